"""The staircase of frames from pixel to Earth, held against NumPy, and its round trip over random sensors."""

from __future__ import annotations

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.spatial.transform import Rotation
from support.derivatives import first_derivatives_at_zero

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.platform import Station
from jaxgeo.status import Status

SIZE = {"focal_px": (9000.0, 9100.0), "width": 8000, "height": 6000}
PINHOLE = FrameCamera.from_pixels(**SIZE)
LENS = FrameCamera.from_pixels(**SIZE, distortion=BrownConrady(k1=-0.12, p1=1e-3, p2=-2e-3))
LEVERS = {"lever_body": np.array([1.5, -0.4, 0.8]), "lever_head": np.array([0.11, 0.02, -0.07])}
BORESIGHT = Rotation.from_euler("ZYX", [1.0, -0.5, 0.7], degrees=True).as_matrix()
SENSORS = {
    "fixed, looking down": Sensor(PINHOLE),
    "two axes in body": Sensor(LENS, Gimbal.mirror_two_axis(), Mount.nadir(R_body_from_base=BORESIGHT, **LEVERS)),
    "three axes in level": Sensor(PINHOLE, Gimbal.three_axis(), Mount.forward(R_body_from_base=BORESIGHT, **LEVERS)),
}
TWO_AXES = SENSORS["two axes in body"]
ROWS = pytest.mark.parametrize("name", SENSORS)
COUNT = 50


def random_shots(sensor: Sensor) -> Shot:
    rng = np.random.default_rng(6)
    position = Geodetic(
        lat=rng.uniform(-1.57, 1.57, COUNT), lon=rng.uniform(-3.2, 3.2, COUNT), height=rng.uniform(-100, 2e4, COUNT)
    )
    angles = [rng.uniform(-limit, limit, COUNT) for limit in (3.1, 1.5, 3.1)]
    readings = rng.uniform(-1.5, 1.5, (COUNT, len(sensor.gimbal.axes)))
    return Shot(Pose(position, *angles), readings, np.zeros(COUNT))


def one(shots: Shot, index: int) -> Shot:
    return jax.tree.map(lambda leaf: leaf[index], shots)


@jax.jit
@functools.partial(jax.vmap, in_axes=(None, 0, 0, 0))
def out_and_back(sensor, shot, uv, distance):
    origin, direction, status = sensor.ray_ecef(shot, uv)
    back, status_back = sensor.project_ecef(shot, origin + distance * direction)
    return origin, direction, status, back, status_back


def pixels_of_all_shots() -> np.ndarray:
    return np.random.default_rng(7).uniform([0.0, 0.0], [7999.0, 5999.0], (COUNT, 2))


