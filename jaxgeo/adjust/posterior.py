"""Unit-weight covariances after an adjustment: images, shared parameters, points and measurements."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._blas_threads import one_thread
from jaxgeo._compile import sized_filter_jit
from jaxgeo._record import Record
from jaxgeo.adjust.arrays import Problem, free_columns
from jaxgeo.adjust.banded import Factor, Tridiagonal, factored, selected_inverse
from jaxgeo.adjust.equations import Equations
from jaxgeo.adjust.layout import Group
from jaxgeo.adjust.losses import AbstractLoss
from jaxgeo.adjust.measurements import image_points
from jaxgeo.adjust.reduction import (
    Eliminated,
    along_points,
    backward_rows,
    condensed,
    places,
    rows_of,
    solve_reduced,
    times_inverse,
    undamped,
)
from jaxgeo.adjust.values import Values
from jaxgeo.adjust.weak_datum import Motions, Weak, apart, weakly_held, with_holds


class Datum(Record):
    """Inner constraints: the unconstrained motions, of images (d, n, c) and points (d, 3, rows)."""

    images: Float[Array, "d n c"]
    points: Float[Array, "d 3 rows"]


class Posterior(Record):
    """The factored reduced normal equations, their inverse at the block pattern, and the points' factors.

    With a `datum`, factor and inverse are those of minimal constraints; results are transformed to inner constraints.
    With a `weak`ly constrained datum, they are those of the block fixed at some images, and the motions of the whole
    are added.
    """

    factor: Factor
    inverse: Tridiagonal
    points: Eliminated
    datum: Datum | None
    weak: Weak | None = None


@one_thread()
def posterior_of(
    problem: Problem, equations: Equations, datum: Datum | None, values: Values | None = None
) -> Posterior:
    """The inverse of the reduced normal equations; NaN where they are singular.

    With the `values` of the equations, weakly constrained motions of the whole are separated.
    """
    points, matrix = undamped(problem, equations)
    motions = None if values is None else weakly_held(problem, values, equations, matrix)
    if motions is None:
        return jax.block_until_ready(Posterior(*_inverse(problem, matrix, datum), points, datum))
    return jax.block_until_ready(
        _apart(problem, points, with_holds(problem, matrix, motions, datum is not None), motions, datum)
    )


@sized_filter_jit
def _apart(
    problem: Problem, points: Eliminated, matrix: Tridiagonal, motions: Motions, datum: Datum | None
) -> Posterior:
    factor = factored(matrix)
    weak = Weak.of(motions, apart(problem, points, factor, motions))
    return Posterior(factor, selected_inverse(factor), points, datum, weak)


@sized_filter_jit
def _inverse(problem: Problem, matrix: Tridiagonal, datum: Datum | None) -> tuple[Factor, Tridiagonal]:
    if datum is not None:  # any weights on the motions make it regular and leave the results unchanged
        matrix = held(problem, matrix, datum)
    factor = factored(matrix)
    return factor, selected_inverse(factor)


def held(problem: Problem, matrix: Tridiagonal, datum: Datum) -> Tridiagonal:
    """The matrix with the motions constrained at the middle slab's images, each with about the weight of the
    diagonal."""
    band, middle = problem.layout.band, problem.layout.band.slabs // 2
    motions = jax.vmap(band.to_slabs)(datum.images)[:, middle]
    scaled = motions * jnp.diagonal(matrix.diagonal[middle])[None, :]
    weighted = scaled.T @ (scaled / jnp.sum(motions * scaled, axis=1)[:, None])
    return eqx.tree_at(lambda m: m.diagonal, matrix, matrix.diagonal.at[middle].add(weighted))


@sized_filter_jit
def least_share(problem: Problem, posterior: Posterior) -> Float[Array, ""]:
    """Smallest ratio of an unknown's marginal to its conditional weight.

    Not positive where the system is singular. With a weakly constrained datum, that of the block fixed at some images.
    """
    posterior = eqx.tree_at(lambda p: p.weak, posterior, None, is_leaf=lambda x: x is None)
    variances = jnp.diagonal(covariance_of_images(problem, posterior), axis1=1, axis2=2)
    scales = problem.layout.band.of_images(posterior.factor.scale), posterior.factor.scale_shared
    pairs = zip(scales, (variances, jnp.diagonal(covariance_of_shared(problem, posterior))), strict=True)
    free = jnp.concatenate([x.ravel() for x in free_columns(problem)])
    share = jnp.concatenate([(scale**2 / variance).ravel() for scale, variance in pairs])
    share = jnp.where(free > 0.0, share, 1.0)
    return jnp.min(jnp.where(jnp.isfinite(share), share, 0.0))  # the minimum of many may ignore NaN


@sized_filter_jit
def covariance_of_images(problem: Problem, posterior: Posterior) -> Float[Array, "n c c"]:
    """Covariance of each image's own columns; zero for fixed ones."""
    covariance = _of_images(problem, posterior.inverse)
    if posterior.weak is not None:
        covariance = covariance + jnp.einsum("dni,dnj->nij", posterior.weak.images, posterior.weak.images)
    if posterior.datum is None:
        return covariance
    transfer = _Transfer.of(problem, posterior)
    G, H = (jnp.moveaxis(x, 1, 0) for x in (posterior.datum.images, transfer.of_images))  # (n, d, c)
    return _transferred(transfer, covariance, G, H)


