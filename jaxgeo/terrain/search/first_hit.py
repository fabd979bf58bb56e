"""The first point at which a ray meets the terrain: the one that the camera sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import tree_where
from jaxgeo._typing import Flag, Index, Scalar
from jaxgeo.earth.ray import Ray
from jaxgeo.status import Status, status_where
from jaxgeo.terrain.interface import Bracket
from jaxgeo.terrain.search.base import AbstractSearch, Reach, is_buried, reach_of
from jaxgeo.terrain.search.leaf import Event, first_event
from jaxgeo.terrain.track import Track, make_track

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

LONGEST_TRACK = 60_000.0  # m
SHORTEST_TRACK = 10.0  # m; shorter ones are taken as they are
TRACK_TOLERANCE = 2e-7  # m
MOST_TRACKS = 4096
FINEST = 30  # dyadic levels of one track


class FirstHit(AbstractSearch):
    """Walks the ray over a pyramid of upper bounds and settles every cell it cannot pass with the exact bilinear patch.

    Along a track the ray is cut into dyadic intervals no longer than one cell at the finest level. An interval whose
    lowest point clears the bound over all cells it can touch is skipped and the next one tried is twice as long where
    aligned; otherwise it is halved; an interval of the finest level is settled exactly (`leaf.first_event`). So no cell
    is passed unseen, and the crossing found is the first.
    """

    def bracket(self, ray: Ray, dem: Dem) -> Bracket:
        reach = reach_of(ray, dem)
        start = _walk_start(ray, dem, reach)
        walk = jax.lax.while_loop(
            lambda walk: ~walk.is_over,
            lambda walk: _next_track(walk, ray, dem, reach.end),
            start,
        )
        return _as_bracket(walk, ray, dem, reach)


class _Walk(eqx.Module):
    """State of the walk along the ray: the range passed so far, the length to try next, and what was met."""

    passed: Scalar
    length: Scalar
    tracks: Index
    event: Event
    is_over: Flag


def _walk_start(ray: Ray, dem: Dem, reach: Reach) -> _Walk:
    """Begin where the ray sinks below the ceiling if that is over the grid; else at its origin, to see it come in."""
    begins_inside = dem.contains(dem.over(ray.at(reach.start))[0])
    passed = jnp.where(begins_inside, reach.start, 0.0)
    entered = begins_inside | dem.contains(dem.over(ray.origin)[0])
    length = jnp.minimum(reach.end - passed, LONGEST_TRACK)
    possible = reach.exists & reach.is_near
    return _Walk(passed, length, jnp.asarray(0), Event.none(entered), ~possible)


def _next_track(walk: _Walk, ray: Ray, dem: Dem, end: Scalar) -> _Walk:
    """Make a track of the length to try; walk it if it is true to the exact map, else try half the length."""
    track = make_track(ray, dem, walk.passed, walk.passed + walk.length)
    is_true = (track.error < TRACK_TOLERANCE) | (walk.length <= SHORTEST_TRACK)
    event = _walk_track(track, dem, walk.event, ~is_true)
    passed = jnp.where(is_true, walk.passed + walk.length, walk.passed)
    length = jnp.where(is_true, jnp.minimum(2.0 * walk.length, LONGEST_TRACK), 0.5 * walk.length)
    remaining = end - passed
    tracks = walk.tracks + 1
    is_over = event.happened | (remaining <= 1e-9 * end) | (tracks >= MOST_TRACKS)
    return _Walk(passed, jnp.minimum(length, remaining), tracks, event, is_over)


class _Step(eqx.Module):
    """An interval [position, position + 2^level) of the 2^finest along one track; whether it must be settled."""

    position: Index
    level: Index
    must_settle: Flag


class _Stretch(eqx.Module):
    """A track cut into 2^finest intervals of `unit` tau, none longer than a cell; `sag` bounds its bending."""

    track: Track
    finest: Index
    count: Index
    unit: Scalar
    sag: Float[Array, "3"]

    @classmethod
    def of(cls, track: Track) -> _Stretch:
        finest = jnp.ceil(jnp.log2(jnp.maximum(2.0 * track.speed(), 1.0)))
        finest = jnp.clip(finest, 0, FINEST).astype(jnp.int32)
        count = jnp.left_shift(jnp.asarray(1, jnp.int32), finest)
        return cls(track, finest, count, 2.0 / count, track.sag())

    def interval(self, step: _Step) -> tuple[Scalar, Scalar]:
        """The ends of an interval in tau."""
        width = jnp.left_shift(jnp.asarray(1, jnp.int32), step.level)
        return -1.0 + self.unit * step.position, -1.0 + self.unit * (step.position + width)

    def after(self, step: _Step) -> _Step:
        """The interval after this one, twice as long where that is aligned."""
        position = step.position + jnp.left_shift(jnp.asarray(1, jnp.int32), step.level)
        is_aligned = (jnp.right_shift(position, step.level) & 1) == 0
        return _Step(position, step.level + (is_aligned & (step.level < self.finest)), jnp.asarray(False))


def _walk_track(track: Track, dem: Dem, event: Event, skip: Flag) -> Event:
    """Walk one track to its end or to the first event.

    In rounds: all rays of a batch go on to the next interval that they cannot pass, then all settle it together.
    """
    stretch = _Stretch.of(track)

    def is_going_on(state: tuple[_Step, Event]) -> Flag:
        step, event = state
        return (step.position < stretch.count) & ~event.happened & ~skip

    def round_(state: tuple[_Step, Event]) -> tuple[_Step, Event]:
        step, event = state
        step = _next_to_settle(stretch, dem, step, event.entered)
        begin, end = stretch.interval(step)
        event = jax.lax.cond(step.must_settle, lambda: first_event(track, dem, begin, end, event), lambda: event)
        return tree_where(step.must_settle, stretch.after(step), step), event

    first = _Step(jnp.asarray(0, jnp.int32), stretch.finest, jnp.asarray(False))
    return jax.lax.while_loop(is_going_on, round_, (first, event))[1]


def _next_to_settle(stretch: _Stretch, dem: Dem, step: _Step, entered: Flag) -> _Step:
    """The next interval of the finest level that cannot be passed unseen, or the end of the track."""

    def is_passing(step: _Step) -> Flag:
        return (step.position < stretch.count) & ~step.must_settle

    def advance(step: _Step) -> _Step:
        clear = _is_clear(stretch, dem, step, entered)
        finer = _Step(step.position, jnp.maximum(step.level - 1, 0), step.level == 0)
        return tree_where(clear, stretch.after(step), finer)

    return jax.lax.while_loop(is_passing, advance, step)


def _is_clear(stretch: _Stretch, dem: Dem, step: _Step, entered: Flag) -> Flag:
    """Whether the interval surely holds no event: above all ground it can touch, or (before entry) beside the grid."""
    begin, end = stretch.interval(step)
    first, last = stretch.track.at(begin), stretch.track.at(end)
    bend = stretch.sag * (end - begin) ** 2
    low = jnp.minimum(first, last) - bend
    high = jnp.maximum(first, last) + bend
    edge = (jnp.asarray(dem.extent) - 1).astype(jnp.float64)
    is_inside = jnp.all((low[:2] >= 0.0) & (high[:2] <= edge))
    is_beside = jnp.any((high[:2] < -1e-6) | (low[:2] > edge + 1e-6))
    low_texel = jnp.right_shift(jnp.floor(low[:2]).astype(jnp.int32), step.level)
    high_texel = jnp.right_shift(jnp.floor(high[:2]).astype(jnp.int32), step.level)
    fits = jnp.all(high_texel <= low_texel + 1)
    is_above = is_inside & fits & (low[2] > dem.bound(step.level, low_texel))
    return jnp.where(entered, is_above, is_beside)


def _as_bracket(walk: _Walk, ray: Ray, dem: Dem, reach: Reach) -> Bracket:
    """The walk's result with the status of rays that met nothing."""
    event = walk.event
    without = jnp.where(reach.sinks, Status.not_converged.code, Status.rises_away.code)
    without = status_where(~event.entered, Status.ray_misses_terrain, without)
    without = status_where(~reach.exists, Status.rises_away, without)
    without = status_where(~reach.is_near, Status.ray_misses_terrain, without)
    status = jnp.where(event.happened, event.status, without)
    status = status_where(reach.is_near & is_buried(ray, dem), Status.camera_below_terrain, status)
    return Bracket(event.lower, event.upper, event.cell, status)
