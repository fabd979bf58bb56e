"""Check of files that a CRS refers to (grids of datum shifts and geoids, definitions), if a file states the CRS.

PROJ opens them by path. A bare name is looked up in PROJ's own folders, and is allowed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element

import pyproj
from pyproj.exceptions import CRSError

from jaxgeo.io._gdal_xml import entries

_KEYS = ("srs", "projection", "sourcesrs", "targetsrs")
_NAMING = re.compile(r"\b\w*(?:grids|file|model|init)\s*=\s*([^\s+\"]+)", re.IGNORECASE)


def check_crs(where: str, crs: pyproj.CRS | str | Any, error: type[ValueError]) -> None:
    """Raise `error` if a CRS from a file, as text or parsed by PROJ, refers to a file by a path."""
    names: list[str] = []
    if isinstance(crs, str):
        names += _named(crs)
        if not any(_is_path(name) for name in names):
            try:
                crs = pyproj.CRS.from_user_input(crs)
            except CRSError:
                return  # the CRS parser reports it
    if isinstance(crs, pyproj.CRS):
        names += _within(crs.to_json_dict())
    path = next((name for name in names if _is_path(name)), None)
    if path is not None:
        raise error(
            f"{where}: its coordinate reference system names the file {path}, which PROJ would open; a file may name "
            f"grids in PROJ's own folders only. Write another CRS into it (gdal_edit -a_srs EPSG:...)."
        )


def check_crs_in(where: str, root: Element, error: type[ValueError]) -> None:
    """As `check_crs`, for every CRS in GDAL's XML: GDAL lets PROJ open the files it refers to."""
    for element in root.iter():
        for key, text in ((str(element.tag).lower(), element.text or ""), *entries(element)):
            if key in _KEYS and text.strip():
                check_crs(where, text.strip(), error)


def _within(part: Any) -> Iterator[str]:
    """File names in PROJJSON: texts as parameter values, and those in PROJ definitions."""
    if isinstance(part, dict):
        for key, value in part.items():
            if key == "value" and isinstance(value, str):
                yield from value.split(",")
            yield from _within(value)
    elif isinstance(part, list):
        for one in part:
            yield from _within(one)
    elif isinstance(part, str):
        yield from _named(part)


def _named(text: str) -> Iterator[str]:
    return (name for found in _NAMING.finditer(text) for name in found[1].split(","))


def _is_path(name: str) -> bool:
    return any(mark in name for mark in ("/", "\\", ".."))
