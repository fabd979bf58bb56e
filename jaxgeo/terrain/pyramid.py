"""Upper bounds of a bilinear surface over square blocks of cells, for every power of two."""

from __future__ import annotations

import types
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float32, Int

from jaxgeo._typing import Index, Scalar


class Pyramid(eqx.Module):
    """Maxima over 2 x 2 neighbouring texels of 2^level x 2^level cells, all levels in one flat float32 array.

    A box no wider than 2^level cells on either axis touches at most the texel of its lower corner and the next one
    on each axis, so one look-up at that corner bounds the surface over the whole box. Values are rounded up.
    """

    bounds: Float32[Array, " texels"]
    shape: tuple[int, int] = eqx.field(static=True)

    @property
    def top(self) -> int:
        """The highest level: one texel holds every cell."""
        return len(_level_shapes(self.shape)) - 1

    def bound(self, level: Index, corner: Int[Array, "2"]) -> Scalar:
        """Upper bound in m over the texels `corner` and the next ones at `level` (clipped to the pyramid)."""
        shapes = _level_shapes(self.shape)
        widths = np.array([width for _, width in shapes], np.int32)
        offsets = np.cumsum([0] + [rows * width for rows, width in shapes[:-1]]).astype(np.int32)
        heights = np.array([rows for rows, _ in shapes], np.int32)
        level = jnp.clip(level, 0, len(shapes) - 1)
        row = jnp.clip(corner[0], 0, jnp.asarray(heights)[level] - 1)
        col = jnp.clip(corner[1], 0, jnp.asarray(widths)[level] - 1)
        return self.bounds[jnp.asarray(offsets)[level] + row * jnp.asarray(widths)[level] + col].astype(jnp.float64)


def build_pyramid(cell_tops: Any, xp: types.ModuleType) -> Pyramid:
    """Pyramid over the highest surface height of every cell, an array (rows - 1, cols - 1) in NumPy or JAX (`xp`)."""
    texels = xp.nextafter(cell_tops.astype(np.float32), np.float32(np.inf))
    shape = (int(cell_tops.shape[0]), int(cell_tops.shape[1]))
    flat = []
    for rows, cols in _level_shapes(shape):
        assert texels.shape == (rows, cols)
        pair = xp.maximum(texels, xp.concatenate([texels[1:], texels[-1:]], axis=0))
        flat.append(xp.maximum(pair, xp.concatenate([pair[:, 1:], pair[:, -1:]], axis=1)).reshape(-1))
        texels = xp.pad(texels, ((0, rows % 2), (0, cols % 2)), mode="edge")
        texels = xp.maximum(texels[0::2], texels[1::2]) if rows > 1 else texels[:1]
        texels = xp.maximum(texels[:, 0::2], texels[:, 1::2]) if cols > 1 else texels[:, :1]
    return Pyramid(jnp.asarray(xp.concatenate(flat)), shape)


def _level_shapes(shape: tuple[int, int]) -> list[tuple[int, int]]:
    rows, cols = shape
    shapes = [(rows, cols)]
    while rows > 1 or cols > 1:
        rows, cols = (rows + 1) // 2, (cols + 1) // 2
        shapes.append((rows, cols))
    return shapes
