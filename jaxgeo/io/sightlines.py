"""Conservative bounds of ray paths over a mosaic, from block bounds without reading posts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxgeo.earth import WGS84
from jaxgeo.earth.ray import Ray
from jaxgeo.io._proj import lonlat_of
from jaxgeo.io.blocks import Blocks
from jaxgeo.io.heights import POSSIBLE_HEIGHTS
from jaxgeo.io.mapping import FileMap
from jaxgeo.terrain.grid import AbstractGrid
from jaxgeo.terrain.search.reach import CEILING_MARGIN

USUAL_FLOOR = -500.0  # m: below nearly all dry land, so paths have short segments above it and long ones below
FINE, COARSE = 16, 2  # segments of a path above and below it
NODES = 2 * (FINE + COARSE) + 1
PLACES = 33  # samples from a ray's origin to the start of its path
RAYS_AT_ONCE = 16_384
BATCHES = (256, 2048, RAYS_AT_ONCE)  # numbers of rays that are compiled for
CLEARLY = 0.01  # m: depth below the lowest ground that proves a hit
BESIDE = 1.0  # cells added around each box
ON_THE_EDGE = 1e-6  # cells: tolerance for rounding on the outermost posts
FAR_AWAY = 1e15  # outside the map's domain


@dataclasses.dataclass(frozen=True)
class Sightlines:
    """Paths of n rays as segments, each with a conservative bounding box.

    `low` and `high` (n, segments, 2) are (row, col) bounds without any margin, `bottom` and `top` (n, segments) those
    of height in m. `exists` (n,) is false for rays that never get below the start height of paths. `last` (n,)
    is the segment in which the ray has certainly hit the ground, if any; `touches` (n, segments) where it may hit it.
    `is_simple` rays start over the mosaic and end over it, by hitting the ground or by rising above all of it.
    """

    low: np.ndarray
    high: np.ndarray
    bottom: np.ndarray
    top: np.ndarray
    exists: np.ndarray
    last: np.ndarray
    touches: np.ndarray
    is_simple: np.ndarray

    def take(self, rays: np.ndarray) -> Sightlines:
        """The paths of some rays."""
        return Sightlines(*(getattr(self, field.name)[rays] for field in dataclasses.fields(self)))

    def needed(self, ceiling: float) -> np.ndarray:
        """Mask (n, segments) of segments to load for a search that starts at `ceiling`."""
        reached = np.arange(self.low.shape[1])[None, :] <= self.last[:, None]
        below = self.bottom <= ceiling + 2.0 * CEILING_MARGIN
        return self.exists[:, None] & reached & (below | self.touches)


def sightlines(
    rays: Ray,
    mapping: FileMap,
    grid: AbstractGrid | None,
    blocks: Blocks,
    ceiling: float,
    void_ceiling: Callable[[], float],
) -> Sightlines:
    """Follow rays (n, 3) from `ceiling` until they have certainly hit the ground or are above `ceiling` again.

    `grid` is the mosaic's, or None if only PROJ (`mapping`) can compute its map; `void_ceiling` is a function, called
    only if there are voids on the path.
    """
    normals, heights, exists = _nodes(rays, ceiling)
    rowcol = _rowcols(normals, mapping, grid)
    low, high, bottom, top = _boxes(rowcol, heights)
    path = Sightlines(
        low, high, bottom, top,
        exists=exists,
        last=np.full(len(low), low.shape[1] - 1),
        touches=np.zeros(bottom.shape, bool),
        is_simple=np.ones(len(low), bool),
    )  # fmt: skip
    _walk(path, blocks, void_ceiling)
    return path


def block_range(low: np.ndarray, high: np.ndarray, blocks: Blocks) -> np.ndarray:
    """First and last row and column of the blocks under boxes, (n, 4), if they overlap the mosaic."""
    cells = np.array(blocks.cells)
    first, last = np.floor(low - BESIDE), np.floor(high + BESIDE)
    limit = cells - 1.0
    if blocks.turn is not None:  # at most once around the Earth
        shift = blocks.turn * np.floor(first[:, 1] / blocks.turn)
        first[:, 1], last[:, 1] = first[:, 1] - shift, last[:, 1] - shift
        limit = np.stack([np.full(len(low), limit[0]), first[:, 1] + blocks.turn - 1.0], axis=1)
    first, last = np.clip(first, 0.0, limit), np.clip(last, 0.0, limit)
    ranges = np.concatenate([first, last], axis=1).astype(np.int64) // blocks.size
    if blocks.turn is not None:  # a partial block at the seam shifts later blocks
        wraps = last[:, 1] >= blocks.turn
        ends = ((last[:, 1] - blocks.turn).astype(np.int64) // blocks.size) + blocks.shape[1]
        ranges[:, 3] = np.where(wraps, ends, ranges[:, 3])
        ranges[:, 3] = np.minimum(ranges[:, 3], ranges[:, 1] + blocks.shape[1] - 1)
    return ranges


def _walk(path: Sightlines, blocks: Blocks, void_ceiling: Callable[[], float]) -> None:
    """Mark where each ray may hit the ground, and where it certainly has: segment by segment, all rays together."""
    active = path.exists.copy()
    for k in range(path.low.shape[1]):
        low, high = path.low[:, k], path.high[:, k]
        path.is_simple[active & ~_is_within(low, high, blocks)] = False
        over = np.flatnonzero(active & _overlaps(low, high, blocks))
        if over.size:
            ranges, which = _distinct(block_range(low[over], high[over], blocks))
            bottoms, tops = _bounds(ranges, blocks, void_ceiling)
            path.touches[over, k] = path.bottom[over, k] <= tops[which]
            met = path.top[over, k] < bottoms[which] - CLEARLY
            met &= _is_within(low[over], high[over], blocks)
            path.last[over[met]] = k
            active[over[met]] = False
        if not active.any():
            return


def _distinct(ranges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unique integer rows (n, 4), and the inverse index."""
    sizes = ranges.max(axis=0) + 1
    keys = np.ravel_multi_index(tuple(ranges.T), tuple(sizes.tolist()))
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    return ranges[first], which


