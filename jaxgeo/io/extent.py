"""Extent of a DEM, and messages for positions outside it."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pyproj

from jaxgeo.earth import Geodetic
from jaxgeo.io.files import DemFiles
from jaxgeo.terrain import Dem, GeographicGrid


def extent_deg(dem: Dem | DemFiles) -> tuple[float, float, float, float]:
    """(west, south, east, north) in deg of a DEM's outline; east is not less than west."""
    assert dem.grid is not None
    rows, cols = (int(posts) - 1 for posts in np.asarray(dem.extent if isinstance(dem, Dem) else dem.shape))
    ways = np.linspace(0.0, 1.0, 9)
    edge = [(r * rows, c * cols) for r in ways for c in ways]
    x, y, z = np.moveaxis(np.asarray(jax.vmap(dem.grid.normal)(jnp.array(edge))), -1, 0)
    lat, lon = np.rad2deg(np.arctan2(z, np.hypot(x, y))), np.rad2deg(np.arctan2(y, x))
    if isinstance(dem.grid, GeographicGrid) and cols * abs(float(dem.grid.step[0, 1])) > 2.0 * math.pi - 1e-9:
        return -180.0, float(lat.min()), 180.0, float(lat.max())
    lon = lon[0] + (lon - lon[0] + 180.0) % 360.0 - 180.0
    return float(lon.min()), float(lat.min()), float(lon.max()), float(lat.max())


def place_beside(dem: Dem | DemFiles, lat_deg: float, lon_deg: float, what: str = "the camera") -> str | None:
    """Message with the distance of a position outside a DEM and both locations; None if inside or not finite.

    `what` names the position in the message, which says if the position with exchanged coordinates is inside.
    """
    west, south, east, north = edges = extent_deg(dem)
    if not (math.isfinite(lat_deg) and math.isfinite(lon_deg)) or _is_within(edges, lat_deg, lon_deg):
        return None
    lon = west + (lon_deg - west) % 360.0
    exchanged = (
        " (with latitude and longitude exchanged it would be on it)" if _is_within(edges, lon_deg, lat_deg) else ""
    )
    is_nearer_to_west = lon - east >= west + 360.0 - lon
    nearest = west if is_nearer_to_west else min(lon, east), min(max(lat_deg, south), north)
    _, _, off = pyproj.Geod(ellps="WGS84").inv(lon, lat_deg, *nearest)
    return (
        f"the elevation model reaches from {south:.4f} to {north:.4f} deg north and {west:.4f} to {east:.4f} deg east; "
        f"{what} is at {lat_deg:.4f} deg north, {(lon + 180.0) % 360.0 - 180.0:.4f} deg east, "
        f"{_kilometres(off)} km beside it{exchanged}"
    )


def camera_beside(terrain: Any, position: Geodetic) -> str | None:
    """`place_beside` of a camera, or of the first of several; None also for a terrain that is no DEM, and for files too
    large for one grid."""
    if not isinstance(terrain, Dem | DemFiles) or terrain.grid is None:
        return None
    lat, lon = (float(np.rad2deg(np.ravel(angle)[0])) for angle in (position.lat, position.lon))
    return place_beside(terrain, lat, lon)


def _is_within(edges: tuple[float, float, float, float], lat_deg: float, lon_deg: float) -> bool:
    west, south, east, north = edges
    return south <= lat_deg <= north and (lon_deg - west) % 360.0 <= east - west


def _kilometres(metres: float) -> str:
    """Kilometres with three digits, without an exponent."""
    return f"{metres / 1000.0:,.0f}" if metres >= 1e5 else f"{metres / 1000.0:.3g}"
