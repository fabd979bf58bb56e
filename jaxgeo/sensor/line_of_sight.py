"""Targets of a pointing: a point on the ground, or a line of sight."""

from __future__ import annotations

from typing import Any, TypeAlias

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64, check_range
from jaxgeo._record import Record
from jaxgeo._typing import Vector3Field
from jaxgeo.earth import Geodetic


class LineOfSight(Record):
    """A line of sight: `ned`, a vector of any length in north-east-down at the position of the pose."""

    ned: Vector3Field

    @classmethod
    def from_degrees(cls, *, azimuth: ArrayLike, depression: ArrayLike) -> LineOfSight:
        """From the true azimuth and the angle below the horizontal, deg; shapes may carry a batch axis.

        Raises `ValueError` for an azimuth beyond +-360 deg and a depression beyond +-90 deg.
        """
        check_range(azimuth, "azimuth", "deg", -360.0, 360.0)
        check_range(depression, "depression", "deg", -90.0, 90.0)
        given: Any = as_float64((azimuth, depression), "LineOfSight.from_degrees")
        azimuth, depression = (jnp.deg2rad(angle) for angle in given)
        level = jnp.cos(depression)
        return cls(jnp.stack([level * jnp.cos(azimuth), level * jnp.sin(azimuth), jnp.sin(depression)], axis=-1))

    def to_degrees(self) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """(true azimuth in [0, 360), depression) in deg."""
        ned: Any = as_float64(self.ned, "line of sight")
        north, east, down = ned[..., 0], ned[..., 1], ned[..., 2]
        depression = jnp.rad2deg(jnp.arctan2(down, jnp.hypot(north, east)))
        return jnp.mod(jnp.rad2deg(jnp.arctan2(east, north)), 360.0), depression


Target: TypeAlias = Geodetic | LineOfSight