def _bounds(ranges: np.ndarray, blocks: Blocks, void_ceiling: Callable[[], float]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest ground, known or not, over ranges of blocks (n, 4)."""
    wanted = np.zeros(blocks.shape, bool)
    for i0, j0, i1, j1 in ranges.tolist():
        blocks.mark(wanted, (i0, i1), (j0, j1))
    blocks.read(wanted)
    bottoms, tops = np.empty(len(ranges)), np.empty(len(ranges))
    for n, (i0, j0, i1, j1) in enumerate(ranges.tolist()):
        low, high, has_void = blocks.bounds((i0, i1), (j0, j1))
        if has_void:
            unknown = void_ceiling()
            low, high = min(low, unknown), max(high, unknown)
        bottoms[n], tops[n] = low, high
    return bottoms, tops


def _is_within(low: np.ndarray, high: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Whether boxes are entirely over the mosaic."""
    rows = (low[:, 0] >= 0.0) & (high[:, 0] <= blocks.cells[0])
    return rows if blocks.turn is not None else rows & (low[:, 1] >= 0.0) & (high[:, 1] <= blocks.cells[1])


def _overlaps(low: np.ndarray, high: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Whether boxes, with the margin, overlap the mosaic."""
    rows = (low[:, 0] - BESIDE <= blocks.cells[0]) & (high[:, 0] + BESIDE >= 0.0)
    if blocks.turn is not None:
        return rows
    return rows & (low[:, 1] - BESIDE <= blocks.cells[1]) & (high[:, 1] + BESIDE >= 0.0)


def comes_in(
    rays: Ray, mapping: FileMap, grid: AbstractGrid | None, blocks: Blocks, ceiling: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of rays (n, 3): which get below `ceiling` at all, which are over the mosaic there, and which were before.

    The path to there is interpolated linearly between 33 points, so whether a ray passes the very corner of a
    mosaic is only known to some metres.
    """
    found = [_ways(padded_rays(part), jnp.asarray(ceiling)) for part in in_parts(rays)]
    normals, exists = (np.concatenate(leaves)[: len(rays.origin)] for leaves in zip(*found, strict=True))
    rowcol = _rowcols(normals, mapping, grid)
    return exists, _is_within(rowcol[:, -1], rowcol[:, -1], blocks), _passes_over(rowcol, blocks)


def _passes_over(rowcol: np.ndarray, blocks: Blocks) -> np.ndarray:
    """Whether any of the line segments between points (n, points, 2) overlaps the mosaic."""
    a, run = rowcol[:, :-1], np.diff(rowcol, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(-ON_THE_EDGE - a) / run, (np.array(blocks.cells) + ON_THE_EDGE - a) / run])
    inside = (a >= -ON_THE_EDGE) & (a <= np.array(blocks.cells) + ON_THE_EDGE)
    still = run == 0.0
    first = np.where(still, np.where(inside, -np.inf, np.inf), ends.min(axis=0))
    last = np.where(still, np.where(inside, np.inf, -np.inf), ends.max(axis=0))
    if blocks.turn is not None:
        first[..., 1], last[..., 1] = -np.inf, np.inf
    return (np.maximum(first.max(axis=-1), 0.0) <= np.minimum(last.min(axis=-1), 1.0)).any(axis=1)


def in_parts(rays: Ray) -> Iterator[Ray]:
    """Rays (n, 3) in chunks of at most `RAYS_AT_ONCE`."""
    for start in range(0, len(rays.origin), RAYS_AT_ONCE):
        yield Ray(rays.origin[start : start + RAYS_AT_ONCE], rays.direction[start : start + RAYS_AT_ONCE])


@jax.jit
def _ways(rays: Ray, ceiling: Float[Array, ""]) -> tuple[Float[Array, "n places 3"], Bool[Array, " n"]]:
    def way(ray: Ray) -> tuple[Float[Array, "places 3"], Bool[Array, ""]]:
        heights, sides = jnp.stack([ceiling, ceiling]), jnp.array([-1.0, 1.0])
        (entry, exit_), meets = WGS84.crossings(ray.origin, ray.direction, heights, sides)
        ranges = jnp.linspace(0.0, jnp.maximum(entry, 0.0), PLACES)
        return jax.vmap(lambda s: WGS84.normal_and_height(ray.at(s))[0])(ranges), meets[0] & (exit_ > 0.0)

    return jax.vmap(way)(rays)


def _nodes(rays: Ray, ceiling: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals (n, nodes, 3) and heights (n, nodes) along the paths, and which exist."""
    origin, direction = (np.asarray(part, np.float64) for part in (rays.origin, rays.direction))
    found = [_paths(padded_rays(part), jnp.asarray(ceiling)) for part in in_parts(Ray(origin, direction))]
    normals, heights, exists = (np.concatenate(leaves)[: len(origin)] for leaves in zip(*found, strict=True))
    return normals, heights, exists


def padded_rays(rays: Ray) -> Ray:
    """Rays (n, 3) padded to one of a few numbers by rays that point away from the Earth."""
    count = len(rays.origin)
    size = next((size for size in BATCHES if size >= count), count)
    away = np.tile([3e7, 0.0, 0.0], (size - count, 1))
    return Ray(
        jnp.asarray(np.concatenate([rays.origin, away])), jnp.asarray(np.concatenate([rays.direction, away / 3e7]))
    )


@jax.jit
def _paths(
    rays: Ray, ceiling: Float[Array, ""]
) -> tuple[Float[Array, "n nodes 3"], Float[Array, "n nodes"], Bool[Array, " n"]]:
    return jax.vmap(_path, in_axes=(0, None))(rays, ceiling)


def _path(
    ray: Ray, ceiling: Float[Array, ""]
) -> tuple[Float[Array, "nodes 3"], Float[Array, " nodes"], Bool[Array, ""]]:
    """Nodes from the ceiling down, and up again where the ray starts to rise."""
    heights = jnp.stack([ceiling, ceiling, jnp.minimum(USUAL_FLOOR, ceiling - 1.0), jnp.asarray(POSSIBLE_HEIGHTS[0])])
    (entry, exit_, floor, deepest), meets = WGS84.crossings(
        ray.origin, ray.direction, heights, jnp.array([-1.0, 1.0, -1.0, -1.0])
    )
    exists = meets[0] & (exit_ > 0.0) & jnp.all(jnp.isfinite(ray.origin)) & jnp.all(jnp.isfinite(ray.direction))
    start = jnp.maximum(entry, 0.0)
    end = jnp.maximum(jnp.where(meets[3] & (deepest > 0.0), deepest, exit_), start)
    middle = jnp.clip(jnp.where(meets[2] & (floor > 0.0), floor, end), start, end)
    ranges = jnp.concatenate([jnp.linspace(start, middle, 2 * FINE + 1), jnp.linspace(middle, end, 2 * COARSE + 1)[1:]])
    normals, altitudes = jax.vmap(lambda s: WGS84.normal_and_height(ray.at(s)))(ranges)
    return normals, altitudes, exists


def _rowcols(normals: np.ndarray, mapping: FileMap, grid: AbstractGrid | None) -> np.ndarray:
    """(row, col) (n, nodes, 2) under normals (n, nodes, 3); not finite outside the map's domain.

    On a geographic map the columns of each path continue across the seam opposite to the mosaic's centre.
    """
    shape, flat = normals.shape[:-1], normals.reshape(-1, 3)
    if grid is not None:
        rowcol = np.concatenate(
            [np.asarray(_by_grid(grid, jnp.asarray(part))) for part in _in_batches(flat, RAYS_AT_ONCE * NODES)]
        )[: len(flat)]
    else:
        rowcol = np.stack(mapping.rowcol(*lonlat_of(flat)), axis=-1)
    rowcol = rowcol.reshape(*shape, 2)
    if mapping.crs.is_geographic:
        a, _, _, d, _, _ = mapping.affine
        if d == 0.0:
            period = abs(2.0 * np.pi / mapping.crs.axis_info[0].unit_conversion_factor / a)
            if np.any(np.abs(np.diff(rowcol[..., 1], axis=1)) > 0.5 * period):
                rowcol[..., 1] = np.unwrap(rowcol[..., 1], axis=1, period=period)
    return rowcol


def _in_batches(flat: np.ndarray, largest: int) -> Iterator[np.ndarray]:
    for start in range(0, len(flat), largest):
        part = flat[start : start + largest]
        size = next(size * NODES for size in BATCHES if size * NODES >= len(part))
        yield np.concatenate([part, np.tile(part[-1:], (size - len(part), 1))])


@eqx.filter_jit
def _by_grid(grid: AbstractGrid, normals: jax.Array) -> jax.Array:
    return jax.vmap(grid.rowcol)(normals)


def _boxes(rowcol: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Bounds of (row, col) and of height over the segments between every second node.

    Rows and columns are modelled as parabolas whose curvature is multiplied by eight, to cover higher orders; height
    along a straight line is convex, so chords bound it from above, and their extensions from below.
    """
    a, m, b = rowcol[:, 0:-1:2], rowcol[:, 1::2], rowcol[:, 2::2]
    bend = np.abs(a + b - 2.0 * m)
    low, high = np.minimum(np.minimum(a, m), b) - bend, np.maximum(np.maximum(a, m), b) + bend
    is_mapped = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(is_mapped, low, FAR_AWAY), np.where(is_mapped, high, FAR_AWAY)
    first, half, last = heights[:, 0:-1:2], heights[:, 1::2], heights[:, 2::2]
    bottom = np.minimum(half, np.minimum(2.0 * half - last, 2.0 * half - first))
    return low, high, np.minimum(bottom, np.minimum(first, last)), np.maximum(first, last)
