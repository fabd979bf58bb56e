"""Geoid grid files: PROJ's bilinear interpolation, verified against the grid's own posts before use."""

from __future__ import annotations

import functools
import math
import pathlib
import re
from typing import Any

import numpy as np
from pyproj.exceptions import ProjError
from pyproj.transformer import Transformer
from rasterio.io import DatasetReader
from rasterio.windows import Window

from jaxgeo.io._gdal import GDAL_ERRORS
from jaxgeo.io._proj import DATA
from jaxgeo.io._rasters import GRIDS, open_raster
from jaxgeo.io._regular import check_regular
from jaxgeo.io._tiff import layout_mistake
from jaxgeo.io.errors import VerticalDatumError
from jaxgeo.io.reach import HERE

WITHIN = 1e-3  # m; at a post, interpolation returns the post's value except for rounding
MOST_COLUMNS = 1_000_000  # 1.3 arc seconds around the Earth
EDGE = 1e-9  # deg; a position on the western edge is inside
_HEIGHT_BANDS = ("geoid_undulation", "vertical_offset", "hydroid_height", "ellipsoidal_height_offset")
_SHARES = np.array([0.02, 0.14, 0.26, 0.38, 0.49, 0.51, 0.62, 0.74, 0.86, 0.98])  # of rows and columns: all quadrants

Posts = tuple[np.ndarray, np.ndarray, np.ndarray]  # longitude and latitude in deg, undulation in m


def grid_by_path(path: pathlib.Path, depths: bool) -> tuple[Transformer, float]:
    """Transformer that adds a geoid grid's undulations (subtracts, for depths), and the grid's first longitude in deg.

    Takes longitudes from there on, up to 360 deg more, and latitudes in deg, as of WGS 84. Raises
    `VerticalDatumError` for a file that PROJ cannot read, or one whose posts PROJ does not reproduce.
    """
    check_regular(path, VerticalDatumError)
    if not path.is_file():
        raise VerticalDatumError(f"vertical_datum: the geoid grid {path} does not exist.")
    if any(character in str(path) for character in '",'):
        raise VerticalDatumError(f"vertical_datum: PROJ cannot take a path with a comma or a quote in it: {path}")
    mistake = layout_mistake(path)
    if mistake:
        raise VerticalDatumError(f"vertical_datum: the geoid grid {path} is damaged: {mistake}.")
    try:
        transformer = _look_up(path, "+over", "+step +proj=axisswap +order=1,2,-3 " if depths else "")
    except ProjError as error:
        raise VerticalDatumError(
            f"vertical_datum: PROJ cannot read {path} as a geoid grid (it takes GeoTIFF and GTX files with the "
            f"undulation in m in the first band)."
        ) from error
    west = _first_longitude(path)
    found = _largest_difference(path, _stamp(path), "+over", west)
    if found is not None:
        raise VerticalDatumError(
            f"vertical_datum: PROJ reads the geoid grid {path} wrongly: {found}. Convert it to a GeoTIFF in deg, with "
            f"longitudes from -180 to 180, or use another grid."
        )
    return transformer, west


def check_grids_of(transformer: Transformer) -> None:
    """Raises `VerticalDatumError` for a PROJ operation with a geoid grid whose posts PROJ does not reproduce.

    This affects global grids from 0 to 360 deg that repeat the first meridian at the end: PROJ 9 reads them one
    column off at west longitudes.
    """
    for path in _grids_of(transformer):
        found = _largest_difference(path, _stamp(path), "", -180.0)
        if found is not None:
            raise VerticalDatumError(
                f"PROJ reads its geoid grid {path} wrongly: {found}. Replace it by the one that `pyproj sync` gets, or "
                f"take it out of PROJ's folder."
            )


def _grids_of(transformer: Transformer) -> list[pathlib.Path]:
    """The vertical grid files that an operation uses, without the package's own."""
    names = {
        name.strip().lstrip("@")
        for listed in re.findall(r"proj=vgridshift\b[^+]*?\bgrids=(\S+)", transformer.definition.replace("+", ""))
        for name in listed.split(",")
    }
    known = (pathlib.Path(grid.full_name) for one in transformer.operations or () for grid in one.grids)
    return [path for path in dict.fromkeys(known) if path.name in names and path.is_file() and path.parent != DATA]


def _look_up(path: pathlib.Path, over: str, last: str = "") -> Transformer:
    """The sum of a height and the grid's value, from and to deg; `last` is a step that precedes it."""
    return Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad {last}"
        f'+step +proj=vgridshift +grids="{path.resolve()}" +multiplier=1 {over} '
        f"+step +proj=unitconvert +xy_in=rad +xy_out=deg {over}"
    )


