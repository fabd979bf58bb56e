"""Sections 3 and 4 and Table 4: comparison of the searches over many terrains, and settings that would give the print.

The paper publishes neither its tiles nor K and M of the segmented search, the size of the target area, or what its
"time" includes. Terrains are synthetic (see `make_scene`), at the depressions of Table 2, and redrawn with every seed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap

from jaxgeo.studies.scenes import Scene, make_scene
from jaxgeo.studies.terrain_searches import PRINTED_MS, Found, Over, outcomes_of_ranges
from jaxgeo.terrain import (
    AbstractSearch,
    AbstractStudiedSearch,
    ExhaustiveFirst,
    ExhaustiveNearest,
    FastIteration,
    FirstHit,
    ImprovedLiteral,
    ImprovedSecant,
    Outcome,
    Photogrammetric,
    Segmented,
    TargetArea,
    WholeTerrain,
)

TERRAINS = 10
RAYS = 500
TUNED = 3  # terrains of each kind used to test settings
SIZE = 601  # posts per side
RESAMPLES = 2000
EPS = 0.2  # m, section 5.2
GIVES_PRINT = 1.10  # a setting reproduces the printed table within this factor of every printed ratio

SEARCHES: dict[str, AbstractSearch] = {
    "exhaustive": ExhaustiveFirst(),
    "photogrammetric": Photogrammetric(),
    "improved": ImprovedSecant(),
    "segmented": Segmented(),
    "fast": FastIteration(),
    "first hit": FirstHit(),
}
IN_PRINT = ("exhaustive", "improved", "segmented", "fast")  # the columns of Table 4
FREE_MOUNTAIN = "nearest of all, mountain alone"
FREE = "nearest of all"
FREE_AND_CONSTANT = "nearest of all, with a constant"
SINGLE = "nearest single rays"
SINGLE_AND_CONSTANT = "nearest single rays, with a constant"
OTHER_SLOPE = (Outcome.farther_hit, Outcome.nearer_hit)
NOT_CONVERGED = (Outcome.cycled, Outcome.diverged, Outcome.failed)


class Kind(NamedTuple):
    """A kind of terrain: rms slope and depression in deg, spectral exponent, post spacing in m."""

    slope: float
    depression: float
    exponent: float = 3.39
    spacing: float = 30.0


KINDS = {"plain": Kind(1.0, 15.3), "hill": Kind(8.0, 14.6), "mountain": Kind(22.0, 11.2)}
MOUNTAINS = {
    "rms slope 15°": KINDS["mountain"]._replace(slope=15.0),
    "rms slope 30°": KINDS["mountain"]._replace(slope=30.0),
    "rms slope 40°": KINDS["mountain"]._replace(slope=40.0),
    "depression 8°": KINDS["mountain"]._replace(depression=8.0),
    "depression 15°": KINDS["mountain"]._replace(depression=15.0),
    "spectrum f^-3 (rougher near by)": KINDS["mountain"]._replace(exponent=3.0),
    "spectrum f^-4 (smoother near by)": KINDS["mountain"]._replace(exponent=4.0),
    "posts 15 m apart": KINDS["mountain"]._replace(spacing=15.0),
    "posts 60 m apart": KINDS["mountain"]._replace(spacing=60.0),
}
EPSILONS = (0.2, 0.5, 1.0, 2.0)  # m; 2 m is a tenth of the DEM's 20 m
CONSTANTS = (0.0, 1.0, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, 200.0)  # evaluations
STEPS = (3, 4, 5, 6, 8)  # K
SEGMENTS = (4, 10, 16, 32)  # M
LIMITS = (20, 100, 400, 1000)  # iteration limits of the improved search


@dataclass(frozen=True)
class Trial:
    """One search over the rays of one terrain of a kind, drawn from `seed`."""

    kind: str
    seed: int
    search: str
    found: Found

    def share(self, *outcomes: Outcome) -> float:
        """The share of rays with one of these outcomes."""
        return float(np.isin(self.found.outcomes, [one.value for one in outcomes]).mean())


class Interval(NamedTuple):
    """A value and its 95 % interval over terrains, from `low` to `high`."""

    value: float
    low: float
    high: float
    error: float


@dataclass(frozen=True)
class Choice:
    """A setting of what the paper leaves open, and its result: by kind, the costs of exhaustive, improved, segmented
    and fast search in one unit."""

    group: str
    name: str
    costs: dict[str, tuple[float, ...]]

    def ratios(self, kind: str) -> tuple[float, ...]:
        """Costs of exhaustive, improved and segmented search divided by those of the fast one."""
        *others, fast = self.costs[kind]
        return tuple(cost / fast for cost in others)

    def farthest(self, kinds: Iterable[str] | None = None) -> float:
        """Largest factor between a ratio and the printed one, over these kinds or all available ones."""
        return max(float(_off(self.ratios(kind), kind).max()) for kind in (self.costs if kinds is None else kinds))

    def distance(self, kinds: Iterable[str] | None = None) -> float:
        """RMS factor between ratios and printed ones: the exponential of the RMS of the logarithms."""
        logs = [np.log(_off(self.ratios(kind), kind)) for kind in (self.costs if kinds is None else kinds)]
        return float(np.exp(np.sqrt(np.mean(np.square(logs)))))

    def gives_print(self, kinds: Iterable[str] | None = None) -> bool:
        """Whether every ratio of these kinds is within `GIVES_PRINT` of the printed one."""
        return self.farthest(kinds) <= GIVES_PRINT

    def distance_of_times(self) -> float:
        """The same for all printed times after the best common factor, so terrains are compared with each other too."""
        logs = [np.log(np.array(costs) / printed_times(kind)) for kind, costs in self.costs.items()]
        return float(np.exp(np.std(np.concatenate(logs))))


def _off(ratios: Sequence[float], kind: str) -> np.ndarray:
    return np.exp(np.abs(np.log(np.array(ratios) / printed_ratios(kind))))


def printed_ratios(kind: str) -> tuple[float, ...]:
    """Times of Table 4 of exhaustive, improved and segmented search divided by those of the fast one."""
    *others, fast = printed_times(kind)
    return tuple(ms / fast for ms in others)


def printed_times(kind: str) -> tuple[float, ...]:
    """Times of Table 4 in ms of exhaustive, improved, segmented and fast search."""
    return tuple(float(PRINTED_MS[kind][name]) for name in IN_PRINT)


@dataclass(frozen=True)
class Comparison:
    """All results of the searches: trials, mean savings by K and M on mountains, and the tested settings."""

    trials: list[Trial]
    segmented: dict[tuple[int, int], Interval]
    choices: list[Choice]
    rays: int

    def of(self, kind: str, search: str) -> list[Trial]:
        """The trials of a search on a kind of terrain, one for each terrain."""
        return [one for one in self.trials if (one.kind, one.search) == (kind, search)]

    def evaluations(self, kind: str, search: str) -> np.ndarray:
        """Evaluations of all rays of all terrains."""
        return np.concatenate([one.found.evaluations for one in self.of(kind, search)])

    def us_per_ray(self, kind: str, search: str) -> float:
        """Median over terrains of the time in us per ray of a compiled batch."""
        return float(np.median([one.found.us_per_ray for one in self.of(kind, search)]))

    def share(self, kind: str, search: str, *outcomes: Outcome) -> Interval:
        """The share of rays with one of these outcomes."""
        return interval(np.mean, [one.share(*outcomes) for one in self.of(kind, search)])

    def ratio(self, kind: str, search: str, by: Callable[[np.ndarray], float] = np.mean) -> Interval:
        """Evaluations of a search divided by those of the fast one, by their means or another statistic over a
        terrain's rays; the interval is that of the ratio of the means over terrains."""
        return interval(_quotient, *(self._by_terrain(kind, name, by) for name in (search, "fast")))

    def saving(self, kind: str, by: Callable[[np.ndarray], float] = np.mean) -> Interval:
        """Share of the segmented search's evaluations that the fast one saves."""
        return interval(_saving, *(self._by_terrain(kind, name, by) for name in ("segmented", "fast")))

    def tail(self, kind: str, steps: int = 6) -> tuple[float, float]:
        """For the segmented search: the share of rays not settled after K steps, and their share of the evaluations."""
        evaluations = self.evaluations(kind, "segmented")
        is_beyond = evaluations > 1 + 2 * steps
        return float(is_beyond.mean()), float(evaluations[is_beyond].sum() / evaluations.sum())

    def single_savings(self, kind: str) -> np.ndarray:
        """Share of evaluations that the fast search saves against the segmented one, for every single ray."""
        segmented, fast = (self.evaluations(kind, name) for name in ("segmented", "fast"))
        return 1.0 - fast / segmented

    def nearest(self, group: str) -> Choice:
        """The setting of a group closest to the printed ratios, among those tested on every kind of terrain."""
        of_all = [one for one in self.choices if one.group == group and len(one.costs) == len(KINDS)]
        return min(of_all, key=Choice.distance)

    def _by_terrain(self, kind: str, search: str, by: Callable[[np.ndarray], float]) -> list[float]:
        return [float(by(one.found.evaluations)) for one in self.of(kind, search)]


