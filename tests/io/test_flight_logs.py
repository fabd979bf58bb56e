"""Subtitles of DJI's videos and flight logs of AirData: positions, angles of the camera, what is unknown.

Held against: the layout of DJI's SRT as published readers of it expect it (FrameCnt, latitude, longitude or longtitude,
rel_alt, abs_alt, gb_yaw, gb_pitch, gb_roll), and the header that AirData exports today (AIRDATA_HEADER, 48 columns in
feet, or with meters), which its readers list.
"""

from __future__ import annotations

import calendar
import pathlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo import FrameCamera
from jaxgeo.io import TableError, UnstatedDatum, read_acquisition, undulation, with_usual_errors
from jaxgeo.io.acquisitions._flight_logs import nadir_attitude
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_FORWARD, R_HEAD_FROM_CAMERA_NADIR

AIRDATA_HEADER = (
    "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),"
    "height_above_ground_at_drone_location(feet),ground_elevation_at_drone_location(feet),"
    "altitude_above_seaLevel(feet),height_sonar(feet),speed(mph),distance(feet),mileage(feet),satellites,gpslevel,"
    "voltage(v),max_altitude(feet),max_ascent(feet),max_speed(mph),max_distance(feet), xSpeed(mph), ySpeed(mph),"
    " zSpeed(mph), compass_heading(degrees), pitch(degrees), roll(degrees),isPhoto,isVideo,rc_elevator,rc_aileron,"
    "rc_throttle,rc_rudder,rc_elevator(percent),rc_aileron(percent),rc_throttle(percent),rc_rudder(percent),"
    "gimbal_heading(degrees),gimbal_pitch(degrees),gimbal_roll(degrees),battery_percent,voltageCell1,voltageCell2,"
    "voltageCell3,voltageCell4,voltageCell5,voltageCell6,current(A),battery_temperature(f),altitude(feet),ascent(feet),"
    "flycStateRaw,flycState,message"
)
AIRDATA = {
    "time(millisecond)": "1500",
    "datetime(utc)": "2025-05-04 10:20:31",
    "latitude": "36.3",
    "longitude": "-84.2",
    "height_above_takeoff(feet)": "984.252",
    "altitude_above_seaLevel(feet)": "2952.756",
    "gpslevel": "5",
    " compass_heading(degrees)": "28",
    "isPhoto": "0",
    "gimbal_heading(degrees)": "30.5",
    "gimbal_pitch(degrees)": "-60",
    "gimbal_roll(degrees)": "0",
    "altitude(feet)": "1.0",
}
SRT = """{number}
00:00:00,000 --> 00:00:00,033
<font size="28">FrameCnt: {number}, DiffTime: 33ms
2025-05-04 10:20:30.125
[iso: 100] [shutter: 1/1000] [fnum: 2.8] [focal_len: 24.00] [latitude: {lat}] [longitude: {lon}] \
[rel_alt: 300.000 abs_alt: {alt}] [gb_yaw: {yaw} gb_pitch: {pitch} gb_roll: {roll}]</font>

"""
USUAL = {
    "number": 1,
    "lat": "36.300000",
    "lon": "-84.200000",
    "alt": "900.000",
    "yaw": "30.5",
    "pitch": "-60.0",
    "roll": "0.0",
}


def subtitles(*changes: dict[str, Any]) -> str:
    return "".join(SRT.format(**(USUAL | {"number": k + 1} | change)) for k, change in enumerate(changes or ({},)))


def airdata(*changes: dict[str, str], header: str = AIRDATA_HEADER) -> str:
    rows = [
        ",".join((AIRDATA | change).get(name, "") for name in AIRDATA_HEADER.split(",")) for change in changes or ({},)
    ]
    return "\n".join([header, *rows, ""])


@pytest.fixture
def log(tmp_path: pathlib.Path) -> Callable[..., Any]:
    def read(text: str, **how: Any) -> Any:
        path = tmp_path / "log.txt"
        path.write_text(text, encoding="utf-8")
        return read_acquisition(path, **how)

    return read


def angles(found: Any) -> list[float]:
    pose = found.shots.pose
    return [float(np.rad2deg(np.asarray(one)[0])) for one in (pose.heading, pose.pitch, pose.roll)]