@sized_filter_jit
def covariance_of_shared(problem: Problem, posterior: Posterior) -> Float[Array, "s s"]:
    """Covariance of the shared parameters, the same in every datum; zero for fixed ones."""
    _, free = free_columns(problem)
    covariance = posterior.inverse.corner * free[:, None] * free[None, :]
    return covariance if posterior.weak is None else covariance + posterior.weak.shared.T @ posterior.weak.shared


@sized_filter_jit
def covariance_of_reduced(problem: Problem, posterior: Posterior) -> Float[Array, "N N"]:
    """Covariance of images, in their order, and shared parameters; zero for fixed ones."""
    images, shared = free_columns(problem)
    free = jnp.concatenate([images.ravel(), shared])
    N, s, c = images.size, shared.size, problem.of_image
    if problem.layout.band.slabs == 1:
        own, border = posterior.inverse.diagonal[0], posterior.inverse.border[0]
        covariance = jnp.block([[own, border], [border.T, posterior.inverse.corner]])
    else:
        eye = jnp.eye(N + s)
        whole = jax.vmap(lambda one, other: solve_reduced(problem, posterior.factor, one, other))
        found = whole(eye[:, :N].reshape(-1, problem.n, c), eye[:, N:])
        covariance = jnp.concatenate([found[0].reshape(N + s, N), found[1]], axis=1)
        covariance = 0.5 * (covariance + covariance.T)
    covariance = covariance * free[:, None] * free[None, :]
    if posterior.weak is not None:
        U = jnp.concatenate([posterior.weak.images.reshape(-1, N), posterior.weak.shared], axis=1)
        covariance = covariance + U.T @ U
    if posterior.datum is None:
        return covariance
    transfer = _Transfer.of(problem, posterior)
    G = jnp.pad(posterior.datum.images.reshape(-1, N), ((0, 0), (0, s)))
    H = jnp.concatenate([transfer.of_images.reshape(-1, N), transfer.of_shared], axis=1)
    return _transferred(transfer, covariance, G, H)


@sized_filter_jit
def covariance_of_functions(
    problem: Problem, posterior: Posterior, images: Float[Array, "d n c"], shared: Float[Array, "d s"]
) -> Float[Array, "d d"]:
    """Covariance of linear functions of the unknowns, by their derivatives for each image's own columns and for the
    shared parameters. Without inner constraints."""
    assert posterior.datum is None
    of_images, of_shared = free_columns(problem)
    images, shared = images * of_images[None], shared * of_shared[None]
    found = jax.vmap(lambda one, other: solve_reduced(problem, posterior.factor, one, other))(images, shared)
    total = jnp.einsum("dnc,enc->de", images, found[0]) + shared @ found[1].T
    if posterior.weak is not None:
        along = jnp.einsum("knc,dnc->kd", posterior.weak.images, images) + posterior.weak.shared @ shared.T
        total = total + along.T @ along
    return 0.5 * (total + total.T)


