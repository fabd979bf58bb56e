"""Sentinel values that mean "unknown", by file format: one tuple of `Sentinel` each, every row covered by a test.

A reader calls `sentinel_of(ROWS, quantity, values)` before it uses a quantity as a measurement. To add a format, add
one tuple (`KLV = (Sentinel(...), ...)`) and its entry in `SENTINELS`; readers import only their own tuple.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

UNDEFINED = re.compile(r"[+-]?0+(\.0*)?/0+(\.0*)?")  # EXIF's undefined fraction
NO_TIME = re.compile(r"[\s0:.-]*")  # a date and time of zeros or blanks


class Sentinel(NamedTuple):
    """Fields of a file whose values together mean that a quantity is unknown.

    - `quantity`: the unknown quantity, such as "position", "height", "camera angles".
    - `fields`: the field names used by the format's reader.
    - `is_unknown`: a test of their values, in that order and as read.
    - `reason`: the meaning of the values, as the end of a sentence that begins with the fields and their values.
    """

    quantity: str
    fields: tuple[str, ...]
    is_unknown: Callable[..., bool]
    reason: str

    def holds(self, values: Mapping[str, Any]) -> bool:
        """Whether all fields are present and mean "unknown"."""
        return all(name in values for name in self.fields) and self.is_unknown(*(values[name] for name in self.fields))


def sentinel_of(rows: tuple[Sentinel, ...], quantity: str, values: Mapping[str, Any]) -> Sentinel | None:
    """The first row of a format that marks a quantity as unknown; None if its values are measurements."""
    return next((row for row in rows if row.quantity == quantity and row.holds(values)), None)


def is_undefined(value: Any) -> bool:
    """Whether a value is the fraction 0/0, or consists of such fractions."""
    parts = value if isinstance(value, tuple) else (value,)
    return bool(parts) and all(isinstance(part, str) and bool(UNDEFINED.fullmatch(part.strip())) for part in parts)


def all_zero(*values: Any) -> bool:
    """Whether every value is the number zero, or a text of it."""
    try:
        return all(float(value) == 0.0 for value in values)
    except (TypeError, ValueError):
        return False


def begins_with(*words: str) -> Callable[[Any], bool]:
    """A case-insensitive test of a text's beginning."""
    return lambda value: str(value).strip().lower().startswith(tuple(word.lower() for word in words))


def _no_time(value: Any) -> bool:
    return bool(NO_TIME.fullmatch(str(value)))


_ANGLES = "a gimbal that reports no angles writes zeros"
_POSITION = "a receiver without a fix writes zeros"
_RATIONAL = "0/0 is the fraction of an unknown value"

