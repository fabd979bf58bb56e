"""Narrow cone of rays with a common start, where the first of them may come near the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import cross, dot
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Matrix3, Pixel, Scalar, ScalarField, Vector3, Vector3Field
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.local_map import Line, LocalMap
from jaxgeo.terrain.search.reach import CEILING_MARGIN, reach_of
from jaxgeo.terrain.search.walk import Stretch, clear_ahead
from jaxgeo.terrain.track import LONGEST_TRACK, TRACK_TOLERANCE, Track

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

PLACES = 512  # sample ranges along the cone at which the ground below is tested
BENT = 1.1  # safety factor on the grid map's slope at one point, over the cone
BINS = 24  # on either axis across the cone
LEAST_DEEPENING = 0.2  # m of height per m: steeper rays gain little from their own rise
WIDEST = 20  # dyadic level of cells: no terrain has more


class Spread(NamedTuple):
    """Spread of rays about the middle one: origins in m, directions in rad; and the largest rise in m of their ground
    by a field."""

    origin: ScalarField
    direction: ScalarField
    rise: ScalarField


class Beam(Record):
    """A cone about a ray, clear of all ground up to the range `start` in m; its rays are likely to hit within the box
    of its `map`.

    A ray from within `spread.origin` m of the `apex` that deviates from the `axis` by at most `spread.direction` is
    clear up to `start`, has entered the grid from above, and may start there. Other rays start as usual.
    """

    apex: Vector3Field
    axis: Vector3Field
    spread: Spread
    start: ScalarField
    map: LocalMap
    ahead: Ahead

    @classmethod
    def about(cls, ray: Ray, distance: Scalar, dem: Dem, spread: Spread) -> Beam:
        """The cone about a ray with a hit at `distance` in m; not usable if even its start is not clear."""
        dem_reach = reach_of(ray, dem)
        # from where the whole cone is above the ceiling, or from its apex
        sinking = jnp.maximum(-_slope_of_height(ray, dem, dem_reach.start), 1e-3)
        margin = (_radius(spread, dem_reach.start) + spread.rise + CEILING_MARGIN) / sinking
        first = jnp.clip(dem_reach.start - 2.0 * margin, 0.0, distance)
        step = (distance - first) / PLACES
        places = first + step * jnp.arange(PLACES)
        clear, height = jax.vmap(lambda place: _is_clear(ray, dem, spread, place, step))(places)
        ahead = jnp.cumsum(~clear) == 0
        is_covered = (first == 0.0) | (height[0] - _radius(spread, first) > dem.ceiling + spread.rise)
        start = jnp.where(is_covered & ahead[0], first + step * (jnp.sum(ahead) - 1), 0.0)
        length = 2.0 * (distance - start + jnp.max(dem.grid.cell_size()))
        # position along the axis that every ray has reached at the range `start`
        least = 1.0 - 0.5 * spread.direction**2
        near = start * least - spread.origin
        radius = _radius(spread, (near + length + spread.origin) / least)
        half = jnp.stack([0.5 * length, radius, radius])
        local = LocalMap.about(dem, ray.at(near + 0.5 * length), _frame(ray), half)
        far = near + 0.5 * length
        is_of_use = (start > 0.0) & (length < LONGEST_TRACK) & (local.error < TRACK_TOLERANCE)
        ahead = Ahead.of(local, spread, far, dem)
        return cls(ray.origin, ray.direction, spread, jnp.where(is_of_use, start, 0.0), local, ahead)

    def holds(self, ray: Ray, dem: Dem) -> Flag:
        """Whether a ray over this terrain, with its own field, is in the cone."""
        away = [x - y for x, y in zip(ray.origin, self.apex, strict=True)]
        turn = [x - y for x, y in zip(ray.direction, self.axis, strict=True)]
        inside = (dot(away, away) <= self.spread.origin**2) & (dot(turn, turn) <= self.spread.direction**2)
        rise = dem.rise
        return inside & (self.start > 0.0) & (True if rise is None else rise <= self.spread.rise)

    def track(self, ray: Ray, rise: Scalar) -> tuple[Track, Scalar]:
        """Track of a ray in the cone whose ground rises by at most `rise` m, and the tau up to which it is clear."""
        line = self.map.line(ray)
        return self.map.track(line), self.ahead.clear_to(line, rise)


class Ahead(Record):
    """How far rays in a box are clear, by their position in its middle (`clear`, in tau).

    A ray over ground raised by a field is equivalent to a ray over unraised ground that is `lowered` times the rise
    deeper (box's third axis, per m); `rise` in m is the largest rise, `reach` the resulting half width of the bins.
    """

    clear: Float[Array, "bins bins"]
    lowered: ScalarField
    rise: ScalarField
    reach: ScalarField

    @classmethod
    def of(cls, local: LocalMap, spread: Spread, far: Scalar, dem: Dem) -> Ahead:
        """Computed by one walk per bin, along its middle ray, for all its rays; the box is `far` m away."""
        widening = local.half[0] / far
        deepening = local.slopes(jnp.ones(3))[0][2, 2]
        deepens = deepening > LEAST_DEEPENING * local.half[2]
        lowered = jnp.where(deepens, 1.0 / jnp.where(deepens, deepening, 1.0), 0.0)
        raised = lowered * spread.rise
        reach = 1.0 + raised
        _, most = local.slopes((1.0 + widening) * jnp.stack([jnp.ones_like(reach), jnp.ones_like(reach), reach]))
        # distance on either axis of other rays in a bin from its middle ray, without the part due to their rise;
        # rays from beside the apex widen differently
        width = jnp.stack([1.0 / BINS, reach / BINS])
        beside = spread.origin / local.half[1:] + spread.origin / jnp.maximum(far - spread.origin, 1e-9)
        apart = width + widening * (width + beside)
        away = apart + jnp.stack([0.0, (1.0 + widening) * raised])
        row, col = (most[k, 1:] @ away for k in (0, 1))
        bend = most[2, 2] - jnp.abs(deepening) + widening * most[2, 2]
        height = most[2, 1:] @ apart + bend * raised + jnp.abs(deepening * lowered - 1.0) * spread.rise
        spreads = tuple((1.001 * x + 1e-3).astype(jnp.float32) for x in (row, col, height))

        def clear_to(second: Scalar, third: Scalar) -> Scalar:
            line = Line(far, local.half[0], (second, widening * second), (third, widening * third))
            return clear_ahead(Stretch.of(local.track(line)), dem, spreads)

        middles = (2.0 * jnp.arange(BINS) + 1.0) / BINS - 1.0
        over = jax.vmap(jax.vmap(clear_to, (None, 0)), (0, None))
        return cls(over(middles, reach * middles), lowered, spread.rise, reach)

    def clear_to(self, line: Line, rise: Scalar) -> Scalar:
        """The tau up to which a ray in the box is clear, whose ground rises by at most `rise` m."""
        deep = (line.third[0] - self.lowered * jnp.maximum(rise, -self.rise)) / self.reach
        second, third = ((0.5 * BINS * (x + 1.0)).astype(jnp.int32) for x in (line.second[0], deep))
        return self.clear.at[jnp.clip(second, 0, BINS - 1), jnp.clip(third, 0, BINS - 1)].get(mode="promise_in_bounds")


def _frame(ray: Ray) -> Matrix3:
    """Unit vectors by row: along a ray, sideways, and upwards across it; arbitrary sides if it points straight down."""
    axis = ray.direction
    up = ray.origin / jnp.linalg.norm(ray.origin)
    side = jnp.stack(cross(axis, up))
    is_level = jnp.linalg.norm(side) > 1e-3
    least = jnp.eye(3)[jnp.argmin(jnp.abs(axis))]
    side = jnp.where(is_level, side, jnp.stack(cross(axis, least)))
    side = side / jnp.linalg.norm(side)
    return jnp.stack([axis, side, jnp.stack(cross(side, axis))])


def _radius(spread: Spread, distance: Scalar) -> Scalar:
    """Radius in m of the cone at a range; an upper bound, since chords are shorter than arcs."""
    return spread.origin + distance * spread.direction


def _is_clear(ray: Ray, dem: Dem, spread: Spread, place: Scalar, step: Scalar) -> tuple[Flag, Scalar]:
    """Whether the cone, half a step before to half a step after a range, is over the grid and above the ground; and the
    height in m of its middle there."""
    radius = _radius(spread, place + 0.5 * step) + 0.5 * step

    def over(point: Vector3) -> tuple[Pixel, tuple[Pixel, Scalar]]:
        rowcol, height = dem.over(point)
        return rowcol, (rowcol, height)

    slopes, (rowcol, height) = jax.jacfwd(over, has_aux=True)(ray.at(place))
    half = BENT * radius * jnp.sqrt(jnp.sum(slopes**2, axis=1))
    low, high = rowcol - half, rowcol + half
    is_inside = jnp.all(low >= 0.0) & jnp.all(high <= (jnp.asarray(dem.extent) - 1).astype(jnp.float64))
    level = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(2.0 * jnp.max(half), 1.0))), 0, WIDEST).astype(jnp.int32)
    row, col = (jnp.right_shift(jnp.floor(x).astype(jnp.int32), level) for x in jnp.where(is_inside, low, 0.0))
    return is_inside & (height - radius > dem.pyramid.bound(level, row, col) + spread.rise), height


def _slope_of_height(ray: Ray, dem: Dem, distance: Scalar) -> Scalar:
    """Height gain of the ray per m of range."""
    return jax.jvp(lambda s: dem.over(ray.at(s))[1], (distance,), (jnp.ones_like(distance),))[1]
