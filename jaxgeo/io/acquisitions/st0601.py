"""MISB ST 0601: items of the UAS datalink local set by tag, with name, unit and decoding."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxgeo.io.acquisitions.klv import Items


class Item(NamedTuple):
    """An item's name in the standard, the unit of its values as read here, and the decoder of its bytes."""

    name: str
    unit: str
    read: Callable[[bytes], Any]

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name


def decode(items: Items) -> dict[int, Any]:
    """Values by tag: numbers, texts, and bytes for tags not in the table and for items of a wrong length.

    Values that the standard reserves for errors and out-of-range are NaN, and so is a number of zero length, unknown.
    Of a repeated item the last counts.
    """
    values: dict[int, Any] = {}
    for tag, raw in items:
        try:
            values[tag] = TAGS[tag].read(raw) if tag in TAGS else raw
        except ValueError:
            values[tag] = raw
    return values


@functools.cache
def label(tag: int) -> str:
    """The name of a tag, with its unit."""
    return TAGS[tag].label if tag in TAGS else f"Tag {tag}"


def mapped(low: float, high: float, size: int) -> Callable[[bytes], float]:
    """Decoder of unsigned numbers of `size` bytes, mapped linearly to `low` to `high`."""

    def read(raw: bytes) -> float:
        whole = _whole(raw, size)
        return math.nan if math.isnan(whole) else low + (high - low) * (whole / (256**size - 1))

    return read


def signed(bound: float, size: int) -> Callable[[bytes], float]:
    """Decoder of signed numbers of `size` bytes over -`bound` to `bound`; the lowest is the error code: NaN."""
    greatest = 2 ** (8 * size - 1) - 1

    def read(raw: bytes) -> float:
        whole = _whole(raw, size, is_signed=True)
        return bound * (whole / greatest) if whole >= -greatest else math.nan

    return read


def imapb(low: float, high: float) -> Callable[[bytes], float]:
    """Decoder of MISB ST 1201 IMAPB in [`low`, `high`], any length; special values (infinities, NaNs, ...) are NaN."""

    def read(raw: bytes) -> float:
        if not raw:
            return math.nan
        if len(raw) > 8:
            raise ValueError("longer than 8 bytes")
        step = 2.0 ** (math.ceil(math.log2(high - low)) - (8 * len(raw) - 1))
        shift = low / step - math.floor(low / step) if low < 0.0 < high else 0.0
        value = step * (int.from_bytes(raw, "big") - shift) + low
        return value if low <= value <= high else math.nan

    return read


def _whole(raw: bytes, size: int, *, is_signed: bool = False) -> int | float:
    if not raw:
        return math.nan
    if len(raw) != size:
        raise ValueError(f"{len(raw)} bytes, where {size} are needed")
    return int.from_bytes(raw, "big", signed=is_signed)


def _count(raw: bytes, *, is_signed: bool = False) -> int | float:
    if len(raw) > 8:
        raise ValueError("longer than 8 bytes")
    return int.from_bytes(raw, "big", signed=is_signed) if raw else math.nan


def _signed_count(raw: bytes) -> int | float:
    return _count(raw, is_signed=True)


def _time(raw: bytes) -> int | float:
    return _whole(raw, 8)


def _temperature(raw: bytes) -> int | float:
    return _whole(raw, 1, is_signed=True)


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", errors="replace").rstrip("\0")


def _raw(raw: bytes) -> bytes:
    return raw


_HEIGHT, _HEIGHT_EXTENDED = mapped(-900.0, 19_000.0, 2), imapb(-900.0, 40_000.0)
_LAT, _LON = signed(90.0, 4), signed(180.0, 4)
_CORNER_OFFSET = signed(0.075, 2)
_PRESSURE = mapped(0.0, 5000.0, 2)
_RANGE = mapped(0.0, 5e6, 4)
_SPEED = mapped(0.0, 255.0, 1)
_TURN, _RATE = mapped(0.0, 360.0, 2), imapb(-1000.0, 1000.0)

