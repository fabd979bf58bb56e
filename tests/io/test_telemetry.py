"""Telemetry as exposures: values, frames and signs, what is left out and said, real flights, transport streams.

Held against: the 407 packets of a real flight (Cheyenne, 2012), whose frame centres, slant ranges and corners agree
with the lines of sight; rotations of SciPy and positions of PROJ (`aimed`); the layout of MISB ST 0601 by the encoder
of `support.klv_packets`, written from the standard; transport streams as FFmpeg writes them (ISO 13818-1, ST 1402).
"""

from __future__ import annotations

import pathlib
import re
import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.klv_packets import KEY, TIME_US, cell, local_set, synchronous, usual, whole
from support.transport_streams import muxed

from jaxgeo.io import TableError, VerticalDatumError, undulation
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.acquisitions.reported import compare_reported
from jaxgeo.io.acquisitions.telemetry import read_telemetry
from jaxgeo.io.acquisitions.transport_stream import is_transport_stream
from jaxgeo.sensor import FrameCamera, Sensor, Trajectory

ABOVE_ELLIPSOID = (5, 6, 7, 13, 14, 16, 17, 18, 19, 20, 21, 23, 24, 75, 78)
MADE = local_set(usual(*ABOVE_ELLIPSOID))
File = Callable[..., pathlib.Path]


@pytest.fixture
def file(tmp_path: pathlib.Path) -> File:
    """Writes packets, or bytes, one after another and returns the path."""

    def write(*parts: bytes | dict[int, bytes]) -> pathlib.Path:
        path = tmp_path / "flight.klv"
        path.write_bytes(b"".join(one if isinstance(one, bytes) else local_set(one) for one in parts))
        return path

    return write


def degrees(value: Any) -> np.ndarray:
    return np.degrees(np.asarray(value))


def test_values_of_a_packet(file: File) -> None:
    found = read_telemetry(file(usual(), usual(tag_5=350.0)), height_datum="ellipsoid", image_size=(1920, 1080))
    assert found.names.tolist() == ["0", "1"]
    pose, readings = found.shots.pose, degrees(found.shots.gimbal_readings)
    np.testing.assert_allclose(degrees(pose.position.lat), 47.1, atol=1e-7)
    np.testing.assert_allclose(degrees(pose.position.lon), 8.2, atol=1e-7)
    np.testing.assert_allclose(pose.position.height, 2000.0, atol=0.2)  # m; steps of 0.3 m
    np.testing.assert_allclose(degrees(pose.heading), [30.0, 350.0], atol=3e-3)
    np.testing.assert_allclose(degrees(pose.pitch), 3.0, atol=4e-4)
    np.testing.assert_allclose(degrees(pose.roll), -12.0, atol=1e-3)
    np.testing.assert_allclose(readings, [[250.0, -25.0, -10.0]] * 2, atol=1e-6)
    np.testing.assert_allclose(found.shots.time, TIME_US * 1e-6, atol=1e-6)
    assert found.time_is_utc
    sensor, shot, _ = found.exposure(0)
    assert sensor is not None
    camera: Any = sensor.camera
    assert (camera.width, camera.height) == (1920, 1080)
    np.testing.assert_allclose(degrees(camera.field_of_view()), [12.0, 6.8], atol=2e-3)
    assert bool(sensor.gimbal.inside_limits(shot.gimbal_readings))
    assert found.reported is not None
    np.testing.assert_allclose(found.reported.slant_range, 3300.0, atol=1e-2)
    np.testing.assert_allclose(degrees(found.reported.centre.lat), 47.12, atol=1e-7)
    np.testing.assert_allclose(found.reported.centre.height, 450.0, atol=0.2)
    assert found.tags[0]["Sensor Latitude (deg)"] == pytest.approx(47.1)
    (lens,) = found.sources
    np.testing.assert_allclose(lens.sigma[:, 0], 0.01 * np.asarray(found.sensor.camera.focal_px)[:, 0])  # pyright: ignore
    np.testing.assert_array_equal(lens.sigma[:, 1:], 0.0)


