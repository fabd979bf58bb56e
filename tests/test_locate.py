"""Pixel to ground and back: round trips, the papers' numbers, statuses at the doors."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.scenes import rough, small_dem

import jaxgeo
from jaxgeo import (
    BrownConrady,
    ConstantHeight,
    Ellipsoid,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Pose,
    Ray,
    Sensor,
    Shot,
    Status,
)
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import point_shot

COUNT = 16
ROUNDING = 5e-9  # m, of a point in ECEF and back: its last bit is 1e-9 m, so a camera near by sees it as pixels


def pixels_of_rounding(sensors, slant_range) -> np.ndarray:
    """How far rounding may move a pixel, px: 1e-9, or what `ROUNDING` is at this range where that is more."""
    focal = np.max(np.asarray(sensors.camera.focal_px), axis=-1)
    return np.maximum(1e-9, ROUNDING * focal / np.asarray(slant_range))[..., None]


def a_sensor(gimbal: Gimbal, rng: np.random.Generator, focal: tuple[float, float] = (3000.0, 9000.0)) -> Sensor:
    """A camera with lens distortion, lever arms and a boresight, on a gimbal."""
    camera = FrameCamera.from_pixels(
        focal_px=rng.uniform(*focal),
        width=4000,
        height=3000,
        principal_px=rng.uniform([1950.0, 1450.0], [2050.0, 1550.0]),
        distortion=BrownConrady(
            **dict(zip(["k1", "k2", "p1", "p2", "k3"], rng.normal(0.0, [0.05, 0.02, 1e-3, 1e-3, 0.01]), strict=True))
        ),
    )
    mount = Mount(
        R_body_from_base=R_from_rotation_vector(jnp.asarray(rng.normal(0.0, 0.01, 3))),
        R_head_from_camera=Mount.nadir().R_head_from_camera,
        lever_body=rng.normal(0.0, 1.0, 3),
        lever_head=rng.normal(0.0, 0.2, 3),
    )
    return Sensor(camera, gimbal, mount)


def a_shot(gimbal: Gimbal, rng: np.random.Generator, height: tuple[float, float] = (500.0, 3000.0)) -> Shot:
    """An aircraft at 500 to 3000 m unless said otherwise, banking, looking 0 to 60 degrees off nadir."""
    pose = Pose.from_degrees(
        lat=rng.uniform(46.999, 47.001),
        lon=rng.uniform(10.999, 11.001),
        height=rng.uniform(*height),
        heading=rng.uniform(-180.0, 180.0),
        pitch=rng.normal(0.0, 3.0),
        roll=rng.normal(0.0, 3.0),
    )
    return Shot(pose, np.deg2rad(rng.uniform(-40.0, 40.0, len(gimbal.axes))), 0.0)


def batch(items: list):
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, jnp.float64) for leaf in leaves]), *items)


GIMBALS = {
    "two-axis in the body": Gimbal.two_axis(),
    "three-axis in local level": Gimbal.three_axis(),
    "fixed": Gimbal.fixed(),
}


@pytest.mark.parametrize(
    "name", [name if name.startswith("two") else pytest.param(name, marks=pytest.mark.slow) for name in GIMBALS]
)
def test_project_is_the_inverse_of_locate(name):
    rng = np.random.default_rng(5)
    gimbal = GIMBALS[name]
    sensors, shots = (
        batch([a_sensor(gimbal, rng) for _ in range(COUNT)]),
        batch([a_shot(gimbal, rng) for _ in range(COUNT)]),
    )
    uv = jnp.asarray(rng.uniform(0.0, [3999.0, 2999.0], (COUNT, 2)))

    @jax.jit
    @jax.vmap
    def there_and_back(sensor, shot, uv):
        fix = jaxgeo.locate(sensor, shot, uv, ConstantHeight(120.0))
        pixel = jaxgeo.project(sensor, shot, fix.position)
        return fix, pixel

    high = batch([a_shot(gimbal, rng, (12_000.0, 15_000.0)) for _ in range(COUNT)])
    short = batch([a_sensor(gimbal, rng, (1500.0, 2500.0)) for _ in range(COUNT)])
    for sensor, shot, strict in ((sensors, shots, False), (short, high, True)):
        fix, pixel = there_and_back(sensor, shot, uv)
        seen = np.asarray(fix.ok)
        assert seen.sum() >= COUNT // 2
        off = np.abs(np.asarray(pixel.uv - uv))
        limit = 1e-9 if strict else pixels_of_rounding(sensor, fix.slant_range)
        print(f"{name}, {'12 to 15' if strict else '0.5 to 3'} km: pixels return to {off[seen].max():.1e} px")
        assert np.all((off <= limit)[seen])
        assert np.all(np.asarray(pixel.status)[seen] == Status.hit)


@pytest.fixture(scope="module")
def over_terrain():
    """One sensor over rough ground, its shot, and the terrain."""
    rng = np.random.default_rng(11)
    gimbal = Gimbal.two_axis()
    sensor = a_sensor(gimbal, rng)
    pose = Pose.from_degrees(lat=47.0, lon=10.993, height=800.0, heading=5.0, pitch=1.0, roll=-2.0)
    dem = small_dem(rough(2))
    return sensor, point_shot(sensor, pose, Geodetic.from_degrees(lat=47.0, lon=11.0, height=130.0)), dem


def one_by_one(function, *batches):
    """Results of `function` for each item of the batches, stacked; single calls compile in half the time of a batch."""
    found = [function(*jax.tree.map(lambda x, k=k: x[k], batches)) for k in range(8)]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *found)


def project_over(sensor, shots, points, dem):
    """Pixels of eight points over terrain, each from its own shot."""
    return one_by_one(lambda shot, point: jaxgeo.project(sensor, shot, point, terrain=dem), shots, points)


@pytest.fixture(scope="module")
def located(over_terrain):
    """Pixels about the middle of the image, and where they are over terrain."""
    sensor, shot, dem = over_terrain
    uv = jnp.asarray(np.random.default_rng(1).uniform([1700, 1200], [2300, 1800], (8, 2)))
    return uv, one_by_one(lambda pixel: jaxgeo.locate(sensor, shot, pixel, dem), uv)


@pytest.mark.costly
def test_the_round_trip_holds_over_terrain_and_hidden_ground_is_told(over_terrain, located):
    sensor, shot, dem = over_terrain
    uv, located = located
    assert np.all(located.ok)
    shots = jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float64), (8, *np.shape(x))), shot)

    def project(point):
        return project_over(sensor, shots, point, dem)

    pixel = project(located.position)
    assert np.all(np.abs(np.asarray(pixel.uv - uv)) <= pixels_of_rounding(sensor, located.slant_range))
    assert np.all(pixel.ok)
    buried = Geodetic(lat=located.position.lat, lon=located.position.lon, height=located.position.height - 5.0)
    hidden = project(buried)
    assert np.all(np.asarray(hidden.status) == Status.hidden_by_terrain)
    assert np.all(np.isfinite(hidden.uv))


@pytest.mark.costly
def test_a_point_behind_and_a_point_beside(over_terrain):
    sensor, shot, _ = over_terrain
    behind = jaxgeo.project(sensor, shot, Geodetic.from_degrees(lat=47.0, lon=10.9, height=4000.0))
    assert Status(int(behind.status)) is Status.behind_camera
    assert np.all(np.isnan(behind.uv))
    narrow = dataclasses.replace(sensor, camera=dataclasses.replace(sensor.camera, width=1500))
    uv = jnp.array([2000.0, 1500.0])
    seen = jaxgeo.locate(sensor, shot, uv, ConstantHeight(130.0))
    beside = jaxgeo.project(narrow, shot, seen.position)
    assert Status(int(beside.status)) is Status.outside_image
    assert np.all(np.abs(np.asarray(beside.uv - uv)) <= pixels_of_rounding(sensor, seen.slant_range))
    assert Status(int(jaxgeo.locate(narrow, shot, uv, ConstantHeight(130.0)).status)) is Status.outside_image


@pytest.mark.costly
def test_a_measured_range_gives_the_point_that_terrain_gives(over_terrain, located):
    sensor, shot, _ = over_terrain
    uv, fix = jax.tree.map(lambda x: x[0], located)
    measured = jaxgeo.at_range(sensor, shot, uv, fix.slant_range)
    np.testing.assert_allclose(measured.ecef, fix.ecef, rtol=0, atol=1e-8)
    assert bool(measured.ok)
    assert np.isnan(measured.slope)
    for bad in (-1.0, 0.0, np.nan, np.inf):
        wrong = jaxgeo.at_range(sensor, shot, uv, bad)
        assert Status(int(wrong.status)) is Status.invalid_input
        assert np.all(np.isnan(wrong.ecef))


def _place(east: float, north: float, height: float) -> Geodetic:
    centre = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    p = WGS84.to_ecef(centre) + R_ecef_from_enu(centre) @ jnp.array([east, north, 0.0])
    at = WGS84.to_geodetic(p)
    return Geodetic(lat=at.lat, lon=at.lon, height=jnp.asarray(height))


SIGHTS = {
    # camera and point, east, north and height, over level ground at 100 m with a wall of 300 m along its western edge
    "over the wall": ((-1000.0, 0.0, 900.0), (100.0, 0.0, 100.0), Status.hit),
    "from outside, behind the wall": ((-1000.0, 0.0, 120.0), (100.0, 0.0, 100.0), Status.hidden_by_terrain),
    "from inside the wall": ((-230.0, 0.0, 200.0), (100.0, 0.0, 100.0), Status.camera_below_terrain),
    "over the wall's far side": ((-100.0, 0.0, 200.0), (-300.0, 0.0, 100.0), Status.hidden_by_terrain),
    "above the ground": ((0.0, 0.0, 400.0), (100.0, 0.0, 150.0), Status.hit),
    "below the ground": ((0.0, 0.0, 400.0), (100.0, 0.0, 90.0), Status.hidden_by_terrain),
    "up": ((0.0, 0.0, 150.0), (100.0, 0.0, 400.0), Status.hit),
    "beyond the terrain": ((0.0, 0.0, 400.0), (1000.0, 0.0, 50.0), Status.leaves_terrain),
}


@pytest.mark.costly
def test_what_terrain_hides_and_what_it_cannot_tell():
    posts = np.full((17, 17), 100.0)
    posts[:, :3] = 300.0
    dem = small_dem(posts)
    lens = BrownConrady(**dict.fromkeys(["k1", "k2", "p1", "p2", "k3"], 0.0))
    camera = FrameCamera.from_pixels(focal_px=500.0, width=4000, height=3000, distortion=lens)
    mount = Mount.forward(lever_body=np.zeros(3), lever_head=np.zeros(3))
    sensor = Sensor(camera, Gimbal.two_axis(), mount)
    cameras, points = ([_place(*sight[k]) for sight in SIGHTS.values()] for k in (0, 1))
    poses = [Pose.looking_at(position=camera, point=point) for camera, point in zip(cameras, points, strict=True)]
    projection = project_over(sensor, batch([Shot(pose, np.zeros(2), 0.0) for pose in poses]), batch(points), dem)
    words = {name: Status(int(code)).name for name, code in zip(SIGHTS, projection.status, strict=True)}
    assert words == {name: sight[2].name for name, sight in SIGHTS.items()}
    middle = np.broadcast_to(camera.principal_px, (8, 2))
    np.testing.assert_allclose(projection.uv, middle, rtol=0, atol=1e-6)


LI_2023_TABLE_2 = {
    # lat, lon, outer, inner of the aircraft; printed target; obtained minus printed, north and east in m
    "plain": ((28.9702, 89.0043, 74.6747, 0.2304), (29.3559124, 88.8988296, 3850.0036), (-0.41, -9.70)),
    "hill": ((28.9703, 89.0045, 75.3977, -0.7532), (29.3746921, 88.9026302, 3935.7022), (-47.91, 20.28)),
    "mountain": ((28.9705, 89.0056, 78.7673, -0.7064), (29.4453004, 88.8862045, 5289.8706), (-10.65, 99.96)),
    "mountain, inner corrected": (
        (28.9705, 89.0056, 78.7673, -0.6064),
        (29.4453004, 88.8862045, 5289.8706),
        (-5.91, 0.91),
    ),
}


@pytest.mark.parametrize("row", LI_2023_TABLE_2)
def test_li_2023_table_2(row):
    """Li et al. (2023), Table 2: from the aircraft's printed state to the printed target; the conventions are ours."""
    (lat, lon, outer, inner), target, (north, east) = LI_2023_TABLE_2[row]
    camera = FrameCamera.from_metric(focal_length=1.9, pixel_pitch=1e-5, width=7584, height=7584)
    sensor = Sensor(camera, Gimbal.two_axis(), Mount.nadir())
    pose = Pose.from_degrees(lat=lat, lon=lon, height=15409.0, heading=-102.48, pitch=2.8679, roll=-0.3876)
    shot = Shot(pose, np.deg2rad([outer, inner]), 0.0)
    fix = jax.jit(jaxgeo.locate)(sensor, shot, jnp.array([3791.5, 3791.5]), ConstantHeight(target[2]))
    printed = Geodetic.from_degrees(lat=target[0], lon=target[1], height=target[2])
    east_north_up = R_ecef_from_enu(printed).T @ (fix.ecef - WGS84.to_ecef(printed))
    np.testing.assert_allclose(east_north_up[:2], [east, north], rtol=0, atol=0.1)


