"""What an image covers on the ground: outlines as fine as was asked, with their jumps, and the size of a pixel."""

from __future__ import annotations

import dataclasses
import functools
import math
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError
from support.fractal import TangentTerrain, fractal_posts, walk_every_cell

from jaxgeo import (
    ConstantHeight,
    Dem,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Pose,
    Sensor,
    Shot,
    Status,
    Trajectory,
    WhiskbroomCamera,
    locate,
)
from jaxgeo.coverage import MovingExposure, footprint, ground_sample_distance
from jaxgeo.coverage._footprint import FINEST
from jaxgeo.coverage.exposure import local_projection, seen_at
from jaxgeo.terrain import HeightFunction, TangentGrid

FOCAL = 4000.0  # px
SIZE = 800
SENSOR = Sensor(FrameCamera.from_pixels(focal_px=FOCAL, width=SIZE, height=SIZE), Gimbal.two_axis(), Mount.nadir())
TALL = Sensor(FrameCamera.from_pixels(focal_px=FOCAL, width=600, height=1000), Gimbal.two_axis(), Mount.nadir())
HEIGHT = 2000.0
GROUND = ConstantHeight(0.0)
CORNERS = np.array([[-0.5, -0.5], [SIZE - 0.5, -0.5], [SIZE - 0.5, SIZE - 0.5], [-0.5, SIZE - 0.5]])
MIDDLE = np.full(2, 0.5 * (SIZE - 1))


def shot(outer: float = 0.0, *, lat: float = 47.0, lon: float = 11.0, height: float = HEIGHT, **attitude) -> Shot:
    """Looking `outer` deg to the right of straight down."""
    pose = Pose.from_degrees(lat=lat, lon=lon, height=height, **attitude)
    return Shot(pose, np.array([math.radians(outer), 0.0]))


located = eqx.filter_jit(seen_at)  # of a batch of one size


def lengths(v) -> np.ndarray:
    return np.linalg.norm(np.asarray(v), axis=-1)


# Level ground.


def test_the_corners_are_what_locate_finds():
    image = shot(50.0, heading=20.0, pitch=1.0, roll=-2.0)
    outline = footprint(SENSOR, image, GROUND)
    assert outline.ok
    assert np.all(outline.found)
    assert not outline.hidden.any()
    assert outline.hidden_length == 0.0
    place = {tuple(uv): k for k, uv in enumerate(outline.uv)}
    for corner in CORNERS:
        fix = locate(SENSOR, image, corner, GROUND)
        np.testing.assert_allclose(outline.fix.ecef[place[tuple(corner)]], fix.ecef, rtol=0, atol=1e-8)
    on_edge = np.isin(outline.uv, [-0.5, SIZE - 0.5]).any(axis=1)
    assert np.all(on_edge)
    x, y = (outline.uv - MIDDLE).T  # clockwise in the image, whose rows run down, all the way round once
    turns = np.angle(np.exp(1j * np.diff(np.arctan2(y, x), append=np.arctan2(y[0], x[0]))))
    assert np.all(turns > 0.0)
    np.testing.assert_allclose(turns.sum(), 2.0 * math.pi, rtol=1e-12)


@pytest.mark.parametrize("height", [300.0, 2000.0, 9000.0])
def test_area_at_nadir_is_that_of_the_square(height):
    """Curvature takes the ground away by d2 / 2R at a distance d: 2 / R of that and of the map's scale in all."""
    outline = footprint(SENSOR, shot(height=height), GROUND, tolerance=1e-3 * height)
    side = height * SIZE / FOCAL
    of_curvature = side**2 / (6.3e6 * height)
    assert outline.area == pytest.approx(side**2, rel=of_curvature)
    assert outline.area > side**2


@pytest.mark.costly
def test_places_between_lie_within_the_tolerance():
    """On smooth ground at any place of the edge."""
    image, rng = shot(72.0, roll=3.0), np.random.default_rng(1)
    for tolerance in (10.0, 0.1, 0.001):
        outline = footprint(SENSOR, image, GROUND, tolerance=tolerance, places=2)
        assert np.max(off_outline(SENSOR, image, GROUND, outline, rng)) <= tolerance


