"""KML 2.2 and KMZ writer: points, lines and areas with attribute tables."""

from __future__ import annotations

import html
import io
import math
import re
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import shapely
from shapely.geometry.base import BaseGeometry

NAMESPACE = "http://www.opengis.net/kml/2.2"
COLOURS = {
    "fix": "ff00c8ff",
    "uncertain": "ff0080ff",
    "lost": "ff8080ff",
    "area": "4d00c8ff",
    "outline": "ff00c8ff",
}  # aabbggrr
LINES = ("area", "outline")  # styles of areas and lines; an outline has no fill
BALLOON = {
    "time_utc": ("time", ""),
    "u": ("column", "g"),
    "v": ("row", "g"),
    "label": ("label", ""),
    "score": ("score", ""),
    "fix_lat_deg": ("latitude, deg", "z.7f"),
    "fix_lon_deg": ("longitude, deg", "z.7f"),
    "fix_height_m": ("height above WGS 84, m", "z.2f"),
    "fix_height_above_takeoff_m": ("height above the take-off, m", "z.2f"),
    "fix_height_msl_m": ("height above mean sea level (EGM96), m", "z.2f"),
    "status_text": ("status", ""),
    "accuracy_text": ("accuracy", ""),
}  # columns shown in balloons: name there, and format
RADIUS = re.compile(r"(ce|le|se)([0-9_]+)_m")  # shown in balloons too: "CE90, m"
TYPES = {bool: "bool", int: "int", float: "double", str: "string"}
NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class Placemark(NamedTuple):
    """A name, a style (of `COLOURS`), a table, and a geometry: (longitude, latitude) with or without a height, an area,
    a line, or None; `when`, a time as ISO 8601, or None.

    Degrees on WGS 84, heights in m above EGM96, as in the standard. Areas, lines and points without a height are
    clamped to the ground.
    """

    name: str
    style: str
    columns: Mapping[str, Any]
    place: tuple[float, float, float] | tuple[float, float] | BaseGeometry | None
    when: str | None = None


def kml(title: str, description: str, folders: Mapping[str, Sequence[Placemark]]) -> bytes:
    """The document of folders of placemarks with typed columns; balloons show what matters of them.

    Styles need no files of others: markers are the viewer's own, in the colour of the style.

    Folders are documents with a schema each, since GDAL does not find schemas in a KMZ otherwise. Raises `ValueError`
    for a text with a character that XML cannot hold.
    """
    root = ET.Element("kml", xmlns=NAMESPACE)
    document = ET.SubElement(root, "Document")
    _text(document, "name", title)
    _text(document, "description", description)
    for style, colour in COLOURS.items():
        _style(document, style, colour)
    for name, marks in folders.items():
        folder = ET.SubElement(document, "Document")
        _text(folder, "name", name)
        _schema(folder, f"columns_of_{name}", [mark.columns for mark in marks])
        for mark in marks:
            _placemark(folder, f"columns_of_{name}", mark)
    ET.indent(root, " ")
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def as_file(document: bytes, driver: str) -> bytes:
    """A document for a file of the driver "KML" or "KMZ"."""
    return document if driver == "KML" else kmz(document)


def kmz(document: bytes) -> bytes:
    """A KML document zipped, as doc.kml."""
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(zipfile.ZipInfo("doc.kml"), document, zipfile.ZIP_DEFLATED)  # no timestamp: reproducible
    return sink.getvalue()


def _placemark(folder: ET.Element, schema: str, mark: Placemark) -> None:
    element = ET.SubElement(folder, "Placemark")
    _text(element, "name", mark.name)
    known = {name: _shown(value) for name, value in mark.columns.items() if value is not None}
    shown = dict(_told(name, value) for name, value in mark.columns.items() if value is not None and _is_told(name))
    cells = (
        (html.escape(name, quote=False), html.escape(value, quote=False)) for name, value in (shown or known).items()
    )
    rows = (f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in cells)
    _text(element, "description", f"<table>{''.join(rows)}</table>")
    if mark.when is not None:
        _text(ET.SubElement(element, "TimeStamp"), "when", mark.when)
    _text(element, "styleUrl", f"#{mark.style}")
    data = ET.SubElement(ET.SubElement(element, "ExtendedData"), "SchemaData", schemaUrl=f"#{schema}")
    for name, value in known.items():
        ET.SubElement(data, "SimpleData", name=checked_text(name)).text = checked_text(value)
    if isinstance(mark.place, BaseGeometry):
        parts = shapely.get_parts(mark.place)
        parent = element if len(parts) == 1 else ET.SubElement(element, "MultiGeometry")
        for part in parts:
            _polygon(parent, part) if part.geom_type == "Polygon" else _line(parent, part)
    elif mark.place is not None:
        point = ET.SubElement(element, "Point")
        _text(point, "altitudeMode", "absolute" if len(mark.place) == 3 else "clampToGround")
        _text(point, "coordinates", _coordinates([mark.place]))


