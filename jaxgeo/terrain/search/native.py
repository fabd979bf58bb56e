"""First-hit walk by the native search of the package `jaxgeo_native`, over the same tracks as the walk in JAX.

Straight rays over geographic grids it walks to their ends. For other grids and for refracted rays tracks are made here;
the native search walks each ray along its track to the first event or the track's end, and finds the root.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxgeo._native import TARGETS
from jaxgeo._numerics import tree_where
from jaxgeo._typing import Index, Scalar
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.field import AbstractField, BoundedField, ConstantField, LineField, SumField
from jaxgeo.terrain.grid import GeographicGrid
from jaxgeo.terrain.search.batched import at_start, listed
from jaxgeo.terrain.search.beam import Beam
from jaxgeo.terrain.search.found import Found
from jaxgeo.terrain.search.ground import Ground
from jaxgeo.terrain.search.march import happened
from jaxgeo.terrain.search.reach import Way
from jaxgeo.terrain.search.walker import Walker, new_track, next_section, no_tracks
from jaxgeo.terrain.track import Track

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

BLOCK = 16_384  # rays at a time: enough to share among cores, few enough for their caches
FEW = 1024  # rays that are walked to their ends at once
LEFT = 256  # of those that are left of a block, at a time
POSTS = "float64 float32 int8 uint8 int16 uint16 int32 uint32".split()


def serves(ground: Ground) -> bool:
    """Whether the native search knows this kind of terrain: the dtype of its posts, and its fields."""
    dem = eqx.combine(ground.own, ground.shared)
    return str(dem.posts.dtype) in POSTS and _parts(dem.field) is not None


def walk_all(ray: Ray, way: Way, ground: Ground, beam: Beam | None) -> Found:
    """Walk a block of rays (leading axis) to their first events or ends.

    Where tracks are made here, few rays need more than one, or are not in the beam: they are walked apart, `LEFT` at a
    time.
    """
    count = way.start.shape[0]
    walker, track = at_start(ray, way, ground, beam)
    if ray.bending is None and type(ground.shared.grid) is GeographicGrid:
        return _followed(walker, track, ray, way, ground)
    if count <= FEW:
        return _to_the_end(walker, track, ray, way, ground)
    if beam is None:
        walker, track = _with_new_tracks(walker, track, ray, ground, way)
    walker, found = _one_round(walker, track, way, ground)
    waiting, left = listed(jnp.arange(count, dtype=jnp.int32), ~walker.is_over)
    waiting = jnp.pad(waiting, (0, LEFT))

    def some(number: Index, found: Found) -> Found:
        index = jax.lax.dynamic_slice_in_dim(waiting, number * LEFT, LEFT)
        index = jnp.where(number * LEFT + jnp.arange(LEFT) < left, index, count)
        pick = lambda x: x.at[index].get(mode="clip")  # noqa: E731
        here_walker, here_ray, here_way = jax.tree.map(pick, (walker, ray, way))
        here_walker = eqx.tree_at(lambda w: w.is_over, here_walker, here_walker.is_over | (index == count))
        new = _to_the_end(here_walker, no_tracks(here_way.start), here_ray, here_way, ground.of_rays(pick))
        return jax.tree.map(lambda x, new: x.at[index].set(new, mode="drop", unique_indices=True), found, new)

    return jax.lax.fori_loop(0, (left + LEFT - 1) // LEFT, some, found)


def _followed(walker: Walker, track: Track, ray: Ray, way: Way, ground: Ground) -> Found:
    """Straight rays over a geographic grid, walked to their ends natively."""
    grid = ground.shared.grid
    assert isinstance(grid, GeographicGrid)
    rays = [ray.origin, ray.direction, walker.passed, walker.length, way.end, way.first, way.last]
    map_ = [grid.rowcol0, grid.lonlat0, grid.step, grid.cell_size()]
    args = [jnp.asarray(x, jnp.float64) for x in (*rays, *map_)]
    here = jnp.where(walker.is_over, -2, jnp.where(walker.fresh, -1, walker.here))
    number, integer, flag = (jax.ShapeDtypeStruct(here.shape, dtype) for dtype in (np.float64, np.int32, np.bool_))
    results = [integer, number, number, number, integer, integer, integer, flag]
    news, *ranges, row, col, tracks, is_above = _called("first_hits", results, args, track, here, walker, ground)
    cell = jnp.stack([row, col], axis=1)
    return Found(*ranges, cell=cell, news=news, tracks=tracks, is_above=is_above)


def _to_the_end(walker: Walker, track: Track, ray: Ray, way: Way, ground: Ground) -> Found:
    """Rounds until every ray is over."""

    def one_round(state: tuple[Walker, Track, Found]) -> tuple[Walker, Track, Found]:
        walker, track, found = state
        is_over = walker.is_over
        walker, track = _with_new_tracks(walker, track, ray, ground, way)
        walker, new = _one_round(walker, track, way, ground)
        return walker, track, jax.vmap(tree_where)(is_over, found, new)

    state = (walker, track, jax.vmap(Found.nothing)(walker))
    return jax.lax.while_loop(lambda state: ~jnp.all(state[0].is_over), one_round, state)[2]


def _with_new_tracks(walker: Walker, track: Track, ray: Ray, ground: Ground, way: Way) -> tuple[Walker, Track]:
    after, fresh = jax.vmap(new_track, (0, 0, None, 0))(walker, ray, ground.shared, way)
    return after, jax.vmap(tree_where)(walker.fresh, fresh, track)


def _one_round(walker: Walker, track: Track, way: Way, ground: Ground) -> tuple[Walker, Found]:
    """Every ray with a track walks to its first event, or to the track's end; there it requests the next one."""
    walks = ~walker.fresh & ~walker.is_over
    here = jnp.where(walks, walker.here, -1)
    number, integer = (jax.ShapeDtypeStruct(here.shape, dtype) for dtype in (np.float64, np.int32))
    results = [integer, number, number, number, integer, integer]
    news, *taus, row, col = _called("first_events", results, [], track, here, walker, ground)
    walker = eqx.tree_at(lambda w: (w.news, w.is_over), walker, (news, walker.is_over | happened(news)))
    cell = jnp.stack([row, col], axis=1)
    found = jax.vmap(_found)(walker, track, taus, cell, jnp.broadcast_to(_heights(ground)[0], news.shape))
    onwards = jax.vmap(next_section)(walker, way)
    return jax.vmap(tree_where)(walks & ~happened(news), onwards, walker), found


