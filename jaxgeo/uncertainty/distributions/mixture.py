"""Mixture of normal distributions, such as a share of outliers."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr, logsumexp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import as_array, as_float64, check_finite, check_range, concrete
from jaxgeo._typing import Numbers, Scalar, ScalarField
from jaxgeo.uncertainty.distributions.base import AbstractDistribution
from jaxgeo.uncertainty.distributions.table import interpolate, nodes, polynomials

PARTS = 8192  # more than for a smooth quantile function: it bends sharply where outliers begin
STEPS = 60  # of Newton's method or bisection
LOG_ROOT = 0.5 * math.log(2.0 * math.pi)
Parts = Float[Array, " parts"]


class Mixture(AbstractDistribution):
    """Mixture of normal distributions with `shares`, and `sigmas` and `means` in any common unit, (parts,) each.

    It is shifted and scaled to zero mean and a standard deviation of one: `sigma` of the source is that of the whole
    mixture, `per_core` times the sigma of the first part. Differentiable in all parameters. Quantiles are exact to 1e-9
    standard deviations; draws use a table of them, to 1e-5 for outliers up to 100 times as large as the others.

    >>> from jaxgeo.uncertainty.distributions import Mixture
    >>> outliers = Mixture.of_outliers(share=0.05, times=10.0)
    >>> print(f"{outliers.per_core:.3f} {outliers.kurtosis:.1f}")
    2.439 42.5
    """

    shares: Any
    sigmas: Any
    means: Any = 0.0

    @classmethod
    def of_outliers(cls, *, share: ArrayLike, times: ArrayLike) -> Mixture:
        """Normal errors of which a `share` has a standard deviation `times` as large as the others.

        Raises `ValueError` for a share outside (0, 1) and for times that are not positive.
        """
        given: Any = as_float64(as_array([share, times], "share and times"), "share and times")
        check_range(given[0], "share", "(a share of outliers)", 1e-12, 1.0 - 1e-12)
        check_range(given[1], "times", "(standard deviations of the others)", 1e-6, 1e6)
        return cls(jnp.stack([1.0 - given[0], given[0]]), jnp.stack([jnp.ones(()), given[1]]))

    @property
    def words(self) -> str:
        return f"a mixture of {np.shape(self.shares)[-1]} normal distributions"

    @property
    def per_core(self) -> Scalar:
        """Standard deviation of the whole for a sigma of the first part of one."""
        return self._mean_and_sigma()[1] / jnp.asarray(self.sigmas)[0]

    @property
    def standard_deviation(self) -> Scalar:
        """Standard deviation of the whole, in the unit of `sigmas` and `means`."""
        return self._mean_and_sigma()[1]

    def standardised(self, normal: Numbers) -> Numbers:
        logs, middles, scales = self._standard_parts()
        flat = normal.reshape(-1)
        return jax.vmap(lambda z: _quantile(z, logs, middles, scales))(flat).reshape(normal.shape)

    @property
    def skewness(self) -> ScalarField:
        _, middles, scales = self._standard_parts()
        return jnp.sum(jnp.asarray(self.shares) * (middles**3 + 3.0 * middles * scales**2))

    @property
    def kurtosis(self) -> ScalarField:
        _, middles, scales = self._standard_parts()
        powers = middles**4 + 6.0 * middles**2 * scales**2 + 3.0 * scales**4
        return jnp.sum(jnp.asarray(self.shares) * powers)

    def check(self, label: str) -> None:
        shares, sigmas, means = self.shares, self.sigmas, self.means
        if (
            np.ndim(shares) != 1
            or np.shape(shares) != np.shape(sigmas)
            or np.shape(means) not in ((), np.shape(shares))
        ):
            raise ValueError(
                f"{label}: Mixture needs a share and a sigma for each part, and a mean for each or for all; got shapes "
                f"{np.shape(shares)}, {np.shape(sigmas)} and {np.shape(means)}."
            )
        for value, name in ((shares, "shares"), (sigmas, "sigmas"), (means, "means")):
            check_finite(value, f"{label}: {name} of Mixture", "a common unit")
        known_shares, known_sigmas = concrete(shares), concrete(sigmas)
        if known_shares is not None and (np.any(known_shares <= 0.0) or abs(float(np.sum(known_shares)) - 1.0) > 1e-9):
            raise ValueError(
                f"{label}: shares of Mixture must be positive and sum to 1; got {known_shares.tolist()}, the sum of "
                f"which is {float(np.sum(known_shares)):.12g}."
            )
        if known_sigmas is not None and np.any(known_sigmas <= 0.0):
            raise ValueError(f"{label}: sigmas of Mixture must be positive; got {known_sigmas.tolist()}.")

    def prepared(self) -> AbstractDistribution:
        normal = jnp.asarray(nodes(PARTS))
        logs, middles, scales = self._standard_parts()
        value = self.standardised(normal)
        from_middle = (value[:, None] - middles[None, :]) / scales[None, :]
        parts = (logs - jnp.log(scales))[None, :] - 0.5 * from_middle**2
        density = logsumexp(parts, axis=1)
        fall = jnp.sum(jnp.exp(parts - density[:, None]) * from_middle / scales[None, :], axis=1)  # of the log density
        slope = jnp.exp(-0.5 * normal**2 - density)
        return Tabulated(self, polynomials(value, slope, -slope * (normal - slope * fall)))

    def _mean_and_sigma(self) -> tuple[Scalar, Scalar]:
        shares, sigmas, means = self._parts()
        mean = jnp.sum(shares * means)
        return mean, jnp.sqrt(jnp.sum(shares * (sigmas**2 + (means - mean) ** 2)))

    def _parts(self) -> tuple[Parts, Parts, Parts]:
        shares, sigmas = jnp.asarray(self.shares, jnp.float64), jnp.asarray(self.sigmas, jnp.float64)
        return shares, sigmas, jnp.broadcast_to(jnp.asarray(self.means, jnp.float64), shares.shape)

    def _standard_parts(self) -> tuple[Parts, Parts, Parts]:
        """Logarithms of the shares, means and sigmas, of the mixture with zero mean and unit variance."""
        shares, sigmas, means = self._parts()
        mean, sigma = self._mean_and_sigma()
        return jnp.log(shares), (means - mean) / sigma, sigmas / sigma


class Tabulated(AbstractDistribution):
    """A distribution with a table of its quantile function."""

    exact: AbstractDistribution
    table: Float[Array, "parts 6"]

    @property
    def words(self) -> str:
        return self.exact.words

    def standardised(self, normal: Numbers) -> Numbers:
        return interpolate(self.table, normal)

    @property
    def skewness(self) -> ScalarField:
        return self.exact.skewness

    @property
    def kurtosis(self) -> ScalarField:
        return self.exact.kurtosis


def _quantile(normal: Scalar, logs: Parts, middles: Parts, scales: Parts) -> Scalar:
    """Quantile of a mixture at the probability of a standard normal number.

    The smaller tail's logarithm is solved for, in a reflected mixture for positive numbers, so that far quantiles are
    as exact as near ones. The last two steps carry the derivatives.
    """
    is_above = normal > 0.0
    middles = jnp.where(is_above, -middles, middles)
    depth = jnp.where(is_above, -normal, normal)
    wanted = log_ndtr(depth)

    def of_tail(x: Scalar, logs: Parts, middles: Parts, scales: Parts) -> tuple[Scalar, Scalar]:
        """(logarithm of the lower tail, its derivative)."""
        from_middle = (x - middles) / scales
        tail = logsumexp(logs + log_ndtr(from_middle))
        density = logsumexp(logs - jnp.log(scales) - 0.5 * from_middle**2 - LOG_ROOT)
        return tail, jnp.exp(density - tail)

    known = jax.lax.stop_gradient((logs, middles, scales))
    goal, ends = jax.lax.stop_gradient(wanted), jax.lax.stop_gradient(middles + scales * depth)

    def step(_: Any, state: tuple[Scalar, Scalar, Scalar]) -> tuple[Scalar, Scalar, Scalar]:
        low, high, x = state
        tail, slope = of_tail(x, *known)
        low, high = jnp.where(tail < goal, x, low), jnp.where(tail < goal, high, x)
        newton = x - (tail - goal) / slope
        return low, high, jnp.where((newton > low) & (newton < high), newton, 0.5 * (low + high))

    low, high = jnp.min(ends), jnp.max(ends)
    x = jax.lax.fori_loop(0, STEPS, step, (low, high, 0.5 * (low + high)))[2]
    for _ in range(2):
        tail, slope = of_tail(x, logs, middles, scales)
        x = x - (tail - wanted) / slope
    return jnp.where(is_above, -x, x)