def off_outline(sensor, image, terrain, outline, rng, count: int = 512) -> np.ndarray:
    """m in space from what places drawn along the edge see to the outline between their neighbours."""
    index, share = rng.integers(0, len(outline.uv), count), rng.uniform(0.0, 1.0, (count, 1))
    index = np.where(outline.hidden[index], (index + 1) % len(outline.uv), index)
    after = (index + 1) % len(outline.uv)
    a, b = np.asarray(outline.fix.ecef)[index], np.asarray(outline.fix.ecef)[after]
    uv = outline.uv[index] + share * (outline.uv[after] - outline.uv[index])
    p = np.asarray(located(sensor, image, jnp.asarray(uv), terrain).ecef)
    t = np.clip(np.sum((p - a) * (b - a), axis=1) / np.sum((b - a) ** 2, axis=1), 0.0, 1.0)[:, None]
    return lengths(p - a - t * (b - a))


@pytest.mark.parametrize("heading", [0.0, 77.0, 180.0, -135.0])
def test_heading_turns_the_outline(heading):
    images = [shot(40.0, heading=angle) for angle in (0.0, heading)]
    first, other = (footprint(SENSOR, image, GROUND, tolerance=5.0) for image in images)
    foot = np.array(local_projection(images[0]).forward(images[0].pose.position.lat, images[0].pose.position.lon))
    c, s = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    turned = (first.outline - foot) @ np.array([[c, -s], [s, c]])  # headings turn clockwise
    np.testing.assert_array_equal(other.uv, first.uv)
    np.testing.assert_allclose(other.outline - foot, turned, rtol=0, atol=0.02)  # the Earth is flatter along north
    assert other.area == pytest.approx(first.area, rel=1e-5)


@pytest.mark.parametrize("lon", [-100.0, 179.99, 180.0, -179.995])
def test_longitude_changes_nothing_and_180_deg_is_nothing_special(lon):
    first, other = (footprint(SENSOR, shot(60.0, lon=at), GROUND) for at in (11.0, lon))
    np.testing.assert_array_equal(other.uv, first.uv)
    np.testing.assert_allclose(other.outline, first.outline, rtol=0, atol=1e-6)
    assert other.area == pytest.approx(first.area, rel=1e-9)


# Where there is no ground.


@pytest.mark.parametrize("outer, above", [(88.0, "partly"), (89.9, "partly"), (85.0, "pitched up")])
def test_above_the_horizon_there_is_no_area(outer, above):
    attitude = {"roll": -10.0} if above == "pitched up" else {}
    outline = footprint(SENSOR, shot(outer, **attitude), GROUND, tolerance=100.0)
    assert outline.status == Status.crosses_horizon
    assert not outline.ok
    assert math.isnan(outline.area)
    assert np.all(np.isnan(outline.outline[~outline.found]))
    assert np.all(np.isfinite(outline.outline[outline.found]))
    assert not outline.hidden.any()  # ground that ends at the horizon is hidden by none
    edges = outline.found != np.roll(outline.found, -1)
    assert np.sum(edges) == (2 if above == "partly" else 0)
    close = np.max(np.abs(np.roll(outline.uv, -1, axis=0) - outline.uv), axis=1)
    assert np.all(close[edges] <= FINEST)


# Rough ground.

POSTS, SPACING = 64, 60.0  # m
TERRAIN = TangentTerrain(
    posts=fractal_posts(POSTS, spacing=SPACING, relief=120.0, exponent=3.6, seed=2),
    lat=math.radians(47.0),
    lon=math.radians(11.0),
    spacing=SPACING,
)
TERRAIN.posts[:, 30:33] += 250.0  # a wall from north to south through the middle


def dem_of(terrain: TangentTerrain) -> Dem:
    centre = Geodetic(lat=terrain.lat, lon=terrain.lon, height=0.0)
    spacing = (terrain.spacing, terrain.spacing)
    return Dem.from_array(terrain.posts, TangentGrid.centred(centre, spacing=spacing, shape=terrain.posts.shape))


DEM = dem_of(TERRAIN)
OVER_RIDGE = shot(53.0, lon=10.981, height=1300.0, roll=0.0)  # from the west, looking east over the wall


@functools.cache
def over_the_ridge():
    return footprint(SENSOR, OVER_RIDGE, DEM, tolerance=1.0)


