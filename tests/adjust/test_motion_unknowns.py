"""Time offsets and readouts: found from simulated blocks, against finite differences, and named where undetermined."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from jaxgeo import Pose, RollingShutterCamera, Shot
from jaxgeo.adjust import (
    Adjustment,
    Block,
    DeficientBlock,
    Fixed,
    Free,
    InnerConstraints,
    LeastSquares,
    Prior,
    Unknowns,
    adjust,
    calibration,
    motion_by_differences,
    motion_on_trajectory,
    reliability,
    two_step_boresight,
)
from jaxgeo.adjust.equations import known_points, navigation_residuals
from jaxgeo.adjust.measurements import image_points, image_residuals
from jaxgeo.adjust.navigation import joined
from jaxgeo.adjust.problem import prepared
from jaxgeo.adjust.ray_consensus import Rays
from jaxgeo.adjust.values import Step, moved
from jaxgeo.sensor import Trajectory
from jaxgeo.sensor.exposure import image_of_point
from tests.support.moving_block import exposed, indices, late, motion, moving, straight, truth
from tests.support.simulated_block import Simulated, disturbed, simulated

OFFSET, READOUT = 0.02, 0.03  # s
BOTH = Unknowns(time_offset=Free(), readout=Free())
HELD = Unknowns(time_offset=Prior(1e-9), readout=Prior(1e-9))  # the same programs, with both as given
SEEDS = 12


def values_of(found: Adjustment, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(values, standard deviations) of the parameters of that name."""
    chosen = [p for p in found.parameters if p.name == name]
    assert all(p.unit == "s" for p in chosen)
    return np.array([p.value for p in chosen]), np.array([p.sigma for p in chosen])


def check_chi_square(ratios: Any) -> None:
    """Errors over their standard deviations are as large as those of a normal distribution."""
    ratios = np.ravel(ratios)
    low, high = scipy.stats.chi2.interval(0.9999, ratios.size)
    assert low < np.sum(ratios**2) < high


def pose_errors(of: Simulated, found: Adjustment) -> np.ndarray:
    """Errors (n, 6) of adjusted orientations: m, and rad about the camera's axes."""
    turn = np.swapaxes(of.R_frame_from_camera, 1, 2) @ found.images.R_frame_from_camera
    return np.concatenate([found.images.centre - of.centre, Rotation.from_matrix(turn).as_rotvec()], axis=1)


@pytest.mark.costly
def test_exact_measurements_give_offset_readout_and_truth_back() -> None:
    of = late(exposed(truth(), READOUT), np.repeat([0.02, -0.01, 0.05], 5))
    found = adjust(disturbed(moving(of)), BOTH)
    off = truth().offsets(found)
    assert off["centre"] < 1e-5  # m
    assert off["turn"] < 1e-8  # rad
    assert off["points"] < 1e-5  # m
    np.testing.assert_allclose([found.time_offsets[name] for name in ("north", "south", "across")], [0.02, -0.01, 0.05],
                               rtol=0.0, atol=1e-6)  # fmt: skip
    assert found.readouts["camera"] == pytest.approx(READOUT, abs=1e-7)
    assert found.strips["north"].shape == (6,)
    rows = [line for line in found.summary().splitlines() if "time offset, s" in line or "readout, s" in line]
    assert len(rows) == 4
    assert np.linalg.norm(two_step_boresight(found).turn) < 1e-7  # rad: the offsets are taken out of the navigation


@pytest.mark.costly
def test_a_known_readout_is_corrected() -> None:
    of = exposed(truth(), -0.05)
    found = adjust(moving(of, readout=-0.05), HELD)
    assert np.max(np.abs(found.residuals)) < 1e-4  # px
    assert truth().offsets(found)["centre"] < 1e-5  # m
    without = adjust(moving(of), HELD)
    assert np.max(np.abs(without.residuals)) > 1.0  # px
    assert truth().offsets(without)["centre"] > 0.1  # m


