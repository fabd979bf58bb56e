"""Tie point errors of map and terrain, and their propagation into the image."""

from __future__ import annotations

import abc
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64, check_is, check_range, concrete
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField
from jaxgeo.adjust.losses import AbstractLoss
from jaxgeo.register.block_means import covariances_of_means, variances_of_means
from jaxgeo.register.ties import PaddedTies, TiePoints
from jaxgeo.uncertainty.sources import TerrainField

FAINT = 1e-12  # lower bound of the weights: a weight of zero would divide by zero

Rows = Float[Array, "ties 2 columns"]
Blocks = Float[Array, "ties 2 2"]
Pixels = Float[Array, "ties 2"]
Weights = Float[Array, " ties"]


class TieErrors(Record):
    """Standard deviations in m of reference and terrain, in addition to the covariance of each match.

    `registration` is independent for each tie, the same along east and north; `terrain` is the elevation model's height
    error, independent for each tie: that of its point, or of the mean over its block. `terrain_field` is a spatially
    correlated part of the height errors, stated for points, which correlates ties. Over the matched blocks of ties with
    `TiePoints.sides`, as those of `register_image`, it is averaged: it counts whole where its correlation length is
    much longer than a block, and by its integral over the plane divided by the block's area where it is much shorter.
    White noise of single posts h m apart is one with a Gaussian variogram of the length h / sqrt(pi). `shift` is the
    common map shift (map position = true position + shift), the same along east and north: it is estimated with the
    navigation errors unless it is zero.
    """

    registration: ScalarField = 0.0
    terrain: ScalarField = 0.0
    shift: ScalarField = 0.0
    terrain_field: TerrainField | None = None


class AbstractTiePropagation(Record):
    """Propagation of a tie's map position error into the image."""

    @abc.abstractmethod
    def along(self, by_surface: Blocks, by_enu: Float[Array, "ties 2 3"]) -> Blocks:
        """Derivatives of the pixels by the map positions, to the east and north.

        `by_surface` are those along the terrain's surface, `by_enu` those by east, north, up in space.
        """


class FullJacobian(AbstractTiePropagation):
    """Displacement along the terrain: on slopes, a map error causes a height error too."""

    def along(self, by_surface: Blocks, by_enu: Float[Array, "ties 2 3"]) -> Blocks:
        del by_enu
        return by_surface


class LevelGround(AbstractTiePropagation):
    """Displacement on level ground.

    Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation", Eq 6: applies the coordinate
    transformation itself to the map error instead of the chain of its derivatives.
    """

    def along(self, by_surface: Blocks, by_enu: Float[Array, "ties 2 3"]) -> Blocks:
        del by_surface
        return by_enu[:, :, :2]


class AbstractWhitener(Record):
    """Whitening of tie rows by a root of their error covariance."""

    @abc.abstractmethod
    def __call__(self, rows: Rows) -> Float[Array, "numbers columns"]:
        """Rows scaled to independent errors of unit standard deviation."""


class Independent(AbstractWhitener):
    """Whitener of independent ties: the inverse root of each one's covariance."""

    root: Blocks

    def __call__(self, rows: Rows) -> Float[Array, "numbers columns"]:
        return jnp.einsum("tij,tjk->tik", self.root, rows).reshape(-1, rows.shape[2])


class Alike(AbstractWhitener):
    """Whitener of correlated ties: the lower root of their joint covariance."""

    lower: Float[Array, "numbers numbers"]

    def __call__(self, rows: Rows) -> Float[Array, "numbers columns"]:
        return jax.scipy.linalg.solve_triangular(self.lower, rows.reshape(-1, rows.shape[2]), lower=True)


class Sensitivity(Record):
    """Derivatives of the ties' pixels by the map position (east, north) and the height, px/m."""

    by_place: Blocks
    by_height: Pixels


def checked_tie_errors(errors: Any, ties: TiePoints) -> TieErrors:
    """Validated tie errors in float64.

    Raises `TypeError` for anything else, `ValueError` for a standard deviation that is negative or not finite, and for
    ties without any error.
    """
    check_is(errors, TieErrors, "tie_errors")
    for name in ("registration", "terrain", "shift"):
        check_range(getattr(errors, name), f"tie_errors.{name}", "m", 0.0, 1e9)
    if errors.terrain_field is not None:
        check_is(errors.terrain_field, TerrainField, "tie_errors.terrain_field")
        errors.terrain_field.check_numbers()
    errors = as_float64(errors, "tie_errors")
    of_ties, registration, pixel = map(concrete, (ties.covariance, errors.registration, ties.pixel_sigma))
    if of_ties is None or registration is None or pixel is None or pixel > 0.0:
        return errors
    place = of_ties + registration**2 * np.eye(2)
    exact = place[:, 0, 0] * place[:, 1, 1] - place[:, 0, 1] * place[:, 1, 0] <= 0.0
    if exact.any():
        raise ValueError(
            f"tie {int(exact.argmax())} has no error along some direction of the map, nor in the image; give a "
            "registration in m, a covariance in m2, or a pixel_sigma in px."
        )
    return errors


