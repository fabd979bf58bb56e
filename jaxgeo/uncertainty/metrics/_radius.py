"""Radius of the ball that contains a normal vector with a probability: inverse of `_ball`."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri

from jaxgeo._numerics import dot, larger, safe_norm, safe_sqrt, value_and_slope, within
from jaxgeo._typing import Flag, Numbers, Scalar
from jaxgeo.uncertainty.metrics._ball import Frame, bends_of, eigen, frame_of, in_ball, slopes_of, spread

MOST_STEPS = 100
HIGHEST = 1.0 - 1e-10  # probability; float64 sums do not resolve the remainder to 1 beyond it
CLOSE = 1e-13  # of the radius
ROUNDING = 1e-12  # of the largest entry: tolerance for symmetry and positive semi-definiteness


def radius_of(cov: Numbers, probability: Scalar, mean: Numbers) -> Scalar:
    """Radius about the origin that contains N(mean, cov) with the probability; |mean| for a zero covariance.

    NaN if the covariance is invalid or the probability lies outside (0, `HIGHEST`].
    """
    size, is_point, shape, place = _unit(cov, mean)
    inside = (probability > 0.0) & (probability <= HIGHEST)
    radius = size * _unit_radius(frame_of(shape, place), shape, place, jnp.where(inside, probability, 0.5))
    return jnp.where(inside & is_covariance(cov), jnp.where(is_point, safe_norm(mean), radius), jnp.nan)


def chance_within(cov: Numbers, radius: Scalar, mean: Numbers) -> Scalar:
    """Probability that N(mean, cov) lies within a radius (inclusive) of the origin."""
    size, is_point, shape, place = _unit(cov, mean)
    frame = frame_of(shape, place)
    inside = spread(in_ball, frame, shape, jnp.concatenate([larger(radius, 0.0)[None] / size, place]))
    point = jnp.where(safe_norm(mean) <= radius, 1.0, 0.0)
    return jnp.where(is_covariance(cov), jnp.where(is_point, point, within(inside, 0.0, 1.0)), jnp.nan)


def is_covariance(cov: Numbers) -> Flag:
    """Whether a matrix is finite, symmetric and positive semi-definite, to within rounding."""
    close = ROUNDING * jnp.max(jnp.abs(cov))
    lowest = eigen(jnp.where(jnp.isfinite(cov), cov, 0.0))[0][-1]
    return jnp.all(jnp.isfinite(cov)) & jnp.all(jnp.abs(cov - cov.T) <= close) & (lowest >= -close)


def _unit(cov: Numbers, mean: Numbers) -> tuple[Scalar, Flag, Numbers, Numbers]:
    """Scale length for covariance and mean (trace 1), whether it is zero, scaled covariance, scaled mean."""
    size = safe_sqrt(jax.lax.stop_gradient(jnp.trace(cov)))
    is_point = size == 0.0
    usable = is_covariance(jax.lax.stop_gradient(cov)) & ~is_point
    size = jnp.where(usable, size, 1.0)
    d = len(mean)
    return size, is_point, jnp.where(usable, cov / size / size, jnp.eye(d) / d), jnp.where(usable, mean, 0.0) / size


@jax.custom_jvp
def _unit_radius(frame: Frame, cov: Numbers, mean: Numbers, probability: Scalar) -> Scalar:
    low, high = _bounds(mean, probability)
    goal = _log_odds(probability)

    def excess(radius: Scalar) -> Scalar:
        """By its logarithm, in which log odds are nearly straight below and bend upwards above."""
        return _log_odds(in_ball(frame, jnp.concatenate([jnp.exp(radius)[None], mean]))) - goal

    def is_open(state: tuple[Scalar, Scalar, Scalar, Scalar, Scalar]) -> Flag:
        _, _, _, step, count = state
        return (jnp.abs(step) > CLOSE) & (count < MOST_STEPS)

    def narrow(state: tuple[Scalar, Scalar, Scalar, Scalar, Scalar]) -> tuple[Scalar, Scalar, Scalar, Scalar, Scalar]:
        low, high, x, _, count = state
        value, slope = value_and_slope(excess, x)
        low, high = jnp.where(value < 0.0, x, low), jnp.where(value < 0.0, high, x)
        newton = x - value / jnp.where(slope > 0.0, slope, 1.0)
        stays = (slope > 0.0) & (newton >= low - CLOSE) & (newton <= high + CLOSE)
        following = jnp.where(stays, newton, 0.5 * (low + high))
        return low, high, following, following - x, count + 1.0

    low, high = jnp.log(low), jnp.log(high)
    start = jnp.clip(jnp.log(_guess(cov, mean, probability)), low, high)
    state = (low, high, start, jnp.ones_like(low), jnp.zeros_like(low))
    return jnp.exp(jax.lax.while_loop(is_open, narrow, state)[2])


@_unit_radius.defjvp
def _(primals, tangents):
    frame, cov, mean, _ = primals
    _, cov_tangent, mean_tangent, probability_tangent = tangents
    radius = _unit_radius(*primals)
    place = jnp.concatenate([radius[None], mean])
    slopes = spread(slopes_of(in_ball), frame, cov, place)
    bends = spread(bends_of(in_ball), frame, cov, place)
    moved = dot(slopes[1:], mean_tangent) + 0.5 * jnp.sum(bends * cov_tangent)
    return radius, (probability_tangent - moved) / jnp.where(slopes[0] == 0.0, 1.0, slopes[0])


def _log_odds(p: Scalar) -> Scalar:
    tiny = 1e-300
    return jnp.log(larger(p, tiny)) - jnp.log(larger(1.0 - p, 1e-17))


def _bounds(mean: Numbers, probability: Scalar) -> tuple[Scalar, Scalar]:
    """Lower and upper bound of the radius, for a covariance of trace 1.

    A strip across the longest axis contains at most its width times the peak density there. About the mean: the
    chi-square bound of Laurent and Massart (2000), "Adaptive estimation of a quadratic functional by model selection".
    """
    d, tail = len(mean), -jnp.log1p(-probability)
    low = 0.5 * np.sqrt(2.0 * np.pi / d) * probability
    return 0.9 * low, safe_norm(mean) + jnp.sqrt(d + 2.0 * jnp.sqrt(d * tail) + 2.0 * tail)


def _guess(cov: Numbers, mean: Numbers, probability: Scalar) -> Scalar:
    """Wilson-Hilferty cube root of a chi-square with the mean and variance of the squared distance."""
    first = 1.0 + jnp.sum(mean**2)
    second = 2.0 * jnp.sum(cov**2) + 4.0 * mean @ cov @ mean
    share = second / (9.0 * first**2)
    root = larger(1.0 - share + ndtri(probability) * jnp.sqrt(share), 1e-3)
    return jnp.sqrt(first * root**3)
