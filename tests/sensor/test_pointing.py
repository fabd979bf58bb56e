"""Gimbal readings that look at a point: through lever arms, boresight, gains and distortion, or an error in words."""

from __future__ import annotations

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Pose, Sensor, boresight_from_degrees, point_shot

SIZE = {"focal_px": 9000.0, "width": 8000, "height": 6000}
CAMERA = FrameCamera.from_pixels(**SIZE)
LENS = FrameCamera.from_pixels(**SIZE, distortion=BrownConrady(k1=-0.12))
HELD = {
    "R_body_from_base": boresight_from_degrees(heading=1.0, pitch=-2.0, roll=0.5),
    "lever_body": np.array([3.0, -1.0, 0.5]),
    "lever_head": np.array([0.2, 0.1, -0.3]),
}
PAN_TILT = Gimbal.from_degrees(
    axes={"pan": "z", "tilt": "y"}, gain=(0.5, 1.0), offset=(30.0, 0.0), limits=(-720.0, 720.0)
)
ROLL_BEFORE_PITCH = Gimbal.from_degrees(
    axes={"yaw": "z", "roll": "x", "pitch": "y"}, limits=((-180, 180), (-90, 90), (-90, 90)), reference="level"
)
SENSORS = {
    "mirror": Sensor(LENS, Gimbal.mirror_two_axis(), Mount.nadir(**HELD)),
    "drone, roll before pitch": Sensor(CAMERA, ROLL_BEFORE_PITCH, Mount.forward(**HELD)),
    "pan and tilt, pan geared down": Sensor(CAMERA, PAN_TILT, Mount.forward(**HELD)),
}
POSE = Pose.from_degrees(lat=29.0, lon=89.0, height=9000.0, heading=-102.0, pitch=2.8, roll=-1.4)
POINT = Geodetic.from_degrees(lat=29.05, lon=88.98, height=4000.0)  # to the right, 49 deg off nadir
WIDE = Sensor(CAMERA, Gimbal.two_axis(), Mount.nadir(**HELD))
NARROW = Sensor(CAMERA, Gimbal.two_axis(limits=np.deg2rad([[70.0, 80.0], [-10.0, 10.0]])), Mount.nadir(**HELD))
LENS_ON_FRAME = Sensor(LENS, Gimbal.two_axis(), Mount.nadir())


def points_to_the_right(count: int = 24) -> Geodetic:
    """Points within reach of a frame that looks to the right and down, in all distances from 3 to 40 km."""
    rng = np.random.default_rng(8)
    right, ahead = np.geomspace(3e3, 4e4, count), rng.uniform(-1.5e3, 1.5e3, count)
    heading = -1.78
    north = ahead * np.cos(heading) - right * np.sin(heading)
    east = ahead * np.sin(heading) + right * np.cos(heading)
    offsets = np.stack([north, east, rng.uniform(4e3, 8.9e3, count)], axis=1)
    R, origin = np.asarray(R_ecef_from_ned(POSE.position)), np.asarray(WGS84.to_ecef(POSE.position))
    return jax.vmap(WGS84.to_geodetic)(jnp.asarray(origin + offsets @ R.T))


@jax.jit
@functools.partial(jax.vmap, in_axes=(None, None, 0, None))
def look_and_project(sensor, pose, point, uv):
    shot = point_shot(sensor, pose, point, uv=uv)
    seen, _ = sensor.project_ecef(shot, WGS84.to_ecef(point))
    return shot.gimbal_readings, seen, sensor.gimbal.inside_limits(shot.gimbal_readings)


@pytest.mark.costly
@pytest.mark.parametrize(
    "name", [n if n.startswith("drone") else pytest.param(n, marks=pytest.mark.slow) for n in SENSORS]
)
def test_the_pixel_that_should_see_the_point_does(name):
    sensor, points = SENSORS[name], points_to_the_right()
    for uv in (jnp.asarray(CAMERA.principal_px), jnp.array([7000.0, 900.0])):
        _, seen, inside = look_and_project(sensor, POSE, points, uv)
        assert np.all(inside)
        np.testing.assert_allclose(seen, np.tile(uv, (24, 1)), rtol=0, atol=1e-8)  # px; ECEF's last bit is 3e-9 px


def test_an_axis_that_is_not_needed_is_held():
    drone = SENSORS["drone, roll before pitch"]
    readings, _, _ = look_and_project(drone, POSE, points_to_the_right(), jnp.array([7000.0, 900.0]))
    assert np.all(readings[:, 1] == 0.0)


