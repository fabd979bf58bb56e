"""Where lines of sight are surely free, told from the slopes of the ground, so that only the others are searched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.earth import WGS84
from jaxgeo.register.cells import View
from jaxgeo.sensor import Shot
from jaxgeo.terrain import ConstantField, Dem
from jaxgeo.terrain.grid import surface_point

POOL = 4  # cells of the terrain on a side, whose steepest and highest are kept together
MARGIN_CELLS = 2.0
BENT = 2e-3  # rad by which air may bend a line of sight
LEAST_ELEVATION = 1e-3  # rad; lines of sight as flat as that are always searched
WIDER = 1.01  # steps of the grid differ a little over the corridor, and its middle line is not quite straight


@dataclass(frozen=True)
class OpenSight:
    """The steepest and highest ground of a terrain in squares of `POOL` cells.

    Ground rises by no more than its greatest slope over the way; a line of sight that rises faster, above ground that
    is known all along until it is over the ceiling, is free. `steepest` is the tangent of the slope, infinite about
    voids.
    """

    steepest: np.ndarray
    highest: np.ndarray
    ceiling: float
    metres_per_cell: float
    """The least length of a step on the terrain's grid, m."""
    nadir: np.ndarray
    """(row, col) below the camera on that grid."""
    extent: tuple[int, int]
    slack: float

    @classmethod
    def of(cls, view: View) -> OpenSight | None:
        """None for terrains of which nothing can be told so: no `Dem`, or one with a field that varies, or seen from a
        moving camera."""
        terrain = view.terrain
        if not (isinstance(terrain, Dem) and isinstance(view.motion, Shot)):
            return None
        if not isinstance(terrain.field, ConstantField | None):
            return None
        lift = 0.0 if terrain.field is None else float(terrain.field.bounds()[0])
        rows, cols = (int(n) for n in np.asarray(terrain.extent))
        posts = np.asarray(terrain.posts)[:rows, :cols].astype(np.float64)
        least, nadir = _steps_and_nadir(view)
        down, across = np.abs(np.diff(posts, axis=0)), np.abs(np.diff(posts, axis=1))
        down, across = np.maximum(down[:, 1:], down[:, :-1]), np.maximum(across[1:], across[:-1])
        slope = np.hypot(down, across) / float(least)
        if bool(terrain.has_void):
            void = np.asarray(terrain.void)[:rows, :cols]
            slope[void[1:, 1:] | void[:-1, 1:] | void[1:, :-1] | void[:-1, :-1]] = np.inf
        top = np.maximum(np.maximum(posts[1:, 1:], posts[:-1, 1:]), np.maximum(posts[1:, :-1], posts[:-1, :-1]))
        return cls(
            _pooled(slope, 0.0),
            _pooled(top, -np.inf) + lift,
            float(terrain.ceiling),
            float(least),
            np.asarray(nadir),
            (rows, cols),
            0.0 if view.air is None else BENT,
        )

    def searched(self, boxes: np.ndarray) -> np.ndarray:
        """Of squares of cells (6, down, across), as `boxes_of` gives them: which may have hidden ground."""
        may_hide = np.zeros(boxes.shape[1:], bool)
        self._mark(boxes, may_hide)
        return may_hide

    def _mark(self, boxes: np.ndarray, may_hide: np.ndarray) -> None:
        """The same of a block of squares into `may_hide`: all at once if they are free, else quarter by quarter."""
        if not np.isfinite(boxes[0]).any() or self.is_free(Part.of(boxes.min(axis=(1, 2)))):
            return
        rows, cols = may_hide.shape
        if rows == cols == 1:
            may_hide[:] = True
            return
        for down in (np.s_[: (rows + 1) // 2], np.s_[(rows + 1) // 2 :]):
            for across in (np.s_[: (cols + 1) // 2], np.s_[(cols + 1) // 2 :]):
                if may_hide[down, across].size:
                    self._mark(boxes[:, down, across], may_hide[down, across])

    def is_free(self, part: Part) -> bool:
        """Whether the lines of sight to all cells of a part of a tile are surely free."""
        elevation = part.elevation - self.slack
        if not elevation > LEAST_ELEVATION:
            return False
        rise = float(np.tan(min(elevation, 1.57))) / WIDER
        first, last = part.first, part.last
        whole = self._corridor(first, last, (self.ceiling - part.lowest) / rise)
        if whole is None:
            return False
        reach = self.ceiling - part.lowest
        for _ in range(2):  # over lower ground the line of sight is sooner above all of it
            window = self._corridor(first, last, reach / rise)
            assert window is not None
            reach = max(float(self.highest[window].max()) - part.lowest, 0.0)
        window = self._corridor(first, last, reach / rise)
        assert window is not None
        return bool(self.steepest[window].max() < rise)

    def _corridor(self, first: np.ndarray, last: np.ndarray, reach: float) -> tuple[slice, slice] | None:
        """The squares between a part and where its lines of sight are `reach` m nearer to the camera; None where that
        leaves the terrain."""
        way = self.nadir - 0.5 * (first + last)
        length = float(np.hypot(*way))
        step = way / max(length, 1e-9) * min(max(reach, 0.0) * WIDER / self.metres_per_cell, length)
        aside = MARGIN_CELLS + 0.02 * np.abs(step).max() + _spread_of(first, last, length, np.abs(step).max())
        low = np.minimum(first, first + step) - aside
        high = np.maximum(last, last + step) + aside
        if np.any(low < 0.0) or np.any(high > np.array(self.extent) - 1.0):
            return None
        row0, col0 = (int(x) // POOL for x in low)
        row1, col1 = (int(x) // POOL + 1 for x in high)
        return slice(row0, row1), slice(col0, col1)


@dataclass(frozen=True)
class Part:
    """A part of a tile: its box on the terrain's grid (row, col), its lowest ground in m, and the flattest line of
    sight to it, rad."""

    first: np.ndarray
    last: np.ndarray
    lowest: float
    elevation: float

    @classmethod
    def of(cls, box: np.ndarray) -> Part:
        """From the numbers of `boxes_of`."""
        return cls(box[0:2], -box[2:4], float(box[4]), float(np.arcsin(np.clip(box[5], -1.0, 1.0))))


def _spread_of(first: np.ndarray, last: np.ndarray, length: float, step: float) -> float:
    """By how many cells lines of sight from the part's corners leave the box that its middle's sweeps: they all run to
    the nadir."""
    half = 0.5 * float(np.hypot(*(last - first)))
    return half * step / max(length, half, 1e-9)


def _pooled(values: np.ndarray, fill: float) -> np.ndarray:
    rows, cols = (-(-n // POOL) * POOL for n in values.shape)
    padded = np.full((rows, cols), fill)
    padded[: values.shape[0], : values.shape[1]] = values
    return padded.reshape(rows // POOL, POOL, cols // POOL, POOL).max(axis=(1, 3))


@eqx.filter_jit
def _steps_and_nadir(view: View) -> tuple[Any, Any]:
    """(the least length of a step over the terrain's grid in m, (row, col) below the camera)."""
    assert isinstance(view.terrain, Dem)
    assert isinstance(view.motion, Shot)
    terrain = view.terrain
    last = (jnp.asarray(terrain.extent) - 1).astype(jnp.float64)
    places = jnp.array([[r, c] for r in (0.0, 0.5, 1.0) for c in (0.0, 0.5, 1.0)]) * last[None, :]
    steps = jax.vmap(jax.jacfwd(lambda place: surface_point(terrain.grid.normal(place))))(places)
    squared = jnp.einsum("nki,nkj->nij", steps, steps)
    a, b, d = squared[:, 0, 0], squared[:, 0, 1], squared[:, 1, 1]
    least = 0.5 * (a + d) - jnp.sqrt(0.25 * (a - d) ** 2 + b * b)
    up, _ = WGS84.normal_and_height(view.sensor.perspective_centre(view.motion))
    return jnp.sqrt(jnp.min(least)), terrain.grid.rowcol(up)
