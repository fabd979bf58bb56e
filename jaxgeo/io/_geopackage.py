"""GeoPackages of several layers, and files of one layer, GeoJSON or GeoPackage."""

from __future__ import annotations

import contextlib
import json
import pathlib
import sqlite3
import tempfile
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyproj
import shapely

from jaxgeo.io._features import Feature, column_of, feature_collection, has_heights, named_crs
from jaxgeo.io._map_crs import code_of
from jaxgeo.io._qgis import add_layer_styles


class Layer(NamedTuple):
    """Features of one CRS, and GDAL's geometry type for them."""

    features: Sequence[Feature]
    crs: pyproj.CRS
    geometry_type: str


def check_vector_driver(driver: str) -> None:
    """Raises `ImportError` if the driver needs a library that is not installed."""
    if driver != "GPKG":
        return
    try:
        import pyogrio  # noqa: F401
    except ImportError as error:
        raise ImportError("a GeoPackage needs the library pyogrio: pip install 'jaxgeo[gis]'.") from error


def one_layer(
    name: str,
    driver: str,
    layer: str,
    features: Sequence[Feature],
    attributes: Sequence[str],
    crs: pyproj.CRS,
    *,
    style: bool = False,
) -> bytes:
    """Encode a file of one layer; `attributes` are its column names, None where a feature lacks one.

    `driver` is "GeoJSON" or "GPKG"; `name` is the file's, for messages; `style` as in `geopackage`. Raises `ValueError`
    for a column of mixed types, and what `geopackage` raises.
    """
    features = [Feature(shape, {key: row.get(key) for key in attributes}) for shape, row in features]
    if driver == "GPKG":
        kinds = {one.geometry.geom_type for one in features if one.geometry is not None}
        kind = "Unknown" if len(kinds) != 1 else kinds.pop() + " Z" * has_heights(crs)
        return geopackage(name, {layer: Layer(features, crs, kind)}, {}, style=style)
    for key in attributes:
        column_of(name, key, [one.attributes[key] for one in features])
    return feature_collection(features, crs, {"name": layer} | named_crs(name, crs))


def geopackage(name: str, layers: Mapping[str, Layer], metadata: Mapping[str, Any], *, style: bool = False) -> bytes:
    """The bytes of a GeoPackage; `name` is the file's, for messages.

    Features of a layer have the same attributes, numbers, texts or bools, None if unknown. `metadata` is stored with
    each layer, values other than texts as JSON; with `style`, QGIS's default style of each. Raises `ImportError`
    without pyogrio, `ValueError` for a column of mixed types, `OSError` if GDAL fails.
    """
    check_vector_driver("GPKG")
    with tempfile.TemporaryDirectory() as folder:
        return _written(name, pathlib.Path(folder) / "layers.gpkg", layers, metadata, style)


def _written(
    name: str, path: pathlib.Path, layers: Mapping[str, Layer], metadata: Mapping[str, Any], style: bool
) -> bytes:
    from pyogrio import raw  # imports pandas if installed: a quarter of a second
    from pyogrio.errors import DataLayerError, DataSourceError

    texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in metadata.items()}
    try:
        for layer, (features, crs, geometry_type) in layers.items():
            keys = features[0].attributes
            columns = {key: column_of(name, key, [one.attributes[key] for one in features]) for key in keys}
            authority = crs.to_authority()
            raw.write(
                path,
                np.array([_wkb(one) for one in features], object),
                [values for values, _ in columns.values()],
                list(columns),
                field_mask=[unknown for _, unknown in columns.values()],
                layer=layer,
                driver="GPKG",
                geometry_type=geometry_type,
                crs=crs.to_wkt() if authority is None else code_of(crs),
                layer_metadata=texts or None,  # on the data set, it would make readers write an .aux.xml beside it
                nan_as_null=False,
            )
        if style:
            with contextlib.closing(sqlite3.connect(path)) as base:
                add_layer_styles(base, layers)
        _check_whole(path, layers)
        return path.read_bytes()
    except (DataSourceError, DataLayerError, sqlite3.Error, OSError) as error:
        raise OSError(f"{name}: it cannot be written: {error}") from error


def _check_whole(path: pathlib.Path, layers: Mapping[str, Layer]) -> None:
    """Raises `OSError` if rows or the spatial index of a layer are missing, which GDAL does not report."""
    with contextlib.closing(sqlite3.connect(path)) as base:
        tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master")}
        for layer, (features, _, _) in layers.items():
            (count,) = base.execute(f'SELECT count(*) FROM "{layer}"').fetchone() if layer in tables else (0,)
            has_index = f"rtree_{layer}_geom" in tables or all(one.geometry is None for one in features)
            if count != len(features) or not has_index:
                raise OSError(f"layer {layer!r} is not whole; is there room in {path.parent}?")


def _wkb(feature: Feature) -> bytes | None:
    return None if feature.geometry is None else shapely.to_wkb(feature.geometry, output_dimension=3)
