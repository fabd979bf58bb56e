"""A narrow cone of rays that all begin where the first of them may come near the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import cross, dot
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Matrix3, Scalar, ScalarField, Vector3Field
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.local_map import Line, LocalMap
from jaxgeo.terrain.search.base import CEILING_MARGIN, reach_of
from jaxgeo.terrain.search.walk import Stretch, clear_ahead
from jaxgeo.terrain.track import LONGEST_TRACK, TRACK_TOLERANCE, Track

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

PLACES = 1024  # along the cone at which the ground below it is looked at
BENT = 1.1  # how much wider than by its slope at one point a grid's map may be taken to be within the cone
BINS = 32  # on either axis across the cone
LEAST_DEEPENING = 0.2  # m of height by m: a ray that falls more steeply gains little by being told its rise
WIDEST = 20  # dyadic level of cells: no terrain has more


class Spread(NamedTuple):
    """How far rays lie from the middle one: their origins in m, their directions in rad; and how far in m a field may
    raise their ground."""

    origin: ScalarField
    direction: ScalarField
    rise: ScalarField


class Beam(Record):
    """A cone about a ray, clear of all ground up to the range `start` in m; its rays are likely to come down within the
    box of its `map`.

    A ray from within `spread.origin` m of the `apex` that turns from the `axis` by no more than `spread.direction` has
    nothing before it up to `start`, has come over the grid from above, and may begin to look there. Any other walks
    as ever.
    """

    apex: Vector3Field
    axis: Vector3Field
    spread: Spread
    start: ScalarField
    map: LocalMap
    ahead: Ahead

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
        # where along the axis every ray has come to at the latest when its range is the start
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
        """Whether a ray over this terrain, with a field of its own, is of the cone."""
        away = [x - y for x, y in zip(ray.origin, self.apex, strict=True)]
        turn = [x - y for x, y in zip(ray.direction, self.axis, strict=True)]
        inside = (dot(away, away) <= self.spread.origin**2) & (dot(turn, turn) <= self.spread.direction**2)
        rise = dem.rise
        return inside & (self.start > 0.0) & (True if rise is None else rise <= self.spread.rise)

    def track(self, ray: Ray, rise: Scalar) -> tuple[Track, Scalar]:
        """The track of a ray of the cone whose ground is raised by so many m at most, and the tau up to which nothing
        is before it."""
        line = self.map.line(ray)
        return self.map.track(line), self.ahead.clear_to(line, rise)


class Ahead(Record):
    """How far along a box nothing is before rays, by where in its middle they are (`clear`, by tau).

    A ray over ground that is raised is as near to it as one that lies `lowered` times that (box's third axis, per m)
    deeper over ground that is not; `rise` in m bounds it, `reach` is how far such rays lie from the axis.
    """

    clear: Float[Array, "bins bins"]
    lowered: ScalarField
    rise: ScalarField
    reach: ScalarField

    @classmethod
    def of(cls, local: LocalMap, spread: Spread, far: Scalar, dem: Dem) -> Ahead:
        """Found by walking for all rays of a bin at once, along the one in its middle; the box is `far` m away."""
        widening = local.half[0] / far
        deepening = local.slopes(jnp.ones(3))[0][2, 2]
        deepens = deepening > LEAST_DEEPENING * local.half[2]
        lowered = jnp.where(deepens, 1.0 / jnp.where(deepens, deepening, 1.0), 0.0)
        raised = lowered * spread.rise
        reach = 1.0 + raised
        _, most = local.slopes((1.0 + widening) * jnp.stack([jnp.ones_like(reach), jnp.ones_like(reach), reach]))
        # how far from the ray in a bin's middle others of it are, on either axis, but for what goes with their rise;
        # those from beside the apex widen differently
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
        """The tau up to which nothing is before a ray within the box whose ground is raised by so many m at most."""
        deep = (line.third[0] - self.lowered * jnp.maximum(rise, -self.rise)) / self.reach
        second, third = ((0.5 * BINS * (x + 1.0)).astype(jnp.int32) for x in (line.second[0], deep))
        return self.clear.at[jnp.clip(second, 0, BINS - 1), jnp.clip(third, 0, BINS - 1)].get(mode="promise_in_bounds")


def _frame(ray: Ray) -> Matrix3:
    """Unit vectors by row: along a ray, to its side, and upwards across it; some others if it goes straight down."""
    axis = ray.direction
    up = ray.origin / jnp.linalg.norm(ray.origin)
    side = jnp.stack(cross(axis, up))
    is_level = jnp.linalg.norm(side) > 1e-3
    least = jnp.eye(3)[jnp.argmin(jnp.abs(axis))]
    side = jnp.where(is_level, side, jnp.stack(cross(axis, least)))
    side = side / jnp.linalg.norm(side)
    return jnp.stack([axis, side, jnp.stack(cross(side, axis))])


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
