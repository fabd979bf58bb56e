"""One array of values and voids from one raster file or from any number of tiles on one grid."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator

import numpy as np
from rasterio.windows import Window

from jaxgeo.io.errors import DemError
from jaxgeo.io.paths import Paths, are_all_named, expanded
from jaxgeo.io.tiles import MISALIGNED, OpenFiles, Tile, read_header, read_tile
from jaxgeo.io.vertical import horizontal_part, vertical_part, vertical_unit

MOST_POSTS = 2_000_000_000
_UNITS = {
    "m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0,
    "ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "international foot": 0.3048,
    "us-ft": 1200 / 3937, "ftus": 1200 / 3937, "us survey foot": 1200 / 3937, "us survey feet": 1200 / 3937,
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Mosaic:
    """Tiles placed on the grid of the first; `offsets` are the (row, col) of each tile's first post on it."""

    tiles: tuple[Tile, ...]
    offsets: tuple[tuple[int, int], ...]

    @property
    def first(self) -> Tile:
        """The tile whose grid it is."""
        return self.tiles[0]

    @property
    def name(self) -> str:
        """The file or files, for messages."""
        rest = f" and {len(self.tiles) - 1} more" if len(self.tiles) > 1 else ""
        return f"{self.first.path}{rest}"

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """(first row, first col, last row + 1, last col + 1) of each tile, (tiles, 4)."""
        placed = zip(self.tiles, self.offsets, strict=True)
        return np.array([(r, c, r + tile.shape[0], c + tile.shape[1]) for tile, (r, c) in placed])

    @functools.cached_property
    def dtype(self) -> np.dtype:
        """One that holds the values of every tile."""
        kinds = {np.dtype(np.float64) if (t.scale, t.offset) != (1.0, 0.0) else t.dtype for t in self.tiles}
        return np.result_type(*kinds)

    def bounds(self) -> tuple[int, int, int, int]:
        """(first row, first col, last row + 1, last col + 1) of all tiles."""
        r0, c0, r1, c1 = self.corners.T
        return int(r0.min()), int(c0.min()), int(r1.max()), int(c1.max())

    def under(self, window: tuple[int, int, int, int]) -> Iterator[tuple[Tile, int, int]]:
        """The tiles that reach into a window, in their order, with the row and column of their first post there."""
        r0, c0, r1, c1 = window
        turn = self.first.cols_per_turn
        shifts = (0,) if turn is None else (0, -turn, turn)
        top, left, bottom, right = self.corners.T
        near = np.array([(top < r1) & (bottom > r0) & (left + s < c1) & (right + s > c0) for s in shifts])
        for index in np.flatnonzero(near.any(axis=0)):
            for which in np.flatnonzero(near[:, index]):
                yield self.tiles[index], int(top[index]), int(left[index]) + shifts[which]


def open_mosaic(paths: Paths, band: int) -> Mosaic:
    """Headers of one file or of several tiles on one grid. Raises `FileNotFoundError` or `DemError`."""
    tiles = tuple(read_header(name, band) for name in expanded(paths))
    mosaic = Mosaic(tiles, tuple(_offset(tiles[0], tile) for tile in tiles))
    if not are_all_named(paths):
        _check_no_two_are_alike(mosaic)
    return mosaic


