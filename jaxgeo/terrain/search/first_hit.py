"""First-hit search: the first intersection of a ray with the terrain, the one visible to the camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Int

from jaxgeo._accelerator import by_device
from jaxgeo._native import is_native, native_or_not
from jaxgeo._numerics import newton_or_half, safe_sqrt
from jaxgeo._typing import Flags, Scalar
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.ray import Ray
from jaxgeo.status import Status, status_where
from jaxgeo.terrain.interface import AbstractSearch, Bracket
from jaxgeo.terrain.search.batched import Walker, walk_all
from jaxgeo.terrain.search.beam import Beam
from jaxgeo.terrain.search.found import Found
from jaxgeo.terrain.search.ground import Ground, fits_together
from jaxgeo.terrain.search.march import (
    cell_between,
    clearance,
    happened,
    has_entered,
    lowest_clearance,
    status_of,
)
from jaxgeo.terrain.search.native import BLOCK, serves
from jaxgeo.terrain.search.native import walk_all as walk_natively
from jaxgeo.terrain.search.reach import ON_GROUND, Reach, Way, above_ground, reach_of, way_of
from jaxgeo.terrain.search.walker import MOST_TRACKS, nothing_like
from jaxgeo.terrain.track import Track

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

AT_ONCE, AT_ONCE_ACCELERATOR = 131_072, 2**23  # rays; bounds the memory of the search
LIFT = 2.0 * ON_GROUND  # m; far less than the room for the polish, which removes it again
ROOM = 2e-3  # m on either side of the crossing of track and surface, for the polish on the exact map
ROOT_STEPS = 3  # and one more on the exact map
SLACK = 1e-7  # of the track section: far more than rounding moves a root, far less than the polish allows
TINY = 1e-300


class FirstHit(AbstractSearch):
    """Skips intervals above a pyramid of upper bounds and settles the others exactly on the bilinear patches.

    Along a track the ray is cut into dyadic intervals no longer than one cell at the finest level. An interval whose
    lowest point clears the bound over all cells it can touch is skipped and the next one tried is twice as long where
    aligned; otherwise it is halved; an interval of the finest level is settled exactly (`march.step`). So no cell
    is passed unseen, and the crossing found is the first. Root finders, those of optimistix too, end at some crossing:
    bisection at a wrong one for 22 % of 100,000 rays over rough ground, by up to 8.7 km (`docs/theory/terrain.md`).

    Under `jax.vmap` the rays of a batch are walked together (`batched.walk_all`) and finished rays drop out, also if
    each has its own field (`Dem.with_field`). Terrains that differ in anything else are searched one after the other.

    A `beam` changes results only in their last digits: rays within it are known to be clear up to its start. So does
    the package `jaxgeo_native`, which searches in place of JAX on CPUs where it is installed, unless `native` is false
    or the environment variable `JAXGEO_NATIVE` is 0 when a program is traced.
    """

    beam: Beam | None = None
    native: bool = eqx.field(default=True, static=True)

    def bracket(self, ray: Ray, dem: Dem) -> Bracket:
        return _first_hit(ray, dem, jax.lax.stop_gradient(self))

    def brackets(self, rays: Ray, ground: Ground) -> Bracket:
        """Those of many rays (leading axis) over one ground; without derivatives."""
        return _first_hits(rays, ground.bounded(), self)


@custom_vmap
def _first_hit(ray: Ray, dem: Dem, search: FirstHit) -> Bracket:
    brackets = _first_hits(jax.tree.map(lambda x: x[None], ray), Ground.common(dem), search)
    return jax.tree.map(lambda x: x[0], brackets)


@_first_hit.def_vmap
def _(axis_size, in_batched, ray: Ray, dem: Dem, search: FirstHit):
    ray_batched, dem_batched, search_batched = in_batched
    ray = _broadcast(ray, ray_batched, axis_size)
    search = _without_own_beams(search, search_batched)
    if fits_together(dem_batched):
        brackets = _first_hits(ray, Ground.of(dem, dem_batched), search)
    else:
        brackets = _one_terrain_each(_first_hit, axis_size, ray, dem, dem_batched, search)
    return brackets, jax.tree.map(lambda _: True, brackets)


@custom_vmap
def _first_hits(rays: Ray, ground: Ground, search: FirstHit) -> Bracket:
    """Brackets of many rays (leading axis)."""
    if not rays.origin.shape[0]:
        return jax.vmap(lambda _: _nothing())(rays.origin)
    if not (search.native and is_native() and serves(ground) and by_device(True, False)):
        return _search_in_jax(rays, ground, search.beam)
    like = jax.eval_shape(jax.vmap(lambda _: _nothing()), rays.origin)
    return native_or_not(_search_natively, _search_in_jax, like, rays, ground, search.beam)


@_first_hits.def_vmap
def _(axis_size, in_batched, rays: Ray, ground: Ground, search: FirstHit):
    """A batch of batches is one larger batch."""
    ray_batched, ground_batched, search_batched = in_batched
    search = _without_own_beams(search, search_batched)
    rays = _broadcast(rays, ray_batched, axis_size)
    if fits_together(ground_batched.shared):
        count = rays.origin.shape[1]
        flat = lambda x: x.reshape(axis_size * count, *x.shape[2:])  # noqa: E731
        flat_ground = _flat_ground(ground, ground_batched, axis_size, count)
        together = _first_hits(jax.tree.map(flat, rays), flat_ground, search)
        brackets = jax.tree.map(lambda x: x.reshape(axis_size, count, *x.shape[1:]), together)
    else:
        brackets = _one_terrain_each(_first_hits, axis_size, rays, ground, ground_batched, search)
    return brackets, jax.tree.map(lambda _: True, brackets)


def _without_own_beams(search: FirstHit, batched: FirstHit) -> FirstHit:
    """The search without its beam if that is not the same for the whole batch."""
    return FirstHit(None, search.native) if any(jax.tree.leaves(batched)) else search


def _flat_ground(ground: Ground, batched: Ground, axis_size: int, count: int) -> Ground:
    """The ground of a batch of batches: data that differ between or within the batches become each ray's own."""
    own = _broadcast(ground.own, batched.own, axis_size)
    per_batch, shared = eqx.partition(ground.shared, batched.shared)
    repeated = jax.tree.map(lambda x: jnp.broadcast_to(x[:, None], (axis_size, count, *x.shape[1:])), per_batch)
    flat = jax.tree.map(lambda x: x.reshape(axis_size * count, *x.shape[2:]), eqx.combine(own, repeated))
    return Ground(flat, shared)


