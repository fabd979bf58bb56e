"""Tracks of exposures as GPX and KML: camera positions in order of time."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Callable
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.io._gpx import TrackPoint, as_bytes, gpx
from jaxgeo.io._kml import NAMESPACE, checked_text
from jaxgeo.io._utc import utc_text
from jaxgeo.io.acquisitions import Acquisition, AcquisitionSet
from jaxgeo.io.geoid import degrees_of, height_msl

EXTENDED = "http://www.google.com/kml/ext/2.2"  # of KML, for tracks with times
ABOUT = "Positions of the platform on WGS 84, heights above mean sea level (EGM96)."
ABOUT_TAKEOFF = (
    "Positions of the platform on WGS 84, without heights: they are above the take-off, whose own height is unknown."
)


class _Track(NamedTuple):
    """Points of one track: names, longitude and latitude in deg, height above EGM96 in m, or above a take-off of
    unknown height, times as text or None."""

    name: str
    names: list[str]
    places: np.ndarray
    times: list[str | None]
    is_above_takeoff: bool = False

    @property
    def mode(self) -> str:
        """The altitude mode of KML. It has none above a take-off: the ground below may be higher or lower."""
        return "clampToGround" if self.is_above_takeoff else "absolute"


def write_track(
    path: str | os.PathLike[str], found: Acquisition | AcquisitionSet, *, is_above_takeoff: bool = False
) -> None:
    """Write the positions of exposures as a track to .gpx (GPX 1.1) or .kml (KML 2.2).

    Each acquisition is a track, in order of its times. Heights are above mean sea level (EGM96). Points have a time
    (ISO 8601) if the acquisition's times are in UTC; in KML, a track with times for all points is a `gx:Track`, else a
    line, and a single exposure a point. With `is_above_takeoff` heights are above a take-off whose own height is
    unknown: points then have none, and in KML they are drawn on the ground. The file appears only when complete. Raises
    `ValueError` for another ending, a path that cannot be written to, and names that XML cannot hold; `TypeError` for
    other arguments.
    """
    target = pathlib.Path(path)
    write = writer_of(target)
    if not isinstance(found, AcquisitionSet):
        check_is(found, Acquisition, "found", "Or an AcquisitionSet, as read by `read_acquisitions`.")
    parts = found.parts if isinstance(found, AcquisitionSet) else (found,)
    with destination("path", target, binary=True) as stream:
        root = write([_track(one, is_above_takeoff) for one in parts])
        stream.write(as_bytes(root))


def writer_of(target: pathlib.Path) -> Callable[[list[_Track]], ET.Element]:
    """The writer by the ending of a file. Raises `ValueError`."""
    try:
        return WRITERS[target.suffix.lower()]
    except KeyError:
        raise ValueError(f"{target}: tracks are written to files that end in {', '.join(WRITERS)}.") from None


def _track(found: Acquisition, is_above_takeoff: bool) -> _Track:
    order = np.argsort(np.asarray(found.shots.time), kind="stable")
    position = found.shots.pose.position
    lat, lon, height = degrees_of(position)
    places = np.stack([lon, lat, height if is_above_takeoff else height_msl(position)], axis=-1)[order]
    clock = np.asarray(found.shots.time)[order].tolist()
    times = [utc_text(time) if found.time_is_utc else None for time in clock]
    return _Track(os.path.basename(found.path), found.names[order].tolist(), places, times, is_above_takeoff)


def _about(tracks: list[_Track]) -> str:
    return ABOUT_TAKEOFF if any(track.is_above_takeoff for track in tracks) else ABOUT


def _gpx(tracks: list[_Track]) -> ET.Element:
    return gpx(_about(tracks), [(track.name, _points(track)) for track in tracks])


def _points(track: _Track) -> list[TrackPoint]:
    rows = zip(track.names, track.places.tolist(), track.times, strict=True)
    has_datum = not track.is_above_takeoff
    return [TrackPoint(name, lon, lat, height if has_datum else None, time) for name, (lon, lat, height), time in rows]


def _kml(tracks: list[_Track]) -> ET.Element:
    root = ET.Element("kml", {"xmlns": NAMESPACE, "xmlns:gx": EXTENDED})
    document = ET.SubElement(root, "Document")
    _text(document, "name", "Tracks")
    _text(document, "description", _about(tracks))
    for track in tracks:
        mark = ET.SubElement(document, "Placemark")
        _text(mark, "name", track.name)
        points = track.places.tolist()
        if len(points) == 1:
            _add_point(mark, track, points[0])
        elif all(time is not None for time in track.times):
            element = ET.SubElement(mark, "gx:Track")
            _text(element, "altitudeMode", track.mode)
            for time in track.times:
                _text(element, "when", f"{time}")
            for place in points:
                _text(element, "gx:coord", " ".join([*_axes(track, place), "0"][:3]))  # has three numbers in any mode
        else:
            line = ET.SubElement(mark, "LineString")
            _text(line, "altitudeMode", track.mode)
            _text(line, "coordinates", " ".join(",".join(_axes(track, place)) for place in points))
    return root


def _add_point(mark: ET.Element, track: _Track, place: list[float]) -> None:
    """Add a point, with its time if it is known. A placemark has its time before its geometry (KML 2.2, OGC 2008)."""
    (time,) = track.times
    if time is not None:
        _text(ET.SubElement(mark, "TimeStamp"), "when", time)
    point = ET.SubElement(mark, "Point")
    _text(point, "altitudeMode", track.mode)
    _text(point, "coordinates", ",".join(_axes(track, place)))


def _axes(track: _Track, place: list[float]) -> list[str]:
    """Longitude, latitude and, above a datum, height."""
    lon, lat, height = place
    return [f"{lon:.10f}", f"{lat:.10f}", *([] if track.is_above_takeoff else [f"{height:.4f}"])]


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = checked_text(text)


WRITERS: dict[str, Callable[[list[_Track]], ET.Element]] = {".gpx": _gpx, ".kml": _kml}
