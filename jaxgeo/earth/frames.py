"""Local level frames: north-east-down and east-north-up at a geodetic position."""

from __future__ import annotations

import jax.numpy as jnp

from jaxgeo._compile import one_program
from jaxgeo._typing import Matrix3, Vector3
from jaxgeo.earth.geodetic import Geodetic, checked_position


def R_ecef_from_ned(position: Geodetic) -> Matrix3:
    """Rotation from north-east-down at `position` to ECEF; the height does not matter."""
    return _from_ned(checked_position(position, "position"))


def R_ecef_from_enu(position: Geodetic) -> Matrix3:
    """Rotation from east-north-up at `position` to ECEF; the height does not matter."""
    return _from_enu(checked_position(position, "position"))


@one_program
def _from_ned(position: Geodetic) -> Matrix3:
    return jnp.stack(_axes(position), axis=1)


@one_program
def _from_enu(position: Geodetic) -> Matrix3:
    north, east, down = _axes(position)
    return jnp.stack([east, north, -down], axis=1)


def _axes(position: Geodetic) -> tuple[Vector3, Vector3, Vector3]:
    sin_lat, cos_lat = jnp.sin(position.lat), jnp.cos(position.lat)
    sin_lon, cos_lon = jnp.sin(position.lon), jnp.cos(position.lon)
    north = jnp.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat])
    east = jnp.stack([-sin_lon, cos_lon, jnp.zeros_like(sin_lon)])
    down = -jnp.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat])
    return north, east, down