def test_full_angles_and_ellipsoid_heights_are_preferred(file: File) -> None:
    """Each packet by what it has: the second has angles of the full range only, and heights above the ellipsoid."""
    narrow, full = usual(*ABOVE_ELLIPSOID[:-2], 15, 25), usual(*ABOVE_ELLIPSOID, 15, 25, tag_90=35.0, tag_91=-70.0)
    full[6] = full[7] = b"\x80\x00"  # out of range
    found = read_telemetry(file(narrow, full))
    np.testing.assert_allclose(degrees(found.shots.pose.pitch), [3.0, 35.0], atol=1e-3)
    np.testing.assert_allclose(degrees(found.shots.pose.roll), [-12.0, -70.0], atol=1e-3)
    geoid = float(undulation(47.1, 8.2))
    assert abs(geoid) > 40.0
    np.testing.assert_allclose(found.shots.pose.position.height, [2000.0 + geoid, 2050.0], atol=0.2)
    assert found.reported is not None
    np.testing.assert_allclose(found.reported.centre.height, [450.0 + geoid, 500.0], atol=0.3)
    assert any("EGM96 (EPSG:5773)" in one for one in found.assumed)


def test_height_datums(file: File) -> None:
    path = file(usual())
    for datum, height in (("ellipsoid", 2000.0), (25.0, 2025.0), ("EPSG:5773", 2000.0 + float(undulation(47.1, 8.2)))):
        found = read_telemetry(path, height_datum=datum)
        np.testing.assert_allclose(found.shots.pose.position.height, height, atol=0.2)
        assert not any("EGM96" in one for one in found.assumed)
    with pytest.raises(VerticalDatumError, match=r"flight.klv: height_datum='EPSG:0' is unknown"):
        read_telemetry(path, height_datum="EPSG:0")
    above = read_telemetry(file(MADE), height_datum=25.0)
    np.testing.assert_allclose(above.shots.pose.position.height, 2050.0, atol=0.2)
    assert any("height_datum was not used" in one for one in above.assumed)


LOOKS = [  # heading, pitch, roll of the platform, azimuth, elevation of the sensor, deg
    (0.0, 0.0, 0.0, 0.0, -30.0),
    (75.0, 5.0, 0.0, 90.0, -40.0),
    (200.0, -4.0, 18.0, 270.0, -35.0),
    (310.0, 8.0, -22.0, 135.0, -50.0),
    (10.0, 2.0, 3.0, 200.0, -120.0),  # over its head: it looks ahead
]


def aimed(heading: float, pitch: float, roll: float, azimuth: float, elevation: float) -> dict[int, bytes]:
    """A packet whose frame centre is where such a sensor looks 2 km away: by SciPy's rotations and PROJ."""
    body = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
    head = Rotation.from_euler("ZY", [azimuth, elevation], degrees=True)
    ned = (body * head).apply([2000.0, 0.0, 0.0])
    topocentric = f"+proj=topocentric +lon_0={8.2} +lat_0={47.1} +h_0={2050.0} +ellps=WGS84"
    to_ecef = pyproj.Transformer.from_pipeline(f"+proj=pipeline +step +inv {topocentric}")
    ecef = to_ecef.transform(ned[1], ned[0], -ned[2])
    lon, lat, height = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(*ecef)
    return usual(
        *ABOVE_ELLIPSOID, tag_5=heading, tag_6=pitch, tag_7=roll, tag_18=azimuth, tag_19=elevation, tag_21=2000.0,
        tag_23=lat, tag_24=lon, tag_78=height,
    )  # fmt: skip


def test_the_axis_goes_where_the_angles_say(file: File) -> None:
    compared = compare_reported(read_telemetry(file(*(aimed(*look) for look in LOOKS))))
    tolerances = {"slant_range": 0.3, "east": 0.5, "north": 0.5, "azimuth": 2e-4, "elevation": 2e-4}  # m, rad
    for name, tolerance in tolerances.items():  # of the steps of the tags
        np.testing.assert_allclose(getattr(compared, name), 0.0, atol=tolerance, err_msg=name)


def test_a_shift_of_the_centre_is_told(file: File) -> None:
    """A centre 0.001 deg north of where the axis goes: 111 m, against the axis; looking north, that is elevation."""
    moved = aimed(*LOOKS[0])
    moved[23] = usual(tag_23=float(np.degrees(_lat(moved[23]))) + 1e-3)[23]
    compared = compare_reported(read_telemetry(file(moved, moved, moved, *([MADE] * 2))))
    np.testing.assert_allclose(compared.north[0], -111.2, atol=0.7)
    np.testing.assert_allclose(compared.east[0], 0.0, atol=0.5)
    assert compared.elevation[0] < -0.02  # rad, below
    assert abs(compared.azimuth[0]) < 2e-4


def _lat(raw: bytes) -> float:
    return np.radians(90.0 * int.from_bytes(raw, "big", signed=True) / (2**31 - 1))


