"""Section 3, section 4 and Table 4: the searches side by side over many terrains, and what would give the printed table.

The tiles of the paper were never published, nor K and M of the segmented search, the size of the target's area, or what
a "time" holds. Terrains are made up (see `make_scene`), at the depressions of Table 2, and redrawn with every seed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap

from jaxgeo.studies.scenes import Scene, make_scene
from jaxgeo.studies.terrain_searches import PRINTED_MS, SAME_CROSSING, Found, Over, outcomes_of_ranges
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
TUNED = 3  # terrains of each kind on which choices are tried
SIZE = 601  # posts to a side
RESAMPLES = 2000
EPS = 0.2  # m, section 5.2
GIVES_PRINT = 1.10  # within this factor of every printed ratio, a choice gives the printed table

SEARCHES: dict[str, AbstractSearch] = {
    "exhaustive": ExhaustiveFirst(),
    "photogrammetric": Photogrammetric(),
    "improved": ImprovedSecant(),
    "segmented": Segmented(),
    "fast": FastIteration(),
    "first hit": FirstHit(),
}
IN_PRINT = ("exhaustive", "improved", "segmented", "fast")  # the columns of Table 4
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
STEPS = (3, 4, 5, 6, 8)  # K
SEGMENTS = (4, 10, 16, 32)  # M
LIMITS = (20, 100, 400, 1000)  # of the improved search


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
    """A number and, between `low` and `high`, its 95 % interval over terrains."""

    value: float
    low: float
    high: float
    error: float


@dataclass(frozen=True)
class Choice:
    """A choice of what the paper leaves open, and what it gives: by kind, the costs of exhaustive, improved, segmented
    and fast search in one unit."""

    group: str
    name: str
    costs: dict[str, tuple[float, ...]]

    def ratios(self, kind: str) -> tuple[float, ...]:
        """Costs of exhaustive, improved and segmented search over those of the fast one."""
        *others, fast = self.costs[kind]
        return tuple(cost / fast for cost in others)

    def farthest(self, kinds: Iterable[str] | None = None) -> float:
        """The greatest factor between a ratio and the printed one, over these kinds or all that there are."""
        return max(_off(self.ratios(kind), kind).max() for kind in (self.costs if kinds is None else kinds))

    def distance(self, kinds: Iterable[str] | None = None) -> float:
        """The factor between ratios and printed ones: the exponential of the rms of the logarithms."""
        logs = [np.log(_off(self.ratios(kind), kind)) for kind in (self.costs if kinds is None else kinds)]
        return float(np.exp(np.sqrt(np.mean(np.square(logs)))))


def _off(ratios: Sequence[float], kind: str) -> np.ndarray:
    return np.exp(np.abs(np.log(np.array(ratios) / printed_ratios(kind))))


def printed_ratios(kind: str) -> tuple[float, ...]:
    """Times of Table 4 of exhaustive, improved and segmented search over those of the fast one."""
    *others, fast = (PRINTED_MS[kind][name] for name in IN_PRINT)
    return tuple(ms / fast for ms in others)


@dataclass(frozen=True)
class Comparison:
    """All that is found about the searches: trials, the first hits' agreement with the exhaustive search, mean savings
    by K and M on mountains, and the choices tried."""

    trials: list[Trial]
    agreement: dict[str, Interval]
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
        """The median over terrains of the time in us per ray of a compiled batch."""
        return float(np.median([one.found.us_per_ray for one in self.of(kind, search)]))

    def share(self, kind: str, search: str, *outcomes: Outcome) -> Interval:
        """The share of rays with one of these outcomes."""
        return interval(np.mean, [one.share(*outcomes) for one in self.of(kind, search)])

    def ratio(self, kind: str, search: str, by: Callable[[np.ndarray], float] = np.mean) -> Interval:
        """Evaluations of a search over those of the fast one, of their means or another statistic of a terrain's rays;
        the interval is of the ratio of the means over terrains."""
        return interval(_quotient, *(self._by_terrain(kind, name, by) for name in (search, "fast")))

    def saving(self, kind: str, by: Callable[[np.ndarray], float] = np.mean) -> Interval:
        """What share of the evaluations of the segmented search the fast one saves."""
        return interval(_saving, *(self._by_terrain(kind, name, by) for name in ("segmented", "fast")))

    def tail(self, kind: str, steps: int = 6) -> tuple[float, float]:
        """Of the segmented search: the share of rays that K steps do not settle, and their share of evaluations."""
        evaluations = self.evaluations(kind, "segmented")
        is_beyond = evaluations > 1 + 2 * steps
        return float(is_beyond.mean()), float(evaluations[is_beyond].sum() / evaluations.sum())

    @property
    def best(self) -> Choice:
        """Of all choices that were tried on every kind of terrain, the one nearest to the print."""
        return min((one for one in self.choices if len(one.costs) == len(KINDS)), key=Choice.distance)

    def _by_terrain(self, kind: str, search: str, by: Callable[[np.ndarray], float]) -> list[float]:
        return [float(by(one.found.evaluations)) for one in self.of(kind, search)]


def interval(statistic: Callable[..., np.ndarray], *values: Sequence[float]) -> Interval:
    """A statistic of one value for each terrain, or several in pairs, with the percentile bootstrap over terrains."""
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


def _quotient(above: np.ndarray, below: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.mean(above, axis=axis) / np.mean(below, axis=axis)


def _saving(segmented: np.ndarray, fast: np.ndarray, axis: int = -1) -> np.ndarray:
    return 1.0 - _quotient(fast, segmented, axis=axis)


def compare_searches(*, terrains: int = TERRAINS, rays: int = RAYS, seed: int = 0, size: int = SIZE) -> Comparison:
    """All searches over so many terrains of each kind with so many rays each; choices are tried on the first few.

    The exhaustive search runs on every fourth ray of them. Raises `ValueError` for fewer than two terrains, which give
    no interval, and for fewer than eight rays.
    """
    for name, number, least in (("terrains", terrains, 2), ("rays", rays, 8)):
        if number < least:
            raise ValueError(f"{name} must be at least {least}; got {number}.")
    seeds = [int(x) for x in np.random.default_rng(seed).integers(2**31, size=terrains)]
    few = rays // 4
    over = {kind: [Over.of(_scene(kind, what, one, rays, size)) for one in seeds] for kind, what in KINDS.items()}
    trials, agreement = [], {}
    for kind, begun in over.items():
        agrees = []
        for one, drawn in zip(seeds, begun, strict=True):
            found = {
                name: (drawn.fewer(few) if name == "exhaustive" else drawn).find(search, repeats=1)
                for name, search in SEARCHES.items()
            }
            # Beside itself the first hit is always right: it is held against the exhaustive search.
            tried = np.where(found["exhaustive"].outcomes >= Outcome.cycled, np.nan, found["exhaustive"].distance)
            first = found["first hit"]
            codes = outcomes_of_ranges(first.distance[:few], tried)
            found["first hit"] = replace(first, outcomes=codes)
            agrees.append(float(np.mean(codes == Outcome.first_hit)))
            trials += [Trial(kind, one, name, what) for name, what in found.items()]
        agreement[kind] = interval(np.mean, agrees)
    segmented = _savings_by_segments(over["mountain"])
    tried = {kind: begun[:TUNED] for kind, begun in over.items()}
    choices = [*choices_of_methods(tried, few), *choices_of_terrain(seeds[:TUNED], rays, size)]
    return Comparison(trials, agreement, segmented, choices, rays)


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
    """The fast search's mean saving against the segmented one, by K and M."""
    fast = [float(one.find(FastIteration()).evaluations.mean()) for one in over]

    def saving(steps: int, segments: int) -> Interval:
        search = Segmented(steps=steps, segments=segments)
        return interval(_saving, [float(one.find(search).evaluations.mean()) for one in over], fast)

    return {(steps, segments): saving(steps, segments) for steps in STEPS for segments in SEGMENTS}


