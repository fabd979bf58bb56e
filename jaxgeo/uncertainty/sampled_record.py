"""Result of Monte Carlo sampling: counts, moments and quantiles of sampled errors, and merging of its parts."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxgeo._record import Record, portable
from jaxgeo.fix import Fix
from jaxgeo.status import Status
from jaxgeo.uncertainty._figures import figure
from jaxgeo.uncertainty.histogram import RadiusHistogram
from jaxgeo.uncertainty.intervals import (
    Interval,
    Share,
    interval_of_scrambles,
    quantile_interval,
    share_of,
)
from jaxgeo.uncertainty.origin import Origin

if TYPE_CHECKING:
    from jaxgeo.terrain import Dem
    from jaxgeo.uncertainty.regions import ProbabilityMap, Region


class Quantile(NamedTuple):
    """Accuracy figure from samples, m: `value`, and its confidence interval from `low` to `high`.

    All samples count, those without a fix as infinitely far; infinite if too many fail. `conditional` is the figure of
    the samples with a fix only, and `share` their share.
    """

    value: float
    low: float
    high: float
    conditional: float
    share: float


@portable
class SampleRun(NamedTuple):
    """Samples number `first` to `first + count - 1`, and `sums` (4, 4) over those with a fix of the products of (east,
    north, up, 1), in m about the centre."""

    first: int
    count: int
    sums: np.ndarray

    @property
    def end(self) -> int:
        """Number of the sample after the last one."""
        return self.first + self.count


class Sampled(Record):
    """Accuracy of a fix from samples.

    `found` of `count` samples have a fix; `statuses` counts all of them by status. `mean_enu` in m and `cov_enu` in m2
    are those of the samples with a fix. `errors_enu` (count, 3) in m, NaN without a fix, and the status `codes`
    (count,) are set with `keep`. Errors are relative to `centre_enu`: the nominal fix (0, 0, 0), or the mean. `radii`
    holds the distances in m from the centre by figure, in the order of the samples' numbers; with `summary` it is
    empty, and `histograms` hold their counts. `runs` are the runs of samples that were drawn at a time.
    """

    fix: Fix
    count: int
    found: int
    statuses: dict[Status, int]
    mean_enu: np.ndarray
    cov_enu: np.ndarray
    centre_enu: np.ndarray
    radii: dict[str, np.ndarray]
    scrambles: int
    confidence: float
    errors_enu: np.ndarray | None = None
    codes: np.ndarray | None = None
    histograms: dict[str, RadiusHistogram] | None = None
    runs: tuple[SampleRun, ...] = ()
    origin: Origin | None = eqx.field(static=True, default=None)

    def __str__(self) -> str:
        """CE90, LE90 and SE90 with their confidence intervals, those of them that were asked for."""
        told = []
        for name in self.figures:
            value, low, high = self.interval(name, 0.9)
            told.append(f"{name}90 {figure(value, 4)} m ({figure(low, 4)} to {figure(high, 4)})")
        share = "all with a fix" if self.found == self.count else f"{self.found} of them with a fix"
        return f"{', '.join(told)}{', by ' if told else ''}{self.count} samples, {share}; {self.fix}"

    def circular_error(self, probability: float) -> Quantile:
        """Radius of the horizontal circle about the centre that contains this share of the samples."""
        return self.quantile("CE", probability)

    def linear_error(self, probability: float) -> Quantile:
        """Half-height of the vertical interval about the centre that contains this share of the samples."""
        return self.quantile("LE", probability)

    def spherical_error(self, probability: float) -> Quantile:
        """Radius of the sphere about the centre that contains this share of the samples."""
        return self.quantile("SE", probability)

    def share_within(self, figure: str, radius: float) -> Share:
        """Share of the samples, of all drawn, within a `radius` in m of one of the figures "CE", "LE" and "SE".

        Samples without a fix are within none, not even an infinite one. With its confidence interval: of independent
        draws Clopper and Pearson's, of Sobol points Student's over the scrambles. Raises `ValueError` for a figure that
        was not asked for, a negative radius, and samples whose radii were not kept (`summary`).
        """
        self._check_figure(figure)
        if not radius >= 0.0:
            raise ValueError(f"radius must be a length in m, 0 or more; got {radius!r}.")
        if self.histograms is not None:
            raise ValueError("the radii of these samples were not kept: sample again without summary.")
        places = np.flatnonzero((self.radii[figure] <= radius) & np.isfinite(self.radii[figure]))
        return share_of(places, self.count, self.confidence, scrambles=self.scrambles, scramble_of=self.scramble_of)

    @property
    def failed(self) -> float:
        """Share of the samples without a fix."""
        return 1.0 - self.found / self.count

    @property
    def figures(self) -> tuple[str, ...]:
        """The figures that were asked for."""
        return tuple(self.radii if self.histograms is None else self.histograms)

    @property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        """(first, end) of the unbroken ranges of sample numbers, the end not included; more than one after a merge of
        parts with gaps between them."""
        joined: list[tuple[int, int]] = []
        for run in self.runs:
            if joined and joined[-1][1] == run.first:
                joined[-1] = joined[-1][0], run.end
            else:
                joined.append((run.first, run.end))
        return tuple(joined)

    @property
    def numbers(self) -> np.ndarray:
        """The numbers of the samples (count,), in order."""
        return np.concatenate([np.arange(*each) for each in self.ranges or ((0, self.count),)])

    @property
    def scramble_of(self) -> np.ndarray | None:
        """Scramble of each sample (count,); None for independent draws."""
        return self.numbers % self.scrambles if self.scrambles else None

    def merge(self, *others: Sampled) -> Sampled:
        """The samples of this and other parts of one sampling, as if they had been drawn at once.

        Parts are drawn by `sample` with the same arguments, each with its own `first` and `count`. The result does not
        depend on the order or grouping of merges. Counts, statuses, radii and quantiles are those of the samples drawn
        at once; mean and covariance too, up to rounding. Parts may leave gaps (see `ranges`): any set of samples
        that is not chosen by their values estimates the same figures. A merge of radii and summaries is a summary;
        samples are kept if all parts keep them.

        Raises `TypeError` for other arguments than `Sampled`, and `ValueError` for parts that share samples, of another
        sampling (sensor, shot, pixel, terrain, errors, key, ...), or with other figures or another confidence.
        """
        return merged(self, others)

    def summarised(self) -> Sampled:
        """The same without single samples: counts in bins in place of radii, as drawn with `summary`."""
        if self.histograms is not None:
            return self
        how = max(self.scrambles, 1), self.scramble_of
        histograms = {figure: RadiusHistogram.of(radii, *how) for figure, radii in self.radii.items()}
        return dataclasses.replace(self, radii={}, histograms=histograms, errors_enu=None, codes=None)

    def without_rounding(self) -> Sampled:
        """The same with all errors zero, which are rounding: of an error model without errors."""
        runs = tuple(run._replace(sums=np.diag([0.0, 0.0, 0.0, run.sums[3, 3]])) for run in self.runs)
        _, mean, cov = moments_of(runs, np.zeros(3))
        histograms = self.histograms
        if histograms is not None:
            histograms = {figure: one.of_zeros() for figure, one in histograms.items()}
        return dataclasses.replace(
            self,
            mean_enu=mean,
            cov_enu=cov,
            centre_enu=np.zeros(3),
            radii={figure: np.where(np.isfinite(radii), 0.0, np.inf) for figure, radii in self.radii.items()},
            errors_enu=None if self.errors_enu is None else np.where(np.isnan(self.errors_enu), np.nan, 0.0),
            histograms=histograms,
            runs=runs,
        )

    def region(self, probability: float = 0.9, *, dem: Dem | None = None) -> Region:
        """Highest-density region: the smallest area on the ground that holds the truth with this probability.

        From a density of the kept samples on the cells of the DEM that they were drawn over (`probability_map`). The
        error of a fix over terrain is often no ellipse: it follows slopes, and has pieces on several hills. `modes` of
        the region are its pieces, with their shares and places, and `words` tells them. Samples without a fix count as
        outside, so that the probability is one of all samples; regions of larger probabilities contain smaller ones.
        Hyndman 1996, "Computing and graphing highest density regions".

        Of 20,000 samples a 90 % region holds 89.1 to 90.8 % of fresh ones. Raises `ValueError` for a probability
        outside (0, 1) or above the share of samples with a fix, for samples that were not kept (`keep=True`), for fewer
        than 100 samples with a fix, and for a region about a pole; `TypeError` for a `dem` that is none.
        """
        from jaxgeo.uncertainty.regions import checked_probability

        probability = checked_probability(probability)  # before the density is computed
        return self.probability_map(dem=dem).region(probability)

    def probability_map(self, *, dem: Dem | None = None) -> ProbabilityMap:
        """Probability of the truth in each cell on the ground; sums to the share of samples with a fix.

        Cells are those of the DEM's grid (`dem`, by default the terrain of the samples) or whole parts or multiples of
        them, fine enough for the cloud. Samples over other terrain, and those that were merged or pickled without a
        `dem`, use a level grid about the fix. Raises as `region`. `jaxgeo.io.write_probability_map` writes a GeoTIFF.
        """
        from jaxgeo.uncertainty import regions

        return regions.probability_map(self, dem=dem)

    def probability_within(self, polygon: Any) -> Share:
        """Probability that the truth lies within an area: the share of all samples in it, and its interval.

        `polygon` is a shapely Polygon or MultiPolygon, or a GeoJSON mapping of one, in deg of longitude and latitude on
        WGS 84. Samples without a fix are outside. Raises `TypeError` for other objects, `ValueError` for an invalid
        polygon, one in another order or unit, and for samples that were not kept.
        """
        from jaxgeo.uncertainty import regions

        return regions.probability_within(self, polygon)

    def _check_figure(self, figure: str) -> None:
        if figure not in self.figures:
            kept = ", ".join(self.figures) or "none"
            raise ValueError(f"{figure} was not asked for; figures: {kept}. Sample again with it.")

    def quantile(self, figure: str, probability: float) -> Quantile:
        """One of the figures "CE", "LE" and "SE" at a probability.

        Raises `ValueError` for a figure that was not asked for, or a probability outside (0, 1).
        """
        if not 0.0 < probability < 1.0:
            raise ValueError(
                f"probability must lie between 0 and 1, both excluded; got {probability!r}. Write 90 % as 0.9."
            )
        self._check_figure(figure)
        value, low, high = self.interval(figure, probability)
        conditional = value if self.found == self.count else self._quantile_of_found(figure, probability)
        return Quantile(float(value), float(low), float(high), float(conditional), self.found / self.count)

    def interval(self, figure: str, probability: float) -> Interval:
        """A figure and its confidence interval, for arguments that are known to be valid."""
        if self.histograms is not None:
            return self.histograms[figure].interval(probability, self.confidence)
        scramble_of = None if len(self.ranges) < 2 else self.scramble_of
        return interval_of_radii(self.radii[figure], probability, self.confidence, self.scrambles, scramble_of)

    def _quantile_of_found(self, figure: str, probability: float) -> float:
        """The figure of the samples with a fix; NaN if there are none."""
        if self.histograms is not None:
            return self.histograms[figure].quantile_of_found(probability)
        radii = self.radii[figure]
        known = radii[np.isfinite(radii)]
        return quantile_interval(known, probability)[0] if known.size else np.nan


def interval_of_radii(
    radii: np.ndarray, probability: float, confidence: float, scrambles: int, scramble_of: np.ndarray | None = None
) -> Interval:
    """Quantile and its confidence interval, from independent draws or from independent scrambles."""
    if not scrambles:
        return quantile_interval(radii, probability, confidence)
    return interval_of_scrambles(radii, probability, confidence, scrambles=scrambles, scramble_of=scramble_of)


def moments_of(runs: Sequence[SampleRun], centre: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """(number of samples with a fix, mean, covariance) of runs of samples, whatever their order."""
    each = np.array([run.sums for run in runs]).reshape(len(runs), 16)
    sums = np.array([math.fsum(column) for column in each.T]).reshape(4, 4)
    found = round(float(sums[3, 3]))
    mean = sums[:3, 3] / found if found else np.full(3, np.nan)
    if found < 2:
        return found, mean + centre, np.full((3, 3), np.nan)
    return found, mean + centre, (sums[:3, :3] - found * np.outer(mean, mean)) / (found - 1)


def merged(first: Sampled, others: Sequence[Any]) -> Sampled:
    """`Sampled.merge`."""
    every = [first, *others]
    for number, part in enumerate(every):
        if not isinstance(part, Sampled):
            raise TypeError(f"merge takes Sampled parts, as merge(second, third); got {type(part).__name__}.")
        if number:
            _check_same(number, first, part)
    if not others:
        return first
    if any(part.histograms is not None for part in every):
        every = [part.summarised() for part in every]
    runs = sorted((run for part in every for run in part.runs), key=lambda run: run.first)
    _check_apart(runs)
    order = _order(every)
    found, mean, cov = moments_of(runs, first.centre_enu)
    keeps = all(part.errors_enu is not None and part.codes is not None for part in every)
    histograms = None
    if every[0].histograms is not None:
        histograms = {
            figure: one.merge([part.histograms[figure] for part in every[1:] if part.histograms is not None])
            for figure, one in every[0].histograms.items()
        }
    return Sampled(
        fix=first.fix,
        count=sum(run.count for run in runs),
        found=found,
        statuses=_added([part.statuses for part in every]),
        mean_enu=mean,
        cov_enu=cov,
        centre_enu=first.centre_enu,
        radii={figure: order(lambda part, figure=figure: part.radii[figure]) for figure in every[0].radii},
        scrambles=first.scrambles,
        confidence=first.confidence,
        errors_enu=order(lambda part: part.errors_enu) if keeps else None,
        codes=order(lambda part: part.codes) if keeps else None,
        histograms=histograms,
        runs=tuple(runs),
        origin=first.origin,
    )


def _order(parts: Sequence[Sampled]) -> Callable[[Callable[[Sampled], Any]], np.ndarray]:
    """A function that puts one array of all parts (by sample) in the order of the samples' numbers."""
    pieces = []
    for part in parts:
        start = 0
        for run in part.runs:
            pieces.append((run.first, part, slice(start, start + run.count)))
            start += run.count
    pieces.sort(key=lambda piece: piece[0])
    return lambda array_of: np.concatenate([array_of(part)[place] for _, part, place in pieces])


