"""A narrow cone of rays that all begin where the first of them may come near the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgeo._numerics import cross, dot
from jaxgeo._typing import Flag, Matrix3, Scalar, ScalarField, Vector3, Vector3Field
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.local_map import LocalMap
from jaxgeo.terrain.search.base import CEILING_MARGIN, reach_of
from jaxgeo.terrain.track import LONGEST_TRACK, TRACK_TOLERANCE, Track

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

PLACES = 1024  # along the cone at which the ground below it is looked at
BENT = 1.1  # how much wider than by its slope at one point a grid's map may be taken to be within the cone
WIDEST = 20  # dyadic level of cells: no terrain has more


class Spread(NamedTuple):
    """How far rays lie from the middle one: their origins in m, their directions in rad; and how far in m a field may
    raise their ground."""

    origin: ScalarField
    direction: ScalarField
    rise: ScalarField


class Beam(eqx.Module):
    """A cone about a ray, clear of all ground up to the range `start` in m; its rays are likely to come down within
    `length` m from there.

    A ray from within `spread.origin` m of the `apex` that turns from the `axis` by no more than `spread.direction` has
    nothing before it up to `start`, has come over the grid from above, and may begin to look there. Any other walks
    as ever.
    """

    apex: Vector3Field
    axis: Vector3Field
    spread: Spread
    start: ScalarField
    length: ScalarField
    map: LocalMap

    @classmethod
    def about(cls, ray: Ray, distance: Scalar, dem: Dem, spread: Spread) -> Beam:
        """The cone about a ray that comes down at a `distance` in m; of no use where not even its start is clear."""
        dem_reach = reach_of(ray, dem)
        # from where all of the cone is above the ceiling, or from its apex
        sinking = jnp.maximum(-_slope_of_height(ray, dem, dem_reach.start), 1e-3)
        margin = (_radius(spread, dem_reach.start) + spread.rise + CEILING_MARGIN) / sinking
        first = jnp.clip(dem_reach.start - 2.0 * margin, 0.0, distance)
        step = (distance - first) / PLACES
        places = first + step * jnp.arange(PLACES)
        clear = jax.vmap(lambda place: _is_clear(ray, dem, spread, place, step))(places)
        ahead = jnp.cumsum(~clear) == 0
        is_covered = (first == 0.0) | (_lowest(ray, dem, spread, first) > dem.ceiling + spread.rise)
        start = jnp.where(is_covered & ahead[0], first + step * (jnp.sum(ahead) - 1), 0.0)
        length = 2.0 * (distance - start + jnp.max(dem.grid.cell_size()))
        radius = _radius(spread, start + length)
        half = jnp.stack([0.5 * length + radius, radius, radius])
        local = LocalMap.about(dem, ray.at(start + 0.5 * length), _frame(ray.direction), half)
        is_of_use = (start > 0.0) & (length < LONGEST_TRACK) & (local.error < TRACK_TOLERANCE)
        return cls(ray.origin, ray.direction, spread, jnp.where(is_of_use, start, 0.0), length, local)

    def holds(self, ray: Ray, dem: Dem) -> Flag:
        """Whether a ray over this terrain, with a field of its own, is of the cone."""
        away = [x - y for x, y in zip(ray.origin, self.apex, strict=True)]
        turn = [x - y for x, y in zip(ray.direction, self.axis, strict=True)]
        inside = (dot(away, away) <= self.spread.origin**2) & (dot(turn, turn) <= self.spread.direction**2)
        rise = dem.rise
        return inside & (self.start > 0.0) & (True if rise is None else rise <= self.spread.rise)

    def track(self, ray: Ray) -> Track:
        """The track of a ray of the cone from the start on."""
        return self.map.track(ray, self.start, self.start + self.length)


def _frame(axis: Vector3) -> Matrix3:
    """Unit vectors along an axis and across it, by row."""
    least = jnp.eye(3)[jnp.argmin(jnp.abs(axis))]
    across = jnp.stack(cross(axis, least))
    across = across / jnp.linalg.norm(across)
    return jnp.stack([axis, across, jnp.stack(cross(axis, across))])


def _radius(spread: Spread, distance: Scalar) -> Scalar:
    """How far in m rays of the cone are from its middle one at a range; chords of the turn are shorter than it."""
    return spread.origin + distance * spread.direction


def _is_clear(ray: Ray, dem: Dem, spread: Spread, place: Scalar, step: Scalar) -> Flag:
    """Whether the cone, from half a step before a range to half a step behind it, lies over the grid, above ground."""
    radius = _radius(spread, place + 0.5 * step) + 0.5 * step
    rowcol, height = dem.over(ray.at(place))
    slopes = jax.jacfwd(lambda p: dem.over(p)[0])(ray.at(place))
    half = BENT * radius * jnp.sqrt(jnp.sum(slopes**2, axis=1))
    low, high = rowcol - half, rowcol + half
    is_inside = jnp.all(low >= 0.0) & jnp.all(high <= (jnp.asarray(dem.extent) - 1).astype(jnp.float64))
    level = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(2.0 * jnp.max(half), 1.0))), 0, WIDEST).astype(jnp.int32)
    row, col = (jnp.right_shift(jnp.floor(x).astype(jnp.int32), level) for x in jnp.where(is_inside, low, 0.0))
    return is_inside & (height - radius > dem.pyramid.bound(level, row, col) + spread.rise)


def _lowest(ray: Ray, dem: Dem, spread: Spread, distance: Scalar) -> Scalar:
    """The lowest height in m of the cone at a range."""
    return dem.over(ray.at(distance))[1] - _radius(spread, distance)


def _slope_of_height(ray: Ray, dem: Dem, distance: Scalar) -> Scalar:
    """How much height the ray gains by m of range."""
    return jax.jvp(lambda s: dem.over(ray.at(s))[1], (distance,), (jnp.ones_like(distance),))[1]
