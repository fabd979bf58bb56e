"""Exposures of a video or a log at given times: between records, at the nearest one, and outside the file.

Held against: linear interpolation in NumPy; times of subtitles count from the start of the video (SubRip).
"""

from __future__ import annotations

import json
import pathlib
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.command_runner import CliRunner
from support.klv_packets import TIME_US, local_set, usual

from jaxgeo.cli import app
from jaxgeo.io import TableError, read_acquisition, read_acquisitions
from jaxgeo.io.acquisitions.detect import WrongOption
from tests.io.test_flight_logs import airdata

CUE = """{number}
00:00:{second:02d},000 --> 00:00:{second:02d},033
{date}[latitude: {lat}] [longitude: {lon}] [rel_alt: 300.000 abs_alt: {alt}] \
[gb_yaw: {yaw} gb_pitch: -60.0 gb_roll: 0.0]

"""
START = 1_746_354_030.0  # 2025-05-04 10:20:30 UTC
Video = list[tuple[int, float, float, float]]
FLIGHT: Video = [(2, 36.3, 900.0, 359.0), (3, 36.4, 910.0, 1.0), (4, 36.6, 900.0, 61.0), (9, 36.7, 900.0, 62.0)]


def video(rows: Video = FLIGHT, *, dated: bool = False, before: int = 0) -> str:
    """Records (second, latitude, height, yaw), after some without a position."""
    lost = [(k, 0.0, 0.0, 0.0) for k in range(before)]
    return "".join(
        CUE.format(
            number=k + 1, second=second, lat=lat, lon=-84.2 if lat else 0.0, alt=alt, yaw=yaw,
            date=f"2025-05-04 10:20:{30 + second}.000\n" if dated else "",
        )
        for k, (second, lat, alt, yaw) in enumerate([*lost, *rows])
    )  # fmt: skip


@pytest.fixture
def srt(tmp_path: pathlib.Path) -> Callable[..., pathlib.Path]:
    def write(text: str) -> pathlib.Path:
        path = tmp_path / "clip.srt"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def numbers(found: Any) -> np.ndarray:
    """Latitude in deg, height in m, yaw in deg and time in s of each exposure."""
    pose = found.shots.pose
    columns = (np.rad2deg(pose.position.lat), pose.position.height, np.rad2deg(pose.heading) % 360.0, found.shots.time)
    return np.stack([np.asarray(one) for one in columns], axis=-1)


@pytest.mark.parametrize("dated", [False, True], ids=["by the video's clock", "dated"])
def test_times_count_from_the_start_of_the_video(srt, dated: bool) -> None:
    """Also where its first records have no position."""
    path = srt(video(dated=dated, before=2))
    times = ["00:00:02.25", "2.75", 3.0, "0:03"]
    found = read_acquisition(path, height_datum=0.0, times=times)
    assert found.names.tolist() == ["00:00:02.25", "00:00:02.75", "00:00:03", "00:00:03"]
    expected = [[36.325, 902.5, 359.5, 2.25], [36.375, 907.5, 0.5, 2.75], [36.4, 910.0, 1.0, 3.0]]
    expected = np.array([*expected, expected[-1]])
    expected[:, 3] += START if dated else 0.0
    np.testing.assert_allclose(numbers(found), expected, atol=1e-6)
    assert any("interpolated linearly between neighbouring records, 1 s apart at most" in one for one in found.assumed)


def test_the_nearest_record_is_taken_over_gaps_and_sharp_turns(srt) -> None:
    path = srt(video())
    found = read_acquisition(path, height_datum=0.0, times=["3.75", "8.0"])
    np.testing.assert_allclose(numbers(found), [[36.6, 900.0, 61.0, 3.75], [36.7, 900.0, 62.0, 8.0]], atol=1e-6)
    for words in (
        "at 3.75 is that of the nearest record, 3, 0.25 s away: between its neighbours an angle turns by 60 deg, more",
        "at 8.0 is that of the nearest record, 4, 1 s away: its neighbours are 5 s apart, more than 2 s.",
    ):
        assert any(words in one for one in found.assumed)


