"""A point on the other side of the Earth is `below_horizon` wherever a place is aimed at, with or without terrain.

Heights along lines of sight are pyproj's; ranges of sight through air are those of `sight_range`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import pytest

import jaxgeo
from jaxgeo import WGS84, Atmosphere, ConstantHeight, Geodetic, Pose, Shot, Status
from jaxgeo.coverage import point_gimbal
from jaxgeo.earth import sight_range
from jaxgeo.earth._horizon import hidden_by_earth
from jaxgeo.earth._on_host import ecef_of, normals_of
from jaxgeo.sensor import point_shot

SENSOR = jaxgeo.Sensor(
    jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000),
    jaxgeo.Gimbal.three_axis(),
    jaxgeo.Mount.forward(),
)
POSE = Pose.from_degrees(lat=36.3, lon=-84.2, height=900.0)
DOWN = Shot(POSE, SENSOR.gimbal.readings_from_degrees(yaw=0.0, pitch=-90.0, roll=0.0))
BELOW = Geodetic.from_degrees(lat=-36.3, lon=95.8, height=300.0)  # straight below, on the other side
EXCHANGED = Geodetic.from_degrees(lat=-84.2, lon=36.3, height=300.0)
NEAR = Geodetic.from_degrees(lat=36.31, lon=-84.2, height=300.0)


def _ecef(lat: float, lon: float, height: float) -> np.ndarray:
    """At a latitude and longitude in deg."""
    return ecef_of(normals_of(np.deg2rad(lat), np.deg2rad(lon)), height)


def test_a_line_that_is_hidden_passes_deep_below_ellipsoid_and_ends() -> None:
    to_lonlat = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    random = np.random.default_rng(5)
    seen = []
    for _ in range(300):
        lat, lon = random.uniform(-80.0, 80.0), random.uniform(-180.0, 180.0)
        there = lat + random.normal() * 10.0 ** random.uniform(-2.0, 1.0), lon + 10.0 ** random.uniform(-2.0, 2.0)
        ends = [_ecef(*at, random.choice([-600.0, 0.0, 3e3, 5e5])) for at in ((lat, lon), there)]
        start, end = ends
        line = np.linspace(start, end, 2001)
        heights = np.asarray(to_lonlat.transform(*line.T)[2])
        depth = min(0.0, heights[0], heights[-1]) - heights.min()
        lift = np.sum((end - start) ** 2) / (32.0 * WGS84.a)
        hidden = bool(hidden_by_earth(start, end, np))
        assert hidden == bool(hidden_by_earth(jnp.asarray(start), jnp.asarray(end)))
        if abs(depth - 500.0 - lift) > 0.01 * depth + 1.0:  # the surfaces of pyproj are not ellipsoids of one shape
            assert hidden == (depth > 500.0 + lift)
        seen.append(hidden)
    assert 50 < sum(seen) < 250


@pytest.mark.parametrize("height", [2.0, 300.0, 12e3, 800e3])
@pytest.mark.parametrize("target", [0.0, 4000.0])
def test_no_point_in_sight_through_the_air_is_hidden(height: float, target: float) -> None:
    """Also along sight lines down to the Dead Sea, and through air denser by 30 %."""
    for ground, air in ((0.0, Atmosphere()), (-420.0, Atmosphere()), (0.0, Atmosphere(refractivity=1.3 * 2.8e-4))):
        reach = float(sight_range(height, target, ground=ground, atmosphere=air))
        for lat in (0.0, 45.0):
            away = np.rad2deg(reach / WGS84.a)
            assert not hidden_by_earth(_ecef(lat, 0.0, height), _ecef(lat + away, 0.0, target), np)
            assert hidden_by_earth(_ecef(lat, 0.0, height), _ecef(lat + away + 12.0, 0.0, target), np)


def test_lines_without_numbers_or_length_are_not_hidden() -> None:
    here = _ecef(47.0, 11.0, 500.0)
    assert not hidden_by_earth(here, here, np)
    assert not hidden_by_earth(here, np.full(3, np.nan), np)


@pytest.mark.costly
def test_projection_keeps_the_pixel_and_says_it() -> None:
    seen = jaxgeo.project(SENSOR, DOWN, BELOW)
    assert int(seen.status) == Status.below_horizon
    np.testing.assert_allclose(seen.uv, SENSOR.camera.project(SENSOR.camera.axis())[0], atol=100.0)
    assert not seen.ok
    places = jax.tree.map(lambda *x: jnp.stack(x), BELOW, NEAR, EXCHANGED)
    many = jax.jit(jax.vmap(lambda point: jaxgeo.project(SENSOR, DOWN, point)))(places)
    codes = [Status(code) for code in np.asarray(many.status).tolist()]
    assert codes[0] is Status.below_horizon
    assert codes[2] in (Status.below_horizon, Status.outside_image)
    assert codes[1] in (Status.hit, Status.outside_image)


@pytest.mark.costly
def test_terrain_hides_what_the_earth_does() -> None:
    assert int(jaxgeo.project(SENSOR, DOWN, BELOW, terrain=ConstantHeight(300.0)).status) == Status.hidden_by_terrain


@pytest.mark.costly
@pytest.mark.parametrize("point", [BELOW, EXCHANGED])
def test_pointing_gives_the_readings_and_says_it(point: Geodetic) -> None:
    found = point_gimbal(SENSOR, DOWN, target=point)
    assert int(found.status) == Status.below_horizon
    assert not found.ok
    assert np.isfinite(found.readings).all()
    assert float(found.miss) < 1e-9
    assert int(point_gimbal(SENSOR, DOWN, target=NEAR).status) == Status.hit
    ground = ConstantHeight(300.0)
    assert int(point_gimbal(SENSOR, DOWN, target=point, terrain=ground).status) == Status.hidden_by_terrain


@pytest.mark.costly
def test_shots_are_not_pointed_through_the_earth() -> None:
    with pytest.raises(ValueError, match=r"The Earth hides the point .* below the horizon"):
        point_shot(SENSOR, POSE, EXCHANGED)
    traced = jax.jit(lambda point: point_shot(SENSOR, POSE, point))(EXCHANGED)
    assert np.isnan(traced.gimbal_readings).all()


def test_a_pose_does_not_look_through_the_earth() -> None:
    with pytest.raises(ValueError, match=r"point is 11,\d+ km from position, below the horizon.*exchanged"):
        Pose.looking_at(position=POSE.position, point=EXCHANGED)
