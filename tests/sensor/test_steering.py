"""Gimbals that follow the ground while the platform moves, sweeps that look at a point, and a tilted plumb line."""

from __future__ import annotations

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

from jaxgeo import (
    WGS84,
    Atmosphere,
    ConstantHeight,
    Deflection,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Pose,
    Sensor,
    Shot,
    Trajectory,
    WhiskbroomCamera,
    locate,
)
from jaxgeo.rotations import rotation_vector_from_R
from jaxgeo.sensor import point_shot, point_trajectory

FRAME = FrameCamera.from_pixels(focal_px=3000.0, width=2000, height=1500)
SENSOR = Sensor(FRAME, Gimbal.two_axis(), Mount.nadir(lever_body=np.array([1.0, 0.2, -0.5])))
START = Shot(Pose.from_degrees(lat=46.0, lon=7.0, height=9000.0, heading=30.0, pitch=2.0, roll=-1.0), [0.0, 0.0])
FLIGHT = Trajectory.steady(START, velocity_ned=[150.0, 90.0, 3.0], body_rates=np.deg2rad([2.0, -1.0, 3.0]), after=3.0)
AIR = Atmosphere()


@jax.jit
def _apart(sensor, shot, uv, point, air):
    fix = locate(sensor, shot, uv, ConstantHeight(point.height), atmosphere=air)
    return jnp.linalg.norm(fix.ecef - WGS84.to_ecef(point))


def off(sensor, shot, uv, point, air=None) -> float:
    """m by which a pixel's ray at the point's height misses a point."""
    return float(_apart(sensor, shot, jnp.array(uv), point, air))


def point(north: float = 0.0, height: float = 1200.0) -> Geodetic:
    return Geodetic.from_degrees(lat=45.9 + north, lon=7.25, height=height)


@pytest.mark.costly
def test_a_steered_gimbal_follows_a_way_over_the_ground():
    way = jax.tree.map(lambda *x: jnp.stack(x), *(point(0.0025 * k) for k in range(9)))
    steered = point_trajectory(SENSOR, FLIGHT, way)
    for k in (0, 4, 8):
        assert off(SENSOR, steered.at(FLIGHT.times[k]), (999.5, 749.5), jax.tree.map(lambda x, k=k: x[k], way)) < 1e-6
    np.testing.assert_array_equal(steered.poses.heading, FLIGHT.poses.heading)
    assert np.max(np.abs(steered.gimbal_readings[8] - steered.gimbal_readings[0])) > 0.05  # against the turning body


@pytest.mark.slow
def test_a_steered_gimbal_stares_at_one_point_with_a_pixel():
    steered = point_trajectory(SENSOR, FLIGHT, point(), uv=(900.0, 800.0))
    for time in (FLIGHT.start, FLIGHT.end):
        assert off(SENSOR, steered.at(time), (900.0, 800.0), point()) < 1e-6


@pytest.mark.slow
def test_looking_at_through_the_air_aims_above_the_point():
    pose = START.pose
    straight, bent = (point_shot(SENSOR, pose, point(), atmosphere=air) for air in (None, AIR))
    assert off(SENSOR, bent, (999.5, 749.5), point(), AIR) < 1e-6
    assert off(SENSOR, bent, (999.5, 749.5), point()) > 0.5
    turn = float(jnp.linalg.norm(bent.gimbal_readings - straight.gimbal_readings))
    assert 2e-5 < turn < 1e-3


@pytest.mark.slow
def test_a_sweep_is_pointed_by_its_middle_unless_a_pixel_is_named():
    camera = WhiskbroomCamera.from_metric(
        focal_length=0.3, pixel_pitch=1e-5, width=1001, height=3001, scan_start=0.2, scan_end=0.6, duration=1.0
    )
    sensor = Sensor(camera, Gimbal.three_axis(reference="body"), Mount.forward())
    for uv in (None, (0.0, 0.0)):
        shot = point_shot(sensor, START.pose, point(), uv=uv)
        assert off(sensor, shot, (500.0, 1500.0) if uv is None else uv, point()) < 1e-6


@pytest.mark.costly
def test_what_a_gimbal_cannot_follow_names_the_knot():
    climbing = jax.tree.map(lambda *x: jnp.stack(x), point(), *[point(height=6e4)] * 8)
    with pytest.raises(ValueError, match=r"At knot 1: The gimbal"):
        point_trajectory(SENSOR, FLIGHT, climbing)
    with pytest.raises(ValueError, match=r"9 knots; got shape \(3,\)"):
        point_trajectory(SENSOR, FLIGHT, Geodetic(lat=jnp.zeros(3), lon=jnp.zeros(3), height=jnp.zeros(3)))
    with pytest.raises(ValueError, match="no axes"):
        point_trajectory(Sensor(FRAME, Gimbal.fixed()), FLIGHT, point())


