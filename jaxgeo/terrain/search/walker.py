"""State of one ray's walk over the terrain, and packing of a batch's states for gather and scatter."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int32

from jaxgeo._numerics import tree_where
from jaxgeo._record import Record
from jaxgeo._typing import Flag, FlagField, Index, IndexField, Scalar, ScalarField
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.search.beam import Beam
from jaxgeo.terrain.search.march import March, happened, news_of
from jaxgeo.terrain.search.reach import Way
from jaxgeo.terrain.search.walk import FINEST, Stretch, first_place, must_settle, place, place_at, position_of
from jaxgeo.terrain.track import LONGEST_TRACK, TRACK_TOLERANCE, Quartic, Track, make_track

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

SHORTEST_TRACK = 10.0  # m; shorter tracks are accepted, unless their error exceeds their length
LEAP = 1e-7  # m; a section this short with a jump of the map, as at the seam of longitudes, is passed over
AT_END = 1e-9  # of a range: the rest is rounding
MOST_TRACKS = 4096


class Walker(Record):
    """State of one ray: the track it walks from range `passed` on, its place there, and its news.

    `fresh` requests a new track; `begun` is false until the first valid one; `is_over` marks the end of the walk, by an
    event in the `news` (see `march.news_of`) between `tau` and `exit`, or without one.
    """

    passed: ScalarField
    length: ScalarField
    tau: ScalarField
    exit: ScalarField
    tracks: IndexField
    here: IndexField
    news: IndexField
    fresh: FlagField
    begun: FlagField
    is_over: FlagField

    @classmethod
    def at_start(cls, way: Way) -> Walker:
        """A ray at the start of its way, or already over if it has none."""
        no, zero = jnp.zeros_like(way.exists), jnp.zeros_like(way.start, dtype=jnp.int32)
        length = jnp.minimum(next_stop(way.start, way) - way.start, LONGEST_TRACK)
        begin = -jnp.ones_like(length)
        return cls(way.start, length, begin, begin, zero, zero, zero, ~no, no, ~way.exists)

    def within(self, ray: Ray, way: Way, is_of_beam: Flag, rise: Scalar, beam: Beam) -> tuple[Walker, Track]:
        """This ray, or, if it is in the beam whose start is farther on its way, one that starts there; its track."""
        begins = is_of_beam & way.exists & (beam.start > way.start)
        track, clear_to = beam.track(ray, rise)
        there = Walker(
            passed=track.middle - track.half,
            length=2.0 * track.half,
            tau=self.tau,
            exit=self.exit,
            tracks=self.tracks,
            here=place_at(Stretch.of(track), clear_to, -1),
            news=news_of(begins, ~begins),
            fresh=~begins,
            begun=begins,
            is_over=self.is_over,
        )
        return tree_where(begins, there, self), track


def next_stop(passed: Scalar, way: Way) -> Scalar:
    """The range in m at which tracks end: where a ray that entered from above must have met the ground, and after that
    the last range at which any can be over the grid."""
    return jnp.where(passed < (1.0 - AT_END) * way.end, way.end, way.last)


def new_track(walker: Walker, ray: Ray, dem: Dem, way: Way) -> tuple[Walker, Track]:
    """Give a ray that requests it the next track, if accurate, and start to walk it.

    The first track starts where the ray sinks below the ceiling. If that is not over the grid, the walk starts where
    the ray comes near the grid, to detect its entry. An inaccurate track is tried again with half the length, down to a
    `LEAP`, over which longitude jumps by a full turn: the ray behind it is on the other side of the grid.
    """
    track = make_track(ray, dem, walker.passed, walker.passed + walker.length)
    is_true = (track.error < TRACK_TOLERANCE) & (2.0 * track.speed() < 2.0**FINEST)
    is_true |= (walker.length <= SHORTEST_TRACK) & (track.error < walker.length)
    leaps = ~is_true & (walker.length <= LEAP)
    is_inside = dem.contains(jnp.stack([track.row.at(jnp.asarray(-1.0)), track.col.at(jnp.asarray(-1.0))]))
    from_first = ~walker.begun & ~is_inside & (walker.passed > way.first)
    good = is_true & ~from_first
    passed = jnp.where(leaps, walker.passed + LEAP, jnp.where(is_true & from_first, way.first, walker.passed))
    onwards = jnp.minimum(next_stop(passed, way) - passed, LONGEST_TRACK)
    length = jnp.where(is_true | leaps, onwards, 0.5 * walker.length)
    after = Walker(
        passed=passed,
        length=jnp.where(good, walker.length, length),
        tau=walker.tau,
        exit=walker.exit,
        tracks=walker.tracks + 1,
        here=jnp.where(good, first_place(Stretch.of(track)), walker.here),
        news=walker.news | (good & ~walker.begun & is_inside),
        fresh=~good,
        begun=walker.begun | good,
        is_over=walker.tracks >= MOST_TRACKS,
    )
    return tree_where(walker.fresh & ~walker.is_over, after, walker), track


def after_track(walker: Walker, stretch: Stretch, way: Way) -> Walker:
    """At the end of its track a ray without an event requests the next one, or is at its end."""
    at_end = ~walker.fresh & ~walker.is_over & (position_of(walker.here) >= stretch.count)
    return tree_where(at_end, next_section(walker, way), walker)


def next_section(walker: Walker, way: Way) -> Walker:
    """A ray at the end of its track: it requests the next one, or is at its end."""
    passed = walker.passed + walker.length
    remaining = next_stop(passed, way) - passed
    return eqx.tree_at(
        lambda w: (w.passed, w.length, w.fresh, w.is_over),
        walker,
        (
            passed,
            jnp.minimum(jnp.minimum(2.0 * walker.length, LONGEST_TRACK), remaining),
            jnp.ones_like(walker.fresh),
            remaining <= AT_END * way.last,
        ),
    )


def take_down(walker: Walker, stretch: Stretch, march: March, settled: Index) -> Walker:
    """Record the event of a march, or that it `settled` this many intervals without one (0 if it is not finished)."""
    beyond = jnp.minimum(position_of(walker.here) + settled, stretch.count)
    onwards = jnp.where(settled > 0, place(beyond, (beyond & 1) ^ 1), walker.here)  # the ground is near: a short step
    found = onwards, march.tau, march.exit, march.news, happened(march.news)
    after = eqx.tree_at(lambda w: (w.here, w.tau, w.exit, w.news, w.is_over), walker, found)
    return tree_where(~walker.fresh & ~walker.is_over & must_settle(walker.here), after, walker)


# Gathered and scattered data are three arrays with one column per ray.


class Store(Record):
    """Walkers and their tracks, one column per ray."""

    numbers: Float[Array, "4 rays"]
    codes: Int32[Array, "3 rays"]
    polynomials: Float[Array, "15 rays"]

    @classmethod
    def of(cls, walker: Walker, track: Track) -> Store:
        """Pack a block."""
        flags = walker.fresh + 2 * walker.begun + 4 * walker.is_over
        codes = [walker.tracks, walker.here, walker.news * 8 + flags]
        polynomials = jax.tree.leaves((track.row, track.col, track.height))
        return cls(
            *(jnp.stack(rows) for rows in ([walker.passed, walker.length, walker.tau, walker.exit], codes, polynomials))
        )

    def unpacked(self) -> tuple[Walker, Track]:
        """The walkers and tracks of a block."""
        passed, length, tau, exit_ = self.numbers
        tracks, here, packed = self.codes
        fresh, begun, is_over = ((packed & bit) > 0 for bit in (1, 2, 4))
        walker = Walker(passed, length, tau, exit_, tracks, here, jnp.right_shift(packed, 3), fresh, begun, is_over)
        row, col, height = (Quartic(*self.polynomials[k : k + 5]) for k in (0, 5, 10))
        end = passed + length
        middle, half = 0.5 * (passed + end), 0.5 * (end - passed)
        return walker, Track(row, col, height, middle, half, jnp.zeros_like(passed))


def nothing_like(x: Array) -> Array:
    """Zeros distributed over devices as `x` is; `zeros_like` would replicate them."""
    return x - x


def no_tracks(like: Float[Array, " rays"]) -> Track:
    """Placeholder tracks, one per ray."""
    nowhere = nothing_like(like)
    flat = Quartic(*[nowhere] * 5)
    return Track(flat, flat, flat, nowhere, nowhere, nowhere)