@pytest.mark.slow
def test_held_axes_and_the_search_start_at_given_readings():
    drone = Sensor(CAMERA, Gimbal.three_axis(), Mount.forward(**HELD))
    shot = point_shot(drone, POSE, POINT, readings=np.array([0.5, -0.5, 0.1]))
    assert shot.gimbal_readings[2] == 0.1
    np.testing.assert_allclose(drone.to_camera(shot, WGS84.to_ecef(POINT))[:2], 0.0, rtol=0, atol=1e-8)  # m


@pytest.mark.costly
def test_the_optical_axis_is_the_default():
    shot = point_shot(WIDE, POSE, POINT, time=7.0)
    sight = WIDE.to_camera(shot, WGS84.to_ecef(POINT))
    np.testing.assert_allclose(sight[:2] / sight[2], 0.0, rtol=0, atol=1e-12)
    assert sight[2] > 0.0
    assert shot.time == 7.0


def readings_of_changes():
    """Readings as a function of changes of pose and point, in units of 1e-3 rad of attitude, 1e-5 rad and 100 m."""
    flat, unravel = ravel_pytree((POSE, POINT))
    unit = jnp.array([1e-5, 1e-5, 100.0, 1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 100.0])
    return lambda x: point_shot(WIDE, *unravel(flat + unit * x)).gimbal_readings


STEP, AROUND = 0.1, 0.1 * jnp.concatenate([jnp.eye(9), -jnp.eye(9), jnp.zeros((1, 9))])


@pytest.mark.slow
def test_derivatives_equal_differences():
    """Values around and derivatives in the middle, by one program."""
    f, none = readings_of_changes(), jnp.zeros((9, 9))
    places, directions = jnp.concatenate([AROUND[:18], none]), jnp.concatenate([none, none, jnp.eye(9)])
    values, changes = jax.jit(jax.vmap(lambda place, along: jax.jvp(f, (place,), (along,))))(places, directions)
    first, differences = changes[18:], (values[:9] - values[9:18]) / (2 * STEP)
    np.testing.assert_allclose(first, differences, rtol=0, atol=1e-6 * np.abs(first).max())


@pytest.mark.slow
def test_second_derivatives_equal_differences():
    first = jax.jacfwd(readings_of_changes())
    slopes = jax.jit(jax.vmap(first))(AROUND)
    second = jax.jit(jax.jacfwd(first))(jnp.zeros(9))
    differences = jnp.moveaxis(slopes[:9] - slopes[9:18], 0, -1) / (2 * STEP)
    np.testing.assert_allclose(second, differences, rtol=0, atol=1e-4 * np.abs(second).max())


MISTAKES = {
    "no axes": (lambda: point_shot(Sensor(CAMERA), POSE, POINT), "gimbal has no axes.* turn the platform"),
    "out of limits": (
        lambda: point_shot(NARROW, POSE, POINT),
        r"would have to go to outer .*, inner .* deg.* outside its limits, outer 70\.\.80, inner -10\.\.10 deg",
    ),
    "out of reach": (
        lambda: point_shot(Sensor(CAMERA, Gimbal.from_degrees(axes={"pan": "z"}), Mount.forward()), POSE, POINT),
        r"cannot look at the point: the best it finds, pan .* deg, misses it by [1-9]\d?\.\d+ deg",
    ),
    "pixel without a ray": (
        lambda: point_shot(LENS_ON_FRAME, POSE, POINT, uv=np.array([1e7, 0.0])),
        "Pixel uv cannot be put on the point. The pixel, or the image of the point, is outside the image",
    ),
    "pose not finite": (
        lambda: point_shot(NARROW, Pose(POSE.position, np.nan, 0.0, 0.0), POINT),
        r"input of point_shot \(pose, point, uv, readings, atmosphere\) must be finite",
    ),
    "readings of another gimbal": (
        lambda: point_shot(NARROW, POSE, POINT, readings=np.zeros(3)),
        r"2 axes \(outer, inner\).* got \(3,\)",
    ),
}


@pytest.mark.costly
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow) if n in ("pixel without a ray", "out of reach") else n for n in MISTAKES],
)
def test_a_point_it_cannot_look_at_is_an_error_in_words(name):
    mistake, message = MISTAKES[name]
    with pytest.raises(ValueError, match=message):
        mistake()


def test_traced_it_is_not_a_number_instead():
    drone = SENSORS["drone, roll before pitch"]
    upwards = eqx.tree_at(lambda s: s.gimbal.limits, drone, jnp.asarray(drone.gimbal.limits).at[2].set([0.5, 0.6]))
    readings, _, _ = look_and_project(upwards, POSE, points_to_the_right(), jnp.array([7000.0, 900.0]))
    assert np.all(np.isnan(readings))