@pytest.mark.slow
def test_the_readout_is_that_of_a_rolling_shutter_camera_on_a_trajectory() -> None:
    """Rows of the block, against the forward model of single images on a trajectory."""
    of = exposed(truth(), READOUT)
    velocity, turn_rate = motion()
    image, points = indices(of)
    rolling = RollingShutterCamera.from_readout(of.sensor.camera, readout_time=READOUT)
    sensor = eqx.tree_at(lambda s: s.camera, of.sensor, rolling)

    def one(shot: Shot, velocity: Any, turn_rate: Any, p_ecef: Any) -> Any:
        enu = of.frame.R_local_from_enu(shot.pose.position).T @ velocity
        path = Trajectory.steady(shot, velocity_ned=jnp.stack([enu[1], enu[0], -enu[2]]), body_rates=turn_rate)
        first = shot.time - rolling.line_time * 0.5 * (rolling.height - 1)
        return image_of_point(sensor, path, first, p_ecef, None)[0]

    rows = np.arange(0, len(image), 7)
    of_image = image[rows]
    angles = [np.asarray(x, float)[of_image] for x in (of.shots.pose.heading, of.shots.pose.pitch, of.shots.pose.roll)]
    position = jax.tree.map(lambda x: np.asarray(x, float)[of_image], of.shots.pose.position)
    time = np.asarray(of.shots.time, float)[of_image]
    shots = Shot(Pose(position, *angles), np.zeros((len(rows), 0)), time)
    p_ecef = of.frame.to_ecef(points[rows])
    uv = jax.jit(jax.vmap(one))(shots, velocity[of_image], turn_rate[of_image], p_ecef)
    np.testing.assert_allclose(uv, of.observations.uv[rows], rtol=0.0, atol=1e-5)  # px


@pytest.mark.slow
def test_errors_are_those_of_their_standard_deviations() -> None:
    """Offsets, readouts and orientations over many blocks; held at zero, orientations are biased."""
    of = late(exposed(truth(), READOUT), OFFSET)
    offsets, readouts, poses, biased = [], [], [], []
    for seed in range(SEEDS):
        block = moving(of.noisy(seed))
        found = adjust(block, BOTH)
        value, sigma = values_of(found, "time offset")
        offsets.append((value - OFFSET) / sigma)
        value, sigma = values_of(found, "readout")
        readouts.append((value - READOUT) / sigma)
        for given, kept in ((found, poses), (adjust(block, HELD), biased)):
            error = pose_errors(truth(), given)
            weight = np.linalg.inv(given.covariance_of_images)
            kept.append(np.einsum("ni,nij,nj->n", error, weight, error).mean() / 6.0)
    check_chi_square(offsets)
    check_chi_square(readouts)
    assert 0.8 < np.mean(poses) < 1.2
    assert np.mean(biased) > 20.0


@pytest.mark.costly
def test_derivatives_are_those_of_the_residuals() -> None:
    """Derivatives by point, pose, focal length and readout against central differences, away from the solution."""
    of = late(exposed(truth(), READOUT), OFFSET)
    unknowns = replace(BOTH, focal=Free())
    ready = prepared(disturbed(moving(of, readout=0.2)), unknowns)
    problem, values = ready.problem, ready.problem.start
    _, by_point, by_pose, by_lens, _ = image_points(problem, values, LeastSquares())
    rng = np.random.default_rng(4)
    step = Step(
        pose=jnp.asarray(rng.normal(size=(problem.n, 6)) * [1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3]),
        points=jnp.asarray(rng.normal(size=values.points.shape)),
        lens=jnp.asarray(rng.normal(size=(1, 2)) * [1.0, 1e-2]),
        mount=jnp.zeros((1, 6)),
        strip=jnp.zeros(values.strip.shape),
        common=jnp.zeros(0),
    )
    layout = problem.layout
    predicted = jnp.einsum("aco,oc->ao", by_pose, step.pose[layout.image])
    predicted += jnp.einsum("aco,oc->ao", by_point, step.points[layout.row] * problem.free_point[layout.row])
    predicted += jnp.einsum("aco,c->ao", by_lens, step.lens[0])
    step = eqx.tree_at(lambda s: s.points, step, step.points * problem.free_point)
    size = 1e-4
    ends = [image_residuals(problem, moved(values, jax.tree.map(lambda x, k=k: k * size * x, step), problem.active))
            for k in (1.0, -1.0)]  # fmt: skip
    np.testing.assert_allclose(predicted, (ends[0] - ends[1]) / (2.0 * size), rtol=1e-6, atol=1e-5)


