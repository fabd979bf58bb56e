"""Elimination of the points from the normal equations (Schur complement), and back substitution."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._compile import sized_filter_jit
from jaxgeo._record import Record
from jaxgeo.adjust.arrays import Problem, free_columns
from jaxgeo.adjust.banded import Band, Factor, Tridiagonal
from jaxgeo.adjust.equations import Equations
from jaxgeo.adjust.layout import Group


class Eliminated(Record):
    """Factored points: `factor` (6, rows) are the lower triangles L of their normal matrices L L', `halves` (3, obs,
    c) of images and (lenses, 3, rows) of lenses the couplings times L'^-1, `forward` (3, rows) the gradients L^-1 g."""

    factor: Float[Array, "6 rows"]
    halves: Float[Array, "3 obs c"]
    shared_halves: Float[Array, "lenses 3 rows"]
    forward: Float[Array, "3 rows"]


class Reduced(Record):
    """Reduced normal equations of images and shared parameters, and their gradients."""

    matrix: Tridiagonal
    images: Float[Array, "n c"]
    shared: Float[Array, " s"]


@sized_filter_jit
def eliminated(problem: Problem, equations: Equations, damping: Any) -> Eliminated:
    """Factors of the points' normal matrices, damped by `damping` times `scales_of_points`."""
    V = equations.points + damping * scales_of_points(problem, equations)
    factor = _cholesky_3(V)
    of_obs = problem.layout.to_rays(jnp.stack(factor))
    return Eliminated(
        jnp.stack(factor),
        jnp.moveaxis(times_inverse(of_obs, equations.coupling), 0, -1),
        times_inverse(factor, equations.shared_coupling),
        _forward(factor, equations.point_gradient),
    )


def scales_of_points(problem: Problem, equations: Equations) -> Float[Array, "3 3 rows"]:
    """Damping scales of the points: the diagonals of their normal matrices; the full matrices where control or
    terrain constrains a point along its rays too, as damping by the diagonal could exceed such a weak constraint."""
    held = jnp.any(problem.known_point != 0.0, axis=(1, 2))
    if problem.terrain is not None:
        held = held | (problem.terrain.information > 0.0)
    return equations.points * jnp.where(held[None, None], 1.0, jnp.eye(3)[:, :, None])


@sized_filter_jit
def reduced(problem: Problem, equations: Equations, rows: tuple[Rows, ...], damping: Any) -> Reduced:
    """The reduced system, its diagonal also increased by the share `damping`, and one where columns are fixed."""
    band, c, s = problem.layout.band, problem.of_image, problem.shared
    images = equations.images * (1.0 + damping * jnp.eye(c))[None]
    shared = equations.shared * (1.0 + damping * jnp.eye(s))
    free_images, free_shared = free_columns(problem)
    images = images + jnp.eye(c)[None] * (1.0 - free_images)[:, :, None]
    border, corner = equations.images_shared, shared + jnp.diag(1.0 - free_shared)
    state = (on_diagonal(band, images), border, corner, equations.image_gradient, equations.shared_gradient)
    for group, own in zip(problem.layout.groups, rows, strict=True):
        state = _less_points(problem, group, own, state)
    blocks, border, corner, image_gradient, shared_gradient = state
    blocks = blocks.reshape(-1, band.size * c, band.size * c)
    diagonal, below = blocks[: band.slabs], blocks[band.slabs :]
    matrix = Tridiagonal(diagonal, below, band.to_slabs(border), corner)
    return Reduced(matrix, image_gradient, shared_gradient)


def on_diagonal(band: Band, images: Float[Array, "n c c"]) -> Float[Array, "blocks size c size c"]:
    """Diagonal, then subdiagonal slab blocks with the given image blocks (n, c, c) on the diagonal."""
    c, each = images.shape[1], jnp.arange(band.size)
    eye = jnp.broadcast_to(jnp.eye(c), (band.slabs * band.size, c, c))
    own = images if band.slabs == 1 else eye.at[band.place].set(images, unique_indices=True)
    own = jnp.moveaxis(own.reshape(band.slabs, band.size, c, c), 1, 0)
    blocks = jnp.zeros((2 * band.slabs - 1, band.size, c, band.size, c))
    return blocks.at[: band.slabs, each, :, each, :].set(own, unique_indices=True)


def solve_reduced(
    problem: Problem, factor: Factor, images: Float[Array, "n c"], shared: Float[Array, " s"]
) -> tuple[Float[Array, "n c"], Float[Array, " s"]]:
    """Inverse of the reduced system times one column."""
    band = problem.layout.band
    slabs, shared = factor.solve(band.to_slabs(images)[:, :, None], shared[:, None])
    return band.of_images(slabs[:, :, 0]), shared[:, 0]


