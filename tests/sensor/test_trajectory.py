"""Trajectories: laws of the interpolation, derivatives by everything in it, and what is refused."""

from __future__ import annotations

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import WGS84, ConstantHeight, FrameCamera, Geodetic, Gimbal, Pose, Sensor, Shot, Status, Trajectory, locate
from jaxgeo.earth import R_ecef_from_ned
from jaxgeo.rotations import (
    R_from_rotation_vector,
    heading_pitch_roll_from_R,
    rotation_rate_from_body_rate,
    rotation_vector_from_R,
)

SENSOR = Sensor(FrameCamera.from_pixels(focal_px=3000.0, width=2000, height=1500), Gimbal.two_axis())
START, R_START = (
    WGS84.to_ecef(Geodetic(lat=0.7, lon=0.3, height=9000.0)),
    R_ecef_from_ned(Geodetic(lat=0.7, lon=0.3, height=0.0)),
)


def motion(t):
    """A smooth flight: position in ECEF m, R_ecef_from_body, gimbal readings."""
    ned = jnp.stack([210.0 * t + 3.0 * jnp.sin(0.4 * t), 40.0 * t + 5.0 * jnp.cos(0.3 * t), 2.0 * jnp.sin(0.5 * t)])
    turn = jnp.stack([0.05 * jnp.sin(0.7 * t), 0.03 * jnp.cos(0.5 * t), 0.4 + 0.02 * t + 0.03 * jnp.sin(0.3 * t)])
    readings = jnp.stack([1.1 + 0.02 * jnp.sin(0.2 * t), 0.05 * jnp.cos(0.3 * t)])
    return START + R_START @ ned, R_START @ R_from_rotation_vector(turn), readings


def pose_of(p_ecef, R_ecef_from_body):
    position = WGS84.to_geodetic(p_ecef)
    return Pose(position, *heading_pitch_roll_from_R(R_ecef_from_ned(position).T @ R_ecef_from_body))


@jax.jit
def knots_at(times):
    p, R, readings = jax.vmap(motion)(times)
    return jax.vmap(pose_of)(p, R), readings


def times_of(interval: float) -> jax.Array:
    """Nine knots about 4 s: always as many, so that nothing is compiled twice."""
    return 4.0 + interval * jnp.arange(-4.0, 5.0)


def flown(interval: float, **given) -> Trajectory:
    poses, readings = knots_at(times_of(interval))
    return Trajectory.from_knots(times_of(interval), poses, readings, **given)


