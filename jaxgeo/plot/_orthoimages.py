"""Orthoimages as greyscale backgrounds, on axes in km of their own map or in m about a fix."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.terrain.grid import AbstractGrid
from jaxgeo.uncertainty import Propagation

MOST_CELLS = 900  # per side of a figure; finer maps are subsampled
CHUNK = 128  # points per batch: one fixed size, compiled once
DRAPED = 240  # samples across a figure about a fix


def over(reference: Orthoimage, rectified: Orthoimage) -> Orthoimage:
    """The rectified image where it is known, surrounded by a paler version of the reference."""
    seen, known = np.asarray(rectified.known), np.asarray(reference.known)
    grey = np.where(seen, stretched(rectified), 0.5 + 0.5 * stretched(reference))
    return Orthoimage(grey[None], seen | known, reference.grid)


def draw_map(reference: Orthoimage, ax: Axes) -> None:
    """Draw the reference in grey on axes in km; large ones are subsampled."""
    step = max(1, math.ceil(max(reference.shape) / MOST_CELLS))
    shown = reference.coarser(step)
    show(np.where(np.asarray(shown.known), stretched(shown), np.nan), shown.grid, ax)


def show(grey: np.ndarray, grid: AbstractGrid, ax: Axes) -> None:
    """Draw grey values between 0 and 1 on axes in km from the lower left corner."""
    tall, wide = (1e-3 * n * side for n, side in zip(grey.shape, np.asarray(cell_size(grid)), strict=True))
    ax.imshow(grey, cmap="gray", vmin=0.0, vmax=1.0, extent=(0.0, wide, 0.0, tall), interpolation="nearest", zorder=0)
    ax.set(xlim=(0.0, wide), ylim=(0.0, tall), aspect="equal", xlabel="across the map, km", ylabel="up the map, km")
    ax.set_facecolor("0.93")


def drape(image: Orthoimage, about: Propagation, reach: float, ax: Axes) -> None:
    """Draw the part of an image within `reach` m of a fix, on axes in m east and north of it."""
    edges = np.linspace(-reach, reach, DRAPED + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    east, north = np.meshgrid(middles, middles)
    rowcol = np.asarray(
        _rowcol_about(image.grid, about.nominal.R_ecef_from_enu, jnp.asarray(about.fix.ecef), east, north)
    )
    row, col = np.rint(rowcol[..., 0]).astype(int), np.rint(rowcol[..., 1]).astype(int)
    rows, cols = image.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    inside &= np.asarray(image.known)[row, col]
    grey = np.where(inside, stretched(image)[row, col], np.nan)
    ax.imshow(grey, cmap="gray", vmin=0, vmax=1, extent=(-reach, reach, -reach, reach), origin="lower", zorder=0)
    ax.set_facecolor("0.93")


def stretched(image: Orthoimage) -> np.ndarray:
    """Grey values from 0 to 1, stretched between their 1st and 99th percentile."""
    grey, known = np.asarray(image.values, np.float64).mean(axis=0), np.asarray(image.known)
    if not known.any():
        return np.zeros(grey.shape)
    low, high = np.quantile(grey[known], [0.01, 0.99])
    return np.clip((grey - low) / max(float(high - low), 1e-12), 0.0, 1.0)


def on_map(reference: Orthoimage, position: Geodetic) -> np.ndarray:
    """Positions (n,) as km right and up from the lower left corner, (n, 2)."""
    lat, lon = (np.asarray(x, np.float64) for x in (position.lat, position.lon))
    count = len(lat)
    padded = [np.resize(x, max(-(-count // CHUNK), 1) * CHUNK) for x in (lat, lon)]
    parts = [_rowcol(reference.grid, *(jnp.asarray(x[k : k + CHUNK]) for x in padded)) for k in range(0, count, CHUNK)]
    rowcol = np.concatenate([np.asarray(part) for part in parts])[:count]
    tall, wide = np.asarray(cell_size(reference.grid))
    return 1e-3 * np.stack([(rowcol[:, 1] + 0.5) * wide, (reference.shape[0] - 0.5 - rowcol[:, 0]) * tall], axis=1)


def turned(grid: AbstractGrid, east_north: np.ndarray) -> np.ndarray:
    """Vectors (n, 2) in m east and north, rotated to m right and up on the map (grid convergence)."""
    per_metre, size = np.asarray(_cells_per_metre(grid)), np.asarray(cell_size(grid))
    cells = east_north @ per_metre.T * size
    return np.stack([cells[:, 1], -cells[:, 0]], axis=1)


@eqx.filter_jit
def cell_size(grid: AbstractGrid) -> jax.Array:
    return grid.cell_size()


@eqx.filter_jit
def _rowcol(grid: AbstractGrid, lat: jax.Array, lon: jax.Array) -> jax.Array:
    return jax.vmap(lambda a, b: grid.rowcol(_normal(a, b)))(lat, lon)


def _normal(lat: jax.Array, lon: jax.Array) -> jax.Array:
    return jnp.stack([jnp.cos(lat) * jnp.cos(lon), jnp.cos(lat) * jnp.sin(lon), jnp.sin(lat)])


@eqx.filter_jit
def _rowcol_about(grid: AbstractGrid, frame: jax.Array, origin: jax.Array, east: Any, north: Any) -> jax.Array:
    def one(e: jax.Array, n: jax.Array) -> jax.Array:
        return grid.rowcol(WGS84.normal_and_height(origin + frame @ jnp.stack([e, n, jnp.zeros_like(e)]))[0])

    return jax.vmap(jax.vmap(one))(jnp.asarray(east), jnp.asarray(north))


@eqx.filter_jit
def _cells_per_metre(grid: AbstractGrid) -> jax.Array:
    """(rows, cols) per metre east and north, at the centre of a grid."""
    normal = grid.normal(jnp.asarray(grid.rowcol0, jnp.float64))
    lat, lon = jnp.arcsin(normal[2]), jnp.arctan2(normal[1], normal[0])

    east, north = WGS84.prime_vertical_radius(lat) * jnp.cos(lat), WGS84.meridian_radius(lat)

    def at(step: jax.Array) -> jax.Array:
        return grid.rowcol(_normal(lat + step[1] / north, lon + step[0] / east))

    return jax.jacfwd(at)(jnp.zeros(2))
