"""Min/max height bounds per block of DEM files that are too large for memory."""

from __future__ import annotations

import hashlib
import os
import pathlib
import threading
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxgeo._partial import partial_file
from jaxgeo.io._regular import check_regular
from jaxgeo.io.errors import DemError
from jaxgeo.io.heights import POSSIBLE_HEIGHTS, Source
from jaxgeo.io.tiles import OpenFiles, stamp_of
from jaxgeo.io.windows import Window

BLOCK = 256  # cells on a side
MOST_AT_ONCE = 16  # blocks read at once: a million posts
_reading = threading.RLock()  # one global lock, since a lock per instance could not be pickled
FIELDS = ("low", "high", "has_void", "is_read")
LATTICE = 9  # samples per block side for the geoid undulation
# Exceptions that NumPy and zipfile raise for damaged, truncated or invalid files.
HEADER = 4096  # bytes: largest header that NumPy writes for an array
_UNREADABLE = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    NotImplementedError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)


class Blocks:
    """Height bounds over blocks of 256 x 256 cells of a mosaic, read on demand and cached.

    Block (i, j) starts at row 256 i and column 256 j; it has one more post per axis than cells, shared with its
    neighbours. `low` and `high` are bounds of the known posts in m above the ellipsoid (+inf and -inf where none is
    known), `has_void` marks unknown posts, `is_read` the blocks read so far. The bounds are exact, except for datums
    with a varying undulation: those are widened by the largest change of the undulation between neighbouring nodes of
    a lattice, and by 0.1 m.
    """

    def __init__(self, source: Source, height_range: tuple[float, float] | None, cache: pathlib.Path | None) -> None:
        self.source = source
        self.size = BLOCK
        self.height_range = height_range
        self.cache = cache
        rows, cols = source.window.shape
        turn = source.mosaic.first.cols_per_turn
        self.turn = turn if turn is not None and cols >= turn else None
        """Columns of a mosaic that spans all longitudes, where the first column follows the last."""
        self.cells = rows - 1, (cols - 1 if self.turn is None else self.turn)
        self.shape = -(-self.cells[0] // self.size), -(-self.cells[1] // self.size)
        self.low, self.high = np.full(self.shape, np.inf), np.full(self.shape, -np.inf)
        self.has_void, self.is_read = np.zeros(self.shape, bool), np.zeros(self.shape, bool)
        self.posts_read = 0
        self._saved = 0
        if cache is not None and cache.exists():
            self._load(cache)

    def read(self, wanted: np.ndarray | None = None) -> None:
        """Read the blocks of a mask (default: all) that are not read yet, a million posts at a time."""
        with _reading:
            self._read(~self.is_read if wanted is None else wanted & ~self.is_read)
            self._save(at_least=0.25)

    def _read(self, missing: np.ndarray) -> None:
        if not missing.any():
            return
        with OpenFiles() as files:
            for i in np.flatnonzero(missing.any(axis=1)):
                columns = np.flatnonzero(missing[i])
                for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
                    for start in range(0, run.size, MOST_AT_ONCE):
                        self._read_run(int(i), run[start : start + MOST_AT_ONCE], files)

    def bounds(self, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[float, float, bool]:
        """(lowest, highest, whether there are voids) over blocks of rows i0..i1 and columns j0..j1, inclusive.

        Columns may wrap around the Earth.
        """
        here = self._index(rows, cols)
        return float(self.low[here].min()), float(self.high[here].max()), bool(self.has_void[here].any())

    def column_of(self, col: int) -> int:
        """Block column of a cell column, counted on across the seam of a mosaic that spans all longitudes."""
        if self.turn is None or col < self.turn:
            return col // self.size
        return self.shape[1] + (col - self.turn) // self.size

    def mark(self, wanted: np.ndarray, rows: tuple[int, int], cols: tuple[int, int]) -> None:
        """Mark blocks in a mask of wanted blocks."""
        wanted[self._index(rows, cols)] = True

    def save(self, at_least: float = 0.0) -> None:
        """Write the cache file, if one was named, once the share of new blocks exceeds `at_least`."""
        with _reading:
            self._save(at_least)

    def _save(self, at_least: float) -> None:
        count = int(self.is_read.sum())
        is_enough = count == self.is_read.size or count - self._saved > at_least * self.is_read.size
        if self.cache is None or count == self._saved or not is_enough:
            return
        try:
            with partial_file(self.cache) as beside:
                with beside.open("wb") as stream:
                    np.savez_compressed(stream, **self.known())  # pyright: ignore[reportArgumentType]
                beside.replace(self.cache)
        except OSError as error:
            raise DemError(f"{self.cache}: the bounds of {self.source.name} cannot be written here: {error}") from error
        self._saved = count

    def known(self) -> dict[str, np.ndarray]:
        """The known bounds and the identity of their files, for `take`."""
        return {"identity": np.array(self.identity()), **{name: getattr(self, name) for name in FIELDS}}

    def take(self, held: Mapping[str, np.ndarray]) -> bool:
        """Adopt `known` bounds of another process if they are of the same, unchanged files; returns whether it did."""
        if str(held["identity"]) != self.identity():
            return False
        for name in FIELDS:
            getattr(self, name)[...] = held[name]
        return True

    def _load(self, cache: pathlib.Path) -> None:
        """Load the bounds of an earlier run if they are of the same files; otherwise they are recomputed."""
        check_regular(cache, DemError)
        try:
            with np.load(cache) as held:
                _check_size(held, "identity", 100 * HEADER)
                if str(held["identity"]) != self.identity():
                    return
                for name in FIELDS:
                    _check_size(held, name, getattr(self, name).nbytes + HEADER)
                self.take(held)
        except _UNREADABLE as error:
            raise DemError(
                f"{cache}: this is not a file of bounds as `open_dem` writes it ({error}). Delete it, or name another."
            ) from error
        self._saved = int(self.is_read.sum())

    def identity(self) -> str:
        """Key of the files, their times and sizes, and the reading options."""
        source = self.source
        files = [
            (os.path.abspath(t.path), t.band, stamp_of(t.path), [stamp_of(s) for s in t.sources])
            for t in source.mosaic.tiles
        ]
        rest = (source.mosaic.corners.tolist(), source.shift.name, source.unit, repr(source.nodata), self.size)
        return hashlib.sha256(repr((files, rest)).encode()).hexdigest()

    def _index(self, rows: tuple[int, int], cols: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(rows[0], rows[1] + 1)[:, None], np.arange(cols[0], cols[1] + 1)[None, :] % self.shape[1]

    def _read_run(self, i: int, run: np.ndarray, files: OpenFiles) -> None:
        """Read adjacent blocks of one block row together."""
        row, stop_row = i * self.size, min((i + 1) * self.size, self.cells[0]) + 1
        col, stop_col = int(run[0]) * self.size, min((int(run[-1]) + 1) * self.size, self.cells[1]) + 1
        window = Window(row, col, stop_row, stop_col)
        values, void = self.source.stored(window, files)
        self.posts_read += values.size
        for j in run:
            part = Window(row, int(j) * self.size, stop_row, min((int(j) + 1) * self.size, self.cells[1]) + 1)
            here = np.s_[:, part.col - col : part.stop_col - col]
            self._take(i, int(j), part, values[here], void[here])

    def _take(self, i: int, j: int, part: Window, values: np.ndarray, void: np.ndarray) -> None:
        has_void = bool(void.any())
        known = values[~void] if has_void else values
        if known.size:
            upwards = self.source.unit * self.source.shift.sign
            low, high = sorted(float(end) * upwards for end in (known.min(), known.max()))
            lowest, highest = self._undulation(part)
            low, high = low + lowest, high + highest
            allowed = POSSIBLE_HEIGHTS if self.height_range is None else self.height_range
            if not allowed[0] <= low <= high <= allowed[1]:  # NaN too
                heights = self.source.ellipsoidal(part, values, void, np.dtype(np.float64))  # may raise `DemError`
                low, high = float(heights[~void].min()), float(heights[~void].max())
                self._check_range(part, low, high)
            self.low[i, j], self.high[i, j] = low, high
        self.has_void[i, j], self.is_read[i, j] = has_void, True

    def _undulation(self, part: Window) -> tuple[float, float]:
        """Bounds in m of the height offset over a block; NaN outside the datum's grid."""
        shift = self.source.shift
        if shift.transformer is None:
            return shift.undulation, shift.undulation
        rows = np.linspace(part.row, part.stop_row - 1, LATTICE)
        cols = np.linspace(part.col, part.stop_col - 1, LATTICE)
        row, col = np.meshgrid(rows, cols, indexing="ij")
        lon, lat = self.source.mapping.lonlat(row.ravel(), col.ravel())
        added = shift.to_ellipsoid(lon, lat, np.zeros(lon.shape)).reshape(row.shape)
        change = max(np.abs(np.diff(added, axis=axis)).max() for axis in (0, 1)) + 0.1
        return float(added.min() - change), float(added.max() + change)

    def _check_range(self, part: Window, low: float, high: float) -> None:
        if self.height_range is None or (low >= self.height_range[0] and high <= self.height_range[1]):
            return
        raise DemError(
            f"{self.source.name}: rows {part.row} to {part.stop_row - 1}, columns {part.col} to {part.stop_col - 1} "
            f"hold heights of {low:.6g} to {high:.6g} m above the ellipsoid, beyond the height_range="
            f"({self.height_range[0]:g}, {self.height_range[1]:g}) that was stated. Widen it, or leave it out."
        )


def _check_size(held: Any, name: str, most: int) -> None:
    """Raises `ValueError` for an array of a file whose unpacked size exceeds the limit."""
    size = held.zip.getinfo(f"{name}.npy").file_size
    if size > most:
        raise ValueError(f"unpacked, {name} has {size:,} bytes, and at most {most:,} belong here")
