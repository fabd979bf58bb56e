"""Bordered block-tridiagonal systems: slabs of images coupled with the next slab, and shared parameters as border.

With one slab the system is dense. With many, the factorisation time grows with their number, not with its cube, and the
diagonal and subdiagonal blocks of the inverse are computed without the rest (Takahashi, Fagan and Chin 1973).
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgeo._record import Record

LEAST_SLABS = 4  # with fewer the gain does not repay the overhead


class Band(Record):
    """Slab position of each image: `place` (n,) is slab * `size` + the index within. Images that share a point are
    in the same slab or in adjacent ones."""

    place: Int[Array, " n"]
    slabs: int = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def to_slabs(self, of_images: Float[Array, "n c *k"]) -> Float[Array, "slabs m *k"]:
        """Image values arranged in slabs; zero in unused positions."""
        shape = (self.slabs, self.size * of_images.shape[1], *of_images.shape[2:])
        if self.slabs == 1:
            return of_images.reshape(shape)
        filled = jnp.zeros((self.slabs * self.size, *of_images.shape[1:]))
        filled = filled.at[self.place].set(of_images, unique_indices=True)
        return filled.reshape(shape)

    def of_images(self, slabs: Float[Array, "slabs m *k"]) -> Float[Array, "n c *k"]:
        """The inverse of `to_slabs`."""
        c = slabs.shape[1] // self.size
        found = slabs.reshape(self.slabs * self.size, c, *slabs.shape[2:])
        return found if self.slabs == 1 else found[self.place]


class Tridiagonal(Record):
    """A symmetric matrix: diagonal blocks `diagonal` (slabs, m, m), subdiagonal blocks `below` (slabs - 1, m, m) of
    each slab (columns) with the next (rows), `border` (slabs, m, s) with the shared parameters, `corner` (s, s) of
    these.
    """

    diagonal: Float[Array, "slabs m m"]
    below: Float[Array, "less m m"]
    border: Float[Array, "slabs m s"]
    corner: Float[Array, "s s"]

    @property
    def own(self) -> tuple[Float[Array, "slabs m"], Float[Array, " s"]]:
        """Entries of the diagonal."""
        return jnp.diagonal(self.diagonal, axis1=1, axis2=2), jnp.diagonal(self.corner)

    def scaled(self, slabs: Float[Array, "slabs m"], shared: Float[Array, " s"]) -> Tridiagonal:
        """Rows and columns multiplied by the given factors."""
        return Tridiagonal(
            self.diagonal * slabs[:, :, None] * slabs[:, None, :],
            self.below * slabs[1:, :, None] * slabs[:-1, None, :],
            self.border * slabs[:, :, None] * shared[None, None, :],
            self.corner * shared[:, None] * shared[None, :],
        )


class Factor(Record):
    """Cholesky factor of a symmetric positive definite matrix, scaled to a unit diagonal: diagonal blocks `own`,
    subdiagonal blocks `below`, `border` (slabs, m, s) transposed for the shared parameters, and `corner`."""

    own: Float[Array, "slabs m m"]
    below: Float[Array, "less m m"]
    border: Float[Array, "slabs m s"]
    corner: Float[Array, "s s"]
    scale: Float[Array, "slabs m"]
    scale_shared: Float[Array, " s"]

    def solve(
        self, slabs: Float[Array, "slabs m k"], shared: Float[Array, "s k"]
    ) -> tuple[Float[Array, "slabs m k"], Float[Array, "s k"]]:
        """Inverse of the matrix times k columns."""
        right, last = slabs * self.scale[:, :, None], shared * self.scale_shared[:, None]
        forward = self._forward(right)
        last = _lower(self.corner, last - jnp.einsum("ams,amk->sk", self.border, forward))
        last = _upper(self.corner, last)
        found = self._backward(forward - self.border @ last)
        return found * self.scale[:, :, None], last * self.scale_shared[:, None]

    def _forward(self, right: Float[Array, "slabs m k"]) -> Float[Array, "slabs m k"]:
        first = _lower(self.own[0], right[0])
        if not len(self.below):
            return first[None]

        def one(before: Any, slab: Any) -> Any:
            L, W, r = slab
            found = _lower(L, r - W @ before)
            return found, found

        _, others = jax.lax.scan(one, first, (self.own[1:], self.below, right[1:]))
        return jnp.concatenate([first[None], others])

    def _backward(self, right: Float[Array, "slabs m k"]) -> Float[Array, "slabs m k"]:
        last = _upper(self.own[-1], right[-1])
        if not len(self.below):
            return last[None]

        def one(after: Any, slab: Any) -> Any:
            L, W, r = slab
            found = _upper(L, r - W.T @ after)
            return found, found

        _, others = jax.lax.scan(one, last, (self.own[:-1], self.below, right[:-1]), reverse=True)
        return jnp.concatenate([others, last[None]])


def factored(matrix: Tridiagonal) -> Factor:
    """Cholesky factor; NaN where the matrix is not positive definite."""
    scale, scale_shared = (1.0 / jnp.sqrt(x) for x in matrix.own)
    A = matrix.scaled(scale, scale_shared)
    first = jnp.linalg.cholesky(A.diagonal[0], symmetrize_input=False)
    along = _lower(first, A.border[0])
    own, below, border = first[None], A.below, along[None]
    if len(A.below):

        def one(before: Any, slab: Any) -> Any:
            (L, Y), (D, low, B) = before, slab
            W = _lower(L, low.T).T
            L = jnp.linalg.cholesky(D - W @ W.T, symmetrize_input=False)
            Y = _lower(L, B - W @ Y)
            return (L, Y), (L, W, Y)

        _, (others, below, alongs) = jax.lax.scan(one, (first, along), (A.diagonal[1:], A.below, A.border[1:]))
        own, border = jnp.concatenate([own, others]), jnp.concatenate([border, alongs])
    left = A.corner - jnp.einsum("ams,amt->st", border, border)
    return Factor(own, below, border, jnp.linalg.cholesky(left, symmetrize_input=False), scale, scale_shared)


def selected_inverse(factor: Factor) -> Tridiagonal:
    """Blocks of the inverse at the matrix's own block pattern; with one slab, the whole inverse."""
    eye = jnp.eye(factor.own.shape[1])
    corner = _lower(factor.corner, jnp.eye(factor.corner.shape[0]))
    corner = corner.T @ corner
    last = _lower(factor.own[-1], eye)
    last = last.T @ last
    diagonal, below = last[None], factor.below
    if len(factor.below):

        def one(after: Any, slab: Any) -> Any:
            L, W = slab
            inverse = _lower(L, eye)
            G = W @ inverse
            low = -(after @ G)
            own = inverse.T @ inverse - G.T @ low
            own = 0.5 * (own + own.T)
            return own, (own, low)

        _, (others, below) = jax.lax.scan(one, last, (factor.own[:-1], factor.below), reverse=True)
        diagonal = jnp.concatenate([others, last[None]])
    along = factor._backward(factor.border)  # inverse of the slab part times the border
    spread = along @ corner
    diagonal = diagonal + spread @ jnp.swapaxes(along, 1, 2)
    below = below + spread[1:] @ jnp.swapaxes(along[:-1], 1, 2)
    return Tridiagonal(diagonal, below, -spread, corner).scaled(factor.scale, factor.scale_shared)


