"""Many looks at one target: held against least squares with the full joint covariance, Kalman's filter, and chance.

References: the joint covariance of all looks as a dense matrix, made of `SharedErrors` or of `propagate` and the
correlations of the sources, and its generalised least-squares estimate; the covariance form of Kalman's filter, in
NumPy; NEES and NIS of simulated runs (Bar-Shalom, Li and Kirubarajan 2001, "Estimation with applications to tracking
and navigation", section 5.4).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import jaxgeo
from jaxgeo import ConstantHeight, ErrorModel, Geodetic, Pose, Shot, Status
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.terrain import TangentGrid
from jaxgeo.uncertainty import (
    AtRest,
    ConstantVelocity,
    Looks,
    PerFlight,
    PerImage,
    Systematic,
    TimeCorrelated,
    Track,
    joint_covariance,
    propagate,
    simulate_looks,
    sources,
    track,
)
from jaxgeo.uncertainty.distributions import StudentT
from jaxgeo.uncertainty.look_equations import About, World
from jaxgeo.uncertainty.look_filter import Carry, Mode, filtered, start_of
from jaxgeo.uncertainty.look_lines import SIZES, Lines
from jaxgeo.uncertainty.looks import checked_looks
from jaxgeo.uncertainty.shared_errors import shared_errors
from jaxgeo.uncertainty.sharing import AbstractSharing, Occasion
from jaxgeo.uncertainty.track_record import TargetState

POINT = Geodetic.from_degrees(lat=47.0, lon=11.0, height=600.0)
GROUND = ConstantHeight(600.0)
MIDDLE, BESIDE = (1999.5, 1499.5), (4050.0, 1500.0)
SENSOR = jaxgeo.Sensor(
    jaxgeo.FrameCamera.from_pixels(focal_px=5000.0, width=4000, height=3000),
    jaxgeo.Gimbal.fixed(),
    jaxgeo.Mount.forward(),
)
FREE = ConstantVelocity(on_terrain=False)


def looks_from(azimuths: Any, step: float = 10.0, **options: Any) -> Looks:
    """Looks at the point from 3.3 km away and 2 km above, one after another."""
    shots = []
    for number, azimuth in enumerate(np.radians(azimuths)):
        north, east = 0.03 * math.cos(azimuth), 0.03 * 1.465 * math.sin(azimuth)
        place = Geodetic.from_degrees(lat=47.0 + north, lon=11.0 + east, height=2600.0)
        shots.append(Shot(Pose.looking_at(position=place, point=POINT), time=step * number))
    return Looks(SENSOR, shots, np.tile(MIDDLE, (len(shots), 1)), **options)


def error_model(scale: float = 1.0) -> ErrorModel:
    """What is fresh, what fades with time, what a flight shares, and what all share."""
    attitude = TimeCorrelated(60.0, alpha=0.2, strength=0.9)
    return ErrorModel(
        (
            sources.Attitude.from_degrees(heading=0.1 * scale, pitch=0.1 * scale, roll=0.1 * scale, sharing=attitude),
            sources.Boresight.from_degrees(heading=0.05 * scale, pitch=0.1 * scale, roll=0.1 * scale),
            sources.Position.from_ned(north=3.0 * scale, east=3.0 * scale, down=5.0 * scale),
            sources.PixelMeasurement.from_pixels(column=2.0 * scale, row=2.0 * scale),
            sources.TerrainHeight.from_metres(5.0 * scale),
        )
    )


# The filter by itself, on lines of sight that make its equations exactly linear.

COUNT, COUNTS, DURATIONS = 12, (3, 2, 2), np.array([30.0, 200.0])
WORLD = World(None, WGS84.to_ecef(POINT), R_ecef_from_enu(POINT), jnp.asarray(DURATIONS))
BEFORE = np.array([300.0, 300.0, 300.0, 10.0, 10.0, 10.0])  # m and m/s: known of the target before the first look


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Lines of sight with drawn geometry and errors, and the measurement b + H x + G z = 0 of each."""

    lines: Lines
    H: np.ndarray
    G: np.ndarray
    b: np.ndarray


def drawn_lines(seed: int = 3) -> Drawn:
    rng = np.random.default_rng(seed)
    heading = rng.standard_normal((COUNT, 3)) * [1.0, 1.0, 0.2] - [0.0, 0.0, 1.0]
    heading /= np.linalg.norm(heading, axis=1)[:, None]
    time = np.cumsum(rng.uniform(1.0, 20.0, COUNT))
    time[5] = time[4]  # two sensors at once
    shift = rng.standard_normal((COUNT, 3, sum(COUNTS))) * 10.0
    right = np.stack([heading[:, 1], -heading[:, 0], np.zeros(COUNT)], axis=1)
    right /= np.linalg.norm(right, axis=1)[:, None]
    across = np.stack([right, np.cross(right, heading)], axis=1)
    T = np.concatenate([np.tile(np.eye(3), (COUNT, 1, 1)), time[:, None, None] * np.eye(3)], axis=2)
    point = rng.standard_normal((COUNT, 3)) * 50.0
    zeros = np.zeros((COUNT, 3))
    ground, status = np.zeros((COUNT, sum(COUNTS))), np.zeros(COUNT, np.int8)
    lines = Lines(time, point, heading, zeros, np.full(COUNT, 5000.0), shift, np.zeros_like(shift), ground, status)
    return Drawn(lines, across @ T, -across @ shift, -np.einsum("nij,nj->ni", across, point))


