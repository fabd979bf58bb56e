"""The points eliminated from the normal equations (Schur complement), and found again from the rest."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo.adjust.equations import Equations, Problem, free_columns
from jaxgeo.adjust.layout import Group


class Eliminated(eqx.Module):
    """Points factored: `factor` (6, rows) the lower triangles L of their normal matrices L L', `halves` (c, 3, obs) of
    images and (lenses, 3, rows) of lenses the couplings times L'^-1, `forward` (3, rows) the gradients L^-1 g."""

    factor: Float[Array, "6 rows"]
    halves: Float[Array, "c 3 obs"]
    shared_halves: Float[Array, "lenses 3 rows"]
    forward: Float[Array, "3 rows"]


class Reduced(eqx.Module):
    """The normal equations of images and what they share, the points eliminated: `matrix` (N, N), `gradient` (N,)."""

    matrix: Float[Array, "N N"]
    gradient: Float[Array, " N"]


def eliminated(problem: Problem, equations: Equations, damping: Any) -> Eliminated:
    """Factors of the points' normal matrices, their diagonals larger by the share `damping`."""
    V = equations.points * (1.0 + damping * jnp.eye(3)[:, :, None])
    factor = _cholesky_3(V)
    rows = problem.layout.row
    of_obs = [f[rows] for f in factor]
    return Eliminated(
        jnp.stack(factor),
        times_inverse(of_obs, equations.coupling),
        times_inverse(factor, equations.shared_coupling),
        _forward(factor, equations.point_gradient),
    )


def reduced(problem: Problem, equations: Equations, points: Eliminated, damping: Any) -> Reduced:
    """The reduced system; its diagonal, too, is larger by the share `damping`, and one where columns are fixed."""
    n, c, s = problem.n, problem.of_image, problem.shared
    images = equations.images * (1.0 + damping * jnp.eye(c))
    shared = equations.shared * (1.0 + damping * jnp.eye(s))
    free_images, free_shared = free_columns(problem)
    matrix = jnp.zeros((n + 1, c, n + 1, c)) if not _dense(problem) else jnp.zeros((n, c, n, c))
    each = jnp.arange(n)
    matrix = matrix.at[each, :, each, :].add(images + jnp.eye(c) * (1.0 - free_images)[:, :, None])
    border, corner = equations.images_shared, shared + jnp.diag(1.0 - free_shared)
    gradient, shared_gradient = equations.image_gradient, equations.shared_gradient
    for group in problem.layout.groups:
        state = (matrix, border, corner, gradient, shared_gradient)
        matrix, border, corner, gradient, shared_gradient = _less_points(problem, group, points, state)
    N = n * c
    matrix = matrix[:n, :, :n, :].reshape(N, N)
    border = border.reshape(N, s)
    whole = jnp.block([[matrix, border], [border.T, corner]]) if s else matrix
    return Reduced(whole, jnp.concatenate([gradient.reshape(-1), shared_gradient]))


def back_substituted(problem: Problem, points: Eliminated, images: Any, shared: Any) -> Float[Array, "3 rows"]:
    """Steps of the points from those (n, c) of the images and (s,) of what they share."""
    layout = problem.layout
    along = jnp.sum(points.halves * images.T[:, layout.image][:, None], axis=0)  # (3, obs)
    found = []
    for group in layout.groups:
        part = along[:, group.first : group.first + group.rays * group.rows]
        found.append(jnp.sum(part.reshape(3, group.rays, group.rows), axis=1))
    total = jnp.concatenate(found, axis=-1) + points.forward
    if problem.of_lenses:
        total = total + jnp.einsum("air,a->ir", points.shared_halves, shared[: problem.of_lenses])
    return -backward(points.factor, total)