def variants() -> dict[str, dict[str, AbstractStudiedSearch]]:
    """The choices of each search of Table 4 at one eps in m, by column and by what is chosen."""
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


def choices_of_methods(over: dict[str, Sequence[Over]], few: int) -> list[Choice]:
    """The choices of the methods: each alone beside the standard ones, and the best of all of them together.

    Costs are evaluations; `few` rays of each terrain stand for all where the exhaustive search runs.
    """
    asked: dict[tuple[float, str, str], dict[str, np.ndarray]] = {}
    fewer = {kind: [one.fewer(few) for one in begun] for kind, begun in over.items()}
    for eps, (method, tried) in itertools.product(EPSILONS, variants().items()):
        # Heights are most of the exhaustive search's time, and few rays say how many they are.
        on = fewer if method == "exhaustive" or eps != EPS else over
        for name, search in tried.items():
            asked[eps, method, name] = {
                kind: np.concatenate([one.find(_at(search, eps)).evaluations for one in begun])
                for kind, begun in on.items()
            }
    standard = {method: next(iter(tried)) for method, tried in variants().items()}
    standard |= {"improved": "secant, at most 100 steps", "segmented": "K = 6, M = 16"}

    def choice(group: str, name: str, chosen: dict[str, str], eps: float = EPS, statistic: str = "mean") -> Choice:
        of = STATISTICS[statistic]
        costs = {
            kind: tuple(float(of(asked[eps, method, chosen[method]][kind])) for method in IN_PRINT) for kind in over
        }
        return Choice(group, name, costs)

    choices = [choice("as in the searches' sheet", "mean evaluations, eps 0.2 m", standard)]
    choices += [choice("counted", f"{name} of a ray's evaluations", standard, EPS, name) for name in STATISTICS][1:]
    choices += [choice("eps", f"{eps} m", standard, eps) for eps in EPSILONS[1:]]
    choices += [
        choice(method, name, standard | {method: name})
        for method, tried in variants().items()
        for name in tried
        if name != standard[method]
    ]
    combined = [
        (dict(zip(variants(), names, strict=True)), eps, statistic)
        for names in itertools.product(*variants().values())
        for eps in EPSILONS
        for statistic in ("mean", "median")
    ]
    made = [(choice("", "", *one), one) for one in combined]
    for group, kinds in (("best of all on mountains", ("mountain",)), ("best of all on the three", tuple(over))):
        best, (chosen, eps, statistic) = min(made, key=lambda one: one[0].distance(kinds))
        text = "; ".join(f"{method}: {name}" for method, name in chosen.items())
        choices.append(replace(best, group=group, name=f"{statistic}, eps {eps} m; {text}"))
    choices.append(_with_overhead(made))
    return choices


