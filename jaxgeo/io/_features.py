"""Encoding of geometries with attributes as GeoJSON or GeoPackage."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyproj
import shapely
from shapely.geometry.base import BaseGeometry

from jaxgeo.io._cells import utf8_text

DECIMALS = {True: "11", False: "7"}  # of GeoJSON, in a geographic CRS and in others: a micrometre
# Values allowed in an attribute column, their storage type, and the filler for unknown ones.
COLUMNS = (
    ({float}, np.float64, np.nan),
    ({bool}, bool, False),
    ({int}, np.int64, 0),
    ({int, float}, np.float64, np.nan),
    ({str}, object, ""),
)


class Feature(NamedTuple):
    """A geometry, or None, and its attributes."""

    geometry: BaseGeometry | None
    attributes: dict[str, Any]


def has_heights(crs: pyproj.CRS) -> bool:
    """Whether a CRS has a height coordinate."""
    return len(crs.axis_info) == 3


def encoded(
    name: str, driver: str, layer: str, features: Sequence[Feature], attributes: Sequence[str], crs: pyproj.CRS
) -> bytes:
    """Encode a file of one layer; `attributes` are its column names, None where a feature lacks one.

    `name` is the file's, for messages. Raises `ValueError` for a column of mixed types, `OSError` if GDAL fails.
    """
    from pyogrio import raw  # imports pandas if installed: a quarter of a second
    from pyogrio.errors import DataLayerError, DataSourceError

    columns = [column_of(name, key, [feature.attributes.get(key) for feature in features]) for key in attributes]
    shapes = [None if shape is None else shapely.to_wkb(shape, output_dimension=3) for shape, _ in features]
    code, options = _crs_and_options(driver, crs)
    sink = io.BytesIO()
    try:
        raw.write(
            sink,
            np.array(shapes, object),
            [values for values, _ in columns],
            list(attributes),
            field_mask=[unknown for _, unknown in columns],
            layer=layer,
            driver=driver,
            geometry_type=_geometry_type(features, crs),
            crs=code,
            **options,
        )
    except (DataSourceError, DataLayerError, OSError) as error:
        raise OSError(f"{name}: it cannot be written: {error}") from error
    return sink.getvalue()


def _geometry_type(features: Sequence[Feature], crs: pyproj.CRS) -> str:
    kinds = {shape.geom_type for shape, _ in features if shape is not None}
    return "Unknown" if len(kinds) != 1 else kinds.pop() + " Z" * has_heights(crs)


def _crs_and_options(driver: str, crs: pyproj.CRS) -> tuple[str, dict[str, Any]]:
    """A CRS in GDAL's notation, and the options of a driver."""
    authority = crs.to_authority()
    code = crs.to_wkt() if authority is None else ":".join(authority)
    if driver != "GeoJSON":
        return code, {}
    options = {"COORDINATE_PRECISION": DECIMALS[crs.is_geographic]}
    if code in ("EPSG:4326", "EPSG:4979", "OGC:CRS84"):  # GeoJSON heights are ellipsoidal, and it names no CRS
        return "EPSG:4326", options | {"RFC7946": "YES"}
    return code, options


def column_of(name: str, key: str, values: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """An attribute of all features, and its unknown mask: floats, integers, booleans or texts."""
    plain = [value.item() if hasattr(value, "item") and np.ndim(value) == 0 else value for value in values]
    plain = [utf8_text(value) for value in plain]
    kinds = {type(value) for value in plain if value is not None}
    for taken, dtype, filler in COLUMNS:
        if kinds <= taken:
            column = np.array([filler if value is None else value for value in plain], dtype)
            return column, np.array([value is None for value in plain])
    shown = ", ".join(sorted(kind.__name__ for kind in kinds))
    raise ValueError(f"{name}: the attribute {key!r} must be all numbers, all texts or all bools; got {shown}.")