def run(lines: Lines, *, shared: float = 1.0, rounds: int = 3, before: Any = BEFORE) -> Any:
    """Estimates after each look, from what was known before."""
    start: Carry = start_of(FREE, COUNTS)
    R = start.R.copy()
    if before is not None:
        R[2:8, 2:8] = np.diag(1.0 / before)
    size = SIZES[0]
    index = np.minimum(np.arange(size), COUNT - 1)
    padded = jax.tree.map(lambda leaf: jnp.asarray(leaf[index]), lines)
    mode = Mode(*(jnp.asarray(x) for x in (shared, 1.0, rounds)))
    used = jnp.asarray(np.arange(size) < COUNT)
    about, span = About(np.zeros(6), np.zeros(())), np.array([0, COUNT])
    _, after = filtered(start._replace(R=R), padded, used, span, about, WORLD, mode, FREE, COUNTS)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:COUNT], after)


def joint(made: Drawn) -> np.ndarray:
    """Covariance of all measurements (2 n, 2 n)."""
    fresh, constant, fading = np.split(made.G, np.cumsum(COUNTS)[:-1], axis=2)
    apart = np.abs(made.lines.time[:, None] - made.lines.time[None, :])
    stays = np.exp(-apart[..., None] / DURATIONS)
    cov = np.einsum("nik,mjk->nimj", constant, constant) + np.einsum("nik,mjk,nmk->nimj", fading, fading, stays)
    cov += np.einsum("nik,mjk,nm->nimj", fresh, fresh, np.eye(COUNT))
    return cov.reshape(2 * COUNT, 2 * COUNT)


