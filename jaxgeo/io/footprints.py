"""Footprint files: image outlines on the ground as GeoJSON or GeoPackage in any CRS of PROJ, or as KML."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyproj
from pyproj.transformer import Transformer

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.coverage._footprint import Footprint
from jaxgeo.io._attributes import attribute_rows
from jaxgeo.io._features import Feature, has_heights
from jaxgeo.io._geopackage import check_vector_driver, one_layer
from jaxgeo.io._kml import Placemark, as_file, kml
from jaxgeo.io._map_crs import flat_map_crs
from jaxgeo.io._outlines import line, outline, runs
from jaxgeo.io._proj import UNKNOWN_CRS, NoOperation, known_crs, operation
from jaxgeo.io._qgis import qml
from jaxgeo.io.vertical import horizontal_part
from jaxgeo.status import Status

DRIVERS = {".geojson": "GeoJSON", ".json": "GeoJSON", ".gpkg": "GPKG", ".kml": "KML", ".kmz": "KMZ"}
IN_KML = ("KML", "KMZ")
LAYER = "footprints"
OWN = ("index", "kind", "kind_of_edge", "complete", "status", "status_text", "hidden_share", "area_m2")
TAKEN = (*OWN, "fid", "geom", "geometry")  # the last three are reserved by GeoPackage and its readers
WHOLE = "The whole edge of the image sees ground."
FEWEST = 256  # minimum padded number of points; larger sizes are powers of two
SEEN, HIDDEN = 1, 2  # edges
MOST_STRETCHED = 100.0  # ratio of map to ground length; larger ones indicate a seam of the map


class _Map(NamedTuple):
    """A CRS, the transformation from WGS 84, and 360 deg of longitude in its unit (None if it is projected)."""

    crs: pyproj.CRS
    way: Transformer
    turn: float | None


class _Seen(NamedTuple):
    """A footprint in NumPy: n points (longitude and latitude in deg, height in m), the same in ECEF, and its status."""

    places: np.ndarray
    ecef: np.ndarray
    found: np.ndarray
    hidden: np.ndarray
    status: Status
    area: float

    @property
    def is_whole(self) -> bool:
        return self.status == Status.hit


def write_footprints(
    path: str | os.PathLike[str],
    footprints: Sequence[Footprint] | Any,
    *,
    crs: Any = "EPSG:4326",
    attributes: Sequence[Mapping[str, Any]] | Mapping[str, Any] | None = None,
    edges: bool = False,
    style: bool = False,
) -> None:
    """Write image outlines on the ground to GeoJSON (.geojson, .json), GeoPackage (.gpkg) or KML (.kml, .kmz).

    Each footprint is a polygon with the attributes `index` (position in `footprints`), `kind` "outline", `complete`
    (whether the whole edge of the image sees ground), `status` and `status_text`, `hidden_share` (share of the
    outline's 3D length that crosses hidden ground) and `area_m2`. Incomplete footprints have no geometry. Outer rings
    run anticlockwise; polygons are cut at the date line.

    - `crs`: anything pyproj takes. Points have no heights, except in a geographic 3D CRS, such as "EPSG:4979". GeoJSON
      in another CRS than WGS 84 names it with the pre-RFC 7946 member, which not every reader supports. KML is always
      in WGS 84, its outlines clamped to the ground and named by the attribute `name`, if there is one.
    - `attributes`: for each footprint numbers, texts or None by name, the same names for all; or one mapping of
      names to a value for each.
    - `edges`: also lines, of `kind` "edge", along visible ground and where the outline crosses hidden ground
      (`kind_of_edge` "seen" or "hidden"); for incomplete footprints, too.
    - `style`: also a style for QGIS, outlines without a fill, as in `write_fixes`; not of KML, which has its own.

    The file appears only when complete. Raises `ValueError` for a path that cannot be written to, for no footprints,
    for a CRS that is unknown, unsuitable or does not cover the footprints, and for attributes that do not match;
    `ImportError` for a .gpkg without the extra `gis`; `OSError` where writing fails.
    """
    target = pathlib.Path(path)
    driver = _driver(target)
    if style and driver in IN_KML:
        raise ValueError(f"{target}: KML has a style of its own, and none for QGIS; leave style= out.")
    if not isinstance(footprints, list | tuple) or not footprints:
        raise ValueError(f"{target}: footprints must be a list of one or more; got {type(footprints).__name__}.")
    for footprint in footprints:
        check_is(footprint, Footprint, "footprints")
    extra = _checked_attributes(target, attributes, len(footprints))
    with destination("footprints", target, binary=True) as stream:
        seen = [_seen(footprint) for footprint in footprints]
        chart = checked_map(target, crs, driver, seen)
        features: list[Feature] = []
        for index, one in enumerate(seen):
            places = _on_map(target, chart, index, one)
            area = outline(places, chart.turn) if one.is_whole else None
            features.append(Feature(area, _own(index, one) | extra[index]))
            if edges:
                features += _edges(index, one, places, chart, extra[index])
        names = [name for name in OWN if edges or name != "kind_of_edge"] + list(extra[0])
        if driver in IN_KML:
            stream.write(as_file(_kml(target, features), driver))
        else:
            stream.write(one_layer(f"{target}", driver, LAYER, features, names, chart.crs, style=style))
    if style and driver != "GPKG":
        with destination("style", target.with_suffix(".qml")) as stream:
            stream.write(qml())


def _kml(target: pathlib.Path, features: Sequence[Feature]) -> bytes:
    """Outlines in one folder, their edges in another."""
    marks: dict[str, list[Placemark]] = {}
    for shape, row in features:
        is_edge = row["kind"] == "edge"
        name = f"{row.get('name') or row.get('shot') or 'footprint {}'.format(row['index'])}"
        title = f"{row['kind_of_edge']} edge of {name}" if is_edge else name if shape else f"{name}: {row['status']}"
        marks.setdefault("Edges" if is_edge else "Footprints", []).append(Placemark(title, "outline", row, shape))
    try:
        return kml("Footprints", "Outlines of images on the ground.", marks)
    except ValueError as error:
        raise ValueError(f"{target}: {error}") from error


def check_footprint_file(
    path: str | os.PathLike[str],
    crs: Any,
    attributes: Sequence[Mapping[str, Any]] | Mapping[str, Any] | None,
    count: int,
) -> None:
    """Raises as `write_footprints` would for this name, CRS and attributes, before the footprints are computed."""
    target = pathlib.Path(path)
    _checked_attributes(target, attributes, count)
    checked_map(target, crs, _driver(target))


def check_is_flat(path: str | os.PathLike[str], crs: Any) -> None:
    """Raises `ValueError` for a CRS with heights, for footprints whose heights are above no datum."""
    flat_map_crs(f"{pathlib.Path(path)}", crs, None, None)


def _seen(footprint: Footprint) -> _Seen:
    """The data of a footprint to write. The last point is repeated as padding, to limit recompilation."""
    count = len(np.asarray(footprint.uv))
    more = max(FEWEST, 1 << (count - 1).bit_length()) - count

    def longer(leaf: Any) -> jax.Array:
        return jnp.asarray(np.pad(leaf, [(0, more)] + [(0, 0)] * (np.ndim(leaf) - 1), mode="edge"))

    parts = (footprint.uv, footprint.fix, footprint.hidden)
    padded = eqx.tree_at(lambda one: (one.uv, one.fix, one.hidden), footprint, jax.tree.map(longer, parts))
    lat, lon, height = padded.fix.position.to_degrees()
    places = np.stack([lon, lat, height], axis=-1)
    places, ecef, found, hidden = (
        np.asarray(x)[:count] for x in (places, padded.fix.ecef, padded.found, padded.hidden)
    )
    return _Seen(places, ecef, found, hidden, Status(int(footprint.status)), float(padded.area))


def _driver(target: pathlib.Path) -> str:
    try:
        driver = DRIVERS[target.suffix.lower()]
    except KeyError:
        raise ValueError(f"{target}: footprints are written to files that end in {', '.join(DRIVERS)}.") from None
    check_vector_driver(driver)
    return driver


def _checked_attributes(target: pathlib.Path, attributes: Any, count: int) -> list[dict[str, Any]]:
    attributes = attribute_rows(f"{target}", attributes, count, "footprints")
    given: list[dict[str, Any]] = (
        [{}] * count
        if attributes is None
        else [{str(name): value for name, value in one.items()} for one in attributes]
    )
    if len(given) != count:
        raise ValueError(f"{target}: attributes must be one mapping for each of {count} footprints; got {len(given)}.")
    for index, one in enumerate(given):
        different = sorted(one.keys() ^ given[0].keys())
        if different:
            raise ValueError(
                f"{target}: the attributes of footprints 0 and {index} differ: {', '.join(different)} is in one "
                f"of them only; write None for what is unknown."
            )
    taken = sorted(name for name in given[0] if name.lower() in TAKEN)
    if taken:
        raise ValueError(f"{target}: the attribute {taken[0]!r} is one that the file has by itself; rename it.")
    return given


def checked_map(target: pathlib.Path, crs: Any, driver: str, seen: Sequence[_Seen] = ()) -> _Map:
    """The caller's CRS and its transformation, about footprints. Raises `ValueError` as `write_footprints`."""
    try:
        known = known_crs(crs)
    except UNKNOWN_CRS as error:
        raise ValueError(f"{target}: PROJ does not know the crs {crs!r}: {error}") from error
    is_3d = known.is_geographic and len(known.axis_info) == 3 and not known.is_compound
    flat = known if is_3d else horizontal_part(known)
    if not (flat.is_geographic or flat.is_projected):
        raise ValueError(f"{target}: a map needs a projected or geographic crs; {flat.name!r} is a {flat.type_name}.")
    if driver in IN_KML and flat != pyproj.CRS.from_epsg(4326):
        raise ValueError(f"{target}: KML has longitudes and latitudes on WGS 84; leave crs out, or write a .gpkg.")
    if driver == "GeoJSON" and flat.to_authority() is None:
        raise ValueError(
            f"{target}: GeoJSON names a crs by its code, and {flat.name!r} has none that PROJ knows; write a .gpkg."
        )
    try:
        found = operation("EPSG:4979" if is_3d else "EPSG:4326", flat, _extent(seen))
    except NoOperation as error:
        raise ValueError(
            f"{target}: PROJ knows no transformation from WGS 84 to {flat.name!r} but a ballpark one."
        ) from error
    turn = 2.0 * np.pi / flat.axis_info[0].unit_conversion_factor if flat.is_geographic else None
    return _Map(flat, found.transformer, turn)


def _extent(seen: Sequence[_Seen]) -> tuple[float, float, float, float] | None:
    """(west, south, east, north) in deg, around the first visible point."""
    lon, lat, _ = np.concatenate([np.zeros((0, 3)), *(one.places[one.found] for one in seen)]).T
    if not lat.size:
        return None
    beside = np.remainder(lon - lon[0] + 180.0, 360.0) - 180.0
    west, east = (np.remainder(lon[0] + x + 180.0, 360.0) - 180.0 for x in (beside.min(), beside.max()))
    return float(west), float(lat.min()), float(east), float(lat.max())


def _on_map(target: pathlib.Path, chart: _Map, index: int, seen: _Seen) -> np.ndarray:
    """Coordinates (n, 2 or 3) of the points; NaN where no ground is visible."""
    axes = 3 if has_heights(chart.crs) else 2
    places = np.full((len(seen.found), axes), np.nan)
    given = seen.places[seen.found, :axes].T
    places[seen.found] = np.stack(chart.way.transform(*given), axis=-1)  # pyright: ignore[reportArgumentType, reportCallIssue]
    if not np.isfinite(places[seen.found]).all():
        raise ValueError(f"{target}: footprint {index} lies outside what {chart.crs.name!r} maps.")
    if chart.turn is None:
        unit = chart.crs.axis_info[0].unit_conversion_factor
        on_map, ground = (_steps(x) for x in (places * unit, seen.ecef))
        if np.any(on_map > MOST_STRETCHED * np.maximum(ground, 1.0)):  # NaN steps compare false
            raise ValueError(
                f"{target}: {chart.crs.name!r} tears footprint {index} apart, or stretches it more than "
                f"{MOST_STRETCHED:g} times; choose a crs that is made for the place."
            )
    return places


def _steps(places: np.ndarray) -> np.ndarray:
    """Differences between consecutive points around a ring."""
    return np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)


def _own(index: int, seen: _Seen) -> dict[str, Any]:
    """The attributes of an outline."""
    steps = _steps(seen.ecef)
    return {
        "index": index,
        "kind": "outline",
        "complete": seen.is_whole,
        "status": seen.status.name,
        "status_text": _sentence(seen.status),
        "hidden_share": float(steps[seen.hidden].sum() / steps.sum()) if seen.is_whole else None,
        "area_m2": seen.area if seen.is_whole else None,
    }


def _sentence(status: Status) -> str:
    return WHOLE if status == Status.hit else status.message


def _edges(index: int, seen: _Seen, places: np.ndarray, chart: _Map, extra: dict[str, Any]) -> Iterator[Feature]:
    """Lines along visible ground, and across hidden ground between."""
    known = seen.found & np.roll(seen.found, -1)
    labels = np.where(known, np.where(seen.hidden, HIDDEN, SEEN), 0)
    for label, run in runs(labels):
        own = {"index": index, "kind": "edge", "kind_of_edge": "hidden" if label == HIDDEN else "seen"}
        own |= {"complete": seen.is_whole, "status": seen.status.name, "status_text": _sentence(seen.status)}
        yield Feature(line(places[run], chart.turn), own | extra)
