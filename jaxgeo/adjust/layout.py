"""Memory layout of a block: points grouped by their number of rays, so that sums need no scatter operations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgeo._checks import check_countable
from jaxgeo._record import Record
from jaxgeo.adjust.banded import Band, band_of, one_slab

GROUP_COST = 6000  # measurement slots that an extra group must save to repay its compilation
MOST_UNLIKE = 3  # times the mean number of measurements per image, up to which each image has one row
DENSE_COLUMNS = 1600  # of the reduced system, up to which it is one slab and chunks may be dense
DENSE_BYTES, DENSE_POINTS = 48_000_000, 64  # bytes of a dense chunk's rows; its least number of points
POINTS = (16, 32, 64, 128, 256)  # per sparse chunk, which has the columns of the images that see its points only
LEAST_STEP = 32  # of points in a dense chunk and of measurements in an image: below it, compiling takes far longer
BATCH_BYTES = 8_000_000  # of the matrix products of a batch of chunks
# # Cost model in ns: multiply-add, gather per number, scatter-add per number, overhead per chunk.
MULTIPLY, GATHER, SCATTER, BEGIN = 0.04, 1.5, 8.0, 3000.0


class Group(Record):
    """Points with similar numbers of rays: `chunks` of `size` points, each with `rays` slots for measurements.

    Measurement k of point row r is at index `first` + k `rows` + r. `slots` (chunks, q) are the images that see a
    chunk's points (padded with the number of images; all images in order if the group is `dense`), `measured` (chunks,
    size, q) is the measurement of a point in that image (else the last measurement of all, which has no weight).
    `batch` chunks are multiplied at a time.
    """

    rays: int = eqx.field(static=True)
    chunks: int = eqx.field(static=True)
    size: int = eqx.field(static=True)
    first: int = eqx.field(static=True)
    first_row: int = eqx.field(static=True)
    dense: bool = eqx.field(static=True)
    batch: int = eqx.field(static=True)
    slots: Int[Array, "chunks q"]
    measured: Int[Array, "chunks size q"]

    @property
    def rows(self) -> int:
        return self.chunks * self.size


class Layout(Record):
    """Index arrays of a block. The last measurement is padding with zero weight.

    `image`, point `row`, `uv` and `information` (1 / sigma, zero for padding) of each measurement; `of_image` (rows,
    width) are the measurements of one image, with number `owner` (rows,); `camera` (n,) is that of each image; `band`
    the order of the images in the reduced system.
    """

    image: Int[Array, " obs"]
    row: Int[Array, " obs"]
    uv: Float[Array, "obs 2"]
    information: Float[Array, "obs 2"]
    of_image: Int[Array, "rows width"]
    owner: Int[Array, " rows"]
    camera: Int[Array, " n"]
    band: Band
    groups: tuple[Group, ...]

    def to_rays(self, of_points: Float[Array, "k rows"]) -> Float[Array, "k obs"]:
        """Point values (rows) repeated for each measurement; group-wise copies, which are faster than a gather."""
        parts = []
        for group in self.groups:
            own = of_points[:, None, group.first_row : group.first_row + group.rows]
            parts.append(jnp.broadcast_to(own, (own.shape[0], group.rays, group.rows)).reshape(own.shape[0], -1))
        return jnp.concatenate([*parts, of_points[:, :1]], axis=1)


@dataclass(frozen=True)
class Order:
    """Indices into the layout: `row_of_point` by point number, `place` of each measurement."""

    row_of_point: np.ndarray
    place: np.ndarray
    rows: int


def layout_of(
    image: np.ndarray, point: np.ndarray, uv: np.ndarray, sigma: np.ndarray, camera: np.ndarray, columns: int
) -> tuple[Layout, Order]:
    """Index arrays of measurements from image and point numbers; `columns` are those of the reduced system."""
    n, points, dense = len(camera), int(point.max()) + 1, columns <= DENSE_COLUMNS
    band = one_slab(n) if dense else band_of(image, point, n)
    order = np.lexsort((image, point))
    image, point, uv, sigma = image[order], point[order], uv[order], sigma[order]
    counts = np.bincount(point, minlength=points)
    start = np.concatenate([[0], np.cumsum(counts)[:-1]])
    parts, given, row_of_point = [], [], np.zeros(points, int)
    first = first_row = lower = 0
    for rays in _group_limits(counts):
        chosen = np.flatnonzero((counts > lower) & (counts <= rays))
        lower = rays
        there = np.arange(rays)[None, :] < counts[chosen][:, None]
        taken = np.where(there, start[chosen][:, None] + np.arange(rays)[None, :], 0)
        image_of_ray = np.where(there, image[taken], n)
        sort = np.lexsort(image_of_ray.T[::-1])
        chosen = chosen[sort]
        size, chunks, batch, own = _chunking(image_of_ray[sort], n, columns // n, dense)
        pad = size * chunks - len(chosen)
        there, taken, image_of_ray = (
            np.concatenate([x[sort], np.full((pad, rays), fill)])
            for x, fill in ((there, False), (taken, 0), (image_of_ray, n))
        )
        slots, ray_of_slot = _slots(image_of_ray.reshape(chunks, size, rays), n, own)
        row = np.arange(size * chunks).reshape(chunks, size, 1)
        measured = np.where(ray_of_slot < rays, first + ray_of_slot * size * chunks + row, -1)
        given.append((rays, chunks, size, first, first_row, own, batch, slots, measured))
        row_of_point[chosen] = first_row + np.arange(len(chosen))
        rows = np.broadcast_to(np.arange(size * chunks)[:, None] + first_row, there.shape)
        parts.append([x.T.ravel() for x in (taken, there, rows)])
        first, first_row = first + there.size, first_row + size * chunks
    taken, there, rows = (np.concatenate([*x, [0]]) for x in zip(*parts, strict=True))
    there = there.astype(bool)
    there[-1] = False
    place = np.zeros(len(order), int)
    place[order[taken[there]]] = np.flatnonzero(there)
    image_of = np.where(there, image[taken], 0)
    last = len(there) - 1
    check_countable(last + 1, f"{len(image)} measurements in one block", "Adjust it in parts.")
    of_image, owner = _by_image(image_of, there, n)
    groups = [Group(*sizes, *_indices(slots, np.where(at < 0, last, at))) for *sizes, slots, at in given]
    layout = Layout(
        image=jnp.asarray(image_of, jnp.int32),
        row=jnp.asarray(rows, jnp.int32),
        uv=jnp.asarray(np.where(there[:, None], uv[taken], 0.0)),
        information=jnp.asarray(np.where(there[:, None], 1.0 / sigma[taken], 0.0)),
        of_image=jnp.asarray(of_image, jnp.int32),
        owner=jnp.asarray(owner, jnp.int32),
        camera=jnp.asarray(camera, jnp.int32),
        band=band,
        groups=tuple(groups),
    )
    return layout, Order(row_of_point, place, first_row)


def gathered(table: Float[Array, "some ..."], at: Int[Array, " obs"]) -> Float[Array, "... obs"]:
    """Entries of a small table with the batch axis last; element-wise gathers are faster than row-wise ones."""
    columns = table.reshape(table.shape[0], -1).T
    found = [column.at[at].get(mode="promise_in_bounds") for column in columns]
    return jnp.stack(found).reshape(*table.shape[1:], at.shape[0]) if found else jnp.zeros((0, at.shape[0]))


def _indices(*arrays: np.ndarray) -> list[Any]:
    return [jnp.asarray(array, jnp.int32) for array in arrays]


def _group_limits(counts: np.ndarray) -> list[int]:
    """Largest number of rays per point in each group, minimising slots plus `GROUP_COST`."""
    rays, points = np.unique(counts[counts > 0], return_counts=True)
    before = np.concatenate([[0], np.cumsum(points)])
    best, first = np.full(len(rays) + 1, np.inf), np.zeros(len(rays) + 1, int)
    best[0] = 0.0
    for end in range(1, len(rays) + 1):
        cost = best[:end] + (before[end] - before[:end]) * rays[end - 1] + GROUP_COST
        first[end] = int(np.argmin(cost))
        best[end] = cost[first[end]]
    limits, end = [], len(rays)
    while end:
        limits.append(int(rays[end - 1]))
        end = first[end]
    return limits[::-1]


def _chunking(image_of_ray: np.ndarray, n: int, c: int, dense: bool) -> tuple[int, int, int, bool]:
    """(points per chunk, chunks, chunks per batch, whether chunks are dense) of the cheapest chunking.

    `image_of_ray` (points, rays) are the images, n for none; an image has c columns.
    """
    points, best = len(image_of_ray), (np.inf, 0, 0, 0, False)
    if dense:
        most = max(DENSE_POINTS, DENSE_BYTES // (24 * n * c))
        chunks = -(-points // most)
        cost = chunks * BEGIN + points * (6.0 * (n * c) ** 2 * MULTIPLY + 3.0 * n * c * GATHER)
        best = (cost, rounded(-(-points // chunks), LEAST_STEP), chunks, 1, True)
    for size in POINTS:
        chunks = rounded(-(-points // size))
        there = np.zeros((chunks, n + 1), bool)
        there[np.arange(points)[:, None] // size, image_of_ray] = True
        columns = c * int(there[:, :n].sum(axis=1).max())
        batch = min(chunks, max(1, BATCH_BYTES // (8 * columns**2)))
        batches = -(-chunks // batch)
        batch = -(-chunks // batches)
        chunks = batch * batches
        each = size * (6.0 * columns**2 * MULTIPLY + 3.0 * columns * GATHER) + columns**2 * SCATTER + BEGIN
        if chunks * each < best[0]:
            best = (chunks * each, size, chunks, batch, False)
    return best[1:]


def rounded(count: int, least_step: int = 1) -> int:
    """A count rounded up by at most a sixteenth, or to a multiple of the least step, so that blocks of similar size
    share shapes and compiled programs."""
    step = max(2 ** max(0, count.bit_length() - 5), least_step)
    return -(-count // step) * step


def _slots(image_of_ray: np.ndarray, n: int, dense: bool) -> tuple[np.ndarray, np.ndarray]:
    """(slots (chunks, q), ray of each point in each slot) from the images (chunks, size, rays) that see the points."""
    chunks, size, rays = image_of_ray.shape
    own = [np.arange(n) if dense else np.unique(images[images < n]) for images in image_of_ray]
    q = max(len(images) for images in own)
    slots, ray_of_slot = np.full((chunks, q), n), np.full((chunks, size, q), rays)
    ray = np.broadcast_to(np.arange(rays), (size, rays))
    for chunk, images in enumerate(own):
        slots[chunk, : len(images)] = images
        by_image = np.full((size, n + 1), rays)
        np.put_along_axis(by_image, image_of_ray[chunk], ray, axis=1)
        ray_of_slot[chunk, :, : len(images)] = by_image[:, images]
    return slots, ray_of_slot


def _by_image(image: np.ndarray, there: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(rows, width): indices of the measurements of each image, padded with the last index, and the image of each
    row (rows,). Images have one row, or several if some have many times more measurements than others."""
    places = np.flatnonzero(there)
    places = places[np.argsort(image[places], kind="stable")]
    counts = np.bincount(image[places], minlength=n)
    mean, most = -(-len(places) // n), int(counts.max())
    width = rounded(most if most <= MOST_UNLIKE * mean else mean, LEAST_STEP)
    rows = np.maximum(-(-counts // width), 1)
    owner = np.repeat(np.arange(n), rows)
    table = np.full((len(owner), width), len(image) - 1)
    within = np.arange(len(places)) - np.repeat(np.cumsum(counts) - counts, counts)
    first = np.repeat(np.cumsum(rows) - rows, counts)
    table[first + within // width, within % width] = places
    return table, owner
