"""Fixes at given positions, without a camera or ground."""

from __future__ import annotations

import numpy as np
import pyproj

from jaxgeo import Fix, Geodetic, Status

ALPS = np.array([[47.0, 11.0, 600.0], [47.01, 11.02, 812.3456], [46.99, 11.03, 1500.25]])  # lat, lon in deg, m
LEVEL = np.array([[9.0, 2.0, 0.5], [2.0, 4.0, -0.3], [0.5, -0.3, 1.0]])  # m², the longer axis east of north-east
DATE_LINE = np.array([[-17.0, 179.99999, 3.0]])
TO_ECEF = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)


def made(places: np.ndarray = ALPS, lost: dict[int, Status] | None = None) -> Fix:
    """Fixes at positions, some without coordinates."""
    lost = lost or {}
    status = np.array([lost.get(i, Status.hit) for i in range(len(places))], np.int8)
    lat, lon, height = np.where(status[:, None] == Status.hit, places, np.nan).T
    ecef = np.stack(TO_ECEF.transform(lon, lat, height), axis=-1)
    ecef[~np.isfinite(ecef)] = np.nan
    number = np.where(status == Status.hit, np.arange(len(places)) + 0.5, np.nan)
    position = Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height)
    return Fix(position, ecef, 1000.0 * number, 0.1 * number, 0.2 * number, 0.3 * number, status)
