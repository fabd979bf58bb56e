"""How sure a quantile of sampled errors is: intervals that assume nothing about how the errors are distributed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy  # loads its parts when they are asked for

LEAST_SCRAMBLES = 16
MANY = 65_536  # errors, from which on not all are put in order
SAMPLE = 16_384


class Interval(NamedTuple):
    """An estimate and its bounds, all in the unit of the errors; infinite where too many samples failed."""

    estimate: float
    low: float
    high: float


def order_ranks(count: int, probability: float, confidence: float = 0.95) -> tuple[int, int]:
    """Ranks, counted from 1, of the two of `count` independent samples that enclose a quantile.

    How many samples lie below the quantile is binomial, however they are distributed. The lower rank may be 0 and the
    upper one `count` + 1: too few samples for a bound on that side. Source: David and Nagaraja 2003, "Order
    statistics", section 7.1.
    """
    count = _whole(count, "count", 1)
    _check_share(probability, "probability")
    _check_share(confidence, "confidence")
    aside = 0.5 * (1.0 - confidence)
    return _binomial_quantile(aside, count, probability), _binomial_quantile(1.0 - aside, count, probability) + 1


def quantile_interval(errors: Any, probability: float, confidence: float = 0.95) -> Interval:
    """The `probability` quantile of independent samples of an error, in any order, and its interval.

    The quantile is the smallest sample below or at which lies that share of them. Failed samples are infinite: they
    count as the worst. A bound that the samples do not give is 0 or infinite. Raises `ValueError` for none, for NaN and
    for errors below zero.
    """
    errors = _errors(errors, "errors")
    low, high = order_ranks(errors.size, probability, confidence)
    # Rounding up must not be led astray by a product that is a whole number but for its last bit.
    rank = max(1, math.ceil(probability * errors.size * (1.0 - 2.0**-50)))
    inside = sorted({max(low, 1), rank, min(high, errors.size)})
    ordered = dict(zip(inside, _ordered(errors, [k - 1 for k in inside]), strict=True))
    return Interval(
        ordered[rank],
        ordered[low] if low >= 1 else 0.0,
        ordered[high] if high <= errors.size else math.inf,
    )


def scramble_quantile(errors: Any, probability: float) -> float:
    """The `probability` quantile of one scramble's errors, between samples where it falls between them.

    Sample k of n in order stands for the middle of its share, (k - 1/2) / n (Hazen 1914, "Storage to be provided in
    impounding reservoirs"). Evenly spread points are so sure of their quantile that the half rank by which the k-th
    sample itself is off would spoil the interval: at 2^8 points it covers 87 to 95 % instead of 94 to 95 %.
    Infinite where it leans on a failed sample.
    """
    errors = _errors(errors, "errors")
    _check_share(probability, "probability")
    rank = min(max(probability * errors.size + 0.5, 1.0), float(errors.size))
    below = math.floor(rank)
    above = min(below + 1, errors.size)
    lower, upper = _ordered(errors, [below - 1, above - 1])
    weight = rank - below
    if weight < 1e-9:  # an infinite neighbour without weight has no say
        return lower
    return (1.0 - weight) * lower + weight * upper


def scrambled_interval(per_scramble: Any, confidence: float = 0.95) -> Interval:
    """Mean of the quantiles of independent scrambles, at least 16, and Student's interval about it.

    Samples of one scramble of Sobol points are not independent, so that their ranks say nothing; the scrambles are.
    `per_scramble` holds the `scramble_quantile` of each. An infinite one leaves the mean infinite and without bounds.
    Raises `ValueError` for fewer.
    """
    quantiles = _errors(per_scramble, "per_scramble")
    _check_share(confidence, "confidence")
    if quantiles.size < LEAST_SCRAMBLES:
        raise ValueError(
            f"an interval from scrambles needs at least {LEAST_SCRAMBLES} of them, so that their spread is known; got "
            f"{quantiles.size}. Draw with Sobol(scrambles={LEAST_SCRAMBLES}) or more."
        )
    if not np.all(np.isfinite(quantiles)):
        return Interval(math.inf, 0.0, math.inf)
    mean = float(np.mean(quantiles))
    student = float(scipy.special.stdtrit(quantiles.size - 1, 0.5 * (1.0 + confidence)))
    half = student * float(np.std(quantiles, ddof=1)) / math.sqrt(quantiles.size)
    return Interval(mean, max(mean - half, 0.0), mean + half)


def relative_half_width(interval: Interval) -> float:
    """Half of an interval's width over its estimate: what adaptive sampling makes small.

    Infinite while the interval is; 0 if it has no width. Source: JCGM 101:2008, section 7.9.
    """
    if not all(map(math.isfinite, interval)):
        return math.inf
    half = 0.5 * (interval.high - interval.low)
    if half == 0.0:
        return 0.0
    return half / interval.estimate if interval.estimate > 0.0 else math.inf


def _ordered(errors: np.ndarray, ranks: list[int]) -> list[float]:
    """The errors of these ranks, counted from 0, in rising order.

    Of many, only those are put in order that lie where a sample of them says that the ranks are (Floyd and Rivest 1975,
    "Expected time bounds for selection"): there is no copy of all, and it takes a fifth of the time. If the sample was
    wrong, which the count of those below tells, all are.
    """
    count = errors.size
    if count >= MANY:
        sample = np.sort(errors[:: count // SAMPLE])
        about = np.array([ranks[0], ranks[-1]]) * (sample.size / count)
        low, high = (about + 4.0 * np.sqrt(sample.size) * np.array([-1.0, 1.0])).astype(int)
        least = sample[low] if low >= 0 else -math.inf
        most = sample[high] if high < sample.size else math.inf
        below, between = 0, []
        for first in range(0, count, MANY):
            some = errors[first : first + MANY]
            below += int(np.count_nonzero(some < least))
            between.append(some[(some >= least) & (some <= most)])
        near = np.concatenate(between)
        if below <= ranks[0] and ranks[-1] - below < near.size:
            return _ordered_of_all(near, [rank - below for rank in ranks])
    return _ordered_of_all(errors, ranks)


def _ordered_of_all(errors: np.ndarray, ranks: list[int]) -> list[float]:
    ordered = np.partition(errors, sorted(set(ranks)))
    return [float(ordered[rank]) for rank in ranks]


def _binomial_quantile(share: float, count: int, probability: float) -> int:
    """Smallest number of successes in `count` trials that is not exceeded with at least the probability `share`."""
    number = math.ceil(scipy.special.bdtrik(share, count, probability))
    below = max(number - 1, 0)
    return below if scipy.special.bdtr(below, count, probability) >= share else number


def _errors(values: Any, name: str) -> np.ndarray:
    """`values` as a flat array of float64 of at least one error, none of them NaN or below zero."""
    errors = np.asarray(values, np.float64)
    if errors.ndim != 1:
        raise ValueError(f"{name} must be one row of numbers; got an array of shape {errors.shape}.")
    if errors.size == 0:
        raise ValueError(f"{name} must hold at least one number; it is empty.")
    wrong = ~(errors >= 0.0)
    if np.any(wrong):
        raise ValueError(
            f"{name} must be at least 0, and infinite where a sample failed; got {errors[wrong][0]} at index "
            f"{np.flatnonzero(wrong)[0]} and {np.count_nonzero(wrong)} such numbers in all."
        )
    return errors


def _whole(value: Any, name: str, least: int) -> int:
    if not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}; got {value!r}.")
    return int(value)


def _check_share(value: Any, name: str) -> None:
    if not 0.0 < value < 1.0:
        raise ValueError(f"{name} must lie between 0 and 1, such as 0.95; got {value!r}.")
