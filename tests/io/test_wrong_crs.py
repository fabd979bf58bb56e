"""Names of maps and vertical datums that are none, wherever they may be given: refused in words, never a fault.

Held against: PROJ, which knows some of them in one place and not in another; the judge is the command line's own.
"""

from __future__ import annotations

import json
import pathlib
import re
from collections.abc import Callable
from typing import Any

import pytest
import rasterio

from jaxgeo._refusals import is_refusal
from jaxgeo.io import (
    DemError,
    ImageError,
    read_dem,
    read_gcp_list,
    read_opensfm,
    read_orientations,
    read_orthoimage,
    write_fixes,
)
from tests.fuzz.sound_files import GCP, OPK, ORIENTATIONS, RECONSTRUCTION, raster, vrt
from tests.support.made_fixes import made

NONE = (
    "", " ", "x", "EPSG:", "EPSG:99999999999999999999", "EPSG:-1", "9" * 5000, "\x00", "EPSG:4326\x00", "\udcff",
    "+proj=utm +zone=99", "+proj=utm +zone=999999999999", "+proj=lcc", "+proj=ob_tran", "{}", "GEOGCS[",
    "PROJCS[" * 500,
    '{"type":"GeographicCRS"}', "EPSG:4326+9999", "+proj=merc +a=0", "+proj=merc +a=nan", "/etc/passwd", "x" * 300,
    "+proj=utm +zone=32 +nadgrids=nope.gsb +type=crs", "EPSG:4978",
    rasterio.CRS.from_epsg(32651).to_wkt().replace('"EPSG","4326"', '"EPSG","4326("'),
)  # fmt: skip
OTHER_KINDS = (10**30, -1, 4326.5, float("nan"), float("inf"), True, b"EPSG:4326", [], {})
DAMAGED = rasterio.CRS.from_epsg(4326).to_wkt().replace('"EPSG","4326"', '"EPSG","4326("')
FEW = {"map of orientations", "datum of orientations"}


def gcp(folder: pathlib.Path, projection: Any) -> Any:
    path = folder / "gcp.txt"
    path.write_text(f"{projection}\n" + GCP[0].split("\n", 1)[1], encoding="utf-8", errors="surrogateescape")
    return read_gcp_list(path, height_datum=20.0)


ASKED: dict[str, Callable[[pathlib.Path, Any], Any]] = {
    "map of orientations": lambda folder, one: read_orientations(folder / "opk.csv", height_datum=20.0, crs=one),
    "datum of orientations": lambda folder, one: read_orientations(folder / "hpr.csv", height_datum=one),
    "projection of control points": gcp,
    "map of a reconstruction": lambda folder, one: read_opensfm(folder / "r.json", height_datum=20.0, crs=one),
    "datum of terrain": lambda folder, one: read_dem(folder / "dem.tif", vertical_datum=one),
    "map of fixes": lambda folder, one: write_fixes(folder / "a.gpkg", made(), crs=one),
    "heights of fixes": lambda folder, one: write_fixes(folder / "a.csv", made(), heights=one),
}


@pytest.mark.costly
@pytest.mark.parametrize("asked", [pytest.param(k, marks=() if k in FEW else pytest.mark.slow) for k in ASKED])
def test_what_is_no_crs_is_refused_in_words(tmp_path: pathlib.Path, asked: str) -> None:
    (tmp_path / "opk.csv").write_text(OPK)
    (tmp_path / "hpr.csv").write_text(ORIENTATIONS)
    (tmp_path / "r.json").write_text(json.dumps([RECONSTRUCTION]))
    raster(tmp_path / "dem.tif")
    refused = 0
    for one in (*NONE, *(OTHER_KINDS if "control" not in asked else ())):
        try:
            ASKED[asked](tmp_path, one)
        except Exception as error:
            refused += 1
            if not (is_refusal(error) or type(error).__name__ == "TypeCheckError"):  # of the tests' own checks
                raise AssertionError(f"{one!r}: {type(error).__name__}") from error
    assert refused > 20


@pytest.mark.parametrize("read", [lambda path: read_dem(path, vertical_datum="ellipsoid"), read_orthoimage])
def test_a_raster_with_a_crs_of_which_proj_understands_no_part_is_refused(
    tmp_path: pathlib.Path, read: Callable[[pathlib.Path], Any]
) -> None:
    """PROJ makes a CRS of it, and stumbles when it is asked for the geographic CRS in it."""
    path = tmp_path / "a.vrt"
    path.write_bytes(vrt(tmp_path)[0])
    read(path)
    srs = re.compile("<SRS>.*</SRS>", re.DOTALL)
    path.write_text(srs.sub(f"<SRS>{DAMAGED.replace(chr(34), '&quot;')}</SRS>", path.read_text()))
    with pytest.raises((DemError, ImageError), match=r"a\.vrt: PROJ does not understand the file's"):
        read(path)
