"""Fixes with their accuracy as files: tables, GIS layers and KML, in any CRS of PROJ."""

from __future__ import annotations

import importlib.metadata
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from shapely.geometry.base import BaseGeometry

from jaxgeo._checks import check_is, require_x64
from jaxgeo._destination import destination
from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io._attributes import attribute_rows
from jaxgeo.io._ellipses import ellipse_polygons
from jaxgeo.io._features import WGS84
from jaxgeo.io._fix_columns import Figures, checked_attributes, figures_of, no_figures, rows_of
from jaxgeo.io._fix_formats import FIXED_CRS, PLACE, STYLED, WRITERS, FixTable
from jaxgeo.io._map_crs import MapCRS, code_of, described, flat_map_crs, map_crs
from jaxgeo.io._mgrs import mgrs_of
from jaxgeo.io._outlines import outline
from jaxgeo.io._qgis import qml
from jaxgeo.io.geoid import EGM96, degrees_of
from jaxgeo.io.tables import ABOVE_TAKEOFF
from jaxgeo.status import Status

STYLE = ".qml"
TAKEN = ("kind", "detection", "mgrs", *PLACE, "crs", "vertical_datum", "fid", "geom", "geometry", "ellipse")
UNITS = {"_m": "m", "_m2": "m^2", "_deg": "deg", "azimuth_deg": "deg clockwise from north, of the longer semi-axis"}


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
    attributes: Sequence[Mapping[str, Any]] | Mapping[str, Any] | None = None,
    ellipses: bool = True,
    mgrs: bool = False,
    reasons: Sequence[str | None] | None = None,
    rings: Sequence[np.ndarray | None] | None = None,
    style: bool = False,
    is_above_takeoff: bool = False,
) -> None:
    """Write fixes and their accuracy to .csv, .geojson or .json, .gpkg, .parquet, .kml, .kmz or .gpx.

    `fixes` is one fix or a batch of n. Fixes without coordinates are written too, without geometry, with their status.
    Columns are those of `jaxgeo.io.tables.FIX_COLUMNS` (on WGS 84, heights above its ellipsoid and above EGM96), and:

    - `accuracy`: the result of `accuracy` for each fix (a list with None where unknown), or of
      `accuracy` for all: radii such as `ce90_m`, `le90_m`, `se90_m`, infinite (in
      GeoJSON null) where too many samples have no fix, and the method.
    - `cov_enu` (n, 3, 3) in m², east, north, up, and `bias_enu` (n, 3) in m, the mean error: rows of NaN where
      unknown. Radii and the semi-axes of the ellipse (centred on the fix plus the bias) are computed from
      them, for the `probability` (0.9, or that of `accuracy`). By default those of `accuracy`, where a linear
      propagation is valid.
    - `crs`: anything pyproj takes. `heights`: "ellipsoid", or a vertical CRS such as "EPSG:5773" (EGM96), "EPSG:3855"
      (EGM2008); by default those of the CRS, and for a 2D one above the ellipsoid. The file names both; tables in the
      columns `crs` and `vertical_datum` beside `map_x`, `map_y`, `map_z`. GeoJSON in another CRS than
      EPSG:4979 names it with the pre-RFC 7946 member, which not every reader supports. KML and GPX are always in WGS 84
      with heights above EGM96; GPX has one track of the fixes with coordinates, with their times.
    - `attributes`: for each fix numbers, texts, bools or None by name, the same names for all; or one mapping of names
      to a value for each fix. KML shows `name`.
    - `ellipses`: also the outline on the ground that contains the true point with the probability, of kind "ellipse",
      or "circle" if only a radius is known; none if it has no area. Outlines are in the horizontal CRS, in a layer
      `ellipses` (.gpkg), a second geometry column (.parquet), or features or placemarks of their own.
    - `mgrs`: also the MGRS reference to 1 m (needs the extra `gis`, as .gpkg and .parquet do).
    - `reasons`: for each fix None, or a text for the column `status_text` instead of that of its status, for example
      that its file could not be read.
    - `rings`: for each fix None, or the outline (m, 3) of what was detected there: longitudes and latitudes in deg,
      heights above the ellipsoid in m. They are features or placemarks of kind "detection", a layer `detections`
      (.gpkg), a geometry column `detection` (.parquet), or well-known text in a column `detection` (.csv).

    - `style`: also a style for QGIS, points by status and outlines without a fill: in a GeoPackage as default of its
      layers (table `layer_styles`), of GeoJSON in a file beside it with the ending .qml.
    - `is_above_takeoff`: whether heights of fixes are above a take-off whose own height is unknown. Their column is
      `fix_height_above_takeoff_m`, without those above the ellipsoid and EGM96; points have no height, in KML they are
      clamped to the ground, and `crs` must be horizontal.

    The file appears only when complete. Raises `ValueError` for a path that cannot be written to, no fixes, a CRS
    that is unknown, unsuitable or does not cover the fixes, unknown heights, and arguments that do not match the fixes;
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
    check_style(target, style)
    check_is(fixes, Fix, "fixes", "Stack many into one record, as `jax.vmap` of `locate` gives them.")
    fixes = _batch(target, fixes)
    with destination("fixes", target, binary=True) as stream:
        chart = _chart(target, crs, heights, fixes.position, is_above_takeoff)
        figures = figures_of(f"{target}", fixes, accuracy, cov_enu, bias_enu, probability)
        how: dict[str, Any] = {"mgrs": mgrs, "reasons": reasons, "is_above_takeoff": is_above_takeoff}
        table = _table_of(target, chart, fixes, figures, attributes, ellipses=ellipses, **how)
        detected = _detected(f"{target}", chart, rings, len(table.rows))
        stream.write(write(table._replace(detected=detected, style=style)))
    if style and target.suffix.lower() != ".gpkg":
        with destination("style", target.with_suffix(STYLE)) as stream:
            stream.write(qml())


def check_style(target: pathlib.Path, style: bool) -> None:
    """Raises `ValueError` for a style of a file that can have none."""
    if style and target.suffix.lower() not in STYLED:
        raise ValueError(f"{target}: only {', '.join(STYLED)} have a style for QGIS; leave style= out.")


def check_fix_file(
    path: str | os.PathLike[str],
    crs: Any,
    heights: Any,
    near: Geodetic,
    *,
    attributes: Sequence[Mapping[str, Any]] | Mapping[str, Any] | None = None,
    mgrs: bool = False,
    reasons: Sequence[str | None] | None = None,
    probability: float | None = None,
    is_above_takeoff: bool = False,
) -> None:
    """Raises as `write_fixes` would for this name, CRS, vertical datum and attributes, before fixes are computed.

    Writes a file without coordinates in memory. `near` are n positions close to the fixes, `probability` is that of
    their accuracy, None without one.
    """
    target = pathlib.Path(path)
    write, chart = _writer(target), _chart(target, crs, heights, near, is_above_takeoff)
    count = np.size(near.lat)
    nothing = np.full(count, np.nan)
    position, status = Geodetic(lat=nothing, lon=nothing, height=nothing), np.full(count, Status.file_not_read, np.int8)
    fixes = Fix(position, np.full((count, 3), np.nan), nothing, nothing, nothing, nothing, status)
    figures = None if probability is None else no_figures(count, probability)
    how: dict[str, Any] = {"mgrs": mgrs, "reasons": reasons, "is_above_takeoff": is_above_takeoff}
    table = _table_of(target, chart, fixes, figures, attributes, ellipses=False, **how)
    one = slice(None) if write in FIXED_CRS else slice(1)  # any row may have text that XML cannot hold
    write(table._replace(rows=table.rows[one], places=table.places[one], outlines=table.outlines[one]))


def _chart(target: pathlib.Path, crs: Any, heights: Any, near: Geodetic, is_above_takeoff: bool) -> MapCRS:
    chart_of = _fixed_crs if _writer(target) in FIXED_CRS else map_crs
    if is_above_takeoff:
        chart_of = _fixed_flat_crs if _writer(target) in FIXED_CRS else flat_map_crs
    lat, lon, _ = degrees_of(near)
    return chart_of(f"{target}", crs, heights, _extent(lon, lat))


def _table_of(
    target: pathlib.Path,
    chart: MapCRS,
    fixes: Fix,
    figures: Figures | None,
    attributes: Any,
    *,
    mgrs: bool,
    reasons: Any,
    ellipses: bool,
    is_above_takeoff: bool,
) -> FixTable:
    rows = _rows(f"{target}", fixes, figures, attributes, chart, mgrs, reasons, is_above_takeoff)
    lat, lon, height = degrees_of(fixes.position)
    places = chart.points(f"{target}", lon, lat, height)
    outlines, kinds = _outlines(f"{target}", chart, fixes, figures if ellipses else None)
    given = attribute_rows(f"{target}", attributes, len(rows), "fixes")
    carried = frozenset(str(name) for row in given or () for name in row)
    metadata = _metadata(chart, figures, is_above_takeoff)
    table = FixTable(f"{target}", chart, rows, places, outlines, kinds, carried, metadata)
    return table._replace(is_above_takeoff=is_above_takeoff)


def _writer(target: pathlib.Path) -> Callable[[FixTable], bytes]:
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
    """(west, south, east, north) in deg, around the first known position."""
    known = np.isfinite(lon) & np.isfinite(lat)
    if not known.any():
        return None
    lon, lat = lon[known], lat[known]
    beside = np.remainder(lon - lon[0] + 180.0, 360.0) - 180.0
    west, east = (np.remainder(lon[0] + x + 180.0, 360.0) - 180.0 for x in (beside.min(), beside.max()))
    return float(west), float(lat.min()), float(east), float(lat.max())


def _fixed_crs(name: str, crs: Any, heights: Any, area: Any) -> MapCRS:
    """The fixed CRS of KML and GPX; raises for any other."""
    own, asked = map_crs(name, "EPSG:4326", EGM96, area), map_crs(name, crs, heights, area)
    is_left_out = heights is None and code_of(asked.crs) in WGS84
    if not is_left_out and asked.crs != own.crs:
        kind = name[-3:].upper()
        raise ValueError(
            f"{name}: {kind} has longitudes and latitudes on WGS 84 and heights above EGM96, and no others; "
            f"leave crs and heights out, or write a .gpkg."
        )
    return own


def _fixed_flat_crs(name: str, crs: Any, heights: Any, area: Any) -> MapCRS:
    """The fixed CRS of KML and GPX without heights; raises for any other."""
    asked = flat_map_crs(name, crs, heights, area)
    if code_of(asked.crs) not in WGS84:
        raise ValueError(
            f"{name}: {name[-3:].upper()} has longitudes and latitudes on WGS 84; leave crs out, or write a .gpkg."
        )
    return asked


def _rows(
    name: str,
    fixes: Fix,
    figures: Figures | None,
    attributes: Any,
    chart: MapCRS,
    mgrs: bool,
    reasons: Any,
    is_above_takeoff: bool,
) -> list[dict[str, Any]]:
    if reasons is not None and len(reasons) != len(fixes.status):
        raise ValueError(f"{name}: reasons must be one, or None, for each of {len(fixes.status)} fixes.")
    own = rows_of(fixes, figures, reasons, is_above_takeoff=is_above_takeoff)
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
    """The ellipse of each fix, or a circle where only a radius is known."""
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


def _detected(
    name: str, chart: MapCRS, rings: Sequence[np.ndarray | None] | None, count: int
) -> tuple[BaseGeometry | None, ...]:
    """The outlines of what was detected, on the map; empty if there are none."""
    if rings is None or all(ring is None for ring in rings):
        return ()
    if len(rings) != count:
        raise ValueError(f"{name}: rings must be one, or None, for each of {count} fixes; got {len(rings)}.")
    found: list[BaseGeometry | None] = []
    for ring in rings:
        if ring is None:
            found.append(None)
            continue
        found.append(outline(chart.points(name, *np.asarray(ring, np.float64).T)[:, :2], chart.turn))
    return tuple(found)


def _metadata(chart: MapCRS, figures: Figures | None, is_above_takeoff: bool) -> Mapping[str, Any]:
    """Metadata common to all fixes of a file."""
    try:
        software = f"jaxgeo {importlib.metadata.version('jaxgeo')}"
    except importlib.metadata.PackageNotFoundError:
        software = "jaxgeo"
    facts: dict[str, Any] = {"software": software, **described(chart)}
    if figures is not None:
        facts["probability"] = figures.probability
        facts["figures"] = "radii, and outlines, hold the truth with the probability; bias and cov are of one sigma"
    heights = "fix_height_m above its ellipsoid, fix_height_msl_m: EGM96"
    if is_above_takeoff:
        heights = f"{ABOVE_TAKEOFF} above the take-off, whose own height is unknown"
    facts["fix_columns"] = f"fix_lat_deg, fix_lon_deg on WGS 84, {heights}"
    facts["units"] = UNITS
    facts["statuses"] = {one.name: one.message for one in Status}
    return facts
