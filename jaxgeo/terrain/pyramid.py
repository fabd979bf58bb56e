"""Pyramid of upper bounds of a bilinear surface over square blocks of cells, one level per power of two."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt16

from jaxgeo._checks import check_countable
from jaxgeo._record import Record
from jaxgeo._typing import Index, Scalar, ScalarField
from jaxgeo.terrain._memory import aligned_empty, handed_over

STEPS = 65_534  # height steps between the lowest and the highest ground
FINEST_STEP = 1e-7  # m, for level ground
ROWS_AT_ONCE = 64  # so that building takes little memory besides the posts


class Pyramid(Record):
    """Maxima over 2 x 2 neighbouring texels of 2^level x 2^level cells, all levels in one flat array.

    A box no wider than 2^level cells on either axis touches at most the texel of its lower corner and the next one
    on each axis, so one lookup at that corner bounds the surface over the whole box. Heights are `base` + `step` times
    the stored integer, in m, rounded up: two bytes per texel resolve a few centimetres.
    """

    bounds: UInt16[Array, "... texels"]
    base: ScalarField
    step: ScalarField
    shape: tuple[int, int] = eqx.field(static=True)

    @property
    def top(self) -> int:
        """The highest level: one texel covers all cells."""
        return len(_level_shapes(self.shape)) - 1

    def bound(self, level: Index, row: Index, col: Index) -> Scalar:
        """Upper bound in m over the texel (row, col) and the next ones at `level` (clipped to the pyramid)."""
        texel = texel_of(self.shape, level, row, col)
        stored = jnp.asarray(self.bounds).at[texel].get(mode="promise_in_bounds")
        return self.base + self.step * stored.astype(jnp.float64)


def texel_of(shape: tuple[int, int], level: Index, row: Index, col: Index) -> Index:
    """Flat index of the texel (row, col) at `level`, clipped to a pyramid over `shape` (rows, cols) cells.

    In 32 bits, as ensured by `check_size`: 64 bits would slow down the search's inner loop.
    """
    rows, cols = shape
    offsets = np.cumsum([0] + [rows * cols for rows, cols in _level_shapes(shape)[:-1]]).astype(np.int32)
    level = jnp.clip(level, 0, len(offsets) - 1)
    last_row, last_col = jnp.right_shift(rows - 1, level), jnp.right_shift(cols - 1, level)
    row, col = jnp.clip(row, 0, last_row), jnp.clip(col, 0, last_col)
    return jnp.asarray(offsets)[level] + row * (last_col + 1) + col


def check_size(posts: tuple[int, int]) -> None:
    """Raise `ValueError` for (rows, cols) of posts whose pyramid has too many texels for 32-bit indices."""
    rows, cols = posts
    texels = sum(rows * cols for rows, cols in _level_shapes((rows - 1, cols - 1)))
    check_countable(
        max(texels, rows * cols),
        f"{rows} x {cols} posts in one terrain (with the bounds above them)",
        "Cut out a part (bounds=, gdal_translate -projwin), or open the files with jaxgeo.io.open_dem, which reads "
        "only what lines of sight need.",
    )


def known_posts(unknown: Any, rows: Any, cols: Any, xp: Any) -> tuple[Any, Any]:
    """Which posts are known and within the true extent, and whether any within it is not; in NumPy with one array."""
    if xp is np:
        known = np.logical_not(unknown, out=aligned_empty(unknown.shape, bool))
        has_void = not known[:rows, :cols].all()
        known[rows:], known[:, cols:] = False, False
        return known, np.asarray(has_void)
    inside = (xp.arange(unknown.shape[0]) < rows)[:, None] & (xp.arange(unknown.shape[1]) < cols)[None, :]
    return inside & ~unknown, xp.any(inside & unknown)


def extremes(posts: Any, known: Any, xp: Any) -> tuple[Any, Any]:
    """Lowest and highest known post, without a temporary array of known posts."""
    kind = None if posts.dtype.kind == "f" else np.iinfo(posts.dtype)
    least, most = (-np.inf, np.inf) if kind is None else (kind.min, kind.max)
    lowest = xp.min(posts, where=known, initial=most)
    return lowest.astype(np.float64), xp.max(posts, where=known, initial=least).astype(np.float64)


def build_pyramid(
    posts: Any, unknown: Any, *, ceiling: Any, lowest: Any, highest: Any, xp: types.ModuleType
) -> Pyramid:
    """Pyramid over posts (rows, cols) in m, in NumPy or JAX (`xp`); unknown posts may be as high as `ceiling`.

    Every known post is between `lowest` and `highest`. With NumPy the posts are read in strips, so that memory is
    hardly more than the pyramid's own.
    """
    base = xp.minimum(xp.asarray(lowest, np.float64), ceiling)
    step = xp.maximum((xp.maximum(xp.asarray(highest, np.float64), ceiling) - base) / STEPS, FINEST_STEP)
    shape = (posts.shape[0] - 1, posts.shape[1] - 1)

    def tops(first: int, last: int) -> Any:
        """The highest of the four posts of cells in rows [first, last), in steps above the base, rounded up."""
        part = np.s_[first : last + 1]
        heights = xp.where(unknown[part], ceiling, posts[part].astype(np.float64))
        stored = (xp.floor((heights - base) / step) + 1.0).astype(np.uint16)
        stored = xp.maximum(stored[:-1], stored[1:])
        return xp.maximum(stored[:, :-1], stored[:, 1:])

    stored = handed_over(_in_place(tops, shape)) if xp is np else _all_at_once(tops(0, shape[0]), shape)
    base, step = jax.device_put((base, step)) if xp is np else (base, step)
    return Pyramid(stored, base, step, shape)


def _all_at_once(finest: Array, shape: tuple[int, int]) -> Array:
    """All levels, dilated and flat, in JAX."""
    levels = []
    for _ in _level_shapes(shape):
        levels.append(_dilated(finest, finest[-1:], jnp).reshape(-1))
        finest = _halved(finest, jnp)
    return jnp.concatenate(levels)


def _in_place(tops: Callable[[int, int], np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """As `_all_at_once` in NumPy, strip by strip, with no more memory than the result's."""
    sizes = [rows * cols for rows, cols in _level_shapes(shape)]
    bounds = aligned_empty((sum(sizes),), np.uint16)
    parts = np.split(bounds, np.cumsum(sizes)[:-1])
    levels = [part.reshape(shape) for part, shape in zip(parts, _level_shapes(shape), strict=True)]
    for first, last in _strips(shape[0]):
        levels[0][first:last] = tops(first, last)
    for number, level in enumerate(levels):
        for first, last in _strips(len(level)) if number + 1 < len(levels) else ():
            levels[number + 1][first // 2 : (last + 1) // 2] = _halved(level[first:last], np)
        for first, last in _strips(len(level)):  # in place: a strip's dilation needs only later rows
            level[first:last] = _dilated(level[first:last], level[min(last, len(level) - 1)][None], np)
    return bounds


def _strips(rows: int) -> list[tuple[int, int]]:
    return [(first, min(first + ROWS_AT_ONCE, rows)) for first in range(0, rows, ROWS_AT_ONCE)]


def _dilated(texels: Any, below: Any, xp: types.ModuleType) -> Any:
    """Each texel's maximum with the next ones in row, col and both; `below` is the row after the last."""
    pair = xp.maximum(texels, xp.concatenate([texels[1:], below], axis=0))
    return xp.maximum(pair, xp.concatenate([pair[:, 1:], pair[:, -1:]], axis=1))


def _halved(texels: Any, xp: types.ModuleType) -> Any:
    """The next level: maxima over 2 x 2 texels; a last odd row or column is kept unchanged."""
    height, width = texels.shape
    texels = xp.pad(texels, ((0, height % 2), (0, width % 2)), mode="edge")
    texels = xp.maximum(texels[0::2], texels[1::2])
    return xp.maximum(texels[:, 0::2], texels[:, 1::2])


def _level_shapes(shape: tuple[int, int]) -> list[tuple[int, int]]:
    rows, cols = shape
    shapes = [(rows, cols)]
    while rows > 1 or cols > 1:
        rows, cols = (rows + 1) // 2, (cols + 1) // 2
        shapes.append((rows, cols))
    return shapes