# Image tags by the names of `ImageTags`.
IMAGE = (
    Sentinel("position", ("EXIF:GPSStatus",), begins_with("V"), "the receiver had no fix"),
    Sentinel("position", ("drone-dji:GpsStatus",), begins_with("invalid"), "the receiver had no fix"),
    Sentinel("position", ("drone-dji:GpsLatitude", "drone-dji:GpsLongitude"), all_zero, _POSITION),
    Sentinel("position", ("drone-dji:GpsLatitude", "drone-dji:GpsLongtitude"), all_zero, _POSITION),
    Sentinel("position", ("drone-dji:Latitude", "drone-dji:Longitude"), all_zero, _POSITION),
    Sentinel("position", ("drone-skydio:Latitude", "drone-skydio:Longitude"), all_zero, _POSITION),
    Sentinel("EXIF position", ("EXIF:GPSLatitude",), is_undefined, _RATIONAL),
    Sentinel("EXIF position", ("EXIF:GPSLongitude",), is_undefined, _RATIONAL),
    Sentinel(
        "EXIF position",
        ("EXIF:GPSLatitude", "EXIF:GPSLongitude"),
        lambda lat, lon: all_zero(*_parts(lat), *_parts(lon)),
        _POSITION,
    ),
    Sentinel("height", ("drone-dji:AbsoluteAltitude",), all_zero, "a receiver without a height writes zero"),
    Sentinel("height", ("drone-skydio:AbsoluteAltitude",), all_zero, "a receiver without a height writes zero"),
    Sentinel("EXIF height", ("EXIF:GPSAltitude",), all_zero, "a receiver without a height writes zero"),
    Sentinel("EXIF height", ("EXIF:GPSAltitude",), is_undefined, _RATIONAL),
    *(
        Sentinel(
            "camera angles", tuple(f"{prefix}{name}{suffix}" for name in ("Yaw", "Pitch", "Roll")), all_zero, _ANGLES
        )
        for prefix, suffix in (
            ("drone-dji:Gimbal", "Degree"),
            ("drone-skydio:CameraOrientationNED/", ""),
            ("drone-parrot:Camera", "Degree"),
            ("Camera:", ""),
        )
    ),
    *(
        Sentinel(quantity, (f"EXIF:{name}",), test, reason)
        for quantity, name in (
            ("focal length", "FocalLength"),
            ("focal length for 35 mm film", "FocalLengthIn35mmFilm"),
            ("digital zoom", "DigitalZoomRatio"),
        )
        for test, reason in ((all_zero, "EXIF writes zero where it is unknown or unused"), (is_undefined, _RATIONAL))
    ),
    Sentinel("calibration", ("drone-dji:CalibratedFocalLength",), all_zero, "the camera was not calibrated"),
    Sentinel(
        "optical centre",
        ("drone-dji:CalibratedOpticalCenterX", "drone-dji:CalibratedOpticalCenterY"),
        all_zero,
        "the camera was not calibrated",
    ),
    Sentinel("time", ("EXIF:DateTimeOriginal",), _no_time, "EXIF writes blanks or zeros where the time is unknown"),
    Sentinel("rangefinder", ("drone-dji:LRFTargetDistance",), all_zero, "the laser hit nothing"),
    *(
        Sentinel("position errors", (f"drone-dji:RtkStd{axis}",), all_zero, "the size of the error is unknown")
        for axis in ("Lat", "Lon", "Hgt")
    ),
    Sentinel(
        "position errors",
        ("drone-dji:RtkFlag",),
        all_zero,
        "there was no solution of RTK, and standard deviations beside it are old ones",
    ),
)


def is_blank(*values: Any) -> bool:
    """Whether every value is an empty cell."""
    return all(isinstance(value, str) and not value.strip() for value in values)


# Fields of DJI's video subtitles (SRT), in lower case.
SUBTITLES = (
    Sentinel("position", ("latitude", "longitude"), all_zero, _POSITION),
    Sentinel("height", ("abs_alt",), all_zero, "a receiver without a height writes zero"),
    Sentinel("camera angles", ("gb_yaw", "gb_pitch", "gb_roll"), all_zero, _ANGLES),
)
# Columns of AirData's flight logs, in lower case and without units.
AIRDATA = (
    Sentinel("position", ("latitude", "longitude"), all_zero, _POSITION),
    Sentinel("position", ("latitude", "longitude"), is_blank, "the cells are empty"),
    Sentinel("position", ("gpslevel",), all_zero, "level 0 is no signal"),
    Sentinel("camera angles", ("gimbal_heading", "gimbal_pitch", "gimbal_roll"), all_zero, _ANGLES),
    Sentinel("camera angles", ("gimbal_heading", "gimbal_pitch", "gimbal_roll"), is_blank, "the cells are empty"),
)
# Columns of Litchi's and Flight Reader's flight logs, in lower case and without units.
LITCHI = (
    Sentinel("position", ("latitude", "longitude"), all_zero, _POSITION),
    Sentinel("position", ("latitude", "longitude"), is_blank, "the cells are empty"),
    Sentinel("camera angles", ("gimbalyawraw", "gimbalpitchraw", "gimbalrollraw"), all_zero, _ANGLES),
)
FLIGHT_READER = (
    Sentinel("position", ("osd.latitude", "osd.longitude"), all_zero, _POSITION),
    Sentinel("position", ("osd.latitude", "osd.longitude"), is_blank, "the cells are empty"),
    Sentinel("position", ("osd.gpslevel",), all_zero, "level 0 is no signal"),
    Sentinel("camera angles", ("gimbal.yaw", "gimbal.pitch", "gimbal.roll"), all_zero, _ANGLES),
    Sentinel("camera angles", ("gimbal.yaw", "gimbal.pitch", "gimbal.roll"), is_blank, "the cells are empty"),
)
# Fields of ArduPilot's messages CAM, and of PX4's camera_capture.
ARDUPILOT = (Sentinel("position", ("Lat", "Lng"), all_zero, _POSITION),)
PX4 = (
    Sentinel("position", ("result",), all_zero, "0 is a photo that failed"),
    Sentinel("position", ("lat", "lon"), all_zero, _POSITION),
    Sentinel("camera angles", ("q[0]", "q[1]", "q[2]", "q[3]"), all_zero, "an attitude that is not known is zeros"),
)
# Fields of DJI's photo marks (Timestamp.MRK).
MARKS = (
    Sentinel("position", ("Q",), all_zero, "0 is no solution"),
    Sentinel("position", ("Lat", "Lon"), all_zero, _POSITION),
    Sentinel("position errors", ("sigma north", "sigma east", "sigma up"), all_zero, "they were not estimated"),
    Sentinel("time", ("week", "time of week"), all_zero, "a receiver without time writes zeros"),
)
# Fields of SBET records.
SBET = (Sentinel("position", ("lat", "lon"), all_zero, "records that were never written are zeros"),)


