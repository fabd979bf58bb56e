"""Raster files as rasterio reads them: one array of values and voids, from one file or several tiles on one grid."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import pathlib
import warnings
from collections.abc import Iterator, Sequence

import numpy as np
import pyproj
import rasterio
from pyproj.exceptions import CRSError
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError, RasterioIOError
from rasterio.transform import Affine
from rasterio.windows import Window

from jaxgeo.io.errors import DemError
from jaxgeo.io.vertical import horizontal_part, vertical_part, vertical_unit

MISALIGNED = 1e-3  # cells; tiles farther than this from a common grid would need resampling
MOST_POSTS = 2_000_000_000
_NOT_HEIGHTS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha, ColorInterp.palette)
_UNITS = {
    "m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0,
    "ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "international foot": 0.3048,
    "us-ft": 1200 / 3937, "ftus": 1200 / 3937, "us survey foot": 1200 / 3937, "us survey feet": 1200 / 3937,
}  # fmt: skip

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


@dataclasses.dataclass(frozen=True)
class Tile:
    """One file's header. `affine` maps (col, row) of post centres, not of corners, to map coordinates."""

    path: str
    band: int
    driver: str
    shape: tuple[int, int]
    affine: Affine
    crs: pyproj.CRS
    dtype: np.dtype
    scale: float
    offset: float
    unit: str | None

    @property
    def is_geographic(self) -> bool:
        """Whether the map coordinates are longitude and latitude."""
        return horizontal_part(self.crs).is_geographic

    @property
    def cols_per_turn(self) -> int | None:
        """Columns in 360 degrees of longitude, where that is a whole number of them."""
        if not self.is_geographic or self.affine.a == 0.0 or self.affine.b or self.affine.d:
            return None
        turn = 2.0 * np.pi / horizontal_part(self.crs).axis_info[0].unit_conversion_factor
        cols = abs(turn / self.affine.a)
        return round(cols) if abs(cols - round(cols)) < MISALIGNED else None


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

    def bounds(self) -> tuple[int, int, int, int]:
        """(first row, first col, last row + 1, last col + 1) of all tiles."""
        corners = [(r, c, r + t.shape[0], c + t.shape[1]) for t, (r, c) in zip(self.tiles, self.offsets, strict=True)]
        r0, c0, r1, c1 = zip(*corners, strict=True)
        return min(r0), min(c0), max(r1), max(c1)


def open_mosaic(paths: Paths, band: int) -> Mosaic:
    """Headers of one file or of several tiles on one grid. Raises `FileNotFoundError` or `DemError`."""
    names = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not names:
        raise DemError("no file was named: paths is empty.")
    tiles = tuple(_header(os.fspath(name), band) for name in names)
    return Mosaic(tiles, tuple(_offset(tiles[0], tile) for tile in tiles))