def back_substituted(problem: Problem, points: Eliminated, images: Any, shared: Any) -> Float[Array, "3 rows"]:
    """Steps of the points from those (n, c) of the images and (s,) of the shared parameters."""
    layout = problem.layout
    along = jnp.sum(points.halves * images[layout.image][None], axis=-1)  # (3, obs)
    found = []
    for group in layout.groups:
        part = along[:, group.first : group.first + group.rays * group.rows]
        found.append(jnp.sum(part.reshape(3, group.rays, group.rows), axis=1))
    total = jnp.concatenate(found, axis=-1) + points.forward
    if problem.of_lenses:
        total = total + jnp.einsum("air,a->ir", points.shared_halves, shared[: problem.of_lenses])
    return -backward(points.factor, total)


class Rows(NamedTuple):
    """Couplings times L'^-1 of a group's points, chunk by chunk: with the images of its slots (chunks, 3, size, q,
    c), with lenses (chunks, 3, size, lenses), and the forward gradients (chunks, 3, size)."""

    images: Float[Array, "chunks 3 size q c"]
    lenses: Float[Array, "chunks 3 size lenses"]
    forward: Float[Array, "chunks 3 size"]

    def joined(self) -> Float[Array, "chunks rows columns"]:
        """One matrix per chunk: 3 size rows, columns of the images' slots and of the lenses."""
        chunks, three, size, q, c = self.images.shape
        both = (self.images.reshape(chunks, three, size, q * c), self.lenses)
        return jnp.concatenate(both, axis=-1).reshape(chunks, three * size, -1)


def rows_of(problem: Problem, group: Group, points: Eliminated) -> Rows:
    """Rows of a group's points, gathered from their measurements."""
    shape = (3, group.chunks, group.size)
    images = points.halves.at[:, group.measured].get(mode="promise_in_bounds")
    own = slice(group.first_row, group.first_row + group.rows)
    lenses = jnp.moveaxis(points.shared_halves[:, :, own].reshape(problem.of_lenses, *shape), 0, -1)
    forward = points.forward[:, own].reshape(shape)
    return Rows(*(jnp.moveaxis(x, 1, 0) for x in (images, lenses, forward)))


@sized_filter_jit
def gather(problem: Problem, points: Eliminated) -> tuple[Rows, ...]:
    """Rows of all groups, as a separate program: fused with its neighbours it takes several times as long, as XLA
    then recomputes sources and indices for each gathered number."""
    return tuple(rows_of(problem, group, points) for group in problem.layout.groups)


def undamped(problem: Problem, equations: Equations) -> tuple[Eliminated, Tridiagonal]:
    """The eliminated points and the matrix of the reduced normal equations, without damping."""
    none = jnp.zeros(())
    points = eliminated(problem, equations, none)
    return points, reduced(problem, equations, gather(problem, points), none).matrix


def _less_points(problem: Problem, group: Group, rows: Rows, state: Any) -> Any:
    """The reduced system after subtracting the contributions of a group's points."""
    c, lenses, q = problem.of_image, problem.of_lenses, group.slots.shape[1]

    def one(state: Any, batch: Any) -> tuple[Any, None]:
        blocks, border, corner, gradient, shared_gradient = state
        slots, (D, of_lenses, y) = batch  # (batch, ...)
        D = D.reshape(group.batch, 3 * group.size, q * c)
        of_lenses = of_lenses.reshape(group.batch, 3 * group.size, lenses)
        y = y.reshape(group.batch, 3 * group.size, 1)
        square = _transposed_times(D, D).reshape(-1, q, c, q, c)
        along = _transposed_times(D, y).reshape(-1, q, c)
        if group.dense:
            blocks, gradient = blocks - square, gradient - along[0]
        else:
            blocks = blocks.at[places(problem.layout.band, slots, c)].add(-square, mode="drop")
            gradient = gradient.at[slots].add(-along, mode="drop")
        if lenses:
            mixed = _transposed_times(D, of_lenses).reshape(-1, q, c, lenses)
            border = border.at[slots, :, :lenses].add(-mixed, mode="drop")
            own = jnp.sum(_transposed_times(of_lenses, of_lenses), axis=0)
            corner = corner.at[:lenses, :lenses].add(-own)
            shared_gradient = shared_gradient.at[:lenses].add(-jnp.einsum("kri,krj->j", y, of_lenses))
        return (blocks, border, corner, gradient, shared_gradient), None

    number = group.chunks // group.batch
    batches = jax.tree.map(lambda x: x.reshape(number, group.batch, *x.shape[1:]), (group.slots, rows))
    if number == 1:
        return one(state, jax.tree.map(lambda x: x[0], batches))[0]
    return jax.lax.scan(one, state, batches)[0]


