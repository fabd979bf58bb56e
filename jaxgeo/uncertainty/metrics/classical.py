"""Classical approximations of the circular error, compared with the exact value."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxgeo._numerics import safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Numbers
from jaxgeo.uncertainty.metrics.ellipse import drms, error_ellipse
from jaxgeo.uncertainty.metrics.exact import circular_error, circular_probability, covariance


class Classical(Record):
    """A formula for the circular error at a `probability`, from a covariance (..., 2, 2) in m²; `source` cites it."""

    formula: Callable[[Any], Numbers] = eqx.field(static=True)
    probability: float = eqx.field(static=True)
    source: str = eqx.field(static=True)


class Comparison(Record):
    """Radius by a formula and exact radius in m, relative error, and actual probability of the formula's circle."""

    radius: Numbers
    exact: Numbers
    relative_error: Numbers
    contains: Numbers


def linear_cep(cov: Any) -> Numbers:
    """0.562 times the larger and 0.615 times the smaller standard deviation.

    Accurate to 0.5 % for axis ratios from 0.3 to 1; 17 % too small for a degenerate (one-dimensional) error.
    """
    ellipse = error_ellipse(cov)
    return 0.562 * ellipse.major + 0.615 * ellipse.minor


def mean_axis_cep(cov: Any) -> Numbers:
    """0.5887 times the sum of the standard deviations along the axes."""
    ellipse = error_ellipse(cov)
    return 0.5887 * (ellipse.major + ellipse.minor)


def rayleigh_cep(cov: Any) -> Numbers:
    """sqrt(ln 2) times the root mean square: exact for a circular error, too large for every other."""
    return jnp.sqrt(jnp.log(2.0)) * drms(cov)


def grubbs_patnaik_cep(cov: Any) -> Numbers:
    """Median of a chi-square variable with the mean and variance of the squared distance, by Wilson and Hilferty."""
    cov = covariance(cov, 2)
    mean = jnp.trace(cov, axis1=-2, axis2=-1)
    variance = 2.0 * jnp.sum(cov**2, axis=(-2, -1))
    share = variance / (9.0 * jnp.where(mean > 0.0, mean, 1.0) ** 2)
    return safe_sqrt(mean * (1.0 - share) ** 3)


def rms_over_1_2(cov: Any) -> Numbers:
    """The root mean square divided by 1.2, published as CEP.

    Within 0.1 % of the 50 % circle of a circular error; contains 60 % of a one-dimensional error.
    """
    return drms(cov) / 1.2


def rms_axis_ce90(cov: Any) -> Numbers:
    """2.146 times the root mean square along one axis; contains 90 % of a circular error and less of any other."""
    return 2.146 * drms(cov) / jnp.sqrt(2.0)


CLASSICAL: Mapping[str, Classical] = MappingProxyType(
    {
        "linear": Classical(linear_cep, 0.5, "the straight line through the round error, of many handbooks"),
        "mean axis": Classical(mean_axis_cep, 0.5, "half the mean axis times 2.3548, of many handbooks"),
        "Rayleigh": Classical(rayleigh_cep, 0.5, "the round error's median"),
        "Grubbs-Patnaik": Classical(
            grubbs_patnaik_cep,
            0.5,
            "Grubbs (1964), Approximate circular and noncircular offset probabilities of hitting",
        ),
        "RMS / 1.2": Classical(
            rms_over_1_2,
            0.5,
            "Li et al. (2023), A target location method for aerial images through fast iteration of elevation based on "
            "DEM",
        ),
        "2.146 RMS axis": Classical(rms_axis_ce90, 0.9, "Gu (2017)"),
    }
)


def compare_classical(cov: Any) -> dict[str, Comparison]:
    """Every row of `CLASSICAL` for a covariance (..., 2, 2) in m², with the exact circle of the same probability."""
    cov = covariance(cov, 2)
    return {name: _compare(row, cov) for name, row in CLASSICAL.items()}


def _compare(row: Classical, cov: Numbers) -> Comparison:
    radius, exact = row.formula(cov), circular_error(cov, row.probability)
    relative = (radius - exact) / jnp.where(exact > 0.0, exact, 1.0)
    return Comparison(radius, exact, relative, circular_probability(cov, radius))
