"""Encoders of fix files: CSV, GeoJSON, GeoPackage, GeoParquet, KML, KMZ and GPX."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from jaxgeo._destination import UNWRITABLE
from jaxgeo.io._cells import Rows, safe_cell
from jaxgeo.io._features import Feature, feature_collection, named_crs
from jaxgeo.io._fix_columns import FIX_DECIMALS
from jaxgeo.io._geopackage import Layer, geopackage
from jaxgeo.io._geoparquet import GeometryColumn, geoparquet
from jaxgeo.io._gpx import TrackPoint, as_bytes, gpx
from jaxgeo.io._kml import RADIUS, Placemark, kml, kmz
from jaxgeo.io._map_crs import MapCRS
from jaxgeo.io._outlines import line as line_through
from jaxgeo.io.tables import ABOVE_TAKEOFF
from jaxgeo.status import Status

PLACE = ("map_x", "map_y", "map_z")  # of a table
# Attributes of a fix that its outline does not repeat.
POINT_ONLY = ("fix_", "slant_", "incidence_", "slope_", "cov_", "bias_", "mgrs", "vertical_datum", "status_text")
ISO = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]{1,9})?Z")


class FixTable(NamedTuple):
    """Content of a file of n fixes: rows, map coordinates (n, 3), NaN if there are none, and outlines of accuracy.

    Columns in `carried` are the caller's.
    """

    name: str
    chart: MapCRS
    rows: list[dict[str, Any]]
    places: np.ndarray
    outlines: list[BaseGeometry | None]
    kinds: list[str]
    carried: frozenset[str]
    metadata: Mapping[str, Any]
    detected: tuple[BaseGeometry | None, ...] = ()  # outlines of what was detected; empty if there are none
    style: bool = False  # whether a GeoPackage holds a style
    is_above_takeoff: bool = False  # whether heights are above a take-off of unknown height: points have none then

    @property
    def points(self) -> list[BaseGeometry | None]:
        """Points with heights above a datum, if there is one; None for a fix without coordinates."""
        axes = 2 if self.is_above_takeoff else 3
        return [shapely.Point(place[:axes]) if np.isfinite(place).all() else None for place in self.places]


def _outline_row(table: FixTable, i: int) -> dict[str, Any]:
    whole = table.rows[i]
    row = {name: whole[name] for name in whole if name in table.carried or not name.startswith(POINT_ONLY)}
    return {"index": row.pop("index"), "kind": table.kinds[i]} | row


def _detected_row(table: FixTable, i: int) -> dict[str, Any]:
    return _outline_row(table, i) | {"kind": "detection"}


def _csv(table: FixTable) -> bytes:
    """CSV with the semi-axes instead of outlines, and map coordinates in columns of their own."""
    decimals = dict(zip(PLACE, [10 if table.chart.flat.is_geographic else 4] * 2 + [4], strict=True)) | FIX_DECIMALS
    stream = io.StringIO(newline="")
    writer = None
    for i, (row, place) in enumerate(zip(table.rows, table.places, strict=True)):
        mapped = {name: x if math.isfinite(x) else None for name, x in zip(PLACE, place.tolist(), strict=True)}
        if table.is_above_takeoff:
            del mapped["map_z"]
        line = row | mapped | {"crs": table.metadata["crs"]}
        line["vertical_datum"] = line.pop("vertical_datum")  # moved to the end
        if table.detected:
            outline = table.detected[i]
            line["detection"] = None if outline is None else shapely.to_wkt(outline, decimals[PLACE[0]])
        if writer is None:
            writer = csv.DictWriter(Rows(stream), list(line), lineterminator="\r\n")
            writer.writerow({name: safe_cell(name) for name in line})
        writer.writerow({name: safe_cell(_text(value, decimals.get(name))) for name, value in line.items()})
    return stream.getvalue().encode("utf-8", UNWRITABLE)


def _text(value: Any, decimals: int | None) -> Any:
    """A cell; empty for None."""
    return value if value is None or decimals is None else f"{value:.{decimals}f}"


def _geojson(table: FixTable) -> bytes:
    """Points, then outlines, in one collection, distinguished by `kind`; a member "jaxgeo" has common metadata."""
    features = [
        Feature(point, {"index": row["index"], "kind": "fix"} | row)
        for point, row in zip(table.points, table.rows, strict=True)
    ]
    features += [Feature(one, _outline_row(table, i)) for i, one in enumerate(table.outlines) if one is not None]
    features += [Feature(one, _detected_row(table, i)) for i, one in enumerate(table.detected) if one is not None]
    chart = table.chart  # with ellipsoidal heights it may have no code: its horizontal part has
    head = named_crs(table.name, chart.crs, chart.flat) | {"jaxgeo": table.metadata}
    return feature_collection(features, chart.flat, head)


def _geopackage(table: FixTable) -> bytes:
    fixes = [Feature(point, row) for point, row in zip(table.points, table.rows, strict=True)]
    layers = {"fixes": Layer(fixes, table.chart.crs, "Point" if table.is_above_takeoff else "Point Z")}
    drawn = [Feature(one, _outline_row(table, i)) for i, one in enumerate(table.outlines) if one is not None]
    if drawn:
        kinds = {one.geometry.geom_type for one in drawn if one.geometry is not None}
        layers["ellipses"] = Layer(drawn, table.chart.flat, "Polygon" if kinds == {"Polygon"} else "Unknown")
    seen = [Feature(one, _detected_row(table, i)) for i, one in enumerate(table.detected) if one is not None]
    if seen:
        layers["detections"] = Layer(seen, table.chart.flat, "Unknown")
    return geopackage(table.name, layers, table.metadata, style=table.style)


def as_parquet(table: FixTable, types: Mapping[str, str] | None = None) -> bytes:
    """A GeoParquet; as a part of a dataset, of given types of columns, with all of its geometries."""
    columns = {name: [row[name] for row in table.rows] for name in table.rows[0]}
    geometries = {"geometry": GeometryColumn(table.points, table.chart.crs)}
    if any(one is not None for one in table.outlines) or (types is not None and "kind" in types):
        geometries["ellipse"] = GeometryColumn(table.outlines, table.chart.flat)
        columns["kind"] = [None if one is None else kind for one, kind in zip(table.outlines, table.kinds, strict=True)]
    if table.detected:
        geometries["detection"] = GeometryColumn(list(table.detected), table.chart.flat)
    return geoparquet(columns, geometries, table.metadata, types)


def when(row: Mapping[str, Any]) -> str | None:
    """The time of a row as ISO 8601: its column `time_utc`, if that holds one."""
    text = row.get("time_utc")
    return text if isinstance(text, str) and ISO.fullmatch(text) else None


def _with_time(name: str, time: str | None) -> str:
    """The name of an image, or the number of a frame with its time."""
    return name if time is None or not name.isdecimal() else f"{name}, {time}"


def _titles(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of fixes on a map: those of their images, with the pixel where one image has several; numbered frames with
    their times."""
    names = [_with_time(f"{row.get('name') or f'fix {i}'}", when(row)) for i, row in enumerate(rows)]
    each = [tuple(f"{row[axis]:g}" for axis in "uv" if isinstance(row.get(axis), int | float)) for row in rows]
    pixels: dict[str, set[tuple[str, ...]]] = {}
    for name, pixel in zip(names, each, strict=True):
        pixels.setdefault(name, set()).add(pixel)
    return [
        f"{name}, pixel {', '.join(pixel)}" if len(pixels[name]) > 1 and pixel else name
        for name, pixel in zip(names, each, strict=True)
    ]


