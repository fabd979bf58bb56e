"""Fixes as files, with how sure they are: tables, maps, and what a globe shows, in any CRS that PROJ knows."""

from __future__ import annotations

import csv
import importlib.metadata
import io
import json
import math
import os
import pathlib
import tempfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from jaxgeo._checks import check_is, require_x64
from jaxgeo._destination import UNWRITABLE, destination
from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io._cells import Rows, safe_cell
from jaxgeo.io._ellipses import ellipse_polygons
from jaxgeo.io._features import DECIMALS, Feature
from jaxgeo.io._fix_columns import FIX_DECIMALS, Figures, checked_attributes, figures_of, rows_of
from jaxgeo.io._geoparquet import GeometryColumn, geoparquet
from jaxgeo.io._kml import Placemark, kml, kmz
from jaxgeo.io._layers import Layer, geopackage
from jaxgeo.io._map_crs import MapCRS, code_of, described, map_crs
from jaxgeo.io._mgrs import mgrs_of
from jaxgeo.io.geoid import EGM96, degrees_of
from jaxgeo.status import Status

PLACE = ("map_x", "map_y", "map_z")  # of a table
TAKEN = ("kind", "mgrs", *PLACE, "crs", "vertical_datum", "fid", "geom", "geometry", "ellipse")
# What an outline does not say again of its fix.
POINT_ONLY = ("fix_", "slant_", "incidence_", "slope_", "cov_", "bias_", "mgrs", "vertical_datum", "status_text")
UNITS = {"_m": "m", "_m2": "m^2", "_deg": "deg", "azimuth_deg": "deg clockwise from north, of the longer semi-axis"}
WGS84 = ("EPSG:4979", "EPSG:4326", "OGC:CRS84", "OGC:CRS84h")


class _Told(NamedTuple):
    """What is written of n fixes: rows, coordinates (n, 3) on the map, NaN where there are none, and outlines.

    Columns named in `carried` are the caller's.
    """

    name: str
    chart: MapCRS
    rows: list[dict[str, Any]]
    places: np.ndarray
    outlines: list[BaseGeometry | None]
    kinds: list[str]
    carried: frozenset[str]
    metadata: Mapping[str, Any]

    @property
    def points(self) -> list[BaseGeometry | None]:
        """Points with heights; None of a fix without coordinates."""
        return [shapely.Point(place) if np.isfinite(place).all() else None for place in self.places]