def gls(made: Drawn, count: int, before: np.ndarray, by: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(estimate from the first looks, its covariance under `cov`) with weights from the inverse of `by`."""
    A, b = made.H[:count].reshape(2 * count, -1), made.b[:count].reshape(-1)
    by, cov = by[: 2 * count, : 2 * count], cov[: 2 * count, : 2 * count]
    weighted = np.linalg.solve(by, A)
    inverse = np.linalg.inv(A.T @ weighted + np.diag(1.0 / before**2))
    return inverse @ weighted.T @ -b, inverse @ (weighted.T @ cov @ weighted + np.diag(before**-2.0)) @ inverse


def place_at(made: Drawn, number: int) -> np.ndarray:
    return np.concatenate([np.eye(3), made.lines.time[number] * np.eye(3)], axis=1)


def test_each_estimate_of_the_filter_is_that_of_least_squares_with_the_joint_covariance() -> None:
    """Recursion with shared errors as states, against dense generalised least squares of the looks so far."""
    made = drawn_lines()
    cov, after = joint(made), run(made.lines)
    R = np.asarray(WORLD.R_ecef_from_track)
    for number in (0, 1, 4, 5, COUNT - 1):
        x, P = gls(made, number + 1, BEFORE, cov, cov)
        np.testing.assert_allclose(after.about.state[number], x, atol=1e-8)
        T = place_at(made, number)
        turn = np.asarray(R_ecef_from_enu(WGS84.to_geodetic(jnp.asarray(after.p_ecef[number])))).T @ R
        np.testing.assert_allclose(after.cov_enu[number], turn @ T @ P @ T.T @ turn.T, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(after.velocity_cov_enu[number], turn @ P[3:, 3:] @ turn.T, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(R.T @ (after.p_ecef[number] - np.asarray(WORLD.origin)), T @ x, atol=2e-8)


def test_innovations_are_those_of_the_covariance_form() -> None:
    """Kalman's filter in its covariance form, with the errors as states, in NumPy."""
    made, after = drawn_lines(), run(drawn_lines().lines)
    fresh, constant, fading = np.split(made.G, np.cumsum(COUNTS)[:-1], axis=2)
    P, s, before = np.diag(np.concatenate([[1.0, 1.0], BEFORE**2, [1.0, 1.0]])), np.zeros(10), -np.inf
    for number, time in enumerate(made.lines.time):
        stays = np.concatenate([np.exp(-(time - before) / DURATIONS), np.ones(8)])
        P, s, before = stays[:, None] * P * stays, stays * s, time
        P[:2, :2] += np.diag(1.0 - stays[:2] ** 2)
        A = np.concatenate([fading[number], made.H[number], constant[number]], axis=1)
        S = A @ P @ A.T + fresh[number] @ fresh[number].T
        innovation, gain = -made.b[number] - A @ s, np.linalg.solve(S, A @ P).T
        assert after.nis[number] == pytest.approx(innovation @ np.linalg.solve(S, innovation), rel=1e-7)
        values, vectors = np.linalg.eigh(S)
        standardised = vectors @ (vectors.T @ innovation / np.sqrt(values))
        np.testing.assert_allclose(after.innovation[number], standardised, atol=1e-7)
        s, P = s + gain @ innovation, P - gain @ S @ gain.T
    assert np.all(after.degrees == 2)


def test_batch_and_filter_are_one_where_all_is_linear() -> None:
    """Nothing is known before: one linearisation for all looks, far off, and one at each look, give the same."""
    made = drawn_lines(seed=4)
    at_once, recursive = run(made.lines, rounds=0, before=None), run(made.lines, rounds=3, before=None)
    np.testing.assert_allclose(at_once.about.state[-1], recursive.about.state[-1], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(at_once.cov_enu[-1], recursive.cov_enu[-1], rtol=1e-8)
    cov = joint(made)
    x, P = gls(made, COUNT, np.full(6, 1e9), cov, cov)
    np.testing.assert_allclose(recursive.about.state[-1], x, rtol=1e-6)
    np.testing.assert_allclose(recursive.velocity_cov_enu[-1], P[3:, 3:], rtol=1e-4, atol=1e-7)
    assert list(recursive.degrees[:4]) == [0, 0, 0, 2]  # six unknowns


def test_what_a_filter_of_independent_looks_claims_and_has() -> None:
    """Least squares with the blocks of the joint covariance as weights; its covariance under the whole of it."""
    made = drawn_lines(seed=7)
    cov = joint(made)
    blocks = np.kron(np.eye(COUNT), np.ones((2, 2))) * cov
    after = run(made.lines, shared=0.0, rounds=0, before=None)
    far = np.full(6, 1e9)
    for number in (4, COUNT - 1):
        (x, claimed), (_, actual) = gls(made, number + 1, far, blocks, blocks), gls(made, number + 1, far, blocks, cov)
        np.testing.assert_allclose(after.about.state[number], x, rtol=1e-6)
        T = place_at(made, number)
        np.testing.assert_allclose(np.trace(after.cov_enu[number]), np.trace(T @ claimed @ T.T), rtol=1e-6)
        np.testing.assert_allclose(np.trace(after.actual[number]), np.trace(T @ actual @ T.T), rtol=1e-6)


def test_shared_errors_have_the_covariance_of_the_sources() -> None:
    """C z has the joint covariance of `AbstractSource.cross_covariance`, in looks of two flights."""
    model, times, flights = error_model(), (0.0, 25.0, 40.0), (0, 0, 1)
    shared = shared_errors(model, (None, None))
    fresh, constant, _ = shared.counts
    for i, here in enumerate(times):
        for j, there in enumerate(times):
            expected = np.zeros((model.size, model.size))
            for source, place in model.parts():
                when = tuple(Occasion(k, k, flights[k], times[k]) for k in (i, j))
                expected[place, place] = source.cross_covariance(source, (when[0], when[1]))
            stays = np.exp(-abs(here - there) / shared.durations)
            between = np.concatenate([np.full(fresh, float(i == j)), np.ones(constant), stays])
            found = (shared.columns[flights[i]] * between) @ shared.columns[flights[j]].T
            np.testing.assert_allclose(found, expected, atol=1e-15)


# Whole tracks. Models of one structure, and as many looks (up to 16, or up to 128), share their programs.

MANY = 20
AZIMUTHS = np.linspace(-40.0, 40.0, MANY)


def scaled(**factors: float) -> ErrorModel:
    """The error model with the sigmas of some sources times a factor; the other ones are exact."""
    return ErrorModel(
        tuple(
            dataclasses.replace(source, sigma=factors.get(source.label.split()[0], 0.0) * np.asarray(source.sigma))
            for source in error_model().sources
        )
    )


@pytest.fixture(scope="module")
def still() -> Track:
    """A target at rest, of which all looks see exactly the same place."""
    return track(looks_from(AZIMUTHS), GROUND, error_model())


@pytest.mark.costly
def test_one_look_is_that_of_linear_propagation(still) -> None:
    looks = looks_from([-40.0])
    alone = propagate(SENSOR, looks.shots[0], MIDDLE, GROUND, error_model())
    np.testing.assert_allclose(still.filtered.cov_enu[0], alone.cov_enu, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(still.independent.cov_enu[0], alone.cov_enu, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(still.filtered.p_ecef[0], alone.fix.ecef, atol=1e-5)
    assert float(still.filtered.ce90[0]) == pytest.approx(float(alone.circular_error(0.9)), rel=1e-6)


@pytest.mark.costly
def test_a_target_at_rest_is_fused_as_by_the_joint_covariance(still) -> None:
    """Least squares by the inverse of the joint covariance of fixes, by `joint_covariance`."""
    looks = looks_from(AZIMUTHS)
    fixes = [propagate(SENSOR, shot, MIDDLE, GROUND, error_model()) for shot in looks.shots]
    _, cov = joint_covariance(fixes, times=[10.0 * k for k in range(MANY)]).fused()
    np.testing.assert_allclose(np.asarray(still.batch.cov_enu)[:2, :2], np.asarray(cov)[:2, :2], rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(still.filtered.cov_enu[-1], still.batch.cov_enu, rtol=1e-6, atol=1e-6)
    assert float(still.batch.cov_enu[2, 2]) <= 25.0  # of the terrain's height, which looks from several sides improve


@pytest.mark.costly
def test_a_common_boresight_is_a_floor() -> None:
    """A hundred looks from one place end at the covariance without any fresh error, and fresh ones alone go on."""
    single = propagate(SENSOR, looks_from([0.0]).shots[0], MIDDLE, GROUND, scaled(boresight=1.0))
    found = track(looks_from(np.zeros(100)), GROUND, scaled(boresight=1.0, pixel=5.0))
    difference = np.asarray(found.batch.cov_enu - single.cov_enu)[:2, :2]
    assert np.linalg.eigvalsh(difference)[0] > 0.0
    np.testing.assert_allclose(found.floor_enu[:2, :2], single.cov_enu[:2, :2], rtol=1e-4, atol=1e-4)
    assert float(found.batch.ce90) == pytest.approx(float(single.circular_error(0.9)), rel=0.05)
    claimed = float(found.independent.ce90[-1])
    assert claimed == pytest.approx(float(found.filtered.ce90[0]) / 10.0, rel=1e-3)
    assert float(found.overconfidence[-1]) == pytest.approx(float(found.actual_ce90[-1]) / claimed)
    assert float(found.actual_ce90[-1]) == pytest.approx(float(found.batch.ce90), rel=1e-6)  # all look alike


@pytest.mark.costly
def test_more_errors_and_fewer_looks_never_make_it_surer(still) -> None:
    """After each look the covariance shrinks, and it lies above the floor."""
    at_each = np.asarray(still.filtered.cov_enu)
    for before, after in itertools.pairwise(at_each):
        assert np.linalg.eigvalsh(before - after)[0] > -1e-6
    assert np.linalg.eigvalsh(at_each[-1] - np.asarray(still.floor_enu))[0] > -1e-6
    larger = track(looks_from(AZIMUTHS), GROUND, error_model(2.0))
    np.testing.assert_allclose(larger.batch.cov_enu, 4.0 * np.asarray(still.batch.cov_enu), rtol=1e-6, atol=1e-6)


RUNS = 500


def nees_of(state: TargetState, p_ecef: Any, cov_enu: Any = None) -> float:
    R = np.asarray(R_ecef_from_enu(state.position))
    error = R.T @ (np.asarray(state.p_ecef) - np.asarray(p_ecef))
    return float(error @ np.linalg.solve(np.asarray(state.cov_enu if cov_enu is None else cov_enu), error))


@pytest.mark.parametrize(
    "target, velocity",
    [
        pytest.param(AtRest(), (0.0, 0.0, 0.0), marks=pytest.mark.slow, id="still"),
        pytest.param(ConstantVelocity(), (8.0, 3.0, 0.0), marks=pytest.mark.slow, id="moving"),
    ],
)
def test_errors_of_simulated_runs_are_as_large_as_stated(target, velocity) -> None:
    """NEES and NIS of 500 runs are within the 95 % bounds of chi-square for batch and filter; those of the filter of
    independent looks are far above, unless its actual covariance is used."""
    looks, model = checked_looks(looks_from(np.linspace(-40.0, 40.0, 12))), error_model()
    rows = []
    for number in range(RUNS):
        key = jax.random.key(number)
        made = simulate_looks(looks, GROUND, model, key, position=POINT, velocity_enu=velocity, target=target)
        found = track(made.looks, GROUND, model, target=target)
        true = made.p_ecef[-1]
        alone = found.independent[-1]
        states = (found.batch, found.filtered[-1], alone)
        nis = float(np.sum(np.asarray(found.nis)))
        rows.append([*(nees_of(one, true) for one in states), nees_of(alone, true, found.actual_enu[-1]), nis])
    batch, recursive, independent, actual, nis = np.sum(rows, axis=0)
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 3 * RUNS)
    assert low < batch < high
    assert low < recursive < high
    assert low < actual < high
    assert independent > 2.0 * high
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], (2 * 12 - target.unknowns) * RUNS)
    assert low < nis < high


@pytest.mark.costly
def test_a_moving_target_free_in_height_is_found_from_a_circle() -> None:
    looks, model = looks_from(np.linspace(0.0, 300.0, 12)), error_model(0.01)
    velocity = (8.0, -3.0, 1.0)
    made = simulate_looks(looks, None, model, jax.random.key(1), position=POINT, velocity_enu=velocity, target=FREE)
    found = track(made.looks, None, model, target=FREE)
    sigma = np.sqrt(np.diagonal(np.asarray(found.batch.velocity_cov_enu)))
    assert np.all(np.abs(np.asarray(found.batch.velocity_enu) - velocity) < 4.0 * sigma)
    assert np.all(sigma < 0.01)
    np.testing.assert_allclose(found.batch.p_ecef, made.p_ecef[-1], atol=1.0)
    np.testing.assert_allclose(found.batch.p_ecef, found.filtered.p_ecef[-1], atol=0.02)
    statuses = np.asarray(found.filtered.status)
    assert list(statuses[:2]) == [Status.weak_intersection] * 2
    assert np.all(statuses[3:] == Status.hit)
    assert np.isnan(np.asarray(found.filtered.p_ecef[0])).all()


@pytest.mark.costly
def test_looks_without_parallax_leave_a_target_free_in_height_undetermined() -> None:
    found = track(looks_from(np.zeros(6)), None, error_model(), target=FREE)
    assert int(found.batch.status) == Status.weak_intersection
    assert np.isnan(np.asarray(found.batch.p_ecef)).all()
    assert "weak_intersection" in str(found)


@pytest.mark.costly
def test_looks_without_a_fix_are_left_out_and_named(still) -> None:
    """A look at the sky, a pixel that is not a number, and one beside the image."""
    looks = looks_from(AZIMUTHS)
    up = Geodetic.from_degrees(lat=47.0, lon=11.0, height=9000.0)
    shots = list(looks.shots)
    shots[1] = Shot(Pose.looking_at(position=shots[1].pose.position, point=up), time=10.0)
    uvs = np.array(looks.uvs)
    uvs[5], uvs[6] = np.nan, BESIDE
    found = track(Looks(SENSOR, shots, uvs), GROUND, error_model())
    lost = [Status(int(code)).name for code in np.asarray(found.status)[[1, 5, 6]]]
    assert lost == ["rises_away", "invalid_input", "outside_image"]
    assert list(np.flatnonzero(~np.asarray(found.used))) == [1, 5, 6]
    text = str(found)
    assert "Left out 1 of 20 looks (1): rises_away" in text
    assert "Left out 1 of 20 looks (5): invalid_input" in text
    assert "Left out 1 of 20 looks (6): outside_image" in text
    assert list(np.asarray(found.degrees)[:8]) == [0, 0, 2, 2, 2, 0, 0, 2]
    rest = [k for k in range(MANY) if k not in (1, 5, 6)]
    alone = track(Looks(SENSOR, [shots[k] for k in rest], uvs[rest]), GROUND, error_model())
    np.testing.assert_allclose(found.batch.cov_enu, alone.batch.cov_enu, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.filtered.p_ecef[-1], alone.filtered.p_ecef[-1], atol=1e-6)
    with pytest.raises(
        ValueError, match="needs 1 or more looks that can be used; got 0 of 20 looks; the others: 20 inv"
    ):
        track(Looks(SENSOR, looks.shots, np.full((MANY, 2), np.nan)), GROUND, error_model())


@pytest.mark.costly
def test_a_look_beside_the_image_is_left_out_of_a_track_free_in_height() -> None:
    looks = looks_from(np.linspace(0.0, 300.0, 12))
    uvs, rest = np.array(looks.uvs), [k for k in range(12) if k != 4]
    uvs[4] = BESIDE
    found = track(Looks(SENSOR, looks.shots, uvs), None, error_model(0.01), target=FREE)
    assert list(np.flatnonzero(np.asarray(found.status) == Status.outside_image)) == [4]
    kept = Looks(SENSOR, [looks.shots[k] for k in rest], uvs[rest])
    alone = track(kept, None, error_model(0.01), target=FREE)
    np.testing.assert_allclose(found.batch.cov_enu, alone.batch.cov_enu, rtol=1e-8, atol=1e-8)


@pytest.mark.costly
def test_other_numbers_of_looks_compile_nothing(still, caplog) -> None:
    """Neither do other positions, errors, and times."""
    str(still)
    with jax.log_compiles():
        found = track(looks_from(np.linspace(-30.0, 30.0, 51), step=3.0), GROUND, error_model(1.5))
        assert found.overconfidence.shape == (51,)
    assert not [record for record in caplog.records if "Finished XLA compilation" in record.getMessage()]


@pytest.mark.costly
def test_words_of_a_track(still) -> None:
    text = str(still)
    assert text.startswith(
        "Target at rest, on the terrain: 20 looks used of 1 sensor in 190 s. At the last: 47.000000 deg"
    )
    claims = f"{float(still.independent.ce90[-1]):.3g} m, and has {float(still.actual_ce90[-1]):.3g} m"
    assert f"A filter of independent looks claims CE90 {claims}" in text
    assert "Innovations are smaller than the model says" in text  # the pixels are exact
    assert not still.is_consistent
    assert str(still.filtered).startswith("20 of 20 states are determined; the last: 47.000000 deg")


def test_errors_that_are_not_normal_count_by_their_variance() -> None:
    plain = sources.PixelMeasurement.from_pixels(column=2.0, row=3.0)
    heavy = dataclasses.replace(plain, distribution=StudentT(df=5.0))
    one, other = (shared_errors(ErrorModel((source,)), (None,)).columns[0] for source in (heavy, plain))
    np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(one, np.diag([2.0, 3.0]))


@pytest.mark.slow
def test_a_look_from_a_trajectory_through_air_is_that_of_linear_propagation() -> None:
    motion = jaxgeo.Trajectory.steady(looks_from([30.0]).shots[0], velocity_ned=(60.0, 20.0, 0.0))
    model, air, uv = ErrorModel((HEIGHT, sources.TimeTag.from_seconds(0.01))), jaxgeo.Atmosphere(), (1500.0, 1200.0)
    looks = Looks(SENSOR, motion, [uv], times=[0.3], errors=PIXEL, atmosphere=air)
    found = track(looks, GROUND, model)
    whole = ErrorModel((*model.sources, PIXEL))
    alone = propagate(SENSOR, motion, uv, GROUND, whole, time=0.3, atmosphere=air)
    np.testing.assert_allclose(found.batch.cov_enu, alone.cov_enu, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.batch.p_ecef, alone.fix.ecef, atol=1e-6)


@pytest.mark.slow
def test_looks_at_hills_gain_more_than_half() -> None:
    """Of looks at real relief from an arc of 90 degrees: NEES, and the errors of one look and of all."""
    dem, model = jaxgeo.io.example_dem(), error_model()
    place = Geodetic.from_degrees(lat=36.31, lon=-84.22, height=0.0)
    place = dataclasses.replace(place, height=dem.height_at(place))
    shots = []
    for number, azimuth in enumerate(np.radians(np.linspace(0.0, 90.0, 30))):
        lat, lon = 36.31 + 0.036 * math.cos(azimuth), -84.22 + 0.045 * math.sin(azimuth)
        position = Geodetic.from_degrees(lat=lat, lon=lon, height=float(place.height) + 3000.0)
        shots.append(Shot(Pose.looking_at(position=position, point=place), time=5.0 * number))
    looks, nees, errors = Looks(SENSOR, shots, np.tile(MIDDLE, (30, 1))), [], []
    for number in range(60):
        made = simulate_looks(looks, dem, model, jax.random.key(number), position=place)
        found = track(made.looks, dem, model)
        nees.append([nees_of(one, made.p_ecef[-1]) for one in (found.batch, found.filtered[-1], found.independent[-1])])
        errors.append(np.linalg.norm(np.asarray(found.filtered.p_ecef)[[0, -1]] - np.asarray(made.p_ecef[-1]), axis=1))
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 180)
    batch, recursive, independent = np.sum(nees, axis=0)
    assert low < batch < high
    assert low < recursive < high
    assert independent > 2.0 * high
    first, last = np.sqrt(np.mean(np.square(errors), axis=0))
    assert first > 20.0
    assert last < 0.5 * first


# Mistakes of the caller.

PIXEL = sources.PixelMeasurement.from_pixels(column=1.0, row=1.0)


class Odd(AbstractSharing):
    def correlation(self, here: Occasion, there: Occasion) -> Any:
        return jnp.asarray(0.5)


ONE = looks_from([0.0])
TWO = list(looks_from([0.0, 1.0]).shots)
STEADY = jaxgeo.Trajectory.steady(TWO[0], velocity_ned=(1.0, 0.0, 0.0))
HEIGHT = sources.TerrainHeight.from_metres(3.0)
STILL, IN_AIR = AtRest(), AtRest(on_terrain=False)
RASTER = sources.TerrainHeightRaster.from_array(
    np.full((3, 3), 5.0), TangentGrid.centred(POINT, spacing=(30.0, 30.0), shape=(3, 3))
)


def pixel(**options: Any) -> Any:
    return dataclasses.replace(PIXEL, **options)


@pytest.mark.parametrize(
    "looks, errors, target, message",
    [
        (Looks(SENSOR, TWO[::-1], np.zeros((2, 2))), PIXEL, STILL, "in the order of time: look 1 is at 0 s, after loo"),
        ([], PIXEL, STILL, "track needs looks; got an empty list"),
        (Looks(SENSOR, TWO[:1], np.zeros(2)), PIXEL, STILL, r"of shape \(looks, 2\); got shape \(2,\)"),
        (Looks(SENSOR, TWO[:1], np.zeros((2, 2))), PIXEL, STILL, "one for each of the 2 uvs; got 1"),
        (looks_from([0.0], times=[np.nan]), PIXEL, STILL, "the time of look 0 must be finite"),
        (looks_from([0.0], times=[0.0, 1.0]), PIXEL, STILL, r"times must have the shape \(1,\)"),
        (Looks(SENSOR, STEADY, np.zeros((1, 2))), PIXEL, STILL, "times must give the time of each image on the traj"),
        (ONE, pixel(distribution=StudentT(df=2.0)), STILL, "no finite variance"),
        (ONE, pixel(sharing=TimeCorrelated(9.0, beta=2.0)), STILL, "with beta = 2 is no Gauss-Markov process"),
        (looks_from([0, 1], 0.0), pixel(sharing=TimeCorrelated(9.0)), STILL, "all looks are at 0 s, so that errors"),
        (ONE, HEIGHT, IN_AIR, "errors has only heights of the terrain"),
        (ONE, RASTER, IN_AIR, "errors has only heights of the terrain"),
        ([looks_from([0.0], errors=HEIGHT)] * 2, PIXEL, STILL, r"looks\[0\].errors: terrain height is Systematic"),
    ],
)
def test_wrong_values_are_named(looks, errors, target, message) -> None:
    with pytest.raises(ValueError, match=message):
        track(looks, GROUND, ErrorModel((errors,)), target=target)


@pytest.mark.parametrize(
    "looks, errors, target, message",
    [
        (ONE, PIXEL, "still", "target must be a jaxgeo AbstractTarget; got str"),
        (TWO, PIXEL, STILL, r"looks\[0\] must be a jaxgeo Looks; got Shot"),
        (Looks(SENSOR, TWO[:1], None), PIXEL, STILL, "looks.uvs must be numbers, the pixel .* of each look; got None"),
        (looks_from([0.0], times=["a"]), PIXEL, STILL, "looks.times must be numbers, the time of each look in s"),
        (looks_from([0.0], errors=3), PIXEL, STILL, r"looks\[0\].errors: errors must be"),
        (ONE, pixel(sharing=Odd()), STILL, "pixel measurement: track needs errors that are fresh, .* got Odd"),
    ],
)
def test_wrong_kinds_are_named(looks, errors, target, message) -> None:
    with pytest.raises(TypeError, match=message):
        track(looks, GROUND, ErrorModel((errors,)), target=target)


@pytest.mark.costly
def test_fewer_looks_than_unknowns_are_refused() -> None:
    uvs = np.full((MANY, 2), np.nan)
    uvs[3] = MIDDLE
    one = Looks(SENSOR, looks_from(AZIMUTHS).shots, uvs)
    with pytest.raises(
        ValueError, match=r"target at constant velocity, on the terrain has 4 unknowns, .* it needs 2 or"
    ):
        track(one, GROUND, error_model(), target=ConstantVelocity())
    at_once = looks_from(AZIMUTHS, step=0.0)
    with pytest.raises(ValueError, match="needs looks at different times; all are at 0 s"):
        track(at_once, GROUND, scaled(pixel=1.0), target=ConstantVelocity())
    with pytest.raises(ValueError, match="free in height has 3 unknowns"):
        track(looks_from([0.0]), None, error_model(), target=AtRest(on_terrain=False))
    with pytest.raises(TypeError, match="terrain must be a jaxgeo terrain"):
        track(looks_from([0.0]), None, ErrorModel((PIXEL,)))


def test_a_state_is_named_and_indexed() -> None:
    at = Geodetic(lat=jnp.asarray(0.8), lon=jnp.asarray(0.2), height=jnp.asarray(10.0))
    zeros, hit = jnp.zeros(3), jnp.asarray(0, jnp.int8)
    moving = jnp.asarray([3.0, -4.0, 0.0])
    state = TargetState(jnp.asarray(1.0), at, zeros, jnp.diag(jnp.array([4.0, 4.0, 1.0])), moving, jnp.eye(3), hit)
    assert (
        str(state)
        == "45.836624 deg, 11.459156 deg, 10.0 m, CE90 4.29 m, LE90 1.64 m, 5 m/s (sigma 1.41) towards 143 deg"
    )
    assert float(state.ce90) == pytest.approx(2.0 * math.sqrt(-2.0 * math.log(0.1)))
    assert float(state.spherical_error(0.5)) > float(state.circular_error(0.5))
    with pytest.raises(IndexError, match="this is one state"):
        state[0]
    lost = dataclasses.replace(state, status=jnp.asarray(Status.weak_intersection, jnp.int8))
    assert str(lost).startswith("no position: weak_intersection")


SHARINGS = {"fresh": PerImage(), "flight": PerFlight(), "all": Systematic()}


@pytest.mark.parametrize("name, kinds", [("fresh", (2, 0, 0)), ("flight", (0, 4, 0)), ("all", (0, 2, 0))])
def test_flights_are_apart(name: str, kinds: tuple[int, int, int]) -> None:
    """What a flight shares is one set of numbers for each of two sensors, what is systematic one for both."""
    source = dataclasses.replace(PIXEL, sharing=SHARINGS[name])
    assert shared_errors(ErrorModel((source,)), (None, None)).counts == kinds


def test_the_ground_is_one_for_all_sensors() -> None:
    """All sensors look at the same ground: a height error that a flight shares, or that fades, is the same for all."""
    fading = dataclasses.replace(HEIGHT, sharing=TimeCorrelated(100.0, alpha=0.3))
    found = shared_errors(ErrorModel((PIXEL, fading, dataclasses.replace(HEIGHT, sharing=PerFlight()))), (None, None))
    assert found.counts == (2, 2, 1)
    np.testing.assert_array_equal(found.columns[0], found.columns[1])


def hilly(heights: Any) -> jaxgeo.Dem:
    """A terrain of 121 x 121 posts, 30 m apart, about the point, by its heights at places east of it in m."""
    row = heights(np.arange(121) * 30.0 - 1800.0)
    middle = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    grid = TangentGrid.centred(middle, spacing=(30.0, 30.0), shape=(121, 121))
    return jaxgeo.Dem.from_array(np.tile(row, (121, 1)), grid)


def looks_towards(east: float, up: float, above: float, count: int = 1, rows: Any = (0.0,)) -> Looks:
    """Looks from a place in the west at a point `east` of `POINT`, with errors in the rows of their pixels."""
    R, origin = np.asarray(R_ecef_from_enu(POINT)), np.asarray(WGS84.to_ecef(POINT))
    at = lambda *enu: WGS84.to_geodetic(jnp.asarray(origin + R @ np.array(enu)))  # noqa: E731
    shots = [
        Shot(Pose.looking_at(position=at(-1500.0, 30.0 * k, above), point=at(east, 0.0, up)), time=10.0 * k)
        for k in range(count)
    ]
    return Looks(SENSOR, shots, np.array([(MIDDLE[0], MIDDLE[1] + row) for row in rows]))


def ground_errors(pixel: float, *, fading: float = 0.0, flight: float = 0.0) -> ErrorModel:
    """Fresh ones of the pixel (px), and those of the ground (m) that fade and that a flight shares: one structure, and
    so one set of programs, whatever the number of sensors."""
    height = sources.TerrainHeight.from_metres
    fades = height(fading, sharing=TimeCorrelated(1e4))
    return ErrorModel(
        (sources.PixelMeasurement.from_pixels(column=pixel, row=pixel), fades, height(flight, sharing=PerFlight()))
    )


@pytest.mark.costly
def test_looks_in_other_order_within_a_tie_or_by_another_sensor_change_nothing() -> None:
    """One sensor in two records is one flight more: with nothing of its own that a flight shares, the same."""
    model, ground = ground_errors(20.0, fading=3.0, flight=4.0), hilly(lambda x: 600.0 + 0.0 * x)
    whole = looks_from(np.linspace(-40.0, 40.0, 6))
    parts = [Looks(SENSOR, whole.shots[k::2], np.tile(MIDDLE, (3, 1))) for k in (1, 0)]
    one, two = track(whole, ground, model), track(parts, ground, model)
    np.testing.assert_allclose(two.batch.cov_enu, one.batch.cov_enu, rtol=1e-9, atol=1e-9)
    assert list(np.asarray(two.sensor)) == [1, 0, 1, 0, 1, 0]
    assert list(np.asarray(two.look)) == [0, 0, 1, 1, 2, 2]


@pytest.mark.costly
@pytest.mark.parametrize("sharing", ["fading", "flight"])
def test_more_sensors_at_one_place_do_not_level_the_ground(sharing: str) -> None:
    steady, ground = ground_errors(1.0, **{sharing: 20.0}), hilly(lambda x: 600.0 + 0.0 * x)
    one, four = (track([looks_from([0.0, 0.0])] * count, ground, steady).batch for count in (1, 4))
    assert float(four.le90) > 0.98 * float(one.le90) > 30.0


@pytest.mark.slow
@pytest.mark.parametrize("east", [0.0, 1700.0, 1794.0, 1799.0], ids="{:g} m".format)
def test_a_look_beside_the_edge_of_the_terrain_is_that_of_linear_propagation(east: float) -> None:
    ground, errors = hilly(lambda x: 600.0 - 0.3 * x), dataclasses.replace(PIXEL, sigma=np.array([30.0, 30.0]))
    looks = looks_towards(east, -0.3 * east, 1900.0)
    found = track(looks, ground, ErrorModel((errors,))).batch
    one = propagate(SENSOR, looks.shots[0], MIDDLE, ground, ErrorModel((errors,)))
    np.testing.assert_allclose(found.cov_enu, one.cov_enu, rtol=1e-2, atol=1e-2 * float(np.max(one.cov_enu)))


@pytest.mark.costly
def test_the_filter_takes_the_first_looks_anew_where_the_ground_is_curved() -> None:
    """After two and four looks, and at the last, it is the batch of the looks so far."""
    ridge = hilly(lambda x: 600.0 + 150.0 * np.exp(-((x / 200.0) ** 2)))
    rows = (60.0, -70.0, 50.0, -30.0, 10.0, -20.0)
    looks = looks_towards(-60.0, 130.0, 1500.0, 6, rows)
    errors = ground_errors(60.0)
    found = track(looks, ridge, errors)
    for count in (2, 4, 6):
        first = Looks(SENSOR, looks.shots[:count], looks.uvs[:count])
        alone = track(first, ridge, errors).batch
        apart = np.linalg.norm(found.filtered.p_ecef[count - 1] - np.asarray(alone.p_ecef))
        assert apart < 0.02 * math.sqrt(np.trace(np.asarray(alone.cov_enu)))


@pytest.mark.costly
def test_looks_that_fit_two_ridges_are_called_ambiguous() -> None:
    ridges = hilly(lambda x: 600.0 + 200.0 * (np.exp(-(((x + 300) / 80) ** 2)) + np.exp(-(((x - 300) / 80) ** 2))))
    errors = ground_errors(30.0)
    found = track(looks_towards(-290.0, 197.0, 400.0, 5, (30.0, 30.0, -40.0, -40.0, -40.0)), ridges, errors)
    assert found.apart > 500.0
    assert found.is_ambiguous
    assert not found.is_consistent
    assert f"Ambiguous: the filter ends {found.apart:.0f} m away" in str(found)
    clear = track(looks_towards(-290.0, 197.0, 400.0, 5, (3.0, 3.0, -4.0, -4.0, 0.0)), ridges, errors)
    assert not clear.is_ambiguous
