"""What happens to a ray within one cell's length: settled exactly on the bilinear patches it passes over."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._typing import Flag, Scalar, StatusCode
from jaxgeo.status import Status
from jaxgeo.terrain.patch import bilinear

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem
    from jaxgeo.terrain.track import Track


WALL = 1e-6  # m: a surface without voids is continuous to far less


class Event(eqx.Module):
    """What a walk has met so far: whether it has come over the grid (and from the side, below the ceiling), and the
    event that ends it, if any: its status, its cell, and the ranges in m between which the surface is crossed."""

    entered: Flag
    from_side: Flag
    happened: Flag
    status: StatusCode
    cell: Int[Array, "2"]
    lower: Scalar
    upper: Scalar

    @classmethod
    def none(cls, entered: Flag) -> Event:
        """Nothing yet; `entered` if the walk begins over the grid."""
        zero, no = jnp.asarray(0.0), jnp.asarray(False)
        return cls(entered, no, no, Status.hit.code, jnp.zeros(2, jnp.int32), zero, zero)


def first_event(track: Track, dem: Dem, begin: Scalar, end: Scalar, event: Event) -> Event:
    """Go through an interval of `tau` that is at most one cell long on either axis.

    It is cut where it crosses a grid line, and each piece lies in one cell. A track that bends over a line and back
    crosses it twice: hence two crossings on each axis, one before and one after its turning point.
    """
    turns = [_turning(track, begin, end, axis) for axis in (0, 1)]
    crossings = [_crossing(track, begin, turn, axis) for axis, turn in enumerate(turns)]
    crossings += [_crossing(track, turn, end, axis) for axis, turn in enumerate(turns)]
    cuts = jnp.concatenate([begin[None], jnp.sort(jnp.stack(crossings)), end[None]])
    pieces = jax.vmap(lambda a, b: _piece(track, dem, a, b))(cuts[:-1], cuts[1:])

    inside = pieces.counts & pieces.is_inside
    come_in = event.entered | (jnp.cumsum(inside) > 0)
    was_in = jnp.append(event.entered, come_in[:-1])
    enters = inside & ~was_in
    from_side = event.from_side | (jnp.cumsum(enters & (pieces.height < dem.ceiling)) > 0)
    leaves = pieces.counts & was_in & ~pieces.is_inside
    happens = leaves | (inside & pieces.crosses)

    status = jnp.where(from_side, Status.enters_from_side.code, Status.hit.code)
    status = jnp.where(pieces.is_void, Status.hits_void.code, status)
    status = jnp.where(pieces.begins_below & ~enters, Status.hits_void.code, status)  # out of a void, into its wall
    status = jnp.where(enters & pieces.begins_below & ~pieces.is_void, Status.enters_below_terrain.code, status)
    status = jnp.where(leaves, Status.leaves_terrain.code, status)
    which = jnp.argmax(happens)
    return Event(
        entered=come_in[-1],
        from_side=from_side[-1],
        happened=jnp.any(happens),
        status=status[which],
        cell=pieces.cell[which],
        lower=pieces.lower[which],
        upper=pieces.upper[which],
    )


def _turning(track: Track, begin: Scalar, end: Scalar, axis: int) -> Scalar:
    """Where row (axis 0) or column (1) turns within the interval, else one of its ends; it is a parabola there."""
    middle = 0.5 * (begin + end)
    first, half, last = track.at(begin)[axis], track.at(middle)[axis], track.at(end)[axis]
    bend = first + last - 2.0 * half
    turn = middle - 0.25 * (end - begin) * (last - first) / jnp.where(bend == 0.0, 1.0, bend)
    return jnp.where(bend == 0.0, end, jnp.clip(turn, begin, end))


def _crossing(track: Track, begin: Scalar, end: Scalar, axis: int) -> Scalar:
    """Where row (axis 0) or column (1) passes an integer within the interval, else its end. Newton on a near-line."""
    first, last = track.at(begin)[axis], track.at(end)[axis]
    line = jnp.maximum(jnp.floor(first), jnp.floor(last))
    crosses = jnp.floor(first) != jnp.floor(last)
    run = jnp.where(crosses, last - first, 1.0)
    low, high, tau = begin, end, begin + (end - begin) * (line - first) / run
    for _ in range(4):
        off = track.at(tau)[axis] - line
        is_before = (off < 0.0) == (run > 0.0)
        low, high = jnp.where(is_before, tau, low), jnp.where(is_before, high, tau)
        newton = tau - off / jnp.where(crosses, track.slope(tau)[axis], 1.0)
        tau = jnp.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
    return jnp.where(crosses, tau, end)


class _Piece(eqx.Module):
    """A piece of track within one cell: whether it has a length, where it lies, and whether it meets the surface."""

    counts: Flag
    is_inside: Flag
    is_void: Flag
    cell: Int[Array, "2"]
    height: Scalar
    begins_below: Flag
    crosses: Flag
    lower: Scalar
    upper: Scalar


def _piece(track: Track, dem: Dem, begin: Scalar, end: Scalar) -> _Piece:
    """Settle one piece on its patch.

    Over a bilinear patch the clearance is a parabola of range but for terms of the track's curvature within one cell;
    the parabola only says where to look for its lowest, the values are exact.
    """
    middle = track.at(0.5 * (begin + end))
    cell = dem.cell_of(middle[:2])
    posts, is_void = dem.patch(cell)

    def clearance(here: Float[Array, "3"]) -> Scalar:
        return here[2] - bilinear(posts, here[:2] - cell)

    begins = track.at(begin)
    first, half, last = clearance(begins), clearance(middle), clearance(track.at(end))
    bend = 2.0 * (first + last - 2.0 * half)
    at = jnp.clip(-(last - first - bend) / jnp.where(bend > 0.0, 2.0 * bend, 1.0), 0.0, 1.0)
    lowest_at = jnp.where(bend > 0.0, begin + (end - begin) * at, end)
    lowest = clearance(track.at(lowest_at))
    upper = jnp.where(first <= 0.0, begin, jnp.where(lowest <= 0.0, lowest_at, end))
    return _Piece(
        counts=end > begin,
        is_inside=dem.contains(middle[:2]),
        is_void=is_void,
        cell=cell,
        height=begins[2],
        begins_below=first < -WALL,
        crosses=(first <= 0.0) | (lowest <= 0.0) | (last <= 0.0),
        lower=track.range_at(begin),
        upper=track.range_at(upper),
    )
