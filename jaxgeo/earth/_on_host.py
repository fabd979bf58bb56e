"""Positions on WGS 84 by NumPy, in batches: for figures and files, where JAX would compile a program."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxgeo.earth.ellipsoid import WGS84


def normals_of(lat: Any, lon: Any) -> np.ndarray:
    """Outward unit normals of the ellipsoid (..., 3), ECEF axes, at latitudes and longitudes in rad."""
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)


def ecef_of(normals: np.ndarray, height: Any) -> np.ndarray:
    """ECEF coordinates (..., 3) in m of points with these normals, at ellipsoidal heights (...) in m."""
    N = WGS84.a / np.sqrt(1.0 - WGS84.e2 * normals[..., 2:] ** 2)
    return (N * [1.0, 1.0, 1.0 - WGS84.e2] + np.asarray(height)[..., None]) * normals


def R_ecef_from_enu_of(lat: float, lon: float) -> np.ndarray:
    """Rotation from east, north, up at a latitude and longitude in rad to ECEF axes."""
    up, east = normals_of(lat, lon), np.array([-np.sin(lon), np.cos(lon), 0.0])
    return np.stack([east, np.cross(up, east), up], axis=1)
