"""A line of sight."""

from __future__ import annotations

import equinox as eqx

from jaxgeo._typing import Scalar, Vector3, Vector3Field


class Ray(eqx.Module):
    """A half-line in ECEF: `origin` in m, `direction` a unit vector."""

    origin: Vector3Field
    direction: Vector3Field

    def at(self, distance: Scalar) -> Vector3:
        """The ECEF point `distance` m along the ray."""
        return self.origin + distance * self.direction
