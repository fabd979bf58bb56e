"""Images: what is read, where there is an image at all, and what is said of files that are none.

Held against: rasters that GDAL writes in several formats, and a frame of NGI, South Africa, as it was published.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from support.rasters import write

import jaxgeo
from jaxgeo.io import ImageError, read_image
from jaxgeo.io.images import check_size

SHAPE = (20, 30)


def picture(dtype: str, bands: int) -> np.ndarray:
    """Values from 1 on, none of them zero."""
    values = np.random.default_rng(4).integers(1, 250, (bands, *SHAPE)).astype(dtype)
    return values + np.asarray(0.25, dtype) if values.dtype.kind == "f" else values


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "float32"])
@pytest.mark.parametrize("bands", [1, 3])
def test_values_come_back_in_their_dtype_without_a_map(tmp_path, dtype: str, bands: int) -> None:
    values = picture(dtype, bands)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the writer: no geotransform
        path = write(tmp_path / "a.tif", values, crs=None, affine=None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, known = read_image(path)
        last, _ = read_image(path, bands)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, values)
    np.testing.assert_array_equal(last, values[-1:])
    assert known.all()


def test_a_pixel_is_unknown_where_all_bands_are_nodata(tmp_path) -> None:
    values = picture("uint8", 3)
    values[:, :4] = 0
    values[0, 10] = 0
    _, known = read_image(write(tmp_path / "a.tif", values, nodata=0), bands=1)
    assert not known[:4].any()
    assert known[4:].all()


def test_a_band_that_is_nowhere_finite_is_named(tmp_path) -> None:
    values = picture("float32", 4)
    values[1], values[3] = np.nan, np.inf
    path = write(tmp_path / "a.tif", values)
    with pytest.raises(ImageError, match=r"bands 2, 4 are nowhere finite.*bands=\[1, 3\].*--band 1 --band 3"):
        read_image(path)
    assert read_image(path, [1, 3])[1].all()
    with pytest.raises(ImageError, match="no pixel is known"):
        read_image(path, 2)


def test_masks_and_alpha_say_where_there_is_an_image(tmp_path) -> None:
    values = picture("uint16", 4)
    values[3, :, :7] = 0
    path = write(tmp_path / "alpha.tif", values)
    with rasterio.open(path, "r+") as data:
        data.colorinterp = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
    found, known = read_image(path)
    assert found.shape == (3, *SHAPE)
    np.testing.assert_array_equal(known, values[3] != 0)
    mask = np.random.default_rng(2).uniform(size=SHAPE) < 0.5
    _, known = read_image(write(tmp_path / "mask.tif", picture("uint8", 3), mask=mask))
    np.testing.assert_array_equal(known, mask)


def test_what_is_not_finite_is_unknown_and_read_as_zero(tmp_path) -> None:
    values = picture("float32", 2)
    values[1, 3, 5], values[0, 4, 6] = np.nan, np.inf
    found, known = read_image(write(tmp_path / "a.tif", values))
    assert np.argwhere(~known).tolist() == [[3, 5], [4, 6]]
    assert found[1, 3, 5] == found[0, 4, 6] == 0.0


@pytest.mark.parametrize(
    "name, bands, message",
    [
        ("a.tif", [], "no band is asked for"),
        ("a.tif", 4, "there is no band 4; the file has bands 1 to 3"),
        ("a.tif", [0], "there is no band 0"),
        ("a.tif", "red", "must be whole numbers"),
        ("complex.tif", None, "complex numbers"),
        ("palette.tif", None, "expand it first"),
        ("nothing.tif", None, "no pixel is known"),
        ("notes.txt", None, "not an image that GDAL can open"),
        ("cut.tif", None, "damaged or cut short"),
        ("folder", None, "this is a folder"),
    ],
)
def test_what_is_no_image_is_refused(tmp_path, name: str, bands, message: str) -> None:
    values = picture("uint8", 3)
    path = write(tmp_path / "a.tif", values)
    write(tmp_path / "complex.tif", values[:1].astype("complex64"))
    write(tmp_path / "nothing.tif", np.zeros_like(values), nodata=0)
    with rasterio.open(write(tmp_path / "palette.tif", values[:1]), "r+") as data:
        data.write_colormap(1, {i: (i, 0, 0, 255) for i in range(256)})
    (tmp_path / "notes.txt").write_text("none")
    (tmp_path / "cut.tif").write_bytes(path.read_bytes()[:-900])
    (tmp_path / "folder").mkdir()
    with pytest.raises(ImageError, match=message) as refusal:
        read_image(tmp_path / name, bands)
    assert name in str(refusal.value)


def test_a_file_that_is_not_there(tmp_path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_image(tmp_path / "none.tif")


@pytest.mark.parametrize(
    "shape, message",
    [((300, 200), "at 0.5 times its size"), ((400, 600), "turned by a quarter"), ((600, 390), "another scene")],
)
def test_an_image_of_another_size_than_the_camera(shape: tuple[int, int], message: str) -> None:
    camera = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=400, height=600)
    check_size("a.tif", (3, 600, 400), camera)
    with pytest.raises(ImageError, match=f"{shape[1]} columns and {shape[0]} rows.*400 and 600.*{message}"):
        check_size("a.tif", shape, camera)


def test_a_real_frame_with_a_wrong_geotransform(jaxgeo_test_data) -> None:
    values, known = read_image(jaxgeo_test_data / "ngi_block/images/3324c_2015_1004_05_0182_RGB.tif")
    assert values.shape == (3, 1152, 640)
    assert values.dtype == np.uint8
    assert known.mean() > 0.99