WEAK = {"control": None, "sigma_position": 50.0, "sigma_attitude": 0.1}  # m, rad


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, WEAK], ids=["control", "weak navigation"])
def test_it_is_dense_least_squares(changes: dict[str, Any]) -> None:
    """Covariances and redundancies against a dense Jacobian of the residuals, with priors."""
    unknowns = Unknowns(time_offset={"north": Prior(0.01), "south": Free()}, readout=Prior(0.02), shift=Prior(0.05))
    found = adjust(moving(late(exposed(truth(), READOUT), OFFSET).noisy(1), **changes), unknowns, screen=None)
    assert len(found.log) < 25
    problem, values = found.prepared.problem, found.solution.values
    n, rows = problem.n, values.points.shape[0]

    def residual(x: Any) -> Any:
        lens, strip = x[6 * n + 3 * rows], x[6 * n + 3 * rows + 1 :].reshape(3, 7)
        step = Step(
            pose=x[: 6 * n].reshape(n, 6) * problem.free_pose,
            points=x[6 * n : 6 * n + 3 * rows].reshape(rows, 3) * problem.free_point,
            lens=lens[None, None],
            mount=jnp.zeros((1, 6)),
            strip=strip * problem.strip.free,
            common=jnp.zeros(0),
        )
        there = moved(values, step, problem.active)
        parts = image_residuals(problem, there)[:, found.prepared.order.place], known_points(problem, there)
        priors = [(there.lens[:, -1] - problem.start.lens[:, -1]) * problem.lens.information[:, 0]]
        priors += [there.strip * problem.strip.information]
        return jnp.concatenate([p.ravel() for p in (*parts, navigation_residuals(problem, there), *priors)])

    J = np.asarray(jax.jit(jax.jacfwd(residual))(jnp.zeros(6 * n + 3 * rows + 22)))
    there = np.flatnonzero(np.any(J != 0.0, axis=0))
    scale = 1.0 / np.linalg.norm(J[:, there], axis=0)
    whole = np.linalg.inv((J[:, there] * scale).T @ (J[:, there] * scale)) * np.outer(scale, scale)
    own = np.concatenate([np.arange(6 * n), np.arange(6 * n + 3 * rows, J.shape[1])])
    kept = np.isin(own, there)
    at = np.searchsorted(there, own[kept])
    sigma = np.sqrt(np.diagonal(whole)[at])
    covariance = found.covariance[np.ix_(kept, kept)]
    np.testing.assert_allclose(covariance / np.outer(sigma, sigma), whole[np.ix_(at, at)] / np.outer(sigma, sigma),
                               rtol=0.0, atol=1e-6)  # fmt: skip
    assert [what for _, what in np.array(found.columns)[~kept].tolist()] == [
        "drift east",
        "drift north",
        "drift up",
    ] * 3 + ["time offset"]
    left = 1.0 - np.einsum("ki,ij,kj->k", J[:, there], whole, J[:, there])
    count = 2 * len(found.block.observations)
    in_order = reliability(found).redundancy.T.ravel()
    np.testing.assert_allclose(in_order, left[:count], rtol=0.0, atol=1e-6)
    assert found.redundancy == found.observations - found.unknown_count
    observed = np.any(J != 0.0, axis=1)
    assert found.redundancy == pytest.approx(np.sum(left[observed]), abs=1e-5)


@pytest.mark.costly
def test_what_one_direction_of_flight_cannot_tell_is_named() -> None:
    """An even straight flight gives a time offset and a shift along it together; two directions tell them apart."""
    velocity, turn_rate = straight()
    unknowns = Unknowns(time_offset=Free(), shift=Free())
    alike = {"velocity": velocity, "turn_rate": turn_rate}
    with pytest.raises(DeficientBlock, match=r"time offset of 3 strips.*shift") as caught:
        adjust(moving(truth(), **alike), unknowns)
    assert {"shift north of 2 strips", "shift north of strip north", "shift east of strip across"} & {
        name for one in caught.value.directions for name in one.parts
    }
    of = late(truth(), OFFSET)
    found = adjust(moving(of, strip=np.full(15, "flight")), unknowns)
    assert found.time_offsets["flight"] == pytest.approx(OFFSET, abs=1e-6)


