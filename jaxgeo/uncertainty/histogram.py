"""Histograms of radii in fixed bins: constant memory, exactly mergeable, quantiles to a relative 2^-14."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxgeo._record import Record
from jaxgeo.uncertainty.intervals import (
    Interval,
    are_many,
    check_scrambles,
    hazen_ranks,
    quantile_ranks,
    scrambled_interval,
)

DIGITS = 14  # binary digits of a radius that its bin keeps: bins are a relative 2^-14 wide, or less
LOWEST, HIGHEST = -14, 28  # powers of two, in m: 61 um, below which all radii share a bin, and 270,000 km
_SHIFT = 52 - DIGITS  # digits of a float64 that are dropped
_BELOW = (LOWEST + 1023) << DIGITS  # bits of the lowest bound
_INFINITE = 2047 << DIGITS  # bits of infinity
BINS = ((HIGHEST - LOWEST) << DIGITS) + 2  # the last one holds the infinite radii of samples without a fix
FEW = 2**16  # radii that wait before they are counted


class RadiusHistogram(Record):
    """Counts of radii, in m, per bin, of one sampling or of each of its Sobol scrambles (`groups`).

    Bins are fixed: the first digits of the number itself. So the histogram of all parts is the sum of those of the
    parts, whatever the parts, which a t-digest or another adaptive sketch cannot give. `bins` are the numbers of the
    occupied bins, in order, and `counts` their samples; those of group g begin at g * BINS. A quantile is off by less
    than 2^-14 (0.0061 %) of its value, or 2^-14 m, from that of the samples; bounds of intervals are those of bins.
    """

    groups: int
    bins: np.ndarray
    counts: np.ndarray

    @classmethod
    def of(cls, radii: np.ndarray, groups: int = 1, group_of: np.ndarray | None = None) -> RadiusHistogram:
        """Histogram of radii, and the group of each; by default they belong to the groups in turn."""
        counter = Counter(groups)
        counter.add(radii, 0, group_of)
        return counter.histogram()

    def merge(self, others: Sequence[RadiusHistogram]) -> RadiusHistogram:
        """The sum of histograms with the same number of groups."""
        every = [self, *others]
        bins, place = np.unique(np.concatenate([one.bins for one in every]), return_inverse=True)
        counts = np.zeros(bins.size, np.int64)
        np.add.at(counts, place, np.concatenate([one.counts for one in every]))
        return RadiusHistogram(self.groups, bins, counts)

    def of_zeros(self) -> RadiusHistogram:
        """The histogram of as many radii, zero where they are finite."""
        group, number = np.divmod(self.bins, BINS)
        zeros = group * BINS + np.where(number == BINS - 1, number, 0)
        return RadiusHistogram(self.groups, zeros, self.counts).merge(())

    def interval(self, probability: float, confidence: float) -> Interval:
        """Quantile and confidence interval, as `quantile_interval`, or for groups as `interval_of_scrambles`."""
        if self.groups > 1:
            pooled = RadiusHistogram(1, self.bins % BINS, self.counts).merge(()).interval(probability, confidence)
            check_scrambles(self.groups)
            if not are_many(int(self.counts.sum()), self.groups, probability):
                return pooled
            each = [self._hazen(group, probability) for group in range(self.groups)]
            return scrambled_interval(np.array(each), confidence, pooled)
        low, rank, high = quantile_ranks(int(self.counts.sum()), probability, confidence)
        return Interval(self._at(rank)[1], self._at(low)[0], self._at(high)[2])

    def quantile_of_found(self, probability: float) -> float:
        """Quantile of the finite radii of all groups; NaN if there are none."""
        bins = self.bins % BINS
        pooled = RadiusHistogram(1, bins[bins < BINS - 1], self.counts[bins < BINS - 1]).merge(())
        count = int(pooled.counts.sum())
        return pooled._at(quantile_ranks(count, probability, 0.5)[1])[1] if count else math.nan

    def _hazen(self, group: int, probability: float) -> float:
        """`scramble_quantile` of a group."""
        here = slice(*np.searchsorted(self.bins, [group * BINS, (group + 1) * BINS]))
        one = RadiusHistogram(1, self.bins[here] - group * BINS, self.counts[here])
        below, above, weight = hazen_ranks(int(one.counts.sum()), probability)
        lower = one._at(below)[1]
        return lower if weight == 0.0 else (1.0 - weight) * lower + weight * one._at(above)[1]

    def _at(self, rank: int) -> tuple[float, float, float]:
        """(lower bound of the bin, estimate, upper bound) of the radius of this rank, counted from 1."""
        cumulative = np.cumsum(self.counts)
        if rank < 1:
            return 0.0, 0.0, 0.0
        if rank > cumulative[-1]:
            return math.inf, math.inf, math.inf
        place = int(np.searchsorted(cumulative, rank))
        low, high = lower_bound(int(self.bins[place])), lower_bound(int(self.bins[place]) + 1)
        if math.isinf(low):
            return math.inf, math.inf, math.inf
        share = (rank - cumulative[place] + self.counts[place] - 0.5) / self.counts[place]
        return low, low + float(share) * (high - low), high


class Counter:
    """Accumulates radii to a histogram, in bounded memory: from `FEW` radii on 5 MB per group."""

    def __init__(self, groups: int = 1) -> None:
        self._groups = groups
        self._waiting: list[np.ndarray] = []
        self._counts: np.ndarray | None = None  # of every bin, which takes longer to look through than a few to sort

    def add(self, radii: np.ndarray, first: int, group_of: np.ndarray | None = None) -> None:
        """Count the radii of samples from number `first` on, or of given groups; NaN is not allowed."""
        bins = bins_of(radii)
        if self._groups > 1:
            bins += ((first + np.arange(radii.size)) % self._groups if group_of is None else group_of) * BINS
        self._waiting.append(bins)
        if sum(each.size for each in self._waiting) > FEW:
            if self._counts is None:
                self._counts = np.zeros(self._groups * BINS, np.int64)
            for each in self._waiting:
                np.add.at(self._counts, each, 1)
            self._waiting = []

    def histogram(self) -> RadiusHistogram:
        """The histogram so far."""
        bins, counts = np.unique(np.concatenate([*self._waiting, np.empty(0, np.int64)]), return_counts=True)
        waiting = RadiusHistogram(self._groups, bins, counts)
        if self._counts is None:
            return waiting
        bins = np.flatnonzero(self._counts)
        counted = RadiusHistogram(self._groups, bins, self._counts[bins])
        return counted.merge((waiting,)) if self._waiting else counted


def bins_of(radii: np.ndarray) -> np.ndarray:
    """Bins of radii in m, 0 or more or infinite."""
    return bin_of_bits(np.ascontiguousarray(radii, np.float64).view(np.int64), np)


def bin_of_bits(bits: Any, xp: Any) -> Any:
    """Bins of the bits of radii; `xp` is NumPy or `jax.numpy`."""
    digits = bits >> _SHIFT
    return xp.where(digits == _INFINITE, BINS - 1, xp.clip(digits - (_BELOW - 1), 0, BINS - 2))


def lower_bound(number: int) -> float:
    """Lower bound in m of a bin; infinite for the last one, and 0 for the first one."""
    if number == 0:
        return 0.0
    if number >= BINS - 1:
        return math.inf
    return float(np.int64((number + _BELOW - 1) << _SHIFT).view(np.float64))
