"""Cell-by-cell march over ground too near to skip; each cell is settled exactly on its patch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int32

from jaxgeo._accelerator import by_device
from jaxgeo._numerics import safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Flags, Index, IndexField, Indices, Numbers, Scalar, ScalarField, StatusCode
from jaxgeo.status import Status, status_where

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem
    from jaxgeo.terrain.patch import Patch
    from jaxgeo.terrain.search.ground import Ground
    from jaxgeo.terrain.track import Quartic, Track

Rays = Float[Array, " rays"]

WALL = 1e-6  # m: a surface without voids is continuous to far less
LEAST_STEP = 2.0**-52  # of tau: changes any value in [-1, 1]
STEPS = 2  # between two checks for the end, on an accelerator
ON_A_LINE = 1e-9  # cells: a line of posts nearer than this counts as crossed
SAME_PLACE = 1e-9  # of the rest of the march: a turning point nearer than this counts as passed


class March(Record):
    """State of a march: position in `tau`, exit of the last settled cell, and the news so far (see `news_of`)."""

    tau: ScalarField
    exit: ScalarField
    news: IndexField

    def is_done(self, end: Numbers) -> Flags:
        """Whether the march has met an event or reached its end."""
        return (self.tau >= end) | happened(self.news)


# News of a march as one int32: bit 0 is set once it is over the grid, bit 1 if it entered below the ceiling, and the
# bits above hold the final status, counted from 1, or 0 before any event.


def news_of(entered: Flags, from_side: Flags) -> Indices:
    """News of a march without an event yet."""
    return entered.astype(jnp.int32) + 2 * from_side.astype(jnp.int32)


def happened(news: Indices) -> Flags:
    """Whether an event has ended the march."""
    return news >= 4


def has_entered(news: Indices) -> Flags:
    """Whether the ray has entered the grid."""
    return (news & 1) == 1


def came_from_side(news: Indices) -> Flags:
    """Whether it entered over the grid's edge below the ceiling."""
    return (news & 2) == 2


def status_of(news: Index) -> StatusCode:
    """The status of the event."""
    return (jnp.right_shift(news, 2) - 1).astype(jnp.int8)


def step(march: March, track: Track, end: Scalar, dem: Dem) -> March:
    """Settle the cell ahead and go on to the next; a march with an event stays before its cell."""
    exit_ = jax.lax.optimization_barrier(cell_exit(march.tau, track, end))
    is_done = march.is_done(end)
    exit_ = jnp.where(is_done, march.exit, exit_)
    news = jnp.where(is_done, march.news, _settle(march, track, dem, exit_))
    return March(jnp.where(happened(news), march.tau, exit_), exit_, news)


def cell_exit(tau: Scalar, track: Track, end: Scalar) -> Scalar:
    """Where the ray crosses the next line of posts, or turns on an axis, or `end`."""
    return jnp.minimum(_exit(track.row, tau, end), _exit(track.col, tau, end))


def cell_between(track: Track, begin: Scalar, end: Scalar) -> tuple[Index, Index]:
    """(row, col) of the cell that contains a section of the track."""
    middle = 0.5 * (begin + end)
    return jnp.floor(track.row.at(middle)).astype(jnp.int32), jnp.floor(track.col.at(middle)).astype(jnp.int32)


def _settle(march: March, track: Track, dem: Dem, exit_: Scalar) -> Index:
    """The news after the cell."""
    row, col = cell_between(track, march.tau, exit_)
    patch, is_void = dem.patch(jnp.stack([row, col]))
    (first, _, last), lowest, _ = lowest_clearance(track, patch, row, col, march.tau, exit_)
    begins_below = first < -WALL
    rows, cols = jnp.asarray(dem.extent)
    within = (row >= 0) & (col >= 0) & (row <= rows - 2) & (col <= cols - 2)
    entered, from_side = has_entered(march.news), came_from_side(march.news)
    inside = (exit_ > march.tau) & within
    enters = inside & ~entered
    leaves = (exit_ > march.tau) & entered & ~within
    from_side |= enters & (track.height.at(march.tau) < dem.ceiling)
    status = jnp.where(from_side, Status.enters_from_side.code, Status.hit.code)
    out_of_void = begins_below & ~enters  # into the wall of the neighbouring cell
    status = status_where(is_void | out_of_void, Status.hits_void, status)
    status = status_where(enters & begins_below & ~is_void, Status.enters_below_terrain, status)
    status = status_where(leaves, Status.leaves_terrain, status)
    ends = leaves | (inside & (jnp.minimum(jnp.minimum(first, last), lowest) <= 0.0))
    return news_of(entered | inside, from_side) + 4 * jnp.where(ends, status.astype(jnp.int32) + 1, 0)


