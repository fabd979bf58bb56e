"""Covariances after an adjustment, of unit weight: of images and what they share, of points, of measurements."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo.adjust.equations import Equations, Problem, free_columns
from jaxgeo.adjust.equations import image_points as weighted_image_points
from jaxgeo.adjust.layout import Group
from jaxgeo.adjust.losses import AbstractLoss
from jaxgeo.adjust.reduction import Eliminated, Rows, backward, eliminate, gather, reduced, rows_of, times_inverse
from jaxgeo.adjust.values import Values


class Datum(eqx.Module):
    """Inner constraints: the motions that nothing holds, of the reduced unknowns (d, N) and the points (d, 3, rows)."""

    reduced: Float[Array, "d N"]
    points: Float[Array, "d 3 rows"]


class Posterior(eqx.Module):
    """Covariance (N, N) of images and what they share, points eliminated, and the points' factors; `information` (N,)
    is the diagonal of what was inverted.

    With a `datum` both are of minimal constraints; what is asked of them is turned into that of the inner ones.
    """

    covariance: Float[Array, "N N"]
    information: Float[Array, " N"]
    points: Eliminated
    datum: Datum | None


def posterior_of(problem: Problem, equations: Equations, datum: Datum | None) -> Posterior:
    """The inverse of the reduced normal equations; NaN where they are singular."""
    points = eliminate(problem, equations, jnp.zeros(()))
    return Posterior(*_inverse(problem, equations, gather(problem, points), datum), points, datum)


@eqx.filter_jit
def _inverse(
    problem: Problem, equations: Equations, rows: tuple[Rows, ...], datum: Datum | None
) -> tuple[Float[Array, "N N"], Float[Array, " N"]]:
    system = reduced(problem, equations, rows, 0.0).matrix
    if datum is not None:  # any weights on the motions make it regular, and change nothing else
        system = system + _weighted(datum.reduced, system)
    scale = 1.0 / jnp.sqrt(jnp.diagonal(system))
    factor = jax.scipy.linalg.cho_factor(system * scale[:, None] * scale[None, :], lower=True)
    inverse = jax.scipy.linalg.cho_solve(factor, jnp.eye(system.shape[0]))
    return inverse * scale[:, None] * scale[None, :], jnp.diagonal(system)


def _weighted(motions: Float[Array, "d N"], system: Float[Array, "N N"]) -> Float[Array, "N N"]:
    """Outer products of the motions, each with about the weight of the system's parts."""
    weight = jnp.diagonal(system)
    scaled = motions * weight[None, :]
    return scaled.T @ (scaled / jnp.sum(motions * scaled, axis=1)[:, None])


@eqx.filter_jit
def covariance_of_reduced(problem: Problem, posterior: Posterior) -> Float[Array, "N N"]:
    """Covariance of images and what they share; zero for what is fixed."""
    images, shared = free_columns(problem)
    free = jnp.concatenate([images.ravel(), shared])
    covariance = posterior.covariance * free[:, None] * free[None, :]
    if posterior.datum is None:
        return covariance
    transfer = _Transfer.of(problem, posterior)
    G, H = posterior.datum.reduced, transfer.of_reduced
    moved = G.T @ (transfer.inverse @ H)
    return covariance - moved - moved.T + G.T @ (transfer.middle @ G)


@eqx.filter_jit
def covariance_of_points(problem: Problem, posterior: Posterior) -> Float[Array, "rows 3 3"]:
    """Covariance of each point, m2."""
    found = [_by_chunks(problem, group, posterior, rays=False)[0] for group in problem.layout.groups]
    covariance = _between(posterior.points.factor, jnp.eye(3)[None] + jnp.concatenate(found))
    if posterior.datum is None:
        return covariance
    transfer = _Transfer.of(problem, posterior)
    G, H = (jnp.moveaxis(x, -1, 0) for x in (posterior.datum.points, transfer.of_points))  # (rows, d, 3)
    moved = jnp.einsum("rdi,de,rej->rij", G, transfer.inverse, H)
    return covariance - moved - jnp.swapaxes(moved, 1, 2) + jnp.einsum("rdi,de,rej->rij", G, transfer.middle, G)


@eqx.filter_jit
def leverages(problem: Problem, values: Values, loss: AbstractLoss, posterior: Posterior) -> Float[Array, "obs 2 2"]:
    """Covariance of each adjusted image point in units of that measured, J Q J'; the same in every datum."""
    layout, c, n = problem.layout, problem.of_image, problem.n
    _, by_point, by_pose, by_lens, _ = weighted_image_points(problem, values, loss)
    own = jnp.concatenate([by_pose, by_lens], axis=1)  # lenses are an image's own, or have columns of their camera
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
    blocks = _own_blocks(problem, posterior.covariance, n, c)[layout.image]
    mixed = jnp.einsum("oai,oic,obc->oab", half, of_rays, own)
    total = jnp.einsum("oai,oij,obj->oab", own, blocks, own) + jnp.einsum("oai,oij,obj->oab", half, of_points, half)
    return total - mixed - jnp.swapaxes(mixed, 1, 2)


def _by_chunks(problem: Problem, group: Group, posterior: Posterior, rays: bool) -> tuple[Array, Array]:
    """(D Q D' (rows, 3, 3), D Q (rays * rows, 3, columns)) of a group's points, D their half couplings.

    The second, of the columns of each ray's image and its lens, only if asked for; in the order of measurements.
    """
    layout, c, a = problem.layout, problem.of_image, len(problem.active)
    last = layout.image.shape[0] - 1
    rows = rows_of(problem, group, posterior.points).joined()
    part = slice(group.first, group.first + group.rays * group.rows)
    camera = layout.camera[layout.image[part]].reshape(group.rays, group.chunks, group.size)

    def one(chunk: Any) -> tuple[Array, Array]:
        slots, D, measured, camera = chunk
        spread = jnp.moveaxis(
            (D @ _local(problem, posterior.covariance, slots, group.dense)).reshape(3, group.size, -1), 0, 1
        )
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