def test_readings_are_put_on_a_trajectory_held_or_knot_by_knot():
    held = FLIGHT.with_readings([0.3, -0.1])
    np.testing.assert_allclose(held.at(1.234).gimbal_readings, [0.3, -0.1], rtol=0, atol=1e-15)
    turned = FLIGHT.with_readings(np.linspace(0.0, 1.0, 9)[:, None] * np.array([0.4, -0.8]))
    np.testing.assert_allclose(turned.at(0.0).gimbal_readings, [0.1, -0.2], rtol=0, atol=1e-15)
    for wrong in ([0.1, np.nan], np.zeros((3, 2))):
        with pytest.raises(ValueError, match=r"finite|shape"):
            FLIGHT.with_readings(wrong)


def test_steady_motion_is_what_was_given_at_every_time():
    velocity, rates = np.array([150.0, 90.0, 3.0]), np.deg2rad([2.0, -1.0, 3.0])
    np.testing.assert_allclose(FLIGHT.velocity_ned_at(0.0), velocity, rtol=0, atol=1e-6)
    for time in (-0.9, 0.0, 2.7):
        np.testing.assert_allclose(FLIGHT.body_rates_at(time), rates, rtol=0, atol=1e-12)
    now = FLIGHT.at(0.0)
    assert float(jnp.linalg.norm(WGS84.to_ecef(now.pose.position) - WGS84.to_ecef(START.pose.position))) < 5e-9
    np.testing.assert_allclose(now.pose.R_ned_from_body, START.pose.R_ned_from_body, rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match=r"velocity_ned must have the shape \(3,\)"):
        Trajectory.steady(START, velocity_ned=[1.0, 2.0])


XI, ETA = 25.0, -18.0  # arc seconds
TILTED = Deflection.from_arcseconds(xi=XI, eta=ETA)


@pytest.mark.costly
@pytest.mark.parametrize("reference", ["body", pytest.param("level", marks=pytest.mark.slow)])
def test_a_deflected_vertical_moves_what_lies_below(reference):
    """A plumb line whose zenith leans north and east meets the ground south and west."""
    gimbal = Gimbal.three_axis(reference=reference)
    sensor, down = Sensor(FRAME, gimbal, Mount.forward()), [0.0, -np.pi / 2, 0.0]
    height = 5000.0
    fixes = []
    for deflection in (Deflection.from_arcseconds(xi=0.0, eta=0.0), TILTED):
        pose = Pose.from_degrees(lat=46.0, lon=7.0, height=height, deflection=deflection)
        fixes.append(locate(sensor, Shot(pose, down), (999.5, 749.5), ConstantHeight(0.0)).position)
    north = float(fixes[1].lat - fixes[0].lat) * 6.3674e6  # the meridian's radius there
    east = float(fixes[1].lon - fixes[0].lon) * 6.3885e6 * np.cos(np.deg2rad(46.0))
    expected = -np.deg2rad(np.array([XI, ETA]) / 3600.0) * height
    np.testing.assert_allclose([north, east], expected, rtol=0, atol=2e-3)


@pytest.mark.costly
def test_the_deflection_is_a_least_rotation_and_its_derivative_is_exact():
    turn = rotation_vector_from_R(TILTED.R_ned_from_level)
    assert abs(float(turn[2])) < 1e-15  # none about the vertical: headings stay
    assert float(jnp.linalg.norm(turn)) == pytest.approx(np.deg2rad(np.hypot(XI, ETA) / 3600.0), rel=1e-9)

    def below(xi):
        pose = Pose(START.pose.position, 0.3, 0.1, 0.0, Deflection(xi, 1e-4))
        return locate(SENSOR, Shot(pose, [0.5, 0.0]), (999.5, 749.5), ConstantHeight(0.0)).ecef

    below_and_J, step = jax.jit(lambda xi: jax.jvp(below, (xi,), (1.0,))), 1e-4
    J = below_and_J(1e-4)[1]
    difference = (below_and_J(1e-4 + step)[0] - below_and_J(1e-4 - step)[0]) / 2.0
    np.testing.assert_allclose(J * step, difference, rtol=0, atol=1e-5)
    for wrong in (500.0, np.nan):
        with pytest.raises(ValueError, match="arc seconds"):
            Deflection.from_arcseconds(xi=wrong, eta=0.0)


