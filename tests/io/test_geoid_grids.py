"""Geoid grids by their path: read as their own posts say, from wherever their longitudes start, or refused.

Held against: RAF20 as IGN publishes it, EGM96 of PROJ's own data, and PROJ's look-up at the posts of grids that GDAL
writes as GTX and GeoTIFF.
"""

from __future__ import annotations

import pathlib
import struct
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj.exceptions import ProjError
from pyproj.transformer import Transformer
from rasterio.transform import Affine
from support.rasters import hills, write

from jaxgeo.io import VerticalDatumError, read_dem, undulation
from jaxgeo.io._proj import DATA
from jaxgeo.io._tiff import layout_mistake
from jaxgeo.io.geoid_grid import check_grids_of
from jaxgeo.io.vertical import height_shift

EGM96 = DATA / "us_nga_egm96_15.tif"
HAWAII = (19.5, -155.5, 26.575796)  # lat, lon, undulation: a post of the grid
PLACES = [(19.5, -155.5), (-33.3, -70.6), (45.1, 6.2), (-41.2, 174.9), (51.4, -0.06), (10.3, 179.97), (-17.3, -179.96)]


def nodes() -> np.ndarray:
    """EGM96 at 15', rows from north, 1440 columns from 180 W."""
    with rasterio.open(EGM96) as data:
        return data.read(1)


def by_hand(lat: float, lon: float) -> float:
    """Bilinear from the nodes, without PROJ."""
    grid, row, col = nodes().astype(np.float64), (90.0 - lat) * 4.0, ((lon + 180.0) % 360.0) * 4.0
    r, c = int(row), int(col)
    u, v, e = row - r, col - c, (c + 1) % 1440
    return (1 - u) * ((1 - v) * grid[r, c] + v * grid[r, e]) + u * ((1 - v) * grid[r + 1, c] + v * grid[r + 1, e])


def write_gtx(path: pathlib.Path, west: float, values: np.ndarray) -> pathlib.Path:
    """The layout of GTX: big-endian south, west, steps in deg, rows, columns; rows from the south."""
    header = struct.pack(">ddddii", -90.0, west, 0.25, 0.25, *values.shape)
    path.write_bytes(header + values[::-1].astype(">f4").tobytes())
    return path


def write_tif(path: pathlib.Path, west: float, values: np.ndarray, point: bool = True) -> pathlib.Path:
    affine = Affine(0.25, 0.0, west - 0.125, 0.0, -0.25, 90.125)
    return write(path, values.astype(np.float32), affine=affine, point=point)


def starting_at(west: float, repeated: bool) -> np.ndarray:
    """The nodes from another meridian on, which may stand again at the end."""
    turned = np.roll(nodes(), -round((west + 180.0) * 4.0), axis=1)
    return np.concatenate([turned, turned[:, :1]], axis=1) if repeated else turned


GLOBAL = [  # every pair of the three is among them
    (west, (row + column) % 2 == 0, kind)
    for row, west in enumerate((-180.0, 0.0, -90.0))
    for column, kind in enumerate(("gtx", "tif", "tif of areas"))
]


@pytest.mark.costly
@pytest.mark.parametrize("west, repeated, kind", GLOBAL)
def test_a_global_grid_is_read_alike_in_all_quadrants(
    tmp_path: pathlib.Path, west: float, repeated: bool, kind: str
) -> None:
    values = starting_at(west, repeated)
    if kind == "gtx":
        path = write_gtx(tmp_path / "geoid.gtx", west, values)
    else:
        path = write_tif(tmp_path / "geoid.tif", west, values, point=kind == "tif")
    lat, lon = np.array([*PLACES, HAWAII[:2]]).T
    found = undulation(lat, lon, path)
    np.testing.assert_allclose(found, [by_hand(*place) for place in zip(lat, lon, strict=True)], rtol=0, atol=1e-6)
    np.testing.assert_allclose(undulation(lat, lon % 360.0, path), found, rtol=0, atol=1e-6)
    assert found[-1] == pytest.approx(HAWAII[2], abs=1e-6)


def test_terrain_in_hawaii_stands_on_the_grid_of_its_place(tmp_path: pathlib.Path) -> None:
    path = write_gtx(tmp_path / "geoid.gtx", 0.0, starting_at(0.0, True))
    dem = write(tmp_path / "dem.tif", hills((5, 6)), affine=Affine(1e-6, 0, -155.5, 0, -1e-6, 19.5))
    posts = np.asarray(read_dem(dem, vertical_datum=path).posts)
    np.testing.assert_allclose(posts, hills((5, 6)) + HAWAII[2], rtol=0, atol=1e-3)


def test_a_part_across_the_date_line_is_read(tmp_path: pathlib.Path) -> None:
    path = write_tif(tmp_path / "pacific.tif", 170.0, starting_at(170.0, False)[:, :120])
    lat, lon = np.array([-17.3, 52.1, 10.0, -30.0]), np.array([-179.96, 179.97, 170.0, -175.5])
    expected = [by_hand(*place) for place in zip(lat, lon, strict=True)]
    np.testing.assert_allclose(undulation(lat, lon, path), expected, rtol=0, atol=1e-6)
    assert np.isnan(undulation(0.0, 100.0, path))


def test_the_grids_that_come_with_the_data_are_read(jaxgeo_test_data: pathlib.Path) -> None:
    assert 40.0 < undulation(48.85, 2.35, jaxgeo_test_data / "geoid" / "fr_ign_RAF20.tif") < 50.0
    assert undulation(*HAWAII[:2], EGM96) == pytest.approx(HAWAII[2], abs=1e-6)


