"""Batched first-hit search: rays advance in rounds, and finished rays drop out.

All rays go through a first pass in large blocks, contiguous in memory. The few unfinished rays (their first interval to
settle held no event, or they need another track) are listed and continue in small gathered and scattered blocks until
the list is empty. With fewer rays left than lanes in a small block, each ray settles many intervals at a time, so that
one ray that grazes a whole plain does not slow down the others.

A ray's hit does not depend on its neighbours, only its timing does; its start may, and with it the last digits of the
hit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Float32, Int, Int32

from jaxgeo._accelerator import by_device
from jaxgeo._numerics import tree_where
from jaxgeo._typing import Flag, Index, Scalar
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.search.beam import Beam
from jaxgeo.terrain.search.ground import Ground
from jaxgeo.terrain.search.march import March, happened, has_entered, march_all
from jaxgeo.terrain.search.reach import Way
from jaxgeo.terrain.search.walk import (
    Stretch,
    advance,
    clear_ahead,
    is_passing,
    must_settle,
    place,
    place_at,
    position_of,
)
from jaxgeo.terrain.search.walker import (
    Store,
    Walker,
    after_track,
    new_track,
    no_tracks,
    nothing_like,
    take_down,
)
from jaxgeo.terrain.track import Quartic, Track

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

LARGE_BLOCK = 4096  # rays of the first pass at a time: their tracks fit a core's cache
SMALL_BLOCK = 2048
LARGE_ACCELERATOR, SMALL_ACCELERATOR = 2**23, 2**18  # on an accelerator: all rays of a part, and most of those left
LEFT, LEFT_ACCELERATOR = 8, 3  # one of so many rays of a block may wait for the next round
MOVES = 4  # between two looks at how many are left
FEW = 256  # rays of a beam at a time that are left after the first pass
BUNDLE = 32  # neighbouring rays that look for a common start
STRIDE = 8  # finest intervals that a march settles before the ray may skip again
NO_SPREAD = (0.0, 0.0, 0.0)
SCATTERED = 1e9  # cells or m: more than any terrain

Rays = Float[Array, " rays"]
Codes = Int32[Array, " rays"]


def walk_all(ray: Ray, way: Way, ground: Ground, beam: Beam | None = None) -> tuple[Walker, Track]:
    """Walk every ray (leading axis) to its first event or its end; the track is that of the event."""
    count = way.start.shape[0]
    if count > SMALL_BLOCK:
        store, waiting, left = _first_pass(ray, way, ground, beam)
    else:
        store = Store.of(*at_start(ray, way, ground, beam))
        walker, _ = store.unpacked()
        waiting, left = listed(jnp.arange(count, dtype=jnp.int32), ~walker.is_over)
    most = by_device(SMALL_BLOCK if beam is None else FEW, SMALL_ACCELERATOR)
    store = _rounds(store, waiting, left, ray, way, ground, most)
    return store.unpacked()


def at_start(ray: Ray, way: Way, ground: Ground, beam: Beam | None) -> tuple[Walker, Track]:
    """Every ray at the start of its reach, needing a track, or at the start of the beam, with one."""
    walker = jax.vmap(Walker.at_start)(way)
    if beam is None or ray.bending is not None:
        return walker, no_tracks(way.start)
    is_of_beam = ground.each(beam.holds, ray)
    rise = ground.each(_rise, way)
    return jax.vmap(Walker.within, (0, 0, 0, 0, 0, None))(walker, ray, way, is_of_beam, rise, beam)


def _rise(way: Way, dem: Dem) -> Scalar:
    return jnp.zeros_like(way.start) if dem.rise is None else jnp.broadcast_to(dem.rise, way.start.shape)


def _first_pass(ray: Ray, way: Way, ground: Ground, beam: Beam | None) -> tuple[Store, Int[Array, " list"], Index]:
    """One pass over all rays in contiguous blocks, the last one padded; and the list of unfinished rays."""
    count = way.start.shape[0]
    blocks, share = -(-count // by_device(LARGE_BLOCK, LARGE_ACCELERATOR)), by_device(LEFT, LEFT_ACCELERATOR)
    size = BUNDLE * -(-count // (BUNDLE * blocks))
    whole = blocks * size
    filled = lambda x: jnp.concatenate([x, jnp.repeat(x[-1:], whole - count, axis=0)])  # noqa: E731
    (ray, way), ground = jax.tree.map(filled, (ray, way)), ground.of_rays(filled)
    way = eqx.tree_at(lambda r: r.exists, way, way.exists & (jnp.arange(whole) < count))

    def block(number, state):
        store, waiting, left = state
        first = number * size
        part = lambda x: jax.lax.dynamic_slice_in_dim(x, first, size)  # noqa: E731
        (here_ray, here_way), here = jax.tree.map(part, (ray, way)), ground.of_rays(part)
        walker, track = at_start(here_ray, here_way, here, beam)
        if beam is None:
            walker, track = _with_new_tracks(walker, track, here_ray, ground.shared, here_way)
            walker = start_together(walker, here.each(_stretch_of, track), ground.shared)
        # rays outside the beam wait for the rounds
        walker = _one_round(walker, track, here, here_way, few=size // share)
        done = Store.of(walker, track)
        store = jax.tree.map(lambda all_, some: jax.lax.dynamic_update_slice(all_, some, (0, first)), store, done)
        index = first + jnp.arange(size, dtype=jnp.int32)
        newcomers, more = listed(index, ~walker.is_over)
        return store, jax.lax.dynamic_update_slice(waiting, newcomers, (left,)), left + more

    zero = nothing_like(way.start[0])
    none = zero.astype(jnp.int32)
    empty = Store(*(jnp.full((rows, whole), value) for rows, value in ((4, zero), (3, none), (15, zero))))
    store, waiting, left = jax.lax.fori_loop(0, blocks, block, (empty, jnp.full(whole + size, none), none))
    return jax.tree.map(lambda x: x[:, :count], store), waiting[:count], left


def _rounds(
    store: Store, waiting: Int[Array, " list"], left: Index, ray: Ray, way: Way, ground: Ground, most: int
) -> Store:
    """Process the list repeatedly, in blocks of `most` rays, until it is empty."""
    count = way.start.shape[0]
    share = by_device(LEFT, LEFT_ACCELERATOR)
    size = min(most, max(64, 1 << (count - 1).bit_length()))
    waiting = jnp.pad(waiting, (0, size))

    def block(number, state):
        store, waiting, following, left, more = state
        index = jax.lax.dynamic_slice_in_dim(waiting, number * size, size)
        index = jnp.where(number * size + jnp.arange(size) < left, index, count)
        walker, track = jax.tree.map(lambda x: _columns(x, index), store).unpacked()
        walker = eqx.tree_at(lambda w: w.is_over, walker, walker.is_over | (index == count))
        pick = lambda x: x.at[index].get(mode="clip")  # noqa: E731
        (here_ray, here_way), here = jax.tree.map(pick, (ray, way)), ground.of_rays(pick)
        walker, track = _with_new_tracks(walker, track, here_ray, ground.shared, here_way)
        walker = _one_round(walker, track, here, here_way, few=jnp.where(left > size, size // share, 0), left=left)
        done = Store.of(walker, track)
        store = jax.tree.map(lambda x, some: x.at[:, index].set(some, mode="drop", unique_indices=True), store, done)
        newcomers, some = listed(index, ~walker.is_over)
        return store, waiting, jax.lax.dynamic_update_slice(following, newcomers, (more,)), left, more + some

    def one_round(state):
        store, waiting, following, left = state
        blocks = (left + size - 1) // size
        store, waiting, following, _, more = jax.lax.fori_loop(
            0, blocks, block, (store, waiting, following, left, nothing_like(left))
        )
        return store, following, waiting, more

    state = (store, waiting, nothing_like(waiting), left)
    return jax.lax.while_loop(lambda state: state[3] > 0, one_round, state)[0]


def _one_round(
    walker: Walker, track: Track, ground: Ground, way: Way, *, few: Index | int, left: Index | None = None
) -> Walker:
    """Skip ahead, march over ground too near to skip (few rays use many lanes each), and close finished tracks."""
    stretch = ground.each(_stretch_of, track)
    walker = skip_ahead(walker, stretch, ground.shared, few)
    found = (
        _march(walker, stretch, ground, few // 2)
        if left is None
        else _march_in_lanes(walker, stretch, ground, few // 2, left)
    )
    return jax.vmap(after_track)(jax.vmap(take_down)(walker, stretch, *found), stretch, way)


def _stretch_of(track: Track, dem: Dem) -> Stretch:
    return Stretch.of(track, dem.rise)


def _march(walker: Walker, stretch: Stretch, ground: Ground, few: Index | int) -> tuple[March, Codes]:
    """March over the next intervals of every ray that cannot skip them: the marches at their end, and the number of
    intervals settled."""
    first = position_of(walker.here)
    marches = ~walker.fresh & ~walker.is_over & must_settle(walker.here)
    last = jnp.minimum(first + jnp.where(marches, STRIDE, 0), stretch.count)
    begin, end = stretch.tau(first), stretch.tau(last)
    march = march_all(stretch.track, ground, begin, end, walker.news, few)
    settled = jnp.where((march.tau >= end) & ~happened(march.news), last - first, 0)
    news = jnp.where((settled > 0) | happened(march.news), march.news, walker.news)
    return March(march.tau, march.exit, news), settled


def _march_in_lanes(
    walker: Walker, stretch: Stretch, ground: Ground, few: Index | int, left: Index
) -> tuple[March, Codes]:
    """As `_march`, with all lanes shared among the rays: each lane takes the intervals after those of the one before.

    The rays come first in the block; ray i gets the lanes from i * each on. Before a ray is over the grid, an event
    depends on earlier intervals, so it gets one lane.
    """
    size = walker.here.shape[0]
    each = jnp.maximum(size // jnp.maximum(left, 1), 1)
    lane = jnp.arange(size, dtype=jnp.int32)
    owner, ahead = lane // each, lane % each
    pick = lambda x: x.at[owner].get(mode="clip")  # noqa: E731
    theirs, mine = jax.tree.map(pick, (stretch, walker))
    first = position_of(mine.here) + STRIDE * ahead
    is_used = (owner < left) & (first < theirs.count) & (has_entered(mine.news) | (ahead == 0))
    there = eqx.tree_at(
        lambda w: (w.here, w.is_over),
        mine,
        (jnp.where(must_settle(mine.here), place(first, jnp.full_like(first, -1)), mine.here), mine.is_over | ~is_used),
    )
    march, settled = _march(there, theirs, ground.of_rays(pick), few)
    met = jax.lax.cummin(jnp.where(happened(march.news) & is_used, lane, size), reverse=True)
    start = lane * each
    nearest = met.at[start].get(mode="clip")
    has_met = (nearest < start + each) & (start < size)
    source = jnp.where(has_met, nearest, start)
    lanes = jnp.where(has_entered(walker.news), each, 1)
    march, first = jax.tree.map(lambda x: x.at[source].get(mode="clip"), (march, settled))
    return march, jnp.where(has_met, 0, jnp.where(lanes > 1, STRIDE * lanes, first))


def _with_new_tracks(walker: Walker, track: Track, ray: Ray, dem: Dem, way: Way, few: int = 0) -> tuple[Walker, Track]:
    """New tracks for the rays of a block that need one, if more than `few` do.

    The condition also prevents recomputing the tracks in every kernel that uses them.
    """

    def made():
        after, fresh = jax.vmap(new_track, (0, 0, None, 0))(walker, ray, dem, way)
        return after, jax.vmap(tree_where)(walker.fresh, fresh, track)

    return jax.lax.cond(jnp.sum(walker.fresh & ~walker.is_over) > few, made, lambda: (walker, track))


def listed(index: Int[Array, " block"], chosen: Bool[Array, " block"]) -> tuple[Int[Array, " block"], Index]:
    """The chosen indices, in order, at the front; and their number."""
    size = index.shape[0]
    count = jnp.cumsum(chosen, dtype=jnp.int32)
    place = jnp.where(chosen, count - 1, size)
    return jnp.zeros_like(index).at[place].set(index, mode="drop", unique_indices=True), count[-1]


def _columns(x: Array, index: Int[Array, " block"]) -> Array:
    return x.at[:, index].get(mode="clip")


def start_together(walker: Walker, stretch: Stretch, dem: Dem) -> Walker:
    """Start bundles of neighbouring rays where they come near the ground.

    The first ray of a bundle walks for all, widened by the bundle's spread. Samples of one line of sight, or pixels of
    one image, so share most of their walk; unrelated neighbours start where they are.
    """
    bundles = lambda x: x.reshape(-1, BUNDLE)  # noqa: E731
    ready = jnp.all(bundles(~walker.fresh & ~walker.is_over & has_entered(walker.news)), axis=1)
    leader = jax.tree.map(lambda x: bundles(x)[:, 0], stretch)

    def spread(quartic: Quartic, leading: Quartic) -> Float32[Array, " bundles"]:
        pairs = zip(jax.tree.leaves(quartic), jax.tree.leaves(leading), strict=True)
        apart = sum(jnp.abs(bundles(each) - first[:, None]) for each, first in pairs)
        return 1.001 * jnp.where(ready, jnp.max(jnp.asarray(apart), axis=1), SCATTERED).astype(jnp.float32)

    quartics = lambda s: (s.track.row, s.track.col, s.headroom)  # noqa: E731
    spreads = tuple(spread(all_, first) for all_, first in zip(quartics(stretch), quartics(leader), strict=True))

    tau = jax.vmap(lambda stretch, spread: clear_ahead(stretch, dem, spread))(leader, spreads)
    clear_to = jnp.broadcast_to(tau[:, None], (tau.shape[0], BUNDLE)).reshape(-1)
    return eqx.tree_at(lambda w: w.here, walker, jax.vmap(place_at, (0, 0, None))(stretch, clear_to, 2))


def skip_ahead(walker: Walker, stretch: Stretch, dem: Dem, few: Index | int) -> Walker:
    """Advance a batch to the next intervals to settle, until at most `few` rays are still skipping."""
    is_walking = ~walker.fresh & ~walker.is_over
    entered = has_entered(walker.news)

    def move(_: Index | int, here: Int[Array, " rays"]) -> Int[Array, " rays"]:
        return jax.vmap(lambda here, stretch, entered: advance(here, stretch, dem, entered, NO_SPREAD))(
            here, stretch, entered
        )

    def many_are_passing(here: Int[Array, " rays"]) -> Flag:
        return jnp.sum(is_walking & is_passing(here, stretch), dtype=jnp.int32) > few

    def some(here: Int[Array, " rays"]) -> Int[Array, " rays"]:
        if by_device(True, False):
            return jax.lax.fori_loop(0, MOVES, move, here)
        for number in range(MOVES):  # fewer kernels, which read the tracks once
            here = move(number, here)
        return here

    moved = jax.lax.while_loop(many_are_passing, some, walker.here)
    return eqx.tree_at(lambda w: w.here, walker, jnp.where(is_walking, moved, walker.here))
