"""The first point at which a ray meets the terrain: the one that the camera sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgeo._typing import Flag, Index, Scalar
from jaxgeo.earth.ray import Ray
from jaxgeo.status import Status, status_where
from jaxgeo.terrain.interface import Bracket
from jaxgeo.terrain.search.base import AbstractSearch, Reach, reach_of
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
    """State of the walk along one track: a dyadic interval [position, position + 2^level) of 2^finest."""

    position: Index
    level: Index
    event: Event


def _walk_track(track: Track, dem: Dem, event: Event, skip: Flag) -> Event:
    """Walk one track to its end or to the first event."""
    finest = jnp.ceil(jnp.log2(jnp.maximum(2.0 * track.speed(), 1.0))).astype(jnp.int32)
    finest = jnp.clip(finest, 0, FINEST)
    count = jnp.left_shift(jnp.asarray(1, jnp.int32), finest)
    unit = 2.0 / count
    sag = track.sag()

    def is_going_on(step: _Step) -> Flag:
        return (step.position < count) & ~step.event.happened & ~skip

    def advance(step: _Step) -> _Step:
        width = jnp.left_shift(jnp.asarray(1, jnp.int32), step.level)
        begin = -1.0 + unit * step.position
        end = -1.0 + unit * (step.position + width)
        clear = _is_clear(track, dem, begin, end, sag, step)
        at_leaf = ~clear & (step.level == 0)
        event = jax.lax.cond(
            at_leaf, lambda: first_event(track, dem, begin, end, step.event), lambda: step.event
        )
        passes = clear | at_leaf
        position = jnp.where(passes, step.position + width, step.position)
        is_aligned = (jnp.right_shift(position, step.level) & 1) == 0
        level = jnp.where(passes, step.level + (is_aligned & (step.level < finest)), step.level - 1)
        return _Step(position, level.astype(jnp.int32), event)

    first = _Step(jnp.asarray(0, jnp.int32), finest, event)
    return jax.lax.while_loop(is_going_on, advance, first).event


def _is_clear(track: Track, dem: Dem, begin: Scalar, end: Scalar, sag: jax.Array, step: _Step) -> Flag:
    """Whether the interval certainly holds no event: above all ground it can touch, or (before entry) beside the grid."""
    first, last = track.at(begin), track.at(end)
    bend = sag * (end - begin) ** 2
    low = jnp.minimum(first, last) - bend
    high = jnp.maximum(first, last) + bend
    edge = (jnp.asarray(dem.extent) - 1).astype(jnp.float64)
    is_inside = jnp.all((low[:2] >= 0.0) & (high[:2] <= edge))
    is_beside = jnp.any((high[:2] < -1e-6) | (low[:2] > edge + 1e-6))
    low_texel = jnp.right_shift(jnp.floor(low[:2]).astype(jnp.int32), step.level)
    high_texel = jnp.right_shift(jnp.floor(high[:2]).astype(jnp.int32), step.level)
    fits = jnp.all(high_texel <= low_texel + 1)
    is_above = is_inside & fits & (low[2] > dem.bound(step.level, low_texel))
    return jnp.where(step.event.entered, is_above, is_beside)


def _as_bracket(walk: _Walk, ray: Ray, dem: Dem, reach: Reach) -> Bracket:
    """The walk's result with the status of rays that met nothing."""
    event = walk.event
    without = jnp.where(reach.sinks, Status.not_converged.code, Status.rises_away.code)
    without = status_where(~event.entered, Status.ray_misses_terrain, without)
    without = status_where(~reach.exists, Status.rises_away, without)
    without = status_where(~reach.is_near, Status.ray_misses_terrain, without)
    status = jnp.where(event.happened, event.status, without)
    rowcol, height = dem.over(ray.origin)
    cell = dem.cell_of(rowcol)
    _, is_void = dem.patch(cell)
    is_buried = reach.is_near & dem.contains(rowcol) & ~is_void & (height < dem.surface(rowcol, cell))
    status = status_where(is_buried, Status.camera_below_terrain, status)
    return Bracket(event.lower, event.upper, event.cell, status)