def chunk_rows(problem: Problem, group: Group, points: Eliminated) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """(rows (chunks, size * 3, q c + lenses) of the coupling times L'^-1, forward (chunks, size * 3)) of a group."""
    c, lenses = problem.of_image, problem.of_lenses
    part = points.halves[:, :, group.first : group.first + group.rays * group.rows]
    part = part.reshape(c, 3, group.rays, group.chunks, group.size)
    part = jnp.transpose(part, (3, 4, 1, 2, 0))  # chunks, size, 3, rays, c
    part = jnp.concatenate([part, jnp.zeros((*part.shape[:3], 1, c))], axis=3)
    rows = jnp.take_along_axis(part, group.ray_of_slot[:, :, None, :, None], axis=3)  # chunks, size, 3, q, c
    rows = rows.reshape(group.chunks, group.size * 3, -1)
    own = slice(group.first_row, group.first_row + group.rows)
    if lenses:
        of_lenses = points.shared_halves[:, :, own].reshape(lenses, 3, group.chunks, group.size)
        of_lenses = jnp.transpose(of_lenses, (2, 3, 1, 0)).reshape(group.chunks, group.size * 3, lenses)
        rows = jnp.concatenate([rows, of_lenses], axis=-1)
    forward = points.forward[:, own].reshape(3, group.chunks, group.size)
    return rows, jnp.transpose(forward, (1, 2, 0)).reshape(group.chunks, group.size * 3)


def _less_points(problem: Problem, group: Group, points: Eliminated, state: Any) -> Any:
    """The reduced system less what the points of a group take from it."""
    c, lenses = problem.of_image, problem.of_lenses
    # Left to itself, the compiler would gather the rows once for each side of the product.
    rows, forward = jax.lax.optimization_barrier(chunk_rows(problem, group, points))
    q = group.slots.shape[1]

    def one(state: Any, chunk: Any) -> tuple[Any, None]:
        matrix, border, corner, gradient, shared_gradient = state
        slots, D, y = chunk
        square, along = jax.lax.dot_general(D, D, (((0,), (0,)), ((), ()))), y @ D
        images = square[: q * c, : q * c].reshape(q, c, q, c)
        if group.dense:
            matrix, gradient = matrix - images, gradient - along[: q * c].reshape(q, c)
        else:
            at = (slots[:, None], jnp.arange(c)[None, :])
            matrix = matrix.at[
                at[0][:, :, None, None], at[1][:, :, None, None], at[0][None, None], at[1][None, None]
            ].add(-images, mode="drop")
            gradient = gradient.at[slots].add(-along[: q * c].reshape(q, c), mode="drop")
        if lenses:
            mixed = square[: q * c, q * c :].reshape(q, c, lenses)
            border = border.at[slots, :, :lenses].add(-mixed, mode="drop")
            corner = corner.at[:lenses, :lenses].add(-square[q * c :, q * c :])
            shared_gradient = shared_gradient.at[:lenses].add(-along[q * c :])
        return (matrix, border, corner, gradient, shared_gradient), None

    if group.chunks == 1:
        return one(state, (group.slots[0], rows[0], forward[0]))[0]
    return jax.lax.scan(one, state, (group.slots, rows, forward))[0]


def _dense(problem: Problem) -> bool:
    return problem.layout.groups[0].dense


def _cholesky_3(V: Float[Array, "3 3 rows"]) -> tuple[Array, ...]:
    """Lower triangle (l00, l10, l20, l11, l21, l22) of many symmetric matrices at once; NaN where not positive."""
    l00 = jnp.sqrt(V[0, 0])
    l10, l20 = V[1, 0] / l00, V[2, 0] / l00
    l11 = jnp.sqrt(V[1, 1] - l10 * l10)
    l21 = (V[2, 1] - l20 * l10) / l11
    return l00, l10, l20, l11, l21, jnp.sqrt(V[2, 2] - l20 * l20 - l21 * l21)


def times_inverse(factor: Any, coupling: Float[Array, "c 3 many"]) -> Float[Array, "c 3 many"]:
    """Coupling times L'^-1, that is L^-1 applied to each of its rows."""
    l00, l10, l20, l11, l21, l22 = factor
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
