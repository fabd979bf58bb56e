"""Tiles of an archive and the parts of them that are read: whole blocks of their files, kept as small GeoTIFFs."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from typing import Any

import numpy as np
import pyproj
from pyproj.transformer import Transformer
from rasterio.enums import MaskFlags
from rasterio.io import DatasetReader, MemoryFile
from rasterio.transform import Affine
from rasterio.windows import Window

LEAST = 512  # posts: parts of files with smaller blocks are as many blocks as give this
COARSE = 64  # posts: side of the squares whose lowest post is known
ENDING = ".tif"

Place = tuple[int, int]
"""(row, col) of a part in its tile."""


@dataclasses.dataclass(frozen=True)
class TileHeader:
    """What is known of a tile before its heights are read; `transform` is that of corners.

    `version` changes with the content of the file; `sea` marks a tile that the archive lacks, of zero height.
    """

    url: str
    shape: tuple[int, int]
    transform: tuple[float, ...]
    crs: str
    part: tuple[int, int]
    version: str = ""
    sea: bool = False

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> TileHeader | None:
        """From JSON; None if it is no header."""
        try:
            pairs = {name: tuple(content[name]) for name in ("shape", "transform", "part")}
            return cls(content["url"], crs=content["crs"], version=content["version"], sea=content["sea"], **pairs)
        except (KeyError, TypeError):
            return None

    @functools.cached_property
    def _to_map(self) -> Transformer | None:
        crs = pyproj.CRS.from_user_input(self.crs)
        flat = crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()
        return None if flat.is_geographic else Transformer.from_crs("EPSG:4326", flat, always_xy=True)

    def rowcol(self, lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(row, col) of posts at positions in deg; not finite outside the map."""
        a, b, c, d, e, f = self.transform[:6]
        if self._to_map is not None:
            x, y = (np.asarray(one) for one in self._to_map.transform(lon, lat))
        else:
            middle = c + 0.5 * a * self.shape[1]
            x, y = middle + np.remainder(lon - middle + 180.0, 360.0) - 180.0, lat
        x, y, det = x - c, y - f, a * e - b * d
        return (a * y - d * x) / det - 0.5, (e * x - b * y) / det - 0.5

    def parts_at(self, lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(row, col) of the parts with positions, and the mask of positions on the tile, or less than a post beside
        it: cells between two tiles have posts of both."""
        row, col = self.rowcol(lon, lat)
        rows, cols = self.shape
        with np.errstate(invalid="ignore"):
            inside = (row >= -1.0) & (row <= rows) & (col >= -1.0) & (col <= cols)
        row, col = (np.clip(np.round(np.where(inside, one, 0.0)), 0, n - 1) for one, n in ((row, rows), (col, cols)))
        return row.astype(int) // self.part[0], col.astype(int) // self.part[1], inside

    def squares_at(self, place: Place, lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(row, col) of the squares of `COARSE` posts in a part at positions on it."""
        row, col = self.rowcol(lon, lat)
        row, col = (
            np.clip(np.floor((one - first * n) / COARSE), 0, None).astype(int)
            for one, first, n in zip((row, col), place, self.part, strict=True)
        )
        return row, col

    def window(self, place: Place) -> Window:
        """The posts of a part."""
        (row, col), (rows, cols) = place, self.part
        top, left = row * rows, col * cols
        height, width = min(rows, self.shape[0] - top), min(cols, self.shape[1] - left)
        return Window(left, top, width, height)  # pyright: ignore[reportCallIssue]


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of a tile on this machine: its file, and the lowest posts of its squares, in the unit of the file."""

    path: str
    digest: str
    size: int
    lowest: np.ndarray
    sea: bool = False
    was_cached: bool = False

    def lowest_around(self, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        """The lowest known post in m of a square and its neighbours; -inf without any. `row`, `col` are squares (n,).

        Neighbours are taken in, since cells between two squares have posts of both; at the edge of a part the lowest
        post beyond is unknown, but a ray is followed over it as well.
        """
        rows, cols = self.lowest.shape
        wide = np.pad(np.where(np.isnan(self.lowest), np.inf, self.lowest), 1, constant_values=np.inf)
        around = np.min([wide[i : i + rows, j : j + cols] for i in range(3) for j in range(3)], axis=0)
        low = around[np.minimum(row, rows - 1), np.minimum(col, cols - 1)]
        return np.where(np.isinf(low), -np.inf, low)


def header_of(url: str, data: DatasetReader, version: str) -> TileHeader:
    """The header of an open tile."""
    shape, block = data.shape, data.block_shapes[0]
    whole = url.endswith((".gz", ".zip"))
    part = tuple(n if whole else min(n, b * max(1, math.ceil(LEAST / b))) for n, b in zip(shape, block, strict=True))
    crs = data.crs.to_wkt() if data.crs is not None else ""
    return TileHeader(url, shape, tuple(data.transform)[:6], crs, (part[0], part[1]), version)


def read_part(data: DatasetReader, window: Window) -> np.ndarray:
    """Stored values of a window, masked posts as a value that marks voids."""
    values = data.read(1, window=window)
    if MaskFlags.per_dataset in data.mask_flag_enums[0]:
        values[data.read_masks(1, window=window) == 0] = void_of(data)
    return values


def void_of(data: DatasetReader) -> float | int:
    """The stored value that marks voids."""
    if data.nodata is not None:
        return data.nodata
    kind = np.dtype(data.dtypes[0])
    return math.nan if kind.kind == "f" else int(np.iinfo(kind).min)


def as_file(data: DatasetReader, window: Window, values: np.ndarray) -> bytes:
    """A window as a GeoTIFF with the same posts on the same grid."""
    masked = MaskFlags.per_dataset in data.mask_flag_enums[0]
    more = {"units": data.units[0], "scale": data.scales[0], "offset": data.offsets[0]}
    nodata = void_of(data) if masked else data.nodata
    return encoded(values, data.crs, placed(data.transform, window), nodata, **more)


def placed(affine: Affine, window: Window) -> Affine:
    """The transform of corners of a window."""
    return affine @ Affine.translation(window.col_off, window.row_off)


def sea_file(header: TileHeader, window: Window) -> bytes:
    """A window of zero height."""
    values = np.zeros((int(window.height), int(window.width)), np.float32)
    return encoded(values, header.crs, placed(Affine(*header.transform), window), None)


def encoded(
    values: np.ndarray,
    crs: Any,
    affine: Affine,
    nodata: float | None,
    *,
    units: str | None = None,
    scale: float = 1.0,
    offset: float = 0.0,
) -> bytes:
    """A compressed GeoTIFF of one band, in memory."""
    profile: dict[str, Any] = {
        "driver": "GTiff", "dtype": values.dtype, "count": 1, "height": values.shape[0], "width": values.shape[1],
        "transform": affine, "compress": "deflate", "predictor": 3 if values.dtype.kind == "f" else 2,
    }  # fmt: skip
    if min(values.shape) >= 256:
        profile |= {"tiled": True, "blockxsize": 256, "blockysize": 256}
    profile |= {"crs": crs} if crs else {}
    profile |= {} if nodata is None else {"nodata": nodata}
    with MemoryFile() as memory:
        with memory.open(**profile) as sink:
            if scale != 1.0:
                sink.scales = (scale,)
            if offset != 0.0:
                sink.offsets = (offset,)
            if units:
                sink.units = (units,)
            sink.write(values, 1)
        return bytes(memory.getbuffer())


def lowest_of(values: np.ndarray, void: float | None) -> np.ndarray:
    """The lowest known post of each square of `COARSE` posts, and of the row and column beyond; NaN without any."""
    heights = values.astype(np.float64)
    if void is not None:
        heights[values == void] = np.nan
    heights[~np.isfinite(heights)] = np.nan
    rows, cols = (math.ceil(n / COARSE) for n in values.shape)
    heights = np.pad(heights, ((0, rows * COARSE - len(heights)), (0, cols * COARSE - heights.shape[1])),
                     constant_values=np.nan)  # fmt: skip
    filled = np.where(np.isnan(heights), np.inf, heights).reshape(rows, COARSE, cols, COARSE).min(axis=(1, 3))
    return np.where(np.isinf(filled), np.nan, filled)


def file_name(url: str) -> str:
    """The name of a file at an address."""
    return os.path.basename(url.split("?")[0].rstrip("/"))
