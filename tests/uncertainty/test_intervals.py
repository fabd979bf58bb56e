"""Intervals hold the quantile as often as they say, of independent draws and of scrambled points."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
import scipy.special
import scipy.stats

from jaxgeo.uncertainty.draws import Sobol
from jaxgeo.uncertainty.intervals import (
    SAMPLE,
    Interval,
    order_ranks,
    quantile_interval,
    relative_half_width,
    scramble_quantile,
    scrambled_interval,
)

SIGMA = np.array([1.0, 3.0])  # m, across and along
SHARES = (0.5, 0.9, 0.95)


@pytest.fixture(scope="module")
def true_radii() -> list[float]:
    """CE50, CE90 and CE95 of the normal distribution with standard deviations SIGMA, m."""

    def share(radius: float) -> float:
        def slice_at(x: float) -> float:
            within = 2.0 * scipy.special.ndtr(math.sqrt(max(radius**2 - x**2, 0.0)) / SIGMA[1]) - 1.0
            return math.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi) * within

        return scipy.integrate.quad(slice_at, -radius, radius, epsabs=1e-12)[0]

    def radius_of(probability: float) -> Any:
        return scipy.optimize.brentq(lambda radius: share(radius) - probability, 0.1, 20.0)

    return [radius_of(probability) for probability in SHARES]


@pytest.mark.parametrize(
    "count, probability, confidence, ranks",
    [
        (10_000, 0.5, 0.95, (4902, 5099)),
        (10_000, 0.9, 0.95, (8941, 9059)),
        (10, 0.5, 0.95, (2, 9)),  # holds it with 97.9 %; with one rank less on a side, 93.5 %
        (10, 0.95, 0.95, (8, 11)),
        (10, 0.05, 0.95, (0, 3)),
        (1, 0.5, 0.95, (0, 2)),
    ],
)
def test_ranks(count: int, probability: float, confidence: float, ranks: tuple[int, int]) -> None:
    assert order_ranks(count, probability, confidence) == ranks


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.9973])
@pytest.mark.parametrize("probability", [0.01, 0.5, 0.9, 0.99])
def test_ranks_are_binomial_quantiles(probability: float, confidence: float) -> None:
    for count in (1, 2, 7, 100, 10_000, 1_000_000):
        low, high = order_ranks(count, probability, confidence)
        below = scipy.stats.binom(count, probability)
        assert (low, high) == (below.ppf(0.5 - 0.5 * confidence), below.ppf(0.5 + 0.5 * confidence) + 1)
        assert below.cdf(high - 1) - below.cdf(low - 1) >= confidence - 1e-9


@pytest.mark.parametrize(
    "count, probability, rank", [(100, 0.55, 55), (100, 0.551, 56), (20, 0.95, 19), (10, 0.001, 1), (7, 0.5, 4)]
)
def test_the_quantile_is_a_sample(count: int, probability: float, rank: int) -> None:
    errors = np.random.default_rng(0).permutation(np.arange(1.0, count + 1.0))
    assert quantile_interval(errors, probability).estimate == rank


def test_bounds_are_samples_in_any_order() -> None:
    ordered = np.arange(1.0, 10_001.0)
    shuffled = np.random.default_rng(1).permutation(ordered)
    assert quantile_interval(shuffled, 0.9) == quantile_interval(ordered, 0.9) == (9000.0, 8941.0, 9059.0)
    np.testing.assert_array_equal(np.sort(shuffled), ordered)
    assert shuffled[0] != 1.0  # the caller's array was not put in order


def test_failures_are_the_worst_samples() -> None:
    errors = np.arange(1.0, 101.0)
    sound = quantile_interval(errors, 0.5)
    errors[90:] = math.inf
    assert quantile_interval(errors, 0.5) == sound
    assert quantile_interval(errors, 0.9) == (90.0, 84.0, math.inf)
    assert quantile_interval(errors, 0.95) == (math.inf, 90.0, math.inf)
    assert quantile_interval(errors[90:], 0.5) == (math.inf,) * 3
    assert quantile_interval([2.0, 3.0], 0.5) == (2.0, 0.0, math.inf)


@pytest.mark.costly
def test_intervals_hold_circular_errors_as_often_as_they_say(true_radii: list[float]) -> None:
    """95 % of 1000 experiments of 10 000 samples; 93 to 97 % is three standard deviations of that count."""
    random = np.random.default_rng(2)
    held = np.zeros(len(SHARES))
    for _ in range(1000):
        errors = np.hypot(*(SIGMA[:, None] * random.standard_normal((2, 10_000))))
        bounds = [quantile_interval(errors, share) for share in SHARES]
        held += [low <= radius <= high for (_, low, high), radius in zip(bounds, true_radii, strict=True)]
    assert np.all(held >= 930), held
    assert np.all(held <= 970), held


@pytest.mark.costly
def test_intervals_of_scrambled_points_hold_them_too_and_are_narrower(true_radii: list[float]) -> None:
    """250 experiments of 16 scrambles of 2^8 points: 91 to 99 % is 2.9 standard deviations of their count."""

    @jax.jit
    def errors(key: jax.Array) -> jax.Array:
        normal = jax.vmap(lambda index: Sobol().standard_normal(key, index, 2))(jnp.arange(16 * 256))
        return jnp.hypot(SIGMA[0] * normal[:, 0], SIGMA[1] * normal[:, 1]).reshape(256, 16).T

    held = np.zeros((250, len(SHARES)))
    width = np.zeros((250, len(SHARES)))
    for experiment in range(250):
        by_scramble = np.asarray(errors(jax.random.key(experiment)))
        for column, (share, radius) in enumerate(zip(SHARES, true_radii, strict=True)):
            interval = scrambled_interval([scramble_quantile(row, share) for row in by_scramble])
            held[experiment, column] = interval.low <= radius <= interval.high
            width[experiment, column] = relative_half_width(interval)
    assert np.all(np.abs(held.mean(axis=0) - 0.95) < 0.04), held.mean(axis=0)
    assert np.all(width.mean(axis=0) < 0.015), width.mean(axis=0)  # of as many independent ones: 0.026 to 0.030


def test_scrambled_interval_is_students() -> None:
    quantiles = np.random.default_rng(3).normal(5.0, 0.1, 20)
    expected = scipy.stats.ttest_1samp(quantiles, 0.0).confidence_interval(0.9)
    mean, low, high = scrambled_interval(quantiles, 0.9)
    np.testing.assert_allclose((mean, low, high), (quantiles.mean(), *expected), rtol=0.0, atol=1e-12)
    assert scrambled_interval([*quantiles, math.inf]) == (math.inf, 0.0, math.inf)
    assert scrambled_interval([0.0] * 15 + [1.0]).low == 0.0


def test_scramble_quantile_lies_between_samples() -> None:
    """Like NumPy's of the same name, but without a NaN where a failed sample has no weight."""
    errors = np.random.default_rng(4).gamma(2.0, size=37)
    for probability in (0.001, 0.3, 0.5, 0.9, 0.999):
        expected = np.quantile(errors, probability, method="hazen")
        np.testing.assert_allclose(scramble_quantile(errors, probability), expected, rtol=0.0, atol=1e-12)
    assert scramble_quantile([1.0, 2.0, math.inf], 0.5) == 2.0
    assert scramble_quantile([1.0, 2.0, math.inf], 0.51) == math.inf
    assert scramble_quantile([math.inf] * 4, 0.5) == math.inf