@pytest.mark.costly
def test_a_trajectory_keeps_its_deflection():
    times = np.arange(9.0)
    heading = 0.2 + 0.05 * times
    position = Geodetic(lat=0.8 + 1e-5 * times, lon=np.full(9, 0.1), height=np.full(9, 4000.0))
    leaning = Deflection(xi=1e-4 * (1.0 + times), eta=np.full(9, -5e-5))
    flight = Trajectory.from_knots(times, Pose(position, heading, 0.0 * heading, 0.0 * heading, leaning))
    pose = flight.at(1.0).pose
    np.testing.assert_allclose([pose.heading, pose.pitch, pose.roll], [0.25, 0.0, 0.0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(flight.at(1.5).pose.deflection.xi, 2.5e-4, rtol=0, atol=1e-18)
    steady = Trajectory.steady(Shot(pose, np.zeros(0)), velocity_ned=[1.0, 0.0, 0.0])
    np.testing.assert_allclose(steady.at(0.0).pose.R_ned_from_body, pose.R_ned_from_body, rtol=0, atol=1e-14)
    np.testing.assert_allclose(steady.at(0.0).pose.heading, 0.25, rtol=0, atol=1e-9)


def test_a_steady_turn_of_more_than_a_circle_is_itself_and_a_wild_one_is_refused():
    shot = Shot(Pose.from_degrees(lat=50.0, lon=8.0, height=1000.0))
    turning = Trajectory.steady(
        shot, velocity_ned=[0.0, 0.0, 0.0], body_rates=np.deg2rad([0.0, 0.0, 60.0]), before=1.0, after=7.0
    )
    for time in (0.0, 1.0, 2.0, 6.9):
        heading = float(turning.at(time).pose.heading)
        assert abs(np.angle(np.exp(1j * (heading - np.deg2rad(60.0 * time))))) < 1e-12
    with pytest.raises(ValueError, match=r"turns by 1500\.0 deg"):
        Trajectory.steady(shot, velocity_ned=[0.0, 0.0, 0.0], body_rates=np.deg2rad([0.0, 0.0, 6000.0]))


def test_readings_that_wrap_are_refused():
    yaw = np.deg2rad([178.0, 179.0, -180.0, -179.0, -178.0, -177.0, -176.0, -175.0, -174.0])
    readings = np.stack([yaw, 0.0 * yaw, 0.0 * yaw], axis=1)
    pose = Pose(Geodetic(lat=0.8 + 1e-6 * np.arange(9), lon=np.full(9, 0.1), height=np.full(9, 1e3)))
    with pytest.raises(ValueError, match=r"axis 0 jump by 359\.0 deg up to knot 2"):
        Trajectory.from_knots(np.arange(9.0), pose, readings)
    flight = Trajectory.from_knots(np.arange(9.0), pose, np.unwrap(readings, axis=0))
    np.testing.assert_allclose(flight.at(1.5).gimbal_readings[0], np.deg2rad(179.5), rtol=0, atol=1e-12)
    for change in (flight.velocity_ned_at, flight.body_rates_at):
        assert np.all(np.isfinite(change(8.0)))
        assert np.all(np.isnan(change(8.1)))


@pytest.mark.parametrize(
    "ask, kind, words",
    [
        (lambda: point_shot(SENSOR, FLIGHT, point()), TypeError, r"pose must be.*trajectory\.at"),
        (lambda: SENSOR.perspective_centre(FLIGHT), TypeError, r"shot must be.*trajectory\.at"),
        (lambda: point_trajectory(SENSOR, START, point()), TypeError, "trajectory must be"),
        (lambda: Trajectory.steady(FLIGHT, velocity_ned=[0.0, 0.0, 0.0]), TypeError, "shot must be"),
        (lambda: Trajectory.steady(START, velocity_ned=[0.0, np.nan, 0.0]), ValueError, "velocity_ned must be finite"),
        (lambda: Trajectory.steady(START, velocity_ned=[0.0] * 3, gimbal_rates=[1.0]), ValueError, "gimbal_rates"),
        (
            lambda: Trajectory.steady(START, velocity_ned=[0.0] * 3, before=-1.0, after=0.5),
            ValueError,
            "before and after",
        ),
        (lambda: Trajectory.from_knots([0.0, 1.0], START.pose, body_rates=[[9.0, 0.0, 0.0]] * 2), ValueError, "515"),
    ],
)
def test_mistakes_are_named(ask, kind, words):
    with pytest.raises((kind, TypeCheckError)) as refused:  # the checker of types is on in tests, not for users
        ask()
    assert isinstance(refused.value, TypeCheckError) or re.search(words, str(refused.value), flags=re.DOTALL)
