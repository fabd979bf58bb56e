"""Mosaics of rendered images: each cell against the rectified images, and which of them samples it best."""

from __future__ import annotations

import pathlib

import numpy as np
import pyproj
import pytest
import rasterio
from support.drone_strip import GROUND, SENSOR, ground, strip
from support.rasters import write

from jaxgeo import Exposure, Geodetic, Pose, Shot
from jaxgeo.earth import WGS84
from jaxgeo.io import MosaicFile, rectify_file, write_mosaic
from jaxgeo.io.errors import NothingSeen
from jaxgeo.io.mosaic import check_mosaic

pytestmark = pytest.mark.costly
UTM, CELL = "EPSG:32632", 0.9


@pytest.fixture(scope="module")
def here(tmp_path_factory) -> tuple[list[pathlib.Path], list[Exposure]]:
    """Four overlapping images and one 3 km away, with their true exposures."""
    folder, scene = tmp_path_factory.mktemp("images"), strip()
    files = [write(folder / f"{k}.tif", grey.astype(np.float32)) for k, grey in enumerate(scene.images)]
    return files, [Exposure(SENSOR, shot) for shot in scene.true]


@pytest.fixture(scope="module")
def done(here, tmp_path_factory) -> MosaicFile:
    target = tmp_path_factory.mktemp("mosaic") / "all.tif"
    files, exposures = here
    return write_mosaic(target, files, exposures, ground(), crs=UTM, resolution=CELL)


def score_at(exposure: Exposure, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Pixels per area of level ground, exactly at each cell."""
    assert isinstance(exposure.motion, Shot)
    lon, lat = pyproj.Transformer.from_crs(UTM, "EPSG:4326", always_xy=True).transform(east, north)
    place = Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=np.full(np.shape(lat), GROUND))
    centre = np.asarray(exposure.sensor.sight(exposure.motion).centre)
    p = np.stack([np.asarray(x) for x in _ecef(place)], axis=-1)
    up = np.stack([np.cos(place.lat) * np.cos(place.lon), np.cos(place.lat) * np.sin(place.lon), np.sin(place.lat)], -1)
    away = centre - p
    distance = np.linalg.norm(away, axis=-1)
    return np.sum(away * up, axis=-1) / distance**3


def _ecef(place: Geodetic) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return to_ecef.transform(np.rad2deg(place.lon), np.rad2deg(place.lat), place.height)


def test_cells_are_of_the_image_that_samples_them_best(here, done: MosaicFile, tmp_path) -> None:
    files, exposures = here
    with rasterio.open(done.path) as data:
        mosaic, transform, nodata = data.read(1), data.transform, data.nodata
    assert np.isnan(nodata)
    assert mosaic.shape == done.raster.shape
    assert mosaic.shape[0] > 3 * 512  # several blocks, some of which no image shows
    east, north = transform @ (np.meshgrid(*(np.arange(n) + 0.5 for n in mosaic.shape[::-1])))
    expected, best, second = (np.full(mosaic.shape, value) for value in (np.nan, 0.0, 0.0))
    for k, (file, exposure) in enumerate(zip(files, exposures, strict=True)):
        one = rectify_file(tmp_path / f"{k}.tif", file, exposure.sensor, exposure.motion, ground(), like=done.raster)
        with rasterio.open(one.path) as data:
            values = data.read(1)
        score = np.where(np.isfinite(values), score_at(exposure, east, north), 0.0)
        second = np.maximum(second, np.minimum(best, score))
        expected = np.where(score > best, values, expected)
        best = np.maximum(best, score)
    known = np.isfinite(expected)
    assert np.array_equal(np.isfinite(mosaic), known)
    assert done.known == np.count_nonzero(known) == sum(done.used.values())
    clear = known & (second < 0.99 * best)  # not at a seam, where the sampling is interpolated between nodes
    assert np.mean(clear[known]) > 0.9
    assert np.allclose(mosaic[clear], expected[clear], atol=1e-3)
    assert not list(pathlib.Path(done.path).parent.glob(".*"))


def test_seams_do_not_show_with_the_true_poses(here, done: MosaicFile, tmp_path) -> None:
    """Steps between neighbouring cells of two images are those within one, except for the noise of the images."""
    with rasterio.open(done.path) as data:
        mosaic = data.read(1)
    files, exposures = here
    alone = rectify_file(
        tmp_path / "1.tif", files[1], exposures[1].sensor, exposures[1].motion, ground(), like=done.raster
    )
    with rasterio.open(alone.path) as data:
        second = data.read(1)
    both = np.isfinite(mosaic) & np.isfinite(second)
    other = both & (mosaic != second)
    assert np.count_nonzero(other) > 1000  # shown by another image
    off = (mosaic - second)[other]
    assert np.std(off) < 0.35 * np.nanstd(second)


def test_an_image_without_ground_is_left_out_and_named(here, tmp_path) -> None:
    files, exposures = here
    assert isinstance(exposures[0].motion, Shot)
    position = exposures[0].motion.pose.position
    up = Exposure(SENSOR, Shot(Pose(position, np.float64(0.0), np.pi, np.float64(0.0)), np.zeros(0)))
    found = write_mosaic(tmp_path / "a.tif", files[:2], [exposures[0], up], ground(), crs=UTM, resolution=2.0)
    assert list(found.left_out) == [str(files[1])]
    assert list(found.used) == [str(files[0])]
    with pytest.raises(NothingSeen):
        write_mosaic(tmp_path / "b.tif", files[:1], [up], ground(), crs=UTM, resolution=2.0)
    assert not (tmp_path / "b.tif").exists()


@pytest.mark.parametrize("check", [write_mosaic, check_mosaic])
def test_images_that_do_not_go_together_are_refused(here, tmp_path, check) -> None:
    files, exposures = here
    with pytest.raises(ValueError, match="give an exposure for each"):
        check(tmp_path / "a.tif", files, exposures[:2], ground())
    with rasterio.open(files[0]) as data:
        grey = data.read(1)
    other = write(tmp_path / "other.tif", grey.astype(np.uint16))
    with pytest.raises(ValueError, match=r"has bands 1 of float32, .*other\.tif 1 of uint16"):
        check(tmp_path / "a.tif", [files[0], other], exposures[:2], ground(), crs=UTM, resolution=2.0)
    with pytest.raises(ValueError, match=r"ends in \.tif"):
        write_mosaic(tmp_path / "a.png", files, exposures, ground())
    with pytest.raises(ValueError, match="more than a file can have"):  # each image alone would do
        check(tmp_path / "a.tif", files, exposures, ground(), crs=UTM, resolution=0.002)


def test_a_check_needs_no_ground_and_writes_nothing(here, tmp_path) -> None:
    """Orientations that are not adjusted yet may miss the ground."""
    files, exposures = here
    assert isinstance(exposures[0].motion, Shot)
    up = Exposure(SENSOR, Shot(Pose(exposures[0].motion.pose.position, 0.0, np.pi, 0.0), np.zeros(0)))
    check_mosaic(tmp_path / "a.tif", files[:1], [up], ground(), crs=UTM, resolution=2.0)
    check_mosaic(tmp_path / "not there yet" / "a.tif", files, exposures, ground(), crs=UTM, resolution=CELL)
    assert not list(tmp_path.iterdir())


def test_ellipsoid_of_the_oracle() -> None:
    place = Geodetic.from_degrees(lat=47.0, lon=11.0, height=100.0)
    found = _ecef(Geodetic(lat=np.float64(place.lat), lon=np.float64(place.lon), height=np.float64(100.0)))
    assert np.allclose(np.asarray(WGS84.to_ecef(place)), found, atol=1e-6)
