"""Correct results for the telemetry of the folder `field`."""

from __future__ import annotations

import math
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jaxgeo.io import TableError, read_acquisition, undulation
from jaxgeo.io.acquisitions import Acquisition, compare_reported, read_sbet
from tests.support.field import FieldFile


def check_sbet(path: pathlib.Path) -> None:
    """Applanix's axes; 2-points has a mean velocity of (-2.341, 0.282, 0.031) m/s, within 0.03 of the positions."""
    found = read_sbet(path)
    assert found.velocity_ned is not None
    assert "y west and z up" in found.facts["velocities"]
    assert float(found.facts["velocities"].split("; ")[1].split()[0]) < 0.03  # m/s, from the change of the positions
    if path.name == "2-points.sbet":
        np.testing.assert_allclose(found.velocity_ned, [[-2.341, 0.282, 0.031]] * 2, atol=2.5e-3)
    else:
        np.testing.assert_allclose(found.velocity_ned, [[51.9615, 30.0, -1.0]] * 400, atol=1e-3)


def read(count: int, *checks: Callable[[Acquisition], None], **how: object) -> Callable[[pathlib.Path], None]:
    """Checks a file whose `count` exposures are those of the folder's flight, except for what `checks` test."""

    def check(path: pathlib.Path) -> None:
        found = read_acquisition(path, **how)
        assert len(found) == count
        pose = found.shots.pose
        np.testing.assert_allclose(np.degrees(pose.position.lat), 36.3, atol=1e-7)
        np.testing.assert_allclose(np.degrees(pose.position.lon), -84.2, atol=1e-7)
        np.testing.assert_allclose(np.degrees(found.shots.gimbal_readings), [[90.0, -35.0, 0.0]] * count, atol=1e-6)
        for one in checks:
            one(found)

    return check


def refused(*words: str) -> Callable[[pathlib.Path], None]:
    """Checks that a file is refused in one line with these words."""

    def check(path: pathlib.Path) -> None:
        with pytest.raises(TableError) as caught:
            read_acquisition(path)
        message = str(caught.value)
        assert message.startswith(f"{path}: ")
        assert "\n" not in message
        for one in words:
            assert one in message

    return check


def then(*checks: Callable[[pathlib.Path], None]) -> Callable[[pathlib.Path], None]:
    def check(path: pathlib.Path) -> None:
        for one in checks:
            one(path)

    return check


def no_centre(found: Acquisition) -> None:
    """No frame centre for comparison, although a slant range of 4000 m is reported."""
    assert found.reported is not None
    np.testing.assert_allclose(found.reported.slant_range, 4000.0, atol=1e-2)
    assert np.isnan(compare_reported(found)).all()


def height(metres: float) -> Callable[[Acquisition], None]:
    return lambda found: np.testing.assert_allclose(found.shots.pose.position.height, metres, atol=0.2)


def above_sea_level(found: Acquisition) -> None:
    height(3000.139 + float(undulation(36.3, -84.2)))(found)
    assert any("EGM96" in one for one in found.assumed)


def field_of_view(across: float, down: float, width: int = 1280) -> Callable[[Acquisition], None]:
    """The same for all exposures, in deg."""

    def check(found: Acquisition) -> None:
        assert found.sensor is not None
        camera: Any = found.sensor.camera
        assert camera.width == width
        half = 0.5 * np.array([camera.width, camera.height])
        fields = 2.0 * np.degrees(np.arctan(half / np.asarray(camera.focal_px)))
        np.testing.assert_allclose(fields, [[across, down]] * len(found), atol=2e-3)

    return check


def said(words: str) -> Callable[[Acquisition], None]:
    def check(found: Acquisition) -> None:
        assert any(words in one for one in found.assumed)

    return check


def pitch(deg: float) -> Callable[[Acquisition], None]:
    return lambda found: np.testing.assert_allclose(np.degrees(found.shots.pose.pitch), deg, atol=1e-3)


def times(start: str) -> Callable[[Acquisition], None]:
    def check(found: Acquisition) -> None:
        assert found.facts["times"].startswith(start)

    return check


def corners(found: Acquisition) -> None:
    """A centre and corners that do not match the angles: reported unchanged, checked by plane geometry."""
    compared = compare_reported(found)
    north, east = 0.01 * 110_960.0, 0.02 * 89_840.0  # m to the centre, at 36.3 deg
    down = float(np.asarray(found.shots.pose.position.height)[0]) - float(np.asarray(found.reported.centre.height)[0])  # pyright: ignore[reportOptionalMemberAccess]
    np.testing.assert_allclose(compared.slant_range, 4000.0 - math.hypot(north, east, down), atol=3.0)
    assert np.isfinite(compared).all()


TOLD = field_of_view(2.9993, 1.7002)
WIDTH = 2.0 * math.degrees(math.atan(0.5 * 200.0458 / 4000.0))
HEIGHT = 2.0 * math.degrees(math.atan(0.5 * 200.0458 / 4000.0 * 720.0 / 1280.0))
KLV: dict[str, tuple[str, Callable[[pathlib.Path], None]]] = {
    "good.klv": ("no frame centre", read(5, TOLD, no_centre, above_sea_level)),
    "fov_once.klv": (
        "field of view sent once",
        read(30, TOLD, said("of 29 packets is that of an earlier one")),
    ),
    "no_fov_target_width.klv": (
        "no field of view but target width and range",
        read(5, field_of_view(WIDTH, HEIGHT), said("2 atan(width / (2 range))")),
    ),
    "no_checksum.klv": (
        "no checksum",
        then(refused("no checksum at its end", "keep_damaged=True reads the 5"), read(5, TOLD, keep_damaged=True)),
    ),
    "payload_checksum.klv": (
        "a checksum of the payload alone",
        then(refused("its checksum is 0xfb78", "keep_damaged=True reads the 5"), read(5, TOLD, keep_damaged=True)),
    ),
    "eg0104.klv": ("the older universal set", refused("MISB EG 0104", "Ask its source for ST 0601")),
    "zero_pos.klv": ("positions 0/0", read(1, said("2 of 3 packets were left out for want of position"))),
    "time_zero.klv": ("times 0", read(2, said("unknown; Precision Time Stamp: a clock that is not set"))),
    "latlon_error.klv": ("latitudes out of range", read(1, said("Sensor Latitude: the code that stands for an error"))),
    "leap.klv": ("leap seconds told", read(2, TOLD, times("2023-11-14T22:13:57.000"))),
    "magnetic_only.klv": ("a magnetic heading only", refused("attitude of the platform", "magnetic heading (tag 64)")),
    "msl_ell_both.klv": ("both heights", read(3, height(2967.95))),
    "pitch_full.klv": ("pitch beyond 20 deg", read(5, pitch(-25.0))),
    "pitch_out_of_range.klv": (
        "pitch out of range",
        refused("Platform Pitch Angle: the code that stands for"),
    ),
    "no_gimbal_angles.klv": ("no angles of the sensor", refused("azimuth and elevation of the sensor (tags 18, 19)")),
    "full_corners.klv": ("corners in full", read(3, TOLD, corners)),
    "klva.ts": ("a transport stream", read(5, field_of_view(2.9993, 1.7002, 320), no_centre, above_sea_level)),
}

ROWS: tuple[FieldFile, ...] = (
    *(FieldFile(f"klv/{name}", situation, check) for name, (situation, check) in KLV.items()),
    FieldFile("tab/2-points.sbet", "SBET velocities as Applanix writes them: y west, z up", check_sbet),
    FieldFile("tab/sbet_manual.out", "SBET by the manual of POSPac", check_sbet),
)
