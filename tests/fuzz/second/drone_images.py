"""Second readings of images of drones: EXIF by `struct`, XMP by lxml."""

from __future__ import annotations

import pathlib
import re
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from tests.fuzz.second.compared import DEGREES, number, same, same_turn

DJI = "http://www.dji.com/drone-dji/1.0"
SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}


def exposure(path: pathlib.Path, found: Any) -> None:
    """Position, height and angles as XMP of DJI states them, else as EXIF does; heights above the ellipsoid."""
    content = path.read_bytes()
    tags, exif = _xmp(content), _gps(content)
    lat = _stated(tags, ("GpsLatitude", "Latitude"), None)
    lon = _stated(tags, ("GpsLongitude", "GpsLongtitude", "Longitude"), None)
    if lat is None or lon is None:  # half a position is none
        lat, lon = _dms(exif, 2), _dms(exif, 4)
    below = exif.get(5) in ((1,), (3,))
    height = _stated(tags, ("AbsoluteAltitude",), -exif[6][0] if below and 6 in exif else exif.get(6, (None,))[0])
    pose = found.shots.pose.position
    if lat is not None and lon is not None:
        same("latitude", np.rad2deg(pose.lat), [lat], DEGREES)
        same_turn("longitude", np.rad2deg(pose.lon), [lon])
    if height:
        same("height", pose.height, [height], 1e-6)
    if found.form.startswith("DJI"):
        angles = [number(tags[f"Gimbal{name}Degree"].strip()) for name in ("Yaw", "Pitch", "Roll")]
        same_turn("angles of the gimbal", np.rad2deg(found.shots.gimbal_readings)[0], angles)
    if "CalibratedFocalLength" in found.facts["focal length"]:
        width = found.sensor.camera.width
        focal = number(tags["CalibratedFocalLength"].strip()) * width / _full_width(content, width)
        same("focal length", np.asarray(found.sensor.camera.focal_px)[0, 0], focal, 1e-6)


def _stated(tags: dict[str, str], names: tuple[str, ...], other: float | None) -> float | None:
    for name in names:
        if name in tags:
            return number(tags[name].strip())
    return other


def _segments(content: bytes) -> list[bytes]:
    """The APP1 segments of a JPEG file, up to its coded image."""
    found, at = [], 2
    while at + 4 <= len(content):
        marker, size = content[at + 1], int.from_bytes(content[at + 2 : at + 4], "big")
        if content[at] != 0xFF or marker in (0x00, 0xFF):
            at += 1  # what is no marker is passed over
        elif marker in (0x01, 0xC8, *range(0xD0, 0xDA), *range(0xF0, 0xFE)):
            at += 2  # no length follows, nor in what a decoder skips behind markers of extensions
        elif marker == 0xDA:
            break
        else:
            found += [content[at + 4 : at + 2 + size]] if marker == 0xE1 else []
            at += 2 + size
    return found


def _xmp(content: bytes) -> dict[str, str]:
    """The tags of DJI, by their local names; the first where one is there twice."""
    found: dict[str, str] = {}
    for uri, prefix, local, value in _xmp_tags(content):
        if uri.rstrip("/") == DJI or prefix == "drone-dji":
            found.setdefault(local, value)
    return found


def xmp_texts(content: bytes) -> dict[str, str]:
    """All tags with their prefixes; the first where one is there twice."""
    found: dict[str, str] = {}
    for _, prefix, local, value in _xmp_tags(content):
        found.setdefault(f"{prefix}:{local}", value)
    return found


def _xmp_tags(content: bytes) -> Iterator[tuple[str, str, str, str]]:
    """(address, prefix, name, value) of each tag of the packet."""
    from lxml import etree

    if content[:2] == b"\xff\xd8":
        packets = [
            part.split(b"\0", 1)[1] for part in _segments(content) if part.startswith(b"http://ns.adobe.com/xap/")
        ]
        content = packets[-1] if packets else b""
    start, end = content.find(b"<x:xmpmeta"), content.rfind(b"</x:xmpmeta>")
    if start < 0 or end < 0:
        return
    packet = re.sub(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]", b" ", content[start : end + 12])
    parser = etree.XMLParser(resolve_entities=False, huge_tree=True, recover=True)  # names of spaces may be no URIs
    for element in etree.fromstring(packet, parser).iter(etree.Element):
        prefixes = {uri: prefix for prefix, uri in element.nsmap.items()}
        texts = [(element.tag, element.text or "")] if not len(element) else []
        for key, value in [*element.attrib.items(), *texts]:
            uri, _, local = key.removeprefix("{").rpartition("}")
            yield uri, prefixes.get(uri) or "", local, value


def _tiff(content: bytes) -> tuple[bytes, str]:
    """(EXIF's TIFF structure, its order of bytes) of a JPEG or TIFF file."""
    if content[:2] == b"\xff\xd8":
        content = next((part[6:] for part in _segments(content) if part.startswith(b"Exif\0\0")), b"")
    return content, {b"II": "<", b"MM": ">"}.get(content[:2], "")


def _directory(data: bytes, order: str, at: int) -> dict[int, tuple[Any, ...]]:
    found: dict[int, tuple[Any, ...]] = {}
    (count,) = struct.unpack_from(f"{order}H", data, at)
    for k in range(count):
        tag, kind, size = struct.unpack_from(f"{order}HHI", data, at + 2 + 12 * k)
        whole = SIZES.get(kind, 0) * size
        if not whole or whole > 10_000:
            continue
        place = at + 10 + 12 * k
        place = place if whole <= 4 else struct.unpack_from(f"{order}I", data, place)[0]
        found[tag] = _values(data, order, place, kind, size)
    return found


def _values(data: bytes, order: str, place: int, kind: int, size: int) -> tuple[Any, ...]:
    if kind in (2, 7):
        return (data[place : place + size].split(b"\0")[0].decode("latin-1"),)
    if kind in (5, 10):
        whole = struct.unpack_from(f"{order}{2 * size}{'I' if kind == 5 else 'i'}", data, place)
        return tuple(a / b if b else None for a, b in zip(whole[::2], whole[1::2], strict=True))
    layout = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 11: "f", 12: "d"}[kind]
    return struct.unpack_from(f"{order}{size}{layout}", data, place)


def _parts(content: bytes, pointer: int) -> dict[int, tuple[Any, ...]]:
    data, order = _tiff(content)
    try:
        first = _directory(data, order, struct.unpack_from(f"{order}I", data, 4)[0]) if order else {}
        return _directory(data, order, first[pointer][0]) if pointer in first else {}
    except (struct.error, TypeError, IndexError):
        return {}


def _gps(content: bytes) -> dict[int, tuple[Any, ...]]:
    return _parts(content, 0x8825)


def _full_width(content: bytes, width: float) -> float:
    """PixelXDimension, where both sides are told; else the image's own width."""
    sides = [_parts(content, 0x8769).get(tag, (0,))[0] for tag in (0xA002, 0xA003)]
    return sides[0] if all(sides) else width


def _dms(exif: dict[int, tuple[Any, ...]], tag: int) -> float | None:
    parts, side = exif.get(tag), exif.get(tag - 1, ("",))[0]
    if parts is None or len(parts) != 3 or None in parts or not isinstance(side, str) or not side:
        return None
    value = parts[0] + parts[1] / 60.0 + parts[2] / 3600.0
    return -value if side[0].upper() in "SW" else value