def _found(walker: Walker, track: Track, taus: list[Scalar], cell: Int[Array, "2"], ceiling: Scalar) -> Found:
    is_above = track.height.at(jnp.asarray(1.0)) >= ceiling
    ranges = (track.range_at(tau) for tau in taus)
    return Found(*ranges, cell=cell, news=walker.news, tracks=walker.tracks, is_above=is_above)


def _called(
    name: str, results: list[Any], first: list[Array], track: Track, here: Array, walker: Walker, ground: Ground
) -> list[Array]:
    """The `results` of a native function: of arrays of its own, then tracks and where they begin, and the terrain."""
    dem, parts = ground.shared, _parts(eqx.combine(ground.own, ground.shared).field)
    assert parts is not None
    constants, lines = parts
    coefficients = jax.tree.leaves((track.row, track.col, track.height))
    flags = jnp.broadcast_to(jnp.asarray(dem.void, bool), dem.posts.shape), jnp.asarray(dem.has_void, bool)
    pyramid = jnp.asarray(dem.pyramid.bounds, jnp.uint16), dem.pyramid.base, dem.pyramid.step
    numbers = [*pyramid[1:], *_heights(ground), *constants]
    numbers += [part for line in lines for part in (line.values, line.first, line.step)]
    places = [jnp.asarray(x, jnp.int32) for x in (here, walker.news)]
    args = [*first, *coefficients, *places, dem.posts, *flags, jnp.asarray(dem.extent, jnp.int32), pyramid[0]]
    args += [jnp.asarray(x, jnp.float64) for x in numbers]  # the search takes the bytes of each array as of its kind
    call = jax.ffi.ffi_call(TARGETS[name], results)
    return list(call(*args, constants=np.int64(len(constants)), lines=np.int64(len(lines))))


def _heights(ground: Ground) -> list[Any]:
    """Ceiling, void ceiling and, with a field, its largest value in m, of each ray or of all."""

    def of(dem: Dem) -> list[Any]:
        return [dem.ceiling, dem.void_top, *([] if dem.rise is None else [dem.rise])]

    return ground.each(of) if jax.tree.leaves(ground.own) else of(ground.shared)


def _parts(field: AbstractField | None) -> tuple[list[Any], list[LineField]] | None:
    """A sum of fields as heights of constant ones and the others; None if the native search does not know one."""
    if field is None:
        return [], []
    if type(field) is BoundedField:
        return _parts(field.field)
    if type(field) is ConstantField:
        return [field.height], []
    if type(field) is LineField:
        return [], [field]
    if type(field) is not SumField:
        return None
    a, b = _parts(field.a), _parts(field.b)
    return None if a is None or b is None else (a[0] + b[0], a[1] + b[1])