def _local(problem: Problem, Q: Float[Array, "N N"], slots: Any, dense: bool) -> Float[Array, "k k"]:
    """Rows and columns of the covariance of a chunk's images and of the lenses; zero for slots that hold none."""
    n, c, lenses = problem.n, problem.of_image, problem.of_lenses
    N = n * c
    if dense:  # all of them, in order
        return Q[: N + lenses, : N + lenses]
    there = jnp.repeat(slots < n, c)
    at = jnp.where(there, (jnp.minimum(slots, n - 1)[:, None] * c + jnp.arange(c)[None, :]).reshape(-1), 0)
    at = jnp.concatenate([at, N + jnp.arange(lenses)])
    there = jnp.concatenate([there, jnp.ones(lenses, bool)])
    return jnp.where(there[:, None] & there[None, :], Q[at[:, None], at[None, :]], 0.0)


def _own_blocks(problem: Problem, Q: Float[Array, "N N"], n: int, c: int) -> Float[Array, "n k k"]:
    """Covariance of each image's own columns, with those of its lens where that is shared."""
    N, a, each = n * c, len(problem.active), jnp.arange(n)
    at = each[:, None] * c + jnp.arange(c)[None, :]
    if problem.of_lenses:
        at = jnp.concatenate([at, N + problem.layout.camera[:, None] * a + jnp.arange(a)[None, :]], axis=1)
    return Q[at[:, :, None], at[:, None, :]]


class _Transfer(eqx.Module):
    """What turns covariances of any minimal constraints into those of the inner ones (S-transformation, Baarda 1973).

    With the motions G of all unknowns and G_s those of the points, which make the datum: `inverse` (G_s' G)^-1,
    `of_reduced` and `of_points` the parts of G_s' Q, `middle` inverse G_s' Q G_s inverse.
    """

    inverse: Float[Array, "d d"]
    of_reduced: Float[Array, "d N"]
    of_points: Float[Array, "d 3 rows"]
    middle: Float[Array, "d d"]

    @classmethod
    def of(cls, problem: Problem, posterior: Posterior) -> _Transfer:
        assert posterior.datum is not None
        G, factor = posterior.datum.points, posterior.points.factor
        n, c, lenses = problem.n, problem.of_image, problem.of_lenses
        half = times_inverse(factor, G)  # L^-1 G of each point
        images, corner = jnp.zeros((G.shape[0], n, c)), jnp.zeros((G.shape[0], lenses))
        for group in problem.layout.groups:  # F = sum of (L^-1 G)' D over the points
            rows = rows_of(problem, group, posterior.points).joined()
            own = half[:, :, group.first_row : group.first_row + group.rows]
            own = own.reshape(-1, 3, group.chunks, group.size)
            own = jnp.moveaxis(own, 1, 2).reshape(-1, group.chunks, 3 * group.size)
            sums = jnp.einsum("dkr,krm->kdm", own, rows)
            q = group.slots.shape[1]
            by_slot = jnp.moveaxis(sums[:, :, : q * c].reshape(group.chunks, -1, q, c), 1, 2)
            images = images.at[:, group.slots].add(jnp.moveaxis(by_slot, 2, 0), mode="drop")
            corner = corner + jnp.sum(sums[:, :, q * c :], axis=0)
        F = jnp.concatenate([images.reshape(G.shape[0], -1), corner], axis=1)
        F = jnp.pad(F, ((0, 0), (0, posterior.covariance.shape[0] - F.shape[1])))
        of_reduced = -F @ posterior.covariance
        spread = F @ posterior.covariance
        along = _along_points(problem, posterior, spread)  # (F Q) D' of each point, (d, 3, rows)
        of_points = _backward_rows(factor, half + along)
        inverse = jnp.linalg.inv(jnp.einsum("dir,eir->de", G, G))
        middle = jnp.einsum("dir,eir->de", of_points, G)
        return cls(inverse, of_reduced, of_points, inverse @ (0.5 * (middle + middle.T)) @ inverse)


def _along_points(problem: Problem, posterior: Posterior, v: Float[Array, "d N"]) -> Float[Array, "d 3 rows"]:
    """Rows of the reduced space times D' of each point."""
    n, c, lenses = problem.n, problem.of_image, problem.of_lenses
    images = v[:, : n * c].reshape(-1, n, c)
    layout = problem.layout
    along = jnp.einsum("doc,ioc->dio", images[:, layout.image], posterior.points.halves)
    found = []
    for group in layout.groups:
        part = along[:, :, group.first : group.first + group.rays * group.rows]
        found.append(jnp.sum(part.reshape(-1, 3, group.rays, group.rows), axis=2))
    total = jnp.concatenate(found, axis=-1)
    return total + jnp.einsum("da,air->dir", v[:, n * c : n * c + lenses], posterior.points.shared_halves)


def _between(factor: Any, inner: Float[Array, "rows 3 3"]) -> Float[Array, "rows 3 3"]:
    """L'^-1 inner L^-1 of each point."""
    once = _backward_rows(factor, jnp.moveaxis(inner, 0, -1))  # rows of inner times L^-1
    return jnp.moveaxis(_backward_rows(factor, jnp.swapaxes(once, 0, 1)), -1, 0)


def _backward_rows(factor: Any, v: Float[Array, "k 3 rows"]) -> Float[Array, "k 3 rows"]:
    """Each of k vectors times L^-1, that is L'^-1 applied to it."""
    return jax.vmap(lambda row: backward(factor, row))(v)