def test_the_roll_of_the_sensor_turns_the_image_clockwise(file: File) -> None:
    """Looking north and level, turned by 90 deg clockwise from behind: the top of the image is in the east."""
    look = {f"tag_{tag}": 0.0 for tag in (5, 6, 7, 18, 19)}
    found = read_telemetry(file(usual(*ABOVE_ELLIPSOID, tag_20=90.0, **look)))
    sensor, shot, _ = found.exposure(0)
    assert sensor is not None
    R = np.asarray(jax.jit(Sensor.R_ned_from_camera)(sensor, shot))
    np.testing.assert_allclose(R @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(R @ [0.0, -1.0, 0.0], [0.0, 1.0, 0.0], atol=1e-4)


def without(*tags: int) -> dict[int, bytes]:
    return {tag: raw for tag, raw in usual(*ABOVE_ELLIPSOID).items() if tag not in tags}


class Pairs(dict):
    """Items that may stand twice, for `local_set`: (tag, value) pairs in their order."""

    def __init__(self, *pairs: tuple[int, bytes]) -> None:
        self.pairs = pairs

    def items(self) -> Any:
        return self.pairs


def test_only_what_is_used_can_refuse(file: File) -> None:
    """Repeated, unknown and misshapen items that are not needed change nothing; of one that is, the last counts."""
    usual_items = tuple(without().items())
    strange = [
        (3, b"one"),
        (3, b"two"),
        (8, b"too long"),
        (200, bytes(300)),
        (48, b"\xff\x80"),
        (102, b"\x00"),
        (2**21, b""),
    ]
    plain, odd = (read_telemetry(file(local_set(Pairs(*pairs)))) for pairs in (usual_items, (*strange, *usual_items)))
    jax.tree.map(np.testing.assert_array_equal, (plain.sensor, plain.shots), (odd.sensor, odd.shots))
    assert odd.facts["Mission ID"] == "two"
    twice = read_telemetry(file(local_set(Pairs(*usual_items, (5, usual(5, tag_5=77.0)[5])))))
    np.testing.assert_allclose(degrees(twice.shots.pose.heading), 77.0, atol=3e-3)


def at(seconds: float, packet: dict[int, bytes]) -> dict[int, bytes]:
    """A packet, some seconds after the first."""
    return packet | {2: (TIME_US + round(1e6 * seconds)).to_bytes(8, "big")}


def test_what_is_sent_now_and_then_holds_until_it_changes(file: File) -> None:
    """For 30 s, the time within which MISB ST 0902 has items repeated; not where a packet says that it is unknown."""
    silent = without(16, 17, 20, 21)
    once = usual(*ABOVE_ELLIPSOID, tag_16=5.0, tag_17=2.5, tag_20=10.0)
    later = usual(*ABOVE_ELLIPSOID, tag_16=8.0, tag_17=4.0, tag_20=40.0)
    unknown = silent | {16: b"", 17: b"", 20: b""}
    sent = [(0, silent), (1, once), (2, silent), (31, silent), (31.2, silent), (40, later), (41, silent), (50, unknown)]
    found = read_telemetry(file(*(at(*one) for one in [*sent, (51, silent), (52, once)])))
    assert found.names.tolist() == ["1", "2", "3", "5", "6", "9"]
    assert found.sensor is not None
    camera: Any = found.sensor.camera
    fields = 2.0 * degrees(np.arctan(0.5 * camera.width / np.asarray(camera.focal_px)[:, 0]))
    np.testing.assert_allclose(fields, [5.0, 5.0, 5.0, 8.0, 8.0, 5.0], atol=2e-3)
    turns = degrees(found.shots.gimbal_readings)[:, 2]
    np.testing.assert_allclose(turns, [10.0, 10.0, 10.0, 40.0, 40.0, 10.0], atol=1e-6)
    said = [one for one in found.assumed if "is that of an earlier one" in one]
    assert said == [
        "The field of view of 3 packets is that of an earlier one, up to 30 s old: items sent now and then are held "
        "until they change, at most 30 s."
    ]


def test_positions_and_angles_are_never_held(file: File) -> None:
    for tag in (13, 14, 75, 5, 6, 7, 18, 19):
        assert read_telemetry(file(MADE, at(1, without(tag)))).names.tolist() == ["0"]


def test_a_field_of_view_from_target_width_and_slant_range(file: File) -> None:
    """As wide as the target at the slant range; the middle of the image is where it is by a told field of view."""
    width, distance = 400.0, 3300.0
    told = without(16, 17) | {22: whole(width, 0.0, 10_000.0, ">H")}
    extended = without(16, 17) | {96: (round(width * 2**10)).to_bytes(4, "big")}  # ST 1201: 2**21 over 2**31 codes
    found = read_telemetry(file(told, extended, MADE), image_size=(1280, 720))
    assert found.sensor is not None
    camera: Any = found.sensor.camera
    expected = 640.0 / (0.5 * width / distance)
    np.testing.assert_allclose(camera.focal_px[:2], expected, rtol=3e-4)
    R = np.asarray(jax.jit(jax.vmap(Sensor.R_ned_from_camera))(found.sensor, found.shots))
    np.testing.assert_allclose(R[0, :, 2], R[2, :, 2], atol=1e-9)
    assert any("of 2 packets is not given; it is from target width and slant range" in one for one in found.assumed)
    for unknown in ({21: bytes(4)}, {22: bytes(2)}):  # no range, no width
        with pytest.raises(TableError, match=r"for want of field of view \(tags 16, 17, or target width 22 or 96"):
            read_telemetry(file(told | unknown))


def test_a_focal_length_from_target_width_errs_more_than_one_that_is_told(file: File) -> None:
    told = without(16, 17) | {22: whole(400.0, 0.0, 10_000.0, ">H")}
    given = "focal=700px,size=1280x720"
    for packets, shares, words in (
        ((MADE,), [0.01], ["1 % by fields of view in the packets;"]),
        ((told,), [0.05], ["5 % by target width and slant range;"]),
        ((told, MADE), [0.05, 0.01], ["1 % by fields of view in the packets, 5 % by target width and slant range"]),
    ):
        found = read_telemetry(file(*packets))
        (lens,) = found.sources
        focal = np.asarray(found.sensor.camera.focal_px)[:, 0]  # pyright: ignore
        np.testing.assert_allclose(lens.sigma[:, 0], np.array(shares) * focal)
        np.testing.assert_array_equal(lens.sigma[:, 1:], 0.0)
        said = [one for one in found.assumed if one.startswith("Focal length sigma: ")]
        assert len(said) == 1
        assert all(word in said[0] for word in words)
    found = read_telemetry(file(MADE), camera=given)
    assert found.sources == ()
    assert any("is the one given" in one and "has no error" in one for one in found.assumed)


def test_a_camera_that_is_given_stands_for_the_field_of_view(file: File) -> None:
    """As it is advised where the packets tell none; and in its place where they do."""
    path = file(without(16, 17, 21))
    with pytest.raises(
        TableError, match=r'for want of field of view.* Give the camera: camera="focal=8\.8mm,pitch=2\.41um"'
    ):
        read_telemetry(path)
    for words, size, focal in (
        ("focal=25mm,pitch=5um", (1920, 1080), 5000.0),
        ("focal=25mm,sensor=10mm", None, 3200.0),  # of 1280 pixels
        ("focal=900px,size=640x480", None, 900.0),
    ):
        found = read_telemetry(path, camera=words, image_size=size)
        assert found.sensor is not None
        camera: Any = found.sensor.camera
        np.testing.assert_allclose(camera.focal_px, focal, rtol=1e-12)
        assert (camera.width, camera.height) == (size or ((640, 480) if "size" in words else (1280, 720)))
        assert any("camera is the one given" in one for one in found.assumed)
    whole_field = read_telemetry(file(MADE), camera=FrameCamera.from_pixels(focal_px=700.0, width=1280, height=720))
    np.testing.assert_allclose(whole_field.sensor.camera.focal_px, 700.0)  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]
    with pytest.raises(TableError, match=r"telemetry names no cameras, so camera='day' is none of it\. Give camera="):
        read_telemetry(path, camera="day")


