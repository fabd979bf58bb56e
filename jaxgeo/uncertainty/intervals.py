"""Distribution-free confidence intervals for quantiles of sampled errors."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy  # submodules load lazily

LEAST_SCRAMBLES = 16
FEWEST_POINTS, FEWEST_BEYOND = 16, 4.0  # of a scramble, and of these beyond its quantile on average; else it is biased
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


def interval_of_scrambles(
    errors: Any, probability: float, confidence: float = 0.95, *, scrambles: int, scramble_of: Any = None
) -> Interval:
    """The `probability` quantile of all samples from scrambles of Sobol points, and its confidence interval.

    `scramble_of` (count,) is the scramble of each sample; by default samples are in the order of their numbers. The
    estimate is that of `quantile_interval`. Samples within one scramble are not independent, so ranks do not apply; the
    scrambles are independent: the interval is Student's for the mean of their quantiles (`scramble_quantile`). Where
    scrambles have too few points for that (about 4 above and below the quantile), or too many of them fail, it is that
    of `quantile_interval`, which is too wide for samples more even than independent ones. Raises as
    `quantile_interval`, and `ValueError` for fewer than 16 scrambles.
    """
    errors = _errors(errors, "errors")
    check_scrambles(scrambles)
    pooled = quantile_interval(errors, probability, confidence)
    if not are_many(errors.size, scrambles, probability):
        return pooled
    return scrambled_interval(_scramble_quantiles(errors, probability, scrambles, scramble_of), confidence, pooled)


def are_many(count: int, scrambles: int, probability: float) -> bool:
    """Whether scrambles have enough points for a quantile or share of their own."""
    points = count // scrambles
    return points >= FEWEST_POINTS and points * min(probability, 1.0 - probability) >= FEWEST_BEYOND


def _scramble_quantiles(errors: np.ndarray, probability: float, scrambles: int, scramble_of: Any) -> np.ndarray:
    """`scramble_quantile` of each scramble."""
    if scramble_of is not None:
        order = np.argsort(scramble_of, kind="stable")
        each = np.split(errors[order], np.cumsum(np.bincount(scramble_of, minlength=scrambles))[:-1])
        return np.array([scramble_quantile(one, probability) for one in each])
    if errors.size >= MANY:
        near = _near_scramble_quantiles(errors, probability, scrambles)
        if near is not None:
            return near
    points, longer = divmod(errors.size, scrambles)
    parts = [errors[: errors.size - longer].reshape(points, scrambles).T[longer:]]
    if longer:
        filled = np.concatenate([errors, np.empty(scrambles - longer)]).reshape(points + 1, scrambles)
        parts.insert(0, filled.T[:longer])
    return np.concatenate([_hazen(np.ascontiguousarray(part), probability) for part in parts])


def _near_scramble_quantiles(errors: np.ndarray, probability: float, scrambles: int) -> np.ndarray | None:
    """As `_scramble_quantiles`, by the errors near the quantile only, as a subsample says; None if that is wrong."""
    some = np.sort(errors[:: errors.size // SAMPLE])
    fewest = errors.size // scrambles
    apart = 6.0 * math.sqrt(probability * (1.0 - probability) * (1.0 / fewest + 1.0 / some.size))
    first, last = (int((probability + sign * apart) * some.size) for sign in (-1, 1))
    if first < 0 or last >= some.size:
        return None
    by_scramble = lambda places: np.bincount(places % scrambles, minlength=scrambles)  # noqa: E731
    near = np.flatnonzero((errors >= some[first]) & (errors <= some[last]))
    points = by_scramble(np.arange(scrambles)) * fewest + (np.arange(scrambles) < errors.size % scrambles)
    if probability < 0.5:
        below = by_scramble(np.flatnonzero(errors < some[first]))
    else:
        below = points - by_scramble(near) - by_scramble(np.flatnonzero(errors > some[last]))
    found = np.empty(scrambles)
    for number in range(scrambles):
        own = errors[near[near % scrambles == number]]
        lower, upper, weight = hazen_ranks(int(points[number]), probability)
        lower, upper = (rank - 1 - below[number] for rank in (lower, upper))
        if lower < 0 or upper >= own.size:
            return None
        ordered = np.partition(own, sorted({lower, upper}))
        found[number] = ordered[lower] if weight == 0.0 else (1.0 - weight) * ordered[lower] + weight * ordered[upper]
    return found


def _hazen(rows: np.ndarray, probability: float) -> np.ndarray:
    """`scramble_quantile` of each row."""
    below, above, weight = hazen_ranks(rows.shape[1], probability)
    ordered = np.partition(rows, sorted({below - 1, above - 1}), axis=1)
    lower = ordered[:, below - 1]
    return lower if weight == 0.0 else (1.0 - weight) * lower + weight * ordered[:, above - 1]


def scramble_quantile(errors: Any, probability: float) -> float:
    """The `probability` quantile of one scramble's errors, interpolated between samples.

    Sample k of n in order is at (k - 1/2) / n (Hazen 1914, "Storage to be provided in impounding reservoirs"). For
    low-discrepancy points the half-rank bias of the k-th sample itself is not negligible: at 2^8 points the interval
    would cover 87 to 95 % instead of 94 to 95 %. Infinite if it depends on a failed sample.
    """
    errors = _errors(errors, "errors")
    _check_share(probability, "probability")
    return float(_hazen(errors[None, :], probability)[0])


def hazen_ranks(count: int, probability: float) -> tuple[int, int, float]:
    """(lower rank, upper rank, weight of the upper one) of a quantile interpolated between samples.

    A weight that only rounding makes positive is 0, so that an infinite neighbour does not count.
    """
    rank = min(max(probability * count + 0.5, 1.0), float(count))
    below = math.floor(rank)
    weight = rank - below
    return below, min(below + 1, count), 0.0 if weight < 1e-9 else weight


def scrambled_interval(per_scramble: Any, confidence: float = 0.95, pooled: Interval | None = None) -> Interval:
    """Mean of the quantiles of at least 16 independent scrambles, and Student's confidence interval.

    `per_scramble` holds the `scramble_quantile` of each. With the quantile of all samples, `pooled`, the interval is
    one of the same width about that. If one is infinite, the result is `pooled`, or infinite without bounds. Raises
    `ValueError` for fewer than 16.
    """
    quantiles = _errors(per_scramble, "per_scramble")
    _check_share(confidence, "confidence")
    check_scrambles(quantiles.size)
    if not np.all(np.isfinite(quantiles)):
        return Interval(math.inf, 0.0, math.inf) if pooled is None else pooled
    estimate = float(np.mean(quantiles)) if pooled is None else pooled.estimate
    student = float(scipy.special.stdtrit(quantiles.size - 1, 0.5 * (1.0 + confidence)))
    half = student * float(np.std(quantiles, ddof=1)) / math.sqrt(quantiles.size)
    return Interval(estimate, max(estimate - half, 0.0), estimate + half)


def check_scrambles(scrambles: int) -> None:
    """Raise `ValueError` for fewer than 16."""
    if scrambles < LEAST_SCRAMBLES:
        raise ValueError(
            f"an interval from scrambles needs at least {LEAST_SCRAMBLES} of them, so that their spread is known; got "
            f"{scrambles}. Draw with Sobol(scrambles={LEAST_SCRAMBLES}) or more."
        )


def share_of(
    places: Any, count: int, confidence: float = 0.95, *, scrambles: int = 0, scramble_of: Any = None
) -> Share:
    """The share that the samples at these places, from 0 on, are of `count`, and its confidence interval.

    Independent samples: Clopper and Pearson 1934, "The use of confidence or fiducial limits illustrated in the case of
    the binomial". Scrambles of Sobol points: Student's interval from the shares of the scrambles, or Clopper and
    Pearson's where scrambles have few points within or outside; `scramble_of` as for `interval_of_scrambles`.
    """
    count, places = _whole(count, "count", 1), np.asarray(places)
    _check_share(confidence, "confidence")
    inside, aside = len(places), 0.5 * (1.0 - confidence)
    if scrambles:
        check_scrambles(scrambles)
    if scrambles and are_many(count, scrambles, inside / count):
        every = np.arange(count) % scrambles if scramble_of is None else np.asarray(scramble_of)
        own, all_of = (np.bincount(which, minlength=scrambles) for which in (every[places], every))
        low, high = scrambled_interval(own / all_of, confidence, Interval(inside / count, 0.0, 1.0))[1:]
        return Share(inside / count, low, min(high, 1.0))
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
