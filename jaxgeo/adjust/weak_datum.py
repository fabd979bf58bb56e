"""Weakly constrained datum: motions of the whole block separated from the other normal equations.

Image points fit equally well wherever the whole block lies. The observations that fix the datum may weigh 1e12 times
less and would be lost in the rounding of a sum. With the motions G, which leave image points unchanged, N G = K depends
on the other observations only and is computed without that loss. With the block fixed at some images by H with H' G =
1, the normal equations M = N + H H' are as well conditioned as those of a free network, and

    N^-1 = M^-1 + (G - F) S^-1 (G - F)',    F = M^-1 K,    S = G' K - K' F,

where S is the marginal weight of the motions.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import sized_filter_jit
from jaxgeo._record import Record
from jaxgeo.adjust.arrays import Problem
from jaxgeo.adjust.banded import Band, Factor, Tridiagonal
from jaxgeo.adjust.datum import Whole, observed_whole
from jaxgeo.adjust.equations import Equations
from jaxgeo.adjust.observing import Observing
from jaxgeo.adjust.reduction import Eliminated, along_points, backward_rows, condensed, solve_reduced, times_inverse
from jaxgeo.adjust.values import Values
from jaxgeo.rotations import R_from_rotation_vector

WEAK = 1e-5  # relative to the weight of image points in a motion's components: weaker motions are separated
SEEN = 1e-8  # share of a motion's weight at the middle slabs that must remain after orthogonalisation


class Motions(Record):
    """Constrained motions G (7, n, c), (7, 3, rows), `combos` of `MOTIONS`, scaled to unit weight at the images of the
    middle slabs, and `holds` H there (7, k, m).

    `K` is N G of images, shared parameters and points; `weight` is G' K, `of_parts` that of the image components alone
    without correlations, `gradient` is G' b. Motions that are unconstrained or not separable there are zero, with 0 in
    `kept`; those of the datum, with 1 in `free`, are zero in all but `holds`.
    """

    images: Float[Array, "7 n c"]
    points: Float[Array, "7 3 rows"]
    combos: Float[Array, "7 7"]
    holds: Float[Array, "7 k m"]
    K: tuple[Float[Array, "7 n c"], Float[Array, "7 s"], Float[Array, "7 3 rows"]]
    weight: Float[Array, "7 7"]
    of_parts: Float[Array, "7"]
    gradient: Float[Array, "7"]
    kept: Float[Array, "7"]
    free: Float[Array, "7"]
    middle: Float[Array, "3"]
    size: Float[Array, ""]

    @property
    def own(self) -> Float[Array, "7"]:
        """The weight of each motion, 1 for those not kept."""
        return jnp.diagonal(self.weight) + (1.0 - self.kept)


class Apart(Record):
    """Contribution of the motions to the inverse of M: G - F (7, n, c), (7, s), (7, 3, rows), F, and S."""

    images: Float[Array, "7 n c"]
    shared: Float[Array, "7 s"]
    points: Float[Array, "7 3 rows"]
    F: tuple[Float[Array, "7 n c"], Float[Array, "7 s"], Float[Array, "7 3 rows"]]
    S: Float[Array, "7 7"]


class Weak(Record):
    """Motions of a weakly constrained datum: U of images, shared parameters and points, where N^-1 = M^-1 + U' U,
    and the system they come from. NaN where S is singular."""

    images: Float[Array, "7 n c"]
    shared: Float[Array, "7 s"]
    points: Float[Array, "7 3 rows"]
    motions: Motions
    apart: Apart

    @classmethod
    def of(cls, motions: Motions, found: Apart) -> Weak:
        scale = 1.0 / jnp.sqrt(motions.own)
        lower = jnp.linalg.cholesky(found.S * scale[:, None] * scale[None, :])

        def one(x: Array) -> Array:
            flat = (scale * motions.kept)[:, None] * x.reshape(7, -1)
            return jax.scipy.linalg.solve_triangular(lower, flat, lower=True).reshape(x.shape)

        return cls(one(found.images), one(found.shared), one(found.points), motions, found)


def weakly_held(problem: Problem, values: Values, equations: Equations, matrix: Tridiagonal) -> Motions | None:
    """The motions of the whole if any is weakly constrained in the (reduced) normal equations, else None."""
    nothing = problem.observed is None and problem.terrain is None and not bool(jnp.any(problem.known_point != 0.0))
    if nothing or problem.effects is not None:  # those change pixels when the whole moves
        return None
    motions = motions_apart(problem, values, equations, matrix)
    return motions if are_weak(motions) else None


def motions_apart(problem: Problem, values: Values, equations: Equations, matrix: Tridiagonal) -> Motions:
    """The constrained motions, scaled by the reduced normal equations."""
    observed, whole = observed_whole(problem, values, equations.control_root)
    return _motions_apart(problem, equations.images, matrix, observed, whole)


@sized_filter_jit
def _motions_apart(
    problem: Problem, of_images: Float[Array, "n c c"], matrix: Tridiagonal, observed: Observing, whole: Whole
) -> Motions:
    combos = whole.combos * (whole.held + whole.free)[:, None]
    images, points = (jnp.einsum("dm,m...->d...", combos, x) for x in (whole.images, whole.points))
    band, (first, count) = problem.layout.band, _slabs(problem.layout.band)
    own = jax.vmap(band.to_slabs)(images)[:, first : first + count].reshape(7, -1)
    w = jnp.diagonal(matrix.diagonal[first : first + count], axis1=1, axis2=2).reshape(-1)
    C, there = _orthonormal(own, w)
    holds = ((C @ own) * w[None]).reshape(7, count, -1)
    free = whole.free * there
    kept = whole.held * there
    images, points = (jnp.einsum("dm,m...->d...", C * kept[:, None], x) for x in (images, points))
    rows = observed.flat(images, points)
    return Motions(
        images,
        points,
        (C * kept[:, None]) @ combos,
        holds * (kept + free)[:, None, None],
        observed.normal(images, points),
        rows @ rows.T,
        jnp.sum(images**2 * jnp.diagonal(of_images, axis1=1, axis2=2)[None], axis=(1, 2)),
        rows @ observed.residuals,
        kept,
        free,
        whole.middle,
        whole.size,
    )


def are_weak(motions: Motions) -> bool:
    """Whether any motion is weakly constrained."""
    kept, weight, of_parts = (np.asarray(x) for x in (motions.kept, motions.weight, motions.of_parts))
    return bool(np.any((kept > 0.0) & (np.diagonal(weight) < WEAK * of_parts)))


def _slabs(band: Band) -> tuple[int, int]:
    """(first, number) of the slabs at which M fixes the motions."""
    return band.slabs // 2 - (band.slabs > 1), min(band.slabs, 2)


def _orthonormal(rows: Float[Array, "7 k"], weight: Float[Array, " k"]) -> tuple[Array, Array]:
    """(lower triangular coefficients (7, 7) of combinations of the rows that are orthonormal with weights; 1 for
    those that exist)."""

    def one_more(i: Array, made: tuple[Array, Array]) -> tuple[Array, Array]:
        found, there = made
        own = jnp.eye(7)[i]
        before = jnp.sum(weight * rows[i] ** 2)
        for _ in range(2):  # reorthogonalise once
            row = own @ rows
            own = own - (found @ rows @ (weight * row)) @ found
        row = own @ rows
        after = jnp.sum(weight * row**2)
        exists = (before > 0.0) & (after > SEEN * before)
        own = jnp.where(exists, own / jnp.sqrt(jnp.where(exists, after, 1.0)), 0.0)
        return found.at[i].set(own), there.at[i].set(exists.astype(jnp.float64))

    return jax.lax.fori_loop(0, 7, one_more, (jnp.zeros((7, 7)), jnp.zeros(7)))


def with_holds(problem: Problem, matrix: Tridiagonal, motions: Motions, datum: bool) -> Tridiagonal:
    """M: the reduced normal equations with the motions fixed, those of the datum too if requested."""
    first, count = _slabs(problem.layout.band)
    H = motions.holds * (motions.kept + motions.free * datum)[:, None, None]
    own = jnp.einsum("dki,dkj->kij", H, H)
    diagonal = matrix.diagonal.at[first : first + count].add(own)
    below = matrix.below
    if count > 1:
        below = below.at[first].add(H[:, 1].T @ H[:, 0])
    return Tridiagonal(diagonal, below, matrix.border, matrix.corner)


def at_holds(problem: Problem, images: Float[Array, "n c"]) -> Float[Array, "k m"]:
    """The change of the images at which the motions are fixed."""
    first, count = _slabs(problem.layout.band)
    return problem.layout.band.to_slabs(images)[first : first + count]


def apart(problem: Problem, points: Eliminated, factor: Factor, motions: Motions, damping: Any = 0.0) -> Apart:
    """F and S from the factor of M."""
    K_images, K_shared, K_points = motions.K
    half = times_inverse(points.factor, K_points)
    from_images, from_shared = condensed(problem, points, half)
    right = K_images - from_images, K_shared - from_shared
    images, shared = jax.vmap(lambda z, s: solve_reduced(problem, factor, z, s))(*right)
    left = half - along_points(problem, points, images, shared)
    F = images, shared, backward_rows(points.factor, left) * problem.free_point.T[None]
    taken = sum((k.reshape(7, -1) @ f.reshape(7, -1).T for k, f in zip(motions.K, F, strict=True)), jnp.zeros((7, 7)))
    S = motions.weight + jnp.diag(damping * jnp.diagonal(motions.weight)) - 0.5 * (taken + taken.T)
    S = S + jnp.diag(1.0 - motions.kept)
    return Apart(motions.images - images, -shared, motions.points - F[2], F, S)


def share_left(weak: Weak) -> tuple[Array, Array]:
    """(eigenvalues (7,) of S in units of the motions' own weights, in ascending order; eigenvectors in rows)."""
    scale = 1.0 / jnp.sqrt(weak.motions.own)
    strengths, vectors = jnp.linalg.eigh(weak.apart.S * scale[:, None] * scale[None, :])
    return strengths, vectors.T * scale[None, :]


def moved_together(problem: Problem, values: Values, motions: Motions, size: Float[Array, "7"]) -> Values:
    """The values after finite motions of the whole, which leave pixels unchanged; fixed parameters stay."""
    x = size @ motions.combos
    turn, scale = x[3:6] / motions.size, x[6] / motions.size
    generator = jnp.zeros((4, 4)).at[:3, 3].set(x[:3])
    generator = generator.at[:3, :3].set(_cross_matrix(turn) + scale * jnp.eye(3))
    shift = _exponential(generator)[:3, 3]
    R, factor, middle = R_from_rotation_vector(turn), jnp.exp(scale), motions.middle

    def placed(p: Array) -> Array:
        return (middle + shift)[None] + factor * (p - middle[None]) @ R.T

    free, own = problem.free_pose, problem.free_point
    centre = jnp.where(free[:, :3] > 0.0, placed(values.centre), values.centre)
    turned = jnp.where(
        free[:, 3:, None] > 0.0, jnp.einsum("ij,njk->nik", R, values.R_frame_from_camera), values.R_frame_from_camera
    )
    points = jnp.where(own > 0.0, placed(values.points), values.points)
    return eqx.tree_at(lambda v: (v.centre, v.R_frame_from_camera, v.points), values, (centre, turned, points))


def _cross_matrix(v: Float[Array, "3"]) -> Float[Array, "3 3"]:
    return jnp.cross(v[None], jnp.eye(3)).T


def _exponential(A: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """Exponential of a matrix of moderate size: ten series terms of its 64th part, squared six times."""
    X = A / 64.0
    total = term = jnp.eye(4)
    for k in range(1, 11):
        term = term @ X / k
        total = total + term
    for _ in range(6):
        total = total @ total
    return total