@pytest.mark.costly
@pytest.mark.parametrize("name", ["sphere", "WGS 84"])
def test_derivatives_over_a_smooth_earth_follow_slant_range_and_incidence(name):
    """Along the track S / cos i and across it S per rad of pointing; tan i per m of height."""
    sphere = Ellipsoid(a=6371008.8, f=0.0)
    ellipsoid = {"sphere": sphere, "WGS 84": WGS84}[name]
    origin = ellipsoid.to_ecef(Geodetic.from_degrees(lat=0.0 if name == "sphere" else 35.0, lon=20.0, height=15000.0))
    R = R_ecef_from_enu(Geodetic.from_degrees(lat=0.0 if name == "sphere" else 35.0, lon=20.0, height=0.0))
    off_nadir = _off_nadir(60_000.0, 15_000.0, 6371008.8)

    def hit(elevation, azimuth, height):
        line = jnp.stack(
            [jnp.sin(azimuth) * jnp.sin(elevation), jnp.cos(azimuth) * jnp.sin(elevation), -jnp.cos(elevation)]
        )
        return jaxgeo.intersect(Ray(origin, R @ line), ConstantHeight(height, ellipsoid=ellipsoid))

    fix, (by_elevation, by_azimuth, by_height) = jax.jit(
        lambda *a: (hit(*a), jax.jacfwd(lambda *b: hit(*b).ecef, argnums=(0, 1, 2))(*a))
    )(off_nadir, 0.0, 0.0)
    S, i = (
        float(fix.slant_range),
        _incidence(ellipsoid, fix.ecef, R @ jnp.array([0.0, jnp.sin(off_nadir), -jnp.cos(off_nadir)])),
    )
    if name == "sphere":
        assert abs(S - 60_000.0) < 1e-6
        assert np.rad2deg(off_nadir) == pytest.approx(75.262, abs=5e-4)
        assert np.rad2deg(i) == pytest.approx(75.784, abs=5e-4)
        assert S / np.cos(i) == pytest.approx(244314.0, abs=0.5)
        assert np.tan(i) == pytest.approx(3.947, abs=5e-4)
    np.testing.assert_allclose(jnp.linalg.norm(by_elevation), S / np.cos(i), rtol=1e-6)
    np.testing.assert_allclose(jnp.linalg.norm(by_azimuth), S * np.sin(off_nadir), rtol=1e-6)
    normal, _ = ellipsoid.normal_and_height(fix.ecef)
    level = by_height - normal * jnp.dot(normal, by_height)
    np.testing.assert_allclose(jnp.linalg.norm(level), np.tan(i), rtol=1e-6)


def _off_nadir(slant_range: float, altitude: float, radius: float) -> float:
    r = radius + altitude
    return float(np.arccos((slant_range**2 + r**2 - radius**2) / (2.0 * slant_range * r)))


def _incidence(ellipsoid: Ellipsoid, p_ecef, direction) -> float:
    normal, _ = ellipsoid.normal_and_height(p_ecef)
    return float(jnp.arccos(-jnp.dot(normal, direction)))
