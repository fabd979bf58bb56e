"""Geometries with attributes, and their encoding as GeoJSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyproj
import shapely
from shapely.geometry.base import BaseGeometry

from jaxgeo._destination import UNWRITABLE
from jaxgeo.io._cells import utf8_text
from jaxgeo.io._map_crs import code_of

DECIMALS = {True: 11, False: 7}  # of GeoJSON, in a geographic CRS and in others: a micrometre
DECIMALS_OF_HEIGHT = 4
WGS84 = ("EPSG:4979", "EPSG:4326", "OGC:CRS84", "OGC:CRS84h")
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


def feature_collection(features: Iterable[Feature], crs: pyproj.CRS, head: Mapping[str, Any]) -> bytes:
    """Encode a GeoJSON FeatureCollection (RFC 7946), one feature a line, with further members `head`.

    Coordinates are rounded to a micrometre, heights to 0.1 mm; outer rings run anticlockwise. NaN and infinities are
    null. A CRS other than WGS 84 (`named_crs`) must be named by the caller. `crs` is the horizontal one.
    """
    decimals = DECIMALS[crs.is_geographic]
    texts = (json.dumps(_as_json(feature, decimals), allow_nan=False, ensure_ascii=False) for feature in features)
    opening = json.dumps({"type": "FeatureCollection"} | dict(head), ensure_ascii=False)[:-1]
    return (opening + ', "features": [\n' + ",\n".join(texts) + "\n]}\n").encode("utf-8", UNWRITABLE)


def _as_json(feature: Feature, decimals: int) -> dict[str, Any]:
    geometry, attributes = feature
    rounded = None if geometry is None else _mapping(shapely.orient_polygons(geometry), decimals)
    properties = {name: _or_null(plain(value)) for name, value in attributes.items()}
    return {"type": "Feature", "geometry": rounded, "properties": properties}


def _mapping(geometry: BaseGeometry, decimals: int) -> Any:
    axes = np.array([decimals, decimals, DECIMALS_OF_HEIGHT])

    def rounded(places: np.ndarray) -> np.ndarray:
        scales = 10.0 ** axes[: places.shape[1]]
        return np.round(places * scales) / scales

    return shapely.geometry.mapping(shapely.transform(geometry, rounded, include_z=geometry.has_z))


def _or_null(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def named_crs(name: str, *known: pyproj.CRS) -> dict[str, Any]:
    """The pre-RFC 7946 CRS member of the first of some descriptions of a CRS that has a code; none for WGS 84.

    Raises `ValueError` if none has a code; `name` is the file's.
    """
    codes = [code_of(crs) for crs in known]
    if codes[0] in WGS84:
        return {}
    code = next((one for one in codes if one is not None), None)
    if code is None:
        raise ValueError(
            f"{name}: GeoJSON names a crs by its code, and {known[0].name!r} has none that PROJ knows; "
            f"write a .gpkg or a .parquet."
        )
    authority, numbers = code.split(":")
    parts = [f"{authority}::{number}" for number in numbers.split("+")]
    urn = f"urn:ogc:def:crs:{parts[0]}" if len(parts) == 1 else f"urn:ogc:def:crs,{','.join(f'crs:{p}' for p in parts)}"
    return {"crs": {"type": "name", "properties": {"name": urn}}}


def plain(value: Any) -> Any:
    """A value of Python itself, texts as UTF-8 can encode them."""
    return utf8_text(value.item() if hasattr(value, "item") and np.ndim(value) == 0 else value)


def column_of(name: str, key: str, values: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """An attribute of all features, and its unknown mask: floats, integers, booleans or texts.

    Raises `ValueError` for mixed types; `name` is the file's.
    """
    plain_values = [plain(value) for value in values]
    kinds = {type(value) for value in plain_values if value is not None}
    for taken, dtype, filler in COLUMNS:
        if kinds <= taken:
            column = np.array([filler if value is None else value for value in plain_values], dtype)
            return column, np.array([value is None for value in plain_values])
    shown = ", ".join(sorted(kind.__name__ for kind in kinds))
    raise ValueError(f"{name}: the attribute {key!r} must be all numbers, all texts or all bools; got {shown}.")