def band_of(image: np.ndarray, point: np.ndarray, n: int) -> Band:
    """A bandwidth-reducing order of the images, in the smallest slabs that keep connected images adjacent.

    From the image and point numbers of all measurements, by the reverse Cuthill-McKee (1969) order. One slab in the
    original order if the images are too strongly connected for a gain.
    """
    import scipy  # submodules load lazily

    ones = np.ones(len(image), np.int32)
    incidence = scipy.sparse.csr_array((ones, (image, point)), shape=(n, int(point.max()) + 1))
    shared = (incidence @ incidence.T).tocoo()
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(shared.tocsr(), symmetric_mode=True)
    place = np.empty(n, int)
    place[order] = np.arange(n)
    one, other = place[shared.row], place[shared.col]
    least, size = 1, max(1, int(np.max(np.abs(one - other))))  # bandwidth: always a valid slab size
    for tried in range(least, size):
        if int(np.max(np.abs(one // tried - other // tried))) <= 1:
            size = tried
            break
    slabs = -(-n // size)
    if slabs < LEAST_SLABS:
        return one_slab(n)
    return Band(jnp.asarray(place, jnp.int32), slabs, size)


def one_slab(n: int) -> Band:
    """All images in one slab, in their original order."""
    return Band(jnp.arange(n, dtype=jnp.int32), 1, n)


def _lower(L: Float[Array, "m m"], right: Float[Array, "m k"]) -> Float[Array, "m k"]:
    """L^-1 times columns."""
    return jax.scipy.linalg.solve_triangular(L, right, lower=True)


def _upper(L: Float[Array, "m m"], right: Float[Array, "m k"]) -> Float[Array, "m k"]:
    """L'^-1 times columns."""
    return jax.scipy.linalg.solve_triangular(L, right, lower=True, trans=1)
