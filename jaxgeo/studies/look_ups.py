"""Count of the terrain look-ups of a first-hit search over the pyramid."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxgeo._record import Record
from jaxgeo._typing import Flag, Index, Scalar
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain import Dem
from jaxgeo.terrain.search.reach import reach_of

SAG = 1.0 / (8.0 * 6.3e6)  # 1/m: sag of a straight line below the ellipsoid's curve at the middle of a chord
FINEST = 24  # dyadic levels at most


class _Walk(Record):
    position: Index
    level: Index
    bounds: Index
    patches: Index


def first_hit_look_ups(ray: Ray, dem: Dem, first: Scalar) -> tuple[Index, Index]:
    """Look-ups of a pyramid search along one ray up to its first hit at range `first` (m): bounds, and cells settled.

    The rule is that of `FirstHit`: dyadic intervals of the range between highest and lowest ground, halved where the
    bound over all cells that they can touch is not cleared, doubled where aligned; an interval of the finest level, no
    longer than a cell, is settled on the patches below it. Here the ends are placed by the exact map; a search that
    starts at a better level, or shares its start with other rays, needs fewer.
    """
    reach = reach_of(ray, dem)
    ends = jnp.stack([reach.start, reach.end])
    rowcols = jnp.stack([dem.over(ray.at(end))[0] for end in ends])
    cells = jnp.max(jnp.abs(rowcols[1] - rowcols[0]))
    finest = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(cells, 1.0))), 0, FINEST).astype(jnp.int32)
    unit = (reach.end - reach.start) / 2.0**finest
    stop = jnp.where(jnp.isfinite(first), first, reach.end)

    def range_of(position: Index) -> Scalar:
        return reach.start + unit * position

    def is_going_on(walk: _Walk) -> Flag:
        return (range_of(walk.position) <= stop) & (walk.position < 2**finest)

    def advance(walk: _Walk) -> _Walk:
        width = 2**walk.level
        begin, end = range_of(walk.position), range_of(walk.position + width)
        (near, near_height), (far, far_height) = dem.over(ray.at(begin)), dem.over(ray.at(end))
        low = jnp.minimum(near_height, far_height) - SAG * (end - begin) ** 2
        first_cell, last_cell = jnp.floor(jnp.minimum(near, far)), jnp.floor(jnp.maximum(near, far))
        texel = jnp.right_shift(first_cell.astype(jnp.int32), walk.level)
        last_texel = jnp.right_shift(last_cell.astype(jnp.int32), walk.level)
        is_clear = jnp.all(last_texel <= texel + 1) & (low > dem.pyramid.bound(walk.level, texel[0], texel[1]))
        must_settle = ~is_clear & (walk.level == 0)
        passes = is_clear | must_settle
        position = jnp.where(passes, walk.position + width, walk.position)
        is_aligned = (jnp.right_shift(position, walk.level) & 1) == 0
        coarser = jnp.minimum(walk.level + is_aligned, finest)
        level = jnp.where(passes, coarser, walk.level - 1)
        touched = 1 + jnp.sum(last_cell - first_cell).astype(jnp.int32)
        return _Walk(position, level, walk.bounds + 1, walk.patches + jnp.where(must_settle, touched, 0))

    none = jnp.asarray(0, jnp.int32)
    walk = jax.lax.while_loop(is_going_on, advance, _Walk(none, finest, none, none))
    return walk.bounds, walk.patches
