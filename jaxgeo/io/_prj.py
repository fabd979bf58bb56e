"""`.prj` files: the CRS of the file beside them, as text that PROJ reads."""

from __future__ import annotations

import os
import pathlib

import pyproj

from jaxgeo.io._crs_reach import check_crs
from jaxgeo.io._proj import UNKNOWN_CRS, known_crs
from jaxgeo.io.errors import TableError

ENDING = ".prj"
NAMELESS = ("", "unknown", "unnamed")
UNITS = {"degree": "deg"}


def prj_beside(path: str | os.PathLike[str]) -> pathlib.Path | None:
    """The `.prj` file of a table: of the same name, in its folder."""
    table = pathlib.Path(path)
    each = (table.with_suffix(ending) for ending in (ENDING, ENDING.upper()))
    return next((one for one in each if one != table and one.is_file()), None)


def read_prj(path: str | os.PathLike[str]) -> pyproj.CRS:
    """The CRS of a `.prj` file. Raises `FileNotFoundError`, and `TableError` for text that PROJ does not know."""
    text = pathlib.Path(path).read_text(encoding="utf-8-sig", errors="replace").strip()
    check_crs(f"{path}", text, TableError)
    try:
        return known_crs(text)
    except UNKNOWN_CRS as error:
        raise TableError(
            f"{path}: PROJ does not know this CRS, {text[:60]!r}: state the CRS itself, such as crs='EPSG:32617'."
        ) from error


def name_of(crs: pyproj.CRS) -> str:
    """The name of a CRS, with its code if it has one: `WGS 84 / UTM zone 16N (EPSG:32616)`; or its projection and
    ellipsoid."""
    code = ":".join(crs.to_authority(min_confidence=70) or ())
    way = crs.coordinate_operation
    if crs.name.lower() in NAMELESS and not code and way is not None and crs.ellipsoid is not None:
        origin = [
            f"{one.name.lower()} {one.value:g} {UNITS.get(one.unit_name.lower(), one.unit_name)}"
            for one in way.params
            if one.name.startswith("Longitude")
        ]
        return f"a map without a name ({', '.join([f'{way.method_name}', *origin, f'{crs.ellipsoid.name}'])})"
    return f"{crs.name} ({code})" if code else crs.name


def text_of(crs: pyproj.CRS) -> str:
    """The code of a CRS, or its definition if it has none."""
    return ":".join(crs.to_authority(min_confidence=70) or ()) or crs.to_wkt()
