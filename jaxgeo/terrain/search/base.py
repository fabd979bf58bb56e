"""What every search for the crossing of a ray and a terrain shares."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import jax.numpy as jnp

from jaxgeo._numerics import dot, safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Flag, FlagField, Scalar, ScalarField, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.ray import Ray

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem
    from jaxgeo.terrain.interface import Bracket

CEILING_MARGIN = 1.0  # m above the highest ground, so that a search starts clearly above the surface
ON_GROUND = 1e-6  # m; a ray that begins nearer to the ground begins on it, whatever the sign of the rounding
FLOOR_MARGIN = 1.0  # m below the lowest ground, so that it ends clearly below
BEYOND = 200_000.0  # m behind the lowest point of a bent ray that does not sink to the floor when straight


class AbstractSearch(Record):
    """A way to find where a ray crosses the surface of a DEM. It gets frozen inputs and returns a frozen bracket."""

    @abstractmethod
    def bracket(self, ray: Ray, dem: Dem) -> Bracket:
        """The crossing of `ray` (ECEF) and `dem` that this search finds, with its cell and status."""


class Reach(Record):
    """The part of a ray in which it can meet the ground.

    From `start` (where it sinks below the ceiling, or its origin) to `end` (where it is below the lowest ground, or has
    risen above the ceiling again), ranges in m. `exists` is false for a ray that is never below the ceiling, or so far
    from the grid there that the grid's map means nothing (`is_near` is false; `from_near` says the same of its origin);
    `sinks` tells which kind of end it is.
    """

    start: ScalarField
    end: ScalarField
    exists: FlagField
    is_near: FlagField
    from_near: FlagField
    sinks: FlagField


def reach_of(ray: Ray, dem: Dem) -> Reach:
    """The part of `ray` that lies between the highest and the lowest ground of `dem`, both taken a margin too far.

    From inflated ellipsoids (a + h, b + h), which lie within 6 mm of the surfaces of constant height: far less than
    the margins. A bent ray lies below the straight one, by the more the farther: the ceiling is raised by as much as at
    the end.
    """
    start, end, exists, sinks = reach_between(ray, dem.floor, dem.ceiling)
    centre_up, farthest = dem.grid_reach()
    is_near, from_near = (is_towards(p, centre_up, farthest) for p in (ray.at(start), ray.origin))
    return Reach(start, end, exists, is_near, from_near, sinks)


def reach_between(ray: Ray, floor: Scalar, ceiling: Scalar) -> tuple[Scalar, Scalar, Flag, Flag]:
    """(start, end, exists, sinks) of `reach_of`, for ground between two heights in m."""
    bottom, to_bottom, sinks = _inflated_chord(ray, floor - FLOOR_MARGIN)
    fall = 0.0
    if ray.bending is not None:
        last = jnp.where(sinks & (bottom >= to_bottom), bottom - to_bottom, jnp.maximum(bottom, 0.0) + BEYOND)
        shift = ray.bending.shift(last)
        fall = jnp.sqrt(dot(shift, shift))
    middle, to_top, meets = _inflated_chord(ray, ceiling + CEILING_MARGIN + fall)
    start, exit_, lowest = jnp.maximum(middle - to_top, 0.0), middle + to_top, bottom - to_bottom
    sinks = sinks & (lowest >= 0.0)
    return start, jnp.where(sinks, lowest, exit_), meets & (exit_ > 0.0), sinks


def _inflated_chord(ray: Ray, height: Scalar) -> tuple[Scalar, Scalar, Flag]:
    """Range in m of a line's middle inside the ellipsoid (a + h, b + h), half its length in it, and if it meets it."""
    equatorial, polar = 1.0 / (WGS84.a + height), 1.0 / (WGS84.b + height)
    axes = (equatorial, equatorial, polar)
    origin = [x * axis for x, axis in zip(ray.origin, axes, strict=True)]
    direction = [x * axis for x, axis in zip(ray.direction, axes, strict=True)]
    squared = dot(direction, direction)
    middle = -dot(origin, direction) / squared
    nearest = [o + middle * d for o, d in zip(origin, direction, strict=True)]
    room = (1.0 - dot(nearest, nearest)) / squared
    return middle, safe_sqrt(room), room > 0.0


def is_towards(p_ecef: Vector3, up: Vector3, cosine: Scalar) -> Flag:
    """Whether a point, seen from the Earth's centre, lies within an angle of a direction."""
    along = dot(p_ecef, up)
    return along > cosine * jnp.sqrt(dot(p_ecef, p_ecef))


def is_buried(ray: Ray, dem: Dem) -> Flag:
    """Whether the ray begins over the grid and below its known surface, by more than rounding."""
    return above_ground(ray, dem) < -ON_GROUND


def above_ground(ray: Ray, dem: Dem) -> Scalar:
    """How far in m above the known surface a ray begins; infinitely far, where none is known below it."""
    rowcol, height = dem.over(ray.origin)
    cell = dem.cell_of(rowcol)
    _, is_void = dem.patch(cell)
    return jnp.where(dem.contains(rowcol) & ~is_void, height - dem.surface(rowcol, cell), jnp.inf)
