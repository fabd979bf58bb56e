"""The searches of the literature: the laws they obey on a plane, and how each of them fails."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Bisection, FirstHit, Ray, Status, intersect
from jaxgeo.studies.scenes import profile_dem, profile_ray, tangent_dem
from jaxgeo.studies.terrain_searches import approaches, located, outcomes, run_from, trace
from jaxgeo.terrain import (
    Dem,
    Ending,
    ExhaustiveFirst,
    ExhaustiveNearest,
    FastIteration,
    HeightsBetween,
    ImprovedLiteral,
    ImprovedSecant,
    Outcome,
    Photogrammetric,
    Segmented,
    TargetArea,
    WholeTerrain,
)

pytestmark = pytest.mark.costly

POSTS, SPACING = 65, 30.0  # m
AHEAD = SPACING * (np.arange(POSTS) - POSTS // 2)  # m beyond the middle, along the look
BATCH = 8
AREA = TargetArea(height=0.0, half=2)
EVERY_SEARCH = {
    "exhaustive, first": ExhaustiveFirst(window=HeightsBetween(0.0, 10.0)),
    "exhaustive, nearest": ExhaustiveNearest(window=HeightsBetween(0.0, 10.0)),
    "photogrammetric": Photogrammetric(start=0.0),
    "improved, as printed": ImprovedLiteral(start=0.0),
    "improved, secant": ImprovedSecant(start=0.0),
    "segmented": Segmented(start=0.0, window=AREA),
    "fast": FastIteration(window=AREA),
}


def of_arrays(search):
    """The search with its numbers as arrays: one program serves them all."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, search)


def run_of(search, dem: Dem, *rays: Ray):
    """Runs and outcomes of up to eight rays, compiled once for each kind of search, whatever its numbers."""
    search = of_arrays(search)
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *rays, *[rays[-1]] * (BATCH - len(rays)))
    run = run_from(approaches(batch, dem), dem, search)
    first, _ = located(batch, dem, FirstHit())
    codes = outcomes(run, np.asarray(first))
    return jax.tree.map(lambda x: np.asarray(x)[: len(rays)], run), [Outcome(code) for code in codes[: len(rays)]]


def plane(k: float) -> tuple[Dem, Ray]:
    """A plane of slope k along the look, and a ray 45 degrees down that meets it in the middle at height 0."""
    dem = profile_dem(k * AHEAD, SPACING)
    return dem, profile_ray(dem, 0.0, 0.0, depression=math.pi / 4.0, altitude=5000.0)


def ridge(height_there: float = 40.0, step: float = 15.0) -> tuple[Dem, Ray]:
    """Level ground at 0 m with a ridge one post wide and 60 m high, and a ray that passes its place 40 m up."""
    dem = profile_dem(np.where(AHEAD == 0.0, 60.0, 0.0), SPACING)
    return dem, profile_ray(dem, 0.0, height_there, depression=math.radians(step), altitude=5000.0)


def plateau(first: float, last: float) -> tuple[Dem, Ray]:
    """Level ground at 0 m with a plateau 200 m high between two places, and a ray to the ground 600 m ahead.

    The ray is 15 degrees down; a bump of 40 m lies behind its target.
    """
    heights = np.where(np.abs(AHEAD - 0.5 * (first + last)) <= 0.5 * (last - first), 200.0, 40.0 * (AHEAD == 630.0))
    dem = profile_dem(heights, SPACING)
    return dem, profile_ray(dem, 600.0, 0.0, depression=math.radians(15.0), altitude=5000.0)


# Laws on a plane. k = tan(slope along the look) / tan(depression); k > 0 rises along the look.


@pytest.mark.parametrize("k, evaluations", [(-0.9, 91), (-0.5, 23), (0.0, 11), (0.5, 7), (0.9, 4)])
def test_evaluations_of_fast_iteration_on_a_plane(k: float, evaluations: int) -> None:
    """From 200 m above the target to 0.2 m, h(Zmax) counted."""
    dem, ray = plane(k)
    run, _ = run_of(FastIteration(window=HeightsBetween(0.0, 200.0)), dem, ray)
    assert run.evaluations[0] == evaluations
    assert run.ending[0] == Ending.converged
    assert 0.0 <= run.clearance[0] <= 0.2