@pytest.mark.parametrize("text", [subtitles(), airdata()], ids=["subtitles", "AirData"])
def test_a_record_is_an_exposure(log, text: str) -> None:
    found = log(text, height_datum="EPSG:5773")
    at = found.shots.pose.position
    np.testing.assert_allclose(np.rad2deg([at.lat[0], at.lon[0]]), [36.3, -84.2], atol=1e-12)
    geoid = float(undulation(36.3, -84.2))
    assert at.height[0] == pytest.approx(900.0 + geoid, abs=2e-3)  # m
    np.testing.assert_allclose(angles(found), [30.5, 30.0, 0.0], atol=1e-12)  # the body of a camera in Mount.nadir()
    assert found.sensor is None
    above = log(text, takeoff_height=10.0)
    assert above.shots.pose.position.height[0] == pytest.approx(310.0, abs=1e-3)


def test_times(log) -> None:
    stamp = calendar.timegm((2025, 5, 4, 10, 20, 30))
    found = log(subtitles(), height_datum=0.0)
    assert found.shots.time.tolist() == [stamp + 0.125]
    assert not found.time_is_utc
    found = log(airdata({}, {"time(millisecond)": "1625", "isPhoto": "1"}), height_datum=0.0)
    assert found.shots.time.tolist() == [stamp + 1.0, stamp + 1.125]
    assert found.time_is_utc
    assert found.facts["photos"] == "1 (1)"
    for text, words in (
        (subtitles().replace("2025-05-04", "0000-00-00"), "Times are those of the video"),
        (airdata({"datetime(utc)": ""}), "Times are not in the file, or not in a form that is read; they are 0."),
    ):
        found = log(text, height_datum=0.0)
        assert found.shots.time.tolist() == [0.0]
        assert any(words in one for one in found.assumed)


def test_feet_and_meters(log) -> None:
    found = log(airdata(header=AIRDATA_HEADER.replace("(feet)", "(meters)")), height_datum=0.0)
    assert found.shots.pose.position.height[0] == 2952.756
    with pytest.raises(TableError, match="its unit must be feet or meters"):
        log(airdata(header=AIRDATA_HEADER.replace("(feet)", "(fathoms)")), height_datum=0.0)


def test_spellings_of_subtitles(log) -> None:
    found = log(subtitles().replace("longitude", "longtitude").replace("FrameCnt: 1", ""), height_datum=0.0)
    np.testing.assert_allclose(np.rad2deg(found.shots.pose.position.lon), [-84.2])
    assert found.names.tolist() == ["1"]


def test_what_is_unknown_is_left_out_and_said(log) -> None:
    text = subtitles({}, {"lat": "0.000000", "lon": "0.000000"}, {"alt": "0.000"}, {"yaw": "0.0", "pitch": "0.0"})
    found = log(text, height_datum=0.0)
    assert found.names.tolist() == ["1"]
    told = " ".join(found.assumed)
    for quantity in ("position unknown", "height unknown", "camera angles unknown"):
        assert f"1 of 4 records are left out: {quantity}" in told
    blank = {"latitude": "", "longitude": ""}
    changes = [{}, blank, {"gpslevel": "0"}, {"latitude": "0", "longitude": "0"}, {"gimbal_pitch(degrees)": ""}]
    found = log(airdata(*changes), height_datum=0.0)
    assert found.names.tolist() == ["0"]
    assert found.facts["records"] == "1 of 5"
    with pytest.raises(TableError, match=r"no record has a position.*position unknown"):
        log(airdata(blank), height_datum=0.0)


@pytest.mark.parametrize(
    "text, how, words",
    [
        (subtitles(), {}, r"the first is 900 m, 300 m above the take-off.*height_datum=.*takeoff_height="),
        (airdata(), {}, "the vertical datum of its altitude is not stated"),
    ],
)
def test_heights_are_asked_for(log, text: str, how: Any, words: str) -> None:
    with pytest.raises(UnstatedDatum, match=words):
        log(text, **how)


