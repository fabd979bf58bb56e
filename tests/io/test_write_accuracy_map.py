"""Maps of accuracy as GeoTIFFs: the right place, the right numbers, and codes that say what they mean."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
import rasterio

import jaxgeo
from jaxgeo import Pose, Shot, Status
from jaxgeo.io import write_accuracy_map
from jaxgeo.uncertainty import NO_FIX, Method, sources
from tests.support import looks
from tests.support.scenes import rough, small_dem

pytestmark = pytest.mark.costly

CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=3000.0, width=601, height=601)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
POSE = Pose.from_degrees(lat=47.0, lon=10.98024, height=900.0)
MODEL = (sources.Attitude.from_degrees(heading=0.03, pitch=0.03, roll=0.03), sources.TerrainHeight.from_metres(2.0))
SCENE = (looks.level_sensor(), looks.level_shot(), looks.LEVEL, looks.level_errors())


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A map in UTM of a part of what the image sees and some more, and what comes back from the file."""
    path = tmp_path_factory.mktemp("maps") / "accuracy.tif"
    place = {"crs": "EPSG:32632", "bounds": (645_000.0, 5_204_000.0, 646_100.0, 5_204_470.0), "resolution": 100.0}
    found = write_accuracy_map(path, *SCENE, **place, probability=0.5, block=4)
    with rasterio.open(path) as data:
        return found, data.read(), data.profile, data.descriptions, data.units, data.tags()


def test_cells_lie_where_the_map_says(written) -> None:
    found, bands, profile, *_ = written
    assert profile["crs"].to_epsg() == 32632
    to_lonlat = pyproj.Transformer.from_crs(profile["crs"].to_wkt(), "EPSG:4326", always_xy=True)
    row, col = np.indices(bands.shape[1:])
    west, north = profile["transform"].c, profile["transform"].f
    x, y = west + 100.0 * (col + 0.5), north - 100.0 * (row + 0.5)
    lon, lat = to_lonlat.transform(x, y)
    np.testing.assert_allclose(np.rad2deg(found.position.lon), lon, atol=1e-10)  # deg
    np.testing.assert_allclose(np.rad2deg(found.position.lat), lat, atol=1e-10)


def test_bands_are_the_map(written) -> None:
    found, bands, profile, descriptions, units, _ = written
    assert descriptions == ("CE50, m", "LE50, m", "method", "status")
    assert units[:2] == ("m", "m")
    assert np.isnan(profile["nodata"])
    expected = (found.circular, found.linear, found.method, found.status)
    for band, values in zip(bands, expected, strict=True):
        np.testing.assert_array_equal(band, np.asarray(values, np.float32))
    assert np.isfinite(bands[2:]).all()
    assert bands.shape == (4, 5, 11)  # the south edge is moved outwards
    assert set(np.unique(bands[2])) == {NO_FIX, Method.facet}
    np.testing.assert_array_equal(np.isnan(bands[0]), bands[3] != Status.hit)


@pytest.mark.slow
def test_the_image_fills_the_map_that_was_made_for_it(tmp_path) -> None:
    shot = Shot(POSE, SENSOR.gimbal.readings_from_degrees(outer=62.0, inner=0.0))
    scene = (SENSOR, shot, looks.LEVEL, MODEL)
    found = write_accuracy_map(tmp_path / "a.TIFF", *scene, resolution=50.0, block=64)
    with rasterio.open(tmp_path / "a.TIFF") as data:
        assert data.crs.to_epsg() == 32632
        seen = data.read(4) == Status.hit
    assert seen.mean() > 0.5
    assert all(edge.any() for edge in (seen[:2], seen[-2:], seen[:, :2], seen[:, -2:]))
    assert found.shape == seen.shape


