"""PROJ setup: bundled geoid grid, no ballpark transformations, one fixed operation per file."""

from __future__ import annotations

import dataclasses
import pathlib
import re
from typing import Any

import numpy as np
import pyproj
from pyproj.aoi import AreaOfInterest
from pyproj.datadir import append_data_dir, get_user_data_dir  # pyright: ignore[reportPrivateImportUsage]
from pyproj.exceptions import CRSError, ProjError
from pyproj.transformer import Transformer, TransformerGroup

from jaxgeo._record import portable
from jaxgeo.earth._on_host import normals_of
from jaxgeo.io._quietly import quietly

DATA = pathlib.Path(__file__).resolve().parents[1] / "data"

# pyproj's exceptions for an unknown CRS; the last one for text that UTF-8 cannot encode.
UNKNOWN_CRS = (CRSError, UnicodeEncodeError)

UTM_ZONE = re.compile(r"(?:UTM)?[ _-]*(?:zone)?[ _-]*(\d{1,2})[ _-]*([NS])", re.IGNORECASE)

# The pyproj wheels carry no grids and ignore PROJ_DATA. This adds only the EGM96 grid of the package.
append_data_dir(str(DATA))


@dataclasses.dataclass(frozen=True)
class Operation:
    """One PROJ coordinate operation, the same for every point, with PROJ's name and accuracy."""

    transformer: Transformer
    name: str
    accuracy: float | None
    """Accuracy in m; None if unknown to PROJ."""
    better: tuple[str, ...]
    """Operations that would have been preferred, had their grids been available."""

    def __str__(self) -> str:
        accuracy = "unknown accuracy" if self.accuracy is None else f"accuracy {self.accuracy:g} m"
        note = f"; better, but without its grid here: {', '.join(self.better[:2])}" if self.better else ""
        return f"{self.name} ({accuracy}{note})"


@portable
class NoOperation(ValueError):
    """PROJ has no operation, or none whose grids are available: `missing` lists (operation, grid file, address)."""

    def __init__(self, source: str, target: str, missing: list[tuple[str, str, str]]) -> None:
        super().__init__(f"PROJ has no usable transformation from {source} to {target}")
        self.missing = missing


def known_crs(given: Any) -> pyproj.CRS:
    """The CRS of a text, a code or a `pyproj.CRS`; its parts are validated too, since damage only shows there.

    Raises one of `UNKNOWN_CRS`.
    """
    try:
        crs = pyproj.CRS.from_user_input(given)
    except CRSError as error:
        raise CRSError(_usual_code(given) or "give a code, such as EPSG:32616, or a definition in WKT.") from error
    _ = crs.geodetic_crs, crs.source_crs, crs.sub_crs_list
    return crs


def _usual_code(given: Any) -> str | None:
    """Advice for the name of a UTM zone alone, which stands for zones of many datums; None for others."""
    found = UTM_ZONE.fullmatch(given.strip()) if isinstance(given, str) else None
    if found is None or not 1 <= int(found[1]) <= 60:
        return None
    code = (32600 if found[2].upper() == "N" else 32700) + int(found[1])
    return f"a zone without a datum; write EPSG:{code} for WGS 84 / UTM zone {int(found[1])}{found[2].upper()}."


def operation(source: Any, target: Any, area: tuple[float, float, float, float] | None = None) -> Operation:
    """The best available operation from `source` to `target` (x or longitude first); never a ballpark one.

    `area` is (west, south, east, north) in deg. Raises `NoOperation`.
    """
    source, target = pyproj.CRS.from_user_input(source), pyproj.CRS.from_user_input(target)
    group = _group(source, target, area)
    if not group.transformers and area is not None and not group.unavailable_operations:
        group = _group(source, target, None)
    missing = [
        (op.name or "unnamed operation", grid.short_name, grid.url)
        for op in group.unavailable_operations
        for grid in op.grids
        if not grid.available
    ]
    if not group.transformers:
        raise NoOperation(source.name, target.name, missing)
    best = group.transformers[0]
    accuracy = best.accuracy if best.accuracy is not None and best.accuracy >= 0 else None
    better = () if group.best_available else tuple(dict.fromkeys(grid for _, grid, _ in missing))
    return Operation(best, _named(best.description), accuracy, better)


def _named(description: str) -> str:
    """PROJ's name of an operation, without null steps."""
    parts = description.split(" + ")
    moving = [part for part in parts if not part.startswith(("axis order change", "Null geographic offset"))]
    return " + ".join(moving) or "no change"


def _group(source: pyproj.CRS, target: pyproj.CRS, area: tuple[float, float, float, float] | None) -> TransformerGroup:
    aoi = None if area is None else AreaOfInterest(*area)
    try:
        with quietly():  # "best transformation is not available": `operation` reports it
            return TransformerGroup(source, target, always_xy=True, allow_ballpark=False, area_of_interest=aoi)  # pyright: ignore[reportArgumentType]
    except ProjError as error:  # damaged definition
        raise NoOperation(source.name, target.name, []) from error


def how_to_get(missing: list[tuple[str, str, str]], datum: str | None = None) -> str:
    """The missing grid files, and how to install them for PROJ; `datum` is the code of the vertical datum that needs
    them."""
    files = list(dict.fromkeys(grid for _, grid, _ in missing))
    on_net = [grid for grid in files if any(g == grid and url for _, g, url in missing)]
    shown = ", ".join(files[:4]) + (f" and {len(files) - 4} more" if len(files) > 4 else "")
    sync = f"sync --file {on_net[0]}" if on_net else ""
    how = f"`pyproj {sync}` (or PROJ's `proj{sync}`) downloads it; or" if on_net else "Get it from its publisher and"
    if datum is not None and len(on_net) == 1:
        how = f"`jaxgeo dem --geoid {datum}` downloads it; or"
    choice = " (which of them depends on the place)" if len(files) > 1 else ""
    return f"the grid file is missing: {shown}{choice}. {how} put the file into {get_user_data_dir()}."


def unit_normals(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """Normals of WGS 84, (..., 3), at longitudes and latitudes in deg."""
    return normals_of(np.radians(lat_deg), np.radians(lon_deg))


def lonlat_of(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes in deg of normals (..., 3)."""
    x, y, z = np.moveaxis(normals, -1, 0)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
