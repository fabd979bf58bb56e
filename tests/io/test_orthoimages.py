"""Orthoimages: read where they lie, written and read back alike, and made from images in files.

Held against: positions by pyproj on five kinds of map, rasters that GDAL writes, and an orthoimage of NGI, South
Africa.
"""

from __future__ import annotations

import jax
import numpy as np
import pyproj
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rasterio.transform import Affine
from support.rasters import write

import jaxgeo
from jaxgeo import ConstantHeight, Pose, Shot, Status
from jaxgeo.io import (
    ImageError,
    MapRaster,
    OrthoWriter,
    read_orthoimage,
    read_orthoimage_and_report,
    rectify_file,
    write_orthoimage,
)
from jaxgeo.io.map_raster import image_spacing
from jaxgeo.ortho.orthoimage import Orthoimage

SHAPE = (40, 50)
LO25 = pyproj.CRS.from_wkt(
    'PROJCS["unnamed",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
    'UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],'
    'PARAMETER["central_meridian",25],PARAMETER["scale_factor",1],PARAMETER["false_easting",0],'
    'PARAMETER["false_northing",0],UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
)
TURNED = Affine.translation(650_000.0, 5_207_000.0) @ Affine.rotation(25.0) @ Affine.scale(4.0, -3.0)
RASTERS = {
    "geographic": MapRaster(pyproj.CRS("EPSG:4326"), Affine(1e-4, 0.0, 11.0, 0.0, -1e-4, 47.0), SHAPE),
    "UTM": MapRaster(pyproj.CRS("EPSG:32632"), Affine(5.0, 0.0, 650_000.0, 0.0, -5.0, 5_207_000.0), SHAPE),
    "Lo25": MapRaster(LO25, Affine(5.0, 0.0, -57129.449, 0.0, -5.0, -3723906.806), SHAPE),
    "turned": MapRaster(pyproj.CRS("EPSG:32632"), TURNED, SHAPE),
}