@sized_filter_jit
def covariance_of_points(problem: Problem, posterior: Posterior) -> Float[Array, "rows 3 3"]:
    """Covariance of each point, m2."""
    found = [_by_chunks(problem, group, posterior, rays=False)[0] for group in problem.layout.groups]
    covariance = _between(posterior.points.factor, jnp.eye(3)[None] + jnp.concatenate(found))
    if posterior.weak is not None:
        covariance = covariance + jnp.einsum("dir,djr->rij", posterior.weak.points, posterior.weak.points)
    if posterior.datum is None:
        return covariance
    transfer = _Transfer.of(problem, posterior)
    G, H = (jnp.moveaxis(x, -1, 0) for x in (posterior.datum.points, transfer.of_points))  # (rows, d, 3)
    return _transferred(transfer, covariance, G, H)


@sized_filter_jit
def leverages(problem: Problem, values: Values, loss: AbstractLoss, posterior: Posterior) -> Float[Array, "obs 2 2"]:
    """Leverage of each image point in measurement units, J Q J'; the same in every datum."""
    layout = problem.layout
    _, by_point, by_pose, by_lens, _ = image_points(problem, values, loss)
    own = jnp.concatenate([by_pose, by_lens], axis=1)  # lens columns belong to the image or to its camera
    own, by_point = (jnp.moveaxis(x, -1, 0) for x in (own, by_point))  # (obs, 2, columns)
    factor = layout.to_rays(posterior.points.factor)
    half = jnp.moveaxis(times_inverse(factor, jnp.moveaxis(by_point, 0, -1)), -1, 0)  # J_p L'^-1
    inner, spread = [], []
    for group in layout.groups:
        of_points, of_rays = _by_chunks(problem, group, posterior, rays=True)
        inner.append(of_points)
        spread.append(of_rays)
    columns = own.shape[-1]
    of_rays = jnp.concatenate([*spread, jnp.zeros((1, 3, columns))])
    of_points = jnp.eye(3)[None] + jnp.concatenate(inner)[layout.row]
    blocks = _with_lens(problem, posterior)[layout.image]
    mixed = jnp.einsum("oai,oic,obc->oab", half, of_rays, own)
    total = jnp.einsum("oai,oij,obj->oab", own, blocks, own) + jnp.einsum("oai,oij,obj->oab", half, of_points, half)
    total = total - mixed - jnp.swapaxes(mixed, 1, 2)
    if posterior.weak is None:
        return total
    along = _along_measurements(problem, posterior.weak, own, by_point)
    return total + jnp.einsum("doa,dob->oab", along, along)


def _along_measurements(problem: Problem, weak: Weak, own: Array, by_point: Array) -> Float[Array, "7 obs 2"]:
    """Changes of the image points by the motions of a weakly constrained datum, each of one standard deviation."""
    layout, lenses = problem.layout, weak.shared[:, : problem.of_lenses]
    images = weak.images[:, layout.image]
    if problem.of_lenses:
        lenses = lenses.reshape(7, -1, len(problem.active))[:, layout.camera[layout.image]]
        images = jnp.concatenate([images, lenses], axis=2)
    points = weak.points[:, :, layout.row]
    return jnp.einsum("oac,doc->doa", own, images) + jnp.einsum("oai,dio->doa", by_point, points)