@functools.lru_cache(maxsize=64)
def _largest_difference(path: pathlib.Path, stamp: Any, over: str, west: float) -> str | None:
    """Message with the largest difference between PROJ and the grid's posts; None if they agree."""
    del stamp  # only part of the cache key: a changed time or size means a changed file
    lon, lat, own = _posts(path)
    shown = _look_up(path, over).transform(wrapped(lon, west), lat, np.zeros(own.shape))[2]
    if not np.isfinite(shown).any():
        return "it finds none of the grid's own posts"
    off = np.where(np.isfinite(shown), np.abs(shown - own), 0.0)
    k = int(np.argmax(off))
    if off[k] <= WITHIN:
        return None
    ns, ew = "NS"[int(lat[k] < 0.0)], "EW"[int(lon[k] < 0.0)]
    return f"at its post {abs(lat[k]):g} {ns} {abs(lon[k]):g} {ew} it gives {shown[k]:.3f} m, the file {own[k]:.3f} m"


def _posts(path: pathlib.Path) -> Posts:
    """Posts across a grid, of the finest part where there are several. Raises `VerticalDatumError`."""
    try:
        with _opened(str(path)) as data:
            parts = data.subdatasets or [str(path)]
        found = [_posts_of(part) for part in parts]
    except GDAL_ERRORS as error:
        raise VerticalDatumError(
            f"vertical_datum: the posts of the geoid grid {path} cannot be read to check it: {error}"
        ) from error
    lon, lat, own = (np.concatenate(one) for one in zip(*(posts for posts, _ in found), strict=True))
    within = np.stack([_is_within(lon, lat, box) for _, box in found])
    lon, lat, own = (one[within.sum(axis=0) <= 1] for one in (lon, lat, own))  # elsewhere PROJ uses the finer part
    if not own.size:
        raise VerticalDatumError(f"vertical_datum: the geoid grid {path} has no value at any of the posts looked at.")
    return lon, lat, own


def _posts_of(name: str) -> tuple[Posts, tuple[float, float, float, float]]:
    """Known posts of one raster, longitudes in [-180, 180), and its (west, south, east, north) in deg."""
    with _opened(name) as data:
        bands = [text in _HEIGHT_BANDS for text in data.descriptions]
        band = bands.index(True) + 1 if any(bands) else 1
        if data.width > MOST_COLUMNS:
            raise VerticalDatumError(f"vertical_datum: the geoid grid {name} has {data.width} columns; it is damaged.")
        rows, cols = (np.unique(np.round(_SHARES * (n - 1)).astype(int)) for n in data.shape)
        cols = np.union1d(cols, [0, data.width - 1])
        whole_rows = [Window(0, int(row), data.width, 1) for row in rows]  # pyright: ignore[reportCallIssue]
        stored = np.array([data.read(band, window=row)[0, cols] for row in whole_rows])
        mask = np.array([data.read_masks(band, window=row)[0, cols] for row in whole_rows]) == 0
        scale, offset = data.scales[band - 1], data.offsets[band - 1]
        if not (math.isfinite(scale) and math.isfinite(offset) and scale != 0.0):
            raise VerticalDatumError(
                f"vertical_datum: the geoid grid {name} states scale {scale:g} and offset {offset:g}; it is damaged."
            )
        values = stored.astype(np.float64) * scale + offset
        a, b, c, d, e, f = data.transform[:6]
        box = data.bounds
    row, col = np.meshgrid(rows, cols, indexing="ij")
    lon, lat = (c + a * (col + 0.5) + b * (row + 0.5)), (f + d * (col + 0.5) + e * (row + 0.5))
    known = ~mask & np.isfinite(values)
    return (wrapped(lon[known], -180.0), lat[known], values[known]), (box.left, box.bottom, box.right, box.top)


def _first_longitude(path: pathlib.Path) -> float:
    """Longitude of the grid's first column, deg; -180 if no header states it, which the check of its posts refuses."""
    try:
        with _opened(str(path)) as data:
            step = abs(data.transform.a)
            return min(data.bounds.left, data.bounds.right) + step / 2.0
    except (VerticalDatumError, *GDAL_ERRORS):
        return -180.0


def _opened(name: str) -> DatasetReader:
    return open_raster(name, HERE, VerticalDatumError, "a geoid grid", GRIDS)


def _is_within(lon: np.ndarray, lat: np.ndarray, box: tuple[float, float, float, float]) -> np.ndarray:
    west, south, east, north = box
    return (np.mod(lon - west, 360.0) <= east - west) & (lat >= south) & (lat <= north)


def wrapped(lon_deg: np.ndarray, west: float) -> np.ndarray:
    """Longitudes in deg wrapped to [`west`, `west` + 360)."""
    return np.mod(lon_deg - (west - EDGE), 360.0) + (west - EDGE)


def _stamp(path: pathlib.Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_mtime_ns, found.st_size