def lowest_clearance(
    track: Track, patch: Patch, row: Index, col: Index, begin: Scalar, end: Scalar
) -> tuple[tuple[Scalar, Scalar, Scalar], Scalar, Scalar]:
    """Clearance in m over a cell's patch at `begin`, halfway and `end`; its minimum between them, and the tau of that.

    Over a bilinear patch the clearance is a parabola of range, except for the track's curvature within one cell; the
    parabola only locates the minimum, the values are exact.
    """
    first, half, last = (clearance(track, patch, row, col, tau) for tau in (begin, 0.5 * (begin + end), end))
    bend = 2.0 * (first + last - 2.0 * half)
    at = jnp.clip((first - last + bend) / jnp.where(bend > 0.0, 2.0 * bend, 1.0), 0.0, 1.0)
    lowest_at = jnp.where(bend > 0.0, begin + (end - begin) * at, end)
    return (first, half, last), clearance(track, patch, row, col, lowest_at), lowest_at


def clearance(track: Track, patch: Patch, row: Index, col: Index, tau: Scalar) -> Scalar:
    """Height in m of the track above the patch of the cell (row, col)."""
    return track.height.at(tau) - patch.at(track.row.at(tau) - row, track.col.at(tau) - col)


def _exit(axis: Quartic, tau: Scalar, end: Scalar) -> Scalar:
    """Where row or column crosses the next line, or first turns back, or `end`.

    Up to the turning point the track is monotonic, so its end value gives the side, without relying on a slope.
    """
    slope, last_slope = axis.slope(tau), axis.slope(end)
    turn = tau + (end - tau) * slope / jnp.where(slope == last_slope, 1.0, slope - last_slope)
    turns = (slope * last_slope < 0.0) & (turn > tau + SAME_PLACE * (end - tau))
    stop = jnp.where(turns, turn, end)
    now, then = axis.at(tau), axis.at(stop)
    above, below = jnp.floor(now + ON_A_LINE) + 1.0, jnp.ceil(now - ON_A_LINE) - 1.0
    line = jnp.where(then > now, above, below)
    crosses = (then > above) | (then < below)
    # estimate by the parabola through both ends with the slope at the first; a Newton step is used if it is better
    length, per_rise = stop - tau, 1.0 / jnp.where(crosses, then - now, 1.0)
    share, start_slope = (line - now) * per_rise, slope * length * per_rise
    root = safe_sqrt(start_slope * start_slope - 4.0 * (start_slope - 1.0) * share)
    crossing = tau + length * jnp.minimum(2.0 * share / jnp.maximum(start_slope + root, share), 1.0)
    beyond = axis.at(crossing) - line
    better = crossing - beyond / jnp.where(crosses, axis.slope(crossing), 1.0)
    is_better = (better > tau) & (better < stop) & (jnp.abs(axis.at(better) - line) < jnp.abs(beyond))
    crossing = jnp.maximum(jnp.where(is_better, better, crossing), tau + LEAST_STEP)
    return jnp.where(crosses, jnp.minimum(crossing, stop), stop)


def march_all(
    track: Track, ground: Ground, begin: Rays, end: Rays, news: Int32[Array, " rays"], few: Index | int
) -> March:
    """March a batch (leading axis) from `begin` to `end`, until at most `few` rays are still marching."""

    def move(march: March) -> March:
        for _ in range(by_device(1, STEPS)):
            march = ground.each(step, march, track, end)
        return march

    def many_are_on_the_way(march: March) -> Flag:
        return jnp.sum(~march.is_done(end), dtype=jnp.int32) > few

    return jax.lax.while_loop(many_are_on_the_way, move, March(begin, begin, news))
