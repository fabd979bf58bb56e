"""Sections under lines of sight, and their drawing."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Dem, FrameCamera, Geodetic
from jaxgeo._locate import intersect
from jaxgeo.demo.scene import scene_file
from jaxgeo.earth import WGS84, R_ecef_from_ned
from jaxgeo.earth.ray import Ray
from jaxgeo.io import example_dem
from jaxgeo.io.scene import read_scene
from jaxgeo.plot import Section, section_under, sight_section
from jaxgeo.status import Status
from tests.support.drawn import a_section, line, new_axes, words


@pytest.fixture
def ax():
    return new_axes()


LEVEL = 200.0  # m, the ground of a level terrain
HIGH, DOWN = 3000.0, 10.0  # m, deg: where the camera is, and how far it looks down


@pytest.fixture(scope="module")
def demo() -> tuple[Ray, Dem]:
    """The optical axis of the demonstration, over the terrain that comes with the package."""
    scene = read_scene(scene_file())
    assert scene.shot is not None
    camera = scene.sensor.camera
    assert isinstance(camera, FrameCamera)
    middle = np.array([0.5 * (camera.width - 1), 0.5 * (camera.height - 1)])
    origin, direction, _ = scene.sensor.ray_ecef(scene.shot, middle)
    return Ray(origin, direction), example_dem()


def like(dem: Dem, posts: np.ndarray) -> Dem:
    """Other heights on the grid of a terrain, so that nothing is compiled again."""
    return Dem.from_array(posts, dem.grid)


def straight(camera: Geodetic, azimuth_deg: float, down_deg: float) -> Ray:
    azimuth, down = math.radians(azimuth_deg), math.radians(down_deg)
    ned = jnp.array([math.cos(down) * math.cos(azimuth), math.cos(down) * math.sin(azimuth), math.sin(down)])
    return Ray(WGS84.to_ecef(camera), R_ecef_from_ned(camera) @ ned)


@pytest.fixture(scope="module")
def section(demo) -> Section:
    return section_under(*demo)


@pytest.mark.costly
def test_the_first_hit_is_the_fix(demo, section) -> None:
    fix = intersect(*demo)
    distance, height = section.hits[0]
    assert section.status == Status.hit
    assert height == pytest.approx(float(fix.position.height), abs=1e-6)
    foot = WGS84.to_ecef(Geodetic(lat=fix.position.lat, lon=fix.position.lon, height=jnp.asarray(0.0)))
    normal, camera_height = WGS84.normal_and_height(demo[0].origin)
    chord = float(jnp.linalg.norm(foot - (demo[0].origin - camera_height * normal)))
    assert distance == pytest.approx(chord * (1.0 + (chord / 6.37e6) ** 2 / 24.0), abs=0.05)  # the arc over its chord
    assert np.interp(distance, section.distance, section.sight - section.ground) == pytest.approx(0.0, abs=0.5)


@pytest.mark.costly
def test_a_straight_line_bends_up_over_the_ellipsoid(demo) -> None:
    """From height h over a sphere of radius R, down by an angle a: (R + h) cos a / cos(a - d / R) - R at distance d."""
    level = like(demo[1], np.full(np.shape(demo[1].posts), LEVEL))
    camera = Geodetic.from_degrees(lat=36.3, lon=-84.1, height=HIGH)
    found = section_under(straight(camera, 270.0, DOWN), level, reach=17_500.0)
    radius = float(WGS84.prime_vertical_radius(camera.lat))  # westwards
    turn, down = found.distance / radius, math.radians(DOWN)
    expected = (radius + HIGH) * math.cos(down) / np.cos(down - turn) - radius
    np.testing.assert_allclose(found.sight, expected, rtol=0, atol=0.05)  # m
    tangent = HIGH - (radius + HIGH) / radius * math.tan(down) * found.distance
    np.testing.assert_allclose(found.flat, tangent, rtol=0, atol=0.05)  # m
    drop = 0.5 * found.hits[0, 0] ** 2 / radius
    assert found.curved == pytest.approx(drop, rel=0.1)
    assert found.hits[0, 1] == pytest.approx(LEVEL, abs=1e-6)
    np.testing.assert_allclose(found.ground[np.isfinite(found.ground)], LEVEL, rtol=0, atol=1e-9)


@pytest.mark.costly
def test_a_second_ridge_is_a_farther_hit(demo) -> None:
    """Two walls across a low line of sight: it goes into the first, comes out, and goes into the second."""
    dem = demo[1]
    rows, columns = (int(n) for n in np.asarray(dem.extent))
    posts = np.full((rows, columns), LEVEL)
    first, second = columns // 2, columns // 4
    posts[:, first - 3 : first + 4] = posts[:, second - 3 : second + 4] = 3000.0
    posts[:, first - 20 : first - 10] = np.nan
    middle = dem.grid.normal(jnp.array([rows / 2, columns - 20.0]))
    lat, lon = math.asin(float(middle[2])), math.atan2(float(middle[1]), float(middle[0]))
    camera = Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.asarray(2500.0))
    found = section_under(straight(camera, 270.0, 1.0), like(dem, posts))
    assert len(found.hits) == 2
    assert found.status == Status.hit
    assert found.void.any()
    assert np.isnan(found.ground[found.void]).all()
    heights = np.interp(found.hits[:, 0], found.distance, found.sight)
    np.testing.assert_allclose(found.hits[:, 1], heights, rtol=0, atol=1.0)


def test_the_section_is_drawn_as_it_is(ax) -> None:
    section = a_section()
    assert sight_section(section, ax) is ax
    before, behind = line(ax, "line of sight"), line(ax, "_behind the first hit")
    assert before[-1, 0] == pytest.approx(1.9)
    assert behind[0, 0] == pytest.approx(1.9)
    assert behind[-1, 0] == pytest.approx(4.0)
    np.testing.assert_allclose(before[:, 1], 700.0 - 200.0 * before[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(line(ax, "first hit"), [[1.9, 330.0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(line(ax, "1 crossing farther on"), [[3.1, 100.0]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(line(ax, "_surface")[:, 1], section.ground, rtol=0, atol=1e-12)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("distance on the ellipsoid, km", "height above WGS 84, m")
    assert {"ground unknown", "over a flat Earth, 2 m lower"} <= set(words(ax))
    (void,) = [patch for patch in ax.patches if patch.get_hatch() and patch.get_width() > 0.0]
    assert void.get_x() == pytest.approx(0.50)
    assert void.get_x() + void.get_width() == pytest.approx(0.80)


def test_a_line_without_a_fix_says_why(ax) -> None:
    sight_section(a_section(hits=np.zeros((0, 2)), status=Status.leaves_terrain), ax)
    assert "no fix: leaves terrain" in words(ax)
    assert not any(str(one.get_label()).startswith("first hit") for one in ax.lines)


def test_a_window_of_a_section(ax) -> None:
    sight_section(a_section(), ax, window=(1500.0, 3500.0), legend=False)
    assert ax.get_xlim() == (1.5, 3.5)
    low, high = ax.get_ylim()
    assert low < 100.0
    assert 400.0 < high < 500.0
    assert ax.get_legend() is None
    with pytest.raises(ValueError, match=r"window must hold some of the section, 0 to 4000 m; got 5000.0 to 6000.0 m"):
        sight_section(a_section(), ax, window=(5000.0, 6000.0))


@pytest.mark.costly
def test_sections_that_cannot_be(demo) -> None:
    ray, dem = demo
    with pytest.raises(ValueError, match="reach must be a positive length in m; got 0"):
        section_under(ray, dem, reach=0.0)
    with pytest.raises(ValueError, match="nowhere above ground of this terrain"):
        section_under(straight(Geodetic.from_degrees(lat=0.0, lon=0.0, height=HIGH), 0.0, DOWN), dem)
    with pytest.raises(ValueError, match="plumb"):
        section_under(straight(Geodetic.from_degrees(lat=36.3, lon=-84.25, height=HIGH), 0.0, 90.0), dem)
    with pytest.raises(ValueError, match="ray must be finite"):
        section_under(replace_origin(ray, np.nan), dem)


def replace_origin(ray: Ray, value: float) -> Ray:
    return Ray(jnp.full(3, value), ray.direction)
