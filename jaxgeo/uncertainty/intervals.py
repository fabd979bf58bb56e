"""Distribution-free confidence intervals for quantiles of sampled errors."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy  # submodules load lazily

LEAST_SCRAMBLES = 16
MANY = 65_536  # number of errors from which a full sort is avoided
SAMPLE = 16_384


class Interval(NamedTuple):
    """An estimate and its bounds in the unit of the errors; infinite if too many samples failed."""

    estimate: float
    low: float
    high: float


class Share(NamedTuple):
    """A share of all samples, and its confidence interval from `low` to `high`."""

    value: float
    low: float
    high: float


def order_ranks(count: int, probability: float, confidence: float = 0.95) -> tuple[int, int]:
    """Ranks, counted from 1, of the two of `count` independent samples that bracket a quantile.

    The number of samples below the quantile is binomial for any distribution. The lower rank may be 0 and the upper one
    `count` + 1: too few samples for a bound on that side. David and Nagaraja 2003, "Order statistics", section 7.1.
    """
    count = _whole(count, "count", 1)
    _check_share(probability, "probability")
    _check_share(confidence, "confidence")
    aside = 0.5 * (1.0 - confidence)
    return _binomial_quantile(aside, count, probability), _binomial_quantile(1.0 - aside, count, probability) + 1


def quantile_interval(errors: Any, probability: float, confidence: float = 0.95) -> Interval:
    """The `probability` quantile of independent samples of an error, in any order, and its confidence interval.

    The quantile is the smallest sample that at least that share of the samples does not exceed. Failed samples are
    infinite and count as the largest. A bound not determined by the samples is 0 or infinite. Raises `ValueError` for
    no samples, NaN and negative errors.
    """
    errors = _errors(errors, "errors")
    low, rank, high = quantile_ranks(errors.size, probability, confidence)
    inside = sorted({max(low, 1), rank, min(high, errors.size)})
    ordered = dict(zip(inside, _order(errors, [k - 1 for k in inside]), strict=True))
    return Interval(
        ordered[rank],
        ordered[low] if low >= 1 else 0.0,
        ordered[high] if high <= errors.size else math.inf,
    )


def quantile_ranks(count: int, probability: float, confidence: float) -> tuple[int, int, int]:
    """Ranks, counted from 1, of the lower bound, the quantile and the upper bound; bounds may be 0 or `count` + 1."""
    low, high = order_ranks(count, probability, confidence)
    # Guards ceil against a product that is an integer except for its last bit.
    return low, max(1, math.ceil(probability * count * (1.0 - 2.0**-50))), high


def scramble_quantile(errors: Any, probability: float) -> float:
    """The `probability` quantile of one scramble's errors, interpolated between samples.

    Sample k of n in order is at (k - 1/2) / n (Hazen 1914, "Storage to be provided in impounding reservoirs"). For
    low-discrepancy points the half-rank bias of the k-th sample itself is not negligible: at 2^8 points the interval
    would cover 87 to 95 % instead of 94 to 95 %. Infinite if it depends on a failed sample.
    """
    errors = _errors(errors, "errors")
    _check_share(probability, "probability")
    below, above, weight = hazen_ranks(errors.size, probability)
    lower, upper = _order(errors, [below - 1, above - 1])
    return lower if weight == 0.0 else (1.0 - weight) * lower + weight * upper


def hazen_ranks(count: int, probability: float) -> tuple[int, int, float]:
    """(lower rank, upper rank, weight of the upper one) of a quantile interpolated between samples.

    A weight that only rounding makes positive is 0, so that an infinite neighbour does not count.
    """
    rank = min(max(probability * count + 0.5, 1.0), float(count))
    below = math.floor(rank)
    weight = rank - below
    return below, min(below + 1, count), 0.0 if weight < 1e-9 else weight


def scrambled_interval(per_scramble: Any, confidence: float = 0.95) -> Interval:
    """Mean of the quantiles of at least 16 independent scrambles, and Student's confidence interval.

    Samples within one scramble of Sobol points are not independent, so rank intervals do not apply; the scrambles are
    independent. `per_scramble` holds the `scramble_quantile` of each. If one is infinite, so is the mean, without
    bounds. Raises `ValueError` for fewer than 16.
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


def share_of(numbers: Any, count: int, confidence: float = 0.95, scrambles: int = 0) -> Share:
    """The share that the samples with these numbers, from 0 on, are of `count`, and its confidence interval.

    Independent samples: Clopper and Pearson 1934, "The use of confidence or fiducial limits illustrated in the case of
    the binomial". Scrambles of Sobol points: Student's interval of the shares of the scrambles.
    """
    count, numbers = _whole(count, "count", 1), np.asarray(numbers)
    _check_share(confidence, "confidence")
    if scrambles:
        size = np.bincount(np.arange(count) % scrambles, minlength=scrambles)
        mean, low, high = scrambled_interval(np.bincount(numbers % scrambles, minlength=scrambles) / size, confidence)
        return Share(mean, low, min(high, 1.0))
    inside, aside = len(numbers), 0.5 * (1.0 - confidence)
    low = float(scipy.special.betaincinv(inside, count - inside + 1, aside)) if inside else 0.0
    high = float(scipy.special.betaincinv(inside + 1, count - inside, 1.0 - aside)) if inside < count else 1.0
    return Share(inside / count, low, high)


def relative_half_width(interval: Interval) -> float:
    """Half the width of an interval divided by its estimate: the stopping criterion of adaptive sampling.

    Infinite while the interval is infinite; 0 if it has no width. JCGM 101:2008, section 7.9.
    """
    if not all(map(math.isfinite, interval)):
        return math.inf
    half = 0.5 * (interval.high - interval.low)
    if half == 0.0:
        return 0.0
    return half / interval.estimate if interval.estimate > 0.0 else math.inf


def _order(errors: np.ndarray, ranks: list[int]) -> list[float]:
    """The errors of these ranks, counted from 0, in ascending order.

    For large samples only the errors near the ranks are sorted, located by a subsample (Floyd and Rivest 1975,
    "Expected time bounds for selection"): no full copy, a fifth of the time. If the count below shows that the
    subsample was wrong, all errors are sorted.
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
            return _order_all(near, [rank - below for rank in ranks])
    return _order_all(errors, ranks)


def _order_all(errors: np.ndarray, ranks: list[int]) -> list[float]:
    ordered = np.partition(errors, sorted(set(ranks)))
    return [float(ordered[rank]) for rank in ranks]


def _binomial_quantile(share: float, count: int, probability: float) -> int:
    """Smallest number of successes in `count` trials that is not exceeded with probability `share` or more."""
    number = math.ceil(scipy.special.bdtrik(share, count, probability))
    below = max(number - 1, 0)
    return below if scipy.special.bdtr(below, count, probability) >= share else number


def _errors(values: Any, name: str) -> np.ndarray:
    """`values` as a flat float64 array of at least one error, none NaN or negative."""
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
