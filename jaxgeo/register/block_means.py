"""Covariances of terrain height errors averaged over matched blocks (regularisation of a variogram)."""

from __future__ import annotations

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.uncertainty.sources import TerrainField

# A uniform window of unit side is represented by two Gaussians at +-CENTRE of standard deviation WIDTH. Both numbers
# follow from its variance, CENTRE^2 + WIDTH^2 = 1/12, and the integral of its square, 1: with these the mean is right
# where the correlation length is much longer than the side, and where it is much shorter.
WIDTH, CENTRE = 0.150932249220825, 0.246074764001667
# Weights and lengths (in ranges) of three Gaussians that represent a spherical variogram to 0.02 of its sill, and its
# integral over the plane to 0.04; fitted by least squares, with positive weights that sum to one.
SPHERICAL = ((0.04854, 0.02539), (0.15148, 0.12297), (0.79998, 0.50427))

Sides = Float[Array, "n 2 2"]


def variances_of_means(field: TerrainField, sides: Sides) -> Float[Array, " n"]:
    """Variances in m2 of a field's means over blocks with `sides`, as `covariances_of_means`."""
    return jax.vmap(lambda one: _covariances(field, jnp.zeros((1, 2)), one[None])[0, 0])(sides)


def covariances_of_means(
    field: TerrainField, p_ecef: Float[Array, "n 3"], sides_ecef: Float[Array, "n 3 2"]
) -> Float[Array, "n n"]:
    """Covariances in m2 of a field's means over blocks, parallelograms about points in ECEF, m.

    `sides_ecef` has the two sides of each as columns, m. The covariance of two means is the mean of the field's
    covariance over all pairs of their points (Journel and Huijbregts 1978, "Mining Geostatistics", section II.D), here
    with windows of four Gaussians for uniform ones, which makes the integral a sum: it differs from that of uniform
    squares by at most 0.004 of the sill, and their variance by at most 0.053 of itself (at a length of a tenth of the
    side). A spherical variogram is taken as a sum of Gaussians within 0.02 of its sill. All blocks are projected onto
    one plane, so that the matrix is positive semi-definite.
    """
    R = R_ecef_from_enu(WGS84.to_geodetic(p_ecef[0]))[:, :2]
    return _covariances(field, (p_ecef - p_ecef[:1]) @ R, jnp.einsum("ki,nkj->nij", R, sides_ecef))


def _covariances(field: TerrainField, centre: Float[Array, "n 2"], sides: Sides) -> Float[Array, "n n"]:
    window = WIDTH**2 * jnp.einsum("nik,njk->nij", sides, sides)
    spread = 2.0 * (window[:, None] + window[None])
    corners = CENTRE * np.array(list(itertools.product((-1.0, 1.0), repeat=2)))
    at = centre[None, :, :] + jnp.einsum("nij,kj->kni", sides, jnp.asarray(corners))
    pairs = np.array(list(itertools.product(range(len(corners)), repeat=2)))

    def added(total: Array, pair: Array) -> tuple[Array, None]:
        away = at[pair[0]][:, None, :] - at[pair[1]][None, :, :]
        return total + _smoothed(field, away, spread) / len(pairs), None

    count = centre.shape[0]
    return jax.lax.scan(added, jnp.zeros((count, count)), jnp.asarray(pairs))[0]


def _smoothed(field: TerrainField, away: Float[Array, "n n 2"], spread: Float[Array, "n n 2 2"]) -> Float[Array, "n n"]:
    """Expected covariance at points `away` apart, m, that are displaced by a Gaussian of covariance `spread` / 2."""
    total = jnp.zeros(away.shape[:-1])
    for variance, length in _gaussians(field):
        square = length**2
        a, b, c = spread[..., 0, 0] + square, spread[..., 0, 1], spread[..., 1, 1] + square
        det = a * c - b**2
        x, y = away[..., 0], away[..., 1]
        exponent = (c * x**2 - 2.0 * b * x * y + a * y**2) / det
        total = total + variance * square / jnp.sqrt(det) * jnp.exp(-exponent)
    return total


def _gaussians(field: TerrainField) -> list[tuple[Any, Any]]:
    """(variance in m2, length in m) of the Gaussian variograms that represent a field."""
    sigma, split = jnp.asarray(field.sigma), field.gaussian_lengths.shape[0]
    found = [(sigma[k] ** 2, field.gaussian_lengths[k]) for k in range(split)]
    for k in range(field.spherical_lengths.shape[0]):
        variance, length = sigma[split + k] ** 2, field.spherical_lengths[k]
        found += [(share * variance, scale * length) for share, scale in SPHERICAL]
    return found