@pytest.mark.parametrize(
    "changes, words",
    [
        ({13: bytes(4), 14: bytes(4)}, "position .*; Sensor Latitude and Sensor Longitude: a receiver without a fix"),
        ({75: bytes(2)}, "height .*; Sensor Ellipsoid Height: -900 m is the code zero"),
        ({16: bytes(2), 17: bytes(2)}, "field of view .*; Sensor Horizontal Field of View: it is not measured"),
        ({6: b"\x80\x00"}, "attitude .*; Platform Pitch Angle: the code that stands for an error or a value out of"),
        ({14: b"\x80\x00\x00\x00"}, "position .*; Sensor Longitude: the code that stands for an error"),
    ],
)
def test_sentinels_are_told_and_are_no_numbers(file: File, changes: dict[int, bytes], words: str) -> None:
    with pytest.raises(TableError, match=f"1 of 1 packets were left out for want of {words}"):
        read_telemetry(file(without() | changes))
    assert read_telemetry(file(without() | changes, MADE)).names.tolist() == ["1"]


def test_a_centre_of_zeros_is_no_centre(file: File) -> None:
    nothing = without() | {21: bytes(4), 23: bytes(4), 24: bytes(4)}
    found = read_telemetry(file(nothing, without(23, 24), MADE))
    assert found.reported is not None
    np.testing.assert_array_equal(np.isnan(found.reported.centre.lat), [True, True, False])
    np.testing.assert_array_equal(np.isnan(found.reported.slant_range), [True, False, False])
    compared = compare_reported(found)
    for name in ("slant_range", "east", "north", "azimuth", "elevation"):
        np.testing.assert_array_equal(np.isnan(getattr(compared, name)), [True, True, False], err_msg=name)