def write_fixes(
    path: str | os.PathLike[str],
    fixes: Fix | Any,
    *,
    accuracy: Any = None,
    cov_enu: Any = None,
    bias_enu: Any = None,
    probability: float | None = None,
    crs: Any = "EPSG:4326",
    heights: Any = None,
    attributes: Sequence[Mapping[str, Any]] | None = None,
    ellipses: bool = True,
    mgrs: bool = False,
    reasons: Sequence[str | None] | None = None,
) -> None:
    """Fixes and how sure they are, written to .csv, .geojson or .json, .gpkg, .parquet, .kml or .kmz.

    `fixes` is one fix or a batch of n. A fix without coordinates is written too, with no geometry and its status. Each
    has the columns of `jaxgeo.io.tables.FIX_COLUMNS` (on WGS 84, heights above its ellipsoid and above EGM96), and:

    - `accuracy`: what `accuracy` tells of each fix (a list with None where it is not known), or `accuracy_of_each` or
      `accuracy_of_pixels` of all: radii such as `ce90_m`, `le90_m`, `se90_m`, infinite (in GeoJSON null) where too many
      samples have no fix, and by which method.
    - `cov_enu` (n, 3, 3) in m², east, north, up, and `bias_enu` (n, 3) in m, the mean of the errors: rows of NaN where
      unknown. Radii and the semi-axes of the ellipse, which lies about the fix moved by the bias, are computed from
      them, with the `probability` (0.9, or that of `accuracy`). By default those of `accuracy`, where it trusts a
      propagation.
    - `crs`: anything pyproj takes. `heights`: "ellipsoid", or a vertical CRS such as "EPSG:5773" (EGM96), "EPSG:3855"
      (EGM2008); by default those of the CRS, and of a flat one above the ellipsoid. Both are named in the file, in a
      table beside `map_x`, `map_y`, `map_z` by the columns `crs` and `vertical_datum`. GeoJSON in another CRS than
      EPSG:4979 names it in the way that came before RFC 7946, which not every reader knows. KML has its own: WGS 84,
      heights above EGM96.
    - `attributes`: for each fix numbers, texts, bools or None by name, the same names for all. KML shows `name`.
    - `ellipses`: also the outline on the ground that holds the truth with the probability, of a kind "ellipse", or
      "circle" where only a radius is known; none for one without area. They lie in the horizontal CRS, in a layer
      `ellipses` (.gpkg), a second column of geometries (.parquet), features or placemarks of their own.
    - `mgrs`: also the square metre in the Military Grid Reference System (with the extra `gis`, as .parquet).
    - `reasons`: for each fix None, or the sentence that stands in the column `status_text` in place of that of its
      status: why there is none, such as that its file could not be read.

    The file appears when all is written. Raises `ValueError` for a path that cannot be written to, no fixes, a CRS
    that is unknown, is no map or does not reach, heights that cannot be named, and what does not belong to the fixes;
    `VerticalDatumError` where a grid is missing; `ImportError` without the extra; `OSError` where writing fails.

    >>> import pathlib, tempfile
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    >>> shot = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=1600.0))
    >>> fix = jaxgeo.locate(sensor, shot, (0, 0), jaxgeo.ConstantHeight(600.0))
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name) / "fixes.csv"
    >>> jaxgeo.io.write_fixes(path, fix, crs="EPSG:32632", heights="EPSG:5773")
    >>> names, row = (line.split(",") for line in path.read_text().splitlines())
    >>> found = dict(zip(names, row))
    >>> print(found["status"], found["crs"], found["map_x"][:9], found["map_z"][:6], found["vertical_datum"])
    hit EPSG:32632+5773 651498.55 550.39 EGM96 height
    >>> folder.cleanup()
    """
    require_x64()
    target = pathlib.Path(path)
    write = _writer(target)
    check_is(fixes, Fix, "fixes", "Stack many into one record, as `jax.vmap` of `locate` gives them.")
    fixes = _batch(target, fixes)
    with destination("fixes", target, binary=True) as stream:
        chart_of = _kml_crs if write in (_kml, _kmz) else map_crs
        lat, lon, height = degrees_of(fixes.position)
        chart = chart_of(f"{target}", crs, heights, _extent(lon, lat))
        figures = figures_of(f"{target}", fixes, accuracy, cov_enu, bias_enu, probability)
        rows = _rows(f"{target}", fixes, figures, attributes, chart, mgrs, reasons)
        places = chart.points(f"{target}", lon, lat, height)
        outlines, kinds = _outlines(f"{target}", chart, fixes, figures if ellipses else None)
        carried = frozenset(str(name) for row in attributes or () for name in row)
        told = _Told(f"{target}", chart, rows, places, outlines, kinds, carried, _metadata(chart, figures))
        stream.write(write(told))


def check_fix_file(path: str | os.PathLike[str], crs: Any, heights: Any, near: Geodetic) -> None:
    """Raises as `write_fixes` would for this name, CRS and vertical datum, and fixes `near` a batch of points."""
    target = pathlib.Path(path)
    chart_of = _kml_crs if _writer(target) in (_kml, _kmz) else map_crs
    lat, lon, _ = degrees_of(near)
    chart_of(f"{target}", crs, heights, _extent(lon, lat))


def _writer(target: pathlib.Path) -> Callable[[_Told], bytes]:
    try:
        return WRITERS[target.suffix.lower()]
    except KeyError:
        raise ValueError(f"{target}: fixes are written to files that end in {', '.join(WRITERS)}.") from None


def _batch(target: pathlib.Path, fixes: Fix) -> Fix:
    shape = np.shape(np.asarray(fixes.status))
    if len(shape) > 1 or shape == (0,):
        raise ValueError(f"{target}: fixes must be one, or a batch of n > 0; got a batch of the shape {shape}.")
    on_host = jax.tree.map(np.asarray, fixes)
    return on_host if shape else jax.tree.map(lambda leaf: leaf[None], on_host)


def _extent(lon: np.ndarray, lat: np.ndarray) -> tuple[float, float, float, float] | None:
    """(west, south, east, north) in deg, about the first place that is known."""
    known = np.isfinite(lon) & np.isfinite(lat)
    if not known.any():
        return None
    lon, lat = lon[known], lat[known]
    beside = np.remainder(lon - lon[0] + 180.0, 360.0) - 180.0
    west, east = (np.remainder(lon[0] + x + 180.0, 360.0) - 180.0 for x in (beside.min(), beside.max()))
    return float(west), float(lat.min()), float(east), float(lat.max())


def _kml_crs(name: str, crs: Any, heights: Any, area: Any) -> MapCRS:
    """The one CRS of KML; another cannot be asked for."""
    own, asked = map_crs(name, "EPSG:4326", EGM96, area), map_crs(name, crs, heights, area)
    is_left_out = heights is None and code_of(asked.crs) in WGS84
    if not is_left_out and asked.crs != own.crs:
        raise ValueError(
            f"{name}: KML has longitudes and latitudes on WGS 84 and heights above EGM96, and no others; leave crs and "
            f"heights out, or write a .gpkg."
        )
    return own