ABOVE_SEA = "Heights of points are above mean sea level, EGM96; fix_height_m is above the WGS 84 ellipsoid."
ON_THE_GROUND = (
    f"{ABOVE_TAKEOFF} is above the take-off, whose own height is unknown: points are drawn on the ground of the map."
)


def _kml(table: FixTable) -> bytes:
    points, areas = [], []
    for i, (title, row, place) in enumerate(zip(_titles(table.rows), table.rows, table.places, strict=True)):
        known = bool(np.isfinite(place).all())
        style = "lost" if not known else "fix" if row["status"] == Status.hit.name else "uncertain"
        at = tuple(place.tolist()[: 2 if table.is_above_takeoff else 3]) if known else None
        points.append(Placemark(title if known else f"{title}: {row['status']}", style, row, at, when(row)))
        if table.outlines[i] is not None:
            own = _outline_row(table, i)
            areas.append(Placemark(f"{table.kinds[i]} of {title}", "area", own, table.outlines[i], when(row)))
    shapes = [
        Placemark(
            f"{table.rows[i].get('label') or 'detection'} in {table.rows[i].get('name') or i}",
            "area",
            _detected_row(table, i),
            one,
            when(table.rows[i]),
        )
        for i, one in enumerate(table.detected)
        if one is not None
    ]
    share = table.metadata.get("probability")
    about = ON_THE_GROUND if table.is_above_takeoff else ABOVE_SEA
    about += f" Outlines hold the truth with a probability of {share:g}." if areas else ""
    try:
        folders = {"Fixes": points} | ({"Ellipses": areas} if areas else {})
        folders |= {"Detections": shapes} if shapes else {}
        return kml("Fixes", about, folders | _path(table))
    except ValueError as error:
        raise ValueError(f"{table.name}: {error}") from error