def literal(sensor: Sensor, shot: Shot, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(origin, direction) in ECEF with nothing but SciPy's rotations."""
    pose, mount, gimbal = shot.pose, sensor.mount, sensor.gimbal
    R_ned_from_body = Rotation.from_euler("ZYX", [pose.heading, pose.pitch, pose.roll]).as_matrix()
    R_ned_from_head = np.eye(3) if gimbal.reference == "level" else R_ned_from_body @ mount.R_body_from_base
    angles = gimbal.sign * gimbal.gain * (shot.gimbal_readings - gimbal.offset)
    for axis, angle in zip(gimbal.axes, angles, strict=True):
        R_ned_from_head = R_ned_from_head @ Rotation.from_euler(axis, float(angle)).as_matrix()
    lever_ned = R_ned_from_body @ mount.lever_body + R_ned_from_head @ mount.lever_head
    R_ecef = np.asarray(R_ecef_from_ned(pose.position))
    direction_camera = np.asarray(sensor.camera.ray(uv)[0])
    origin = np.asarray(WGS84.to_ecef(pose.position)) + R_ecef @ lever_ned
    return origin, R_ecef @ R_ned_from_head @ mount.R_head_from_camera @ direction_camera


@ROWS
def test_rays_are_the_product_of_the_frames_and_project_undoes_them(name):
    sensor = SENSORS[name]
    shots, uv = random_shots(sensor), pixels_of_all_shots()
    distance = np.geomspace(1e4, 3e5, COUNT)
    origin, direction, status, back, status_back = out_and_back(sensor, shots, uv, distance)
    assert np.all(status == Status.hit)
    assert np.all(status_back == Status.hit)
    # The last bit of an ECEF coordinate is 1e-9 m: at 10 km and a focal length of 9000 px that is 1e-9 px.
    np.testing.assert_allclose(back, uv, rtol=0, atol=3e-9)
    for index in range(3):
        origin_literal, direction_literal = literal(sensor, one(shots, index), uv[index])
        np.testing.assert_allclose(origin[index], origin_literal, rtol=0, atol=2e-9)
        np.testing.assert_allclose(direction[index], direction_literal, rtol=0, atol=2e-15)
        direction_camera, _ = sensor.camera.ray(uv[index])
        by_vectors = sensor.line(Station.of(one(shots, index)), direction_camera)
        np.testing.assert_allclose(by_vectors[0], origin[index], rtol=0, atol=2e-9)
        np.testing.assert_allclose(by_vectors[1], direction[index], rtol=0, atol=2e-15)


def test_a_level_gimbal_takes_only_its_lever_from_the_attitude():
    sensor = SENSORS["three axes in level"]
    position = Geodetic.from_degrees(lat=24.6, lon=120.7, height=300.0)
    readings = sensor.gimbal.readings_from_degrees(yaw=40.0, pitch=-60.0, roll=0.0)
    level, banked = Shot(Pose(position), readings), Shot(Pose(position, 2.0, 0.3, -0.4), readings)
    np.testing.assert_array_equal(sensor.R_ecef_from_camera(level), sensor.R_ecef_from_camera(banked))
    moved_ned = R_ecef_from_ned(position).T @ (sensor.perspective_centre(banked) - sensor.perspective_centre(level))
    turned = banked.pose.R_ned_from_body @ LEVERS["lever_body"] - LEVERS["lever_body"]
    np.testing.assert_allclose(moved_ned, turned, rtol=0, atol=2e-9)


def test_a_camera_that_looks_down_sees_what_is_below_and_ahead():
    here = Pose.from_degrees(lat=45.0, lon=6.0, height=2000.0, heading=90.0)
    sensor, shot = Sensor(PINHOLE), Shot(here)

    def ecef(*ned: float):
        return WGS84.to_ecef(here.position) + R_ecef_from_ned(here.position) @ np.array(ned)

    uv, _ = sensor.project_ecef(shot, ecef(0.0, 100.0, 1e3))  # flying east, the east is at the top
    np.testing.assert_allclose(uv, PINHOLE.principal_px - np.array([0.0, 910.0]), rtol=0, atol=1e-6)
    p_camera = sensor.to_camera(shot, ecef(-3.0, 2.0, 10.0))
    np.testing.assert_allclose(p_camera, [3.0, -2.0, 10.0], rtol=0, atol=2e-9)  # south is to the right


def broken(path, value):
    """A good (sensor, shot, uv), with one number spoiled."""
    sensor = eqx.tree_at(lambda sensor: sensor.camera, TWO_AXES, PINHOLE)
    good = (sensor, one(random_shots(sensor), 0), np.array([100.0, 200.0]))
    return eqx.tree_at(path, good, replace_fn=lambda leaf: np.full(np.shape(leaf), value))


BROKEN = {
    "latitude": broken(lambda t: t[1].pose.position.lat, np.nan),
    "heading": broken(lambda t: t[1].pose.heading, np.inf),
    "readings": broken(lambda t: t[1].gimbal_readings, np.nan),
    "focal length": broken(lambda t: t[0].camera.focal_px, np.nan),
    "lever": broken(lambda t: t[0].mount.lever_head, np.nan),
    "pixel": broken(lambda t: t[2], np.nan),
}


@pytest.mark.costly
@pytest.mark.parametrize("name", BROKEN)
def test_what_is_not_finite_is_said_to_be_so_and_stays_out_of_gradients(name):
    origin, direction, status = ray(*BROKEN[name])
    assert status == Status.invalid_input
    assert np.all(np.isnan(origin))
    assert np.all(np.isnan(direction))
    gradients = gradient_of_masked(*BROKEN[name])
    assert all(np.all(leaf == 0.0) for leaf in jax.tree.leaves(gradients))


ray = jax.jit(lambda sensor, shot, uv: sensor.ray_ecef(shot, uv))


@jax.jit
@jax.grad
def _gradient(everything):
    sensor, shot, uv = everything
    origin, direction, status = sensor.ray_ecef(shot, uv)
    back, _ = sensor.project_ecef(shot, jnp.where(status == Status.hit, origin + 1e4 * direction, jnp.nan))
    return jnp.sum(jnp.where(status == Status.hit, jnp.concatenate([direction, back]), 0.0))


def gradient_of_masked(*everything):
    return _gradient(everything)


def test_a_status_of_the_camera_is_the_status_of_the_ray():
    sensor = TWO_AXES
    shot = one(random_shots(sensor), 0)
    origin, direction, status = ray(sensor, shot, np.array([8200.0, 100.0]))
    assert status == Status.outside_image
    assert np.all(np.isfinite(direction))
    origin, direction, status = ray(sensor, shot, np.array([1e5, 100.0]))
    assert status == Status.outside_image
    assert np.all(np.isfinite(origin))
    assert np.all(np.isnan(direction))


@pytest.mark.costly
def test_derivatives_of_the_ray_equal_differences_and_forward_equals_reverse():
    """In every number of sensor, shot and pixel, each in units of its own size (0.01 for those that are zero)."""
    sensor = eqx.tree_at(lambda sensor: sensor.camera, TWO_AXES, PINHOLE)
    shot = one(random_shots(sensor), 1)
    flat, unravel = ravel_pytree((sensor, shot, jnp.array([700.0, 5000.0])))
    unit = jnp.where(jnp.abs(flat) > 0.0, jnp.abs(flat), 0.01)

    def f(x):
        sensor, shot, uv = unravel(flat + unit * x)
        origin, direction, _ = sensor.ray_ecef(shot, uv)
        return jnp.concatenate([origin / 6.4e6, direction])

    first = jax.jit(lambda: first_derivatives_at_zero(f, flat.size, 1e-3)[:3])
    forward, reverse, differences = first()
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=1e-12 * np.abs(forward).max())
    np.testing.assert_allclose(forward, differences, rtol=0, atol=1e-9 * np.abs(forward).max())
