"""Synthetic scene colours: woods on slopes, meadows in valleys, shading, haze and sky."""

from __future__ import annotations

import jax
import numpy as np

from jaxgeo.demo.scene import sampled
from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.terrain import Dem

LIGHT = np.array([0.80, -0.35, 0.42])  # direction to the sun: east, north, up
MEADOW, MOWN, WOOD, CROWN = (
    np.array(rgb) for rgb in ([0.56, 0.62, 0.33], [0.74, 0.70, 0.46], [0.17, 0.27, 0.14], [0.34, 0.43, 0.20])
)
ZENITH, HORIZON = np.array([0.36, 0.56, 0.83]), np.array([0.83, 0.89, 0.94])
CLEAR = 11_000.0  # m, haze length: contrast falls to 1/e
OCTAVES = (260.0, 120.0, 55.0, 25.0, 11.0, 5.0, 2.3)  # m, wavelengths of the vegetation texture
TABLE = 256  # side length of the periodic random table


def painted(dem: Dem, fix: Fix, focal_px: float) -> np.ndarray:
    """Colours (rows, columns, 3) of an image from the fixes (rows, columns) of its pixels; sky where there is no fix.

    The DEM grid must be aligned with north and east, as geographic grids are.
    """
    ok = np.asarray(fix.ok)
    shape, flat = ok.shape, jax.tree.map(np.ravel, fix.position)
    rowcol = np.asarray(_rowcol(dem, flat)).reshape(*shape, 2)[ok]
    spacing_north, spacing_east = (float(x) for x in np.asarray(dem.grid.cell_size()))
    layers = np.stack(_relief(dem, spacing_north, spacing_east), axis=-1)
    shade, steep = sampled(layers, rowcol).T
    distance = np.asarray(fix.slant_range)[ok]
    east, north = spacing_east * rowcol[:, 1], -spacing_north * rowcol[:, 0]
    ground = _grown(east, north, steep, distance / focal_px) * shade[:, None]
    air = np.exp(-distance / CLEAR)[:, None]
    image = _sky(shape)
    image[ok] = ground * air + HORIZON * (1.0 - air)
    return image


def _sky(shape: tuple[int, ...]) -> np.ndarray:
    up = np.clip(np.linspace(1.0, -1.0, shape[0]), 0.0, 1.0)[:, None, None]
    return np.broadcast_to(HORIZON + (ZENITH - HORIZON) * up, (*shape, 3)).copy()


def _grown(east: np.ndarray, north: np.ndarray, steep: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Vegetation colours (n, 3) at places (m) with slopes (tangents); no detail finer than the pixel footprint (m)."""
    parts = [_chance(east / size, north / size, seed) for seed, size in enumerate(OCTAVES)]
    seen = [np.clip(size / (3.0 * footprint) - 0.5, 0.0, 1.0) for size in OCTAVES]
    patches = 0.5 * parts[0] + 0.3 * parts[1] * seen[1] + 0.15 * parts[2] * seen[2]
    fine = np.sum([part * here for part, here in zip(parts[2:], seen[2:], strict=True)], axis=0)
    wooded = _step((steep - 0.12) / 0.06 + 2.5 * patches)[:, None]
    field = _step(4.0 * _chance(east / 170.0 + 31.0, north / 170.0, 9) + 0.5)[:, None]
    meadow = MEADOW + (MOWN - MEADOW) * field + 0.03 * fine[:, None]
    wood = WOOD + (CROWN - WOOD) * np.clip(0.4 + 0.45 * fine, 0.0, 1.0)[:, None]
    return meadow + (wood - meadow) * wooded


def _step(x: np.ndarray) -> np.ndarray:
    x = np.clip(0.5 + 0.5 * x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def _chance(x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    """Smooth noise between -1 and 1 with correlation length 1."""
    table = np.random.default_rng(seed).uniform(-1.0, 1.0, (TABLE, TABLE))
    col, row = np.floor(x).astype(int), np.floor(y).astype(int)
    s, t = (part * part * (3.0 - 2.0 * part) for part in (x - col, y - row))
    at = lambda i, j: table[(row + j) % TABLE, (col + i) % TABLE]  # noqa: E731
    near, far = at(0, 0) * (1 - s) + at(1, 0) * s, at(0, 1) * (1 - s) + at(1, 1) * s
    return near * (1 - t) + far * t


def _relief(dem: Dem, north: float, east: float) -> tuple[np.ndarray, np.ndarray]:
    """(shading, slope tangent) of DEM posts (rows, cols); `north`, `east` are the post spacings in m."""
    down, across = np.gradient(np.asarray(dem.posts, float), north, east)
    steep = np.hypot(down, across)
    light = LIGHT / np.linalg.norm(LIGHT)
    lit = (light[2] - light[0] * across + light[1] * down) / np.sqrt(1.0 + steep**2)
    return 0.34 + 1.25 * np.clip(lit, 0.0, 1.0), steep


@jax.jit
def _rowcol(dem: Dem, positions: Geodetic) -> jax.Array:
    return jax.vmap(dem.rowcol_at)(positions)
