"""What the reader refuses, each with the file, the place and the reason."""

from __future__ import annotations

import pathlib
import pickle
import zipfile
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.control import GroundControlPoint
from rasterio.transform import Affine
from support.rasters import DEGREE, hills, write

from jaxgeo.io import DemError, ImageError, TableError, VerticalDatumError, read_dem
from jaxgeo.io.scene import SceneError

HERE = Affine(DEGREE, 0, 5.0, 0, -DEGREE, 45.0)
LAMBERT = "+proj=lcc +lat_1=45 +lat_2=46 +lat_0=45.5 +lon_0=3 +ellps=GRS80"


def archive(path: pathlib.Path) -> pathlib.Path:
    with zipfile.ZipFile(path.with_suffix(".zip"), "w") as sink:
        sink.write(write(path, hills((5, 6))), "dem.tif")
    return path.with_suffix(".zip")


def of_another_format(path: pathlib.Path) -> pathlib.Path:
    """One that GDAL reads, but that is on no list here."""
    rasterio.shutil.copy(write(path, hills((5, 6)).astype(np.float32)), path.with_suffix(".kro"), driver="KRO")
    return path.with_suffix(".kro")


def text_file(path: pathlib.Path) -> pathlib.Path:
    path.write_text("no raster")
    return path


def truncated(path: pathlib.Path) -> pathlib.Path:
    write(path, hills((200, 200)))
    path.write_bytes(path.read_bytes()[:100_000])
    return path


def corrupt(path: pathlib.Path) -> pathlib.Path:
    write(path, hills((200, 200)), compress="deflate")
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 2000] = b"\x5a" * 2000
    path.write_bytes(content)
    return path


def with_gcps(path: pathlib.Path) -> pathlib.Path:
    gcps = [GroundControlPoint(r, c, 5.0 + c * DEGREE, 45.0 - r * DEGREE) for r in (0, 5) for c in (0, 6)]
    with rasterio.open(path, "w", driver="GTiff", dtype="float64", count=1, height=5, width=6) as sink:
        sink.gcps = (gcps, "EPSG:4326")
        sink.write(hills((5, 6)), 1)
    return path


LONG = "(" * 50_000


@pytest.mark.parametrize("kind", [DemError, VerticalDatumError, TableError, ImageError])
def test_a_refusal_is_one_line_however_strange_what_it_quotes(kind: type[Exception]) -> None:
    """Advice at its end stays; names of files keep their spaces and letters."""
    assert str(kind("a  \u00e4 b.tif: row 2\n  is wrong.\r\nUse\x1b[31m another.")) == (
        "a  \u00e4 b.tif: row 2 is wrong. Use\\x1b[31m another."
    )
    long = str(kind(f"a.csv, row 2, column u: '{LONG}' is not a number; expected pixels."))
    assert long.startswith("a.csv, row 2, column u: '((((")
    assert long.endswith("' is not a number; expected pixels.")
    assert len(long) < 1100
    assert str(pickle.loads(pickle.dumps(kind(long)))) == long


def test_a_scene_error_has_a_line_for_each_mistake() -> None:
    assert str(SceneError("a.toml: one.\na.toml: two.")) == "a.toml: one.\na.toml: two."
    many = str(SceneError("\n".join(f"a.toml: {k} {LONG}" for k in range(1000)))).splitlines()
    assert len(many) == 21
    assert many[-1] == "... and 980 more mistakes."
    assert max(map(len, many)) < 1100


def plain(**changes: Any) -> Callable[[pathlib.Path], pathlib.Path]:
    heights = changes.pop("heights", hills((5, 6)))
    return lambda path: write(path, heights, **changes)