def _added(statuses: Sequence[Mapping[Status, int]]) -> dict[Status, int]:
    """Counts by status of all parts together."""
    return {code: total for code in Status if (total := sum(each.get(code, 0) for each in statuses))}


def _check_same(number: int, first: Sampled, part: Sampled) -> None:
    """Raise `ValueError` unless a part is of the same sampling as the first one."""
    if first.origin is None or part.origin is None or not first.runs or not part.runs:
        raise ValueError(
            f"part {0 if first.origin is None else number} cannot be merged: it does not come from sample(...), and "
            "what was sampled is not known. Parts are samples of sample(..., first=..., count=...)."
        )
    others = first.origin.differences(part.origin)
    if others:
        raise ValueError(
            f"part {number} is no part of the same sampling as part 0: {', '.join(others)} differ. Draw parts with the "
            "same arguments, except for first and count."
        )
    for name, ours, theirs in (
        ("figures", sorted(first.figures), sorted(part.figures)),
        ("confidence", first.confidence, part.confidence),
    ):
        if ours != theirs:
            raise ValueError(
                f"part {number} has other {name} than part 0: {theirs} and {ours}. Draw parts with the same ones."
            )


def _check_apart(runs: Sequence[SampleRun]) -> None:
    """Raise `ValueError` if two runs, in order, share samples."""
    for run, following in itertools.pairwise(runs):
        if following.first < run.end:
            last = min(run.end, following.end) - 1
            which = f"samples {following.first} to {last} are" if last > following.first else f"sample {last} is"
            raise ValueError(f"{which} in two parts, and would count twice. Give each part a first of its own.")