@pytest.mark.slow  # the number of evaluations, above, is of the same law
@pytest.mark.parametrize("k", [-0.9, -0.5, 0.0, 0.5, 0.9])
def test_fast_iteration_contracts_by_half_of_one_less_k(k: float) -> None:
    dem, ray = plane(k)
    height = np.asarray(trace(FastIteration(window=HeightsBetween(0.0, 200.0), eps=0.0), ray, dem, 5).height)
    np.testing.assert_allclose(height[1:3] / height[:2], (1.0 - k) / 2.0, rtol=0, atol=2e-4)


@pytest.mark.parametrize("k", [-0.9, -0.5, 0.5, 0.9, 1.0, 1.5])
def test_photogrammetric_iteration_contracts_by_k(k: float) -> None:
    dem, ray = plane(k)
    height = np.asarray(trace(Photogrammetric(start=100.0, eps=0.0), ray, dem, 5).height)
    np.testing.assert_allclose(height[1:] / height[:-1], -k, rtol=0, atol=2e-4)


@pytest.mark.parametrize("k, ending", [(0.5, Ending.converged), (1.0, Ending.cycled), (1.5, Ending.diverged)])
def test_photogrammetric_iteration_cycles_and_diverges(k: float, ending: Ending) -> None:
    dem, ray = plane(k)
    run, outcome = run_of(Photogrammetric(start=100.0), dem, ray)
    assert run.ending[0] == ending
    is_lost = ending != Ending.converged
    assert run.status[0] == (Status.not_converged if is_lost else Status.hit)
    assert outcome[0].name == (ending.name if is_lost else "first_hit")
    assert (run.evaluations[0] == 101) == (ending == Ending.cycled)


@pytest.mark.parametrize("k", [-0.9, -0.5, 0.5, 0.9, 1.5])
def test_the_secant_is_exact_on_a_plane(k: float) -> None:
    """One step: Z0, h(Z0), and the plane itself. The segmented search begins with it and is as good."""
    dem, ray = plane(k)
    for search in (ImprovedSecant(start=100.0), Segmented(start=100.0, window=AREA)):
        run, _ = run_of(search, dem, ray)
        assert (run.evaluations[0], run.iterations[0]) == (3, 1)
        assert abs(run.height[0]) < 0.02  # m, what the Earth curves away under the line


def test_the_printed_improved_step_is_exact_on_a_rising_plane() -> None:
    dem, ray = plane(0.5)
    run, _ = run_of(ImprovedLiteral(start=150.0), dem, ray)
    outward = math.ceil((150.0 + 300.0) / SPACING)  # posts from A, 150 m this side of the target, to ground as high
    assert run.iterations[0] == 1
    assert run.evaluations[0] == 2 + outward
    assert abs(run.height[0]) < 0.05  # m


def test_the_printed_improved_step_is_photogrammetric_on_falling_ground() -> None:
    dem, ray = plane(-0.5)
    printed, usual = (run_of(search(start=100.0), dem, ray)[0] for search in (ImprovedLiteral, Photogrammetric))
    assert printed.iterations[0] == usual.iterations[0] > 3
    np.testing.assert_allclose(printed.height, usual.height, rtol=0, atol=1e-6)  # m


@pytest.mark.parametrize("k", [-0.5, 0.5])
def test_exhaustive_search_takes_every_step_down_to_eps(k: float) -> None:
    dem, ray = plane(k)
    window = HeightsBetween(-10.0, 50.1)
    run, _ = run_of(ExhaustiveFirst(window=window), dem, ray)
    tries = next(n for n in range(1000) if (1.0 + k) * (50.1 - 0.2 * n) <= 0.2) + 1
    assert run.evaluations[0] == tries
    nearest, _ = run_of(ExhaustiveNearest(window=window), dem, ray)
    assert nearest.evaluations[0] == 302
    assert abs(nearest.height[0]) <= 0.1 + 1e-3  # m: half a step


