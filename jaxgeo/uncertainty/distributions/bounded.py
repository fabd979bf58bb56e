"""Distributions with limits: uniform, triangular, arcsine, truncated normal."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax.scipy.special import erf, ndtr, ndtri

from jaxgeo._checks import concrete
from jaxgeo._typing import Numbers, Scalar, ScalarField
from jaxgeo.uncertainty.distributions.base import AbstractDistribution, both_tails, odd

HALF_ROOT = math.sqrt(0.5)


class Uniform(AbstractDistribution):
    """Uniform within limits of 3^(1/2) standard deviations: quantisation of encoders, tolerances of data sheets."""

    @property
    def words(self) -> str:
        return "uniform"

    def standardised(self, normal: Numbers) -> Numbers:
        return math.sqrt(3.0) * erf(normal * HALF_ROOT)

    @property
    def kurtosis(self) -> ScalarField:
        return 9.0 / 5.0


class Triangular(AbstractDistribution):
    """Triangular, symmetric, within limits of 6^(1/2) standard deviations: the sum of two equal uniform errors."""

    @property
    def words(self) -> str:
        return "triangular"

    def standardised(self, normal: Numbers) -> Numbers:
        return odd(lambda size: math.sqrt(6.0) * (1.0 - jnp.sqrt(both_tails(size))), normal)

    @property
    def kurtosis(self) -> ScalarField:
        return 12.0 / 5.0


class Arcsine(AbstractDistribution):
    """Arcsine (U-shaped) within limits of 2^(1/2) standard deviations: an oscillation at an unknown phase."""

    @property
    def words(self) -> str:
        return "arcsine"

    def standardised(self, normal: Numbers) -> Numbers:
        return math.sqrt(2.0) * jnp.sin(0.5 * math.pi * erf(normal * HALF_ROOT))

    @property
    def kurtosis(self) -> ScalarField:
        return 3.0 / 2.0


class TruncatedNormal(AbstractDistribution):
    """Normal with the parts below `low` and above `high` cut off, e.g. by an acceptance test.

    The limits are in standard deviations of the normal distribution before the cut, and may be infinite. The result is
    scaled to a standard deviation of one about its own mean: `sigma` of the source is that after the cut.
    """

    low: ScalarField
    high: ScalarField

    @property
    def words(self) -> str:
        known = [concrete(limit) for limit in (self.low, self.high)]
        if any(limit is None or limit.ndim for limit in known):
            return "truncated normal"
        return f"normal truncated to {known[0]:g}..{known[1]:g} sigma"

    def standardised(self, normal: Numbers) -> Numbers:
        low, high = self._limits()
        p, q = ndtr(normal), ndtr(-normal)
        below = ndtr(low) * q + ndtr(high) * p
        above = ndtr(-low) * q + ndtr(-high) * p
        is_left = below < above
        tail = ndtri(jnp.where(is_left, below, above))
        mean, sigma = self._mean_and_sigma()
        return (jnp.where(is_left, tail, -tail) - mean) / sigma

    @property
    def skewness(self) -> ScalarField:
        return self._standard_moments()[0]

    @property
    def kurtosis(self) -> ScalarField:
        return self._standard_moments()[1]

    def check(self, label: str) -> None:
        low, high = concrete(self.low), concrete(self.high)
        if low is None or high is None:
            return
        if not (low.ndim == high.ndim == 0 and low < high and low < 8.0 and high > -8.0):
            raise ValueError(
                f"{label}: the limits of TruncatedNormal must be two numbers, low below high, in standard deviations "
                f"of the normal distribution before the cut, within 8 of its middle; got low {low!s}, high {high!s}."
            )

    def _limits(self) -> tuple[Scalar, Scalar]:
        return jnp.asarray(self.low, jnp.float64), jnp.asarray(self.high, jnp.float64)

    def _moments(self) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """Moments of orders 1 to 4 about the middle of the normal distribution before the cut."""
        low, high = self._limits()
        share = jnp.where(low > 0.0, ndtr(-low) - ndtr(-high), ndtr(high) - ndtr(low))
        ends = [jnp.where(jnp.isfinite(x), x, 0.0) for x in (low, high)]
        densities = [
            jnp.where(jnp.isfinite(x), jnp.exp(-0.5 * end**2) / math.sqrt(2.0 * math.pi), 0.0)
            for x, end in zip((low, high), ends, strict=True)
        ]
        at_ends = [(ends[0] ** k * densities[0] - ends[1] ** k * densities[1]) / share for k in range(4)]
        first, second = at_ends[0], 1.0 + at_ends[1]
        return first, second, 2.0 * first + at_ends[2], 3.0 * second + at_ends[3]

    def _mean_and_sigma(self) -> tuple[Scalar, Scalar]:
        mean, square, *_ = self._moments()
        return mean, jnp.sqrt(square - mean**2)

    def _standard_moments(self) -> tuple[Scalar, Scalar]:
        mean, second, third, fourth = self._moments()
        variance = second - mean**2
        skewness = (third - 3.0 * mean * second + 2.0 * mean**3) / variance**1.5
        kurtosis = (fourth - 4.0 * mean * third + 6.0 * mean**2 * second - 3.0 * mean**4) / variance**2
        return skewness, kurtosis
