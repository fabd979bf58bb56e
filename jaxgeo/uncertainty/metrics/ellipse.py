"""Error ellipse of a 2D covariance, and root mean square errors."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxgeo._checks import concrete
from jaxgeo._compile import one_program
from jaxgeo._numerics import safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Numbers
from jaxgeo.uncertainty.metrics._ball import eigen
from jaxgeo.uncertainty.metrics.exact import bias_of, check_probability, covariance


class ErrorEllipse(Record):
    """Semi-axes in m, and the azimuth of the longer one in rad clockwise from north, in [0, pi)."""

    major: Numbers
    minor: Numbers
    azimuth: Numbers

    def __str__(self) -> str:
        numbers = [concrete(x) for x in (self.major, self.minor, jnp.round(jnp.rad2deg(self.azimuth), 6))]
        shown = [_shown(x.tolist()) for x in numbers if x is not None]
        if len(shown) < len(numbers):  # traced
            return repr(self)
        return "semi-axes {} and {} m, the longer at {} deg clockwise from north".format(*shown)


def _shown(numbers: Any) -> str:
    """A number, or nested lists of numbers, to six digits."""
    return f"[{' '.join(map(_shown, numbers))}]" if isinstance(numbers, list) else f"{numbers:.6g}"


def error_ellipse(cov: Any, probability: Any = None) -> ErrorEllipse:
    """One-sigma ellipse of a covariance (..., 2, 2) in m², east before north.

    With a `probability`, the ellipse about the mean that contains it: sqrt(-2 ln(1 - p)) times as large. The azimuth of
    a circular error is arbitrary and has no derivative. Raises as `circular_error` does.
    """
    return _ellipse(covariance(cov, 2), None if probability is None else check_probability(probability))


@one_program
def _ellipse(cov: Numbers, probability: Numbers | None) -> ErrorEllipse:
    scale = 1.0 if probability is None else jnp.sqrt(-2.0 * jnp.log1p(-probability))
    variances, axes = jnp.vectorize(eigen, signature="(d,d)->(d),(d,d)")(cov)
    azimuth = jnp.mod(jnp.arctan2(axes[..., 0, 0], axes[..., 0, 1]), jnp.pi)
    major, minor = (jnp.asarray(scale * safe_sqrt(variances[..., k])) for k in (0, 1))
    shape = jnp.broadcast_shapes(major.shape, azimuth.shape)
    return ErrorEllipse(major, minor, jnp.broadcast_to(azimuth, shape))


def drms(cov: Any, bias: Any = None) -> Numbers:
    """Root mean square horizontal distance (DRMS) in m, from `cov` (..., 2, 2) in m² and `bias` (..., 2) in m."""
    return _rms(covariance(cov, 2), bias)


def two_drms(cov: Any, bias: Any = None) -> Numbers:
    """Twice the `drms`: contains 95.4 % of a one-dimensional and 98.2 % of a circular error, not a fixed share."""
    return 2.0 * drms(cov, bias)


def rms_3d(cov: Any, bias: Any = None) -> Numbers:
    """Root mean square 3D distance in m, from `cov` (..., 3, 3) in m² and `bias` (..., 3) in m."""
    return _rms(covariance(cov, 3), bias)


def _rms(cov: Numbers, bias: Any) -> Numbers:
    bias = bias_of(bias, cov.shape[-1])
    return safe_sqrt(jnp.trace(cov, axis1=-2, axis2=-1) + jnp.sum(bias**2, axis=-1))
