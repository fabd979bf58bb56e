"""Comparison of published terrain searches: results, terrain evaluations, and run times.

The terrains are synthetic, with a given RMS slope, at the depressions of Table 2 of Li et al. (2023), "A target
location method for aerial images through fast iteration of elevation based on DEM"; its tiles are not published.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxgeo._compile import batch_filter_jit, batch_options
from jaxgeo._numerics import tree_where
from jaxgeo.earth.ray import Ray
from jaxgeo.status import Status
from jaxgeo.studies.look_ups import first_hit_look_ups
from jaxgeo.studies.scenes import Scene, make_scene
from jaxgeo.terrain import (
    AbstractSearch,
    AbstractStudiedSearch,
    Bisection,
    Dem,
    ExhaustiveFirst,
    ExhaustiveNearest,
    FastIteration,
    FirstHit,
    ImprovedLiteral,
    ImprovedSecant,
    Outcome,
    Photogrammetric,
    Run,
    Segmented,
    WholeTerrain,
    outcome_of,
)
from jaxgeo.terrain.polish import polish
from jaxgeo.terrain.search.literature.bisection import SHORTEST
from jaxgeo.terrain.search.literature.studied import Approach, approach
from jaxgeo.terrain.search.reach import reach_of

FIRST_HIT = FirstHit()
SAME_CROSSING = 30.0  # m of range, one post spacing: points closer together are the same crossing
# Loops over thousands of heights take four times as long in an unoptimised program, as commands compile others.
OPTIMISED = {"xla_backend_optimization_level": 3}

SEARCHES: dict[str, AbstractSearch] = {
    "exhaustive, first": ExhaustiveFirst(),
    "exhaustive, nearest": ExhaustiveNearest(),
    "photogrammetric": Photogrammetric(),
    "improved, as printed": ImprovedLiteral(),
    "improved, secant": ImprovedSecant(),
    "segmented": Segmented(),
    "fast": FastIteration(),
    "fast, Zmax of the DEM": FastIteration(window=WholeTerrain()),
    "bisection": Bisection(),
    "first hit": FirstHit(),
}

PRINTED_MS: dict[str, dict[str, int]] = {
    "plain": {"exhaustive": 4156, "improved": 3843, "segmented": 3540, "fast": 3648},
    "hill": {"exhaustive": 18610, "improved": 5269, "segmented": 4712, "fast": 4530},
    "mountain": {"exhaustive": 1249840, "improved": 86312, "segmented": 36879, "fast": 20106},
}
"""Table 4 of Li et al. (2023), ms of 100 runs on a 2.90 GHz processor; whether each or all of them, it does not say."""

PRINTED_AS: dict[str, str] = {
    "exhaustive, first": "exhaustive",
    "improved, secant": "improved",
    "segmented": "segmented",
    "fast": "fast",
}
"""Which of our searches stands beside which column of that table."""


@dataclass(frozen=True)
class Row:
    """One search on one scene, over all its rays.

    Evaluations are heights read from the DEM, for the first hit the bounds and patches looked up; `shares` of every
    `Outcome` in enum order; `farthest` in m behind the first hit; `us_per_ray` in a compiled batch.
    """

    scene: str
    search: str
    evaluations: float
    median_evaluations: float
    most_evaluations: int
    shares: tuple[float, ...]
    farthest: float
    us_per_ray: float

    def share(self, outcome: Outcome) -> float:
        """The share of rays with an outcome."""
        return self.shares[outcome.value]


def standard_scenes(rays: int, *, size: int = 1501, seed: int = 1) -> list[Scene]:
    """Plain, hill, mountain and very steep terrain: RMS slopes of 1, 8, 22 and 47 deg, posts 30 m apart.

    Depressions are those of the outer frame angles 74.67, 75.40 and 78.77 deg of Li et al. (2023), Table 2.
    """
    kinds = {"plain": (1.0, 15.3), "hill": (8.0, 14.6), "mountain": (22.0, 11.2), "very steep": (47.0, 11.2)}
    return [
        make_scene(name, rms_slope=math.radians(slope), depression=math.radians(down), rays=rays, size=size, seed=seed)
        for name, (slope, down) in kinds.items()
    ]


@batch_filter_jit
def approaches(rays: Ray, dem: Dem) -> Approach:
    """The approach of every ray of a batch, shared by all published searches."""
    return jax.vmap(approach, in_axes=(0, None))(rays, dem)


@batch_filter_jit
def run_from(begun: Approach, dem: Dem, search: AbstractStudiedSearch) -> Run:
    """A batch of runs of a published search, from the `approaches` of its rays."""
    return jax.vmap(search.run_from, in_axes=(0, None))(begun, dem)


@functools.cache
def _run_many() -> Callable[[Approach, Dem, AbstractStudiedSearch], Run]:
    """`run_from` as a program to be timed: called without the search for kept programs, which takes milliseconds."""
    return jax.jit(run_from, compiler_options=batch_options() | OPTIMISED)


@batch_filter_jit
def located(rays: Ray, dem: Dem, search: AbstractSearch) -> tuple[Array, Array]:
    """Ranges in m (NaN without a hit) and statuses of a batch of rays: a search and its polish, as in `intersect`."""

    def locate_one(ray: Ray) -> tuple[Array, Array]:
        bracket = dem.bracket(ray, search)
        has_point = bracket.status == Status.hit
        distance = polish(tree_where(has_point, ray, dem.safe_ray()), dem, bracket)
        return jnp.where(has_point, distance, jnp.nan), bracket.status

    return jax.vmap(locate_one)(rays)


@batch_filter_jit
def bisection_evaluations(rays: Ray, dem: Dem) -> Array:
    """Evaluations of `Bisection` along each ray: it halves the range between highest and lowest ground to 1e-9 m."""

    def count(ray: Ray) -> Array:
        reach = reach_of(ray, dem)
        return jnp.ceil(jnp.log2((reach.end - reach.start) / (SHORTEST + 4e-16 * reach.end))) + 1.0

    return jax.vmap(count)(rays)


@jax.jit
def first_hit_evaluations(rays: Ray, dem: Dem, first: Array) -> Array:
    """Total bounds and patches that a first-hit search looks up along each ray (see `first_hit_look_ups`)."""
    bounds, patches = jax.vmap(first_hit_look_ups, in_axes=(0, None, 0))(rays, dem, first)
    return bounds + patches


def study(scene: Scene, searches: dict[str, AbstractSearch] | None = None, *, repeats: int = 3) -> list[Row]:
    """Run searches over a scene's rays and compare each run with the guaranteed first hit.

    Times are medians of `repeats` calls for the whole batch under `vmap`, compiled before: the search alone (from the
    `approaches`) for the published ones, search and polish for bisection and the first hit. The slowest ray determines
    the time of a batch.
    """
    over = Over.of(scene)
    rows = []
    for name, search in (SEARCHES if searches is None else searches).items():
        found = over.find(search, repeats=repeats)
        is_farther = found.outcomes == Outcome.farther_hit
        rows.append(
            Row(
                scene=scene.name,
                search=name,
                evaluations=float(found.evaluations.mean()),
                median_evaluations=float(np.median(found.evaluations)),
                most_evaluations=int(found.evaluations.max()),
                shares=tuple(float(np.mean(found.outcomes == outcome.value)) for outcome in Outcome),
                farthest=float(np.nanmax((found.distance - over.first)[is_farther])) if is_farther.any() else 0.0,
                us_per_ray=found.us_per_ray,
            )
        )
    return rows


@dataclass(frozen=True)
class Found:
    """One search over a batch of rays. Per ray: evaluations, `Outcome` code, range in m (for a published search that
    did not converge the last one, for others NaN without a hit) and height of its point above the ground in m
    (published searches only, else NaN); and the time in us per ray."""

    evaluations: np.ndarray
    outcomes: np.ndarray
    distance: np.ndarray
    clearance: np.ndarray
    us_per_ray: float


@dataclass(frozen=True)
class Over:
    """A batch of rays over a terrain with shared inputs of all searches: approaches, and ranges of first hits in m."""

    rays: Ray
    dem: Dem
    begun: Approach
    first: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> Over:
        """All rays of a scene."""
        rays, dem = scene.rays, scene.dem
        return cls(rays, dem, approaches(rays, dem), np.asarray(located(rays, dem, FIRST_HIT)[0]))

    def fewer(self, count: int) -> Over:
        """The first `count` rays."""
        rays, begun, first = jax.tree.map(lambda x: x[:count], (self.rays, self.begun, self.first))
        return Over(rays, self.dem, begun, first)

    def find(self, search: AbstractSearch, *, repeats: int = 0) -> Found:
        """Run one search; its time is the median of `repeats` further calls, NaN without them."""
        if isinstance(search, AbstractStudiedSearch):
            go = functools.partial(_run_many(), self.begun, self.dem, search)
            run = go()
            codes, distance = outcomes(run, self.first), np.asarray(run.distance)
            evaluations, clearance = np.asarray(run.evaluations), np.asarray(run.clearance)
        else:
            go = functools.partial(located, self.rays, self.dem, search)
            distance = np.asarray(go()[0])
            codes = outcomes_of_ranges(distance, self.first)
            is_bisection = isinstance(search, Bisection)
            asked = (
                bisection_evaluations(self.rays, self.dem)
                if is_bisection
                else first_hit_evaluations(self.rays, self.dem, self.first)
            )
            evaluations, clearance = np.asarray(asked), np.full(distance.shape, np.nan)
        return Found(evaluations, codes, distance, clearance, _median_seconds(go, repeats) * 1e6 / self.first.size)


def outcomes(run: Run, first: np.ndarray, tolerance: float = SAME_CROSSING) -> np.ndarray:
    """The `Outcome` codes of a batch of runs against first hits at ranges `first` in m; `tolerance` in m of range."""
    return np.asarray(jax.vmap(outcome_of, (0, 0, None))(run, jnp.asarray(first), jnp.asarray(tolerance)))


def outcomes_of_ranges(distance: np.ndarray, first: np.ndarray) -> np.ndarray:
    """`Outcome` codes of searches that return a range in m or NaN, against first hits at ranges `first` in m."""
    away = distance - first
    codes = np.where(away < -SAME_CROSSING, Outcome.nearer_hit, Outcome.farther_hit)
    codes = np.where(np.abs(away) <= SAME_CROSSING, Outcome.first_hit, codes)
    return np.where(np.isnan(distance), Outcome.failed, codes)


def _median_seconds(go: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        jax.block_until_ready(go())
        times.append(time.perf_counter() - begin)
    return float(np.median(times)) if times else math.nan


def searches_table(rows: Sequence[Row]) -> str:
    """Rows as a plain table with units: evaluations per ray, shares in %, farthest in m, time in us."""
    head = (
        f"{'terrain':11s}{'search':24s}{'evaluations per ray':>22s}   {'first  farther nearer cycled diverged failed'}"
        f"{'farthest':>10s}{'time':>11s}"
    )
    units = f"{'':11s}{'':24s}{'mean  median     most':>22s}   {'%':>5s}{'%':>8s}{'%':>7s}{'%':>7s}{'%':>9s}{'%':>7s}"
    lines = [head, units + f"{'m':>11s}{'us/ray':>11s}"]
    for row in rows:
        shares = "".join(f"{100.0 * s:{w}.1f}" for s, w in zip(row.shares, (5, 8, 7, 7, 9, 7), strict=True))
        lines.append(
            f"{row.scene:11s}{row.search:24s}{row.evaluations:7.1f}{row.median_evaluations:7.0f}"
            f"{row.most_evaluations:8d}   {shares}{row.farthest:11.0f}{row.us_per_ray:11.1f}"
        )
    return "\n".join(lines)


def printed_table(rows: Sequence[Row]) -> str:
    """The twelve printed times of Table 4 of Li et al. (2023) beside ours, also as multiples of the fast one's."""
    ours = {(row.scene, PRINTED_AS[row.search]): row for row in rows if row.search in PRINTED_AS}
    lines = [
        f"{'terrain':10s}{'search':12s}{'printed':>11s}{'/ fast':>8s}{'ours':>11s}{'/ fast':>8s}"
        f"{'evaluations':>13s}{'/ fast':>8s}",
        f"{'':22s}{'ms':>11s}{'':8s}{'us/ray':>11s}{'':8s}{'per ray':>13s}",
    ]
    for scene, printed in PRINTED_MS.items():
        fast = ours[scene, "fast"]
        for name, ms in printed.items():
            row = ours[scene, name]
            lines.append(
                f"{scene:10s}{name:12s}{ms:11d}{ms / printed['fast']:8.2f}"
                f"{row.us_per_ray:11.1f}{row.us_per_ray / fast.us_per_ray:8.2f}"
                f"{row.evaluations:13.1f}{row.evaluations / fast.evaluations:8.2f}"
            )
    return "\n".join(lines)


@functools.partial(jax.jit, static_argnames="steps")
def trace(search: AbstractStudiedSearch, ray: Ray, dem: Dem, steps: int) -> Run:
    """The state of a search after 0, 1, ... `steps` - 1 steps, as a batch of runs; for searches with a `limit`."""
    begun = approach(ray, dem)
    stopped = lambda limit: eqx.tree_at(lambda search: search.limit, search, limit).run_from(begun, dem)  # noqa: E731
    return jax.vmap(stopped)(jnp.arange(steps))