@jax.jit
def errors(trajectory: Trajectory) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Largest errors of position in m, attitude and readings in rad, between the knots and away from the ends."""
    times = jnp.linspace(trajectory.times[2], trajectory.times[6], 173)
    p, R, readings = jax.vmap(motion)(times)
    shots = jax.vmap(trajectory.at)(times)
    R_found = jax.vmap(lambda pose: R_ecef_from_ned(pose.position) @ pose.R_ned_from_body)(shots.pose)
    apart = jax.vmap(lambda a, b: jnp.linalg.norm(rotation_vector_from_R(a.T @ b)))(R, R_found)
    away = jnp.linalg.norm(jax.vmap(WGS84.to_ecef)(shots.pose.position) - p, axis=1)
    return jnp.max(away), jnp.max(apart), jnp.max(jnp.abs(shots.gimbal_readings - readings))


def test_every_knot_is_met():
    trajectory = flown(0.5)
    for k in (0, 1, 4, 8):
        shot = trajectory.at(trajectory.times[k])
        pose = jax.tree.map(lambda x, k=k: x[k], trajectory.poses)
        np.testing.assert_allclose(WGS84.to_ecef(shot.pose.position), WGS84.to_ecef(pose.position), rtol=0, atol=5e-9)
        np.testing.assert_allclose(shot.pose.R_ned_from_body, pose.R_ned_from_body, rtol=0, atol=1e-13)
        np.testing.assert_allclose(shot.gimbal_readings, trajectory.gimbal_readings[k], rtol=0, atol=1e-15)


def test_the_interpolation_is_of_third_order():
    coarse, fine = errors(flown(0.5)), errors(flown(0.25))
    assert fine[0] < 1e-3
    assert fine[1] < 2e-4
    for large, small in zip(coarse, fine, strict=True):
        assert large / small > 7.0


def given_rates(interval: float) -> dict:
    """What an inertial system would say at the knots."""

    velocity, rates = velocity_and_rates(times_of(interval))
    return {"velocity_ned": velocity, "body_rates": rates}


@jax.jit
@jax.vmap
def velocity_and_rates(t):
    (p, R, _), (v, turn, _) = jax.jvp(motion, (t,), (jnp.ones_like(t),))
    spin = R.T @ turn
    return R_ecef_from_ned(WGS84.to_geodetic(p)).T @ v, jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])


@pytest.mark.costly
def test_with_velocities_and_rates_it_is_of_fourth_order():
    coarse, fine = (errors(flown(interval, **given_rates(interval))) for interval in (1.0, 0.5))
    for k in (0, 1):
        assert coarse[k] / fine[k] > 13.0
        assert fine[k] < errors(flown(0.5))[k]


@pytest.mark.costly
def test_velocity_and_rates_are_those_of_the_motion_and_have_no_steps():
    trajectory = flown(0.25)
    times = np.array([3.5, 3.9, 4.25 - 1e-9, 4.25 + 1e-9, 3.1, 3.3, 4.0, 4.4, 4.8])
    for t, expected, rates in zip(times, *velocity_and_rates(times), strict=True):
        np.testing.assert_allclose(trajectory.velocity_ned_at(t), expected, rtol=0, atol=2e-2)
        np.testing.assert_allclose(trajectory.body_rates_at(t), rates, rtol=0, atol=2e-3)
    steps = [
        np.asarray(f(4.25 + 1e-9) - f(4.25 - 1e-9)) for f in (trajectory.velocity_ned_at, trajectory.body_rates_at)
    ]
    assert max(np.max(np.abs(step)) for step in steps) < 1e-6


@pytest.mark.costly
def test_a_steady_turn_is_exact():
    """About one axis at one rate, in intervals of 0.9 rad."""
    times, axis = np.append(np.arange(9.0), 2.37), jnp.array([0.3, -0.5, 0.6])

    @jax.jit
    @jax.vmap
    def turned(t):
        R = R_START @ R_from_rotation_vector(t * axis)
        return pose_of(START, R), R

    poses, R = turned(times)
    shot = Trajectory.from_knots(times[:9], jax.tree.map(lambda x: np.asarray(x)[:9], poses)).at(2.37)
    found = np.asarray(R_ecef_from_ned(shot.pose.position)) @ np.asarray(shot.pose.R_ned_from_body)
    np.testing.assert_allclose(found, R[9], rtol=0, atol=1e-13)


def test_a_frame_camera_on_a_trajectory_is_its_shot():
    trajectory, ground = flown(0.5), ConstantHeight(200.0)
    pose = jax.tree.map(lambda x: x[5], trajectory.poses)
    still = Shot(pose, trajectory.gimbal_readings[5], trajectory.times[5])
    hit = jax.jit(lambda shot, uv: locate(SENSOR, shot, uv, ground).ecef)
    for uv in ((0.0, 0.0), (999.5, 749.5)):
        a, b = (hit(shot, jnp.array(uv)) for shot in (still, trajectory.at(trajectory.times[5])))
        np.testing.assert_allclose(a, b, rtol=0, atol=2e-8)


@pytest.mark.slow
def test_derivatives_by_time_velocity_rates_and_every_knot_equal_differences():
    trajectory = flown(1.0, **given_rates(1.0))
    ground = ConstantHeight(200.0)

    def hit(moved, time):
        return locate(SENSOR, moved.at(time), (300.0, 1200.0), ground).ecef

    time = jnp.asarray(3.4)
    run = jax.jit(hit)
    by_knots, by_time = jax.jit(jax.jacrev(hit, argnums=(0, 1)))(trajectory, time)
    steps = {"times": 1e-3, "lat": 1e-7, "lon": 1e-7, "height": 0.1, "gimbal_readings": 1e-5, "velocity_ned": 0.1}

    def differs(change, J, step):
        moved = [run(*change(k * step)) for k in (-2, -1, 1, 2)]
        difference = (8 * (moved[2] - moved[1]) - (moved[3] - moved[0])) / 12
        np.testing.assert_allclose(J * step, difference, rtol=0, atol=1e-6)  # m

    differs(lambda e: (trajectory, time + e), by_time, 1e-3)
    paths = jax.tree_util.tree_flatten_with_path(trajectory)[0]
    jacobians = jax.tree.leaves(by_knots)
    rng, moving = np.random.default_rng(0), 0
    for number, (path, leaf) in enumerate(paths):
        name = str(path[-1]).strip(".")
        for knot in (2, 3, 4, 5):
            direction = np.zeros(leaf.shape)
            direction[knot] = rng.normal(size=leaf.shape[1:])
            J = jnp.sum(jacobians[number] * direction[None], axis=tuple(range(1, jacobians[number].ndim)))

            def change(e, number=number, direction=direction):
                leaves = [x + e * direction if k == number else x for k, (_, x) in enumerate(paths)]
                return jax.tree.unflatten(jax.tree.structure(trajectory), leaves), time

            differs(change, J, steps.get(name, 1e-5))
            moving += float(jnp.linalg.norm(J)) > 1e-9
    assert moving >= 2 * len(paths)  # the knots on both sides


@pytest.mark.costly
def test_before_and_after_there_is_nothing():
    trajectory, ground = flown(1.0), ConstantHeight(0.0)

    @jax.jit
    @functools.partial(jax.grad, has_aux=True)
    def slope_and_status(time):
        fix = locate(SENSOR, trajectory.at(time), (10.0, 10.0), ground)
        return jnp.where(fix.ok, fix.slant_range, 0.0), fix.status

    found = [slope_and_status(time) for time in (-1e-6, 0.0, 4.0, 8.0, 8.0 + 1e-6, np.nan)]
    names = [Status(int(status)) for _, status in found]
    assert names == [Status.invalid_input, *[Status.hit] * 3, *[Status.invalid_input] * 2]
    assert np.all(np.isfinite([slope for slope, _ in found]))


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda t: t.at[3].set(1.5), "knot 3 is at 1.5 s, after one at 2 s"),
        (lambda t: t.at[3].set(2.0), "increase"),
        (lambda t: t.at[5:].add(40.0), "gap of 41 s before knot 5"),
        (lambda t: t.at[2].set(jnp.nan), "finite"),
        (lambda t: t[:-1], "8 entries"),
        (lambda t: t[:1], "at least two"),
    ],
)
def test_what_cannot_be_flown_is_refused(change, words):
    trajectory = flown(1.0)
    with pytest.raises(ValueError, match=words):
        Trajectory.from_knots(change(trajectory.times), trajectory.poses, trajectory.gimbal_readings)


def test_two_knots_and_plain_numbers_will_do():
    poses, _ = knots_at(jnp.array([0.0, 1.0]))
    middle = Trajectory.from_knots([0.0, 1.0], poses).at(0.5)
    ends = jax.vmap(WGS84.to_ecef)(poses.position)
    np.testing.assert_allclose(WGS84.to_ecef(middle.pose.position), jnp.mean(ends, axis=0), rtol=0, atol=1e-8)


def test_degrees_for_radians_are_noticed():
    trajectory = flown(1.0)
    wild = eqx.tree_at(lambda p: p.heading, trajectory.poses, jnp.arange(9) * 2.5)
    with pytest.raises(ValueError, match="rad"):
        Trajectory.from_knots(trajectory.times, wild)


@jax.jit
def back_and_turning(rotation, rate):
    R, turn = jax.jvp(R_from_rotation_vector, (rotation,), (rotation_rate_from_body_rate(rotation, rate),))
    return rotation_vector_from_R(R), R, turn


@pytest.mark.costly
@pytest.mark.parametrize("length", [0.0, 1e-9, 1e-4, 0.7e-4, 0.3, 2.0, 3.0])
def test_rotation_vectors_come_back_and_their_rates_follow_the_body(length):
    rotation, rate = length * np.array([0.6, -0.48, 0.64]), np.array([0.2, 0.5, -0.3])
    back, R, turn = back_and_turning(rotation, rate)
    np.testing.assert_allclose(back, rotation, rtol=0, atol=5e-15)
    spin = np.asarray(R).T @ np.asarray(turn)
    np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], rate, rtol=0, atol=1e-10)
