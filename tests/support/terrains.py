"""User-defined terrain with only the five methods that the interface requires."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import WGS84, Geodetic, Ray
from jaxgeo._numerics import all_finite
from jaxgeo.status import Status, status_where
from jaxgeo.terrain import AbstractTerrain, Bracket, ConstantField

METRES_A_DEGREE = math.radians(1.0) * 6.367e6
AROUND = 1e-3  # m


class Tin(AbstractTerrain):
    """Triangles: `corners` (triangles, 3, 3) in ECEF m. A cell is (triangle index, 0)."""

    corners: jax.Array

    def bracket(self, ray: Ray, search) -> Bracket:
        ray, corners = jax.lax.stop_gradient((ray, self.corners))
        first, to_second, to_third = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        across = jnp.cross(ray.direction[None, :], to_third)
        volume = jnp.sum(across * to_second, axis=1)
        scale = 1.0 / jnp.where(volume == 0.0, 1.0, volume)
        from_first = ray.origin[None, :] - first
        u = scale * jnp.sum(from_first * across, axis=1)
        aside = jnp.cross(from_first, to_second)
        v = scale * jnp.sum(aside * ray.direction[None, :], axis=1)
        distance = scale * jnp.sum(aside * to_third, axis=1)
        is_met = (volume != 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
        distance = jnp.where(is_met, distance, jnp.inf)
        nearest = jnp.argmin(distance)
        found = jnp.isfinite(distance[nearest])
        at = jnp.where(found, distance[nearest], 0.0)
        around = jnp.where(found, AROUND, 0.0)
        cell = jnp.stack([jnp.where(found, nearest, 0), jnp.zeros_like(nearest)]).astype(jnp.int32)
        return Bracket(at - around, at + around, at, cell, status_where(found, Status.hit, Status.rises_away.code))

    def clearance(self, p_ecef, cell):
        first, second, third = self.corners[cell[0]]
        normal = jnp.cross(second - first, third - first)
        up, _ = WGS84.normal_and_height(p_ecef)
        return normal @ (p_ecef - first) / (normal @ up)

    def with_field(self, field):
        assert isinstance(field, ConstantField)
        up = jax.vmap(jax.vmap(lambda corner: WGS84.normal_and_height(corner)[0]))(self.corners)
        return eqx.tree_at(lambda tin: tin.corners, self, self.corners + jnp.asarray(field.height) * up)

    def made_safe(self):
        return self, all_finite(self.corners)

    def safe_ray(self) -> Ray:
        middle = jnp.mean(jax.lax.stop_gradient(self.corners[0]), axis=0)
        up, _ = WGS84.normal_and_height(middle)
        return Ray(middle + 1000.0 * up, -up)


def tin_along(centre: Geodetic, north: np.ndarray, heights: np.ndarray, half_width: float = 3000.0) -> Tin:
    """Strips of two triangles between profile points, `north` of a centre, `heights` in m, level from west to east."""
    lat0, lon0 = np.rad2deg(float(centre.lat)), np.rad2deg(float(centre.lon))
    lat = lat0 + np.asarray(north) / METRES_A_DEGREE
    aside = half_width / (METRES_A_DEGREE * math.cos(float(centre.lat)))
    edge = lambda lon: np.asarray(  # noqa: E731
        jax.vmap(WGS84.to_ecef)(Geodetic.from_degrees(lat=lat, lon=np.full(lat.shape, lon), height=np.asarray(heights)))
    )
    west, east = edge(lon0 - aside), edge(lon0 + aside)
    lower = np.stack([west[:-1], east[:-1], east[1:]], axis=1)
    upper = np.stack([west[:-1], east[1:], west[1:]], axis=1)
    return Tin(jnp.asarray(np.concatenate([lower, upper])))


class Bridge(Tin):
    """Triangles whose reported heights are 50 m above them: a plumb line would hit something else."""

    def height_at(self, position: Geodetic):
        return super().height_at(position) + 50.0


class Unknown(Tin):
    """Triangles with unknown heights except where lines of sight meet them."""

    def height_at(self, position: Geodetic):
        return jnp.full_like(position.lat, jnp.nan)
