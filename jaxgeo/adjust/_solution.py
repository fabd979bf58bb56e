"""Least-squares point from image residuals, and its error propagation."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import all_finite, safe_norm
from jaxgeo._typing import Matrix3, Scalar, Vector3
from jaxgeo.adjust._least_squares import minimize
from jaxgeo.adjust.rays import Image, Residuals, Stacked, design_of, inverse_of
from jaxgeo.earth import Atmosphere

# # Gauss-Newton steps. Each reduces the error by about the ratio of residual to focal length, which for a gross error
# may be a fifth.
STEPS = 16
LONGEST_STEP = 0.5  # of the shortest slant range

Root = Float[Array, "..."]  # of the weights: (2 rays,), or (2 rays, 2 rays) where residuals are correlated


class WeightedImages(NamedTuple):
    """Inputs of the solution: images (leading axis), root of the weights, and atmosphere."""

    images: Image
    root: Root
    air: Atmosphere | None


def ranges_of(images: Image, p_ecef: Vector3) -> Float[Array, " rays"]:
    """Distances from each perspective centre to a point, m."""
    return jax.vmap(lambda centre: safe_norm(p_ecef - centre))(images.sight.centre)


def least_squares_point(weighted: WeightedImages, start: Vector3, solver: Any = None) -> tuple[Vector3, Scalar]:
    """(the point of least weighted squares, ECEF m; length of the last step, m, infinite if the solver failed).

    By `STEPS` Gauss-Newton steps or by a `solver` of optimistix, whose last step is the Gauss-Newton step from its
    result: a result that is no minimum has a long one, whatever the solver reports.
    """
    still, begin = jax.lax.stop_gradient((weighted, start))
    if solver is None:
        p_ecef, step = jax.lax.fori_loop(0, STEPS, lambda _, state: _improve(still, state[0]), (begin, jnp.zeros(())))
    else:
        found, converged = minimize(_residuals, solver, begin, still)
        p_ecef = jnp.where(all_finite(found), found, begin)
        step = jnp.where(converged & all_finite(found), safe_norm(_gauss_newton_step(still, p_ecef)), jnp.inf)
    return _least(p_ecef, weighted), step


def _improve(weighted: WeightedImages, p_ecef: Vector3) -> tuple[Vector3, Scalar]:
    """(point after a Gauss-Newton step of limited length; length of the whole step, m)."""
    step = _gauss_newton_step(weighted, p_ecef)
    length = safe_norm(step)
    images = weighted.images
    longest = LONGEST_STEP * jnp.min(jnp.where(images.used, ranges_of(images, p_ecef), jnp.inf))
    share = jnp.where(length > longest, longest / jnp.where(length > 0.0, length, 1.0), 1.0)
    return p_ecef + share * step, length


def _gauss_newton_step(weighted: WeightedImages, p_ecef: Vector3) -> Vector3:
    design, residuals = (_whiten(weighted.root, part) for part in design_of(weighted.images, p_ecef, weighted.air))
    inverse, _ = inverse_of(design.T @ design)
    return -inverse @ (design.T @ residuals)


def _residuals(p_ecef: Vector3, weighted: WeightedImages) -> Float[Array, " rows"]:
    """Whitened residuals; their derivatives neglect those of the refraction shift, as those of `design_of`."""

    def residual(image: Image) -> Float[Array, "2"]:
        shift = jax.lax.stop_gradient(image.seeming(p_ecef, weighted.air) - p_ecef)
        return image.residual_of(p_ecef + shift)[0]

    return _whiten(weighted.root, jax.vmap(residual)(weighted.images))


def _whiten(root: Root, stacked: Float[Array, "..."]) -> Float[Array, "..."]:
    """Residuals (rays, 2), or their derivatives (rays, 2, 3), stacked and in units of sigmas."""
    flat = stacked.reshape(root.shape[0], *stacked.shape[2:])
    if root.ndim == 2:
        return root @ flat
    return root * flat if flat.ndim == 1 else root[:, None] * flat


def _gradient(p_ecef: Vector3, weighted: WeightedImages) -> Vector3:
    """Gradient of the least-squares cost, zero at the solution: whitened residuals times their derivatives."""
    design, residuals = (_whiten(weighted.root, part) for part in design_of(weighted.images, p_ecef, weighted.air))
    return design.T @ residuals


@jax.custom_jvp
def _least(p_ecef: Vector3, weighted: WeightedImages) -> Vector3:
    """`p_ecef` at a zero of the gradient, with derivatives by the implicit function theorem."""
    return p_ecef


@_least.defjvp
def _(primals, tangents):
    """dp = -(d gradient / dp)^-1 d gradient, at a point that itself moves under further differentiation."""
    p_ecef, weighted = primals
    p_ecef = _least(p_ecef, weighted)
    _, change = jax.jvp(lambda weighted: _gradient(p_ecef, weighted), (weighted,), (tangents[1],))
    inverse, _ = inverse_of(jax.jacfwd(_gradient)(p_ecef, weighted))
    return p_ecef, -inverse @ change


def spread_of(
    weighted: WeightedImages, errors: tuple[Root, Stacked] | None, p_ecef: Vector3, residuals: Residuals
) -> tuple[Matrix3, Scalar]:
    """(covariance of the point in ECEF, m2; chi-square of the residuals), under the given errors.

    The chi-square is the minimum over all points, to first order.
    """
    derivatives, _ = design_of(weighted.images, p_ecef, weighted.air)
    design = _whiten(weighted.root, derivatives)
    inverse, _ = inverse_of(design.T @ design)
    if errors is None:
        return inverse, jnp.sum(_whiten(weighted.root, residuals) ** 2)
    root, cov = errors
    estimator = inverse @ (design.T * weighted.root[None, :] if weighted.root.ndim == 1 else design.T @ weighted.root)
    across, misfit = _whiten(root, derivatives), _whiten(root, residuals)
    along = across.T @ misfit
    normal_inverse, _ = inverse_of(across.T @ across)
    chi_square = jnp.sum(misfit**2) - along @ normal_inverse @ along
    return estimator @ cov @ estimator.T, chi_square