UNTIMED = {
    "zero": {2: bytes(8)},
    "of no bytes": {2: b""},
    "too short": {2: b"\x01"},
    "beyond all times": {2: b"\xff" * 8},
    "moved out of range by leap seconds": {136: b"\xff" + bytes(7)},
}


@pytest.mark.parametrize("case", UNTIMED)
def test_a_fix_needs_no_time(file: File, case: str) -> None:
    untimed, timed = without() | UNTIMED[case], without()
    found, known = read_telemetry(file(untimed, untimed)), read_telemetry(file(timed, timed))
    assert (len(found), found.time_is_utc, found.facts["times"]) == (2, False, "unknown")
    np.testing.assert_array_equal(found.shots.time, 0.0)
    jax.tree.map(
        np.testing.assert_array_equal,
        (found.sensor, found.shots.pose, found.shots.gimbal_readings),
        (known.sensor, known.shots.pose, known.shots.gimbal_readings),
    )
    told = [one for one in found.assumed if one.startswith("The time of 2 of 2 packets is unknown")]
    assert len(told) == 1
    assert ("a clock that is not set writes zero" in told[0]) is (case == "zero")
    assert not any("UTC" in one for one in found.assumed)


def test_packets_with_a_time_and_without(file: File) -> None:
    found = read_telemetry(file(at(1, without()), without() | {2: bytes(8)}, without(2), at(3, without())))
    np.testing.assert_allclose(found.shots.time, [1e-6 * TIME_US + 1, 0.0, 0.0, 1e-6 * TIME_US + 3], atol=1e-3)
    assert not found.time_is_utc
    assert any(one.startswith("The time of 2 of 4 packets is unknown; Prec") for one in found.assumed)
    assert found.facts["times"].count("2012-09-19") == 2
    with pytest.raises(ValueError, match="times"):
        Trajectory.from_knots(found.shots.time, found.shots.pose, found.shots.gimbal_readings)


def test_what_an_earlier_packet_said_is_not_held_where_no_time_tells_its_age(file: File) -> None:
    once, silent = usual(*ABOVE_ELLIPSOID), without(16, 17, 21) | {2: bytes(8)}
    found = read_telemetry(file(once, silent))
    assert found.names.tolist() == ["0"]
    assert any("not held in a packet without a time" in one for one in found.assumed)


def test_a_heading_that_is_only_magnetic_is_told(file: File) -> None:
    with pytest.raises(
        TableError, match=r"for want of attitude.*magnetic heading \(tag 64\) is there, but not the decl"
    ):
        read_telemetry(file(without(5) | {64: b"\x10\x00"}))


@pytest.mark.parametrize(
    "lost, words",
    [
        (13, "position of the sensor"),
        (75, "height of the sensor"),
        (5, "attitude of the platform"),
        (7, "attitude of the platform"),
        (18, "azimuth and elevation of the sensor"),
    ],
)
def test_packets_that_lack_something_are_left_out(file: File, lost: int, words: str) -> None:
    empty, error = without(), without()
    empty[lost] = b""
    reserved, too_short = b"\x80" + bytes(len(error[lost]) - 1), b"\x01"
    error[lost] = reserved if lost in (13, 7) else too_short
    found = read_telemetry(file(without(lost), MADE, empty, error))
    assert found.names.tolist() == ["1"]
    assert any(one.startswith(f"3 of 4 packets were left out for want of {words}") for one in found.assumed)
    with pytest.raises(TableError, match=f"none of its 1 packets makes an exposure. 1 of 1 .* for want of {words}"):
        read_telemetry(file(without(lost)))


def test_one_field_of_view_is_enough(file: File) -> None:
    path = file(without(17), without(16))
    found = read_telemetry(path)
    assert found.sensor is not None
    focal = np.asarray(found.sensor.camera.focal_px)  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose(focal[:, 0], focal[:, 1])
    expected = [640.0 / np.tan(np.radians(6.0)), 360.0 / np.tan(np.radians(3.4))]
    np.testing.assert_allclose(focal[:, 0], expected, rtol=3e-4)
    assert any("pixels are square" in one for one in found.assumed)
    with pytest.raises(TableError, match="for want of field of view"):
        read_telemetry(file(without(16, 17)))