def _is_told(name: str) -> bool:
    """Whether balloons show a column."""
    return name in BALLOON or RADIUS.fullmatch(name) is not None


def _told(name: str, value: Any) -> tuple[str, str]:
    """Name and text of a column in a balloon."""
    radius = RADIUS.fullmatch(name)
    title, spec = BALLOON.get(name, ("", "z.2f"))
    if radius is not None:
        title = f"{radius[1].upper()}{radius[2].replace('_', '.')}, m"
    is_number = isinstance(value, float) and math.isfinite(value)
    return title, format(value, spec) if spec and is_number else _shown(value)


def _line(parent: ET.Element, line: Any) -> None:
    _text(_on_ground(parent, "LineString"), "coordinates", _coordinates(line.coords))


def _on_ground(parent: ET.Element, tag: str) -> ET.Element:
    """A new geometry that follows the ground."""
    element = ET.SubElement(parent, tag)
    _text(element, "tessellate", "1")
    _text(element, "altitudeMode", "clampToGround")
    return element


def _polygon(parent: ET.Element, area: Any) -> None:
    polygon = _on_ground(parent, "Polygon")
    for kind, rings in (("outer", [area.exterior]), ("inner", area.interiors)):
        for ring in rings:
            boundary = ET.SubElement(ET.SubElement(polygon, f"{kind}BoundaryIs"), "LinearRing")
            _text(boundary, "coordinates", _coordinates(ring.coords))


def _coordinates(places: Any) -> str:
    """Coordinates in KML's format: ten decimals of a degree, four of a metre."""
    return " ".join(",".join([f"{x:.10f}", f"{y:.10f}", *(f"{z:.4f}" for z in height)]) for x, y, *height in places)


def _style(document: ET.Element, name: str, colour: str) -> None:
    style = ET.SubElement(document, "Style", id=name)
    if name not in LINES:
        icon = ET.SubElement(style, "IconStyle")
        _text(icon, "color", colour)
        _text(icon, "scale", "0.7")
        return
    line = ET.SubElement(style, "LineStyle")
    _text(line, "color", f"ff{colour[2:]}")
    _text(line, "width", "2")
    fill = ET.SubElement(style, "PolyStyle")
    _text(fill, "color", colour)
    if name == "outline":
        _text(fill, "fill", "0")


def _schema(document: ET.Element, schema_id: str, tables: Sequence[Mapping[str, Any]]) -> None:
    """The type of each column from its values: float if any has decimals."""
    kinds: dict[str, set[type]] = {}
    for table in tables:
        for name, value in table.items():
            kinds.setdefault(name, set()).update(() if value is None else (type(value),))
    schema = ET.SubElement(document, "Schema", name=schema_id, id=schema_id)
    for name, found in kinds.items():
        kind = float if found == {int, float} else next(iter(found)) if len(found) == 1 else str
        ET.SubElement(schema, "SimpleField", type=TYPES[kind], name=checked_text(name))


def _shown(value: Any) -> str:
    """A value in XML notation."""
    if isinstance(value, bool):
        return "1" if value else "0"
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "INF" if value > 0.0 else "-INF"
    return str(value)


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = checked_text(text)


def checked_text(text: str) -> str:
    """The text. Raises `ValueError` for a character that XML cannot hold."""
    wrong = NO_XML.search(text)
    if wrong is not None:
        raise ValueError(f"XML cannot hold the character {wrong.group()!r} of the text {text[:60]!r}; take it out.")
    return text