def test_a_time_outside_the_file_is_refused_with_its_range(srt) -> None:
    path = srt(video())
    for time, words in (
        ("00:01:23", r'times="00:01:23" is outside the file; its exposures are from 00:00:02 to 00:00:09\.'),
        ("1.9", "is outside the file"),
        ("00:61:00", "is none of HH:MM:SS"),
        ("soon", "is none of HH:MM:SS"),
        ("2025-05-04T10:20:33", "has no time zone; write 2025-05-04T10:20:33Z"),
        ("2025-05-04T10:20:33Z", "the times of the file are not"),
    ):
        with pytest.raises(TableError, match=words) as refusal:
            read_acquisition(path, height_datum=0.0, times=[time])
        assert "\n" not in str(refusal.value)


def test_poses_are_interpolated_where_the_zoom_changes(tmp_path: pathlib.Path) -> None:
    """Telemetry has the field of view in steps; the focal length is that of the nearest record."""
    packets = tmp_path / "video.klv"
    sets = (
        usual(tag_75=1000.0 + 10.0 * k, tag_16=20.0 + 0.01 * k) | {2: struct.pack(">Q", TIME_US + 1_000_000 * k)}
        for k in range(2)
    )
    packets.write_bytes(b"".join(map(local_set, sets)))
    whole = read_acquisition(packets)
    found = read_acquisition(packets, times=["0.25", "0.75"])
    ends = np.asarray(whole.shots.pose.position.height)
    np.testing.assert_allclose(found.shots.pose.position.height, ends[0] + np.array([0.25, 0.75]) * np.ptp(ends))
    focal = [np.asarray(one.sensor.camera.focal_px) for one in (whole, found)]
    assert not np.array_equal(focal[0][0], focal[0][1])
    np.testing.assert_array_equal(focal[1], focal[0])


def test_logs_and_telemetry_take_times_in_utc_too(tmp_path: pathlib.Path) -> None:
    log = tmp_path / "flight.csv"
    later = {"time(millisecond)": "2500", "datetime(utc)": "2025-05-04 10:20:32", "latitude": "36.4"}
    log.write_text(airdata({}, later), encoding="utf-8")
    found = read_acquisition(log, takeoff_height=0.0, times=["2025-05-04T10:20:31.250Z"])
    assert found.names.tolist() == ["2025-05-04T10:20:31.250Z"]
    np.testing.assert_allclose(np.rad2deg(found.shots.pose.position.lat), [36.325], atol=1e-9)
    packets = tmp_path / "video.klv"
    sets = (usual(tag_75=1000.0 + 10.0 * k) | {2: struct.pack(">Q", TIME_US + 1_000_000 * k)} for k in range(3))
    packets.write_bytes(b"".join(map(local_set, sets)))
    whole = read_acquisition(packets).shots.pose.position.height
    found = read_acquisitions([packets, log], takeoff_height=0.0, times=["0.5"])
    assert not found.unread
    height = np.asarray(found.parts[0].shots.pose.position.height)
    np.testing.assert_allclose(height, [0.5 * (whole[0] + whole[1])], atol=1e-6)
    table = tmp_path / "eo.csv"
    table.write_text("image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg\na,43,4,18,3,3,-1\n")
    with pytest.raises(WrongOption, match="table of orientations, and times is no option"):
        read_acquisition(table, height_datum=0.0, times=["1"])


def test_the_command_line_says_which(srt) -> None:
    path = str(srt(video()))
    line = ["inspect", path, "--camera-datum", "0"]
    result = CliRunner().invoke(app, [*line, "--time", "00:00:02.5", "--time", "9", "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert [row["name"] for row in told["exposures"]] == ["00:00:02.5", "00:00:09"]
    refused = CliRunner().invoke(app, [*line, "--time", "83.5"])
    assert refused.exit_code == 2
    assert "--time 83.5 is outside the file; its exposures are from 00:00:02 to 00:00:09." in refused.stderr
