"""Geoid undulation and heights above mean sea level."""

from __future__ import annotations

import numpy as np
from jax.typing import ArrayLike

from jaxgeo.earth import Geodetic
from jaxgeo.earth.geodetic import check_position
from jaxgeo.fix import Fix
from jaxgeo.io.vertical import VerticalDatum, height_shift

EGM96 = "EPSG:5773"


def undulation(lat_deg: ArrayLike, lon_deg: ArrayLike, datum: VerticalDatum = EGM96) -> np.ndarray:
    """Geoid undulation: height in m of a vertical datum's zero above the WGS 84 ellipsoid; shapes broadcast.

    `datum` as in `read_dem`; EGM96 is bundled. NaN where a coordinate is NaN or outside the datum's grid.
    Raises `VerticalDatumError` for an unknown datum or one whose grid is missing, `ValueError` for a latitude out of
    range.
    """
    lat, lon = np.broadcast_arrays(np.asarray(lat_deg, np.float64), np.asarray(lon_deg, np.float64))
    return _apply(lat, lon, np.zeros(lat.shape), datum, inverse=False)


def height_msl(position: Geodetic | Fix, datum: VerticalDatum = EGM96) -> np.ndarray:
    """Height in m above a vertical datum (mean sea level, EGM96 by default) of a position or a fix, batches included.

    NaN stays NaN, so a fix without coordinates has no height. Raises as `undulation` does.

    >>> place = jaxgeo.Geodetic.from_degrees(lat=36.3, lon=-84.2, height=300.0)
    >>> print(f"{jaxgeo.io.height_msl(place):.2f} m above mean sea level")
    331.06 m above mean sea level
    """
    if isinstance(position, Fix):
        position = position.position
    lat, lon, height = np.broadcast_arrays(*degrees_of(position))
    return _apply(lat, lon, height, datum, inverse=True)


def degrees_of(position: Geodetic) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(lat, lon, height) in deg, deg, m, by NumPy: no compilation for a new batch length."""
    check_position(position, "position")
    lat, lon, height = (np.asarray(part, np.float64) for part in (position.lat, position.lon, position.height))
    return np.asarray(np.rad2deg(lat)), np.asarray(np.rad2deg(lon)), height


def _apply(lat: np.ndarray, lon: np.ndarray, height: np.ndarray, datum: VerticalDatum, inverse: bool) -> np.ndarray:
    known = np.isfinite(lat) & np.isfinite(lon) & np.isfinite(height)
    if np.any(np.abs(lat[known]) > 90.0):
        raise ValueError(f"latitudes must lie in [-90, 90] deg; got {lat[known][np.abs(lat[known]).argmax()]!r}.")
    shift = height_shift(datum)
    change = shift.from_ellipsoid if inverse else shift.to_ellipsoid
    result = np.full(lat.shape, np.nan)
    if known.any():
        result[known] = change(lon[known], lat[known], height[known])
    return result
