"""Orthorectification of an image onto a ground grid, with occluded cells masked."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Int8

from jaxgeo._accelerator import by_device, core_count
from jaxgeo._arguments import check_mapped_terrain, checked_air, checked_exposure
from jaxgeo._checks import as_float64, check_is
from jaxgeo._record import Record, packed, unpacked
from jaxgeo.earth import Atmosphere
from jaxgeo.observation import accepts_exposure
from jaxgeo.ortho.cells import Cells, View, cells_one_by_one, hidden, may_be_hidden, where_any
from jaxgeo.ortho.chart import WELL_MAPPED, Chart, basis, charted, charted_cells
from jaxgeo.ortho.interpolation import AbstractInterpolation, Bilinear, Nearest, Pixels, halved_pixels, sampled
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.ortho.visibility_bounds import OpenSight
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.terrain.grid import AbstractGrid

TILE, TILE_ACCELERATOR = 512, 2048  # cells on a side, at most
STRIP, ACROSS = 32, 128  # rows and columns of a tile per step, so that arrays stay in the processor's caches
SIDE_ACCELERATOR = 1024  # the same on an accelerator
SEARCHED, SEARCHED_ACCELERATOR = 1024, 2**17  # lines of sight per call: one size, compiled once
BILINEAR = Bilinear()
COARSEST = 6  # halvings of an image, at most
HIDDEN_TOLERANCE = 0.01


class How(NamedTuple):
    """Interpolation and output options."""

    interpolation: AbstractInterpolation
    dtype: np.dtype


class Filled(NamedTuple):
    """A tile's values (bands, rows, cols), mask of known cells, `Status` without occlusion, and flags of image cells
    that may be occluded (None if not requested)."""

    values: Array
    known: Array
    status: Array
    doubtful: Array | None


class Tile(NamedTuple):
    """A tile of a rectified image: values (bands, rows, cols) in the image's dtype, zero where unknown; mask of
    known cells and `Status` of each cell, (rows, cols)."""

    values: np.ndarray
    known: np.ndarray
    status: np.ndarray


class Rectified(Record):
    """A rectified image, and the `Status` (rows, cols) of each cell: `hit` where the image shows it, else the
    reason."""

    orthoimage: Orthoimage
    status: Int8[Any, "rows cols"]


class Rectifier:
    """Rectifies an image onto any part of a grid, tile by tile; arguments and errors as for `rectify`.

    Pickling stores the arguments, from which another process constructs it again.
    """

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
        how = {"interpolation": interpolation, "mask_hidden": mask_hidden, "hidden_tolerance": hidden_tolerance}
        how |= {"time": time, "atmosphere": atmosphere}
        self._made_of = (sensor, shot, values, known, terrain, grid), how
        check_mapped_terrain(terrain)
        check_is(grid, AbstractGrid, "grid")
        check_is(interpolation, AbstractInterpolation, "interpolation")
        sensor, motion, moment = checked_exposure(sensor, shot, time)
        values = checked_image(values, sensor)
        self.view = View(sensor, motion, moment, terrain, as_float64(grid, "grid"), checked_air(atmosphere))
        self._how = How(interpolation, values.dtype)
        self._lock = threading.Lock()
        self._image = values, _mask_of(known, values)
        self._levels: dict[int, Pixels] = {}
        self._open_sight = OpenSight.of(self.view) if mask_hidden else None
        self._mask_hidden = mask_hidden
        self._tolerance = jnp.asarray(as_float64(hidden_tolerance, "hidden_tolerance"))

    def __reduce__(self) -> tuple[Any, ...]:
        return _made_again, packed(self._made_of)

    def tile(self, row: int, col: int, shape: tuple[int, int]) -> Tile:
        """The cells from (row, col) of the grid, `shape` = (rows, cols)."""
        corner = jnp.array([float(row), float(col)])
        filled = self._by_chart(corner, shape) if isinstance(self.view.motion, Shot) else None
        filled = self._one_by_one(corner, shape) if filled is None else filled
        values, known, status = (np.asarray(x) for x in filled[:3])
        doubtful = status == Status.hit if self._open_sight is None else np.asarray(filled[3])
        if self._mask_hidden and doubtful.any():
            values, known, status = (x.copy() for x in (values, known, status))
            rows, cols = np.nonzero(doubtful)
            status[rows, cols] = self._looked_at(np.stack([rows + row, cols + col], axis=1))
            gone = doubtful & (status != Status.hit)
            values[:, gone], known[gone] = 0, False
        return Tile(values, known, status)

    def _by_chart(self, corner: Array, shape: tuple[int, int]) -> Filled | None:
        """A tile by polynomials; None where they are not accurate enough."""
        found = charted(self.view, corner, jnp.array([shape[0] - 1.0, shape[1] - 1.0]))
        if not float(found.error) <= WELL_MAPPED:
            return None
        level = self._level_for(*(np.asarray(x) for x in (found.lattice.u, found.lattice.v, found.lattice.status)))
        least_sine = self._open_sight and self._open_sight.least_sine(*np.asarray(found.on_terrain))
        pixels = self._at_level(level)
        across = _block()[1]
        side = max(by_device(TILE, TILE_ACCELERATOR), -(-max(shape) // across) * across)
        size = jnp.asarray(2.0**level)
        filled = _filled(self.view, found.chart, pixels, size, least_sine, jnp.asarray(shape), self._how, side)
        cut = lambda leaf: leaf[..., : shape[0], : shape[1]]  # noqa: E731
        if by_device(True, False):
            return jax.tree.map(lambda leaf: cut(np.asarray(leaf)), filled)
        return jax.tree.map(lambda leaf: np.asarray(cut(leaf)), filled)

    def _one_by_one(self, corner: Array, shape: tuple[int, int]) -> Filled:
        """A tile by exact projection of each cell."""
        cells = cells_one_by_one(self.view, corner, shape)
        here, below, right = np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[:-1, 1:]
        three = (np.asarray(x) for x in (cells.u, cells.v, cells.status))
        level = self._level_for(*(np.stack([x[part].ravel() for part in (here, below, right)], axis=1) for x in three))
        least_sine = None
        if self._open_sight is not None:
            on_terrain = np.stack([np.asarray(x).ravel() for x in (cells.terrain_row, cells.terrain_col)])
            least_sine = self._open_sight.least_sine(np.nanmin(on_terrain, axis=1), np.nanmax(on_terrain, axis=1))
        return _filled_cells(cells, self._at_level(level), jnp.asarray(2.0**level), least_sine, self._how)

    def _looked_at(self, places: np.ndarray) -> np.ndarray:
        """First-hit `Status` (n,) of the lines of sight to cells (n, 2)."""
        found, most = np.empty(len(places), np.int8), by_device(SEARCHED, SEARCHED_ACCELERATOR)
        for first in range(0, len(places), most):
            part = places[first : first + most]
            padded = jnp.asarray(np.resize(part, (most, 2)).astype(np.float64))
            found[first : first + most] = np.asarray(hidden(self.view, padded, self._tolerance))[: len(part)]
        return found

    def _level_for(self, u: np.ndarray, v: np.ndarray, status: np.ndarray) -> int:
        """Number of image halvings that make pixels about as large as cells, from pixels (n, 3) of sample cells and
        their neighbours one row and one column on."""
        if isinstance(self._how.interpolation, Nearest):
            return 0
        area = np.abs((u[:, 1] - u[:, 0]) * (v[:, 2] - v[:, 0]) - (u[:, 2] - u[:, 0]) * (v[:, 1] - v[:, 0]))
        seen = np.all(status == Status.hit, axis=1)
        area = area[seen if seen.any() else np.isfinite(area)]
        pixels = float(np.median(area)) ** 0.5 if area.size else 1.0
        return int(np.clip(np.floor(np.log2(max(pixels, 1.0)) + 0.5), 0, COARSEST))

    def _at_level(self, level: int) -> Pixels:
        level = min(level, min(self._image[0].shape[1:]).bit_length() - 1)
        with self._lock:  # several threads make tiles
            found = self._levels
            if level == 0 and 0 not in found:
                found[0] = _packed(Pixels.of(*self._image))
            for k in range(1, level + 1):
                if k not in found:
                    found[k] = halved_pixels(*self._image) if k == 1 else _halved(found[k - 1])
            return found[level]


def _made_again(given: tuple[Any, ...], how: dict[str, Any]) -> Rectifier:
    return Rectifier(*unpacked(given), **unpacked(how))


@accepts_exposure
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
    tile: int | None = None,
) -> Rectified:
    """Orthorectify the image of a shot (or a trajectory and the image's `time`) onto a grid of `shape` cells.

    `image` (rows, cols) or (bands, rows, cols) of any real dtype, which is kept, has the size of the sensor's camera;
    `known` (rows, cols) flags its valid pixels. `terrain` is a `Dem` or a `ConstantHeight`, `grid` the map from
    positions to the (row, col) of cells: that of an `Orthoimage`, of a `Dem`, or one of `jaxgeo.io`.
    Each cell centre is projected into the image from its own height. Where cells are larger than pixels, pixel means
    are used (not by `Nearest`). A cell that terrain occludes by more than `hidden_tolerance` m of the line of sight is
    not filled and has the status `hidden_by_terrain`. Occlusion is tested by first-hit search, except where slope
    bounds prove visibility. `mask_hidden=False` skips the test: occluded cells then show the occluding ground.

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
    rectifier: Rectifier, shape: tuple[int, int], tile: int | None = None
) -> Iterator[tuple[tuple[slice, slice], Tile]]:
    """(position, tile) of all tiles of a grid of `shape` cells, in order, computed on all processors.

    Tiles have one size, so that one compiled program serves all; those at the end are clipped.
    """
    rows, cols = shape
    tile = by_device(TILE, TILE_ACCELERATOR) if tile is None else tile
    side = _side(rows, tile), _side(cols, tile)
    corners = [(row, col) for row in range(0, rows, side[0]) for col in range(0, cols, side[1])]
    workers = core_count()
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[tuple[tuple[int, int], Future[Tile]]] = deque()
        for corner in corners:
            waiting.append((corner, pool.submit(rectifier.tile, *corner, side)))
            if len(waiting) > 2 * workers:  # limit the queue: the whole may be larger than memory
                yield _cut(*waiting.popleft(), side, shape)
        while waiting:
            yield _cut(*waiting.popleft(), side, shape)