def ground(dtype: str = "uint8", bands: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Values of the whole range of bytes, and where they are known."""
    random = np.random.default_rng(7)
    values = random.integers(0, 256, (bands, *SHAPE)).astype(dtype)
    return values, random.uniform(size=SHAPE) < 0.8


@pytest.mark.costly
@pytest.mark.parametrize("raster", RASTERS.values(), ids=RASTERS)
@pytest.mark.parametrize("dtype, bands, cog", [("uint8", 3, False), ("uint16", 4, True), ("float32", 1, False)])
def test_what_was_written_is_read_back(tmp_path, raster: MapRaster, dtype: str, bands: int, cog: bool) -> None:
    values, known = ground(dtype, bands)
    write_orthoimage(tmp_path / "a.tif", values, raster, known=known, cog=cog, tags={"NOTE": "mine"})
    found, report = read_orthoimage_and_report(tmp_path / "a.tif")
    assert found.values.dtype == dtype
    np.testing.assert_array_equal(found.known, known)
    np.testing.assert_array_equal(found.values[:, known], values[:, known])
    np.testing.assert_allclose(report.raster.transform[:6], raster.transform[:6], rtol=1e-14)
    assert report.raster.crs.equals(raster.crs, ignore_axis_order=True) or report.raster.crs.name == raster.crs.name
    assert report.map_error.worst < 1e-3  # m
    with rasterio.open(tmp_path / "a.tif") as data:
        assert data.tags()["NOTE"] == "mine"
        assert data.tags()["SOFTWARE"] == "jaxgeo"
        assert ColorInterp.alpha not in data.colorinterp
        assert (data.tags(ns="IMAGE_STRUCTURE").get("LAYOUT") == "COG") == cog
    write_orthoimage(tmp_path / "again.tif", found, report.raster)
    np.testing.assert_array_equal(read_orthoimage(tmp_path / "again.tif").known, known)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.costly
@pytest.mark.parametrize("name", RASTERS)
def test_cells_lie_where_proj_has_them(tmp_path, name: str) -> None:
    raster = RASTERS[name]
    write_orthoimage(tmp_path / "a.tif", *ground()[:1], raster)
    place = np.array([[0.0, 0.0], [39.0, 49.0], [12.0, 31.0]])
    x, y = raster.transform @ (place[:, 1] + 0.5, place[:, 0] + 0.5)
    lon, lat = pyproj.Transformer.from_crs(raster.crs, "EPSG:4326", always_xy=True).transform(x, y)
    normal = np.asarray(jax.vmap(read_orthoimage(tmp_path / "a.tif").grid.normal)(place))
    found = np.rad2deg([np.arctan2(normal[:, 1], normal[:, 0]), np.arcsin(normal[:, 2])])
    np.testing.assert_allclose(found, [lon, lat], atol=1e-9)  # deg


def test_bounds_cut_out_the_same_cells(tmp_path) -> None:
    values, known = ground("uint16", 2)
    write_orthoimage(tmp_path / "a.tif", values, RASTERS["geographic"], known=known)
    part, report = read_orthoimage_and_report(tmp_path / "a.tif", 2, (11.001, 46.997, 11.003, 46.999))
    row, col = report.window
    rows, cols = report.raster.shape
    here = np.s_[row : row + rows, col : col + cols]
    assert 20 <= rows <= 24
    np.testing.assert_array_equal(part.known, known[here])
    np.testing.assert_array_equal(part.values, np.where(known[here], values[1][here], part.values))
    write_orthoimage(tmp_path / "part.tif", part, report.raster)
    with rasterio.open(tmp_path / "part.tif") as data:
        assert data.transform.c == pytest.approx(11.0 + 1e-4 * col, abs=1e-12)
    with pytest.raises(ValueError, match="cells beside the raster"):
        write_orthoimage(tmp_path / "off.tif", part, report.raster._replace(transform=RASTERS["geographic"].transform))


def test_windows_make_the_same_file_and_what_is_left_out_is_unknown(tmp_path) -> None:
    raster = RASTERS["UTM"]._replace(shape=(300, 520))
    values = np.random.default_rng(1).integers(0, 256, (1, 300, 520)).astype(np.uint8)
    with OrthoWriter(tmp_path / "a.tif", raster, bands=1, dtype=np.uint8) as sink:
        for col in (256, 0):
            sink.write(0, col, values[:, :, col : col + 256])
        assert not (tmp_path / "a.tif").exists()
    with rasterio.open(tmp_path / "a.tif") as data:
        np.testing.assert_array_equal(data.read()[:, :, :512], values[:, :, :512])
        np.testing.assert_array_equal(data.dataset_mask() != 0, np.arange(520)[None] < np.full((300, 1), 512))


def test_a_failure_leaves_no_file(tmp_path) -> None:
    writer = OrthoWriter(tmp_path / "a.tif", RASTERS["UTM"], bands=1, dtype=np.uint8)
    with pytest.raises(RuntimeError, match="mine"), writer:
        raise RuntimeError("mine")
    assert not list(tmp_path.iterdir())


def test_a_nodata_value_may_not_be_one_of_the_image(tmp_path) -> None:
    values, known = ground()
    values[:, known] = np.maximum(values[:, known], 1)
    write_orthoimage(tmp_path / "a.tif", values, RASTERS["UTM"], known=known, nodata=0)
    np.testing.assert_array_equal(read_orthoimage(tmp_path / "a.tif").known, known)
    values[1, 2, 3], known[2, 3] = 0, True
    with pytest.raises(ValueError, match="row 2, column 3 is known and is the nodata value 0"):
        write_orthoimage(tmp_path / "b.tif", values, RASTERS["UTM"], known=known, nodata=0)
    with pytest.raises(ValueError, match="no number that uint8 can hold"):
        write_orthoimage(tmp_path / "b.tif", values, RASTERS["UTM"], nodata=-9999)
    assert not (tmp_path / "b.tif").exists()


@pytest.mark.parametrize(
    "change, how, message",
    [
        ({"crs": None}, {}, "reference is without a CRS.*gdal_edit -a_srs"),
        ({"affine": None}, {}, "no geotransform"),
        ({"nodata": 5}, {}, "no pixel is known"),
        ({}, {"bounds": (60.0, 10.0, 61.0, 11.0)}, "hold nothing of the file"),
        ({}, {"bounds": (5.0, 45.0, 5.0, 46.0)}, "bounds are empty"),
        ({}, {"bands": [1, 7]}, "there is no band 7"),
        ({"crs": 'LOCAL_CS["somewhere",UNIT["metre",1]]'}, {}, "does not say where on the Earth"),
    ],
)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_what_is_no_reference_is_refused(tmp_path, change: dict, how: dict, message: str) -> None:
    path = write(tmp_path / "a.tif", np.full((1, *SHAPE), 5, np.uint8), **change)
    with pytest.raises(ImageError, match=message) as refusal:
        read_orthoimage(path, **how)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"path": "a.png"}, "name a file that ends in .tif"),
        ({"image": np.zeros((3, 4, 5), np.uint8)}, "40 rows of 50 cells"),
        ({"image": np.zeros(SHAPE, bool)}, "holds no bool"),
        ({"known": np.zeros(SHAPE, bool)}, "nothing is known"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, change: dict, message: str) -> None:
    given = {"path": "a.tif", "image": ground()[0], "raster": RASTERS["UTM"], **change}
    given["path"] = tmp_path / given["path"]
    with pytest.raises(ValueError, match=message):
        write_orthoimage(**given)
    assert not list(tmp_path.iterdir())


def test_a_real_reference(jaxgeo_test_data) -> None:
    folder = jaxgeo_test_data / "ngi_block/reference_ortho"
    image, report = read_orthoimage_and_report(folder / "ngi_rgb_byte_1.tif", bounds=(24.405, -33.70, 24.42, -33.68))
    assert isinstance(image, Orthoimage)
    assert report.map_error.worst < 1e-4  # m: a transverse Mercator without a code
    assert image.ground_sampling == pytest.approx(5.0, abs=1e-3)
    assert image.known.all()


CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=400.0, width=120, height=100)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
LEVEL = ConstantHeight(100.0)


def above(heading: float = 30.0, height: float = 900.0, pitch: float = 0.0) -> Shot:
    """A shot with 2 m a pixel under it, 100 m above the ellipsoid."""
    return Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=height, heading=heading, pitch=pitch))


@pytest.mark.costly
@pytest.mark.parametrize("pitch", [0.0, 60.0])
def test_the_sampling_of_an_image_in_its_middle(pitch: float) -> None:
    """A pixel's footprint on level ground is 1 / cos wide and 1 / cos^2 long: their root, about."""
    found = image_spacing("a.tif", SENSOR, above(pitch=pitch), LEVEL, {})
    assert found.metres == pytest.approx(2.0 / np.cos(np.deg2rad(pitch)) ** 1.5, rel=0.02)


@pytest.mark.costly
def test_an_image_file_becomes_an_orthoimage(tmp_path) -> None:
    row, col = np.indices((100, 120))
    write(tmp_path / "frame.tif", np.stack([2 * col, 2 * row]).astype(np.uint8))  # its map is passed over
    made = rectify_file(tmp_path / "a.tif", tmp_path / "frame.tif", SENSOR, above(), LEVEL, status=True, crs=32632)
    image, report = read_orthoimage_and_report(tmp_path / "a.tif")
    assert made.raster.transform == report.raster.transform
    assert made.raster.transform.a == pytest.approx(2.0, rel=0.01)
    assert made.known == np.count_nonzero(image.known)
    assert made.known * made.raster.transform.a**2 == pytest.approx(100 * 120 * 4.0, rel=0.05)
    with rasterio.open(tmp_path / "a_status.tif") as data:
        codes = data.read(1)
        assert data.tags()["STATUS_CODES"].startswith("0: ")
    assert made.counts[Status.hit] == np.count_nonzero(codes == Status.hit)
    here = np.argwhere(image.known)[::997]
    normals = jax.vmap(image.grid.normal)(here.astype(float))
    lat, lon = np.arcsin(normals[:, 2]), np.arctan2(normals[:, 1], normals[:, 0])
    points = jaxgeo.Geodetic(lat=lat, lon=lon, height=np.full(len(here), 100.0))
    seen = jax.vmap(lambda point: jaxgeo.project(SENSOR, above(), point).uv)(points)
    inside = np.clip(seen, 0.0, [119.0, 99.0])  # the outer half of the pixels at the edge
    np.testing.assert_allclose(np.asarray(image.values)[:, *here.T].T / 2.0, inside, atol=0.26)  # pixels
    again = rectify_file(
        tmp_path / "b.tif", tmp_path / "frame.tif", SENSOR, above(), LEVEL, like=tmp_path / "a.tif", bands=2
    )
    assert again.raster.transform == made.raster.transform
    np.testing.assert_array_equal(read_orthoimage(tmp_path / "b.tif").values[0], image.values[1])


@pytest.mark.costly
@pytest.mark.parametrize(
    "change, error, message",
    [
        ({"like": RASTERS["geographic"], "resolution": 1.0}, ValueError, "leave out crs="),
        ({"like": RASTERS["UTM"]}, ValueError, r"shows none of the 40 x 50 cells"),
        ({"shot": above(pitch=85.0)}, ValueError, "at the image's sampling the map would have"),
        ({"image": "small.tif"}, ImageError, "at 0.5 times its size"),
        ({"path": "nowhere/a.tif"}, FileNotFoundError, "there is no folder"),
        ({"path": "frame.tif"}, ValueError, "frame.tif: this is an input, and would be overwritten"),
        ({"path": "small.tif", "like": "small.tif"}, ValueError, "small.tif: this is an input"),
        ({"path": "a.tif", "like": "a_status.tif", "status": True}, ValueError, "a_status.tif: this is an input"),
        ({"crs": 32632, "resolution": 1e-5}, ValueError, "a resolution of 1e-05 .*; name a coarser resolution="),
        ({"crs": 32632, "resolution": 1e-320}, ValueError, "would have inf x inf cells"),
        ({"like": RASTERS["UTM"]._replace(shape=(2**19, 2**18))}, ValueError, "524288 x 262144 cells is larger than"),
    ],
)
def test_what_cannot_be_rectified_is_refused(tmp_path, change: dict, error: type, message: str) -> None:
    write(tmp_path / "frame.tif", np.ones((100, 120), np.uint8))
    write(tmp_path / "small.tif", np.ones((50, 60), np.uint8))
    given = {"path": "a.tif", "image": "frame.tif", "sensor": SENSOR, "shot": above(), "terrain": LEVEL, **change}
    for name in ("path", "image", "like"):
        given |= {name: tmp_path / given[name]} if isinstance(given.get(name), str) else {}
    with pytest.raises(error, match=message):
        rectify_file(**given)
    assert len(list(tmp_path.iterdir())) == 2
