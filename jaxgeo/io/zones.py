"""Tiles with different column spacing by latitude (Copernicus DEM, DTED) as one terrain.

All zones are refined to common columns: an integer number of them per column of a zone. New posts are interpolated
linearly between two posts of a row, and the surface between posts is bilinear, so the surface of a zone
is exactly that of its own posts. Where two zones meet, the cells between the last row of one and the first of the next
join both rows: the surface is continuous there, and no post is moved. A row of posts in both zones is taken from
the zone with the closer columns.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from fractions import Fraction

import numpy as np

from jaxgeo.io.errors import DemError
from jaxgeo.io.paths import Paths, are_all_named, expanded
from jaxgeo.io.raster import Mosaic, check_no_two_are_alike, offset_on, read_window
from jaxgeo.io.reach import HERE, Reach
from jaxgeo.io.tiles import MISALIGNED, OpenFiles, Tile, read_header
from jaxgeo.terrain.pyramid import check_size

MOST_COLUMNS = 60  # common columns per column of a zone


@dataclasses.dataclass(frozen=True)
class Zones:
    """Mosaics on one common grid, `grid`; each with the number of common columns per own column, and its offset.

    `offsets` are the (row, col) of each mosaic's own first post on the common grid.
    """

    parts: tuple[Mosaic, ...]
    factors: tuple[int, ...]
    offsets: tuple[tuple[int, int], ...]
    grid: Tile

    @property
    def first(self) -> Tile:
        """The header of the common grid: the first tile's, except for its columns."""
        return self.grid

    @property
    def tiles(self) -> tuple[Tile, ...]:
        """All tiles, as in their files."""
        return tuple(tile for part in self.parts for tile in part.tiles)

    @property
    def name(self) -> str:
        """The files, for messages."""
        return f"{self.grid.path} and {len(self.tiles) - 1} more"

    @property
    def marks_found(self) -> set[float]:
        """Given void values that a post read so far had."""
        return set().union(*(part.marks_found for part in self.parts))

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """(first row, first col, last row + 1, last col + 1) of each mosaic, (mosaics, 4)."""
        found = []
        for part, factor, (row, col) in zip(self.parts, self.factors, self.offsets, strict=True):
            r0, c0, r1, c1 = part.bounds()
            found.append((r0 + row, c0 * factor + col, r1 + row, (c1 - 1) * factor + 1 + col))
        return np.array(found)

    def bounds(self) -> tuple[int, int, int, int]:
        """(first row, first col, last row + 1, last col + 1) of all of them."""
        r0, c0, r1, c1 = self.corners.T
        return int(r0.min()), int(c0.min()), int(r1.max()), int(c1.max())

    def read_as(self, unit: float, nodata: tuple[float, ...]) -> Zones:
        """A copy with m per unit of height and further void values."""
        return dataclasses.replace(self, parts=tuple(part.read_as(unit, nodata) for part in self.parts))

    def read(self, window: tuple[int, int, int, int], files: OpenFiles | None = None) -> tuple[np.ndarray, np.ndarray]:
        """As `Mosaic.read`, on the common grid."""
        if files is None:
            with OpenFiles() as files:
                return self.read(window, files)
        r0, c0, r1, c1 = window
        try:
            check_size((r1 - r0, c1 - c0))
        except ValueError as error:
            raise DemError(f"{self.name}: {error}") from error
        values, void = np.zeros((r1 - r0, c1 - c0)), np.ones((r1 - r0, c1 - c0), bool)
        for part, factor, (row, col), corners in zip(
            self.parts, self.factors, self.offsets, self.corners.tolist(), strict=True
        ):
            top, bottom = max(r0, corners[0]), min(r1, corners[2])
            if top >= bottom:
                continue
            found, unknown = _refined(part, factor, (top - row, c0 - col, bottom - row, c1 - col), files)
            here = np.s_[top - r0 : bottom - r0]
            take = void[here] & ~unknown
            np.copyto(values[here], found, where=take)
            void[here] &= ~take
        return values, void


