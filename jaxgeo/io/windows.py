"""Raster windows: posts within geographic bounds, and padding to a few sizes."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from jaxgeo.io.errors import DemError
from jaxgeo.io.mapping import FileMap
from jaxgeo.terrain.pyramid import check_size

Bounds = tuple[float | int, float | int, float | int, float | int]

_ALONG_EDGE = 721
_INSIDE = 33
_SMALLEST = 256
_LARGEST_SQUARE = 1024
_SQUARES = 1024, 2048


@dataclasses.dataclass(frozen=True)
class Window:
    """Rows `row` to `stop_row` and columns `col` to `stop_col`, ends excluded."""

    row: int
    col: int
    stop_row: int
    stop_col: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.stop_row - self.row, self.stop_col - self.col

    def joined(self, other: Window) -> Window:
        """The smallest window that holds both."""
        first = min(self.row, other.row), min(self.col, other.col)
        return Window(*first, max(self.stop_row, other.stop_row), max(self.stop_col, other.stop_col))

    def moved(self, row: int, col: int) -> Window:
        """The same window, counted from a post `row`, `col` earlier."""
        return Window(self.row + row, self.col + col, self.stop_row + row, self.stop_col + col)


def window_of_bounds(name: str, mapping: FileMap, bounds: Bounds, cols_per_turn: int | None) -> Window:
    """Posts within (west, south, east, north) in deg and one more on each side, within the file.

    In a global file with `cols_per_turn` columns the window may cross the file's edge. Raises `DemError` for bounds
    that are invalid or contain no posts.
    """
    west, south, east, north = _checked(name, bounds)
    lon, lat = _places(west, south, east, north)
    row, col = mapping.rowcol((lon + 180.0) % 360.0 - 180.0, lat)
    known = np.isfinite(row) & np.isfinite(col)
    rows, cols = mapping.shape
    a, b, _, d, _, _ = mapping.affine
    turn = None
    if mapping.crs.is_geographic and b == 0.0 and d == 0.0:
        turn = 2.0 * np.pi / mapping.crs.axis_info[0].unit_conversion_factor / abs(a)
        col = col - turn * np.round((col - col[0]) / turn)  # the first point is the centre of the bounds
    if not known.any():
        raise DemError(f"{name}: {_shown(bounds)} lie outside the area that {mapping.crs.name!r} maps.")
    r0, r1 = math.floor(row[known].min()) - 1, math.ceil(row[known].max()) + 2
    c0, c1 = math.floor(col[known].min()) - 1, math.ceil(col[known].max()) + 2
    r0, r1 = max(r0, 0), min(r1, rows)
    is_round = cols_per_turn is not None and cols >= cols_per_turn
    if is_round and c1 - c0 >= cols:
        c0, c1 = 0, cols
    elif not is_round:
        c0, c1 = _held(c0, c1, cols, turn)
    if r1 - r0 < 2 or c1 - c0 < 2:
        raise DemError(f"{name}: {_shown(bounds)} hold no posts of the file, which covers {_extent(mapping)}.")
    return Window(r0, c0, r1, c1)


def _held(first: int, stop: int, cols: int, turn: float | None) -> tuple[int, int]:
    """The columns of a file within bounds; columns 360 deg apart coincide."""
    shifts = (0,) if turn is None else (0, round(turn), -round(turn))
    parts = [(max(first + shift, 0), min(stop + shift, cols)) for shift in shifts]
    parts = [part for part in parts if part[1] - part[0] >= 2] or parts[:1]
    return min(part[0] for part in parts), max(part[1] for part in parts)


def padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """The padded array size for a window; few sizes, since each is compiled for.

    Windows of up to 1024 posts a side get a square of 256, 512 or 1024; a longer side is padded to 1024, 1536, 2048,
    3072, 4096, ... by itself. A window that would then be too large for a terrain keeps its size.
    """
    padded = _padded_shape(shape)
    try:
        check_size(padded)
    except ValueError:
        return shape
    return padded


def square_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """The padded array size where windows are many: a square of 1024 or 2048 for all up to it."""
    side = next((side for side in _SQUARES if side >= max(shape)), None)
    return padded_shape(shape) if side is None else (side, side)


def _padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    longest = max(shape)
    if longest <= _LARGEST_SQUARE:
        side = _SMALLEST
        while side < longest:
            side *= 2
        return side, side
    return _padded(shape[0]), _padded(shape[1])


def _padded(n: int) -> int:
    size = _LARGEST_SQUARE
    while size < n:
        if size * 3 // 2 >= n:
            return size * 3 // 2
        size *= 2
    return size


def _checked(name: str, bounds: Bounds) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(edge) for edge in bounds)
    except (TypeError, ValueError) as error:
        raise DemError(f"{name}: bounds must be (west, south, east, north) in deg; got {bounds!r}.") from error
    if not all(map(math.isfinite, (west, south, east, north))) or max(abs(west), abs(east)) > 360.0:
        raise DemError(f"{name}: bounds must be finite, longitudes within 360 deg; got {_shown(bounds)}.")
    if not -90.0 <= south < north <= 90.0:
        raise DemError(f"{name}: bounds must have -90 <= south < north <= 90 deg; got {_shown(bounds)}.")
    if west == east:
        raise DemError(f"{name}: the bounds are empty, west = east = {west:g} deg.")
    return west, south, east if east > west else east + 360.0, north


def _places(west: float, south: float, east: float, north: float) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes of the bounds' centre, edges and a lattice inside (which may contain a pole)."""
    t, i = np.linspace(0.0, 1.0, _ALONG_EDGE), np.linspace(0.0, 1.0, _INSIDE)
    zero, one = np.zeros_like(t), np.ones_like(t)
    u, v = (grid.ravel() for grid in np.meshgrid(i, i))
    u, v = np.concatenate([[0.5], t, t, zero, one, u]), np.concatenate([[0.5], zero, one, t, t, v])
    return west + u * (east - west), south + v * (north - south)


def _shown(bounds: Bounds) -> str:
    return "bounds (west, south, east, north) = ({:g}, {:g}, {:g}, {:g}) deg".format(*bounds)


def _extent(mapping: FileMap) -> str:
    rows, cols = (np.linspace(0.0, n - 1.0, 21) for n in mapping.shape)
    lon, lat = mapping.lonlat(*(u.ravel() for u in np.meshgrid(rows, cols)))
    known = np.isfinite(lon) & np.isfinite(lat)
    lon, lat = lon[known], lat[known]
    return f"longitudes {lon.min():.4f} to {lon.max():.4f}, latitudes {lat.min():.4f} to {lat.max():.4f} deg"
