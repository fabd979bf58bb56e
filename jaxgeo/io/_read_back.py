"""Verification of written rasters: GDAL does not report a full disk on closing a file."""

from __future__ import annotations

import pathlib
import zlib
from typing import NamedTuple

import numpy as np
import rasterio
from rasterio.errors import RasterioError
from rasterio.windows import Window

BLOCK = 256  # cells per side of the blocks that track the last writing window
ROWS = 1024  # rows read back at a time


class _Part(NamedTuple):
    window: Window
    has_mask: bool
    sums: tuple[int, int]


class WrittenWindows:
    """Checksums of the windows written to a raster of `shape`, for comparison with its file."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._parts: list[_Part] = []
        self._last = np.full([-(-n // BLOCK) for n in shape], -1, np.int32)  # index of the part last written there

    def add(self, row: int, col: int, values: np.ndarray, known: np.ndarray | None) -> None:
        """Register a window that starts at (row, col): values (bands, rows, cols), its optional mask (rows, cols)."""
        rows, cols = values.shape[1:]
        for start in range(0, rows, ROWS):
            stop = min(start + ROWS, rows)
            window = Window(col, row + start, cols, stop - start)  # pyright: ignore[reportCallIssue]
            mask = None if known is None else known[start:stop]
            self._last[_blocks(window)] = len(self._parts)
            self._parts.append(_Part(window, mask is not None, _sums(values[:, start:stop], mask)))

    def mistake(self, path: pathlib.Path) -> str:
        """Why a file differs from what was written, empty if equal; overwritten windows are skipped."""
        try:
            with rasterio.open(path) as data:
                for number, part in enumerate(self._parts):
                    if np.any(self._last[_blocks(part.window)] != number):
                        continue
                    values = data.read(window=part.window)
                    mask = data.read_masks(1, window=part.window) != 0 if part.has_mask else None
                    if _sums(values, mask) != part.sums:
                        return f"rows {part.window.row_off} and after are not what was written; is the disk full?"
        except RasterioError as error:
            return f"it cannot be read back ({error}); is the disk full?"
        return ""


def _blocks(window: Window) -> tuple[slice, slice]:
    first, last = (window.row_off, window.col_off), (window.row_off + window.height, window.col_off + window.width)
    rows, cols = (slice(a // BLOCK, -(-b // BLOCK)) for a, b in zip(first, last, strict=True))
    return rows, cols


def _sums(values: np.ndarray, mask: np.ndarray | None) -> tuple[int, int]:
    known = b"" if mask is None else np.packbits(mask).tobytes()
    return zlib.crc32(np.ascontiguousarray(values).data), zlib.crc32(known)
