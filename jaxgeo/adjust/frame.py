"""Local Cartesian frames of an adjustment, in m, free of Earth curvature and map projection."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxgeo._checks import as_float64
from jaxgeo._record import Record
from jaxgeo._typing import Matrix3
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.earth.geodetic import check_position


class LocalFrame(Record):
    """East-north-up at `origin`: a rotation and translation of ECEF, exact at any distance."""

    origin: Geodetic

    @property
    def R_ecef_from_local(self) -> Matrix3:
        """Rotation from the frame's axes to ECEF."""
        return R_ecef_from_enu(self.origin)

    def from_ecef(self, p_ecef: Any) -> jax.Array:
        """Positions (..., 3) in ECEF, m, converted to the frame, m."""
        p_ecef = as_float64(p_ecef, "p_ecef")
        return (p_ecef - jnp.broadcast_to(self._origin_ecef, p_ecef.shape)) @ self.R_ecef_from_local

    def to_ecef(self, p: Any) -> jax.Array:
        """Positions (..., 3) in the frame converted to ECEF, m."""
        p = as_float64(p, "p")
        return p @ self.R_ecef_from_local.T + jnp.broadcast_to(self._origin_ecef, p.shape)

    @property
    def _origin_ecef(self) -> jax.Array:
        return WGS84.to_ecef(as_float64(self.origin, "frame.origin"))

    def from_geodetic(self, position: Geodetic) -> jax.Array:
        """A position, or a batch (n,), as coordinates (n, 3) in the frame, m."""
        check_position(position, "position")
        lat, lon, height = jnp.broadcast_arrays(
            *(jnp.asarray(x) for x in (position.lat, position.lon, position.height))
        )
        flat = Geodetic(lat=lat.ravel(), lon=lon.ravel(), height=height.ravel())
        return self.from_ecef(jax.vmap(WGS84.to_ecef)(flat)).reshape(*lat.shape, 3)

    def to_geodetic(self, p: Any) -> Geodetic:
        """Coordinates (n, 3) or (3,) in the frame as positions."""
        p = as_float64(p, "p")
        found = jax.vmap(WGS84.to_geodetic)(self.to_ecef(p).reshape(-1, 3))
        return jax.tree.map(lambda x: x.reshape(p.shape[:-1]), found)

    def R_local_from_enu(self, position: Geodetic) -> Matrix3:
        """Rotation from east-north-up at a position to the frame's axes."""
        return self.R_ecef_from_local.T @ R_ecef_from_enu(position)


class Cartesian(Record):
    """A frame without georeference, such as that of a model or of a map treated as Cartesian; m, z up."""
