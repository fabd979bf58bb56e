"""The vertical plane of a line of sight, for every depression up to the nadir."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._typing import Scalar, Vector3

FLAT = 1e-3  # horizontal component of a direction, at least: a steeper line counts as that steep, to the east
SLANT = 2.0  # descent per m, at most, of the path along which the ground is probed: steeper ones lead far below it


class SightPlane(NamedTuple):
    """Vertical plane of a line of sight: the horizontal unit vector `along` the line, the horizontal component `level`
    of its direction, and its descent `fall` in m per m."""

    along: Float[Array, "2"]
    level: Scalar
    fall: Scalar

    @classmethod
    def of(cls, direction_enu: Vector3) -> SightPlane:
        """The plane of a direction; towards the east for one that is plumb."""
        along, level = along_of(direction_enu)
        return cls(along, level, -direction_enu[2] / level)

    @property
    def slant(self) -> Scalar:
        """Descent in m per m of the path along which the ground is probed: that of the line, or less near the nadir."""
        return jnp.minimum(self.fall, SLANT)

    @property
    def path(self) -> Vector3:
        """Path through the fix along which the ground is probed, in east, north, up per m ahead."""
        return jnp.append(self.along, -self.slant)

    def abreast(self, ahead: Float[Array, "*shape"], above: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Distance ahead of the fix, m, of the point of the line that is nearest to a point `ahead` m ahead of the fix,
        horizontally, and `above` m above the line."""
        return ahead - self.level**2 * self.fall * above


def along_of(direction_enu: Vector3) -> tuple[Float[Array, "2"], Scalar]:
    """(horizontal unit vector along a line of sight, its horizontal component); east for one that is plumb."""
    level = jnp.sqrt(direction_enu[0] ** 2 + direction_enu[1] ** 2)
    plumb = level < FLAT
    along = jnp.where(plumb, jnp.array([1.0, 0.0]), direction_enu[:2] / jnp.where(plumb, 1.0, level))
    return along, jnp.maximum(level, FLAT)