def _cut(
    corner: tuple[int, int], made: Future[Tile], side: tuple[int, int], shape: tuple[int, int]
) -> tuple[tuple[slice, slice], Tile]:
    """(position, tile) of a finished tile, clipped to the last row and column."""
    (row, col), part = corner, made.result()
    here = np.s_[row : min(row + side[0], shape[0]), col : min(col + side[1], shape[1])]
    cut = np.s_[: here[0].stop - row, : here[1].stop - col]
    return here, Tile(part.values[:, *cut], part.known[cut], part.status[cut])


def checked_image(image: Any, sensor: Sensor) -> np.ndarray:
    """The image as (bands, rows, cols). Raises `ValueError` for a shape other than that of the sensor's camera."""
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


def _mask_of(known: Any, values: np.ndarray) -> np.ndarray | None:
    """Mask of valid pixels; None if all are valid."""
    sound = np.all(np.isfinite(values), axis=0) if values.dtype.kind == "f" else np.ones(values.shape[1:], bool)
    if known is not None:
        if np.shape(known) != values.shape[1:]:
            raise ValueError(f"known must have the image's shape {values.shape[1:]}; got {np.shape(known)}.")
        sound = sound & np.asarray(known, bool)
    return None if sound.all() else sound


_packed = eqx.filter_jit(Pixels.packed)
_halved = eqx.filter_jit(Pixels.halved)