REFUSED = {
    "no angles": (subtitles().replace("gb_", "xx_"), "there are no angles of the camera"),
    "old subtitles": ("1\n00:00:00,000 --> 00:00:01,000\nGPS(-84.2,36.3,15)\n", "there are no angles of the camera"),
    "latitude": (subtitles({"lat": "136.3"}), r"subtitle 1: lat 136.3 is outside \[-90, 90\] deg"),
    "no gimbal": (airdata(header=AIRDATA_HEADER.replace("gimbal_pitch", "x")), "no column gimbal_pitch"),
    "word": (airdata({"gimbal_heading(degrees)": "north"}), "row 2, column gimbal_heading.*'north' is not a number"),
    "range": (airdata({"gimbal_heading(degrees)": "530"}), r"row 2: yaw 530 is outside \[-360, 360\] deg"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_logs_that_do_not_serve_are_refused_in_a_line(log, case: str) -> None:
    text, words = REFUSED[case]
    with pytest.raises(TableError, match=words) as refusal:
        log(text, height_datum=0.0)
    assert "\n" not in str(refusal.value)


def test_a_camera_is_the_bodys(log) -> None:
    camera = FrameCamera.from_pixels(focal_px=2600.0, width=3840, height=2160)
    found = log(subtitles({}, {}), height_datum=0.0, cameras=camera)
    sensor, shot, _ = found.exposure(1)
    ray, _ = jax.jit(lambda: sensor.camera.ray(np.array([1919.5, 1079.5])))()
    np.testing.assert_allclose(ray, [0.0, 0.0, 1.0], atol=1e-12)
    sight = jax.jit(lambda: sensor.sight(shot).R_ecef_from_camera @ np.array([0.0, 0.0, 1.0]))()
    lat, lon = np.deg2rad([36.3, -84.2])
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    assert float(np.dot(sight, up)) == pytest.approx(-np.sin(np.deg2rad(60.0)), abs=1e-12)
    with pytest.raises(TableError, match="the file names no cameras"):
        log(subtitles(), height_datum=0.0, camera="wide")


def test_the_gimbals_angles_err_as_those_of_a_drone(log) -> None:
    found = with_usual_errors(log(subtitles(), height_datum=0.0))
    sigma = {type(one).__name__: np.rad2deg(np.asarray(one.sigma)[0]) for one in found.sources}
    np.testing.assert_allclose(sigma["Attitude"], [1.0, 0.5, 0.5])


def test_the_attitude_of_a_nadir_camera_is_the_gimbals() -> None:
    yaw, pitch, roll = np.deg2rad(np.random.default_rng(2).uniform([-180, -120, -180], [180, 45, 180], (50, 3))).T
    pitch[:3], roll[3:6], (pitch[6], roll[6]) = 0.0, 0.0, (0.0, 0.0)
    gimbal = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    body = Rotation.from_euler("ZYX", np.stack(nadir_attitude(yaw, pitch, roll), axis=1)).as_matrix()
    np.testing.assert_allclose(
        body @ np.asarray(R_HEAD_FROM_CAMERA_NADIR), gimbal @ np.asarray(R_HEAD_FROM_CAMERA_FORWARD), atol=2e-9
    )


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("2\n00:00:00,033 --> 00:00:00,066\n", "2\n00:00:0", "latitude stands twice, as 47.1 and as 47.2"),
        ("1\n00:00:00,000 --> 00:00:00,033\n", "1\n", "row 2: there is no time"),
    ],
)
def test_records_of_subtitles_whose_time_is_damaged_are_not_mixed(
    tmp_path: pathlib.Path, old: str, new: str, words: str
) -> None:
    """A second record within a cue would take the place of the first, field by field."""
    record = "{0}\n{1}\n[latitude: 47.{0}] [longitude: 8.25] [abs_alt: 610.5] [gb_yaw: 1 gb_pitch: -45 gb_roll: 0]\n\n"
    times = "00:00:00,000 --> 00:00:00,033", "00:00:00,033 --> 00:00:00,066"
    text = "".join(record.format(k + 1, time) for k, time in enumerate(times))
    assert old in text
    (tmp_path / "a.SRT").write_text(text.replace(old, new))
    with pytest.raises(TableError, match=words):
        read_acquisition(tmp_path / "a.SRT", height_datum="ellipsoid")


def test_a_number_of_subtitles_that_goes_on_in_damaged_bytes_is_none(tmp_path: pathlib.Path) -> None:
    place = "[latitude: 47.1\xfe5] [longitude: 8.25] [abs_alt: 610.5] [gb_yaw: 1 gb_pitch: -45 gb_roll: 0]"
    text = f"1\n00:00:00,000 --> 00:00:00,033\n{place}\n"
    (tmp_path / "a.SRT").write_bytes(text.encode("latin-1"))
    with pytest.raises(TableError, match="no record has a position"):
        read_acquisition(tmp_path / "a.SRT", height_datum="ellipsoid")


def test_a_damaged_second_value_of_subtitles_is_no_reason_to_take_the_first(tmp_path: pathlib.Path) -> None:
    angles = "[gb_yaw: 1 gb_pitch: -45 gb_roll: 0]"
    place = f"[latitude: 47.1] [longitude: 8.25] [longitude: 120.0a] [abs_alt: 610.5] {angles}"
    (tmp_path / "a.SRT").write_text(f"1\n00:00:00,000 --> 00:00:00,033\n{place}\n")
    with pytest.raises(TableError, match=r"subtitle 1: longitude stands twice, as 8\.25 and as 120\.0a"):
        read_acquisition(tmp_path / "a.SRT", height_datum="ellipsoid")
