"""GPX 1.1: tracks of points with heights and times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree as ET

from jaxgeo.io._kml import checked_text

NAMESPACE = "http://www.topografix.com/GPX/1/1"


class TrackPoint(NamedTuple):
    """A point of a track: longitude and latitude in deg on WGS 84, height above EGM96 in m or None, time (ISO 8601) or
    None, and a description or None."""

    name: str
    lon: float
    lat: float
    height: float | None
    time: str | None
    about: str | None = None


def gpx(about: str, tracks: Sequence[tuple[str, Sequence[TrackPoint]]]) -> ET.Element:
    """The document of tracks by name. Raises `ValueError` for a text that XML cannot hold."""
    root = ET.Element("gpx", xmlns=NAMESPACE, version="1.1", creator="jaxgeo")
    _text(ET.SubElement(root, "metadata"), "desc", about)
    for name, points in tracks:
        track = ET.SubElement(root, "trk")
        _text(track, "name", name)
        segment = ET.SubElement(track, "trkseg")
        for one in points:
            point = ET.SubElement(segment, "trkpt", lat=f"{one.lat:.10f}", lon=f"{one.lon:.10f}")
            height = None if one.height is None else f"{one.height:.4f}"
            texts = {"ele": height, "time": one.time, "name": one.name, "desc": one.about}
            for tag, text in texts.items():
                if text is not None:
                    _text(point, tag, text)
    return root


def as_bytes(root: ET.Element) -> bytes:
    ET.indent(root, " ")
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = checked_text(text)
