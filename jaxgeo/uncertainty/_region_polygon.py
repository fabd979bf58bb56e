"""Checks of a polygon of the caller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any


def checked_polygon(polygon: Any) -> Any:
    """The polygon or multipolygon. Raises `TypeError` for what is none, `ValueError` for one that cannot be used."""
    import shapely

    area = _geometry(polygon)
    if area.geom_type not in ("Polygon", "MultiPolygon"):
        raise ValueError(f"polygon must be a Polygon or a MultiPolygon; got a {area.geom_type}.")
    if area.is_empty:
        raise ValueError("the polygon is empty: it has no coordinates.")
    west, south, east, north = area.bounds
    if not all(map(math.isfinite, area.bounds)) or not area.is_valid:
        raise ValueError(f"the polygon is not valid: {shapely.is_valid_reason(area)}. Try shapely.make_valid.")
    if south < -90.0 or north > 90.0 or west < -360.0 or east > 360.0:
        raise ValueError(
            f"the polygon must be in degrees, (longitude, latitude) on WGS 84; its first coordinates go from {west:g} "
            f"to {east:g}, its second ones from {south:g} to {north:g}. Exchange them if they are (latitude, "
            f"longitude), and transform map coordinates with pyproj."
        )
    return area


def _geometry(polygon: Any) -> Any:
    import shapely

    if isinstance(polygon, shapely.Geometry):
        return polygon
    polygon = getattr(polygon, "__geo_interface__", polygon)
    if not isinstance(polygon, Mapping):
        raise TypeError(f"polygon must be a shapely geometry or a GeoJSON mapping; got {type(polygon).__name__}.")
    if polygon.get("type") == "Feature":
        polygon = polygon.get("geometry")
    try:
        return shapely.geometry.shape(dict(polygon))  # pyright: ignore[reportOptionalIterable, reportCallIssue, reportArgumentType]
    except Exception as error:  # shapely raises many kinds for wrong mappings
        raise ValueError(f"the polygon is no GeoJSON geometry that shapely can read: {error}") from error
