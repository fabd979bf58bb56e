"""Raster mosaic: values and voids from one raster file or any number of tiles on one grid."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator

import numpy as np
from rasterio.windows import Window

from jaxgeo.io.errors import DemError
from jaxgeo.io.height_units import alike, stated_unit, unit_shown
from jaxgeo.io.tiles import MISALIGNED, OpenFiles, Tile, read_tile
from jaxgeo.io.voids import check_untagged, marked
from jaxgeo.terrain.pyramid import check_size


@dataclasses.dataclass(frozen=True)
class Mosaic:
    """Tiles placed on the grid of the first; `offsets` are the (row, col) of each tile's first post on it.

    `unit` is m per unit of height; `nodata` are further stored void values; `marks_found` collects
    those found in the posts read so far.
    """

    tiles: tuple[Tile, ...]
    offsets: tuple[tuple[int, int], ...]
    unit: float = 1.0
    nodata: tuple[float, ...] = ()
    marks_found: set[float] = dataclasses.field(default_factory=set)

    @property
    def first(self) -> Tile:
        """The tile that defines the grid."""
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
        """A dtype that holds the values of every tile."""
        kinds = {np.dtype(np.float64) if (t.scale, t.offset) != (1.0, 0.0) else t.dtype for t in self.tiles}
        return np.result_type(*kinds)

    def bounds(self) -> tuple[int, int, int, int]:
        """(first row, first col, last row + 1, last col + 1) of all tiles."""
        r0, c0, r1, c1 = self.corners.T
        return int(r0.min()), int(c0.min()), int(r1.max()), int(c1.max())

    def read_as(self, unit: float, nodata: tuple[float, ...]) -> Mosaic:
        """A copy with m per unit of height and further void values."""
        return dataclasses.replace(self, unit=unit, nodata=nodata, marks_found=set())

    def read(self, window: tuple[int, int, int, int], files: OpenFiles | None = None) -> tuple[np.ndarray, np.ndarray]:
        """As `read_window`."""
        return read_window(self, window, files)

    def under(self, window: tuple[int, int, int, int]) -> Iterator[tuple[Tile, int, int]]:
        """The tiles that overlap a window, in their order, with the row and column of their first post there."""
        r0, c0, r1, c1 = window
        turn = self.first.cols_per_turn
        shifts = (0,) if turn is None else (0, -turn, turn)
        top, left, bottom, right = self.corners.T
        near = np.array([(top < r1) & (bottom > r0) & (left + s < c1) & (right + s > c0) for s in shifts])
        for index in np.flatnonzero(near.any(axis=0)):
            for which in np.flatnonzero(near[:, index]):
                yield self.tiles[index], int(top[index]), int(left[index]) + shifts[which]


def read_window(
    mosaic: Mosaic, window: tuple[int, int, int, int], files: OpenFiles | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Values in the unit of the files, and voids, of a window of the mosaic's grid.

    `window` is (first row, first col, last row + 1, last col + 1). Where tiles overlap, the first known value is used;
    posts outside all tiles are void. `files` are kept open for the next window.
    """
    if files is None:
        with OpenFiles() as files:
            return read_window(mosaic, window, files)
    r0, c0, r1, c1 = window
    try:
        check_size((r1 - r0, c1 - c0))
    except ValueError as error:
        raise DemError(f"{mosaic.name}: {error}") from error
    values, void = np.zeros((r1 - r0, c1 - c0), mosaic.dtype), np.ones((r1 - r0, c1 - c0), bool)
    for tile, row, col in mosaic.under(window):
        top, left = max(row, r0), max(col, c0)
        bottom, right = min(row + tile.shape[0], r1), min(col + tile.shape[1], c1)
        inner = Window(left - col, top - row, right - left, bottom - top)  # pyright: ignore[reportCallIssue]
        part, unknown = _read_part(mosaic, tile, inner, files)
        here = np.s_[top - r0 : bottom - r0, left - c0 : right - c0]
        take = void[here] & ~unknown
        np.copyto(values[here], part, where=take)
        void[here] &= ~take
    return values, void


def _read_part(mosaic: Mosaic, tile: Tile, inner: Window, files: OpenFiles) -> tuple[np.ndarray, np.ndarray]:
    """Values with scale and offset applied, and voids, of a window of one tile."""
    part, unknown = read_tile(tile, inner, files)
    for mark in mosaic.nodata:
        here = marked(part, mark)
        if here.any():
            mosaic.marks_found.add(mark)
            unknown |= here
    check_untagged(tile, part, unknown, (int(inner.row_off), int(inner.col_off)), mosaic.unit)
    if (tile.scale, tile.offset) != (1.0, 0.0):
        part = part.astype(np.float64) * tile.scale + tile.offset
    return part, unknown


def check_no_two_are_alike(mosaic: Mosaic) -> None:
    """Refuse two files over the same posts unless the caller named them: one may not be heights."""
    seen: dict[tuple[int, ...], Tile] = {}
    for tile, corners in zip(mosaic.tiles, map(tuple, mosaic.corners), strict=True):
        if corners in seen:
            raise DemError(
                f"{tile.path}: it covers the same posts as {seen[corners].path}. If both hold heights, name them one "
                f'by one in order of preference; else leave one out, e.g. by a pattern such as "*_dem.tif".'
            )
        seen[corners] = tile


def offset_on(first: Tile, tile: Tile) -> tuple[int, int]:
    """(row, col) of a tile's first post on the grid of the first tile. Raises `DemError` if it is not on that grid."""
    if tile is first:
        return 0, 0
    if tile.crs is not first.crs and not tile.crs.equals(first.crs, ignore_axis_order=True):
        raise DemError(
            f"{tile.path}: its CRS is {tile.crs.name!r}, that of {first.path} is {first.crs.name!r}; tiles must share "
            f"one grid (they are not resampled). Read them apart, or warp them to one grid first."
        )
    if not alike(_unit_or_metre(tile), _unit_or_metre(first)):
        raise DemError(
            f"{tile.path}: its heights are in {unit_shown(stated_unit(tile))}, those of {first.path} in "
            f"{unit_shown(stated_unit(first))}. Convert them to one unit first (gdal_calc), or read them apart."
        )
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


def _unit_or_metre(tile: Tile) -> float | str | None:
    """The unit that a tile states; metres if it states none, unless its map is in another unit."""
    stated = stated_unit(tile)
    return 1.0 if stated is None and (tile.is_geographic or tile.map_unit == 1.0) else stated


def _spacing(tile: Tile) -> str:
    return f"{np.hypot(tile.affine.a, tile.affine.d):.9g} x {np.hypot(tile.affine.b, tile.affine.e):.9g}"
