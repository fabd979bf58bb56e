"""Images taken in motion: pixel to ground and back row by row, derivatives, and points that no row sees."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.fractal import fractal_posts

from jaxgeo import (
    Dem,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Pose,
    PushbroomCamera,
    RollingShutterCamera,
    Sensor,
    Status,
    Trajectory,
    locate,
    project,
)
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.sensor.conventions import R_HEAD_FROM_CAMERA_LI_2023, li_2023_sweep_sensor
from jaxgeo.terrain import TangentGrid

CENTRE = Geodetic.from_degrees(lat=29.2, lon=88.9, height=0.0)
SIZE = 129
START = 418_000.0  # s of a GPS week: a time of many digits


def ground(spacing: float, relief: float, base: float = 0.0) -> Dem:
    posts = base + fractal_posts(SIZE, spacing=spacing, relief=relief, exponent=3.0, seed=4)
    return Dem.from_array(posts, TangentGrid.centred(CENTRE, spacing=(spacing, spacing), shape=posts.shape))


def flown(
    *, east: float, north: float, height: float, speed: float, heading_deg: float, rates_deg, readings, span: float
):
    """A flight of `span` s about START whose attitude swings by so many deg/s at most, in three frequencies."""
    times = START + np.linspace(-0.1, 1.1, 61) * span
    since = times - START
    heading = np.deg2rad(heading_deg)
    axes, origin = np.asarray(R_ecef_from_enu(CENTRE)), np.asarray(WGS84.to_ecef(CENTRE))
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    enu = np.array([east, north, height]) + since[:, None] * speed * along
    position = jax.vmap(WGS84.to_geodetic)(jnp.asarray(origin + enu @ axes.T))
    swing = [
        np.deg2rad(r) / w * np.sin(w * since + k)
        for k, (r, w) in enumerate(zip(rates_deg, (2.1, 3.7, 5.3), strict=True))
    ]
    pose = Pose(position, heading + swing[0], np.deg2rad(1.0) + swing[1], swing[2])
    return Trajectory.from_knots(times, pose, np.tile(readings, (len(times), 1)))


SWEEP = li_2023_sweep_sensor(
    focal_length=1.9,
    pixel_pitch=8e-6,
    width=7584,
    height=48836,
    scan_start=np.deg2rad(-6.44),
    scan_end=np.deg2rad(-18.21),
    duration=2.0,
)
DRONE = {"east": 300.0, "north": -250.0, "height": 400.0, "heading_deg": 70.0, "rates_deg": (5.0, 5.0, 5.0)}
LINES = PushbroomCamera.from_metric(
    focal_length=0.012, pixel_pitch=8e-6, width=1200, height=800, line_time=2.5e-3, principal_point=(2e-5, -3e-4)
)
ROLLING = RollingShutterCamera.from_readout(
    FrameCamera.from_pixels(focal_px=3000.0, width=4000, height=3000), readout_time=0.03
)
ACROSS = Mount(np.eye(3), R_HEAD_FROM_CAMERA_LI_2023)
LEVER = Mount.nadir(lever_body=np.array([1.2, -0.3, 0.8]), lever_head=np.array([0.1, 0.05, 0.2]))
SCENES = {
    "sweep": (
        SWEEP,
        flown(
            east=10e3,
            north=-60e3,
            height=15409.0,
            speed=220.0,
            heading_deg=-102.44,
            rates_deg=(0.3, 0.5, 1.0),
            readings=[np.pi / 2, np.deg2rad(-0.7)],
            span=2.0,
        ),
        ground(1000.0, 3000.0, base=3000.0),
    ),
    "pushbroom": (
        Sensor(LINES, Gimbal.two_axis(), LEVER),
        flown(**DRONE, speed=60.0, readings=[0.35, 0.1], span=2.0),
        ground(20.0, 80.0),
    ),
    "rolling shutter": (
        Sensor(ROLLING, Gimbal.two_axis(), LEVER),
        flown(**DRONE, speed=15.0, readings=[0.6, -0.1], span=0.03),
        ground(20.0, 80.0),
    ),
}
ROWS = pytest.mark.parametrize("name", SCENES)
located = jax.jit(jax.vmap(lambda s, m, uv, t: locate(s, m, uv, t, time=START), (None, None, 0, None)))
projected = jax.jit(jax.vmap(lambda s, m, p: project(s, m, p, time=START), (None, None, 0)))
projected_over = jax.jit(jax.vmap(lambda s, m, p, t: project(s, m, p, time=START, terrain=t), (None, None, 0, None)))


def some_pixels(camera, count: int = 64) -> np.ndarray:
    rng = np.random.default_rng(8)
    return rng.uniform([-0.49, -0.49], [camera.width - 0.51, camera.height - 0.51], (count, 2))


@ROWS
def test_from_pixel_to_rough_ground_and_back(name):
    sensor, flight, terrain = SCENES[name]
    uv = some_pixels(sensor.camera)
    fixes = located(sensor, flight, uv, terrain)
    assert np.mean(np.asarray(fixes.ok)) > 0.9
    assert np.std(np.asarray(fixes.position.height)[np.asarray(fixes.ok)]) > 5.0  # rough it is
    if name == "sweep":  # nor is any of them hidden
        back = projected_over(sensor, flight, fixes.position, terrain)
    else:
        back = projected(sensor, flight, fixes.position)
    ok = np.asarray(fixes.ok)
    assert np.all(np.asarray(back.status)[ok] == Status.hit)
    np.testing.assert_allclose(np.asarray(back.uv)[ok], uv[ok], rtol=0, atol=1e-6)
