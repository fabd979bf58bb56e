"""The demonstration's drone image: it reads back as what its tags say, and shows what its camera sees."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from PIL import Image

import jaxgeo
from jaxgeo import demo, io
from jaxgeo.demo.drone import tagged
from jaxgeo.demo.scenery import LIGHT
from jaxgeo.io.acquisitions.usual_errors import POSITION

pytestmark = pytest.mark.costly

COLUMNS, ROWS = 64, 48  # as in the examples of docstrings, which compile the same program
DATUM = "EPSG:5773"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return demo.drone_image(tmp_path_factory.mktemp("image") / "drone.jpg", columns=COLUMNS)


@pytest.fixture(scope="module")
def fixes(made):
    """Of every pixel, (48, 64)."""
    uv = np.stack(np.meshgrid(np.arange(float(COLUMNS)), np.arange(float(ROWS))), axis=-1)
    found = made.fixes(uv.reshape(-1, 2))
    return jax.tree.map(lambda leaf: leaf.reshape(*uv.shape[:2], *leaf.shape[1:]), found)


def test_the_camera_is_read_back(made):
    found = io.read_acquisition(made.path, height_datum=DATUM)
    assert found.form == "DJI drone image"
    sensor, _, sources = found.exposure(0)
    assert [source.label for source in sources] == ["interior orientation"]  # as is usual for a lens of a design
    for read, true in zip(jax.tree.leaves(sensor.camera), jax.tree.leaves(made.sensor.camera), strict=True):
        np.testing.assert_allclose(read, true, atol=1e-6)
    assert (sensor.camera.width, sensor.camera.height) == (COLUMNS, ROWS)


def test_tags_are_those_of_the_shot_with_its_errors(made):
    read = io.read_acquisition(made.path, height_datum=DATUM).exposure(0)[1]
    written = tagged(made.sensor, made.shot, seed=0)
    places = [jaxgeo.WGS84.to_ecef(shot.pose.position) for shot in (read, written)]
    np.testing.assert_allclose(places[0], places[1], rtol=0, atol=0.002)
    np.testing.assert_allclose(np.rad2deg(read.gimbal_readings), np.rad2deg(written.gimbal_readings), atol=0.0051)
    np.testing.assert_allclose(np.rad2deg(read.pose.heading) % 360.0, np.rad2deg(written.pose.heading), atol=0.0051)


def test_tags_err_by_draws_of_the_usual_errors(made):
    off = []
    for seed in range(12):
        shot = tagged(made.sensor, made.shot, seed)
        moved = jaxgeo.WGS84.to_ecef(shot.pose.position) - jaxgeo.WGS84.to_ecef(made.shot.pose.position)
        turned = np.rad2deg(np.asarray(shot.gimbal_readings) - np.asarray(made.shot.gimbal_readings))
        off.append([np.linalg.norm(moved) / np.linalg.norm(POSITION), *(turned / [1.0, 0.5, 0.5])])
    size = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all((size > 0.5) & (size < 1.6)), size


def test_the_datum_has_to_be_stated(made):
    with pytest.raises(io.UnstatedDatum, match="height_datum"):
        io.read_acquisition(made.path)


def test_the_sky_is_where_no_ground_is(made, fixes):
    red, _, blue = np.moveaxis(np.asarray(Image.open(made.path), float), -1, 0)
    sky = blue > red + 8.0
    assert 0.2 < np.mean(~fixes.ok) < 0.6
    assert np.mean(sky == ~fixes.ok) > 0.97  # but for the haze of the farthest ridges


def test_slopes_towards_the_sun_are_bright(made, fixes):
    """The light on the ground by the height of the terrain a few metres further, against the pixels near the camera."""
    dem = io.example_dem()
    height = jax.jit(jax.vmap(lambda place, dem: dem.height_at(place), in_axes=(0, None)))

    def at(east, north):
        lat, lon = fixes.position.lat, fixes.position.lon
        place = jaxgeo.Geodetic(lat=lat + north / 6.36e6, lon=lon + east / (6.38e6 * np.cos(lat)), height=0.0 * lat)
        return np.asarray(height(jax.tree.map(np.ravel, place), dem)).reshape(lat.shape)

    step = 15.0
    normal = [-(at(step, 0.0) - at(-step, 0.0)) / (2 * step), -(at(0.0, step) - at(0.0, -step)) / (2 * step), 1.0]
    light = sum(n * towards for n, towards in zip(normal, LIGHT, strict=True))
    light = light / np.sqrt(normal[0] ** 2 + normal[1] ** 2 + 1.0)
    grey = np.mean(np.asarray(Image.open(made.path), float), axis=-1)
    near = fixes.ok & (fixes.slant_range < 2500.0)
    assert np.sum(near) > 200
    assert np.corrcoef(light[near], grey[near])[0, 1] > 0.6