def test_relative_half_width() -> None:
    assert relative_half_width(Interval(10.0, 9.0, 12.0)) == 0.15
    assert relative_half_width(Interval(10.0, 9.0, math.inf)) == math.inf
    assert relative_half_width(Interval(0.0, 0.0, 0.0)) == 0.0
    assert relative_half_width(Interval(0.0, 0.0, 1.0)) == math.inf


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: quantile_interval([], 0.5), "errors must hold at least one number"),
        (lambda: quantile_interval([1.0, math.nan], 0.5), "got nan at index 1 and 1 such"),
        (lambda: quantile_interval([-2.0, 1.0], 0.5), "got -2.0 at index 0"),
        (lambda: quantile_interval(np.ones((2, 3)), 0.5), r"shape \(2, 3\)"),
        (lambda: quantile_interval([1.0], 50.0), "probability must lie between 0 and 1, such as 0.95; got 50.0"),
        (lambda: quantile_interval([1.0], 0.5, 1.0), "confidence must lie"),
        (lambda: order_ranks(0, 0.5), "count must be a whole number of at least 1; got 0"),
        (lambda: scrambled_interval(np.ones(15)), r"at least 16 .* got 15. Draw with Sobol\(scrambles=16\)"),
    ],
)
def test_mistakes_are_named(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize("kind", ["spread", "sorted", "failed", "alike"])
@pytest.mark.parametrize("probability", [1e-5, 0.5, 0.9, 0.99999])
def test_ranks_of_many_errors_are_those_of_all(kind: str, probability: float) -> None:
    """Also where a sample of them misleads: every so many lies elsewhere, or all are the same."""
    errors = np.random.default_rng(4).exponential(size=200_001)
    if kind == "sorted":
        errors = np.sort(errors)
        errors[:: errors.size // SAMPLE] *= 1e3
    elif kind == "failed":
        errors[errors > 2.0] = np.inf
    elif kind == "alike":
        errors[:] = 3.0
    estimate, low, high = quantile_interval(errors, probability)
    ordered = np.sort(errors)
    first, last = order_ranks(errors.size, probability)
    assert estimate == ordered[int(np.ceil(probability * errors.size)) - 1]
    assert low == (ordered[first - 1] if first >= 1 else 0.0)
    assert high == (ordered[last - 1] if last <= errors.size else np.inf)