# How each fails. The first hit, beside them, does not.


def first_height(dem: Dem, ray: Ray, search=None) -> float:
    """Height of the point found by `intersect`, in a batch of the one size."""
    batch = jax.tree.map(lambda x: jnp.broadcast_to(x, (BATCH, *x.shape)), ray)
    distance, status = located(batch, dem, FirstHit() if search is None else search)
    assert status[0] == Status.hit
    return float(dem.over(ray.at(distance[0]))[1])


def test_first_hit_sees_the_ridge_and_the_plateau() -> None:
    front = 40.0 + 20.0 / (2.0 + math.tan(math.radians(15.0))) * math.tan(math.radians(15.0))
    assert first_height(*ridge()) == pytest.approx(front, abs=0.02, rel=0)
    dem, ray = plateau(-210.0, -60.0)
    assert first_height(dem, ray) == pytest.approx(200.0, abs=0.5, rel=0)


@pytest.mark.parametrize(
    "search",
    [
        FastIteration(window=WholeTerrain()),
        Photogrammetric(start=30.0),
        ImprovedLiteral(start=30.0),
        ImprovedSecant(start=30.0),
        ExhaustiveFirst(step=50.0, window=HeightsBetween(0.0, 60.0)),
        ExhaustiveNearest(window=HeightsBetween(0.0, 60.0)),
        Segmented(start=30.0, window=AREA),
    ],
    ids=lambda search: type(search).__name__,
)
def test_a_narrow_ridge_is_jumped(search) -> None:
    """A long step, or a start behind it. Exhaustive search sees it with a short step, unless it takes the nearest."""
    dem, ray = ridge()
    run, outcome = run_of(search, dem, ray)
    assert outcome == [Outcome.farther_hit]
    assert run.status[0] == Status.hit  # it does not know
    assert run.height[0] < 0.3  # m, on the level ground behind it, or a step below


def test_short_steps_see_the_narrow_ridge() -> None:
    dem, ray = ridge()
    assert run_of(ExhaustiveFirst(window=HeightsBetween(0.0, 60.0)), dem, ray)[1] == [Outcome.first_hit]


def test_bisection_finds_the_hidden_slope() -> None:
    assert first_height(*ridge(), search=Bisection()) == pytest.approx(0.0, abs=0.01, rel=0)


def test_a_near_peak_outside_the_target_area_hides_from_fast_iteration() -> None:
    dem, ray = plateau(-210.0, -60.0)
    assert run_of(FastIteration(window=AREA), dem, ray)[1] == [Outcome.farther_hit]
    assert run_of(Segmented(start=0.0, window=AREA), dem, ray)[1] == [Outcome.farther_hit]  # the same window misses it
    assert run_of(FastIteration(window=WholeTerrain()), dem, ray)[1] == [Outcome.first_hit]


def test_a_start_below_the_ground_fails() -> None:
    """The ray at the area's highest height is deep in a plateau: the middle of the first window is too."""
    dem, ray = plateau(-90.0, 510.0)
    run, outcome = run_of(FastIteration(window=AREA), dem, ray)
    assert outcome == [Outcome.failed]
    assert run.status[0] == Status.not_converged
    assert run.clearance[0] < -100.0


def test_fast_iteration_is_slow_on_back_slopes_and_stops_short() -> None:
    """At k = -0.98 it takes 300 evaluations from 200 m, and 0.2 m of clearance are 10 m of height."""
    dem, ray = plane(-0.98)
    run, _ = run_of(FastIteration(window=HeightsBetween(0.0, 200.0)), dem, ray)
    assert run.evaluations[0] == pytest.approx(300, abs=3, rel=0)
    assert run.height[0] == pytest.approx(10.0, abs=0.3, rel=0)