def test_image_sizes(file: File) -> None:
    for across, down, size in ((12.0, 6.8, (1280, 720)), (12.0, 9.02, (640, 480)), (5.0, 5.0, (1024, 1024))):
        found = read_telemetry(file(usual(*ABOVE_ELLIPSOID, tag_16=across, tag_17=down)))
        assert found.sensor is not None
        camera: Any = found.sensor.camera
        assert (camera.width, camera.height) == size
        assert any(f"{size[0]} x {size[1]} pixels, by the ratio" in one for one in found.assumed)
    with pytest.raises(ValueError, match="image width must be a whole number"):
        read_telemetry(file(MADE), image_size=(0, 720))


def test_what_is_not_told_is_said(file: File) -> None:
    found = read_telemetry(file(without(20, 21, 23)))
    np.testing.assert_array_equal(np.asarray(found.shots.gimbal_readings)[:, 2], 0.0)
    assert any("roll of the sensor (tag 20)" in one for one in found.assumed)
    assert any("taken as UTC" in one for one in found.assumed)
    assert found.reported is not None
    assert np.isnan(found.reported.slant_range).all()
    assert np.isnan(compare_reported(found)).all()


def test_leap_seconds_are_added(file: File) -> None:
    """Sent now and then: what the second packet says holds until the fourth says something else."""
    told = [{}, {136: b"\xf0"}, {}, {136: b"\xef"}, {}]
    found = read_telemetry(file(*(usual(*ABOVE_ELLIPSOID) | one for one in told)))
    np.testing.assert_allclose(np.asarray(found.shots.time) - TIME_US * 1e-6, [-16, -16, -16, -17, -17], atol=1e-6)
    assert not any("taken as UTC" in one for one in found.assumed)


def test_a_damaged_packet_among_good_ones(file: File) -> None:
    wrong = bytearray(MADE)
    wrong[-1] ^= 1
    path = file(MADE, bytes(wrong), MADE, MADE[:60])
    found = read_telemetry(path)
    assert found.names.tolist() == ["0", "2"]
    words = f"2 of 4 packets are damaged, they were left out: packet 1 at byte {len(MADE)}: its checksum"
    assert found.assumed[0].startswith(words)
    kept = read_telemetry(path, keep_damaged=True)
    assert kept.names.tolist() == ["0", "1", "2"]
    assert "1 of them were kept" in kept.assumed[0]
    with pytest.raises(
        TableError, match=r"none of its 1 packets .* damaged.* checksum is 0x.* keep_damaged=True reads"
    ):
        read_telemetry(file(bytes(wrong)))
    assert len(read_telemetry(file(bytes(wrong)), keep_damaged=True)) == 1
    with pytest.raises(TableError, match=r"cut off: \d+ of \d+ bytes are there\.$"):  # none of it can be told apart
        read_telemetry(file(MADE[:60]))


