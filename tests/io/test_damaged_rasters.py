"""Rasters that GDAL reads though they are damaged: what it gives then is no value of the file, and is refused."""

from __future__ import annotations

import pathlib
import zipfile
import zlib

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine
from support.rasters import DEGREE, hills, lose_tag, write

from jaxgeo.io import DemError, ImageError, read_dem, read_image

GRID = "ncols 3\nnrows 3\nxllcorner 5.0\nyllcorner 45.0\ncellsize 0.01\nNODATA_value -9999\n1 2 3\n4 5.5 6\n7 8 9\n"


def grid(path: pathlib.Path, text: str) -> pathlib.Path:
    path.write_text(text)
    path.with_suffix(".prj").write_text(rasterio.CRS.from_epsg(4326).to_wkt())
    return path


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("5.5", "5.5.5", "'5.5.5'"),
        ("5.5", "5x5", "'5x5'"),
        ("\nyllcorner", "\n\tyllcorner", "begin at 'yllcorner', not at '1'"),
        ("\nxll", "\nx\x0cll", "begin at 'llcorner', not at '1'"),
        ("NODATA_value", "N0DATA_value", "begin at '0DATA_value', not at '1'"),
        ("1 2 3", "inf 2 3", "begin at '4', not at 'inf'"),
        ("xllcorner 5.0\n", "", "neither xllcorner and yllcorner nor xllcenter"),
        ("xllcorner", "xxllcorner", "neither xllcorner and yllcorner nor xllcenter"),
        ("xllcorner", "xllcorner\x0c", "neither xllcorner and yllcorner nor xllcenter"),
        ("yllcorner", "yllcenter", "neither xllcorner and yllcorner nor xllcenter"),
        ("xllcorner ", "xllcorner a b ", "'a', which its header states as xllcorner, is not a number"),
        ("NODATA_value -9999", "NODATA_value", "'', which its header states as nodata_value, is not a number"),
        ("cellsize 0.01", "yllcorner 46.0\ncellsize 0.01", "states yllcorner twice, as 45.0 and 46.0"),
        ("0.01", "0.010.01", "'0.010.01'"),
        ("1 2", "12", "8 values"),
        ("7 8", "7 8 8", "10 values"),
        ("9\n", "9\n\x00", ""),
    ],
)
def test_words_of_a_text_grid_that_are_no_numbers_are_no_heights(
    tmp_path: pathlib.Path, old: str, new: str, words: str
) -> None:
    read_dem(grid(tmp_path / "a.asc", GRID), vertical_datum="ellipsoid")
    with pytest.raises(DemError, match="damaged") as error:
        read_dem(grid(tmp_path / "b.asc", GRID.replace(old, new)), vertical_datum="ellipsoid")
    assert words in str(error.value)


def test_a_grid_of_grass_that_states_an_edge_twice_is_refused(tmp_path: pathlib.Path) -> None:
    text = "north: 46\nsouth: 45\neast: 6\nwest: 5\nrows: 2\ncols: 3\n1 2 3\n4 5.5 6\n"
    read_dem(grid(tmp_path / "a.asc", text), vertical_datum="ellipsoid")
    with pytest.raises(DemError, match="states east twice, as 6 and 7"):
        read_dem(grid(tmp_path / "b.asc", text.replace("east: 6", "east: 6\neast: 7")), vertical_datum="ellipsoid")


@pytest.mark.parametrize(
    "written, row",
    [
        ("1e3 2 3", [1000.0, 2.0, 3.0]),
        ("+1 -2 3", [1.0, -2.0, 3.0]),
        (".5 2 3", [0.5, 2.0, 3.0]),
        ("nan 2 3", [np.nan, 2.0, 3.0]),
        ("1,5 2 3", [1.5, 2.0, 3.0]),
        ("1\t2\r\n3", [1.0, 2.0, 3.0]),
    ],
)
def test_numbers_of_a_text_grid_as_programs_write_them_are_read(
    tmp_path: pathlib.Path, written: str, row: list[float]
) -> None:
    dem = read_dem(grid(tmp_path / "a.asc", GRID.replace("1 2 3", written)), vertical_datum="ellipsoid")
    expected = np.array([row, [4.0, 5.5, 6.0], [7.0, 8.0, 9.0]])
    void = np.isnan(expected)
    np.testing.assert_array_equal(np.asarray(dem.void), void)
    np.testing.assert_array_equal(np.asarray(dem.posts)[~void], expected[~void])