def _by_chunks(problem: Problem, group: Group, posterior: Posterior, rays: bool) -> tuple[Array, Array]:
    """(D Q D' (rows, 3, 3), D Q (rays * rows, 3, columns)) of a group's points, D their half couplings.

    The second only on request: for the columns of each ray's image and lens, in the order of measurements.
    """
    layout, c, a = problem.layout, problem.of_image, len(problem.active)
    last = layout.image.shape[0] - 1
    rows = rows_of(problem, group, posterior.points).joined()
    part = slice(group.first, group.first + group.rays * group.rows)
    camera = layout.camera[layout.image[part]].reshape(group.rays, group.chunks, group.size)
    Q, band = posterior.inverse, layout.band
    whole = _together(problem, Q, Q.diagonal[0], Q.border[0]) if group.dense else None
    apart = jnp.concatenate([Q.diagonal, Q.below]).reshape(-1, band.size, problem.of_image, band.size, problem.of_image)
    border = band.of_images(Q.border)

    def one(chunk: Any) -> tuple[Array, Array]:
        slots, D, measured, camera = chunk
        local = _local(problem, Q, apart, border, slots) if whole is None else whole
        spread = jnp.moveaxis((D @ local).reshape(3, group.size, -1), 0, 1)
        D = jnp.moveaxis(D.reshape(3, group.size, -1), 0, 1)
        inner = jnp.sum(D[:, :, None, :] * spread[:, None, :, :], axis=-1)
        if not rays:
            return inner, jnp.zeros(())
        q = slots.shape[0]
        by_slot = jnp.moveaxis(spread[:, :, : q * c].reshape(group.size, 3, q, c), 2, 1)
        point = jnp.arange(group.size)[:, None]
        ray = jnp.where(measured < last, (measured - group.first) // group.rows, group.rays)
        of_rays = jnp.zeros((group.size, group.rays + 1, 3, c)).at[point, ray].set(by_slot)[:, :-1]
        if problem.of_lenses:
            of_lenses = spread[:, :, q * c :].reshape(group.size, 3, -1, a)
            of_lens = jnp.moveaxis(of_lenses, 2, 1)[point, camera.T]  # (size, rays, 3, a)
            of_rays = jnp.concatenate([of_rays, of_lens], axis=-1)
        return inner, of_rays

    given = (group.slots, rows, group.measured, jnp.moveaxis(camera, 1, 0))
    inner, of_rays = jax.lax.map(one, given)
    inner = inner.reshape(group.rows, 3, 3)
    if not rays:
        return inner, of_rays
    of_rays = jnp.moveaxis(of_rays.reshape(group.rows, group.rays, 3, -1), 0, 1)
    return inner, of_rays.reshape(group.rays * group.rows, 3, -1)


def _of_images(problem: Problem, Q: Tridiagonal) -> Float[Array, "n c c"]:
    """Covariance of each image's own columns in the current datum; zero for fixed ones."""
    band, c, each = problem.layout.band, problem.of_image, jnp.arange(problem.layout.band.size)
    blocks = Q.diagonal.reshape(band.slabs, band.size, c, band.size, c)
    blocks = jnp.moveaxis(blocks[:, each, :, each, :], 0, 1).reshape(-1, c, c)
    free, _ = free_columns(problem)
    return (blocks if band.slabs == 1 else blocks[band.place]) * free[:, :, None] * free[:, None, :]


def _together(problem: Problem, Q: Tridiagonal, own: Array, border: Array) -> Float[Array, "k k"]:
    """Joint covariance of some images' columns and of the shared lenses."""
    lenses = problem.of_lenses
    border = border[:, :lenses]
    return jnp.block([[own, border], [border.T, Q.corner[:lenses, :lenses]]]) if lenses else own


def _local(
    problem: Problem,
    Q: Tridiagonal,
    blocks: Float[Array, "blocks size c size c"],
    border: Float[Array, "n c s"],
    slots: Int[Array, " q"],
) -> Float[Array, "k k"]:
    """Covariance of a chunk's images and of the lenses; zero for unused slots and for image pairs without common
    points. `blocks` are those of Q, `border` its part between images and shared parameters."""
    band, c, q = problem.layout.band, problem.of_image, slots.shape[0]
    lower = blocks.at[places(band, slots, c)].get(mode="fill", fill_value=0.0).reshape(q * c, q * c)
    slab = jnp.repeat(band.place[jnp.minimum(slots, problem.n - 1)] // band.size, c)
    own = lower + jnp.where(slab[:, None] < slab[None, :], lower.T, 0.0)
    return _together(problem, Q, own, border.at[slots].get(mode="fill", fill_value=0.0).reshape(q * c, border.shape[2]))


def _with_lens(problem: Problem, posterior: Posterior) -> Float[Array, "n k k"]:
    """Covariance of each image's own columns, with those of a shared lens, in the current datum."""
    own = _of_images(problem, posterior.inverse)
    if not problem.of_lenses:
        return own
    a, Q = len(problem.active), posterior.inverse
    at = problem.layout.camera[:, None] * a + jnp.arange(a)[None, :]  # (n, a)
    border = problem.layout.band.of_images(Q.border)  # (n, c, s)
    mixed = jnp.take_along_axis(border, at[:, None, :], axis=2)
    corner = Q.corner[at[:, :, None], at[:, None, :]]
    return jnp.concatenate(
        [jnp.concatenate([own, mixed], axis=2), jnp.concatenate([jnp.swapaxes(mixed, 1, 2), corner], axis=2)], axis=1
    )


def _transferred(transfer: _Transfer, covariance: Array, G: Array, H: Array) -> Array:
    """Covariance (..., k, k) under inner constraints, from parts (..., d, k) of the motions and of G_s' Q."""
    moved = jnp.einsum("...di,de,...ej->...ij", G, transfer.inverse, H)
    return covariance - moved - jnp.swapaxes(moved, -1, -2) + jnp.einsum("...di,de,...ej->...ij", G, transfer.middle, G)


class _Transfer(Record):
    """S-transformation from any minimal constraints to inner constraints (Baarda 1973).

    With the motions G of all unknowns and G_s of the points, which define the datum: `inverse` is (G_s' G)^-1,
    `of_images`, `of_shared` and `of_points` are the parts of G_s' Q, `middle` is inverse G_s' Q G_s inverse.
    """

    inverse: Float[Array, "d d"]
    of_images: Float[Array, "d n c"]
    of_shared: Float[Array, "d s"]
    of_points: Float[Array, "d 3 rows"]
    middle: Float[Array, "d d"]

    @classmethod
    def of(cls, problem: Problem, posterior: Posterior) -> _Transfer:
        assert posterior.datum is not None
        G, points, factor = posterior.datum.points, posterior.points, posterior.points.factor
        half = times_inverse(factor, G)  # L^-1 G of each point
        images, corner = condensed(problem, points, half)  # (L^-1 G)' D, summed over the points
        of_images, of_shared = jax.vmap(lambda x, y: solve_reduced(problem, posterior.factor, x, y))(
            images, corner
        )  # F Q
        along = along_points(problem, points, of_images, of_shared)  # (F Q) D' of each point, (d, 3, rows)
        of_points = backward_rows(factor, half + along)
        if posterior.weak is not None:
            weak = posterior.weak
            part = jnp.einsum("dir,eir->de", G, weak.points)
            of_images = of_images - jnp.einsum("de,enc->dnc", part, weak.images)
            of_shared = of_shared - part @ weak.shared
            of_points = of_points + jnp.einsum("de,eir->dir", part, weak.points)
        inverse = jnp.linalg.inv(jnp.einsum("dir,eir->de", G, G))
        middle = jnp.einsum("dir,eir->de", of_points, G)
        return cls(inverse, -of_images, -of_shared, of_points, inverse @ (0.5 * (middle + middle.T)) @ inverse)


def _between(factor: Any, inner: Float[Array, "rows 3 3"]) -> Float[Array, "rows 3 3"]:
    """L'^-1 inner L^-1 of each point."""
    once = backward_rows(factor, jnp.moveaxis(inner, 0, -1))  # rows of inner times L^-1
    return jnp.moveaxis(backward_rows(factor, jnp.swapaxes(once, 0, 1)), -1, 0)