def range_of(uv: np.ndarray) -> float:
    """Slant range in m to the first ground, by going through every cell in NumPy."""
    origin, direction, _ = SENSOR.ray_ecef(OVER_RIDGE, uv)
    return walk_every_cell(TERRAIN, np.asarray(origin), np.asarray(direction), 600.0, 6000.0).distance


@pytest.mark.slow
def test_a_ridge_makes_jumps_along_lines_of_sight():
    outline = over_the_ridge()
    assert outline.ok
    jumps = np.flatnonzero(outline.hidden)
    after = (jumps + 1) % len(outline.uv)
    origin = np.asarray(SENSOR.perspective_centre(OVER_RIDGE))
    here, there = (np.asarray(outline.fix.ecef)[k] - origin for k in (jumps, after))
    between = lengths(np.cross(here, there)) / (lengths(here) * lengths(there))
    assert np.all(between <= FINEST / FOCAL)
    assert np.all(np.abs(lengths(there) - lengths(here)) > 1.0)
    over_wall = np.abs(lengths(there) - lengths(here)) > 150.0
    sides = outline.uv[jumps[over_wall], 1]
    assert np.sum(over_wall) == 2  # one where the wall leaves the image on either side
    assert len(set(np.round(outline.uv[jumps[over_wall], 0]))) == 2 or len(set(np.round(sides))) == 2
    on_map = lengths(outline.outline[after] - outline.outline[jumps])
    assert outline.hidden_length == pytest.approx(on_map.sum(), rel=1e-12)


@pytest.mark.slow
def test_going_through_every_cell_finds_the_same_jumps():
    outline = over_the_ridge()
    jumps = np.flatnonzero(outline.hidden)
    for k in jumps:
        pair = outline.uv[[k, (k + 1) % len(outline.uv)]]
        found = np.asarray(outline.fix.slant_range)[[k, (k + 1) % len(outline.uv)]]
        np.testing.assert_allclose([range_of(uv) for uv in pair], found, rtol=0, atol=1e-3)


DENSE = 100


@pytest.mark.slow
def test_no_jump_is_missed_along_the_edge():
    """Places on every side, walked through in NumPy: a step that no slope explains is a jump that was found."""
    outline = over_the_ridge()
    steps = np.linspace(0.0, 1.0, DENSE, endpoint=False)[:, None]
    uv = np.concatenate([a + steps * (b - a) for a, b in zip(CORNERS, np.roll(CORNERS, -1, axis=0), strict=True)])
    ranges = np.array([range_of(place) for place in uv])
    far = np.flatnonzero(np.abs(np.roll(ranges, -1) - ranges) > 150.0)
    jumps = outline.uv[outline.hidden]
    for k in far:
        middle = 0.5 * (uv[k] + uv[(k + 1) % len(uv)])
        assert np.min(np.max(np.abs(jumps - middle), axis=1)) <= SIZE / DENSE
    assert len(far) == 2


@pytest.mark.slow
def test_over_rough_ground_places_between_lie_within_the_tolerance():
    outline = footprint(SENSOR, OVER_RIDGE, DEM, tolerance=0.5, places=512)
    off = off_outline(SENSOR, OVER_RIDGE, DEM, outline, np.random.default_rng(4))
    assert np.mean(off <= 0.5) > 0.99
    assert np.max(off) < 2.0


@pytest.mark.costly
def test_beyond_the_terrain_the_outline_is_not_whole():
    outline = footprint(SENSOR, dataclasses.replace(OVER_RIDGE, gimbal_readings=np.array([1.2, 0.0])), DEM)
    assert outline.status == Status.leaves_terrain
    assert math.isnan(outline.area)
    assert 0 < np.sum(outline.found) < len(outline.uv)
    away = footprint(SENSOR, shot(0.0, lon=12.0), DEM)
    assert away.status == Status.ray_misses_terrain
    assert not away.found.any()
    assert away.hidden_length == 0.0


# The size of a pixel.

SCALES = ("columns", "rows", "along", "across")


@pytest.mark.costly
def test_at_nadir_a_pixel_is_height_over_focal_length():
    found = ground_sample_distance(SENSOR, shot(), MIDDLE, GROUND)
    for name in SCALES:
        assert float(getattr(found, name)) == pytest.approx(HEIGHT / FOCAL, rel=1e-9), name
    assert float(found.area) == pytest.approx((HEIGHT / FOCAL) ** 2, rel=1e-9)