def _parts(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


# Items of MISB ST 0601, by their names and units in `st0601`; reserved codes are read as NaN.
KLV = (
    Sentinel("time", ("Precision Time Stamp (us)",), all_zero, "a clock that is not set writes zero"),
    Sentinel("position", ("Sensor Latitude (deg)", "Sensor Longitude (deg)"), all_zero, _POSITION),
    Sentinel("frame centre", ("Frame Center Latitude (deg)", "Frame Center Longitude (deg)"), all_zero, _POSITION),
    *(
        Sentinel(f"height of the {of}", (field,), lambda height: height == -900.0, "-900 m is the code zero")
        for of, field in (
            ("sensor", "Sensor True Altitude (m above mean sea level)"),
            ("sensor", "Sensor Ellipsoid Height (m above the ellipsoid)"),
            ("sensor", "Sensor Ellipsoid Height Extended (m above the ellipsoid)"),
            ("frame centre", "Frame Center Elevation (m above mean sea level)"),
            ("frame centre", "Frame Center Height Above Ellipsoid (m above the ellipsoid)"),
        )
    ),
    *(
        Sentinel(quantity, (field,), all_zero, "it is not measured")
        for quantity, field in (
            ("slant range", "Slant Range (m)"),
            ("target width", "Target Width (m)"),
            ("target width", "Target Width Extended (m)"),
            ("field of view", "Sensor Horizontal Field of View (deg)"),
            ("field of view", "Sensor Vertical Field of View (deg)"),
        )
    ),
    *(
        Sentinel(quantity, (field,), _is_nan, "the code that stands for an error or a value out of range")
        for quantity, field in (
            ("position", "Sensor Latitude (deg)"),
            ("position", "Sensor Longitude (deg)"),
            ("frame centre", "Frame Center Latitude (deg)"),
            ("frame centre", "Frame Center Longitude (deg)"),
            ("attitude", "Platform Pitch Angle (deg)"),
            ("attitude", "Platform Roll Angle (deg)"),
            ("attitude", "Platform Pitch Angle (Full) (deg)"),
            ("attitude", "Platform Roll Angle (Full) (deg)"),
            ("angles of the sensor", "Sensor Relative Elevation Angle (deg)"),
        )
    ),
)

SENTINELS: dict[str, tuple[Sentinel, ...]] = {
    "image": IMAGE,
    "KLV": KLV,
    "subtitles": SUBTITLES,
    "AirData": AIRDATA,
    "Litchi": LITCHI,
    "Flight Reader": FLIGHT_READER,
    "ArduPilot": ARDUPILOT,
    "PX4": PX4,
    "marks": MARKS,
    "SBET": SBET,
}
