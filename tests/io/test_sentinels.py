"""Sentinels: every row of the table tells its value from the measurement beside it."""

from __future__ import annotations

from typing import Any

import pytest

from jaxgeo.io.sentinels import SENTINELS, Sentinel, is_undefined, sentinel_of

NO_FRACTION, ZERO_ANGLE, SOME_ANGLE = ("0/0",) * 3, (0.0,) * 3, (0.0, 0.0, 0.3)


def pair(unknown: Any, measured: Any, *names: str) -> tuple[dict[str, Any], dict[str, Any]]:
    return dict.fromkeys(names, unknown), dict.fromkeys(names, measured)


def angles(prefix: str, suffix: str = "") -> tuple[dict[str, Any], dict[str, Any]]:
    return pair("+0.00", "+0.10", *(f"{prefix}{name}{suffix}" for name in ("Yaw", "Pitch", "Roll")))


# By format, in the order of its rows: values that mean "unknown", and measurements of the same fields.
EXAMPLES: dict[str, list[tuple[dict[str, Any], dict[str, Any]]]] = {
    "image": [
        pair("V", "A", "EXIF:GPSStatus"),
        pair("Invalid", "RTK", "drone-dji:GpsStatus"),
        pair("+0.0000000", "+0.0000001", "drone-dji:GpsLatitude", "drone-dji:GpsLongitude"),
        pair("0", "0.1", "drone-dji:GpsLatitude", "drone-dji:GpsLongtitude"),
        pair("0", "0.1", "drone-dji:Latitude", "drone-dji:Longitude"),
        pair("0", "0.1", "drone-skydio:Latitude", "drone-skydio:Longitude"),
        pair(NO_FRACTION, SOME_ANGLE, "EXIF:GPSLatitude"),
        pair(NO_FRACTION, SOME_ANGLE, "EXIF:GPSLongitude"),
        pair(ZERO_ANGLE, SOME_ANGLE, "EXIF:GPSLatitude", "EXIF:GPSLongitude"),
        pair("+0.00", "-0.01", "drone-dji:AbsoluteAltitude"),
        pair("0", "0.25", "drone-skydio:AbsoluteAltitude"),
        pair(0.0, 0.5, "EXIF:GPSAltitude"),
        pair("0/0", 0.5, "EXIF:GPSAltitude"),
        angles("drone-dji:Gimbal", "Degree"),
        angles("drone-skydio:CameraOrientationNED/"),
        angles("drone-parrot:Camera", "Degree"),
        angles("Camera:"),
        pair(0.0, 8.8, "EXIF:FocalLength"),
        pair("0/0", 8.8, "EXIF:FocalLength"),
        pair(0, 24, "EXIF:FocalLengthIn35mmFilm"),
        pair("0/0", 24, "EXIF:FocalLengthIn35mmFilm"),
        pair(0.0, 1.0, "EXIF:DigitalZoomRatio"),
        pair("0/0", 1.0, "EXIF:DigitalZoomRatio"),
        pair("0.000000", "3666.67", "drone-dji:CalibratedFocalLength"),
        pair("0.0", "2010.0", "drone-dji:CalibratedOpticalCenterX", "drone-dji:CalibratedOpticalCenterY"),
        pair("0000:00:00 00:00:00", "2024:05:10 00:00:00", "EXIF:DateTimeOriginal"),
        pair("0.0", "61.2", "drone-dji:LRFTargetDistance"),
        pair("0", "0.0093", "drone-dji:RtkStdLat"),
        pair("0", "0.0097", "drone-dji:RtkStdLon"),
        pair("0", "0.0238", "drone-dji:RtkStdHgt"),
        pair("0", "50", "drone-dji:RtkFlag"),
    ],
    "subtitles": [
        pair(0.0, 0.5, "latitude", "longitude"),
        pair(0.0, 900.0, "abs_alt"),
        pair(0.0, 0.5, "gb_yaw", "gb_pitch", "gb_roll"),
    ],
    "AirData": [
        pair("0.0", "0.5", "latitude", "longitude"),
        pair("", "36.3", "latitude", "longitude"),
        pair("0", "4", "gpslevel"),
        pair("0", "0.5", "gimbal_heading", "gimbal_pitch", "gimbal_roll"),
        pair(" ", "30", "gimbal_heading", "gimbal_pitch", "gimbal_roll"),
    ],
    "Litchi": [
        pair("0", "0.5", "latitude", "longitude"),
        pair("", "36.3", "latitude", "longitude"),
        pair("0", "5", "gimbalyawraw", "gimbalpitchraw", "gimbalrollraw"),
    ],
    "Flight Reader": [
        pair("0", "0.5", "osd.latitude", "osd.longitude"),
        pair("", "36.3", "osd.latitude", "osd.longitude"),
        pair("0", "4", "osd.gpslevel"),
        pair("0", "0.5", "gimbal.yaw", "gimbal.pitch", "gimbal.roll"),
        pair("", "30", "gimbal.yaw", "gimbal.pitch", "gimbal.roll"),
    ],
    "ArduPilot": [pair(0.0, 36.3, "Lat", "Lng")],
    "PX4": [
        pair(0, -1, "result"),
        pair(0.0, 36.3, "lat", "lon"),
        pair(0.0, 0.5, "q[0]", "q[1]", "q[2]", "q[3]"),
    ],
    "marks": [
        pair("0", "50", "Q"),
        pair(0.0, 0.5, "Lat", "Lon"),
        pair(0.0, 0.01, "sigma north", "sigma east", "sigma up"),
        pair(0.0, 2312.0, "week", "time of week"),
    ],
    "SBET": [pair(0.0, 0.8, "lat", "lon")],
    "KLV": [
        pair(0, 1, "Precision Time Stamp (us)"),
        pair(0.0, 4.2e-8, "Sensor Latitude (deg)", "Sensor Longitude (deg)"),
        pair(0.0, 4.2e-8, "Frame Center Latitude (deg)", "Frame Center Longitude (deg)"),
        pair(-900.0, -899.7, "Sensor True Altitude (m above mean sea level)"),
        pair(-900.0, -899.7, "Sensor Ellipsoid Height (m above the ellipsoid)"),
        pair(-900.0, -899.7, "Sensor Ellipsoid Height Extended (m above the ellipsoid)"),
        pair(-900.0, -899.7, "Frame Center Elevation (m above mean sea level)"),
        pair(-900.0, -899.7, "Frame Center Height Above Ellipsoid (m above the ellipsoid)"),
        pair(0.0, 1.2e-3, "Slant Range (m)"),
        pair(0.0, 0.2, "Target Width (m)"),
        pair(0.0, 0.2, "Target Width Extended (m)"),
        pair(0.0, 3e-3, "Sensor Horizontal Field of View (deg)"),
        pair(0.0, 3e-3, "Sensor Vertical Field of View (deg)"),
        *(
            pair(float("nan"), 0.0, f"{name} (deg)")
            for name in (
                "Sensor Latitude",
                "Sensor Longitude",
                "Frame Center Latitude",
                "Frame Center Longitude",
                "Platform Pitch Angle",
                "Platform Roll Angle",
                "Platform Pitch Angle (Full)",
                "Platform Roll Angle (Full)",
                "Sensor Relative Elevation Angle",
            )
        ),
    ],
}
CASES = [
    pytest.param(row, *example, id=f"{row.quantity}: {', '.join(row.fields)} {next(iter(example[0].values()))}")
    for form, examples in EXAMPLES.items()
    for row, example in zip(SENTINELS[form], examples, strict=True)
]