def test_what_is_missing_is_named() -> None:
    of = truth()
    without = replace(of.block(), navigation=replace(of.block().navigation, velocity=None))
    with pytest.raises(ValueError, match=r"time_offset needs the velocity and the turn rate.*velocity=, turn_rate="):
        adjust(without, Unknowns(time_offset=Free()), screen=None)
    with pytest.raises(ValueError, match="readout needs the velocity"):
        replace(without, readout={"camera": 0.01})
    unknown = replace(of.block().navigation, velocity=np.full((15, 3), np.nan))
    with pytest.raises(ValueError, match=r"those of image i00 are not known \(15 such images\)"):
        replace(of.block(), navigation=unknown, readout=0.01)
    with pytest.raises(ValueError, match=r"Unknowns\.time_offset is that of the navigation"):
        prepared(replace(of.block(), navigation=None), Unknowns(time_offset=Free()))
    with pytest.raises(ValueError, match="there is no camera 'other'; known are camera"):
        replace(of.block(), readout={"other": 0.01})
    for wrong in (np.nan, np.inf, 30.0, "0.03", True, [0.01]):
        with pytest.raises(ValueError, match=r"must be a number up to 10, in s \(0\.03 is 30 ms\)"):
            replace(of.block(), readout=wrong)
    with pytest.raises(ValueError, match=r"velocity must be \(3,\) or \(15, 3\).*m/s"):
        of.block(velocity=np.zeros((4, 3)))
    with pytest.raises(ValueError, match="Give navigation or control"):
        adjust(moving(of, readout=0.01), datum=InnerConstraints(), screen=None)
    mixed = {"north": Free(), "south": Fixed()}
    assert prepared(moving(of), Unknowns(time_offset=mixed)).problem.strip.free[:, 6].tolist() == [1.0, 0.0, 0.0]


@pytest.mark.costly
def test_a_calibration_has_no_readout() -> None:
    found = adjust(moving(exposed(truth(), READOUT)), replace(BOTH, focal=Free()))
    calibrated = calibration(found, truth().sensor)
    assert calibrated.source is not None
    assert len(calibrated.source.axes) == 3  # focal length and principal point only


def test_rays_start_from_the_camera_at_the_time_of_their_row() -> None:
    of = exposed(truth(), 0.2)
    assert Rays.of(moving(of)).spread > 10.0
    assert Rays.of(moving(of, readout=0.2)).spread < 1.01
    found = prepared(moving(of, readout=0.2), Unknowns()).problem.start.points
    assert np.all(np.isfinite(found))


def test_motion_by_differences_is_exact_for_parabolas() -> None:
    time = np.array([0.0, 1.0, 3.0, 3.5, 5.0])
    position = np.stack([2.0 * time + 0.3 * time**2, -time, 0.1 * time**2], axis=1)
    axis = np.array([0.0, 0.6, 0.8])
    R = Rotation.from_rotvec((0.05 * time)[:, None] * axis).as_matrix()
    order = np.array([3, 0, 4, 2, 1])
    velocity, turn_rate = motion_by_differences(position[order], R[order], R[order], time[order], np.full(5, "a"))
    inner = order[(time[order] > 0.0) & (time[order] < 5.0)]
    rows = np.isin(order, inner)
    expected = np.stack([2.0 + 0.6 * time, np.full(5, -1.0), 0.2 * time], axis=1)
    np.testing.assert_allclose(velocity[rows], expected[inner], atol=1e-12)
    np.testing.assert_allclose(turn_rate, np.broadcast_to(0.05 * axis, (5, 3)), atol=1e-12)
    still = motion_by_differences(position, R, R, np.zeros(5), np.full(5, "a"))
    assert np.all(np.isnan(still))


