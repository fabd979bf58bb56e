"""The part of a ray in which it can meet the terrain, and whether it starts below it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import jax.numpy as jnp

from jaxgeo._numerics import dot, safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Flag, FlagField, Scalar, ScalarField, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.ray import Ray

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

CEILING_MARGIN = 1.0  # m above the highest ground, so that a search starts clearly above the surface
ON_GROUND = 1e-6  # m; a ray that starts closer to the ground starts on it, whatever the sign of the rounding
FLOOR_MARGIN = 1.0  # m below the lowest ground, so that a search ends clearly below
BEYOND = 200_000.0  # m beyond the lowest point of a bent ray that does not reach the floor when straight
DEEPEST = -11_200.0  # m: below all ground on Earth, so a ray below it has crossed ground, known or not
AROUND = 0.01  # rad of arc added to the cone about a grid's corners, because normals are not radii
WIDER = 1.1  # factor on the cone, because grid edges bulge
WIDEST = 1.5  # rad; a wider cone is assumed to hold every ray
TRUSTED = math.pi / 3.0  # rad of arc beyond a grid's corners within which its map is valid


class Reach(Record):
    """The part of a ray in which it can meet the ground.

    From `start` (where it sinks below the ceiling, or its origin) to `end` (where it is below the lowest ground, or has
    risen above the ceiling again), ranges in m. `first` and `last` bound the part over the grid that is neither above
    the ceiling again nor below all ground on Earth; `is_near` is false without such a part. `exists` is false for a ray
    that is never below the ceiling. `from_near` states whether the origin is close to the grid, `sinks` whether the ray
    ends below the ground.
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
    """The section of a reach that a walk covers, ranges in m.

    `start` is the first range of the walk, within `first` and `last`; `exists` is false for a ray without a walk.
    """

    start: ScalarField
    end: ScalarField
    first: ScalarField
    last: ScalarField
    exists: FlagField


def way_of(reach: Reach) -> Way:
    """The section to walk, of the reach of one ray or a batch."""
    start = jnp.clip(reach.start, reach.first, reach.last)
    return Way(start, reach.end, reach.first, reach.last, reach.exists & reach.is_near)


def reach_of(ray: Ray, dem: Dem) -> Reach:
    """The part of `ray` between the highest and the lowest ground of `dem`, with a margin at both.

    Computed on inflated ellipsoids (a + h, b + h), which deviate by up to 6 mm from surfaces of constant height: far
    less than the margins. A bent ray sinks below the straight one, more with distance: the ceiling is raised by the
    amount at the end.
    """
    start, end, exit_, deep, exists, sinks = _reach_between(ray, dem.floor, dem.ceiling)
    first, last = _ranges_about(ray, *dem.grid_reach())
    from_near = (first <= 0.0) & (last >= 0.0)
    first, last = jnp.maximum(first, 0.0), jnp.minimum(last, jnp.minimum(deep, exit_))
    is_near = first < last  # false for NaN
    first, last = jnp.where(is_near, first, 0.0), jnp.where(is_near, last, end)
    return Reach(start, jnp.minimum(end, last), first, last, exists, is_near, from_near, sinks)


def is_mapped(ray: Ray, dem: Dem, distance: Scalar) -> Flag:
    """Whether the grid's map is valid below a point of a ray."""
    up, farthest = dem.grid_reach()
    p_ecef, most = ray.at(distance), farthest + TRUSTED
    return (most >= jnp.pi) | (dot(p_ecef, up) > jnp.cos(most) * jnp.sqrt(dot(p_ecef, p_ecef)))


def _ranges_about(ray: Ray, up: Vector3, farthest: Scalar) -> tuple[Scalar, Scalar]:
    """Signed ranges in m between which a straight ray is over the grid or close to it; first > last if nowhere.

    The test region is a cone from the Earth's centre about the normal of the grid's centre; `farthest` as in
    `Dem.grid_reach`. The ray enters and leaves it at the roots of a s^2 + 2 b s + c.
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
    stays, climbs = a > 0.0, along > 0.0  # in the cone, or its opposite, at either end of the line
    is_beside = ~stays & ((room <= 0.0) | (start * a > along * b))  # or opposite between both ranges, at -b / a
    first = jnp.where(stays, jnp.where(climbs, high, -jnp.inf), jnp.where(is_beside, jnp.inf, low))
    last = jnp.where(stays & climbs, jnp.inf, jnp.where(stays, low, high))
    return jnp.where(arc > WIDEST, -jnp.inf, first), jnp.where(arc > WIDEST, jnp.inf, last)


def reach_between(ray: Ray, floor: Scalar, ceiling: Scalar) -> tuple[Scalar, Scalar, Flag, Flag]:
    """(start, end, exists, sinks) of `reach_of`, for ground between two heights in m."""
    start, end, _, _, exists, sinks = _reach_between(ray, floor, ceiling)
    return start, end, exists, sinks


def _reach_between(ray: Ray, floor: Scalar, ceiling: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar, Flag, Flag]:
    """(start, end, exit, deep, exists, sinks): `exit` is where the ray rises above the ceiling, `deep` where it is
    below all ground on Earth, infinite if never; the latter within some metres."""
    bottom, to_bottom, sinks = _inflated_chord(ray, floor - FLOOR_MARGIN)
    fall = 0.0
    if ray.bending is not None:
        last = jnp.where(sinks & (bottom >= to_bottom), bottom - to_bottom, jnp.maximum(bottom, 0.0) + BEYOND)
        shift = ray.bending.shift(last)
        fall = jnp.sqrt(dot(shift, shift))
    middle, to_top, meets = _inflated_chord(ray, ceiling + CEILING_MARGIN + fall)
    start, exit_, lowest = jnp.maximum(middle - to_top, 0.0), middle + to_top, bottom - to_bottom
    sinks = sinks & (lowest >= 0.0)
    # squared ranges from the middle grow by twice the semi-axis per m of height
    below = to_bottom * to_bottom - (2.0 * WGS84.a) * jnp.maximum(floor - FLOOR_MARGIN - DEEPEST, 0.0)
    to_deep = safe_sqrt(below)
    deep = jnp.where((below > 0.0) & (bottom + to_deep > 0.0), bottom - to_deep, jnp.inf)
    return start, jnp.where(sinks, lowest, exit_), exit_, deep, meets & (exit_ > 0.0), sinks


def _inflated_chord(ray: Ray, height: Scalar) -> tuple[Scalar, Scalar, Flag]:
    """Range in m of the middle of a line's chord in the ellipsoid (a + h, b + h), half its length, and if it exists."""
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
    """Whether the ray starts over the grid and below its known surface, by more than rounding."""
    return above_ground(ray, dem) < -ON_GROUND


def above_ground(ray: Ray, dem: Dem) -> Scalar:
    """Height in m of a ray's origin above the known surface; infinite without known surface below."""
    rowcol, height = dem.over(ray.origin)
    cell = dem.cell_of(rowcol)
    _, is_void = dem.patch(cell)
    return jnp.where(dem.contains(rowcol) & ~is_void, height - dem.surface(rowcol, cell), jnp.inf)
