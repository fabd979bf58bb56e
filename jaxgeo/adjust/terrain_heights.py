"""Heights of a terrain model as observations of the points of a block."""

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
    """The points of a block lie on a terrain model, to a standard deviation of its height.

    `information` (rows,) is 1 / sigma in 1/m, zero for points that are not tied to it. The residual is the height of
    the point above the surface under it, so that the slope of the ground has its part.
    """

    dem: Dem
    frame: LocalFrame
    information: Float[Array, " rows"]

    def above(self, place: Vector3) -> Scalar:
        """Height in m of a place in the frame above the surface under it; NaN over unknown ground."""
        position = WGS84.to_geodetic(self.frame.to_ecef(place))
        return position.height - self.dem.height_at(position)

    def residuals(self, points: Float[Array, "rows 3"]) -> Float[Array, " rows"]:
        """Weighted heights above the surface; zero for points that are not tied to it."""
        tied = self.information > 0.0
        return jnp.where(tied, jax.vmap(self.above)(points), 0.0) * self.information

    def linearised(self, points: Float[Array, "rows 3"]) -> tuple[Float[Array, " rows"], Float[Array, "rows 3"]]:
        """The same, and its derivatives by the places."""
        tied = self.information > 0.0
        value, slope = jax.vmap(jax.value_and_grad(self.above))(points)
        weight = self.information
        return jnp.where(tied, value, 0.0) * weight, jnp.where(tied[:, None], slope, 0.0) * weight[:, None]


class HeightObservations(Record):
    """That points lie on a terrain model to `sigma` m of its height: those of `names`, or all that are no control."""

    dem: Dem
    sigma: float
    names: tuple[str, ...] | None = eqx.field(static=True, default=None)
