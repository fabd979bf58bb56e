"""Ground control points and their image measurements: the `gcp_list.txt` of OpenDroneMap."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyproj

from jaxgeo._checks import require_x64
from jaxgeo._text_numbers import words_of
from jaxgeo.adjust.records import ImagePoints, as_names
from jaxgeo.earth import Geodetic
from jaxgeo.io._columns import refuse_doubles
from jaxgeo.io._crs_reach import check_crs
from jaxgeo.io._csv import CsvTable
from jaxgeo.io._dialect import WHITE, with_points
from jaxgeo.io._map_grid import MapGrid, projection_text, understood_crs
from jaxgeo.io._text import read_text
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.io.tables import PIXEL_COLUMNS
from jaxgeo.io.vertical import vertical_unit

COLUMNS = ["geo_x", "geo_y", "geo_z", "im_x", "im_y", "image_name"]
LIMITS = {
    "geo_x": (-1e9, 1e9, "units of the projection"),
    "geo_y": (-1e9, 1e9, "units of the projection"),
    "geo_z": (-2000.0, 2_000_000.0, "m"),
    "im_x": PIXEL_COLUMNS["u"],
    "im_y": PIXEL_COLUMNS["v"],
}
OFFSETS = {"centre": 0.0, "corner": 0.5}  # coordinates of the first pixel's centre, pixels


@dataclass(frozen=True)
class GroundControl:
    """Ground control points by name (n,), and their image measurements.

    `position` holds n entries; every point of `points` is one of `names`.
    """

    names: np.ndarray
    position: Geodetic
    points: ImagePoints

    def __post_init__(self) -> None:
        names = as_names(self.names, "names")
        unique, counts = np.unique(names, return_counts=True)
        if np.any(counts > 1):
            raise ValueError(f"point {unique[counts > 1][0]} is there {counts.max()} times; names must differ.")
        shape = np.shape(self.position.lat)
        if shape != (len(names),):
            raise ValueError(f"position must hold an entry for each of {len(names)} points; got shape {shape}.")
        unknown = np.setdiff1d(self.points.point, names)
        if unknown.size:
            raise ValueError(f"point {unknown[0]} is measured in images, but has no position.")
        object.__setattr__(self, "names", names)

    def __len__(self) -> int:
        return len(self.names)


def read_gcp_list(
    path: str | os.PathLike[str], *, height_datum: str | float, pixel_origin: str = "centre"
) -> GroundControl:
    """Read ground control points from an OpenDroneMap file.

    Its first line is a projection: "EPSG:32651", a PROJ text "+proj=utm ...", "WGS84 UTM 51N", or "WGS84" (degrees).
    Every other line is, separated by white space, `geo_x geo_y geo_z im_x im_y image_name [gcp_name] [extra ...]`:
    easting and northing (longitude and latitude in deg) in the units of the projection, height in m (if the
    projection has a vertical part, in its unit, and as depth if it counts downwards), column and row in pixels.
    Without names, lines with the same coordinates are one point, as in OpenDroneMap; such points are called
    "unnamed-0", "unnamed-1", in their order. Blank lines and those that begin with # are skipped.

    - `height_datum`: datum of the heights: "ellipsoid", "EPSG:5773" (EGM96 mean sea level), an undulation in
      m; as in scene files.
    - `pixel_origin`: origin of im_x and im_y: the "centre" of the first pixel, as in OpenSfM, or its outer "corner", as
      in programs that count the image from 0 to its width; then half a pixel is subtracted.

    Raises `TableError` with the line for an unknown projection, words that are missing or not numbers, a NaN height, a
    name with two positions, a position with two names, a point measured twice in an image;
    `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    if pixel_origin not in OFFSETS:
        raise ValueError(f"pixel_origin must be 'centre' or 'corner'; got {pixel_origin!r}.")
    (line, projection), *rows = _lines(path)
    table = _table(path, rows)
    text = projection_text(projection)
    check_crs(f"{path}, row {line}", text, TableError)
    crs, vertical = understood_crs(f"{path}, row {line}", text)
    numbers = {name: table.numbers(name, limits) for name, limits in LIMITS.items()}
    places = np.stack([numbers[name] for name in COLUMNS[:3]], axis=-1)
    names, of_point = _points(table, places)
    image = np.array([row[5] for row in table.cells], dtype=str)
    keys = zip(image.tolist(), names[of_point].tolist(), strict=True)
    refuse_doubles(table, keys, "image {0}, point {1}: measured twice")
    uv = np.stack([numbers["im_x"], numbers["im_y"]], axis=-1) - OFFSETS[pixel_origin]
    first = np.unique(of_point, return_index=True)[1]
    position = _positions(table, crs, vertical, places[first], height_datum)
    return GroundControl(names, position, ImagePoints(image, names[of_point], uv))


def _lines(path: str | os.PathLike[str]) -> list[tuple[int, str]]:
    """The lines with content, with their numbers."""
    text = read_text(path, "file of ground control points")
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), start=1)]
    lines = [(i, line) for i, line in lines if line and not line.startswith("#")]
    if len(lines) < 2:
        raise TableError(f"{path}: expected a projection in the first line and measurements of points below it.")
    return lines


def _table(path: str | os.PathLike[str], rows: list[tuple[int, str]]) -> CsvTable:
    """The words of each line, with the name, or an empty one, last."""
    cells = []
    for line, text in rows:
        words = words_of(text)
        if len(words) < len(COLUMNS):
            raise TableError(f"{path}, row {line}: {len(words)} words; expected {' '.join(COLUMNS)} [gcp_name].")
        cells.append([*words[:6], words[6] if len(words) > 6 else ""])
    return CsvTable(path, [*COLUMNS, "gcp_name"], [line for line, _ in rows], with_points(cells, WHITE))


def _points(table: CsvTable, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(names of the points in the order of their first lines, point index of each line)."""
    keys = [tuple(place) for place in places.tolist()]
    name_at: dict[Any, str] = {}
    place_of: dict[str, Any] = {}
    for row, (key, cells) in enumerate(zip(keys, table.cells, strict=True)):
        if not (name := cells[6]):
            continue
        if name_at.setdefault(key, name) != name:
            raise table.wrong(row, "gcp_name", f"{name} lies where {name_at[key]} does; one of the names is wrong.")
        if place_of.setdefault(name, key) != key:
            raise table.wrong(row, "gcp_name", f"{name} has other coordinates above: {_shown(place_of[name])}.")
    order = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    unnamed = (name for name in _unnamed() if name not in place_of)
    names = np.array([name_at.get(key) or next(unnamed) for key in order], dtype=str)
    return names, np.array([order[key] for key in keys])


def _unnamed() -> Iterator[str]:
    k = 0
    while True:
        yield f"unnamed-{k}"
        k += 1


def _shown(place: tuple[float, ...]) -> str:
    return " ".join(f"{x:.10g}" for x in place)


def _positions(
    table: CsvTable, crs: pyproj.CRS, vertical: pyproj.CRS | None, places: np.ndarray, height_datum: str | float
) -> Geodetic:
    """Map coordinates as geodetic positions."""
    x, y, z = places.T
    lon, lat = MapGrid.about(table.path, crs, x, y).to_lonlat(x, y)
    lost = ~(np.isfinite(lon) & np.isfinite(lat)) | (np.abs(lat) > 90.0)
    if np.any(lost):
        raise TableError(f"{table.path}: {_shown(tuple(places[np.argmax(lost)]))} has no place in {crs.name!r}.")
    try:
        height = ellipsoidal_heights(lon, lat, z * (vertical_unit(vertical) or 1.0), height_datum, vertical)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{table.path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{table.path}: {error}") from error
    return Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height)
