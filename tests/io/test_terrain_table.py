"""Terrain as the field has it: unit, scale, voids, container and vertical CRS, combined, against NumPy and PROJ.

What is expected is computed from the values that were written, by NumPy, and by pyproj where a geoid is added.
"""

from __future__ import annotations

import itertools
import pathlib
from typing import Any, NamedTuple

import numpy as np
import pyproj
import pytest
from rasterio.transform import Affine
from support.rasters import DEGREE, gdalbuildvrt, hills, write

from jaxgeo.io import DemError, read_dem

pytestmark = pytest.mark.costly

ROWS, COLS = 8, 10
UNDULATION = -30.0  # m
US_FOOT = 1200 / 3937
HEIGHTS = hills((ROWS, COLS)) + 200.0  # m
VOID = np.s_[3:5, 6:8]


class Unit(NamedTuple):
    """A unit: its word on a band, m, and vertical CRS of the EPSG registry that count in it, upwards and downwards."""

    word: str
    metres: float
    up: int | None
    down: int | None
    code: int | None


M = Unit("metre", 1.0, 5714, 5715, 9001)
FT = Unit("foot", 0.3048, 8050, 8051, 9002)
US_FT = Unit("US survey foot", US_FOOT, 6360, 6358, 9003)
DM = Unit("dm", 0.1, None, None, None)

ALL = [
    (unit, scale, void, container, vertical)
    for unit, scale, void, container, vertical in itertools.product(
        (M, FT, US_FT, DM),
        (1.0, 0.1),
        ("tagged", -9999, -32768),
        ("file", "tiles", "VRT"),
        ("caller", "unknown", "up", "down"),
    )
    if unit.up is not None or vertical == "caller"
]


def crs_of(unit: Unit, vertical: str) -> str:
    """The CRS of a file: no vertical part, one without a name, or one that counts upwards or downwards."""
    if vertical == "caller":
        return "EPSG:4326"
    if vertical != "unknown":
        return f"EPSG:4326+{unit.up if vertical == 'up' else unit.down}"
    flat = pyproj.CRS("EPSG:4326").to_wkt("WKT1_GDAL")
    axis = f'UNIT["{unit.word}",{unit.metres!r},AUTHORITY["EPSG","{unit.code}"]],AXIS["Up",UP]'
    return f'COMPD_CS["unknown",{flat},VERT_CS["unknown",VERT_DATUM["unknown",2005],{axis}]]'


def contained(folder: pathlib.Path, stored: np.ndarray, container: str, **options: Any) -> Any:
    """The values in one file, in two tiles, or in two tiles and a VRT over them that says nothing of heights."""
    if container == "file":
        return write(folder / "dem.tif", stored, **options)
    files = []
    for index, part in enumerate(np.split(stored, 2, axis=1)):
        affine = Affine(DEGREE, 0, 5.0 + index * COLS // 2 * DEGREE, 0, -DEGREE, 45.0)
        files.append(write(folder / f"{index}.tif", part, affine=affine, **options))
    return files if container == "tiles" else gdalbuildvrt(folder / "dem.vrt", files)


def by_pyproj(metres: np.ndarray) -> np.ndarray:
    """Heights above EGM96 as heights above the ellipsoid, at the posts."""
    lon = 5.0 + (np.arange(COLS) + 0.5) * DEGREE
    lat = 45.0 - (np.arange(ROWS) + 0.5) * DEGREE
    lon, lat = np.meshgrid(lon, lat)
    msl = pyproj.Transformer.from_crs("EPSG:4326+5773", "EPSG:4979", always_xy=True, allow_ballpark=False)
    return msl.transform(lon, lat, metres)[2]


def named(row: tuple[Unit, float, str | int, str, str]) -> str:
    unit, scale, void, container, vertical = row
    return f"{unit.word} x {scale:g}, void {void}, {container}, {vertical}"


QUICK = 4  # of so many rows one is run always; all with --slow


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, id=named(row), marks=() if index % QUICK == 0 else (pytest.mark.slow,))
        for index, row in enumerate(ALL)
    ],
)
def test_heights_are_those_that_were_written(row: Any, tmp_path: pathlib.Path) -> None:
    unit, scale, void, container, vertical = row
    sign = -1.0 if vertical == "down" else 1.0
    stored = np.round(sign * HEIGHTS / (unit.metres * scale)).astype(np.int32)
    metres = sign * stored * scale * unit.metres
    is_tagged = void == "tagged"
    stored[VOID] = mark = -32768 if is_tagged else void
    dem = contained(
        tmp_path, stored, container, crs=crs_of(unit, vertical), scale=scale, nodata=mark if is_tagged else None,
        unit=unit.word if vertical == "caller" else None,
    )  # fmt: skip
    options: dict[str, Any] = {"vertical_datum": "EPSG:5773" if vertical == "caller" else UNDULATION}
    if not is_tagged:
        with pytest.raises(DemError, match=rf"exactly {mark}, .* no nodata tag for that.* Pass nodata={mark}\."):
            read_dem(dem, **options)
        options["nodata"] = mark
    found = read_dem(dem, **options)
    expected = by_pyproj(metres) if vertical == "caller" else metres + UNDULATION
    unknown = np.zeros(stored.shape, bool)
    unknown[VOID] = True
    np.testing.assert_array_equal(found.void, unknown)
    np.testing.assert_allclose(np.asarray(found.posts)[~unknown], expected[~unknown], rtol=0, atol=1e-9)