def places(band: Band, slots: Int[Array, "*batch q"], c: int) -> tuple[Array, ...]:
    """Indices, each (..., q, c, q, c) when broadcast, of the image pairs of chunks in the slab blocks.

    Out of range for unused slots and for pairs outside the diagonal and subdiagonal blocks; such images share no
    points.
    """
    n, column = band.place.shape[0], jnp.arange(c)
    slab, within = jnp.divmod(band.place[jnp.minimum(slots, n - 1)], band.size)
    there, after = slots < n, slab[..., :, None] - slab[..., None, :]
    block = jnp.where(after == 0, slab[..., None, :], band.slabs + slab[..., None, :])
    kept = there[..., :, None] & there[..., None, :] & ((after == 0) | (after == 1))
    block = jnp.where(kept, block, 2 * band.slabs)[..., :, None, :, None]
    row, across = within[..., :, None, None, None], within[..., None, None, :, None]
    like = (1,) * (slots.ndim - 1)
    down, along = column.reshape(*like, 1, c, 1, 1), column.reshape(*like, 1, 1, 1, c)
    return block, row, down, across, along


def _transposed_times(A: Float[Array, "batch rows a"], B: Float[Array, "batch rows b"]) -> Float[Array, "batch a b"]:
    return jax.lax.dot_general(A, B, (((1,), (1,)), ((0,), (0,))))


def _cholesky_3(V: Float[Array, "3 3 rows"]) -> tuple[Array, ...]:
    """Lower triangles (l00, l10, l20, l11, l21, l22) of a batch of symmetric matrices; NaN where not positive
    definite."""
    l00 = jnp.sqrt(V[0, 0])
    l10, l20 = V[1, 0] / l00, V[2, 0] / l00
    l11 = jnp.sqrt(V[1, 1] - l10 * l10)
    l21 = (V[2, 1] - l20 * l10) / l11
    return l00, l10, l20, l11, l21, jnp.sqrt(V[2, 2] - l20 * l20 - l21 * l21)


def times_inverse(factor: Any, coupling: Float[Array, "c 3 many"]) -> Float[Array, "c 3 many"]:
    """Coupling times L'^-1, that is L^-1 applied to each of its rows."""
    l00, l10, l20, l11, l21, l22 = (entry[None] for entry in factor)
    a = coupling[:, 0] / l00
    b = (coupling[:, 1] - l10 * a) / l11
    return jnp.stack([a, b, (coupling[:, 2] - l20 * a - l21 * b) / l22], axis=1)


def _forward(factor: Any, v: Float[Array, "3 rows"]) -> Float[Array, "3 rows"]:
    """L^-1 v."""
    return times_inverse(factor, v[None])[0]


def backward(factor: Any, v: Float[Array, "3 rows"]) -> Float[Array, "3 rows"]:
    """L'^-1 v."""
    l00, l10, l20, l11, l21, l22 = factor
    z = v[2] / l22
    y = (v[1] - l21 * z) / l11
    return jnp.stack([(v[0] - l10 * y - l20 * z) / l00, y, z])


def along_points(
    problem: Problem, points: Eliminated, images: Float[Array, "d n c"], shared: Float[Array, "d s"]
) -> Float[Array, "d 3 rows"]:
    """Rows of the reduced space times D' of each point."""
    layout = problem.layout
    along = jnp.einsum("doc,ioc->dio", images[:, layout.image], points.halves)
    found = []
    for group in layout.groups:
        part = along[:, :, group.first : group.first + group.rays * group.rows]
        found.append(jnp.sum(part.reshape(-1, 3, group.rays, group.rows), axis=2))
    total = jnp.concatenate(found, axis=-1)
    return total + jnp.einsum("da,air->dir", shared[:, : problem.of_lenses], points.shared_halves)


def condensed(
    problem: Problem, points: Eliminated, half: Float[Array, "d 3 rows"]
) -> tuple[Float[Array, "d n c"], Float[Array, "d s"]]:
    """Image and shared-parameter parts of the sums of v' D over the points, v (3,) of each point and D its halves."""
    n, c, lenses, d = problem.n, problem.of_image, problem.of_lenses, half.shape[0]
    images, corner = jnp.zeros((d, n, c)), jnp.zeros((d, lenses))
    for group in problem.layout.groups:
        rows = rows_of(problem, group, points).joined()
        own = half[:, :, group.first_row : group.first_row + group.rows]
        own = own.reshape(-1, 3, group.chunks, group.size)
        own = jnp.moveaxis(own, 1, 2).reshape(-1, group.chunks, 3 * group.size)
        sums = jnp.einsum("dkr,krm->kdm", own, rows)
        q = group.slots.shape[1]
        by_slot = jnp.moveaxis(sums[:, :, : q * c].reshape(group.chunks, -1, q, c), 1, 2)
        images = images.at[:, group.slots].add(jnp.moveaxis(by_slot, 2, 0), mode="drop")
        corner = corner + jnp.sum(sums[:, :, q * c :], axis=0)
    return images, jnp.pad(corner, ((0, 0), (0, problem.shared - lenses)))


def backward_rows(factor: Any, v: Float[Array, "k 3 rows"]) -> Float[Array, "k 3 rows"]:
    """Each of k vectors times L^-1, that is L'^-1 applied to it."""
    return jax.vmap(lambda row: backward(factor, row))(v)