REFUSED: dict[str, tuple[Callable[[pathlib.Path], pathlib.Path], dict[str, Any], str]] = {
    "not a raster": (text_file, {}, r"not a raster that GDAL can open"),
    "an archive": (archive, {}, r"It is an archive: unpack it first"),
    "another format": (of_another_format, {}, r"Pass allow_remote=True .*, or write it to a GeoTIFF first"),
    "truncated": (truncated, {}, r"rows 0 to 200 cannot be read; the file is damaged or cut short"),
    "corrupt": (corrupt, {}, r"the file is damaged: the block in row \d+ and column 0 of its blocks does not fit"),
    "no band": (plain(), {"band": 2}, r"there is no band 2; the file has 1"),
    "no CRS": (plain(crs=None), {}, r"names no coordinate reference system.*gdal_edit"),
    "local CRS": (
        plain(crs='LOCAL_CS["site",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'),
        {},
        r"'site' .* does not say where on the Earth",
    ),
    "no geotransform": (plain(affine=None), {}, r"it has no geotransform. Warp it first"),
    "control points": (with_gcps, {}, r"it is placed by ground control points only"),
    "all void": (
        plain(heights=np.full((5, 6), -9999.0), nodata=-9999.0),
        {},
        r"all 30 posts of rows 0 to 4, columns 0 to 5 are void",
    ),
    "complex": (plain(heights=np.ones((5, 6), np.complex64)), {}, r"band 1 holds complex numbers \(complex64\)"),
    "picture": (
        plain(heights=np.ones((3, 5, 6), np.uint8), photometric="RGB"),
        {},
        r"band 1 is the red channel of a picture",
    ),
    "one row": (plain(heights=hills((1, 6))), {}, r"1 x 6 posts make no surface"),
    "latitude": (plain(affine=Affine(0.1, 0, 5, 0, 0.1, 89.8)), {}, r"posts at latitude 90\.25 deg, past a pole"),
    "axes swapped": (plain(affine=Affine(0.01, 0, 45, 0, -0.01, 135)), {}, r"latitude 13\d.* deg, past a pole"),
    "squeezed": (plain(affine=Affine(0.1, 0.1, 5, 0.1, 0.1, 45)), {}, r"squeezes the raster into a line"),
    "undeclared void": (
        plain(heights=np.where(np.eye(5, 6) > 0, -32768, 100).astype(np.int16)),
        {},
        r"5 posts, the first at row 0, column 0, are exactly -32768, .* no nodata tag.*nodata=-32768",
    ),
    "scale 0": (plain(scale=0.0, offset=10.0), {}, r"scale 0 and offset 10 of its heights.*gdal_edit -scale 1"),
    "no finite scale": (plain(scale=float("inf")), {}, r"scale inf and offset 0 of its heights"),
    "no finite offset": (plain(offset=float("nan")), {}, r"scale 1 and offset nan of its heights"),
    "unit": (plain(unit="fathom"), {}, r"the unit of band 1 is 'fathom', no known unit of height"),
    "height_unit": (plain(), {"height_unit": "yd"}, r"height_unit is 'yd', no known unit of height"),
    "units at odds": (plain(crs="EPSG:4326+5773", unit="ft"), {"vertical_datum": None}, r"in 'ft'.*has a unit of 1 m"),
    "a map in feet": (
        plain(crs="EPSG:2263", affine=Affine(30, 0, 980000, 0, -30, 200000)),
        {},
        r"the map is in US survey foot and nothing says whether the heights are too",
    ),
    "a map in feet, a datum in metres": (
        plain(crs="EPSG:2263", affine=Affine(30, 0, 980000, 0, -30, 200000)),
        {"vertical_datum": "EPSG:5773"},
        r"the map is in US survey foot and nothing says whether the heights are too",
    ),
    "untagged -9999": (
        plain(heights=np.where(np.eye(5, 6) > 0, -9999, 100).astype(np.int16)),
        {},
        r"5 posts, the first at row 0, column 0, are exactly -9999, .* no nodata tag.*nodata=-9999",
    ),
    "ballpark datum": (
        plain(crs=LAMBERT, affine=Affine(30, 0, 0, 0, -30, 0)),
        {},
        r"no transformation from .* to WGS 84 but a ballpark one.*assume_wgs84=True",
    ),
    "too wide": (
        plain(crs="EPSG:3395", affine=Affine(6e6, 0, -2e7, 0, -3e6, 9e6)),
        {},
        r"covers too much of the Earth",
    ),
    "rounded": (plain(), {"dtype": np.int16}, r"dtype=int16 would round the heights"),
    "half precision": (plain(), {"dtype": np.float16}, r"dtype=float16 cannot hold heights"),
    "endless ceiling": (plain(), {"void_ceiling": float("inf")}, r"void_ceiling must be a finite height"),
    "bounds elsewhere": (plain(), {"bounds": (10, 50, 11, 51)}, r"\(10, 50, 11, 51\) deg hold no posts.*covers long"),
    "bounds upside down": (plain(), {"bounds": (5, 45, 6, 44)}, r"must have -90 <= south < north <= 90 deg; got .*45"),
    "bounds empty": (plain(), {"bounds": (5, 44, 5, 45)}, r"the bounds are empty, west = east = 5 deg"),
    "bounds not finite": (plain(), {"bounds": (5, 44, float("nan"), 45)}, r"bounds must be finite"),
    "bounds in metres": (plain(), {"bounds": (650000, 4900000, 660000, 4910000)}, r"longitudes within 360 deg"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")  # as these files are written
@pytest.mark.parametrize("kind", REFUSED)
def test_the_message_names_the_file_and_the_reason(tmp_path: pathlib.Path, kind: str) -> None:
    make, given, reason = REFUSED[kind]
    path = make(tmp_path / "dem.tif")
    name = "" if kind == "height_unit" else rf"dem\{path.suffix}: "
    options: dict[str, Any] = {"vertical_datum": "ellipsoid"} | given
    with pytest.raises(DemError, match="(?s)" + name + ".*" + reason):
        read_dem(path, **options)


def test_a_missing_file_is_named() -> None:
    with pytest.raises(FileNotFoundError, match=r"/nowhere/dem\.tif: no such file"):
        read_dem("/nowhere/dem.tif", vertical_datum="ellipsoid")


def test_no_file_at_all() -> None:
    with pytest.raises(DemError, match="no file was named"):
        read_dem([], vertical_datum="ellipsoid")


@pytest.mark.parametrize(
    "changes, reason",
    [
        ({"crs": "EPSG:4258"}, r"b\.tif: its CRS is 'ETRS89', that of .*a\.tif is 'WGS 84'; tiles must share one grid"),
        ({"affine": Affine(DEGREE * 1.01, 0, 5.1, 0, -DEGREE, 45.0)}, r"b\.tif: its posts are spaced 0\.000841"),
        ({"affine": Affine(DEGREE, 0, 5.1 + DEGREE / 3, 0, -DEGREE, 45.0)}, r"falls at row .*, column 120\.333"),
        ({"unit": "ft"}, r"b\.tif: its heights are in ft, those of .*a\.tif in no unit"),
    ],
)  # fmt: skip
def test_tiles_off_the_grid_are_refused(tmp_path: pathlib.Path, changes: dict[str, Any], reason: str) -> None:
    a = write(tmp_path / "a.tif", hills((5, 6)))
    options: dict[str, Any] = {"affine": Affine(DEGREE, 0, 5.1, 0, -DEGREE, 45.0)} | changes
    b = write(tmp_path / "b.tif", hills((5, 6)), **options)
    with pytest.raises(DemError, match=reason):
        read_dem([a, b], vertical_datum="ellipsoid")


def test_what_was_refused_is_read_once_it_is_said(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", hills((5, 6)), crs=LAMBERT, affine=Affine(30, 0, 0, 0, -30, 0))
    assert np.all(np.isfinite(read_dem(path, vertical_datum="ellipsoid", assume_wgs84=True).posts))


def test_32_bit_floats_are_refused_before_anything_is_read() -> None:
    with jax.enable_x64(False), pytest.raises(RuntimeError, match=r"jaxgeo\.enable_x64\(\)"):
        read_dem("/nowhere/dem.tif")


def test_a_terrain_given_as_geoid_is_refused(tmp_path: pathlib.Path) -> None:
    wide = np.full((40, 40), 700.0, np.float32)
    grid = write(tmp_path / "not_a_geoid.tif", wide, affine=Affine(0.1, 0, 3.0, 0, -0.1, 47.0))
    path = write(tmp_path / "dem.tif", hills((5, 6)))
    with pytest.raises(VerticalDatumError, match=r"would move heights by up to 700 m.*Is the grid a geoid's"):
        read_dem(path, vertical_datum=str(grid))
