"""Geodetic position: latitude, longitude and ellipsoidal height."""

from __future__ import annotations

from dataclasses import KW_ONLY

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxgeo._checks import as_float64, by_numpy_if_known, check_finite, check_range, require_x64
from jaxgeo._record import Record
from jaxgeo._typing import ScalarField


class Geodetic(Record):
    """A point near the ellipsoid: latitude and longitude in rad, height above the ellipsoid in m.

    >>> summit = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=2450.0)
    >>> print(f"{summit.lat:.6f} rad, {summit.height} m")
    0.820305 rad, 2450.0 m
    >>> print(*np.round(summit.to_degrees(), 9))
    47.0 11.0 2450.0
    """

    _: KW_ONLY
    lat: ScalarField
    lon: ScalarField
    height: ScalarField

    @classmethod
    def from_degrees(cls, *, lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> Geodetic:
        """Geodetic position from degrees and m; inputs may have batch axes.

        Raises `ValueError` for a latitude outside [-90, 90], a longitude outside [-360, 360] or a height that is not
        finite; `RuntimeError` with 64-bit floats off; `TypeError` for float32.
        """
        check_range(lat, "lat", "deg", -90.0, 90.0)
        check_range(lon, "lon", "deg", -360.0, 360.0)
        check_finite(height, "height", "m above the ellipsoid")
        given = as_float64((lat, lon, height), "Geodetic.from_degrees(lat, lon, height)")
        lat, lon, height = (jnp.stack(x) if isinstance(x, list | tuple) else x for x in given)
        lat, lon = by_numpy_if_known(lambda xp, lat, lon: (xp.deg2rad(lat), xp.deg2rad(lon)), lat, lon)
        return cls(lat=lat, lon=lon, height=height)

    def to_degrees(self) -> tuple[ScalarField, ScalarField, ScalarField]:
        """(lat, lon, height) in deg, deg, m."""
        require_x64()
        return jnp.rad2deg(self.lat), jnp.rad2deg(self.lon), self.height