def read_window(
    mosaic: Mosaic, window: tuple[int, int, int, int], files: OpenFiles | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Values as stored, and voids, of (first row, first col, last row + 1, last col + 1) on the mosaic's grid.

    Where several tiles hold a post, the first that knows it is taken; what none holds is void. `files` are kept open
    for the next window.
    """
    if files is None:
        with OpenFiles() as files:
            return read_window(mosaic, window, files)
    r0, c0, r1, c1 = window
    if (r1 - r0) * (c1 - c0) > MOST_POSTS:
        raise DemError(f"{mosaic.name}: {r1 - r0} x {c1 - c0} posts are too many at once; name a part with bounds=.")
    values, void = np.zeros((r1 - r0, c1 - c0), mosaic.dtype), np.ones((r1 - r0, c1 - c0), bool)
    for tile, row, col in mosaic.under(window):
        top, left = max(row, r0), max(col, c0)
        bottom, right = min(row + tile.shape[0], r1), min(col + tile.shape[1], c1)
        inner = Window(left - col, top - row, right - left, bottom - top)  # pyright: ignore[reportCallIssue]
        part, unknown = read_tile(tile, inner, files)
        here = np.s_[top - r0 : bottom - r0, left - c0 : right - c0]
        take = void[here] & ~unknown
        np.copyto(values[here], part, where=take)
        void[here] &= ~take
    return values, void


def metres_per_unit(tile: Tile, height_unit: str | None, by_datum: float | None) -> float:
    """m per unit of a tile's heights: by the caller, the band, the file's vertical CRS or the datum asked for; else 1.

    A horizontal CRS in feet whose heights' unit nobody states is refused, as is a file that contradicts itself.
    """
    by_crs = vertical_unit(vertical_part(tile.crs))
    if height_unit is not None:
        return _unit(height_unit, "height_unit")
    if tile.unit:
        by_band = _unit(tile.unit, f"{tile.path}: the unit of band {tile.band}")
        if by_crs is not None and abs(by_band / by_crs - 1.0) > 1e-9:
            raise DemError(
                f"{tile.path}: band {tile.band} says that its heights are in {tile.unit!r}, the file's vertical CRS "
                f"has a unit of {by_crs:g} m. Say which holds with height_unit=."
            )
        return by_band
    if by_crs is not None:
        return by_crs
    if by_datum is not None and by_datum != 1.0:  # a datum in metres says nothing of a map in feet
        return by_datum
    axis = horizontal_part(tile.crs).axis_info[0]
    if not tile.is_geographic and axis.unit_conversion_factor != 1.0:
        raise DemError(
            f"{tile.path}: the map is in {axis.unit_name} and nothing says whether the heights are too. "
            f'Pass height_unit="m", "ft" or "us-ft".'
        )
    return 1.0


def _check_no_two_are_alike(mosaic: Mosaic) -> None:
    """Refuse two files over the same posts where nobody named them: one may hold something else than heights."""
    seen: dict[tuple[int, ...], Tile] = {}
    for tile, corners in zip(mosaic.tiles, map(tuple, mosaic.corners), strict=True):
        if corners in seen:
            raise DemError(
                f"{tile.path}: it covers the same posts as {seen[corners].path}. If both hold heights, name them one "
                f'by one in order of preference; else leave one out, e.g. by a pattern such as "*_dem.tif".'
            )
        seen[corners] = tile


def _offset(first: Tile, tile: Tile) -> tuple[int, int]:
    """(row, col) of a tile's first post on the grid of the first tile. Raises `DemError` if it is not on that grid."""
    if tile is first:
        return 0, 0
    if tile.crs is not first.crs and not tile.crs.equals(first.crs, ignore_axis_order=True):
        raise DemError(
            f"{tile.path}: its CRS is {tile.crs.name!r}, that of {first.path} is {first.crs.name!r}; tiles must share "
            f"one grid (they are not resampled). Read them apart, or warp them to one grid first."
        )
    if tile.unit != first.unit:
        raise DemError(f"{tile.path}: its heights are in {tile.unit!r}, those of {first.path} in {first.unit!r}.")
    steps, others = np.array(first.affine[:6]).reshape(2, 3), np.array(tile.affine[:6]).reshape(2, 3)
    drift = np.linalg.solve(steps[:, :2], others[:, :2] - steps[:, :2]) * max(tile.shape)
    if not np.abs(drift).max() <= MISALIGNED:
        raise DemError(
            f"{tile.path}: its posts are spaced {_spacing(tile)}, those of {first.path} {_spacing(first)}; tiles must "
            f"share one grid (they are not resampled). Read them apart, or warp them to one grid first."
        )
    col, row = np.linalg.solve(steps[:, :2], others[:, 2] - steps[:, 2])
    if first.cols_per_turn is not None:
        col -= first.cols_per_turn * np.round((col + (tile.shape[1] - first.shape[1]) / 2.0) / first.cols_per_turn)
    if not max(abs(row - np.round(row)), abs(col - np.round(col))) <= MISALIGNED:
        raise DemError(
            f"{tile.path}: its first post falls at row {row:.3f}, column {col:.3f} of the grid of {first.path}; tiles "
            f"must share one grid (they are not resampled). Read them apart, or warp them to one grid first."
        )
    return round(row), round(col)


def _unit(name: str, whose: str) -> float:
    try:
        return _UNITS[name.strip().lower()]
    except KeyError:
        raise DemError(
            f'{whose} is {name!r}, no known unit of height; pass height_unit="m", "ft" or "us-ft".'
        ) from None


def _spacing(tile: Tile) -> str:
    return f"{np.hypot(tile.affine.a, tile.affine.d):.9g} x {np.hypot(tile.affine.b, tile.affine.e):.9g}"
