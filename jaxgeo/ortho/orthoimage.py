"""Orthoimage: image bands on a ground grid."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Num

from jaxgeo._compile import one_program
from jaxgeo._record import Record
from jaxgeo.terrain.grid import AbstractGrid


class Orthoimage(Record):
    """Bands of an image on a ground grid: an orthophoto or a rectified image.

    `values` (bands, rows, cols) of any real dtype; `known` (rows, cols) is the mask of valid cells; `grid` maps
    positions to (row, col) with cell centres at integers. Make one with `Orthoimage.of`, `jaxgeo.io.read_orthoimage` or
    `rectify`.
    """

    values: Num[Any, "bands rows cols"]
    known: Bool[Any, "rows cols"]
    grid: AbstractGrid

    @classmethod
    def of(cls, values: Any, grid: AbstractGrid, known: Any = None) -> Orthoimage:
        """From values (rows, cols) or (bands, rows, cols); by default known where all bands are finite.

        Raises `ValueError` for other shapes, and if no cell is known.

        >>> from jaxgeo.ortho import Orthoimage
        >>> from jaxgeo.terrain import TangentGrid
        >>> middle = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
        >>> grid = TangentGrid.centred(middle, spacing=(0.5, 0.5), shape=(4, 6))
        >>> image = Orthoimage.of(np.arange(24.0).reshape(4, 6), grid)
        >>> print(image.shape, round(image.ground_sampling, 3), image.coarser(2).shape)
        (4, 6) 0.5 (2, 3)
        """
        values = np.asarray(values)
        values = values[None] if values.ndim == 2 else values
        if values.ndim != 3 or min(values.shape) < 1:
            raise ValueError(f"values must be (rows, cols) or (bands, rows, cols); got shape {values.shape}.")
        finite = np.all(np.isfinite(values), axis=0)
        known = finite if known is None else np.asarray(known, bool)
        if known.shape != finite.shape:
            raise ValueError(f"known must have the shape {finite.shape} of the values; got {known.shape}.")
        known = known & finite
        if not known.any():
            raise ValueError("no cell of this orthoimage is known; there is nothing to see on it.")
        return cls(values, known, grid)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return np.shape(self.known)

    @property
    def ground_sampling(self) -> float:
        """Side length in m of the central cell: the square root of its area on the ellipsoid."""
        return cell_side(self.grid)

    def grey(self) -> Float[Array, "rows cols"]:
        """The mean of all bands; unknown cells have the mean of the known ones."""
        return _grey(jnp.asarray(self.values, jnp.float64), jnp.asarray(self.known))

    def window(self, row: int, col: int, shape: tuple[int, int]) -> Orthoimage:
        """A window with its first cell at (row, col); cells beyond the edges are unknown and zero."""
        rows, cols = self.shape
        top, left = max(row, 0), max(col, 0)
        bottom, right = min(row + shape[0], rows), min(col + shape[1], cols)
        values = np.zeros((np.shape(self.values)[0], *shape), np.asarray(self.values).dtype)
        known = np.zeros(shape, bool)
        if top < bottom and left < right:
            here = np.s_[top - row : bottom - row, left - col : right - col]
            values[:, *here] = np.asarray(self.values)[:, top:bottom, left:right]
            known[here] = np.asarray(self.known)[top:bottom, left:right]
        return Orthoimage(values, known, self.grid.window(row, col))

    def coarser(self, factor: int) -> Orthoimage:
        """Means over squares of `factor` cells; known where at least half of a square is. Remaining rows and columns
        at the end are dropped."""
        if factor == 1:
            return self
        rows, cols = (n // factor for n in self.shape)
        if min(rows, cols) < 1:
            raise ValueError(f"an orthoimage of {self.shape} cells cannot be made {factor} times as coarse.")
        squares = (rows, factor, cols, factor)
        known = np.asarray(self.known)[: rows * factor, : cols * factor].reshape(squares)
        values = np.asarray(self.values, np.float64)[:, : rows * factor, : cols * factor].reshape(-1, *squares)
        count = known.sum(axis=(1, 3))
        total = np.where(known, values, 0.0).sum(axis=(2, 4))
        means = total / np.maximum(count, 1)
        return Orthoimage(means, 2 * count >= factor * factor, self.grid.coarser(factor))


def cell_side(grid: AbstractGrid) -> float:
    """Side length in m of the central cell of a grid: the square root of its area on the ellipsoid."""
    return float(np.sqrt(np.prod(np.asarray(_cell_size(grid)))))


@eqx.filter_jit
def _cell_size(grid: AbstractGrid) -> Float[Array, "2"]:
    return grid.cell_size()


@one_program
def _grey(values: Float[Array, "bands rows cols"], known: Bool[Array, "rows cols"]) -> Float[Array, "rows cols"]:
    grey = jnp.mean(values, axis=0)
    middle = jnp.sum(jnp.where(known, grey, 0.0)) / jnp.maximum(jnp.sum(known), 1)
    return jnp.where(known, grey, middle)
