"""What every search for the crossing of a ray and a terrain shares."""

from __future__ import annotations

import math
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
DEEPEST = -11_200.0  # m: no ground on Earth is lower, so that a ray that is has met some, known here or not
AROUND = 0.01  # rad of arc by which the cone about a grid is wider than that of its corners: normals are not radii
WIDER = 1.1  # times as wide, for edges that bulge
WIDEST = 1.5  # rad; a wider cone is taken to hold every ray
TRUSTED = math.pi / 3.0  # rad of arc beyond a grid's corners within which its map means something


class AbstractSearch(Record):
    """A way to find where a ray crosses the surface of a DEM. It gets frozen inputs and returns a frozen bracket."""

    @abstractmethod
    def bracket(self, ray: Ray, dem: Dem) -> Bracket:
        """The crossing of `ray` (ECEF) and `dem` that this search finds, with its cell and status."""


class Reach(Record):
    """The part of a ray in which it can meet the ground.

    From `start` (where it sinks below the ceiling, or its origin) to `end` (where it is below the lowest ground, or has
    risen above the ceiling again), ranges in m. `first` and `last` bound where it can come over the grid while it is
    neither above the ceiling again nor deeper than all ground; `is_near` is false for a ray that never does. `exists`
    is false for one that is never below the ceiling. `from_near` says whether its origin lies close to the grid,
    `sinks` which kind of end it has.
    """

    start: ScalarField
    end: ScalarField
    first: ScalarField
    last: ScalarField
    exists: FlagField
    is_near: FlagField
    from_near: FlagField
    sinks: FlagField


class Way(Record):
    """What a walk along a ray has to know of its reach, ranges in m.

    `start` is where it begins, within `first` and `last`; `exists` is false for a ray that need not be followed.
    """

    start: ScalarField
    end: ScalarField
    first: ScalarField
    last: ScalarField
    exists: FlagField


def way_of(reach: Reach) -> Way:
    """The way of the ray of a reach, or of rays of as many."""
    start = jnp.clip(reach.start, reach.first, reach.last)
    return Way(start, reach.end, reach.first, reach.last, reach.exists & reach.is_near)


def reach_of(ray: Ray, dem: Dem) -> Reach:
    """The part of `ray` that lies between the highest and the lowest ground of `dem`, both taken a margin too far.

    From inflated ellipsoids (a + h, b + h), which lie within 6 mm of the surfaces of constant height: far less than
    the margins. A bent ray lies below the straight one, by the more the farther: the ceiling is raised by as much as at
    the end.
    """
    start, end, exit_, deep, exists, sinks = _reach_between(ray, dem.floor, dem.ceiling)
    first, last = _ranges_about(ray, *dem.grid_reach())
    from_near = (first <= 0.0) & (last >= 0.0)
    first, last = jnp.maximum(first, 0.0), jnp.minimum(last, jnp.minimum(deep, exit_))
    is_near = first < last  # false for NaN
    first, last = jnp.where(is_near, first, 0.0), jnp.where(is_near, last, end)
    return Reach(start, jnp.minimum(end, last), first, last, exists, is_near, from_near, sinks)


def is_mapped(ray: Ray, dem: Dem, distance: Scalar) -> Flag:
    """Whether the grid's map means something under a place on a ray."""
    up, farthest = dem.grid_reach()
    p_ecef, most = ray.at(distance), farthest + TRUSTED
    return (most >= jnp.pi) | (dot(p_ecef, up) > jnp.cos(most) * jnp.sqrt(dot(p_ecef, p_ecef)))


def _ranges_about(ray: Ray, up: Vector3, farthest: Scalar) -> tuple[Scalar, Scalar]:
    """Signed ranges in m between which a straight ray is over a grid or close to it; the first is larger if nowhere.

    There it is within a cone from the Earth's centre about the normal of the grid's middle; `farthest` as in
    `Dem.grid_reach`. It enters and leaves that where the quadratic a s^2 + 2 b s + c is zero.
    """
    arc = WIDER * farthest + AROUND
    squared = jnp.cos(arc) ** 2
    along, start = dot(ray.direction, up), dot(ray.origin, up)
    a = along * along - squared
    b = start * along - squared * dot(ray.origin, ray.direction)
    c = start * start - squared * dot(ray.origin, ray.origin)
    room = b * b - a * c
    far = -b - jnp.where(b < 0.0, -1.0, 1.0) * safe_sqrt(room)
    low, high = jnp.minimum(far / a, c / far), jnp.maximum(far / a, c / far)
    stays, climbs = a > 0.0, along > 0.0  # within the cone, or the one opposite to it, at either end of the line
    is_beside = ~stays & ((room <= 0.0) | (start * a > along * b))  # or opposite amid both ranges, at -b / a
    first = jnp.where(stays, jnp.where(climbs, high, -jnp.inf), jnp.where(is_beside, jnp.inf, low))
    last = jnp.where(stays & climbs, jnp.inf, jnp.where(stays, low, high))
    return jnp.where(arc > WIDEST, -jnp.inf, first), jnp.where(arc > WIDEST, jnp.inf, last)


def reach_between(ray: Ray, floor: Scalar, ceiling: Scalar) -> tuple[Scalar, Scalar, Flag, Flag]:
    """(start, end, exists, sinks) of `reach_of`, for ground between two heights in m."""
    start, end, _, _, exists, sinks = _reach_between(ray, floor, ceiling)
    return start, end, exists, sinks


def _reach_between(ray: Ray, floor: Scalar, ceiling: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar, Flag, Flag]:
    """(start, end, exit, deep, exists, sinks): `exit` is where the ray rises above the ceiling, `deep` where it is
    deeper than all ground, infinite if it never is; the latter within some metres."""
    bottom, to_bottom, sinks = _inflated_chord(ray, floor - FLOOR_MARGIN)
    fall = 0.0
    if ray.bending is not None:
        last = jnp.where(sinks & (bottom >= to_bottom), bottom - to_bottom, jnp.maximum(bottom, 0.0) + BEYOND)
        shift = ray.bending.shift(last)
        fall = jnp.sqrt(dot(shift, shift))
    middle, to_top, meets = _inflated_chord(ray, ceiling + CEILING_MARGIN + fall)
    start, exit_, lowest = jnp.maximum(middle - to_top, 0.0), middle + to_top, bottom - to_bottom
    sinks = sinks & (lowest >= 0.0)
    # squares of ranges from the middle grow by twice the semi-axis for each m of height
    below = to_bottom * to_bottom - (2.0 * WGS84.a) * jnp.maximum(floor - FLOOR_MARGIN - DEEPEST, 0.0)
    to_deep = safe_sqrt(below)
    deep = jnp.where((below > 0.0) & (bottom + to_deep > 0.0), bottom - to_deep, jnp.inf)
    return start, jnp.where(sinks, lowest, exit_), exit_, deep, meets & (exit_ > 0.0), sinks


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


def is_buried(ray: Ray, dem: Dem) -> Flag:
    """Whether the ray begins over the grid and below its known surface, by more than rounding."""
    return above_ground(ray, dem) < -ON_GROUND


def above_ground(ray: Ray, dem: Dem) -> Scalar:
    """How far in m above the known surface a ray begins; infinitely far, where none is known below it."""
    rowcol, height = dem.over(ray.origin)
    cell = dem.cell_of(rowcol)
    _, is_void = dem.patch(cell)
    return jnp.where(dem.contains(rowcol) & ~is_void, height - dem.surface(rowcol, cell), jnp.inf)