def _broadcast(tree, batched, axis_size: int):
    return jax.tree.map(
        lambda x, is_batched: x if is_batched else jnp.broadcast_to(x, (axis_size, *jnp.shape(x))), tree, batched
    )


def _one_terrain_each(first_hit, axis_size: int, rays: Ray, dem: Dem | Ground, dem_batched, search: FirstHit):
    """A batch in which every item has its own terrain: one after the other."""
    leaves, structure = jax.tree.flatten(dem)
    flags = jax.tree.leaves(dem_batched)

    def one(number):
        own = [x[number] if is_batched else x for x, is_batched in zip(leaves, flags, strict=True)]
        own_dem = jax.tree.unflatten(structure, own)
        return first_hit(jax.tree.map(lambda x: x[number], rays), own_dem, FirstHit(None, search.native))

    return jax.lax.map(one, jnp.arange(axis_size))


def _search_natively(rays: Ray, ground: Ground, beam: Beam | None) -> Bracket:
    return _in_parts(rays, ground, BLOCK, lambda rays, ground: _search(rays, ground, beam, walk_natively))


def _search_in_jax(rays: Ray, ground: Ground, beam: Beam | None) -> Bracket:
    def walk(ray: Ray, way: Way, ground: Ground, beam: Beam | None) -> Found:
        return ground.each(_found, *walk_all(ray, way, ground, beam))

    size = by_device(AT_ONCE, AT_ONCE_ACCELERATOR)
    return _in_parts(rays, ground, size, lambda rays, ground: _search(rays, ground, beam, walk))