def test_the_secant_runs_away_where_ray_and_ground_are_parallel() -> None:
    fall = math.tan(math.radians(15.0))
    heights = 200.0 - fall * (np.minimum(AHEAD, 600.0) + 960.0)
    dem = profile_dem(heights, SPACING)
    ray = profile_ray(dem, 0.0, 200.0 - fall * 960.0 + 30.0, depression=math.radians(15.0), altitude=5000.0)
    run, outcome = run_of(ImprovedSecant(start=float(heights[20])), dem, ray)
    assert outcome == [Outcome.diverged]
    assert run.status[0] == Status.not_converged


# The interface.


@pytest.mark.parametrize("search", EVERY_SEARCH.values(), ids=EVERY_SEARCH.keys())
def test_statuses(search) -> None:
    """What keeps a ray from an answer is said, and is a failure."""
    level = tangent_dem(np.zeros((POSTS, 5)), SPACING)
    down, into = math.radians(45.0), profile_ray(level, 0.0, 0.0, depression=math.radians(45.0), altitude=5000.0)
    beyond = profile_ray(level, 2000.0, 0.0, depression=down, altitude=5000.0)
    upward = Ray(into.origin, -into.direction)
    buried = Ray(into.at(jnp.asarray(7500.0)), into.direction)
    far = Ray(-into.origin, -into.direction)
    run, outcome = run_of(search, level, into, beyond, upward, buried, far)
    expected = ["hit", "leaves_terrain", "rises_away", "camera_below_terrain", "ray_misses_terrain"]
    assert [Status(code).name for code in run.status] == expected
    assert outcome == [Outcome.first_hit] + [Outcome.failed] * 4
    holes = np.zeros((POSTS, 5))
    holes[POSTS // 2] = np.nan
    over_void, _ = run_of(search, tangent_dem(holes, SPACING), into)
    assert over_void.status[0] == Status.hits_void


@pytest.mark.parametrize(
    "search", [FastIteration(window=AREA), pytest.param(ImprovedLiteral(start=30.0), marks=pytest.mark.slow)]
)
def test_single_and_nested_rays_run_as_in_a_batch(search) -> None:
    dem, search = ridge()[0], of_arrays(search)
    rays = [profile_ray(dem, 0.0, 5.0 + 9.0 * n, depression=math.radians(20.0), altitude=5000.0) for n in range(BATCH)]
    begun = approaches(jax.tree.map(lambda *leaves: jnp.stack(leaves), *rays), dem)
    batch = run_from(begun, dem, search)
    in_rows = jax.tree.map(lambda x: x.reshape(2, 4, *x.shape[1:]), begun)
    nested = jax.jit(lambda begun, dem: jax.vmap(lambda row: run_from(row, dem, search))(begun))(in_rows, dem)
    alone = eqx.filter_jit(search.run_from)(jax.tree.map(lambda x: x[3], begun), dem)
    for name in ("distance", "evaluations", "ending", "status"):
        every = np.asarray(getattr(batch, name))
        np.testing.assert_allclose(np.asarray(getattr(nested, name)).ravel(), every, rtol=0, atol=1e-6)
        np.testing.assert_allclose(np.asarray(getattr(alone, name)), every[3], rtol=0, atol=1e-6)


def test_intersect_keeps_the_answer_of_the_method() -> None:
    """The polish does not move it by more than a micrometre or so, and failures have no coordinates."""
    search = FastIteration(window=AREA)
    (dem, ray), (high, into) = plane(0.5), plateau(-90.0, 510.0)
    find = jax.jit(lambda ray, dem: intersect(ray, dem, search=search))
    fix = find(ray, dem)
    run, _ = run_of(search, dem, ray)
    assert fix.status == Status.hit
    assert float(fix.slant_range) == pytest.approx(run.distance[0], abs=3e-6, rel=0)
    lost = find(into, high)
    assert lost.status == Status.not_converged
    assert np.isnan(lost.slant_range)