@pytest.mark.parametrize("row, unknown, measured", CASES)
def test_a_sentinel_is_told_from_a_measurement(
    row: Sentinel, unknown: dict[str, Any], measured: dict[str, Any]
) -> None:
    assert row.fields == tuple(unknown)
    assert row.holds(unknown)
    assert not row.holds(measured)
    assert not row.holds({})
    for name in row.fields:
        assert len(row.fields) == 1 or not row.holds(unknown | {name: measured[name]})  # all fields have to tell it


def test_every_format_has_examples() -> None:
    assert set(EXAMPLES) == set(SENTINELS)


def test_the_first_sentinel_of_a_quantity_is_named() -> None:
    values = {"EXIF:GPSStatus": "V", "EXIF:GPSAltitude": 0.0}
    rows = SENTINELS["image"]
    position, height = (sentinel_of(rows, quantity, values) for quantity in ("position", "EXIF height"))
    assert position is not None
    assert height is not None
    assert (position.fields, height.fields) == (("EXIF:GPSStatus",), ("EXIF:GPSAltitude",))
    assert sentinel_of(rows, "time", values) is None


def test_a_fraction_of_nothing() -> None:
    for value in ("0/0", NO_FRACTION, "0.0/0"):
        assert is_undefined(value)
    for value in ("0/1", 0.0, "", (), ("0/0", 1.0), None):
        assert not is_undefined(value)
