"""Maps between offsets from a fix, places on a grid, and degrees, for many points on the host."""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import quick_filter_jit
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.fix import Fix
from jaxgeo.terrain import TangentGrid
from jaxgeo.terrain.grid import AbstractGrid, surface_point

BATCH = 4096  # points converted at a time


class Frame(NamedTuple):
    """A grid about a fix: maps of (row, col) (n, 2) to degrees, and to m on the level plane of the fix."""

    grid: AbstractGrid
    R: np.ndarray
    p_ecef: np.ndarray
    height: np.ndarray
    lon_deg: float

    @classmethod
    def of(cls, fix: Fix, grid: AbstractGrid) -> Frame:
        R, height = np.asarray(R_ecef_from_enu(fix.position)), np.asarray(fix.position.height)
        return cls(grid, R, np.asarray(fix.ecef), height, math.degrees(float(np.asarray(fix.position.lon))))

    def places(self, rowcol: np.ndarray) -> np.ndarray:
        """(longitude, latitude, east, north) (n, 4): deg, within 180 deg of the fix; m, at its height above WGS 84."""
        found = _in_parts(_from_grid, rowcol, self.R, self.p_ecef, self.height, self.grid)
        lon = np.degrees(found[:, 0]) - self.lon_deg
        found[:, 0] = self.lon_deg + np.remainder(lon + 180.0, 360.0) - 180.0
        found[:, 1] = np.degrees(found[:, 1])
        return found

    def post_size(self) -> np.ndarray:
        """Length in m of a step in row and one in col, at the fix."""
        at = _in_parts(_to_grid, np.zeros((1, 3)), self.R, self.p_ecef, self.grid)[0, 3:]
        places = self.places(at + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))[:, 2:]
        return np.linalg.norm(places[1:] - places[0], axis=1)


def _in_parts(function: Any, points: np.ndarray, *common: Any) -> np.ndarray:
    """A function of batches, of `BATCH` points at a time: one program serves any number."""
    found = []
    for first in range(0, len(points), BATCH):
        part = points[first : first + BATCH]
        filled = np.concatenate([part, np.repeat(part[-1:], BATCH - len(part), axis=0)])
        found.append(np.asarray(function(filled, *common))[: len(part)])
    return np.concatenate(found)


@quick_filter_jit
@functools.partial(jax.vmap, in_axes=(0, None, None, None))
def _to_grid(offset: Vector3, R: jax.Array, p_ecef: Vector3, grid: AbstractGrid) -> jax.Array:
    """(latitude, longitude, height, row, col) of a point at an offset (east, north, up) in m."""
    normal, height = WGS84.normal_and_height(p_ecef + R @ offset)
    return jnp.concatenate([jnp.stack([*_angles(normal), height]), grid.rowcol(normal)])


@quick_filter_jit
@functools.partial(jax.vmap, in_axes=(0, None, None, None, None))
def _from_grid(rowcol: jax.Array, R: jax.Array, p_ecef: Vector3, height: Scalar, grid: AbstractGrid) -> jax.Array:
    """(longitude, latitude, east, north) of a place at (row, col), at a height."""
    normal = grid.normal(rowcol)
    lat, lon = _angles(normal)
    offset = R.T @ (surface_point(normal) + height * normal - p_ecef)
    return jnp.stack([lon, lat, offset[0], offset[1]])


def rowcol_of(lonlat: np.ndarray, grid: AbstractGrid) -> np.ndarray:
    """(row, col) (n, 2) of longitudes and latitudes (n, 2) in rad."""
    return _in_parts(_rowcol_of, lonlat, grid)


@quick_filter_jit
@functools.partial(jax.vmap, in_axes=(0, None))
def _rowcol_of(lonlat: jax.Array, grid: AbstractGrid) -> jax.Array:
    """(row, col) of a longitude and latitude in rad."""
    lon, lat = lonlat
    return grid.rowcol(jnp.stack([jnp.cos(lat) * jnp.cos(lon), jnp.cos(lat) * jnp.sin(lon), jnp.sin(lat)]))


def _angles(normal: Vector3) -> tuple[Scalar, Scalar]:
    return jnp.arctan2(normal[2], jnp.hypot(normal[0], normal[1])), jnp.arctan2(normal[1], normal[0])


def places_of(fix: Fix, offsets: np.ndarray) -> np.ndarray:
    """(latitude, longitude, height) (n, 3) of offsets from a fix; longitudes in rad within a half turn of it."""
    grid = level_grid(fix)
    return on_grid(fix, offsets, grid)[:, :3]


def on_grid(fix: Fix, offsets: np.ndarray, grid: AbstractGrid) -> np.ndarray:
    """(latitude, longitude, height, row, col) (n, 5)."""
    if not len(offsets):
        return np.zeros((0, 5))
    R = np.asarray(R_ecef_from_enu(fix.position))
    found = _in_parts(_to_grid, offsets, R, np.asarray(fix.ecef), grid)
    lon = float(np.asarray(fix.position.lon))
    found[:, 1] = lon + np.remainder(found[:, 1] - lon + np.pi, 2.0 * np.pi) - np.pi
    return found


def level_grid(fix: Fix) -> TangentGrid:
    """A level grid about a fix, with posts of 1 m, rows to the south."""
    return TangentGrid.centred(fix.position, spacing=(1.0, 1.0), shape=(1, 1))