def _in_parts(rays: Ray, ground: Ground, most: int, search: Callable[[Ray, Ground], Bracket]) -> Bracket:
    """Brackets of many rays, at most so many at once; the last part overlaps the one before."""
    count = rays.origin.shape[0]
    parts = -(-count // most)
    size = -(-count // parts)
    if parts == 1:
        return search(rays, ground)

    def part(start: Int[Array, ""], found: Bracket) -> Bracket:
        first = jnp.minimum(start * size, count - size)
        pick = lambda x: jax.lax.dynamic_slice_in_dim(x, first, size)  # noqa: E731
        new = search(jax.tree.map(pick, rays), ground.of_rays(pick))
        return jax.tree.map(lambda all_, some: jax.lax.dynamic_update_slice_in_dim(all_, some, first, 0), found, new)

    nothing = nothing_like(jnp.where(jnp.isfinite(rays.origin[0, 0]), rays.origin[0, 0], 0.0))
    empty = jax.tree.map(lambda x: jnp.full((count, *x.shape), nothing.astype(x.dtype)), _nothing())
    return jax.lax.fori_loop(0, parts, part, empty)


def _search(rays: Ray, ground: Ground, beam: Beam | None, walk: Callable[..., Found]) -> Bracket:
    reach = ground.each(reach_of, rays)
    begins_low = reach.exists & reach.from_near & (reach.start == 0.0)

    def at_ground() -> tuple[Array, Flags]:
        above = ground.each(above_ground, rays)
        on_ground = begins_low & (jnp.abs(above) <= ON_GROUND)
        up = jax.vmap(lambda p_ecef: WGS84.normal_and_height(p_ecef)[0])(rays.origin)
        lifted = rays.origin + LIFT * up  # so that the ray's side of the ground is detected
        return jnp.where(on_ground[:, None], lifted, rays.origin), begins_low & (above < -ON_GROUND)

    origin, buried = jax.lax.cond(jnp.any(begins_low), at_ground, lambda: (rays.origin, begins_low & False))
    found = walk(eqx.tree_at(lambda ray: ray.origin, rays, origin), way_of(reach), ground, beam)
    brackets = jax.vmap(_as_bracket)(found, reach)
    status = jnp.where(buried, Status.camera_below_terrain.code, brackets.status)
    return eqx.tree_at(lambda b: b.status, brackets, status)


def _found(walker: Walker, track: Track, dem: Dem) -> Found:
    """The outcome of a walk in JAX, with the root on its track."""
    begin, end = walker.tau, walker.exit
    cell = jnp.stack(cell_between(track, begin, end))
    root, below = _root(track, dem, cell, begin, end)
    is_above = track.height.at(jnp.asarray(1.0)) >= dem.ceiling
    ranges = (track.range_at(tau) for tau in (begin, root, below))
    return Found(*ranges, cell=cell, news=walker.news, tracks=walker.tracks, is_above=is_above)


def _as_bracket(found: Found, reach: Reach) -> Bracket:
    """The result of a walk: where the ray meets the surface, or the status of a miss."""
    met = happened(found.news)
    lower = jnp.maximum(found.near - ROOM, found.begin)
    upper = jnp.minimum(found.near + ROOM, found.below)
    without = jnp.where(found.is_above, Status.rises_away.code, Status.not_converged.code)
    without = status_where(~has_entered(found.news), Status.ray_misses_terrain, without)
    without = status_where(found.tracks > MOST_TRACKS, Status.not_converged, without)
    without = status_where(~reach.is_near, Status.ray_misses_terrain, without)
    without = status_where(~reach.exists, Status.rises_away, without)
    return Bracket(
        lower=jnp.where(met, lower, 0.0),
        upper=jnp.where(met, jnp.maximum(lower, upper), 0.0),
        near=jnp.where(met, found.near, 0.0),
        cell=jnp.where(met, found.cell, 0),
        status=jnp.where(met, status_of(found.news), without),
    )


def _root(track: Track, dem: Dem, cell: Int[Array, "2"], begin: Scalar, end: Scalar) -> tuple[Scalar, Scalar]:
    """Tau at which the track first sinks below the patch of a cell, and a later tau at which it is below.

    Starts from the parabola through three values, then Newton on the polynomials, bracketed by bisection.
    """
    row, col = cell
    patch, _ = dem.patch(cell)
    (first, half, last), lowest, lowest_at = lowest_clearance(track, patch, row, col, begin, end)
    below = jnp.where(first <= 0.0, begin, jnp.where(lowest <= 0.0, lowest_at, end))
    bend = 2.0 * (first + last - 2.0 * half)
    fall = first - last + bend
    share = 2.0 * first / jnp.maximum(fall + safe_sqrt(fall * fall - 4.0 * bend * first), TINY)
    low, high = begin, below
    tau = jnp.clip(begin + (end - begin) * share, low, high)
    for _ in range(ROOT_STEPS):
        value = clearance(track, patch, row, col, tau)
        by_row, by_col = patch.gradient(track.row.at(tau) - row, track.col.at(tau) - col)
        slope = track.height.slope(tau) - by_row * track.row.slope(tau) - by_col * track.col.slope(tau)
        low, high, tau = newton_or_half(low, high, tau, value, slope, SLACK * (end - begin))
    return tau, below


def _nothing() -> Bracket:
    zero = jnp.asarray(0.0)
    return Bracket(zero, zero, zero, jnp.zeros(2, jnp.int32), Status.not_converged.code)