@eqx.filter_jit
def _filled(
    view: View,
    chart: Chart,
    pixels: Pixels,
    size: ArrayLike,
    least_sine: Array | None,
    shape: Array,
    how: How,
    side: int,
) -> Filled:
    """A tile of `shape` cells filled by its chart, block by block, as the first of `side` x `side`: one program for
    tiles of all shapes. The others are meaningless."""
    by_row, by_col = (basis(jnp.arange(float(side)), last) for last in chart.last)
    sound = jnp.all(jnp.isfinite(chart.columns))
    strip, across = _block()
    rows, cols = -(-shape[0] // strip), -(-shape[1] // across)

    def block(row: Array, col: Array) -> Filled:
        of_row = jax.lax.dynamic_slice_in_dim(by_row, row, strip)
        of_col = jax.lax.dynamic_slice_in_dim(by_col, col, across)
        return _filled_cells(charted_cells(view, chart, of_row, of_col, sound), pixels, size, least_sine, how)

    def with_block(number: Array, whole: Filled) -> Filled:
        row, col = strip * (number // cols), across * (number % cols)

        def put(leaf: Array, part: Array) -> Array:
            return jax.lax.dynamic_update_slice(leaf, part, (*[0] * (leaf.ndim - 2), row, col))

        return jax.tree.map(put, whole, block(row, col))

    kinds = jax.eval_shape(block, 0, 0)
    blank = jax.tree.map(lambda leaf: jnp.zeros((*leaf.shape[:-2], side, side), leaf.dtype), kinds)
    return jax.lax.fori_loop(0, rows * cols, with_block, blank)


@eqx.filter_jit
def _filled_cells(cells: Cells, pixels: Pixels, size: ArrayLike, least_sine: Array | None, how: How) -> Filled:
    """Cells (rows, cols) filled from an image whose pixels are `size` times as large as the pixels of their
    coordinates."""
    some = jnp.any(cells.status == Status.hit)
    values, known = where_any(some, lambda *given: _values(pixels, size, how, *given), cells.u, cells.v, cells.status)
    doubtful = None if least_sine is None else may_be_hidden(cells, least_sine)
    return Filled(values, known, cells.status, doubtful)


def _values(pixels: Pixels, size: ArrayLike, how: How, u: Array, v: Array, status: Array) -> tuple[Array, Array]:
    """(values in the image's dtype (bands, rows, cols), zero where unknown; mask of known cells). Integers are
    rounded and clipped to their range."""
    sound = (status == Status.hit) & jnp.isfinite(u) & jnp.isfinite(v)
    place_u, place_v = (jnp.where(sound, (x + 0.5) / size - 0.5, 0.0) for x in (u, v))
    bands, all_known = sampled(pixels, (place_u, place_v), how.interpolation)
    sound = sound & all_known
    found = []
    for band in bands:
        value = jnp.where(sound, band, 0.0)
        if how.dtype.kind != "f":
            limits = np.iinfo(how.dtype)
            value = jnp.clip(jnp.rint(value), limits.min, limits.max)
        found.append(value.astype(how.dtype))
    return jnp.stack(found), sound


def _block() -> tuple[int, int]:
    """Rows and columns of a tile per step."""
    return by_device((STRIP, ACROSS), (SIDE_ACCELERATOR, SIDE_ACCELERATOR))


def _side(count: int, most: int) -> int:
    """Tile side for `count` cells: at most `most`, tiles of nearly equal size, a multiple of `STRIP`."""
    tiles = -(-count // most)
    share = -(-count // tiles)
    return -(-share // STRIP) * STRIP
