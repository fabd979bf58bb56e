"""Terrain of constant height: the ellipsoid model."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxgeo._checks import as_float64, check_is
from jaxgeo._compile import one_program
from jaxgeo._numerics import dot, finite_or, value_and_slope
from jaxgeo._typing import Flag, Index, Scalar, ScalarField, Vector3
from jaxgeo.earth.ellipsoid import WGS84, Ellipsoid
from jaxgeo.earth.geodetic import Geodetic, checked_position
from jaxgeo.earth.ray import Ray
from jaxgeo.status import Status, status_where
from jaxgeo.terrain.field import AbstractField, ConstantField, checked_field
from jaxgeo.terrain.interface import AbstractSearch, AbstractTerrain, Bracket
from jaxgeo.terrain.search.reach import ON_GROUND

CLOSE_ENOUGH = 1e-6  # m of height
ROUNDS = 3  # iterations for the height on an ellipsoid other than WGS 84
NEWTON_STEPS = 40  # near the horizon the first steps only halve the range


class ConstantHeight(AbstractTerrain):
    """The surface of constant geodetic `height` in m (exact, not an inflated ellipsoid).

    The ellipsoid model of Li et al. (2023), "A target location method for aerial images through fast iteration of
    elevation based on DEM", section 2.1. Every search returns the same, near intersection. Another `ellipsoid`, such as
    a sphere, is for studies: the fix's ECEF point is on it, while its geodetic position is relative to WGS 84.
    """

    height: ScalarField
    ellipsoid: Ellipsoid = eqx.field(static=True, default=WGS84)

    def with_field(self, field: AbstractField) -> ConstantHeight:
        """The surface raised by a constant field; varying fields need posts.

        Raises `TypeError` for any field but a `ConstantField`.
        """
        hint = "A terrain of one height has no posts for a field that varies: take a Dem."
        check_is(field, ConstantField, "field", hint)
        return ConstantHeight(self._height() + checked_field(field).bounds()[0], self.ellipsoid)

    def bracket(self, ray: Ray, search: AbstractSearch) -> Bracket:
        del search
        ray, height = jax.lax.stop_gradient((ray, self._height()))
        if ray.bending is None:
            near, _, meets = self.ellipsoid.ranges_to_height(ray.origin, ray.direction, height)
        else:
            near, meets = _bent_range(self.ellipsoid, ray, height)
        up, above = self.ellipsoid.normal_and_height(ray.origin)
        above = above - height
        below, on_ground = above < -ON_GROUND, jnp.abs(above) <= ON_GROUND
        near = jnp.where(on_ground, 0.0, near)
        ahead = jnp.where(on_ground, dot(up, ray.direction) < 0.0, meets & (near >= 0.0) & ~below)
        status = status_where(ahead, Status.hit, Status.rises_away.code)
        status = status_where(below, Status.camera_below_terrain, status)
        distance = jnp.where(ahead, near, 0.0)
        return Bracket(distance, distance, distance, jnp.zeros(2, jnp.int32), status)

    def clearance(self, p_ecef: Vector3, cell: Int[Array, "2"]) -> Scalar:
        del cell
        return self.ellipsoid.normal_and_height(p_ecef)[1] - self._height()

    def height_at(self, position: Geodetic) -> Scalar:
        """Height of the surface in m at a latitude and longitude (the height of `position` is ignored)."""
        return _height_at(self, checked_position(position, "position"))

    def ground_above(self, p_ecef: Vector3) -> tuple[Scalar, Flag]:
        above = -self.clearance(p_ecef, jnp.zeros(2, jnp.int32))
        return above, jnp.isfinite(above)

    def made_safe(self) -> tuple[ConstantHeight, Flag]:
        height = self._height()
        return ConstantHeight(finite_or(height, 0.0), self.ellipsoid), jnp.isfinite(height)

    def safe_ray(self) -> Ray:
        return Ray(jnp.array([self.ellipsoid.a + 1000.0, 0.0, 0.0]), jnp.array([-1.0, 0.0, 0.0]))

    def _height(self) -> Scalar:
        return as_float64(self.height, "terrain.height")


def _bent_range(ellipsoid: Ellipsoid, ray: Ray, height: Scalar) -> tuple[Scalar, Flag]:
    """Range in m at which a bent ray reaches a height, and whether it does.

    Newton from the origin. Height along a ray is convex, also with refraction (the air bends it less than the Earth
    curves), so no step overshoots, and a rising ray is detected as having no intersection ahead.
    """

    def excess(distance: Scalar) -> Scalar:
        return ellipsoid.normal_and_height(ray.at(distance))[1] - height

    def refine(_: Index, state: tuple[Scalar, Flag]) -> tuple[Scalar, Flag]:
        distance, sinks = state
        value, slope = value_and_slope(excess, distance)
        sinks = sinks & ((slope < 0.0) | (value <= CLOSE_ENOUGH))
        step = jnp.where(sinks & (slope < 0.0), value / jnp.where(slope < 0.0, slope, -1.0), 0.0)
        return distance - step, sinks

    start = (jnp.zeros_like(height), jnp.ones_like(height, bool))
    distance, sinks = jax.lax.fori_loop(0, NEWTON_STEPS, refine, start)
    return distance, sinks & (jnp.abs(excess(distance)) <= CLOSE_ENOUGH)


@one_program
def _height_at(ground: ConstantHeight, position: Geodetic) -> Scalar:
    height = jnp.zeros_like(position.lat)
    for _ in range(ROUNDS):
        p_ecef = WGS84.to_ecef(Geodetic(lat=position.lat, lon=position.lon, height=height))
        height = height - ground.clearance(p_ecef, jnp.zeros(2, jnp.int32))
    return height