def open_tiles(paths: Paths, band: int, reach: Reach = HERE) -> Mosaic | Zones:
    """Headers of one file, or of several tiles on one grid except for their column spacing.

    Raises `FileNotFoundError` or `DemError`.
    """
    tiles = [read_header(name, band, reach) for name in expanded(paths)]
    zones: list[list[Tile]] = []
    for tile in tiles:
        zone = next((zone for zone in zones if _have_like_columns(zone[0], tile)), None)
        zones.append([tile]) if zone is None else zone.append(tile)
    steps = _columns_in_common([zone[0] for zone in zones]) if len(zones) > 1 else None
    found = _one(tiles) if steps is None else _several(tiles[0], zones, steps)
    if not are_all_named(paths):
        for part in found.parts if isinstance(found, Zones) else (found,):
            check_no_two_are_alike(part)
    return found


def _one(tiles: list[Tile]) -> Mosaic:
    return Mosaic(tuple(tiles), tuple(offset_on(tiles[0], tile) for tile in tiles))


def _several(first: Tile, zones: list[list[Tile]], steps: list[int]) -> Zones:
    """Zones with the finest columns first; the common grid starts at the very first tile."""
    order = sorted(range(len(zones)), key=lambda index: steps[index])
    parts, factors = tuple(_one(zones[index]) for index in order), tuple(steps[index] for index in order)
    factor = steps[next(index for index, zone in enumerate(zones) if zone[0] is first)]
    grid = _with_columns(first, factor)
    headers = (_with_columns(part.first, factor) for part, factor in zip(parts, factors, strict=True))
    return Zones(parts, factors, tuple(offset_on(grid, header) for header in headers), grid)


def _have_like_columns(a: Tile, b: Tile) -> bool:
    return abs(a.affine.a - b.affine.a) * max(a.shape[1], b.shape[1]) <= MISALIGNED * abs(a.affine.a)


def _columns_in_common(firsts: list[Tile]) -> list[int] | None:
    """The number of common columns per column of each tile; None if that is not a small integer.

    Only rows along parallels can be refined so; others are left to the checks of one grid.
    """
    if any(tile.affine.b or tile.affine.d or not tile.is_geographic for tile in firsts):
        return None
    finest = min(firsts, key=lambda tile: abs(tile.affine.a)).affine.a
    ratios = [Fraction(tile.affine.a / finest).limit_denominator(12) for tile in firsts]
    off = [abs(tile.affine.a / finest - r) * tile.shape[1] for tile, r in zip(firsts, ratios, strict=True)]
    common = math.lcm(*(ratio.denominator for ratio in ratios))
    steps = [int(ratio * common) for ratio in ratios]
    return steps if max(off) <= MISALIGNED and min(steps) > 0 and max(steps) <= MOST_COLUMNS else None


def _with_columns(tile: Tile, factor: int) -> Tile:
    """A header with `factor` columns for each of its own, and the same first post."""
    a, b, c, d, e, f = tile.affine[:6]
    rows, cols = tile.shape
    affine = type(tile.affine)(a / factor, b, c, d / factor, e, f)
    return dataclasses.replace(tile, affine=affine, shape=(rows, (cols - 1) * factor + 1))


def _refined(
    part: Mosaic, factor: int, window: tuple[int, int, int, int], files: OpenFiles
) -> tuple[np.ndarray, np.ndarray]:
    """Values and voids of rows and fine columns, from a mosaic's first post; new posts are interpolated linearly."""
    r0, c0, r1, c1 = window
    first, last = c0 // factor, -((1 - c1) // factor)
    values, void = read_window(part, (r0, first, r1, last + 1), files)
    if factor == 1:
        return values, void
    left, step = np.divmod(np.arange(c0, c1) - first * factor, factor)
    right = np.minimum(left + (step > 0), values.shape[1] - 1)
    share = step / factor
    fine = values[:, left] * (1.0 - share) + values[:, right] * share
    return fine, void[:, left] | void[:, right]
