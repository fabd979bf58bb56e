"""Bisection between the highest and the lowest ground."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from jaxgeo._typing import Flag, Scalar
from jaxgeo.earth.ray import Ray
from jaxgeo.status import Status, status_where
from jaxgeo.terrain.interface import AbstractSearch, Bracket
from jaxgeo.terrain.search.reach import is_buried, is_mapped, reach_of

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

SHORTEST = 1e-9  # m, with a relative part for far rays
STEPS = 100


class Bisection(AbstractSearch):
    """Sign-bracketing bisection: keeps one end above the surface and one below, and halves the interval.

    It finds *a* crossing. Over rough ground at a shallow angle that may be on a hidden slope behind the first one;
    `FirstHit` returns the crossing visible to the camera. Rays that never go below the lowest ground (upward or level)
    have no bracket: `not_converged`. A ray whose search ends beside the grid gets `leaves_terrain`.
    """

    def bracket(self, ray: Ray, dem: Dem) -> Bracket:
        reach = reach_of(ray, dem)
        is_near = is_mapped(ray, dem, reach.start)
        possible = reach.exists & is_near & reach.sinks
        lower, upper = _bisect(ray, dem, reach.start, jnp.where(possible, reach.end, reach.start))
        rowcol, _ = dem.over(ray.at(0.5 * (lower + upper)))
        cell = dem.cell_of(rowcol)
        _, is_void = dem.patch(cell)
        status = status_where(is_void, Status.hits_void, Status.hit.code)
        status = status_where(~dem.contains(rowcol), Status.leaves_terrain, status)
        is_open = ~reach.sinks | _is_below(ray, dem, reach.start)
        status = status_where(is_open, Status.not_converged, status)
        status = status_where(~reach.exists, Status.rises_away, status)
        status = status_where(is_buried(ray, dem), Status.camera_below_terrain, status)
        status = status_where(~is_near, Status.ray_misses_terrain, status)
        return Bracket(lower, upper, 0.5 * (lower + upper), cell, status)


def _bisect(ray: Ray, dem: Dem, start: Scalar, end: Scalar) -> tuple[Scalar, Scalar]:
    def unfinished(state: tuple[Scalar, Scalar, jax.Array]) -> Flag:
        lower, upper, count = state
        return (upper - lower > SHORTEST + 4e-16 * upper) & (count < STEPS)

    def halve(state: tuple[Scalar, Scalar, jax.Array]) -> tuple[Scalar, Scalar, jax.Array]:
        lower, upper, count = state
        middle = 0.5 * (lower + upper)
        below = _is_below(ray, dem, middle)
        return jnp.where(below, lower, middle), jnp.where(below, middle, upper), count + 1

    lower, upper, _ = jax.lax.while_loop(unfinished, halve, (start, end, jnp.asarray(0)))
    return lower, upper


def _is_below(ray: Ray, dem: Dem, distance: Scalar) -> Flag:
    """Whether the ray is below the surface there; beside the grid the nearest edge is extended level."""
    rowcol, height = dem.over(ray.at(distance))
    last = (jnp.asarray(dem.extent) - 1).astype(jnp.float64)
    inside = jnp.clip(rowcol, 0.0, last)
    return height < dem.surface(inside, dem.cell_of(inside))