@pytest.mark.costly
def test_at_nadir_where_nothing_rounds_too():
    """On the equator the line of sight has no level part at all, so that along and across it have no direction."""
    found = ground_sample_distance(SENSOR, shot(lat=0.0, lon=0.0), MIDDLE, GROUND)
    for name in SCALES:
        assert float(getattr(found, name)) == pytest.approx(HEIGHT / FOCAL, rel=1e-9), name
    oblong = eqx.tree_at(lambda s: s.camera.focal_px, SENSOR, np.array([FOCAL, 2.0 * FOCAL]))
    found = ground_sample_distance(oblong, shot(lat=0.0, lon=0.0), MIDDLE, GROUND)
    assert float(found.along) == pytest.approx(float(found.rows), rel=1e-9)
    assert float(found.across) == pytest.approx(float(found.columns), rel=1e-9)


@pytest.mark.costly
@pytest.mark.parametrize("outer", [15.0, 45.0, 75.0])
@pytest.mark.parametrize("heading", [0.0, 130.0])
def test_on_level_ground_a_pixel_is_its_angle_over_the_cosine(outer, heading):
    found = ground_sample_distance(SENSOR, shot(outer, heading=heading), MIDDLE, GROUND)
    across = float(found.fix.slant_range) / FOCAL
    along = across / math.cos(float(found.fix.incidence_surface))
    assert float(found.across) == pytest.approx(across, rel=1e-9)
    assert float(found.along) == pytest.approx(along, rel=1e-9)
    assert float(found.columns) == pytest.approx(along, rel=1e-9)  # columns run to the right, as the gimbal turns
    assert float(found.rows) == pytest.approx(across, rel=1e-9)
    assert float(found.area) == pytest.approx(along * across, rel=1e-9)


WAVES = HeightFunction(lambda place: 20.0 * jnp.sin(2e4 * place.lat), -20.0, 20.0, lipschitz=0.07)
OVER = {"level": (GROUND, 50.0), "waves": (WAVES, 50.0), "rough": (DEM, None)}


@pytest.mark.costly
@pytest.mark.parametrize("terrain", ["level", *(pytest.param(x, marks=pytest.mark.slow) for x in ("rough", "waves"))])
def test_a_pixel_s_size_is_that_of_differences(terrain):
    ground, outer = OVER[terrain]
    image = OVER_RIDGE if outer is None else shot(outer, pitch=4.0)
    for uv in (MIDDLE, np.array([30.0, 700.0]), np.array([-0.5, SIZE - 0.5])):
        found = ground_sample_distance(SENSOR, image, uv, ground)
        assert found.fix.ok
        step = 0.01
        places = uv + step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [0, 0]])
        inner = np.clip(places, -0.5, SIZE - 0.5)
        p = np.asarray(located(SENSOR, image, jnp.asarray(inner), ground).ecef)
        moved = inner[[0, 2]] - inner[[1, 3]]
        by_column, by_row = (p[0] - p[1]) / moved[0, 0], (p[2] - p[3]) / moved[1, 1]
        tolerance = 1e-6 if np.all(inner == places) else 1e-4  # one-sided at the edge
        assert float(found.columns) == pytest.approx(lengths(by_column), rel=tolerance)
        assert float(found.rows) == pytest.approx(lengths(by_row), rel=tolerance)
        assert float(found.area) == pytest.approx(lengths(np.cross(by_column, by_row)), rel=tolerance)


@pytest.mark.costly
@pytest.mark.parametrize(
    "image, ground, status",
    [
        (shot(89.0, roll=-10.0), GROUND, Status.rises_away),
        pytest.param(shot(lon=12.0), DEM, Status.ray_misses_terrain, marks=pytest.mark.slow),
    ],
    ids=["over the horizon", "beside the terrain"],
)
def test_no_ground_has_no_size(image, ground, status):
    found = ground_sample_distance(SENSOR, image, MIDDLE, ground)
    assert found.fix.status == status
    assert all(np.isnan(getattr(found, name)) for name in (*SCALES, "area"))


# A camera that sweeps while it flies.

