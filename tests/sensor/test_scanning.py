"""Cameras that expose row after row: their rays and images standing still, their times, and what is refused."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Geodetic, Gimbal, Pose, Sensor, Shot, project
from jaxgeo.sensor import BrownConrady, FrameCamera, PushbroomCamera, RollingShutterCamera, WhiskbroomCamera
from jaxgeo.sensor.conventions import li_2023_sensor, li_2023_sweep_sensor
from jaxgeo.status import Status

FRAME = FrameCamera.from_pixels(focal_px=900.0, width=1280, height=960, distortion=BrownConrady(k1=-0.05))
LINE = {"focal_length": 0.05, "pixel_pitch": 5e-6, "width": 2000, "height": 4000}
LENS = {"principal_point": (1e-5, 4e-4), "distortion": BrownConrady(k1=-0.1, k2=0.02, p1=1e-3, p2=-8e-4)}
SWEEP = {**LINE, "duration": 0.8}
CAMERAS = {
    "rolling shutter": RollingShutterCamera.from_readout(FRAME, readout_time=0.03),
    "rolling shutter from below": RollingShutterCamera.from_readout(FRAME, readout_time=-0.03),
    "pushbroom": PushbroomCamera.from_metric(**LINE, line_time=2e-3),
    "pushbroom, looking ahead, distorted": PushbroomCamera.from_metric(**LINE, **LENS, line_time=2e-3),
    "sweep": WhiskbroomCamera.from_metric(**SWEEP, scan_start=0.1, scan_end=0.5),
    "sweep upwards": WhiskbroomCamera.from_metric(**SWEEP, scan_start=0.5, scan_end=-0.1),
    "sweep over the horizon, distorted": WhiskbroomCamera.from_metric(**SWEEP, **LENS, scan_start=-1.6, scan_end=1.6),
}


def _back(camera, uv):
    direction, status = camera.ray(uv)
    return direction, status, camera.image_at(7.0 * direction, camera.time_of(uv))


def _still(uv, camera):
    found, status = camera.project(3.0 * camera.ray(uv)[0])
    return found, (found, status)


back = jax.jit(jax.vmap(_back, (None, 0)))
rate_and_still = jax.jit(jax.vmap(jax.jacfwd(_still, has_aux=True), (0, None)))
ROWS = pytest.mark.parametrize("name", CAMERAS)


def some_pixels(camera, count: int = 100) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.uniform([-0.499, -0.499], [camera.width - 0.501, camera.height - 0.501], (count, 2))


@pytest.mark.costly
@ROWS
def test_a_point_on_the_ray_of_a_pixel_is_seen_when_that_is_exposed(name):
    camera = CAMERAS[name]
    uv = some_pixels(camera)
    direction, status, (found, delay, seen) = back(camera, uv)
    assert np.all(status == Status.hit)
    assert np.all(seen == Status.hit)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found, uv, rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.asarray(delay) / float(camera.line_time), 0.0, atol=1e-8)


@ROWS
def test_rows_are_exposed_one_after_another(name):
    camera = CAMERAS[name]
    first, last = camera.exposure()
    times = [camera.time_of(jnp.array(uv)) for uv in ([3.0, -0.5], [9.0, 0.0], [0.0, camera.height - 0.5])]
    np.testing.assert_allclose(times[1], 0.0, atol=0)
    np.testing.assert_allclose(sorted([times[0], times[2]]), [first, last], rtol=1e-15)
    np.testing.assert_allclose(last - first, abs(camera.line_time) * camera.height, rtol=1e-12)


@pytest.mark.costly
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if "distorted" in name else name
        for name in CAMERAS
        if "pushbroom" not in name
    ],
)
def test_standing_still_they_are_cameras_like_any_other(name):
    """Each pixel back from its ray, with its derivative; a point beside the image keeps its pixel."""
    camera = CAMERAS[name]
    uv = some_pixels(camera)
    uv[0] = [500.0, camera.height + 3.0]
    J, (found, status) = rate_and_still(uv, camera)
    assert list(np.asarray(status)) == [Status.outside_image] + [Status.hit] * (len(uv) - 1)
    np.testing.assert_allclose(found, uv, rtol=0, atol=1e-8)
    np.testing.assert_allclose(J[:5], np.broadcast_to(np.eye(2), (5, 2, 2)), rtol=0, atol=1e-8)


def test_a_sweep_turns_about_the_line_from_edge_to_edge():
    camera = CAMERAS["sweep"]
    for row, angle in ((-0.5, 0.1), (1999.5, 0.3), (3999.5, 0.5)):
        direction, _ = camera.ray(jnp.array([999.5, row]))
        np.testing.assert_allclose(direction, [0.0, np.sin(angle), np.cos(angle)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(camera.axis(), [0.0, np.sin(0.3), np.cos(0.3)], rtol=0, atol=1e-15)
    right, _ = camera.ray(jnp.array([1999.5, 1999.5]))
    assert right[0] > 0.0


def test_a_sweep_over_a_line_s_own_height_is_a_frame_camera_nearby():
    """Small images of both, with the same pixels: they differ by the cube of the field."""
    frame = FrameCamera.from_pixels(focal_px=1e4, width=100, height=60)
    line = FrameCamera.from_pixels(focal_px=1e4, width=100, height=1)
    sweep = WhiskbroomCamera(optics=line, scan_start=-30e-4, scan_end=30e-4, line_time=1e-4, rows=60)
    uv = jnp.asarray(some_pixels(frame))
    away = jax.vmap(lambda uv: frame.ray(uv)[0] - sweep.ray(uv)[0])(uv)
    assert float(jnp.max(jnp.abs(away))) < (60e-4) ** 3


def test_li_2023_s_sweep_passes_the_frame_angles_of_its_table():
    """A scan of s against the horizontal is a frame angle of 90 deg + s off nadir."""
    common = {"focal_length": 1.9, "pixel_pitch": 8e-6, "width": 7584, "height": 48836}
    scan = {"scan_start": np.deg2rad(-6.44), "scan_end": np.deg2rad(-18.21), "duration": 2.0}
    sweep, frame = li_2023_sweep_sensor(**common, **scan), li_2023_sensor(**common)
    pose = Pose.from_degrees(lat=28.97, lon=89.0, height=15409.0, heading=-102.48, pitch=2.87, roll=-0.39)
    for outer in (74.6747, 75.3977, 78.7673):
        row = (90.0 - outer - 6.44) / (18.21 - 6.44) * 48836 - 0.5
        _, swept, _ = sweep.ray_ecef(Shot(pose, [np.pi / 2, 0.0]), jnp.array([1000.0, row]))
        _, still, _ = frame.ray_ecef(Shot(pose, [np.deg2rad(outer), 0.0]), jnp.array([1000.0, 24417.5]))
        np.testing.assert_allclose(swept, still, rtol=0, atol=1e-14)
    assert abs((18.21 - 6.44) / 48836 / np.rad2deg(8e-6 / 1.9) - 1.0) < 1e-3  # square pixels: 8 um it is


def test_a_pushbroom_that_stands_still_has_no_rows():
    sensor, shot = Sensor(CAMERAS["pushbroom"], Gimbal.fixed()), Shot(Pose.from_degrees(lat=1.0, lon=2.0, height=500.0))
    with pytest.raises(ValueError, match=r"Trajectory\.steady"):
        project(sensor, shot, Geodetic.from_degrees(lat=1.0, lon=2.0, height=0.0))


@pytest.mark.costly
@ROWS
def test_statuses_off_the_image_and_off_all_numbers(name):
    camera = CAMERAS[name]
    uv = some_pixels(camera)
    uv[:4] = [[3.0, camera.height - 0.4], [camera.width - 0.4, 5.0], [np.nan, 5.0], [5.0, np.nan]]
    direction, status, (_, _, seen) = back(camera, uv)
    assert np.asarray(status)[:4].tolist() == [Status.outside_image] * 2 + [Status.invalid_input] * 2
    assert np.all(np.isfinite(direction), axis=1)[:4].tolist() == [True, True, False, False]
    assert np.all(np.asarray(seen)[2:4] == Status.invalid_input)


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: PushbroomCamera.from_metric(**LINE, line_time=0.0), "FrameCamera"),
        (lambda: PushbroomCamera.from_metric(**LINE, line_time=np.nan), "line_time"),
        (lambda: PushbroomCamera.from_metric(**{**LINE, "height": 0}, line_time=1e-3), "height"),
        (lambda: RollingShutterCamera.from_readout(FRAME, readout_time=0.0), "FrameCamera"),
        (lambda: WhiskbroomCamera.from_metric(**SWEEP, scan_start=0.3, scan_end=0.3), "0.0 rad"),
        (lambda: WhiskbroomCamera.from_metric(**SWEEP, scan_start=-6.44, scan_end=18.21), "in rad"),
        (lambda: WhiskbroomCamera.from_metric(**SWEEP, scan_start=0.0, scan_end=np.inf), "scan_end"),
        (lambda: WhiskbroomCamera.from_metric(**{**SWEEP, "duration": -1.0}, scan_start=0.0, scan_end=1.0), "duration"),
    ],
)
def test_what_is_no_such_camera_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