REFUSED = {
    "empty": (b"", "no packet of MISB ST 0601 in its 0 bytes; expected KLV"),
    "text": (b"time_s,lat_deg\n" * 20, "in its 300 bytes; expected KLV, or an MPEG transport stream"),
    "other key": (
        KEY[:8] + bytes(20),
        "first key in it is 060e2b34020b01010000000000000000, that of the UAS",
    ),
    "cut off": (MADE[:70], r"none of its 1 packets .* cut off: 53 of \d+ bytes are there"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_files(file: File, case: str) -> None:
    content, words = REFUSED[case]
    with pytest.raises(TableError, match=f"flight.klv: .*{words}"):
        read_telemetry(file(content))


def test_files_that_are_none(tmp_path: pathlib.Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file of telemetry"):
        read_telemetry(tmp_path / "nowhere.klv")
    with pytest.raises(TableError, match="this is a folder"):
        read_telemetry(tmp_path)


def test_a_file_cut_off_anywhere_gives_whole_packets_or_an_error(file: File) -> None:
    whole = read_telemetry(file(MADE, MADE))
    for end in range(0, 2 * len(MADE), 5):
        path = file((MADE + MADE)[:end])
        if end < len(MADE):
            with pytest.raises(TableError):
                read_telemetry(path)
            continue
        found = read_telemetry(path)
        assert found.names.tolist() == ["0"]
        assert found.tags[0] == whole.tags[0]
        np.testing.assert_array_equal(found.shots.gimbal_readings, np.asarray(whole.shots.gimbal_readings)[:1])
        assert any("cut off" in one or "1 of 2" in one for one in found.assumed) == (end >= len(MADE) + len(KEY))


@pytest.mark.costly
@given(st.dictionaries(st.integers(2, 140), st.binary(max_size=9), max_size=20), st.binary(max_size=30))
@settings(deadline=None, database=None, derandomize=True, max_examples=60)
def test_any_items_are_an_exposure_or_an_error(tmp_path_factory: pytest.TempPathFactory, changed, noise) -> None:
    path = tmp_path_factory.getbasetemp() / "any.klv"
    path.write_bytes(noise + local_set(usual(*ABOVE_ELLIPSOID) | changed) + noise)
    try:
        found = read_telemetry(path)
    except TableError:
        return
    for leaf in jax.tree.leaves((found.sensor, found.shots)):
        assert np.isfinite(leaf).all()


def cheyenne(folder: pathlib.Path) -> Acquisition:
    return read_telemetry(folder / "telemetry_klv" / "Cheyenne.bin")


def test_a_real_flight(jaxgeo_test_data: pathlib.Path) -> None:
    """Slant ranges agree with positions to their last digits; the axis with the centre, but for delays between tags."""
    found = cheyenne(jaxgeo_test_data)
    assert len(found) == 407
    assert found.facts["Platform Designation"] == "C208B"
    assert found.facts["times"].startswith("2012-09-19T20:40:44.105")
    compared = compare_reported(found)
    assert np.abs(compared.slant_range).max() < 0.7  # m of 3 km; heights come in steps of 0.3 m
    assert np.abs(np.median(compared.slant_range)) < 0.05
    angles = np.stack([compared.azimuth, compared.elevation]) * 1e3  # mrad
    assert np.all(np.abs(np.median(angles, axis=1)) < [1.5, 0.3])
    assert np.all(np.percentile(np.abs(angles), 95, axis=1) < [6.0, 6.0])
    assert np.percentile(np.hypot(compared.east, compared.north), 50) < 10.0  # m


def test_corners_of_a_real_flight(jaxgeo_test_data: pathlib.Path) -> None:
    """They are those of images level with the horizon, while the sensor's roll is told as zero against the aircraft."""
    path = jaxgeo_test_data / "telemetry_klv" / "Cheyenne.bin"
    told, level = (
        np.degrees(compare_reported(read_telemetry(path, upright=upright)).turn) for upright in (False, True)
    )
    assert np.percentile(np.abs(told), 50) > 3.0
    assert np.percentile(np.abs(level), 50) < 0.1
    assert np.percentile(np.abs(level), 95) < 0.5
    (said,) = [one for one in read_telemetry(path).assumed if "upright=True" in one]
    turns = [float(one) for one in re.findall(r"[-+]\d+\.\d", said)]
    np.testing.assert_allclose(turns, [np.median(told), np.median(level)], atol=0.1)
    assert not any("own corners" in one for one in read_telemetry(path, upright=True).assumed)


def test_upright_images(file: File) -> None:
    """Whatever the attitude, the image's right is horizontal and its top up; the axis stays."""
    path = file(*(aimed(*look) for look in LOOKS))
    free, level = (read_telemetry(path, upright=upright) for upright in (False, True))
    R = [np.asarray(jax.jit(jax.vmap(Sensor.R_ned_from_camera))(one.sensor, one.shots)) for one in (free, level)]
    np.testing.assert_allclose(R[0][..., 2], R[1][..., 2], atol=1e-12)
    np.testing.assert_allclose(R[1][:, 2, 0], 0.0, atol=1e-12)
    assert np.all(R[1][:, 2, 1] > 0.0)
    assert np.abs(R[0][:, 2, 0]).max() > 0.1


CORNERS = [(corner, axis) for corner in range(4) for axis in (0, 1)]


def test_corners_in_full_and_by_their_offsets(file: File) -> None:
    """Corners of an image on flat ground, told of images that are turned about the axis."""
    looks = [aimed(*LOOKS[0]) | usual(20, tag_20=turn) for turn in (0.0, 20.0, 350.0)]
    corners, centre = _corners_on_the_ground(read_telemetry(file(looks[0])))
    offsets = corners - centre
    full = {82 + 2 * k + axis: code(corners[k, axis], (90.0, 180.0)[axis]) for k, axis in CORNERS}
    by_offset = {26 + 2 * k + axis: code(offsets[k, axis], 0.075, ">h") for k, axis in CORNERS}
    packets = [one | told for one, told in zip(looks, (full, by_offset, full | by_offset), strict=True)]
    found = compare_reported(read_telemetry(file(*packets, MADE, MADE)))
    np.testing.assert_allclose(np.degrees(found.turn[:3]), [0.0, -20.0, 10.0], atol=0.3)
    assert np.isnan(found.turn[3:]).all()
    assert not any("own corners" in one for one in read_telemetry(file(packets[0])).assumed)


def code(value: float, bound: float, layout: str = ">i") -> bytes:
    return whole(value, -bound, bound, layout)


def _corners_on_the_ground(found: Acquisition) -> tuple[np.ndarray, np.ndarray]:
    """(corners (4, 2), centre (2,)) of the first image on the plane through the reported centre: lat, lon in deg."""
    sensor, shot, _ = found.exposure(0)
    assert sensor is not None
    assert found.reported is not None
    camera: Any = sensor.camera
    right, below = camera.width - 0.5, camera.height - 0.5
    R = np.asarray(jax.jit(Sensor.R_ned_from_camera)(sensor, shot))
    pixels = [(-0.5, -0.5), (right, -0.5), (right, below), (-0.5, below)]
    rays = np.array([*(camera.ray(np.array(uv))[0] for uv in pixels), [0.0, 0.0, 1.0]]) @ R.T
    drop = float(shot.pose.position.height) - float(np.asarray(found.reported.centre.height)[0])
    ground = drop * rays[:, :2] / rays[:, 2:]
    centre = np.array([np.asarray(found.reported.centre.lat)[0], np.asarray(found.reported.centre.lon)[0]])
    radii = [6.367e6, 6.388e6 * np.cos(centre[0])]  # m per rad there
    return np.degrees(centre + (ground[:4] - ground[4]) / radii), np.degrees(centre)


def test_transport_streams_are_told_by_their_content() -> None:
    packet = b"\x47" + bytes(187)
    assert is_transport_stream(packet * 5)
    assert is_transport_stream((b"time" + packet) * 5)
    assert is_transport_stream((packet + bytes(16)) * 5)
    assert not is_transport_stream(MADE * 5)
    assert not is_transport_stream(packet)


@pytest.mark.parametrize("kind", ["asynchronous", "synchronous", "in cells, not declared"])
def test_telemetry_of_a_transport_stream(tmp_path: pathlib.Path, kind: str) -> None:
    """As from the packets alone; the size of the images is that of the video; headers of access units do no harm."""
    packets = [local_set(usual(*ABOVE_ELLIPSOID, tag_5=float(k))) for k in range(5)]
    (tmp_path / "alone.klv").write_bytes(b"".join(packets))
    alone = read_telemetry(tmp_path / "alone.klv", image_size=(64, 48))
    path, cells = tmp_path / "flight.ts", [cell(packet, k) for k, packet in enumerate(packets)]
    if kind == "asynchronous":
        muxed(path, packets)
    elif kind == "synchronous":  # two cells in one piece, and a packet over two
        halves = [cell(packets[3][:40], 3), cell(packets[3][40:], 4)]
        muxed(path, [cells[0], cells[1] + cells[2], *halves, cells[4]])
        path.write_bytes(synchronous(path.read_bytes()))
    else:
        muxed(path, cells)
    found = read_telemetry(path)
    assert found.names.tolist() == alone.names.tolist()
    assert found.tags == alone.tags
    jax.tree.map(np.testing.assert_array_equal, found.sensor, alone.sensor)
    assert not any("size of the images" in one or "damaged" in one for one in found.assumed)


def test_transport_streams_need_pyav(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "flight.ts"
    path.write_bytes((b"\x47" + bytes(187)) * 20)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgeo\[video\]'"):
        read_telemetry(path)


def test_transport_streams_that_leave_a_choice_or_none(tmp_path: pathlib.Path) -> None:
    two = muxed(tmp_path / "two.ts", [MADE] * 3, [local_set(usual(*ABOVE_ELLIPSOID, tag_5=99.0))] * 3)
    with pytest.raises(TableError, match=r"two.ts: streams 1, 2 hold packets of MISB ST 0601; choose one with stream="):
        read_telemetry(two)
    np.testing.assert_allclose(degrees(read_telemetry(two, stream=2).shots.pose.heading), 99.0, atol=3e-3)
    with pytest.raises(TableError, match=r"stream=0 is no data stream; those are 1, 2"):
        read_telemetry(two, stream=0)
    other = muxed(tmp_path / "other.ts", [b"no key at all"] * 3)
    with pytest.raises(TableError, match="no packets of MISB ST 0601 in this transport stream; data streams: 1"):
        read_telemetry(other)
    broken = tmp_path / "broken.ts"
    broken.write_bytes((b"\x47" + bytes(187)) * 20)
    with pytest.raises(TableError, match=r"broken.ts: "):
        read_telemetry(broken)