_ROWS: list[tuple[int, str, str, Callable[[bytes], Any]]] = [
    (1, "Checksum", "", _raw),
    (2, "Precision Time Stamp", "us", _time),
    (3, "Mission ID", "", _text),
    (4, "Platform Tail Number", "", _text),
    (5, "Platform Heading Angle", "deg", _TURN),
    (6, "Platform Pitch Angle", "deg", signed(20.0, 2)),
    (7, "Platform Roll Angle", "deg", signed(50.0, 2)),
    (8, "Platform True Airspeed", "m/s", _SPEED),
    (9, "Platform Indicated Airspeed", "m/s", _SPEED),
    (10, "Platform Designation", "", _text),
    (11, "Image Source Sensor", "", _text),
    (12, "Image Coordinate System", "", _text),
    (13, "Sensor Latitude", "deg", _LAT),
    (14, "Sensor Longitude", "deg", _LON),
    (15, "Sensor True Altitude", "m above mean sea level", _HEIGHT),
    (16, "Sensor Horizontal Field of View", "deg", mapped(0.0, 180.0, 2)),
    (17, "Sensor Vertical Field of View", "deg", mapped(0.0, 180.0, 2)),
    (18, "Sensor Relative Azimuth Angle", "deg", mapped(0.0, 360.0, 4)),
    (19, "Sensor Relative Elevation Angle", "deg", signed(180.0, 4)),
    (20, "Sensor Relative Roll Angle", "deg", mapped(0.0, 360.0, 4)),
    (21, "Slant Range", "m", _RANGE),
    (22, "Target Width", "m", mapped(0.0, 10_000.0, 2)),
    (23, "Frame Center Latitude", "deg", _LAT),
    (24, "Frame Center Longitude", "deg", _LON),
    (25, "Frame Center Elevation", "m above mean sea level", _HEIGHT),
    *(
        (24 + 2 * corner + axis, f"Offset Corner {name} Point {corner}", "deg", _CORNER_OFFSET)
        for corner in (1, 2, 3, 4)
        for axis, name in enumerate(("Latitude", "Longitude"))
    ),
    (34, "Icing Detected", "", _count),
    (35, "Wind Direction", "deg", _TURN),
    (36, "Wind Speed", "m/s", mapped(0.0, 100.0, 1)),
    (37, "Static Pressure", "hPa", _PRESSURE),
    (38, "Density Altitude", "m", _HEIGHT),
    (39, "Outside Air Temperature", "deg C", _temperature),
    (40, "Target Location Latitude", "deg", _LAT),
    (41, "Target Location Longitude", "deg", _LON),
    (42, "Target Location Elevation", "m above mean sea level", _HEIGHT),
    (43, "Target Track Gate Width", "px", mapped(0.0, 510.0, 1)),
    (44, "Target Track Gate Height", "px", mapped(0.0, 510.0, 1)),
    (45, "Target Error Estimate - CE90", "m", mapped(0.0, 4095.0, 2)),
    (46, "Target Error Estimate - LE90", "m", mapped(0.0, 4095.0, 2)),
    (47, "Generic Flag Data", "", _count),
    (48, "Security Local Set", "", _raw),
    (49, "Differential Pressure", "hPa", _PRESSURE),
    (50, "Platform Angle of Attack", "deg", signed(20.0, 2)),
    (51, "Platform Vertical Speed", "m/s", signed(180.0, 2)),
    (52, "Platform Sideslip Angle", "deg", signed(20.0, 2)),
    (53, "Airfield Barometric Pressure", "hPa", _PRESSURE),
    (54, "Airfield Elevation", "m above mean sea level", _HEIGHT),
    (55, "Relative Humidity", "%", mapped(0.0, 100.0, 1)),
    (56, "Platform Ground Speed", "m/s", _SPEED),
    (57, "Ground Range", "m", _RANGE),
    (58, "Platform Fuel Remaining", "kg", mapped(0.0, 10_000.0, 2)),
    (59, "Platform Call Sign", "", _text),
    (62, "Laser PRF Code", "", _count),
    (63, "Sensor Field of View Name", "", _count),
    (64, "Platform Magnetic Heading", "deg", _TURN),
    (65, "UAS Datalink LS Version Number", "", _count),
    (67, "Alternate Platform Latitude", "deg", _LAT),
    (68, "Alternate Platform Longitude", "deg", _LON),
    (69, "Alternate Platform Altitude", "m above mean sea level", _HEIGHT),
    (70, "Alternate Platform Name", "", _text),
    (71, "Alternate Platform Heading", "deg", _TURN),
    (72, "Event Start Time", "us", _time),
    (75, "Sensor Ellipsoid Height", "m above the ellipsoid", _HEIGHT),
    (76, "Alternate Platform Ellipsoid Height", "m above the ellipsoid", _HEIGHT),
    (77, "Operational Mode", "", _count),
    (78, "Frame Center Height Above Ellipsoid", "m above the ellipsoid", _HEIGHT),
    (79, "Sensor North Velocity", "m/s", signed(327.0, 2)),
    (80, "Sensor East Velocity", "m/s", signed(327.0, 2)),
    *(
        (80 + 2 * corner + axis, f"Corner {name} Point {corner} (Full)", "deg", read)
        for corner in (1, 2, 3, 4)
        for axis, (name, read) in enumerate((("Latitude", _LAT), ("Longitude", _LON)))
    ),
    (90, "Platform Pitch Angle (Full)", "deg", signed(90.0, 4)),
    (91, "Platform Roll Angle (Full)", "deg", signed(90.0, 4)),
    (92, "Platform Angle of Attack (Full)", "deg", signed(90.0, 4)),
    (93, "Platform Sideslip Angle (Full)", "deg", signed(180.0, 4)),
    (94, "MIIS Core Identifier", "", _raw),
    (96, "Target Width Extended", "m", imapb(0.0, 1.5e6)),
    (102, "SDCC-FLP", "", _raw),
    (103, "Density Altitude Extended", "m", _HEIGHT_EXTENDED),
    (104, "Sensor Ellipsoid Height Extended", "m above the ellipsoid", _HEIGHT_EXTENDED),
    (105, "Alternate Platform Ellipsoid Height Extended", "m above the ellipsoid", _HEIGHT_EXTENDED),
    (106, "Stream Designator", "", _text),
    (107, "Operational Base", "", _text),
    (108, "Broadcast Source", "", _text),
    (109, "Range To Recovery Location", "km", imapb(0.0, 21_000.0)),
    (110, "Time Airborne", "s", _count),
    (112, "Platform Course Angle", "deg", imapb(0.0, 360.0)),
    (113, "Altitude AGL", "m above the ground", _HEIGHT_EXTENDED),
    (114, "Radar Altimeter", "m above the ground", _HEIGHT_EXTENDED),
    (117, "Sensor Azimuth Rate", "deg/s", _RATE),
    (118, "Sensor Elevation Rate", "deg/s", _RATE),
    (119, "Sensor Roll Rate", "deg/s", _RATE),
    (123, "Number of NAVSATs in View", "", _count),
    (134, "Zoom Percentage", "%", imapb(0.0, 100.0)),
    (136, "Leap Seconds", "s", _signed_count),
]

TAGS: dict[int, Item] = {tag: Item(name, unit, read) for tag, name, unit, read in _ROWS}
