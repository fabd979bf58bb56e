"""Rays: lines of sight in ECEF, straight or refracted."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxgeo._record import Record
from jaxgeo._typing import Scalar, Vector3, Vector3Field
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.refraction import Bending


class Ray(Record):
    """A half-line in ECEF: `origin` in m, `direction` a unit vector; refracted if `bending` is given.

    Ranges along a refracted ray are measured along its initial direction: the point at a range lies below it.
    """

    origin: Vector3Field
    direction: Vector3Field
    bending: Bending | None = None

    def through(self, air: Atmosphere | None) -> Ray:
        """The same ray refracted by an atmosphere; straight if `air` is None."""
        bending = None if air is None else Bending.of(self.origin, self.direction, air)
        return Ray(self.origin, self.direction, bending)

    def at(self, distance: Scalar) -> Vector3:
        """The ECEF point `distance` m along the ray."""
        return jnp.stack(self.components_at(distance))

    def components_at(self, distance: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """`at` by components; for batches, building and unpacking vectors of three is slow."""
        x, y, z = (o + distance * d for o, d in zip(self.origin, self.direction, strict=True))
        if self.bending is None:
            return x, y, z
        dx, dy, dz = self.bending.shift(distance)
        return x + dx, y + dy, z + dz

    def heading_at(self, distance: Scalar) -> Vector3:
        """Direction of the ray in ECEF at `distance` m; its length is 1 except for the refraction term."""
        if self.bending is None:
            return self.direction
        return jax.jvp(self.at, (distance,), (jnp.ones_like(distance),))[1]