SWEEP = Sensor(
    WhiskbroomCamera.from_metric(
        focal_length=0.3,
        pixel_pitch=1e-5,
        width=1001,
        height=2000,
        scan_start=-0.3,
        scan_end=0.5,
        duration=2.0,
    ),
    Gimbal.two_axis(),
    Mount.nadir(),
)
FLYING = Trajectory.steady(
    shot(20.0, heading=10.0), velocity_ned=[90.0, 15.0, 0.0], body_rates=[0.01, 0.0, -0.02], before=2.0, after=4.0
)
STANDING = Trajectory.steady(shot(20.0, heading=10.0), velocity_ned=[0.0, 0.0, 0.0], before=2.0, after=4.0)


@pytest.mark.slow
def test_the_outline_of_a_sweep_in_flight():
    exposure = MovingExposure(FLYING, 0.25)
    outline = footprint(SWEEP, exposure, GROUND, tolerance=0.5)
    assert outline.ok
    place = {tuple(uv): k for k, uv in enumerate(outline.uv)}
    at = locate_sweep(jnp.array([[-0.5, -0.5], [1000.5, -0.5], [1000.5, 1999.5], [-0.5, 1999.5]]))
    for k, corner in enumerate(((-0.5, -0.5), (1000.5, -0.5), (1000.5, 1999.5), (-0.5, 1999.5))):
        np.testing.assert_allclose(outline.fix.ecef[place[corner]], at[k], rtol=0, atol=1e-8)
    rng, counts = np.random.default_rng(9), []
    for tolerance in (5.0, 0.5, 0.05):  # its edges are no straight lines
        finer = footprint(SWEEP, exposure, GROUND, tolerance=tolerance, places=4)
        counts.append(len(finer.uv))
        assert np.max(off_outline(SWEEP, exposure, GROUND, finer, rng)) <= tolerance
    assert counts[0] < counts[1] < counts[2] < 2000
    still = footprint(SWEEP, MovingExposure(STANDING, 0.25), GROUND, tolerance=0.5)
    assert abs(outline.area - still.area) > 1e-3 * still.area  # it flies on, and turns, while it sweeps
    held = footprint(SWEEP, shot(20.0, heading=10.0), GROUND, tolerance=0.5)
    assert still.area == pytest.approx(held.area, rel=1e-9)


@jax.jit
def locate_sweep(places):
    return jax.vmap(lambda uv: locate(SWEEP, FLYING, uv, GROUND, time=0.25).ecef)(places)


# Mistakes, in words.

MISTAKES = {
    "no tolerance": (lambda: footprint(SENSOR, shot(), GROUND, tolerance=0.0), ValueError, "must be positive; got 0.0"),
    "a tolerance below": (lambda: footprint(SENSOR, shot(), GROUND, tolerance=-1.0), ValueError, "positive; got -1.0"),
    "NaN": (lambda: footprint(SENSOR, shot(), GROUND, tolerance=math.nan), ValueError, "tolerance must be finite"),
    "no places": (lambda: footprint(SENSOR, shot(), GROUND, places=0), ValueError, "must be positive; got 1.0 and 0"),
    "a trajectory": (lambda: footprint(SENSOR, FLYING, GROUND), TypeError, r"image must be.*Exposure\(trajectory"),
    "a height": (lambda: footprint(SENSOR, shot(), 0.0), TypeError, "terrain must be a jaxgeo terrain"),
    "air": (lambda: footprint(SENSOR, shot(), GROUND, atmosphere=1.0), TypeError, "must be a jaxgeo.Atmosphere"),
    "a flight's pixel": (lambda: ground_sample_distance(SENSOR, FLYING, MIDDLE, GROUND), TypeError, "image must be"),
    "many pixels": (lambda: ground_sample_distance(SENSOR, shot(), CORNERS, GROUND), ValueError, "one pixel.*vmap"),
    "no sensor": (lambda: footprint(SENSOR.camera, shot(), GROUND), TypeError, "sensor must be"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_named(name):
    ask, kind, words = MISTAKES[name]
    with pytest.raises((kind, TypeCheckError)) as refused:  # the checker of types is on in tests, not for users
        ask()
    assert isinstance(refused.value, TypeCheckError) or re.search(words, str(refused.value), flags=re.DOTALL)
