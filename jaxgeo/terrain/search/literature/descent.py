"""The sinking part of a ray as a function of height, the terrain access of the published searches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._numerics import safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Index, Scalar
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.ray import Ray

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

EARTH_RADIUS = 6.371e6  # m: curvature for a first estimate; Newton on the exact height follows
NEWTON_STEPS = 2  # the estimate is 1 m off over 20 km; each step squares the error times 1e-7 per m
LEAST_SINKING = 1e-6  # sine of the depression below which Newton takes no step


class DemSample(Record):
    """One evaluation of the DEM: the height Z, the ground h(Z) under the ray there (m), and the range."""

    height: Scalar
    ground: Scalar
    distance: Scalar
    rowcol: Float[Array, "2"]
    is_inside: Flag

    @property
    def clearance(self) -> Scalar:
        """D(Z) = Z - h(Z), m."""
        return self.height - self.ground


class Descent(Record):
    """A ray over a DEM by the ellipsoidal height Z of its points, from a range `anchor` where it sinks.

    h(Z) is the height of the DEM under the ray's point at height Z. Beside the grid the nearest edge is extended level,
    so that a search may start there.
    """

    ray: Ray
    dem: Dem
    anchor: Scalar
    height: Scalar
    slope: Scalar

    @classmethod
    def of(cls, ray: Ray, dem: Dem, anchor: Scalar) -> Descent:
        """For a ray that sinks at the range `anchor` in m; ranges before it are valid too."""
        up, height = WGS84.normal_and_height(ray.at(anchor))
        return cls(ray, dem, anchor, height, jnp.dot(up, ray.heading_at(anchor)))

    @jax.jit  # once in a program, not at each of its calls: most of the time to trace and lower a search
    def range_at(self, height: Scalar) -> Scalar:
        """Range in m at which the sinking ray is at `height`; if it never gets that low, near its lowest point."""
        bend = (1.0 - self.slope**2) / EARTH_RADIUS
        fall = height - self.height
        distance = self.anchor - 2.0 * fall / (safe_sqrt(self.slope**2 + 2.0 * bend * fall) - self.slope)

        def newton(_: Index, distance: Scalar) -> Scalar:
            up, at = WGS84.normal_and_height(self.ray.at(distance))
            slope = jnp.dot(up, self.ray.heading_at(distance))
            sinks = slope < -LEAST_SINKING
            return distance - jnp.where(sinks, (at - height) / jnp.where(sinks, slope, -1.0), 0.0)

        return jax.lax.fori_loop(0, NEWTON_STEPS, newton, distance)

    def sample_at(self, height: Scalar) -> DemSample:
        """h(Z): one evaluation of the DEM."""
        return self._look_from(self.range_at(height), height)

    def sample_along(self, distance: Scalar, height: Scalar) -> DemSample:
        """The ground under the ray's point at a range, paired with a height other than the ray's: one evaluation."""
        return self._look_from(distance, height)

    @jax.jit
    def _look_from(self, distance: Scalar, height: Scalar) -> DemSample:
        rowcol, _ = self.dem.over(self.ray.at(distance))
        last = (jnp.asarray(self.dem.extent) - 1).astype(jnp.float64)
        nearest = jnp.clip(rowcol, 0.0, last)
        ground = self.dem.surface(nearest, self.cell(nearest))
        return DemSample(height, ground, distance, rowcol, self.dem.contains(rowcol))

    def cell(self, rowcol: Float[Array, "2"]) -> Int[Array, "2"]:
        """The cell at (row, col)."""
        return self.dem.cell_of(rowcol)

    def sinking(self, distance: Scalar) -> Scalar:
        """Height loss of the ray per m of range, at a range."""
        up, _ = WGS84.normal_and_height(self.ray.at(distance))
        return -jnp.dot(up, self.ray.heading_at(distance))

    def post_step(self) -> Scalar:
        """Range in m over which the ray passes one post spacing, the shorter of row and col."""
        level = jnp.sqrt(1.0 - jnp.minimum(self.slope**2, 0.99))
        return jnp.min(self.dem.grid.cell_size()) / level