def _with_overhead(made: list[tuple[Choice, tuple[dict[str, str], float, str]]]) -> Choice:
    """The choice nearest to the print if each time also holds a constant that no search has a part in."""
    constants = np.concatenate([[0.0], np.geomspace(1.0, 3000.0, 40)])

    def added(choice: Choice, constant: float) -> Choice:
        return replace(choice, costs={kind: tuple(x + constant for x in xs) for kind, xs in choice.costs.items()})

    kinds = list(made[0][0].costs)
    printed = np.log([printed_ratios(kind) for kind in kinds])
    costs = np.array([[choice.costs[kind] for kind in kinds] for choice, _ in made])  # (choices, kinds, searches)
    whole = costs[None] + constants[:, None, None, None]
    off = np.square(np.log(whole[..., :3] / whole[..., 3:]) - printed).mean(axis=(-1, -2))
    i, j = np.unravel_index(off.argmin(), off.shape)
    choice, (chosen, eps, statistic) = made[j]
    text = "; ".join(f"{method}: {name}" for method, name in chosen.items())
    name = f"a constant worth {constants[i]:.0f} evaluations; {statistic}, eps {eps} m; {text}"
    return replace(added(choice, float(constants[i])), group="best of all on the three", name=name)


def choices_of_terrain(seeds: Sequence[int], rays: int, size: int) -> list[Choice]:
    """Other mountains, the methods left as they are: costs in mean evaluations."""
    choices = []
    for name, kind in MOUNTAINS.items():
        over = [Over.of(_scene(name, kind, seed, rays, size)).fewer(rays // 4) for seed in seeds]
        asked = [np.concatenate([one.find(SEARCHES[method]).evaluations for one in over]) for method in IN_PRINT]
        choices.append(Choice("terrain", name, {"mountain": tuple(float(x.mean()) for x in asked)}))
    return choices


def is_crossing(distance: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Whether ranges in m are of the same crossing."""
    return np.abs(distance - first) <= SAME_CROSSING
