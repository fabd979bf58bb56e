"""Exact circular, linear and spherical errors of normal errors, and the corresponding probabilities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import as_array, as_float64, check_finite, concrete
from jaxgeo._typing import Numbers
from jaxgeo.uncertainty.metrics._host import host_radii
from jaxgeo.uncertainty.metrics._radius import HIGHEST, ROUNDING, chance_within, radius_of


def _over_batches(item: Callable[[Numbers, Numbers, Numbers], Numbers]) -> Callable[..., Numbers]:
    """Broadcasting version of a function of a covariance, a number and a bias; compiled once per shape."""

    def batch_of(cov: Numbers, number: Numbers, bias: Numbers) -> Numbers:
        d = bias.shape[-1]
        batch = jnp.broadcast_shapes(cov.shape[:-2], number.shape, bias.shape[:-1])
        flat = (
            jnp.broadcast_to(cov, (*batch, d, d)).reshape(-1, d, d),
            jnp.broadcast_to(number, batch).reshape(-1),
            jnp.broadcast_to(bias, (*batch, d)).reshape(-1, d),
        )
        return jax.vmap(item)(*flat).reshape(batch)

    return jax.jit(batch_of)


_radii = _over_batches(radius_of)
_chances = _over_batches(chance_within)


def circular_error(cov: Any, probability: Any, bias: Any = None) -> Numbers:
    """Radius in m of the circle about the nominal point that contains the true point with a probability (CE90, ...).

    `cov` (..., 2, 2) in m² along any two orthogonal axes; `bias` (..., 2) in m along the same axes, zero by default:
    the error is N(bias, cov), and the circle is centred at zero error, not at the mean. Leading axes broadcast. Not an
    approximation: the integral is inverted to about 1e-12 of the radius, for circular to one-dimensional errors and
    small or large biases; to 1e-10 at p = 1 - 1e-6, 1e-8 at 1 - 1e-8 and 1e-6 at 1 - 1e-10, the largest p allowed.
    Derivatives of every order with respect to all three are valid, also for equal axes, a singular covariance and no
    bias. For a zero covariance the radius is |bias|, and its derivative with respect to the covariance, which is
    infinite, is set to zero. Raises `ValueError` for a probability outside (0, 1 - 1e-10], an invalid covariance,
    infinities and NaN; if these are traced, the radius is NaN.

    >>> print(f"{jaxgeo.circular_error(np.eye(2), 0.9):.4f}")
    2.1460
    >>> cov = np.diag([9.0, 1.0])  # 3 m and 1 m
    >>> print(f"{jaxgeo.circular_error(cov, 0.9):.4f} m, 1 m off {jaxgeo.circular_error(cov, 0.9, [1.0, 0.0]):.4f} m")
    5.0435 m, 1 m off 5.3046 m
    """
    return _radius(cov, probability, bias, 2)


def spherical_error(cov: Any, probability: Any, bias: Any = None) -> Numbers:
    """Radius in m of the sphere about the nominal point that contains the true point; see `circular_error`.

    `cov` (..., 3, 3) in m², `bias` (..., 3) in m. Accurate to about 1e-10 of the radius for biases up to ten times the
    largest standard deviation.

    >>> print(f"{jaxgeo.spherical_error(np.eye(3), 0.9):.4f}")
    2.5003
    """
    return _radius(cov, probability, bias, 3)


def linear_error(variance: Any, probability: Any, bias: Any = None) -> Numbers:
    """Half-length in m of the interval about the nominal value that contains the true value: LE50, LE90, ...

    `variance` (...) in m², `bias` (...) in m; otherwise as `circular_error`.

    >>> print(f"{jaxgeo.linear_error(4.0, 0.9):.4f}")
    3.2897
    """
    return _radius(*_as_line(variance, probability, bias), 1)


def circular_probability(cov: Any, radius: Any, bias: Any = None) -> Numbers:
    """Probability that the error N(bias, cov) is within a radius in m of zero; arguments as for `circular_error`.

    Zero for a negative radius. A zero covariance gives zero or one.
    """
    return _chance(cov, radius, bias, 2)


def spherical_probability(cov: Any, radius: Any, bias: Any = None) -> Numbers:
    """Probability that a 3D error is within a radius in m of zero; arguments as for `spherical_error`."""
    return _chance(cov, radius, bias, 3)


def linear_probability(variance: Any, radius: Any, bias: Any = None) -> Numbers:
    """Probability that a 1D error is within a distance in m of zero; arguments as for `linear_error`."""
    return _chance(*_as_line(variance, radius, bias), 1)


def _as_line(variance: Any, other: Any, bias: Any) -> tuple[Any, Any, Any]:
    variance = as_float64(as_array(variance, "variance"), "variance")
    bias = None if bias is None else as_float64(as_array(bias, "bias"), "bias")[..., None]
    return variance[..., None, None], other, bias


def _radius(cov: Any, probability: Any, bias: Any, d: int) -> Numbers:
    cov, bias = covariance(cov, d), bias_of(bias, d)
    level = level_of(probability)
    found = host_radii(cov, level, bias)
    return _radii(cov, level, bias) if found is None else jax.device_put(found)


def _chance(cov: Any, radius: Any, bias: Any, d: int) -> Numbers:
    cov, bias = covariance(cov, d), bias_of(bias, d)
    radius = as_float64(as_array(radius, "radius"), "radius")
    known = concrete(radius)
    if known is not None and np.any(np.isnan(known)):
        raise ValueError("radius must be a number of m; got NaN.")
    return _chances(cov, radius, bias)


def level_of(probability: Any) -> Numbers:
    """The probability of a radius as float64; raises `ValueError` if it is concrete and outside (0, 1 - 1e-10]."""
    level = check_probability(probability)
    known = concrete(level)
    if known is not None and np.any(known > HIGHEST):
        raise ValueError(
            f"probability must be at most 1 - 1e-10, up to which a radius has digits; got 1 - {1.0 - known.max():.3g}."
        )
    return level


def check_probability(probability: Any) -> Numbers:
    """A probability as float64; raises `ValueError` if it is concrete and outside the open interval (0, 1)."""
    probability = as_float64(as_array(probability, "probability"), "probability")
    known = concrete(probability)
    if known is not None and not np.all((known > 0.0) & (known < 1.0)):
        wrong = known[~((known > 0.0) & (known < 1.0))].flat[0]
        raise ValueError(f"probability must lie between 0 and 1, both excluded; got {wrong:g}. Write 90 % as 0.9.")
    return probability


def covariance(cov: Any, d: int) -> Numbers:
    """A covariance (..., d, d) in m² as float64; raises `ValueError` if it is concrete and invalid."""
    name = "cov" if d > 1 else "variance"
    cov = as_float64(as_array(cov, name), name)
    if jnp.ndim(cov) < 2 or cov.shape[-2:] != (d, d):
        raise ValueError(f"cov must have the shape (..., {d}, {d}); got {jnp.shape(cov)}.")
    check_finite(cov, name, "m²")
    known = concrete(cov)
    if known is not None and known.size:
        _check_covariance(known.reshape(-1, d, d), name)
    return cov


def _check_covariance(covs: np.ndarray, name: str) -> None:
    close = ROUNDING * np.max(np.abs(covs), axis=(1, 2))
    skew = np.abs(covs - covs.transpose(0, 2, 1)) > close[:, None, None]
    if np.any(skew):
        k, i, j = np.argwhere(skew)[0]
        raise ValueError(
            f"cov must be symmetric; got {covs[k, i, j]:g} m² in row {i}, column {j}, but {covs[k, j, i]:g} m² in row "
            f"{j}, column {i}. Give (cov + cov.T) / 2 if that is rounding."
        )
    lowest = np.linalg.eigvalsh(covs)[:, 0]
    if np.any(lowest < -close):
        worst = lowest[np.argmax(lowest < -close)]
        raise ValueError(f"{name} must not be negative in any direction; got one with the eigenvalue {worst:g} m².")


def bias_of(bias: Any, d: int) -> Numbers:
    """A bias (..., d) in m as float64, zero for None."""
    if bias is None:
        return jnp.zeros(d)
    bias = as_float64(as_array(bias, "bias"), "bias")
    if jnp.ndim(bias) < 1 or bias.shape[-1] != d:
        raise ValueError(f"bias must have the shape (..., {d}); got {jnp.shape(bias)}.")
    check_finite(bias, "bias", "m")
    return bias