@pytest.mark.parametrize("driver, ending", [("ENVI", ".img"), ("GTX", ".gtx"), ("EHdr", ".bil"), ("BT", ".bt")])
@pytest.mark.parametrize("share", [0.5, 0.99])
def test_a_raw_file_that_is_cut_short_is_refused(
    tmp_path: pathlib.Path, driver: str, ending: str, share: float
) -> None:
    path = tmp_path / f"a{ending}"
    heights = hills((9, 11)).astype(np.float32)
    transform = rasterio.Affine(DEGREE, 0, 5.0, 0, -DEGREE, 45.0)
    profile = {"driver": driver, "dtype": "float32", "count": 1, "height": 9, "width": 11, "crs": "EPSG:4326"}
    with rasterio.open(path, "w", transform=transform, **profile) as sink:
        sink.write(heights, 1)
    whole = path.read_bytes()
    np.testing.assert_array_equal(read_image(path)[0][0], heights)
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ImageError, match=path.name):
        read_image(path)


def test_a_damaged_png_is_refused(tmp_path: pathlib.Path) -> None:
    """GDAL's own way for whole images gives what lies in memory."""
    path, rng = tmp_path / "a.png", np.random.default_rng(3)
    values = rng.integers(0, 255, (3, 40, 50)).astype(np.uint8)
    with rasterio.open(path, "w", driver="PNG", dtype="uint8", count=3, height=40, width=50) as sink:
        sink.write(values)
    whole = path.read_bytes()
    np.testing.assert_array_equal(read_image(path)[0], values)
    for at in rng.integers(60, len(whole) - 30, 30):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        with pytest.raises(ImageError, match=r"a\.png"):
            read_image(path)


@pytest.mark.parametrize("tiled", [False, True])
def test_a_deflated_block_that_goes_on_is_refused(tmp_path: pathlib.Path, tiled: bool) -> None:
    """libtiff takes it for whole, and leaves the last values of the block as they are in memory."""
    path = tmp_path / "a.tif"
    how = {"tiled": True, "blockxsize": 16, "blockysize": 16} if tiled else {}
    write(path, hills((16, 16)).astype(np.float32), compress="deflate", **how)
    with rasterio.open(path) as data:
        at, size = (int(data.get_tag_item(f"BLOCK_{what}_0_0", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE"))
    content = path.read_bytes()
    values = zlib.decompress(content[at : at + size])
    other = zlib.compress(values[:-300] + b"\x07" * 900, 9)
    read_dem(path, vertical_datum="ellipsoid")
    assert len(other) <= size
    path.write_bytes(content[:at] + other.ljust(size, b"\0") + content[at + size :])
    with pytest.raises(DemError, match="damaged"):
        read_dem(path, vertical_datum="ellipsoid")
    with pytest.raises(ImageError, match="damaged"):
        read_image(path)


@pytest.mark.parametrize("name", ["N44E005.hgt.zip", "N44E005.SRTMGL3.hgt.zip"])
def test_an_srtm_tile_in_its_archive_is_read_unless_it_is_damaged(tmp_path: pathlib.Path, name: str) -> None:
    """As the tiles are distributed; GDAL does not look at the archive's checksum."""
    path, rows = tmp_path / name, np.arange(1201)
    heights = (200 + 100 * np.sin(rows[:, None] / 90.0) * np.cos(rows / 70.0)).astype(">i2")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("N44E005.hgt", heights.tobytes())
    np.testing.assert_array_equal(read_image(path)[0][0], heights)
    whole = path.read_bytes()
    for at in (len(whole) // 3, len(whole) // 2):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        with pytest.raises(ImageError, match=r"hgt\.zip"):
            read_image(path)


@pytest.mark.parametrize("tag", [33550, 33922, 34735, 42113], ids=["scale", "place", "CRS", "nodata"])
def test_a_dem_whose_header_is_not_read_whole_is_refused(tmp_path: pathlib.Path, tag: int) -> None:
    """GDAL warns, and goes on: without a place, or with voids as heights of -9999 m."""
    path = write(
        tmp_path / "dem.tif", hills((64, 64)), crs="EPSG:32633", affine=Affine(30, 0, 5e5, 0, -30, 5e6), nodata=-9999.0
    )
    lose_tag(path, tag)
    with pytest.raises(DemError, match="damaged or cut short: its tag G"):
        read_dem(path, vertical_datum="ellipsoid")