def test_a_grid_whose_posts_proj_does_not_give_back_is_refused(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_gtx(tmp_path / "geoid.gtx", 0.0, starting_at(0.0, True))
    monkeypatch.setattr("jaxgeo.io.geoid_grid._first_longitude", lambda _: -180.0)  # as PROJ counts by itself
    with pytest.raises(
        VerticalDatumError, match=r"PROJ reads the geoid grid .*geoid\.gtx wrongly: at its post .* W it"
    ):
        undulation(0.0, 0.0, path)


def test_a_grid_that_is_not_in_degrees_is_refused(tmp_path: pathlib.Path) -> None:
    affine = Affine(1000.0, 0.0, 400_000.0, 0.0, -1000.0, 5_000_000.0)
    path = write(tmp_path / "geoid.tif", hills((20, 20)).astype(np.float32), crs="EPSG:32631", affine=affine)
    with pytest.raises(VerticalDatumError, match=r"geoid grid .*geoid\.tif"):
        undulation(45.0, 3.0, path)


@pytest.mark.parametrize("changes", [{"scale": 0.0}, {"scale": float("inf")}, {"offset": float("nan")}])
def test_a_grid_that_gives_all_posts_one_value_or_none_is_refused(
    tmp_path: pathlib.Path, changes: dict[str, float]
) -> None:
    affine = Affine(0.25, 0.0, 2.875, 0.0, -0.25, 45.125)
    path = write(tmp_path / "geoid.tif", hills((20, 20)).astype(np.float32), affine=affine, **changes)
    with pytest.raises(VerticalDatumError, match=r"geoid grid .*geoid\.tif states scale"):
        undulation(44.0, 4.0, path)


def test_a_grid_in_projs_own_folder_is_held_against_its_posts(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What EPSG:5773 takes where a user's folder holds EGM96 from 0 to 360 deg under PROJ's name."""
    path = write_tif(tmp_path / "us_nga_egm96_15.tif", 0.0, starting_at(0.0, True))
    monkeypatch.setattr("jaxgeo.io.geoid_grid._grids_of", lambda transformer: [path])
    with pytest.raises(VerticalDatumError, match=r"its geoid grid .*us_nga_egm96_15\.tif wrongly: at its post .* W it"):
        undulation(0.0, 0.0)
    write_tif(path, -180.0, starting_at(-180.0, False))
    assert undulation(*HAWAII[:2]) == pytest.approx(HAWAII[2], abs=1e-6)


def test_the_operation_of_egm96_names_its_grid() -> None:
    from jaxgeo.io import geoid_grid

    transformer = height_shift(5773).transformer
    assert transformer is not None
    kept = geoid_grid.DATA
    try:
        geoid_grid.DATA = pathlib.Path("elsewhere")
        assert [path.name for path in geoid_grid._grids_of(transformer)] == ["us_nga_egm96_15.tif"]
        check_grids_of(transformer)
    finally:
        geoid_grid.DATA = kept


def test_proj_by_itself_reads_a_repeated_meridian_one_column_off(tmp_path: pathlib.Path) -> None:
    """The reason of all this; where this fails, PROJ has been mended."""
    path = write_gtx(tmp_path / "geoid.gtx", 0.0, starting_at(0.0, True))
    try:
        by_proj = Transformer.from_pipeline(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
            f"+step +proj=vgridshift +grids={path} +multiplier=1 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
        )
    except ProjError as error:
        pytest.skip(str(error))
    assert by_proj.transform(HAWAII[1], HAWAII[0], 0.0)[2] == pytest.approx(23.1145, abs=1e-3)


PROFILES = [{}, {"BIGTIFF": "YES"}, {"ENDIANNESS": "BIG"}, {"tiled": True, "blockxsize": 16, "blockysize": 16}]


def of_profile(path: pathlib.Path, **profile: Any) -> pathlib.Path:
    posts = np.linspace(40.0, 50.0, 21 * 21, dtype=np.float32).reshape(21, 21)
    transform = rasterio.Affine(0.1, 0, 3.95, 0, -0.1, 46.05)
    made: dict[str, Any] = {"driver": "GTiff", "dtype": "float32", "count": 1, "height": 21, "width": 21}
    with rasterio.open(path, "w", crs="EPSG:4326", transform=transform, **made, **profile) as sink:
        sink.write(posts, 1)
    return path


@pytest.mark.parametrize("profile", PROFILES, ids=str)
def test_a_tiff_whose_blocks_have_no_size_never_reaches_proj(tmp_path: pathlib.Path, profile: dict[str, Any]) -> None:
    """PROJ divides by the sizes of blocks, of strips or tiles, and the whole process ends where they are zero."""
    path = of_profile(tmp_path / "geoid.tif", **profile)
    assert layout_mistake(path) == ""
    assert 40.0 < undulation(45.0, 5.0, path) < 50.0
    content = path.read_bytes()
    order, is_big = ("<" if content[:2] == b"II" else ">"), "BIGTIFF" in profile
    names = {256: "ImageWidth", 257: "ImageLength"}
    names |= {322: "TileWidth", 323: "TileLength"} if "tiled" in profile else {278: "RowsPerStrip"}
    for tag, name in names.items():
        entry = min(content.find(struct.pack(order + "HH", tag, kind), 8) % len(content) for kind in (3, 4))
        changes = {entry + (12 if is_big else 8): bytes(4), entry + 4: bytes(4), entry + 2: struct.pack(order + "H", 2)}
        for at, new in changes.items():  # the value zero, no value, a text
            path.write_bytes(content[:at] + new + content[at + len(new) :])
            with pytest.raises(
                VerticalDatumError, match=f"geoid.tif is damaged: its tag {name} is no number above zero"
            ):
                undulation(45.0, 5.0, path)
