"""Which slope the ground is taken to have where a fix errs: of the facet under it, of its footprint, or none."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._record import Record
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.model_inputs import NominalFix

Points = Float[Array, "points 2"]
Swept = Float[Array, "3 axes"]
Raised = Float[Array, " axes"]
Covariance = Float[Array, "axes axes"]

RINGS, SPOKES = 6, 16  # of the places at which the ground of a footprint is asked, each standing for the same chance
ROUNDS = 2  # the second ellipse lies on the plane found with the first
NARROWEST = 0.02  # of a footprint's length, and m: a narrower one says nothing of the slope across it
STEEPEST = 0.02  # sine of the angle between ray and plane: a plane that all but faces away is taken as no steeper


class Surface(NamedTuple):
    """A plane for the ground about a fix, in east, north, up there.

    Its `normal` has 1 as its last component; it lies `above` the fix by so many m, and the ground keeps off it by
    `roughness` m rms; `known` is the share of the places asked at which there is known ground.
    """

    normal: Vector3
    above: Scalar
    roughness: Scalar
    known: Scalar


class Spread(NamedTuple):
    """How errors move a line of sight at the fix, and the terrain there: m in east, north, up, and m of height."""

    ray: Swept
    height: Raised
    cov_error: Covariance

    def on(self, surface: Surface, direction_enu: Vector3) -> Swept:
        """How they move the point where the line of sight meets a plane."""
        against = along_plane(surface.normal, direction_enu)
        along = direction_enu / against
        return self.ray - along[:, None] * (surface.normal @ self.ray - self.height)[None, :]


class AbstractSlope(Record):
    """A choice of the plane on which a line of sight that errs is taken to come down."""

    @abstractmethod
    def surface(self, terrain: AbstractTerrain, aim: NominalFix, facet: Vector3, spread: Spread) -> Surface:
        """The plane, given the normal of the facet under the fix."""


class Facet(AbstractSlope):
    """The surface under the fix itself: the derivative, right for errors smaller than a cell of the terrain."""

    def surface(self, terrain: AbstractTerrain, aim: NominalFix, facet: Vector3, spread: Spread) -> Surface:
        del terrain, aim, spread
        return _plane(facet)


class Level(AbstractSlope):
    """Level ground at the height of the fix: what a study with a constant height gets."""

    def surface(self, terrain: AbstractTerrain, aim: NominalFix, facet: Vector3, spread: Spread) -> Surface:
        del terrain, aim, facet, spread
        return _plane(jnp.array([0.0, 0.0, 1.0]))


class Footprint(AbstractSlope):
    """The plane that fits the ground best over the error ellipse.

    A regression of the terrain's height at places that stand for equal shares of the ellipse's chance. Where the plane
    lies above or below the fix, the mean of its errors is off by that; what the ground keeps off the plane counts as
    one more error of height (statistical linearisation).
    """

    def surface(self, terrain: AbstractTerrain, aim: NominalFix, facet: Vector3, spread: Spread) -> Surface:
        del facet
        surface = _plane(jnp.array([0.0, 0.0, 1.0]))
        for _ in range(ROUNDS):
            swept = spread.on(surface, aim.direction_enu)
            surface = fitted_plane(terrain, aim, (swept @ spread.cov_error @ swept.T)[:2, :2])
        return surface


def along_plane(normal: Vector3, direction_enu: Vector3) -> Scalar:
    """Product of a plane's normal and the ray's direction, kept away from zero: the ray comes down on it."""
    return jnp.minimum(normal @ direction_enu, -STEEPEST * jnp.sqrt(normal @ normal))


def fitted_plane(terrain: AbstractTerrain, aim: NominalFix, cov: Float[Array, "2 2"]) -> Surface:
    """The plane through a terrain over an ellipse (m2, east and north) about a fix; without derivatives."""
    terrain, aim, cov = jax.lax.stop_gradient((terrain, aim, cov))
    root = _wide_root(cov)
    places = _even_places()
    level = lambda place: aim.p_ecef + aim.R_ecef_from_enu[:, :2] @ (root @ place)  # noqa: E731
    heights, known = jax.vmap(lambda place: terrain.ground_above(level(place)))(places)
    weight = known.astype(jnp.float64)
    design = jnp.concatenate([jnp.ones((len(places), 1)), places], axis=1)
    normal_matrix = design.T @ (weight[:, None] * design) + 1e-9 * jnp.eye(3)
    above, *slopes = jnp.linalg.solve(normal_matrix, design.T @ (weight * heights))
    slope = jnp.linalg.solve(root.T, jnp.stack(slopes))
    residual = heights - design @ jnp.stack([above, *slopes])
    share = jnp.mean(weight)
    roughness = jnp.sqrt(jnp.sum(weight * residual**2) / jnp.maximum(jnp.sum(weight), 1.0))
    return Surface(jnp.stack([-slope[0], -slope[1], jnp.asarray(1.0)]), above, roughness, share)


def _plane(normal: Vector3) -> Surface:
    zero = jnp.asarray(0.0)
    return Surface(normal, zero, zero, jnp.asarray(1.0))


def _even_places() -> Points:
    """Places of a standard normal plane that stand for equal shares of its chance."""
    share = (jnp.arange(RINGS) + 0.5) / RINGS
    radius = jnp.sqrt(-2.0 * jnp.log1p(-share))
    turn = 2.0 * jnp.pi * (jnp.arange(SPOKES)[None, :] + 0.5 * (jnp.arange(RINGS) % 2)[:, None]) / SPOKES
    return jnp.stack([radius[:, None] * jnp.cos(turn), radius[:, None] * jnp.sin(turn)], axis=-1).reshape(-1, 2)


def _wide_root(cov: Float[Array, "2 2"]) -> Float[Array, "2 2"]:
    """A root of a covariance in the plane, widened where it is too narrow to tell a slope."""
    values, vectors = jnp.linalg.eigh(jnp.where(jnp.all(jnp.isfinite(cov)), cov, jnp.eye(2)))
    sigma = jnp.sqrt(jnp.maximum(values, 0.0))
    return vectors * jnp.maximum(sigma, NARROWEST * jnp.maximum(sigma[1], 1.0))[None, :]
