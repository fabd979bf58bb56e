"""Rectification: an image brought onto a grid on the ground, with what the terrain hides left out."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Int8

from jaxgeo._checks import as_float64, check_is
from jaxgeo._doors import check_terrain, checked_air, observation
from jaxgeo.earth import Atmosphere
from jaxgeo.locate import FIRST_HIT
from jaxgeo.register.cells import WELL_MAPPED, Cells, View, boxes_of, cells_by_polynomials, cells_one_by_one, hidden
from jaxgeo.register.interpolation import AbstractInterpolation, Bilinear, Nearest, precision_of, sampled
from jaxgeo.register.open_sight import OpenSight
from jaxgeo.register.orthoimage import Orthoimage
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.terrain.grid import AbstractGrid

TILE = 256  # cells on a side, at most: arrays that stay in the processor's caches
PART = 32  # cells on a side, whose lines of sight are looked at together
SEARCHED = 8192  # lines of sight in one call: one size, which is compiled once
BILINEAR = Bilinear()
COARSEST = 6  # times an image is halved, at most
HIDDEN_TOLERANCE = 0.01


class Tile(NamedTuple):
    """What a tile of a rectified image holds: values (bands, rows, cols) in the image's dtype, zero where nothing is
    known; whether there is an image, and the `Status` of each cell, (rows, cols)."""

    values: np.ndarray
    known: np.ndarray
    status: np.ndarray


class Rectified(eqx.Module):
    """A rectified image, and the `Status` (rows, cols) of each cell: `hit` where the image shows it, or why not."""

    orthoimage: Orthoimage
    status: Int8[Any, "rows cols"]


class Rectifier:
    """Rectifies an image onto any part of a grid, tile by tile; arguments and errors as for `rectify`."""

    def __init__(
        self,
        sensor: Sensor,
        shot: Shot | Trajectory,
        values: Any,
        known: Any,
        terrain: AbstractTerrain,
        grid: AbstractGrid,
        *,
        interpolation: AbstractInterpolation = BILINEAR,
        mask_hidden: bool = True,
        hidden_tolerance: float = HIDDEN_TOLERANCE,
        time: ArrayLike | None = None,
        atmosphere: Atmosphere | None = None,
    ) -> None:
        check_terrain(terrain, FIRST_HIT)
        check_is(grid, AbstractGrid, "grid")
        check_is(interpolation, AbstractInterpolation, "interpolation")
        sensor, motion, moment = observation(sensor, shot, time)
        values = checked_image(values, sensor)
        self.view = View(sensor, motion, moment, terrain, as_float64(grid, "grid"), checked_air(atmosphere))
        self.dtype = values.dtype
        self.interpolation = interpolation
        self._lock = threading.Lock()
        self._levels = [(jnp.asarray(values), _mask_of(known, values))]
        self._open_sight = OpenSight.of(self.view) if mask_hidden else None
        self._mask_hidden = mask_hidden
        self._tolerance = jnp.asarray(as_float64(hidden_tolerance, "hidden_tolerance"))

    def tile(self, row: int, col: int, shape: tuple[int, int]) -> Tile:
        """The cells from (row, col) of the grid on, `shape` = (rows, cols) of them."""
        cells = self._cells(row, col, shape)
        status = np.array(cells.status)
        if self._mask_hidden:
            self._hide(cells, status, row, col)
        return self._sampled(cells, status)

    def _cells(self, row: int, col: int, shape: tuple[int, int]) -> Cells:
        corner = jnp.array([float(row), float(col)])
        if isinstance(self.view.motion, Shot):
            cells, error = cells_by_polynomials(self.view, corner, shape)
            if float(error) <= WELL_MAPPED:
                return cells
        return cells_one_by_one(self.view, corner, shape)

    def _hide(self, cells: Cells, status: np.ndarray, row: int, col: int) -> None:
        """Mark the cells that ground hides, and those of which that cannot be told."""
        chosen = status == Status.hit
        if self._open_sight is not None:
            boxes = np.asarray(boxes_of(cells, jnp.asarray(chosen), PART))
            chosen &= np.kron(self._open_sight.searched(boxes), np.ones((PART, PART), bool))
        if not chosen.any():
            return
        rows, cols = np.nonzero(chosen)
        places = np.stack([rows + row, cols + col], axis=1).astype(np.float64)
        heights = np.asarray(cells.height)[rows, cols]
        found = np.empty(len(places), np.int8)
        for first in range(0, len(places), SEARCHED):
            part = slice(first, min(first + SEARCHED, len(places)))
            padded = np.resize(places[part], (SEARCHED, 2)), np.resize(heights[part], SEARCHED)
            answers = hidden(self.view, jnp.asarray(padded[0]), jnp.asarray(padded[1]), self._tolerance)
            found[part] = np.asarray(answers)[: part.stop - first]
        status[rows, cols] = found

    def _sampled(self, cells: Cells, status: np.ndarray) -> Tile:
        seen = status == Status.hit
        if not seen.any():
            return Tile(np.zeros((self._levels[0][0].shape[0], *seen.shape), self.dtype), seen, status)
        level = 0 if isinstance(self.interpolation, Nearest) else self._level_for(cells, seen)
        values, known = self._at_level(level)
        uv, size = (cells.u, cells.v), jnp.asarray(2.0**level)
        found, sound = _sampled(values, known, uv, size, jnp.asarray(seen), self.interpolation, self.dtype)
        return Tile(np.asarray(found), np.asarray(sound), status)

    def _level_for(self, cells: Cells, seen: np.ndarray) -> int:
        """How often the image is to be halved so that its pixels are about as large as the cells."""
        if min(seen.shape) < 2:
            return 0
        area = _areas(cells, seen, max(1, min(seen.shape) // 32))
        area = area if area.size else _areas(cells, seen, 1)
        if not area.size:
            return 0
        pixels = float(np.median(area)) ** 0.5
        return int(np.clip(np.floor(np.log2(max(pixels, 1.0)) + 0.5), 0, COARSEST))

    def _at_level(self, level: int) -> tuple[Array, Array | None]:
        with self._lock:  # tiles are made in several threads
            while len(self._levels) <= level and min(self._levels[-1][0].shape[1:]) > 1:
                self._levels.append(_halved(*self._levels[-1]))
            return self._levels[min(level, len(self._levels) - 1)]


def rectify(
    sensor: Sensor,
    shot: Shot | Trajectory,
    image: Any,
    terrain: AbstractTerrain,
    grid: AbstractGrid,
    shape: tuple[int, int],
    *,
    known: Any = None,
    interpolation: AbstractInterpolation = BILINEAR,
    mask_hidden: bool = True,
    hidden_tolerance: float = HIDDEN_TOLERANCE,
    time: ArrayLike | None = None,
    atmosphere: Atmosphere | None = None,
    tile: int = TILE,
) -> Rectified:
    """An image of a shot (or a trajectory and the image's `time`) as it lies on the ground, on a grid of `shape` cells.

    `image` (rows, cols) or (bands, rows, cols) of any real dtype, which is kept, of the size of the sensor's camera;
    `known` (rows, cols) says which of its pixels hold an image. `terrain` is a `Dem` or a `ConstantHeight`, `grid` the
    map from positions to the (row, col) of cells: that of an `Orthoimage`, of a `Dem`, or one of `jaxgeo.io`.
    Each cell is projected into the image from its own height, at its middle; where cells are larger than pixels, means
    over pixels are taken (not by `Nearest`). A cell that ground hides by more than `hidden_tolerance` m of the line of
    sight is not filled but has the status `hidden_by_terrain`: a first-hit search says so, but where slopes prove that
    nothing can be in between. `mask_hidden=False` leaves all that out: hidden ground then shows what hides it.

    Raises `ValueError` for an image of another size than the camera's, and as `project` does.
    """
    values = checked_image(image, sensor)
    rectifier = Rectifier(
        sensor,
        shot,
        values,
        known,
        terrain,
        grid,
        interpolation=interpolation,
        mask_hidden=mask_hidden,
        hidden_tolerance=hidden_tolerance,
        time=time,
        atmosphere=atmosphere,
    )
    result = np.zeros((values.shape[0], *shape), values.dtype)
    seen, status = np.zeros(shape, bool), np.zeros(shape, np.int8)
    for here, part in tiles_of(rectifier, shape, tile):
        result[:, *here], seen[here], status[here] = part
    return Rectified(Orthoimage(result, seen, rectifier.view.grid), status)


def tiles_of(
    rectifier: Rectifier, shape: tuple[int, int], tile: int = TILE
) -> Iterator[tuple[tuple[slice, slice], Tile]]:
    """(place, tile) of all tiles of a grid of `shape` cells, in order, computed on all processors.

    Tiles have one size, so that one program serves all; those at the end are cut.
    """
    rows, cols = shape
    side = _side(rows, tile), _side(cols, tile)
    corners = [(row, col) for row in range(0, rows, side[0]) for col in range(0, cols, side[1])]
    workers = _processors()
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[tuple[tuple[int, int], Future[Tile]]] = deque()
        for corner in corners:
            waiting.append((corner, pool.submit(rectifier.tile, *corner, side)))
            if len(waiting) > 2 * workers:  # no more than are soon wanted: the whole may be larger than memory
                yield _cut(*waiting.popleft(), side, shape)
        while waiting:
            yield _cut(*waiting.popleft(), side, shape)


def _cut(
    corner: tuple[int, int], made: Future[Tile], side: tuple[int, int], shape: tuple[int, int]
) -> tuple[tuple[slice, slice], Tile]:
    """(place, tile) of a tile when it is made, without what lies beyond the last row and column."""
    (row, col), part = corner, made.result()
    here = np.s_[row : min(row + side[0], shape[0]), col : min(col + side[1], shape[1])]
    cut = np.s_[: here[0].stop - row, : here[1].stop - col]
    return here, Tile(part.values[:, *cut], part.known[cut], part.status[cut])


def checked_image(image: Any, sensor: Sensor) -> np.ndarray:
    """The image as (bands, rows, cols). Raises `ValueError` for a shape that is not that of the sensor's camera."""
    values = np.asarray(image)
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or values.dtype.kind not in "uif":
        raise ValueError(
            f"an image must be real numbers, (rows, cols) or (bands, rows, cols); got {values.dtype} of shape "
            f"{values.shape}."
        )
    width, height = (getattr(sensor.camera, side, None) for side in ("width", "height"))
    if (height, width) != values.shape[1:]:
        raise ValueError(
            f"the image has {values.shape[1]} rows of {values.shape[2]} pixels, the camera {height} of {width}: they "
            f"are no pair. If the image was made smaller, make the camera so too (focal length and principal point in "
            f"pixels, width and height)."
        )
    return values


def _mask_of(known: Any, values: np.ndarray) -> Array | None:
    """Which pixels hold an image; None if all do."""
    sound = np.all(np.isfinite(values), axis=0) if values.dtype.kind == "f" else np.ones(values.shape[1:], bool)
    if known is not None:
        if np.shape(known) != values.shape[1:]:
            raise ValueError(f"known must have the image's shape {values.shape[1:]}; got {np.shape(known)}.")
        sound = sound & np.asarray(known, bool)
    return None if sound.all() else jnp.asarray(sound)


@eqx.filter_jit
def _sampled(
    values: Array,
    known: Array | None,
    uv: tuple[Array, Array],
    size: Array,
    seen: Array,
    how: AbstractInterpolation,
    dtype: np.dtype,
) -> tuple[Array, Array]:
    """(values in `dtype` at pixels, of an image whose pixels are `size` times as large as those, zero unless known;
    whether they are), for what is seen. Whole numbers are rounded and kept within their range."""
    u, v = uv
    sound = seen & jnp.isfinite(u) & jnp.isfinite(v)
    place = tuple(jnp.where(sound, (x + 0.5) / size - 0.5, 0.0) for x in (u, v))
    found, all_known = sampled(values, known, (place[0], place[1]), how)
    sound = sound & all_known
    found = jnp.where(sound[None, :, :], found, 0.0)
    if dtype.kind != "f":
        limits = np.iinfo(dtype)
        found = jnp.clip(jnp.rint(found), limits.min, limits.max)
    return found.astype(dtype), sound


@eqx.filter_jit
def _halved(values: Array, known: Array | None) -> tuple[Array, Array | None]:
    """Means of four pixels; known where all four are. A last row or column left over is dropped."""
    bands, rows, cols = values.shape
    rows, cols = rows // 2 * 2, cols // 2 * 2
    squares = values[:, :rows, :cols].reshape(bands, rows // 2, 2, cols // 2, 2)
    means = jnp.mean(squares.astype(precision_of(values)), axis=(2, 4))
    if known is None:
        return means, None
    return means, jnp.all(known[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2), axis=(1, 3))


def _areas(cells: Cells, seen: np.ndarray, step: int) -> np.ndarray:
    """Areas in pixels of every `step`-th cell along both sides, where it and its neighbours are seen."""
    here, below, right = np.s_[:-1:step, :-1:step], np.s_[1::step, :-1:step], np.s_[:-1:step, 1::step]
    known = seen[here] & seen[below] & seen[right]
    u, v = np.asarray(cells.u), np.asarray(cells.v)
    (ur, uc), (vr, vc) = (((x[below] - x[here])[known], (x[right] - x[here])[known]) for x in (u, v))
    return np.abs(ur * vc - uc * vr)


def _side(count: int, most: int) -> int:
    """Of tiles that cover so many cells, none over `most` and as alike as may be: a multiple of `PART`."""
    tiles = -(-count // most)
    share = -(-count // tiles)
    return -(-share // PART) * PART


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
