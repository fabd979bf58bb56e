"""What every search for the crossing of a ray and a terrain shares."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp

from jaxgeo._typing import Flag, Scalar
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.ray import Ray

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem
    from jaxgeo.terrain.interface import Bracket

CEILING_MARGIN = 1.0  # m above the highest ground, so that a search starts clearly above the surface
FLOOR_MARGIN = 1.0  # m below the lowest ground, so that it ends clearly below


class AbstractSearch(eqx.Module):
    """A way to find where a ray crosses the surface of a DEM. It gets frozen inputs and returns a frozen bracket."""

    @abstractmethod
    def bracket(self, ray: Ray, dem: Dem) -> Bracket:
        """The crossing of `ray` (ECEF) and `dem` that this search finds, with its cell and status."""


class Reach(eqx.Module):
    """The part of a ray in which it can meet the ground.

    From `start` (where it sinks below the ceiling, or its origin) to `end` (where it is below the lowest ground, or has
    risen above the ceiling again), ranges in m. `exists` is false for a ray that is never below the ceiling, or so far
    from the grid that the grid's map means nothing (`is_near` is false); `sinks` tells which kind of end it is.
    """

    start: Scalar
    end: Scalar
    exists: Flag
    is_near: Flag
    sinks: Flag


def reach_of(ray: Ray, dem: Dem) -> Reach:
    """The part of `ray` that lies between the highest and the lowest ground of `dem`."""
    top, bottom = dem.ceiling + CEILING_MARGIN, dem.floor - FLOOR_MARGIN
    ranges, meets = WGS84.crossings(
        ray.origin, ray.direction, jnp.stack([top, top, bottom]), jnp.array([-1.0, 1.0, -1.0])
    )
    entry, exit_, floor = ranges
    sinks = meets[2] & (floor >= 0.0)
    start = jnp.maximum(entry, 0.0)
    end = jnp.where(sinks, floor, exit_)
    origin_up, _ = WGS84.normal_and_height(ray.origin)
    start_up, _ = WGS84.normal_and_height(ray.at(start))
    centre_up, farthest = dem.grid_reach()
    is_near = (jnp.dot(origin_up, centre_up) > farthest) & (jnp.dot(start_up, centre_up) > farthest)
    return Reach(start, end, meets[0] & (exit_ > 0.0), is_near, sinks)


def is_buried(ray: Ray, dem: Dem) -> Flag:
    """Whether the ray begins over the grid and below its known surface."""
    rowcol, height = dem.over(ray.origin)
    cell = dem.cell_of(rowcol)
    _, is_void = dem.patch(cell)
    return dem.contains(rowcol) & ~is_void & (height < dem.surface(rowcol, cell))