def _path(table: FixTable) -> dict[str, list[Placemark]]:
    """A folder with the line through fixes that have a time of its own each, in order of time; none for others."""
    known = [all(one) for one in np.isfinite(table.places).tolist()]
    timed = [(when(row), *place) for row, place in zip(table.rows, table.places.tolist(), strict=True)]
    timed = [one for one, is_known in zip(timed, known, strict=True) if is_known]
    times = {time for time, *_ in timed}
    if len(times) < max(len(timed), 2) or None in times:
        return {}
    through = line_through(np.array([place for _, *place in sorted(timed)]), 360.0)
    return {"Path": [Placemark("Path of the fixes", "outline", {"fixes": len(timed)}, through)]}


def _radii(row: Mapping[str, Any]) -> str | None:
    """The radii of accuracy of a row in words: "CE90 7.90 m, LE90 3.29 m"; None if there are none."""
    found = [(RADIUS.fullmatch(name), value) for name, value in row.items()]
    texts = [
        f"{name[1].upper()}{name[2].replace('_', '.')} {value:.2f} m"
        for name, value in found
        if name is not None and isinstance(value, float) and math.isfinite(value)
    ]
    return ", ".join(texts) or None


def _kmz(table: FixTable) -> bytes:
    return kmz(_kml(table))


def _gpx(table: FixTable) -> bytes:
    """One track of the fixes with coordinates, in their order, with times where they are in UTC."""
    points = [
        TrackPoint(title, float(place[0]), float(place[1]), height, time=when(row), about=_radii(row))
        for title, row, place in zip(_titles(table.rows), table.rows, table.places, strict=True)
        if np.isfinite(place).all()
        for height in [None if table.is_above_takeoff else float(place[2])]
    ]
    about = "Fixes on the ground on WGS 84, " + (
        "without heights: that of the take-off is unknown."
        if table.is_above_takeoff
        else "heights above mean sea level (EGM96)."
    )
    try:
        return as_bytes(gpx(about, [("Fixes", points)]))
    except ValueError as error:
        raise ValueError(f"{table.name}: {error}") from error


WRITERS: dict[str, Callable[[FixTable], bytes]] = {
    ".csv": _csv,
    ".geojson": _geojson,
    ".json": _geojson,
    ".gpkg": _geopackage,
    ".parquet": as_parquet,
    ".kml": _kml,
    ".kmz": _kmz,
    ".gpx": _gpx,
}
STYLED = (".gpkg", ".geojson", ".json")
FIXED_CRS = (_kml, _kmz, _gpx)  # longitude and latitude on WGS 84, heights above EGM96