def tie_covariances(ties: PaddedTies, errors: TieErrors, sensitivity: Sensitivity) -> Blocks:
    """Covariance in px2 of each tie's residual without navigation errors; the identity for unused ties."""
    place = ties.covariance + jnp.asarray(errors.registration) ** 2 * jnp.eye(2)[None, :, :]
    by_place, by_height = sensitivity.by_place, sensitivity.by_height
    total = jnp.einsum("tij,tjk,tlk->til", by_place, place, by_place)
    variance = height_variances(errors, ties)
    total = total + variance[:, None, None] * by_height[:, :, None] * by_height[:, None, :]
    total = total + ties.pixel_sigma**2 * jnp.eye(2)[None, :, :]
    return jnp.where(ties.used[:, None, None], total, jnp.eye(2)[None, :, :])


def height_variances(errors: TieErrors, ties: PaddedTies) -> Float[Array, " ties"]:
    """Variance in m2 of the terrain height of each tie, or of its mean over the tie's block."""
    field, count = errors.terrain_field, ties.used.shape[0]
    variance = jnp.full(count, 1.0) * jnp.asarray(errors.terrain) ** 2
    if field is None:
        return variance
    if ties.sides is None:
        return variance + field.variance_at(jnp.zeros(()))
    return variance + variances_of_means(field, ties.sides)


def height_covariances(
    field: TerrainField, p_ecef: Float[Array, "ties 3"], sides_ecef: Float[Array, "ties 3 2"] | None
) -> Float[Array, "ties ties"]:
    """Covariance in m2 of the correlated height errors at ties, or of their means over the ties' blocks."""
    if sides_ecef is not None:
        return covariances_of_means(field, p_ecef, sides_ecef)
    squared = jnp.sum((p_ecef[:, None, :] - p_ecef[None, :, :]) ** 2, axis=2)
    return field.variance_at(jnp.sqrt(squared))


def inverse_roots(cov: Blocks) -> Blocks:
    """L^-1 of every L L' = cov, lower."""
    a = jnp.sqrt(cov[:, 0, 0])
    b = cov[:, 1, 0] / a
    c = jnp.sqrt(jnp.maximum(cov[:, 1, 1] - b**2, 1e-30 * cov[:, 1, 1]))
    zero = jnp.zeros_like(a)
    return jnp.stack([jnp.stack([1.0 / a, zero], axis=1), jnp.stack([-b / (a * c), 1.0 / c], axis=1)], axis=1)


def robust_weights(loss: AbstractLoss, roots: Blocks, residuals: Pixels, ties: PaddedTies) -> Weights:
    """Weight of each tie by the length of its standardised residual; zero if unused."""
    squared = jnp.sum(jnp.einsum("tij,tj->ti", roots, residuals) ** 2, axis=1)
    return jnp.where(ties.used, loss.weight(squared), 0.0)


def whitener(
    cov: Blocks,
    roots: Blocks,
    weights: Weights,
    ties: PaddedTies,
    heights: Float[Array, "ties ties"] | None,
    by_height: Pixels,
) -> AbstractWhitener:
    """Whitener of ties with the given covariances, each divided by the tie's weight.

    `heights` in m2 are the covariances between the heights of ties, None for independent ones. The added variance is
    independent for each tie: a wrong match is uncorrelated with its neighbours.
    """
    if heights is None:
        return Independent(roots * jnp.sqrt(weights)[:, None, None])
    count = ties.used.shape[0]
    apart = ties.used[:, None] & ties.used[None, :] & ~jnp.eye(count, dtype=bool)
    alike = jnp.where(apart, heights, 0.0)
    total = alike[:, None, :, None] * by_height[:, :, None, None] * by_height[None, None, :, :]
    own = cov / jnp.maximum(jnp.where(ties.used, weights, 1.0), FAINT)[:, None, None]
    numbers = jnp.arange(count)
    total = total.at[numbers, :, numbers, :].add(own)
    return Alike(jnp.linalg.cholesky(total.reshape(2 * count, 2 * count)))


def information_of(rows: Float[Array, "numbers columns"]) -> Float[Array, "columns columns"]:
    """Information matrix of the columns from whitened rows."""
    return rows.T @ rows


def squared_length(rows: Float[Array, "numbers columns"]) -> Scalar:
    """Sum of all squares."""
    return jnp.sum(rows**2)