def _rows(
    name: str, fixes: Fix, figures: Figures | None, attributes: Any, chart: MapCRS, mgrs: bool, reasons: Any
) -> list[dict[str, Any]]:
    if reasons is not None and len(reasons) != len(fixes.status):
        raise ValueError(f"{name}: reasons must be one, or None, for each of {len(fixes.status)} fixes.")
    own = rows_of(fixes, figures, reasons)
    extra = checked_attributes(name, attributes, len(own), {*own[0], *TAKEN})
    squares: list[dict[str, Any]] = [{} for _ in own]
    if mgrs:
        lat, lon, _ = degrees_of(fixes.position)
        squares = [{"mgrs": square} for square in mgrs_of(lat, lon)]
    datum = {"vertical_datum": chart.vertical_datum}
    return [
        {"index": row.pop("index")} | more | row | at | datum for row, more, at in zip(own, extra, squares, strict=True)
    ]


def _outlines(
    name: str, chart: MapCRS, fixes: Fix, figures: Figures | None
) -> tuple[list[BaseGeometry | None], list[str]]:
    """Of each fix its ellipse, or the circle of a radius that is known without one."""
    count = len(fixes.status)
    if figures is None:
        return [None] * count, [""] * count
    axes, azimuth, centre = figures.axes.copy(), figures.azimuth.copy(), figures.bias_enu[:, :2].copy()
    alone = np.isnan(axes[:, 0]) & np.isfinite(figures.circular)
    axes[alone], azimuth[alone], centre[alone] = figures.circular[alone, None], 0.0, 0.0
    lat, lon, _ = degrees_of(fixes.position)
    lonlat = np.stack([lon, lat], axis=-1)
    polygons = ellipse_polygons(name, chart, lonlat, np.asarray(fixes.ecef), axes, azimuth, centre)
    return polygons, ["circle" if one else "ellipse" for one in alone]


def _metadata(chart: MapCRS, figures: Figures | None) -> Mapping[str, Any]:
    """What all fixes of a file have in common."""
    try:
        software = f"jaxgeo {importlib.metadata.version('jaxgeo')}"
    except importlib.metadata.PackageNotFoundError:
        software = "jaxgeo"
    told: dict[str, Any] = {"software": software, **described(chart)}
    if figures is not None:
        told["probability"] = figures.probability
        told["figures"] = "radii, and outlines, hold the truth with the probability; bias and cov are of one sigma"
    told["fix_columns"] = (
        "fix_lat_deg, fix_lon_deg on WGS 84, fix_height_m above its ellipsoid, fix_height_msl_m: EGM96"
    )
    told["units"] = UNITS
    told["statuses"] = {one.name: one.message for one in Status}
    return told


def _outline_row(told: _Told, i: int) -> dict[str, Any]:
    whole = told.rows[i]
    row = {name: whole[name] for name in whole if name in told.carried or not name.startswith(POINT_ONLY)}
    return {"index": row.pop("index"), "kind": told.kinds[i]} | row


def _csv(told: _Told) -> bytes:
    """No outlines, but the semi-axes; coordinates on the map in columns of their own."""
    decimals = dict(zip(PLACE, [10 if told.chart.flat.is_geographic else 4] * 2 + [4], strict=True)) | FIX_DECIMALS
    stream = io.StringIO(newline="")
    writer = None
    for row, place in zip(told.rows, told.places, strict=True):
        mapped = {name: x if math.isfinite(x) else None for name, x in zip(PLACE, place.tolist(), strict=True)}
        line = row | mapped | {"crs": told.metadata["crs"]}
        line["vertical_datum"] = line.pop("vertical_datum")  # as the last
        if writer is None:
            writer = csv.DictWriter(Rows(stream), list(line), lineterminator="\r\n")
            writer.writerow({name: safe_cell(name) for name in line})
        writer.writerow({name: safe_cell(_text(value, decimals.get(name))) for name, value in line.items()})
    return stream.getvalue().encode("utf-8", UNWRITABLE)


def _text(value: Any, decimals: int | None) -> Any:
    """A cell: empty for None."""
    return value if value is None or decimals is None else f"{value:.{decimals}f}"


