"""Terrain model heights as observations of the points of a block."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._record import Record
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.earth import WGS84
from jaxgeo.terrain import Dem


class TerrainHeights(Record):
    """Terrain height observations: points lie on a terrain model within a standard deviation of its height.

    `information` (rows,) is 1 / sigma in 1/m, zero for points without this observation. The residual is the height of
    the point above the surface below it, and includes the effect of slope.
    """

    dem: Dem
    frame: LocalFrame
    information: Float[Array, " rows"]

    def above(self, place: Vector3) -> Scalar:
        """Height in m of a position in the frame above the surface below it; NaN over unknown ground."""
        position = WGS84.to_geodetic(self.frame.to_ecef(place))
        return position.height - self.dem.height_at(position)

    def residuals(self, points: Float[Array, "rows 3"]) -> Float[Array, " rows"]:
        """Weighted heights above the surface; zero for points without this observation."""
        tied = self.information > 0.0
        return jnp.where(tied, jax.vmap(self.above)(points), 0.0) * self.information

    def linearised(self, points: Float[Array, "rows 3"]) -> tuple[Float[Array, " rows"], Float[Array, "rows 3"]]:
        """The residuals and their derivatives by the positions."""
        tied = self.information > 0.0
        value, slope = jax.vmap(jax.value_and_grad(self.above))(points)
        weight = self.information
        return jnp.where(tied, value, 0.0) * weight, jnp.where(tied[:, None], slope, 0.0) * weight[:, None]


class HeightObservations(Record):
    """Terrain height observations with `sigma` m: of the points in `names`, or of all that are not control."""

    dem: Dem
    sigma: float
    names: tuple[str, ...] | None = eqx.field(static=True, default=None)