def interval(statistic: Callable[..., np.ndarray | np.floating], *values: Sequence[float]) -> Interval:
    """A statistic of one value per terrain, or of several paired ones, with the percentile bootstrap over terrains."""
    data = [np.asarray(one) for one in values]
    drawn = bootstrap(
        data,
        statistic,
        n_resamples=RESAMPLES,
        paired=len(data) > 1,
        vectorized=True,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    low, high = drawn.confidence_interval
    return Interval(float(statistic(*data, axis=-1)), float(low), float(high), float(drawn.standard_error))


def _quotient(above: np.ndarray, below: np.ndarray, axis: int = -1) -> np.ndarray | np.floating:
    return np.mean(above, axis=axis) / np.mean(below, axis=axis)


def _saving(segmented: np.ndarray, fast: np.ndarray, axis: int = -1) -> np.ndarray | np.floating:
    return 1.0 - _quotient(fast, segmented, axis=axis)


def compare_searches(*, terrains: int = TERRAINS, rays: int = RAYS, seed: int = 0, size: int = SIZE) -> Comparison:
    """Run all searches over `terrains` terrains of each kind with `rays` rays each; settings are tested on the first
    few.

    The exhaustive search runs on every fourth ray of those. Raises `ValueError` for fewer than two terrains, which give
    no interval, and for fewer than eight rays.
    """
    for name, number, least in (("terrains", terrains, 2), ("rays", rays, 8)):
        if number < least:
            raise ValueError(f"{name} must be at least {least}; got {number}.")
    seeds = [int(x) for x in np.random.default_rng(seed).integers(2**31, size=terrains)]
    few = rays // 4
    over = {kind: [Over.of(_scene(kind, what, one, rays, size)) for one in seeds] for kind, what in KINDS.items()}
    trials = []
    for kind, begun in over.items():
        for one, drawn in zip(seeds, begun, strict=True):
            found = {
                name: (drawn.fewer(few) if name == "exhaustive" else drawn).find(search, repeats=1)
                for name, search in SEARCHES.items()
            }
            # The first hit is the reference, so it is itself checked against the exhaustive search.
            exhaustive, first = found["exhaustive"], found["first hit"]
            there = np.where(exhaustive.outcomes >= Outcome.cycled, np.nan, exhaustive.distance)
            codes = outcomes_of_ranges(first.distance[:few], there)
            found["first hit"] = replace(first, outcomes=codes)
            trials += [Trial(kind, one, name, what) for name, what in found.items()]
    segmented = _savings_by_segments(over["mountain"])
    tried = {kind: [one.fewer(few) for one in begun[:TUNED]] for kind, begun in over.items()}
    choices = [*choices_of_methods(tried), *choices_of_terrain(seeds[:TUNED], rays, size)]
    return Comparison(trials, segmented, choices, rays)


def _scene(name: str, kind: Kind, seed: int, rays: int, size: int) -> Scene:
    return make_scene(
        name,
        rms_slope=math.radians(kind.slope),
        depression=math.radians(kind.depression),
        rays=rays,
        size=size,
        spacing=kind.spacing,
        exponent=kind.exponent,
        seed=seed,
    )


def _savings_by_segments(over: Sequence[Over]) -> dict[tuple[int, int], Interval]:
    """Mean saving of the fast search against the segmented one, by K and M."""
    fast = [float(one.find(FastIteration()).evaluations.mean()) for one in over]

    def saving(steps: int, segments: int) -> Interval:
        search = Segmented(steps=steps, segments=segments)
        return interval(_saving, [float(one.find(search).evaluations.mean()) for one in over], fast)

    return {(steps, segments): saving(steps, segments) for steps in STEPS for segments in SEGMENTS}


def variants() -> dict[str, dict[str, AbstractStudiedSearch]]:
    """The settings of each search of Table 4 at one eps in m, by column and by setting."""
    return {
        "exhaustive": {
            "heights of the whole terrain down to the ground": ExhaustiveFirst(),
            "heights of the target's area down to the ground": ExhaustiveFirst(window=TargetArea()),
            "all heights of the target's area": ExhaustiveNearest(window=TargetArea()),
        },
        "improved": {
            **{f"secant, at most {limit} steps": ImprovedSecant(limit=limit) for limit in LIMITS},
            **{
                f"as printed, {posts} posts outward at most": ImprovedLiteral(outward=posts)
                for posts in (1, 5, 20, 200)
            },
        },
        "segmented": {f"K = {k}, M = {m}": Segmented(steps=k, segments=m) for k in STEPS for m in SEGMENTS},
        "fast": {
            "Zmax of the target's area": FastIteration(),
            "Zmax of the whole terrain": FastIteration(window=WholeTerrain()),
            "Zmax within 1 km": FastIteration(window=TargetArea(half=33)),
        },
    }


def _at(search: AbstractStudiedSearch, eps: float) -> AbstractStudiedSearch:
    """The search with another tolerance, an exhaustive one also with another step, in m."""
    names = [name for name in ("eps", "step") if hasattr(search, name)]
    return replace(search, **dict.fromkeys(names, eps))


STATISTICS: dict[str, Callable[[np.ndarray], float]] = {"mean": np.mean, "median": np.median, "maximum": np.max}


Asked = dict[str, np.ndarray]  # by column of Table 4: evaluations (variants, rays)


def choices_of_methods(over: Mapping[str, Sequence[Over]]) -> list[Choice]:
    """Settings of the methods: each alone with the others standard, and the combinations closest to the print, by
    evaluations over many rays, with a constant added to every time, and with one single ray of each terrain."""
    names = {method: list(tried) for method, tried in variants().items()}
    standard = {method: tried[0] for method, tried in names.items()}
    standard |= {"improved": "secant, at most 100 steps", "segmented": "K = 6, M = 16"}
    asked = {eps: {kind: _ask(begun, eps) for kind, begun in over.items()} for eps in EPSILONS}

    def choice(group: str, name: str, chosen: dict[str, str], eps: float = EPS, statistic: str = "mean") -> Choice:
        of, rows = STATISTICS[statistic], [(method, names[method].index(chosen[method])) for method in IN_PRINT]
        costs = {kind: tuple(float(of(found[method][i])) for method, i in rows) for kind, found in asked[eps].items()}
        return Choice(group, name, costs)

    return [
        choice("standard", "mean of evaluations, eps 0.2 m", standard),
        *(choice("counted", f"{name} of evaluations", standard, EPS, name) for name in list(STATISTICS)[1:]),
        *(choice("eps", f"{eps} m", standard, eps) for eps in EPSILONS[1:]),
        *(
            choice(method, name, standard | {method: name})
            for method, tried in names.items()
            for name in tried
            if name != standard[method]
        ),
        *_nearest_of_all(asked, names),
    ]


def _ask(over: Sequence[Over], eps: float) -> Asked:
    """Evaluations of every variant of every search of Table 4 for the rays of the terrains, concatenated."""
    return {
        method: np.stack(
            [
                np.concatenate([one.find(_at(search, eps)).evaluations for one in over]).astype(float)
                for search in tried.values()
            ]
        )
        for method, tried in variants().items()
    }


def _nearest_of_all(asked: dict[float, dict[str, Asked]], names: dict[str, list[str]]) -> list[Choice]:
    """The combinations closest to the printed ratios: by means or medians of many rays and by single rays, without
    and with a constant added to all times."""
    choices = []
    none = CONSTANTS[:1]
    for group, kinds, constants, is_single in (
        (FREE_MOUNTAIN, ["mountain"], none, False),
        (FREE, list(KINDS), none, False),
        (FREE_AND_CONSTANT, list(KINDS), CONSTANTS, False),
        (SINGLE, list(KINDS), none, True),
        (SINGLE_AND_CONSTANT, list(KINDS), CONSTANTS, True),
    ):
        found = []
        statistics = ["of one ray"] if is_single else ["mean", "median"]
        for eps, constant, statistic in itertools.product(asked, constants, statistics):
            costs = {kind: _costs(asked[eps][kind], constant, None if is_single else statistic) for kind in KINDS}
            distance, chosen, rays = _nearest({kind: costs[kind] for kind in kinds})
            of = {kind: tuple(float(costs[kind][m][chosen[m], rays.get(kind, 0)]) for m in IN_PRINT) for kind in KINDS}
            text = "; ".join(f"{method}: {names[method][i]}" for method, i in chosen.items())
            held = f"a constant worth {constant:.0f} evaluations, " if constant else ""
            found.append((distance, Choice(group, f"{held}{statistic}, eps {eps} m; {text}", of)))
        choices.append(min(found, key=lambda one: one[0])[1])
    return choices


def _costs(asked: Asked, constant: float, statistic: str | None) -> Asked:
    """Evaluations plus a constant, for every ray, or a statistic of all rays as if for one."""
    if statistic is None:
        return {method: found + constant for method, found in asked.items()}
    of = STATISTICS[statistic]
    return {method: np.array([[of(x)] for x in found]) + constant for method, found in asked.items()}


def _nearest(costs: dict[str, Asked]) -> tuple[float, dict[str, int], dict[str, int]]:
    """The variants of every search, the same for all kinds, and the ray of each kind, whose ratios are closest to
    the print: the sum of the squared logarithms, the variants, the rays."""
    found = []
    logs = {kind: {method: np.log(x) for method, x in of.items()} for kind, of in costs.items()}
    for fast in range(len(next(iter(costs.values()))["fast"])):
        off = {}
        for kind, of in logs.items():
            apart = [
                np.square(of[method] - of["fast"][fast] - math.log(ratio))
                for method, ratio in zip(IN_PRINT, printed_ratios(kind), strict=False)
            ]
            off[kind] = apart[0][:, None, None] + apart[1][None, :, None] + apart[2][None, None, :]
        total = np.sum([x.min(axis=-1) for x in off.values()], axis=0)
        at = tuple(int(i) for i in np.unravel_index(total.argmin(), total.shape))
        rays = {kind: int(x[at].argmin()) for kind, x in off.items()}
        found.append((float(total[at]), dict(zip(IN_PRINT, (*at, fast), strict=True)), rays))
    return min(found, key=lambda one: one[0])


def choices_of_terrain(seeds: Sequence[int], rays: int, size: int) -> list[Choice]:
    """Other mountains with unchanged methods: costs in mean evaluations."""
    choices = []
    for name, kind in MOUNTAINS.items():
        over = [Over.of(_scene(name, kind, seed, rays, size)).fewer(rays // 4) for seed in seeds]
        asked = [np.concatenate([one.find(SEARCHES[method]).evaluations for one in over]) for method in IN_PRINT]
        choices.append(Choice("terrain", name, {"mountain": tuple(float(x.mean()) for x in asked)}))
    return choices