def test_a_cloud_optimised_map_holds_the_same(tmp_path, written) -> None:
    """Tiled, laid out as a COG and said to be one, with the same numbers, place, names and tags."""
    place = {"crs": "EPSG:32632", "bounds": (645_000.0, 5_204_000.0, 646_100.0, 5_204_470.0), "resolution": 100.0}
    write_accuracy_map(tmp_path / "a.tif", *SCENE, **place, probability=0.5, block=8, cog=True)
    _, bands, profile, descriptions, units, tags = written
    with rasterio.open(tmp_path / "a.tif") as data:
        np.testing.assert_array_equal(data.read(), bands)
        assert data.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert (data.crs.to_epsg(), data.transform) == (32632, profile["transform"])
        assert (data.descriptions, data.units) == (descriptions, units)
        assert {name: data.tags()[name] for name in tags} == tags
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_tags_say_what_codes_mean(written) -> None:
    tags = written[-1]
    assert tags["PROBABILITY"] == "0.5"
    assert tags["METHOD_CODES"].startswith("-1: no fix | 0: linear propagation | 1: linear propagation over")
    meanings = dict(entry.split(": ", 1) for entry in tags["STATUS_CODES"].split(" | "))
    assert len(meanings) == len(Status)
    assert meanings["12"].startswith("The pixel, or the image of the point, is outside")


@pytest.mark.parametrize(
    "change, error, message",
    [
        ({"path": "map.png"}, ValueError, "name a file that ends in .tif"),
        ({"path": "nowhere/map.tif"}, FileNotFoundError, "there is no folder"),
        ({"crs": "EPSG:0"}, ValueError, "PROJ does not know the crs 'EPSG:0'"),
        ({"crs": "EPSG:5773"}, ValueError, "needs a projected or geographic crs"),
        ({"bounds": (0.0, 0.0, 1.0, 1.0)}, ValueError, "name it with crs="),
        ({"crs": "EPSG:32632", "bounds": (2.0, 0.0, 1.0, 1.0)}, ValueError, "west < east"),
        ({"crs": "EPSG:32632", "bounds": (0.0, 0.0, 1.0, 1.0)}, ValueError, "give the size of a cell"),
        ({"crs": "EPSG:32632", "bounds": (0.0, 0.0, 1.0, 1.0), "resolution": -1.0}, ValueError, "must be positive"),
        ({"shot": POSE, "resolution": 10.0}, ValueError, "has no edge"),
    ],
)
def test_what_cannot_be_written_is_refused_at_once(tmp_path, change: dict, error: type, message: str) -> None:
    given = dict(zip(("sensor", "shot", "terrain", "errors"), SCENE, strict=True)) | {"path": "map.tif"} | change
    given["path"] = tmp_path / given["path"]
    with pytest.raises(error, match=message):
        write_accuracy_map(**given)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_from_a_pose_all_of_the_terrain_at_its_spacing_in_degrees(tmp_path) -> None:
    dem = small_dem(rough(seed=5, relief=8.0))
    limits = np.deg2rad([[-10.0, 62.0], [-60.0, 60.0]])
    sensor = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.two_axis(limits=limits), jaxgeo.Mount.nadir())
    found = write_accuracy_map(tmp_path / "a.tif", sensor, POSE, dem, MODEL, crs="EPSG:4979", sampling=None, block=64)
    with rasterio.open(tmp_path / "a.tif") as data:
        verdict, status = data.read(3), data.read(4)
        assert data.crs.to_epsg() == 4326
        assert data.res[1] == pytest.approx(np.rad2deg(30.0 / 6.378e6), rel=1e-3)
        meaning = data.tags()["STATUS_CODES"]
    assert 17 <= min(found.shape) <= max(found.shape) <= 20
    assert {Status.leaves_terrain, Status.invalid_input} < {Status(int(code)) for code in np.unique(status)}
    assert "9: The gimbal cannot look there within its limits" in meaning
    inside = np.isfinite(np.asarray(found.position.height))
    np.testing.assert_array_equal(verdict == NO_FIX, ~np.asarray(found.has_fix))
    assert np.mean(verdict[inside] >= 0) > 0.2
