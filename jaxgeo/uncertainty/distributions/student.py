"""Student's t-distribution."""

from __future__ import annotations

import functools
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily

from jaxgeo._typing import Numbers, ScalarField
from jaxgeo.uncertainty.distributions.base import AbstractDistribution
from jaxgeo.uncertainty.distributions.table import interpolate, nodes, polynomials

PARTS = 2048
MOST = 1e6  # degrees of freedom; the distribution is normal to 1e-5
LEAST = 1.0  # degrees of freedom; with fewer, values at the edge of the table exceed 1e17


class StudentT(AbstractDistribution):
    """Student's t with `df` degrees of freedom, a number from 1 to 10^6: heavy tails, or a sigma from few repetitions.

    With more than 2 degrees of freedom it is scaled to a standard deviation of one. With 2 or fewer there is no
    standard deviation: `sigma` of the source is the scale s of t(m, s^2), errors can only be sampled, and linear
    propagation refuses the source. If a data sheet or a mean of n readings gives that scale (JCGM 101:2008, 6.4.9), the
    standard deviation is `StudentT(df).per_scale` times as large.

    `df` is a plain number without a derivative: a table of the quantile function, to a relative 1e-9 (from SciPy's
    `stdtrit`), is a constant of each program.
    """

    df: Any = eqx.field(static=True)

    def __check_init__(self) -> None:
        df: Any = self.df
        known = isinstance(df, int | float | np.integer | np.floating) and not isinstance(df, bool)
        if not known or not LEAST <= df <= MOST:
            raise ValueError(
                f"df of StudentT, its degrees of freedom, must be a plain number, {LEAST:g} to {MOST:g}; got {df!r}."
            )

    @property
    def words(self) -> str:
        return f"Student-t with {self.df:g} degrees of freedom"

    @property
    def per_scale(self) -> float:
        """Standard deviation of t(m, s^2) for a scale s of one; raises `ValueError` without a variance."""
        if self.df <= 2.0:
            raise ValueError(f"{self.words} has no standard deviation; it has one with more than 2.")
        return math.sqrt(self.df / (self.df - 2.0))

    def standardised(self, normal: Numbers) -> Numbers:
        values = interpolate(jnp.asarray(_table(float(self.df))), normal)
        return values if self.df <= 2.0 else values / self.per_scale

    @property
    def skewness(self) -> ScalarField:
        return 0.0 if self.df > 3.0 else math.nan

    @property
    def kurtosis(self) -> ScalarField:
        return 3.0 + 6.0 / (self.df - 4.0) if self.df > 4.0 else math.inf

    @property
    def finite_orders(self) -> float:
        return float(self.df)


@functools.lru_cache(maxsize=16)
def _table(df: float) -> np.ndarray:
    normal = nodes(PARTS)
    tail = scipy.special.ndtr(-np.abs(normal))
    value = np.sign(normal) * -scipy.special.stdtrit(df, tail)
    value[normal == 0.0] = 0.0
    log_density = (
        scipy.special.gammaln(0.5 * (df + 1.0))
        - scipy.special.gammaln(0.5 * df)
        - 0.5 * math.log(df * math.pi)
        - 0.5 * (df + 1.0) * np.log1p(value**2 / df)
    )
    slope = np.exp(-0.5 * normal**2 - 0.5 * math.log(2.0 * math.pi) - log_density)
    curvature = -slope * (normal - slope * (df + 1.0) * value / (df + value**2))
    return polynomials(value, slope, curvature)
