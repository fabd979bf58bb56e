"""Least-squares point from image residuals, and its error propagation."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import safe_norm
from jaxgeo._typing import Matrix3, Scalar, Vector3
from jaxgeo.adjust.rays import Image, Residuals, Stacked, design_of, inverse_of
from jaxgeo.earth import Atmosphere

# # Gauss-Newton steps. Each reduces the error by about the ratio of residual to focal length, which for a gross error
# may be a fifth.
STEPS = 16
LONGEST_STEP = 0.5  # of the shortest slant range

Root = Float[Array, "..."]  # of the weights: (2 rays,), or (2 rays, 2 rays) where residuals are correlated


class Seen(NamedTuple):
    """Inputs of the solution: images (leading axis), root of the weights, and atmosphere."""

    images: Image
    root: Root
    air: Atmosphere | None


def ranges_of(images: Image, p_ecef: Vector3) -> Float[Array, " rays"]:
    """Distances from each perspective centre to a point, m."""
    return jax.vmap(lambda centre: safe_norm(p_ecef - centre))(images.sight.centre)


def solved(seen: Seen, start: Vector3) -> tuple[Vector3, Scalar]:
    """(the point of least weighted squares, ECEF m; length of the last step, m)."""
    still, begin = jax.lax.stop_gradient((seen, start))

    def improved(_: Any, state: tuple[Vector3, Scalar]) -> tuple[Vector3, Scalar]:
        p_ecef, _ = state
        design, residuals = (_whitened(still.root, part) for part in design_of(still.images, p_ecef, still.air))
        inverse, _ = inverse_of(design.T @ design)
        step = -inverse @ (design.T @ residuals)
        length = safe_norm(step)
        longest = LONGEST_STEP * jnp.min(jnp.where(still.images.used, ranges_of(still.images, p_ecef), jnp.inf))
        share = jnp.where(length > longest, longest / jnp.where(length > 0.0, length, 1.0), 1.0)
        return p_ecef + share * step, length

    p_ecef, step = jax.lax.fori_loop(0, STEPS, improved, (begin, jnp.zeros(())))
    return _least(p_ecef, seen), step


def _whitened(root: Root, stacked: Float[Array, "..."]) -> Float[Array, "..."]:
    """Residuals (rays, 2), or their derivatives (rays, 2, 3), stacked and in units of sigmas."""
    flat = stacked.reshape(root.shape[0], *stacked.shape[2:])
    if root.ndim == 2:
        return root @ flat
    return root * flat if flat.ndim == 1 else root[:, None] * flat


def _slope(p_ecef: Vector3, seen: Seen) -> Vector3:
    """Gradient of the least-squares cost, zero at the solution: whitened residuals times their derivatives."""
    design, residuals = (_whitened(seen.root, part) for part in design_of(seen.images, p_ecef, seen.air))
    return design.T @ residuals


@jax.custom_jvp
def _least(p_ecef: Vector3, seen: Seen) -> Vector3:
    """`p_ecef` at a zero of the gradient, with derivatives by the implicit function theorem."""
    return p_ecef


@_least.defjvp
def _(primals, tangents):
    """dp = -(d slope / dp)^-1 d slope, at a point that itself moves under further differentiation."""
    p_ecef, seen = primals
    p_ecef = _least(p_ecef, seen)
    _, change = jax.jvp(lambda seen: _slope(p_ecef, seen), (seen,), (tangents[1],))
    inverse, _ = inverse_of(jax.jacfwd(_slope)(p_ecef, seen))
    return p_ecef, -inverse @ change


def spread_of(
    seen: Seen, errors: tuple[Root, Stacked] | None, p_ecef: Vector3, residuals: Residuals
) -> tuple[Matrix3, Scalar]:
    """(covariance of the point in ECEF, m2; chi-square of the residuals), under the given errors.

    The chi-square is the minimum over all points, to first order.
    """
    derivatives, _ = design_of(seen.images, p_ecef, seen.air)
    design = _whitened(seen.root, derivatives)
    inverse, _ = inverse_of(design.T @ design)
    if errors is None:
        return inverse, jnp.sum(_whitened(seen.root, residuals) ** 2)
    root, cov = errors
    estimator = inverse @ (design.T * seen.root[None, :] if seen.root.ndim == 1 else design.T @ seen.root)
    across, misfit = _whitened(root, derivatives), _whitened(root, residuals)
    along = across.T @ misfit
    normal_inverse, _ = inverse_of(across.T @ across)
    chi_square = jnp.sum(misfit**2) - along @ normal_inverse @ along
    return estimator @ cov @ estimator.T, chi_square
