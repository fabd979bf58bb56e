"""Error ellipses on the ground as polygons: east and north offsets of a point, transformed to a map."""

from __future__ import annotations

import numpy as np
from pyproj.transformer import Transformer
from shapely.geometry.base import BaseGeometry

from jaxgeo.io._map_crs import MapCRS
from jaxgeo.io._outlines import outline

VERTICES = 64  # the polygon has 0.16 % less area than the ellipse
LEAST_AXIS = 1e-4  # m; thinner ones have no area at the precision of files
MOST_AXIS = 1e6  # m; beyond it the level plane is far from the ground
MOST_STRETCHED = 100.0  # ratio of map to ground length; larger ones indicate a seam of the map


def ellipse_polygons(
    name: str,
    chart: MapCRS,
    lonlat_deg: np.ndarray,
    ecef: np.ndarray,
    axes: np.ndarray,
    azimuth: np.ndarray,
    centre_en: np.ndarray,
) -> list[BaseGeometry | None]:
    """The polygon of each of n ellipses on the level plane of a point, in the horizontal CRS of `chart`.

    `lonlat_deg` (n, 2) and `ecef` (n, 3) in m are the points, `axes` (n, 2) the semi-axes in m, the longer one first,
    at `azimuth` (n,) in rad; `centre_en` (n, 2) in m is the centre, east and north of the point. Exact:
    vertices are computed in ECEF. None if a number is not finite, an axis is below 0.1 mm or above 1000 km. Raises
    `ValueError` if the CRS splits an ellipse or does not cover it.
    """
    finite = np.isfinite(np.column_stack([lonlat_deg, ecef, axes, azimuth, centre_en])).all(axis=-1)
    with np.errstate(invalid="ignore"):
        drawn = np.flatnonzero(finite & (axes[:, 1] >= LEAST_AXIS) & (axes[:, 0] <= MOST_AXIS))
    polygons: list[BaseGeometry | None] = [None] * len(axes)
    if not drawn.size:
        return polygons
    places = ecef[drawn, None] + _offsets(lonlat_deg[drawn], axes[drawn], azimuth[drawn], centre_en[drawn])
    x, y, z = np.moveaxis(places, -1, 0)
    lon, lat, _ = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(x, y, z)
    rings = np.stack(chart.to_flat.transform(lon, lat), axis=-1)
    for i, ring, ground in zip(drawn, rings, places, strict=True):
        _check_ring(name, chart, int(i), ring, ground)
        polygons[i] = outline(ring, chart.turn)
    return polygons


def _offsets(lonlat_deg: np.ndarray, axes: np.ndarray, azimuth: np.ndarray, centre_en: np.ndarray) -> np.ndarray:
    """Offsets of the vertices in ECEF, (n, VERTICES, 3), m."""
    around = 2.0 * np.pi * np.arange(VERTICES) / VERTICES
    along, across = axes[:, :1] * np.cos(around), axes[:, 1:] * np.sin(around)
    s, c = np.sin(azimuth)[:, None], np.cos(azimuth)[:, None]
    east = centre_en[:, :1] + along * s - across * c
    north = centre_en[:, 1:] + along * c + across * s
    lon, lat = np.radians(lonlat_deg).T
    east_axis = np.stack([-np.sin(lon), np.cos(lon), np.zeros_like(lon)], axis=-1)
    north_axis = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=-1)
    return east[..., None] * east_axis[:, None] + north[..., None] * north_axis[:, None]


def _check_ring(name: str, chart: MapCRS, index: int, ring: np.ndarray, ground: np.ndarray) -> None:
    if not np.isfinite(ring).all():
        raise ValueError(f"{name}: the ellipse of fix {index} lies outside what {chart.flat.name!r} maps.")
    if chart.turn is not None:
        return
    unit = chart.flat.axis_info[0].unit_conversion_factor
    on_map, on_ground = (np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1) for x in (ring * unit, ground))
    if not np.all(on_map <= MOST_STRETCHED * np.maximum(on_ground, 1.0)):
        raise ValueError(
            f"{name}: {chart.flat.name!r} tears the ellipse of fix {index} apart, or stretches it more than "
            f"{MOST_STRETCHED:g} times; choose a crs that is made for the place, or ellipses=False."
        )