def test_motion_on_a_trajectory_is_that_of_its_knots() -> None:
    of = truth()
    shot = jax.tree.map(lambda x: np.asarray(x, float)[3], of.shots)
    path = Trajectory.steady(shot, velocity_ned=np.array([40.0, 5.0, -1.0]), body_rates=np.array([0.01, -0.02, 0.03]))
    time = float(shot.time)
    velocity, turn_rate = motion_on_trajectory(of.frame, of.sensor, path, [time])
    enu = np.asarray(of.frame.R_local_from_enu(shot.pose.position)) @ [5.0, 40.0, 1.0]
    np.testing.assert_allclose(velocity[0], enu, atol=1e-6)
    np.testing.assert_allclose(turn_rate[0], [0.01, -0.02, 0.03], atol=1e-9)
    with pytest.raises(ValueError, match="an image is at"):
        motion_on_trajectory(of.frame, of.sensor, path, [time + 10.0])


@pytest.mark.costly
@pytest.mark.parametrize("kind", ["two_axis", "drone"])
def test_turn_rates_are_those_of_the_head(kind: str) -> None:
    """Of a gimbal that turns on a turning body: against the orientations that follow each other."""
    of = simulated(kind)
    shot = jax.tree.map(lambda x: np.asarray(x, float)[3], of.shots)
    rates = {
        "body_rates": np.array([0.01, -0.02, 0.03]),
        "gimbal_rates": np.array([0.05, -0.04, 0.02][: len(shot.gimbal_readings)]),
    }
    path = Trajectory.steady(shot, velocity_ned=np.array([40.0, 5.0, -1.0]), **rates)
    time, step = float(shot.time), 1e-3
    _, turn_rate = motion_on_trajectory(of.frame, of.sensor, path, [time])
    ends = [np.asarray(of.sensor.sight(path.at(time + k * step)).R_ecef_from_camera) for k in (-1.0, 1.0)]
    spin = Rotation.from_matrix(ends[1] @ ends[0].T).as_rotvec() / (2.0 * step)
    block = of.block()
    navigation = block.navigation
    assert navigation is not None
    in_frame = np.asarray(of.frame.R_ecef_from_local).T @ spin
    np.testing.assert_allclose(turn_rate[0], navigation.R_frame_from_reference[3].T @ in_frame, atol=1e-6)
    head = navigation.R_frame_from_reference[3] @ navigation.R_reference_from_head[3]
    R = head @ np.asarray(of.sensor.mount.R_head_from_camera)
    np.testing.assert_allclose(R, of.R_frame_from_camera[3], atol=1e-12)


@pytest.mark.slow
def test_cameras_have_their_own_readouts() -> None:
    """Two cameras, one that exposes all rows at once; and one camera for each image, solved for with it."""
    of = exposed(truth(), READOUT)
    image, _ = indices(of)
    names = np.array(of.names)
    uv = np.where((image < 5)[:, None], of.observations.uv, truth().observations.uv)
    block = moving(replace(of, observations=replace(of.observations, uv=uv)))
    assert block.navigation is not None
    camera = block.cameras["camera"]
    images = replace(block.images, camera=np.where(np.arange(15) < 5, "rolling", "frame"))
    both = replace(block, images=images, cameras={"rolling": camera, "frame": camera})
    found = adjust(both, Unknowns(readout={"rolling": Free()}, focal=Free()))
    assert found.readouts == {"rolling": pytest.approx(READOUT, abs=1e-7), "frame": 0.0}
    assert {p.whose for p in found.parameters if p.name == "readout"} == {"camera rolling"}
    own = replace(
        block, images=replace(images, camera=names), cameras=dict.fromkeys(names.tolist(), camera),
        readout=dict.fromkeys(names[:5].tolist(), READOUT),
    )  # fmt: skip
    alone = adjust(own, Unknowns(focal=Prior(10.0), readout=Prior(1e-3)))
    assert alone.prepared.problem.own_lens
    assert np.max(np.abs(alone.residuals)) < 1e-4  # px
    assert len([p for p in alone.parameters if p.name == "readout"]) == 15
    assert alone.readouts["i00"] == pytest.approx(READOUT, abs=1e-6)


def test_joined_navigation_keeps_what_is_known_of_the_motion() -> None:
    block: Block = moving(truth())
    navigation = block.navigation
    assert navigation is not None
    both = joined([navigation.of(np.arange(3)), replace(navigation.of(np.arange(3, 15)), velocity=None)])
    assert np.all(np.isfinite(both.velocity[:3]))
    assert np.all(np.isnan(both.velocity[3:]))
    np.testing.assert_array_equal(both.turn_rate, navigation.turn_rate)
