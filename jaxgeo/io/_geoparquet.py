"""GeoParquet 1.1 encoder: each geometry column with its CRS in PROJJSON."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import pyproj
import shapely
from shapely.geometry.base import BaseGeometry

from jaxgeo.io._cells import utf8_text

VERSION = "1.1.0"


class GeometryColumn(NamedTuple):
    """Geometries of the rows, None if missing, and their CRS."""

    geometries: Sequence[BaseGeometry | None]
    crs: pyproj.CRS


def geoparquet(
    columns: Mapping[str, Sequence[Any]],
    geometries: Mapping[str, GeometryColumn],
    metadata: Mapping[str, Any],
    types: Mapping[str, str] | None = None,
) -> bytes:
    """Encode a table; the first geometry column is the primary one.

    `metadata` is stored under the key "jaxgeo". `types`, the name of the Arrow type of each column, make the schema of
    all parts of a dataset the same, whatever their values. Raises `ImportError` without pyarrow, `ValueError` for a
    column that cannot be stored.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise ImportError("a GeoParquet needs the library pyarrow: pip install 'jaxgeo[gis]'.") from error
    of_type = {} if types is None else {name: pa.type_for_alias(kind) for name, kind in types.items()}
    arrays = {
        name: pa.array([utf8_text(value) for value in values], of_type.get(name)) for name, values in columns.items()
    }
    for name, (shapes, _) in geometries.items():
        arrays[name] = pa.array([_wkb(shape) for shape in shapes], pa.binary())
    geo = {
        "version": VERSION,
        "primary_column": next(iter(geometries)),
        "columns": {name: _described(column, types is not None) for name, column in geometries.items()},
    }
    texts = {"geo": json.dumps(geo), "jaxgeo": json.dumps(metadata, ensure_ascii=False)}
    sink = io.BytesIO()
    parquet.write_table(pa.table(arrays).replace_schema_metadata(texts), sink, compression="snappy")
    return sink.getvalue()


def _wkb(shape: BaseGeometry | None) -> bytes | None:
    return None if shape is None else shapely.to_wkb(shape, output_dimension=3, flavor="iso")


def _described(column: GeometryColumn, is_part: bool) -> dict[str, Any]:
    """Metadata of a column; of a part without its kinds of geometries, for which the format knows an empty list."""
    shapes = [] if is_part else [shape for shape in column.geometries if shape is not None]
    kinds = {f"{shape.geom_type}{' Z' * shape.has_z}" for shape in shapes}
    return {
        "encoding": "WKB",
        "geometry_types": sorted(kinds),
        "crs": column.crs.to_json_dict(),
        "edges": "planar",
        "orientation": "counterclockwise",
    }