def read_window(mosaic: Mosaic, window: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Values as stored, and voids, of (first row, first col, last row + 1, last col + 1) on the mosaic's grid.

    Where several tiles hold a post, the first that knows it is taken; what none holds is void.
    """
    r0, c0, r1, c1 = window
    if (r1 - r0) * (c1 - c0) > MOST_POSTS:
        raise DemError(f"{mosaic.name}: {r1 - r0} x {c1 - c0} posts are too many at once; name a part with bounds=.")
    dtype = np.result_type(*(_stored_dtype(tile) for tile in mosaic.tiles))
    values, void = np.zeros((r1 - r0, c1 - c0), dtype), np.ones((r1 - r0, c1 - c0), bool)
    turn = mosaic.first.cols_per_turn
    for tile, (row, col) in zip(mosaic.tiles, mosaic.offsets, strict=True):
        for shift in (0,) if turn is None else (0, -turn, turn):
            top, left = max(row, r0), max(col + shift, c0)
            bottom, right = min(row + tile.shape[0], r1), min(col + shift + tile.shape[1], c1)
            if top >= bottom or left >= right:
                continue
            part, unknown = _read(tile, Window(left - col - shift, top - row, right - left, bottom - top))  # pyright: ignore
            here = np.s_[top - r0 : bottom - r0, left - c0 : right - c0]
            take = void[here] & ~unknown
            values[here] = np.where(take, part, values[here])
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


@contextlib.contextmanager
def _opened(path: str) -> Iterator[rasterio.DatasetReader]:
    """An open dataset; GDAL is asked not to drop the vertical part of a GeoTIFF's CRS."""
    is_plain = "://" not in path and not path.startswith("/vsi") and ":" not in path[2:]
    if is_plain and not pathlib.Path(path).exists():
        raise FileNotFoundError(f"{path}: no such file.")
    with rasterio.Env(GTIFF_REPORT_COMPD_CS="YES"), warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # refused below, in words
        try:
            dataset = rasterio.open(path)
        except RasterioError as error:
            raise DemError(f"{path}: not a raster that GDAL can open, or a damaged one: {error}") from error
        with dataset:
            yield dataset


def _header(path: str, band: int) -> Tile:
    with _opened(path) as data:
        if not 1 <= band <= data.count:
            raise DemError(f"{path}: there is no band {band}; the file has {data.count}.")
        _check_holds_heights(path, data, band)
        _check_georeferenced(path, data)
        if data.crs is None:
            raise DemError(
                f"{path}: the file names no coordinate reference system, so nobody knows where it lies. "
                f"Write one into it, e.g. gdal_edit -a_srs EPSG:4326 {path}."
            )
        return Tile(
            path=path,
            band=band,
            driver=data.driver,
            shape=data.shape,
            affine=_centred(data.transform),
            crs=_crs(path, data),
            dtype=np.dtype(data.dtypes[band - 1]),
            scale=data.scales[band - 1],
            offset=data.offsets[band - 1],
            unit=data.units[band - 1] or None,
        )


def _centred(corner: Affine) -> Affine:
    """The transform of post centres from that of corners, which is what GDAL gives for area and for point files."""
    a, b, c, d, e, f = corner[:6]
    return Affine(a, b, c + (a + b) / 2.0, d, e, f + (d + e) / 2.0)


def _crs(path: str, data: rasterio.DatasetReader) -> pyproj.CRS:
    try:
        crs = pyproj.CRS.from_wkt(data.crs.to_wkt())
    except (CRSError, RasterioError) as error:
        raise DemError(f"{path}: PROJ does not understand the file's coordinate reference system: {error}") from error
    flat = horizontal_part(crs)
    if not (flat.is_geographic or flat.is_projected):
        raise DemError(f"{path}: {crs.name!r} ({crs.type_name}) does not say where on the Earth the file lies.")
    return crs


def _check_holds_heights(path: str, data: rasterio.DatasetReader, band: int) -> None:
    dtype, colour = data.dtypes[band - 1], data.colorinterp[band - 1]
    if "complex" in dtype:
        raise DemError(f"{path}: band {band} holds complex numbers ({dtype}), not heights.")
    if colour in _NOT_HEIGHTS:
        raise DemError(f"{path}: band {band} is the {colour.name} channel of a picture, not heights.")
    if min(data.shape) < 2:
        raise DemError(f"{path}: {data.height} x {data.width} posts make no surface; at least 2 x 2 are needed.")


def _check_georeferenced(path: str, data: rasterio.DatasetReader) -> None:
    t = data.transform
    if t.is_identity:
        how = "ground control points" if data.gcps[0] else "rational polynomials" if data.rpcs else None
        reason = f"it is placed by {how} only" if how else "it has no geotransform"
        raise DemError(f"{path}: the file's rows and columns are on no map: {reason}. Warp it first (gdalwarp).")
    if not np.isfinite(t.determinant) or t.is_degenerate:
        raise DemError(f"{path}: the geotransform {tuple(t)[:6]} squeezes the raster into a line.")


def _offset(first: Tile, tile: Tile) -> tuple[int, int]:
    """(row, col) of a tile's first post on the grid of the first tile. Raises `DemError` if it is not on that grid."""
    if tile is first:
        return 0, 0
    if not tile.crs.equals(first.crs, ignore_axis_order=True):
        raise DemError(
            f"{tile.path}: its CRS is {tile.crs.name!r}, that of {first.path} is {first.crs.name!r}; tiles must share "
            f"one grid (they are not resampled). Read them apart, or warp them to one grid first."
        )
    if tile.unit != first.unit:
        raise DemError(f"{tile.path}: its heights are in {tile.unit!r}, those of {first.path} in {first.unit!r}.")
    steps, others = np.array(first.affine[:6]).reshape(2, 3), np.array(tile.affine[:6]).reshape(2, 3)
    drift = np.linalg.solve(steps[:, :2], others[:, :2] - steps[:, :2]) * max(tile.shape)
    if np.abs(drift).max() > MISALIGNED:
        raise DemError(
            f"{tile.path}: its posts are spaced {_spacing(tile)}, those of {first.path} {_spacing(first)}; tiles must "
            f"share one grid (they are not resampled). Read them apart, or warp them to one grid first."
        )
    col, row = np.linalg.solve(steps[:, :2], others[:, 2] - steps[:, 2])
    if first.cols_per_turn is not None:
        col -= first.cols_per_turn * np.round((col + (tile.shape[1] - first.shape[1]) / 2.0) / first.cols_per_turn)
    if max(abs(row - round(row)), abs(col - round(col))) > MISALIGNED:
        raise DemError(
            f"{tile.path}: its first post falls at row {row:.3f}, column {col:.3f} of the grid of {first.path}; tiles "
            f"must share one grid (they are not resampled). Read them apart, or warp them to one grid first."
        )
    return round(row), round(col)


def _read(tile: Tile, window: Window) -> tuple[np.ndarray, np.ndarray]:
    with _opened(tile.path) as data:
        try:
            values = data.read(tile.band, window=window)
            unknown = data.read_masks(tile.band, window=window) == 0
            if ColorInterp.alpha in data.colorinterp:  # GDAL's own mask heeds it for 8- and 16-bit files only
                unknown |= data.read(data.colorinterp.index(ColorInterp.alpha) + 1, window=window) == 0
        except RasterioIOError as error:
            raise DemError(
                f"{tile.path}: rows {window.row_off} to {window.row_off + window.height} cannot be read; the file is "
                f"damaged or cut short: {error.__cause__ or error}"
            ) from error
    if values.dtype.kind == "f":
        unknown |= ~np.isfinite(values)
        values = np.where(unknown, 0.0, values)
    if (tile.scale, tile.offset) != (1.0, 0.0):
        values = values.astype(np.float64) * tile.scale + tile.offset
    return values, unknown


def _stored_dtype(tile: Tile) -> np.dtype:
    return np.dtype(np.float64) if (tile.scale, tile.offset) != (1.0, 0.0) else tile.dtype


def _unit(name: str, whose: str) -> float:
    try:
        return _UNITS[name.strip().lower()]
    except KeyError:
        raise DemError(
            f'{whose} is {name!r}, no known unit of height; pass height_unit="m", "ft" or "us-ft".'
        ) from None


def _spacing(tile: Tile) -> str:
    return f"{np.hypot(tile.affine.a, tile.affine.d):.9g} x {np.hypot(tile.affine.b, tile.affine.e):.9g}"
