"""Rays of all kinds over a terrain: steep, grazing, from beside, from below, from the ground, rising, invalid."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import WGS84, Dem, Ray
from jaxgeo.terrain.grid import surface_point


@jax.jit
def _places(dem: Dem, rowcol: Any, height: Any, on_ground: Any) -> Any:
    """ECEF points over a grid, at heights in m above the ellipsoid or, where asked, on the ground."""

    def place(rowcol: Any, height: Any, on_ground: Any) -> Any:
        normal = dem.grid.normal(rowcol)
        surface = dem.surface(rowcol, dem.cell_of(rowcol))
        return surface_point(normal) + jnp.where(on_ground, surface, height) * normal

    return jax.vmap(place)(rowcol, height, on_ground)


def all_rays(dem: Dem, count: int, seed: int) -> Ray:
    """So many rays, an eighth of each kind, mixed."""
    rng = np.random.default_rng(seed)
    rows, cols = np.asarray(dem.extent)
    lowest, highest = float(dem.lowest), float(dem.highest)
    relief = max(highest - lowest, 100.0)
    kind = rng.permutation(count) % 8
    scale, middle = np.array([rows - 1.0, cols - 1.0]), 0.5 * np.array([rows - 1.0, cols - 1.0])
    begin, end = (middle + scale * rng.uniform(-0.6, 0.6, (count, 2)) for _ in range(2))
    far = middle + 2.0 * scale * rng.standard_normal((count, 2))
    near = end + rng.standard_normal((count, 2))
    begin = np.where((kind == 1)[:, None], far, begin)
    begin = np.where((kind == 2)[:, None], near, begin)
    begin = np.where((kind == 3)[:, None], end, begin)  # plumb lines
    within = np.clip(begin, 0.1, scale - 0.1)
    on_ground = kind == 4
    begin = np.where(on_ground[:, None], within, begin)
    above = highest + relief * rng.exponential(1.0, count)
    inside = lowest + relief * rng.uniform(-0.1, 1.1, count)
    start = np.where((kind == 5) | (kind == 6), inside, above)
    stop = np.where(kind == 6, inside, np.where(rng.uniform(size=count) < 0.1, above + 50.0, lowest))
    origin = np.array(_places(dem, begin, start, on_ground))
    target = np.asarray(_places(dem, end, stop, np.zeros(count, bool)))
    upwards = np.asarray(jax.vmap(lambda p: WGS84.normal_and_height(p)[0])(jnp.asarray(origin)))
    direction = target - origin
    direction = np.where((on_ground & (rng.uniform(size=count) < 0.3))[:, None], upwards, direction)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    invalid = kind == 7
    origin[invalid & (rng.uniform(size=count) < 0.1)] = np.nan
    direction[invalid & (rng.uniform(size=count) < 0.1)] = 0.0
    direction[invalid & (rng.uniform(size=count) < 0.1), 0] = np.inf
    origin[invalid & (rng.uniform(size=count) < 0.1)] *= 1e9
    return Ray(jnp.asarray(origin), jnp.asarray(direction))