def _geojson(told: _Told) -> bytes:
    """Points, then outlines, in one collection; `kind` says which is which, and a member "jaxgeo" what all share."""
    decimals = int(DECIMALS[told.chart.flat.is_geographic])
    features = []
    for row, place in zip(told.rows, told.places, strict=True):
        known = np.isfinite(place).all()
        at = [round(x, n) for x, n in zip(place.tolist(), (decimals, decimals, 4), strict=True)] if known else None
        geometry = {"type": "Point", "coordinates": at} if known else None
        own = {"index": row["index"], "kind": "fix"} | row
        features.append({"type": "Feature", "geometry": geometry, "properties": own})
    for i, outline in enumerate(told.outlines):
        if outline is not None:
            mapped = shapely.geometry.mapping(shapely.transform(outline, lambda ring: np.round(ring, decimals)))
            features.append({"type": "Feature", "geometry": mapped, "properties": _outline_row(told, i)})
    head: dict[str, Any] = {"type": "FeatureCollection"} | _named_crs(told) | {"jaxgeo": told.metadata}
    for feature in features:
        feature["properties"] = {name: _json(value) for name, value in feature["properties"].items()}
    texts = (json.dumps(feature, allow_nan=False, ensure_ascii=False) for feature in features)
    text = json.dumps(head, ensure_ascii=False)[:-1] + ', "features": [\n' + ",\n".join(texts) + "\n]}\n"
    return text.encode("utf-8", UNWRITABLE)


def _named_crs(told: _Told) -> dict[str, Any]:
    """The member by which GeoJSON named a CRS before RFC 7946; none for its own, WGS 84 with ellipsoidal heights."""
    chart = told.chart
    if code_of(chart.crs) in WGS84:
        return {}
    code = code_of(chart.crs) or code_of(chart.flat)  # a map with ellipsoidal heights has no code: those go without
    if code is None:
        raise ValueError(
            f"{told.name}: GeoJSON names a crs by its code, and {chart.crs.name!r} has none that PROJ knows; "
            f"write a .gpkg or a .parquet."
        )
    authority, numbers = code.split(":")
    parts = [f"{authority}::{number}" for number in numbers.split("+")]
    urn = f"urn:ogc:def:crs:{parts[0]}" if len(parts) == 1 else f"urn:ogc:def:crs,{','.join(f'crs:{p}' for p in parts)}"
    return {"crs": {"type": "name", "properties": {"name": urn}}}


def _json(value: Any) -> Any:
    """JSON has no NaN and no infinities: they are null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _geopackage(told: _Told) -> bytes:
    fixes = [Feature(point, row) for point, row in zip(told.points, told.rows, strict=True)]
    layers = {"fixes": Layer(fixes, told.chart.crs, "Point Z")}
    drawn = [Feature(one, _outline_row(told, i)) for i, one in enumerate(told.outlines) if one is not None]
    if drawn:
        kinds = {one.geometry.geom_type for one in drawn if one.geometry is not None}
        layers["ellipses"] = Layer(drawn, told.chart.flat, "Polygon" if kinds == {"Polygon"} else "Unknown")
    with tempfile.TemporaryDirectory() as folder:
        return geopackage(told.name, pathlib.Path(folder) / "fixes.gpkg", layers, told.metadata)


def _parquet(told: _Told) -> bytes:
    columns = {name: [row[name] for row in told.rows] for name in told.rows[0]}
    geometries = {"geometry": GeometryColumn(told.points, told.chart.crs)}
    if any(one is not None for one in told.outlines):
        geometries["ellipse"] = GeometryColumn(told.outlines, told.chart.flat)
        columns["kind"] = [None if one is None else kind for one, kind in zip(told.outlines, told.kinds, strict=True)]
    return geoparquet(columns, geometries, told.metadata)


def _kml(told: _Told) -> bytes:
    points, areas = [], []
    for i, (row, place) in enumerate(zip(told.rows, told.places, strict=True)):
        known = bool(np.isfinite(place).all())
        style = "lost" if not known else "fix" if row["status"] == Status.hit.name else "uncertain"
        title = f"{row.get('name') or f'fix {i}'}"
        at = tuple(place.tolist()) if known else None
        points.append(Placemark(title if known else f"{title}: {row['status']}", style, row, at))
        if told.outlines[i] is not None:
            areas.append(Placemark(f"{told.kinds[i]} of {title}", "area", _outline_row(told, i), told.outlines[i]))
    share = told.metadata.get("probability")
    about = "Heights of points are above mean sea level, EGM96; fix_height_m is above the WGS 84 ellipsoid."
    about += f" Outlines hold the truth with a probability of {share:g}." if areas else ""
    try:
        return kml("Fixes", about, {"Fixes": points} | ({"Ellipses": areas} if areas else {}))
    except ValueError as error:
        raise ValueError(f"{told.name}: {error}") from error


def _kmz(told: _Told) -> bytes:
    return kmz(_kml(told))


WRITERS: dict[str, Callable[[_Told], bytes]] = {
    ".csv": _csv,
    ".geojson": _geojson,
    ".json": _geojson,
    ".gpkg": _geopackage,
    ".parquet": _parquet,
    ".kml": _kml,
    ".kmz": _kmz,
}
