"""Terrain plane used in linear propagation: facet under the fix, fit over the footprint, or level."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import smaller
from jaxgeo._record import Record
from jaxgeo._typing import Index, Scalar, Vector3
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.metrics._ball import eigen
from jaxgeo.uncertainty.model_inputs import NominalFix

Points = Float[Array, "points 2"]
Swept = Float[Array, "3 axes"]
Raised = Float[Array, " axes"]
Covariance = Float[Array, "axes axes"]

RINGS, SPOKES = 6, 16  # of the sample points of a footprint, each of equal probability
ROUNDS = 2  # the second ellipse lies on the plane found with the first
NARROWEST = 0.02  # of a footprint's length, and m: smallest width from which the cross slope is estimated
STEEPEST = 0.02  # sine of the angle between ray and plane: lower limit, for planes nearly parallel to the ray


class Surface(NamedTuple):
    """Terrain plane near a fix, in east, north, up at the fix.

    The last component of `normal` is 1; the plane lies `above` m above the fix; `roughness` is the rms deviation of the
    ground from it in m; `known` is the share of sample points with known ground.
    """

    normal: Vector3
    above: Scalar
    roughness: Scalar
    known: Scalar


class Spread(NamedTuple):
    """Derivatives by the errors: the line of sight at the fix (m in east, north, up) and the terrain height (m)."""

    ray: Swept
    height: Raised
    cov_error: Covariance

    def on(self, surface: Surface, direction_enu: Vector3) -> Swept:
        """Derivatives of the intersection of the line of sight with a plane."""
        against = along_plane(surface.normal, direction_enu)
        along = direction_enu / against
        return self.ray - along[:, None] * (surface.normal @ self.ray - self.height)[None, :]


class AbstractSlope(Record):
    """Choice of the terrain plane for linear propagation."""

    @abstractmethod
    def surface(self, terrain: AbstractTerrain, nominal: NominalFix, facet: Vector3, spread: Spread) -> Surface:
        """The plane, given the normal of the facet under the fix."""


class Facet(AbstractSlope):
    """Tangent plane of the terrain at the fix: valid for errors smaller than a terrain cell."""

    def surface(self, terrain: AbstractTerrain, nominal: NominalFix, facet: Vector3, spread: Spread) -> Surface:
        del terrain, nominal, spread
        return _plane(facet)


class Level(AbstractSlope):
    """Horizontal plane at the height of the fix, as in studies with a constant height."""

    def surface(self, terrain: AbstractTerrain, nominal: NominalFix, facet: Vector3, spread: Spread) -> Surface:
        del terrain, nominal, facet, spread
        return _plane(jnp.array([0.0, 0.0, 1.0]))


class Footprint(AbstractSlope):
    """Plane fitted to the ground over the error ellipse.

    A regression of terrain heights at points of equal probability within the ellipse. The offset of the plane from the
    fix is a bias; the residuals of the ground add a height error (statistical linearisation).
    """

    def surface(self, terrain: AbstractTerrain, nominal: NominalFix, facet: Vector3, spread: Spread) -> Surface:
        del facet

        def fitted(_: Index, surface: Surface) -> Surface:
            swept = spread.on(surface, nominal.direction_enu)
            return fit_plane(terrain, nominal, (swept @ spread.cov_error @ swept.T)[:2, :2])

        # a loop, so that the fit is compiled once; it has no derivatives
        spread, nominal = jax.lax.stop_gradient((spread, nominal))
        return jax.lax.fori_loop(0, ROUNDS, fitted, _plane(jnp.array([0.0, 0.0, 1.0])))


def along_plane(normal: Vector3, direction_enu: Vector3) -> Scalar:
    """Product of a plane normal and the ray direction, bounded away from zero: the ray descends onto the plane."""
    return smaller(normal @ direction_enu, -STEEPEST * jnp.sqrt(normal @ normal))


def fit_plane(terrain: AbstractTerrain, nominal: NominalFix, cov: Float[Array, "2 2"]) -> Surface:
    """Plane fitted to a terrain over an error ellipse (m2, east and north) about a fix; no derivatives."""
    terrain, nominal, cov = jax.lax.stop_gradient((terrain, nominal, cov))
    axes, widths = _wide_ellipse(cov)
    root = axes * widths[None, :]
    places = _even_places()
    level = lambda place: nominal.p_ecef + nominal.R_ecef_from_enu[:, :2] @ (root @ place)  # noqa: E731
    heights, known = jax.vmap(lambda place: terrain.ground_above(level(place)))(places)
    weight = known.astype(jnp.float64)
    design = jnp.concatenate([jnp.ones((len(places), 1)), places], axis=1)
    normal_matrix = design.T @ (weight[:, None] * design) + 1e-9 * jnp.eye(3)
    above, *slopes = _solved(normal_matrix, design.T @ (weight * heights))
    slope = axes @ (jnp.stack(slopes) / widths)
    residual = heights - design @ jnp.stack([above, *slopes])
    share = jnp.mean(weight)
    roughness = jnp.sqrt(jnp.sum(weight * residual**2) / jnp.maximum(jnp.sum(weight), 1.0))
    return Surface(jnp.stack([-slope[0], -slope[1], jnp.asarray(1.0)]), above, roughness, share)


def _plane(normal: Vector3) -> Surface:
    zero = jnp.asarray(0.0)
    return Surface(normal, zero, zero, jnp.asarray(1.0))


def _even_places() -> Points:
    """Points of equal probability of the standard normal distribution in 2D."""
    share = (jnp.arange(RINGS) + 0.5) / RINGS
    radius = jnp.sqrt(-2.0 * jnp.log1p(-share))
    turn = 2.0 * jnp.pi * (jnp.arange(SPOKES)[None, :] + 0.5 * (jnp.arange(RINGS) % 2)[:, None]) / SPOKES
    return jnp.stack([radius[:, None] * jnp.cos(turn), radius[:, None] * jnp.sin(turn)], axis=-1).reshape(-1, 2)


def _wide_ellipse(cov: Float[Array, "2 2"]) -> tuple[Float[Array, "2 2"], Float[Array, "2"]]:
    """Axes (columns) and half widths of a 2D covariance, widened where it is too narrow to estimate a slope."""
    values, axes = eigen(jnp.where(jnp.all(jnp.isfinite(cov)), cov, jnp.eye(2)))
    sigma = jnp.sqrt(jnp.maximum(values, 0.0))
    return axes.T, jnp.maximum(sigma, NARROWEST * jnp.maximum(sigma[0], 1.0))


def _solved(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> list[Scalar]:
    """Solution of a few equations with a positive definite matrix; without LAPACK, which takes long to load."""
    rows = [[*matrix[k], right[k]] for k in range(len(right))]
    for k, row in enumerate(rows):
        for j in range(k + 1, len(rows)):
            factor = rows[j][k] / row[k]
            rows[j] = [a - factor * b for a, b in zip(rows[j], row, strict=True)]
    solution: list[Scalar] = []
    for k in reversed(range(len(rows))):
        known = sum(a * x for a, x in zip(rows[k][k + 1 : -1], solution, strict=True))
        solution.insert(0, (rows[k][-1] - known) / rows[k][k])
    return solution
