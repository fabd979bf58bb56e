"""Solutions of a receiver (RTKLIB's .pos) joined to photos by DJI's marks: times, offsets to the camera, refusals.

Held against: DJI's "Matrice 4 Series User Manual" (2025), "Image Log File", and "Phantom 4 RTK White Paper V2": offsets
in mm, positive where the camera is north of, east of and below the antenna. Positions are computed here on a circle
flown in NumPy, and moved to the camera in geocentric coordinates by PROJ.
"""

from __future__ import annotations

import datetime
import json
import pathlib

import numpy as np
import pyproj
import pytest
from support.command_runner import CliRunner
from support.drone_image_files import CAMERA, packet, write_image

from jaxgeo.cli import app
from jaxgeo.io import TableError, read_acquisition, read_acquisitions
from tests.io.test_positions import DJI, place
from tests.io.test_rtklib_positions import LEAP, START, circle, image, track, written

EPOCHS = np.arange(0.0, 60.0, 0.2)
AT = {1: 10.1234, 2: 12.3171, 3: 14.8809}  # s after the start
OFFSETS = {1: (-40.0, 25.0, 194.0), 2: (120.0, -60.0, 150.0), 3: (0.0, 90.0, 201.0)}  # mm
LINE = "{}\t{:.6f}\t[{}]\t{:.0f},N\t{:.0f},E\t{:.0f},V\t0.0,Lat\t0.0,Lon\t0.0,Ellh\t0.0, 0.0, 0.0\t{},Q"
GPS_START = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC).timestamp()


def marks(folder: pathlib.Path, at: dict[int, float] | None = None, name: str = "100_Timestamp.MRK") -> pathlib.Path:
    """Marks without positions, as of flights without corrections in real time."""
    lines = []
    for number, seconds in (AT if at is None else at).items():
        week, tow = divmod(START + LEAP - GPS_START + seconds, 604_800.0)
        lines.append(LINE.format(number, tow, int(week), *OFFSETS[number], 0))
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def photo(folder: pathlib.Path, number: int, seconds: float | None = None) -> pathlib.Path:
    """A photo by a clock of its own, 5 h before UTC and without a time zone; its position is somewhere near."""
    path = folder / f"DJI_{number:04d}.JPG"
    local = datetime.datetime.fromtimestamp(START - 18_000.0, tz=datetime.UTC)
    taken = local + datetime.timedelta(seconds=AT[number] if seconds is None else seconds)
    return write_image(path, packet(DJI), make="DJI", exif=CAMERA | {0x9003: taken.strftime("%Y:%m:%d %H:%M:%S")})


@pytest.fixture
def flight(tmp_path: pathlib.Path) -> tuple[pathlib.Path, pathlib.Path]:
    """(a folder of three photos with their marks, the solutions of their flight)."""
    images = tmp_path / "images"
    images.mkdir()
    for number in AT:
        photo(images, number)
    marks(images)
    return images, written(tmp_path, track(EPOCHS))


def cameras() -> np.ndarray:
    """Latitude and longitude in deg and height in m (n, 3) of the cameras."""
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    found = []
    for number, seconds in AT.items():
        lat, lon, height = circle(np.array([seconds]))[0]
        north, east, down = np.array(OFFSETS[number]) / 1e3
        phi, lam = np.deg2rad([lat, lon])
        to_east = np.array([-np.sin(lam), np.cos(lam), 0.0])
        to_up = np.array([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)])
        at = np.array(to_ecef.transform(lon, lat, height))
        at = at + north * np.cross(to_up, to_east) + east * to_east - down * to_up
        lon, lat, height = to_ecef.transform(*at, direction="INVERSE")
        found.append([lat, lon, height])
    return np.array(found)


def check_cameras(found, rows: slice = slice(None)) -> None:
    """The cameras are where they should be, to 2 mm."""
    off = (place(found) - cameras()[rows]) * [111_000.0, 89_000.0, 1.0]  # m
    assert np.abs(off).max() < 2e-3


def test_photos_are_placed_at_the_events_of_their_marks(flight) -> None:
    images, path = flight
    found = read_acquisition(images, positions=path)
    check_cameras(found)
    assert found.facts["positions"] == "RTKLIB solutions, 3 of 3 images, by time of marks"
    assert any("moved to the camera by the offsets in 100_Timestamp.MRK" in one for one in found.assumed)
    assert not any("no lever arm" in one or "whole seconds" in one for one in found.assumed)
    np.testing.assert_allclose(found.sources[0].sigma, np.tile([0.01, 0.02, 0.03], (3, 1)))


def test_positions_of_marks_and_solutions_replace_what_images_say_of_their_own(flight) -> None:
    """Times are those of the marks in UTC, errors those of the solutions; nothing that is said contradicts another."""
    images, path = flight
    own = read_acquisition(images, height_datum="ellipsoid")
    assert "position errors" in own.facts
    assert any(one.startswith("Positions are taken to be those of the camera") for one in own.assumed)
    for found in (read_acquisition(images, positions=path), read_acquisitions(images, positions=path).parts[0]):
        assert found.time_is_utc
        np.testing.assert_allclose(found.shots.time, START + np.array([*AT.values()]), atol=1e-5)  # s
        assert found.facts["position errors"] == "0.01, 0.02, 0.03 m (standard deviations north, east, down)"
        assert "Times are those of the marks in 100_Timestamp.MRK, in UTC." in found.assumed
        assert not any("camera's clock" in one or "those of the camera:" in one for one in found.assumed)


def test_the_marks_may_lie_beside_the_solutions(flight) -> None:
    images, path = flight
    (images / "100_Timestamp.MRK").rename(path.parent / "marks.mrk")
    check_cameras(read_acquisition(images, positions=path))


def test_events_of_a_camera_are_moved_to_it_too(flight) -> None:
    """Solutions at the exposures themselves, `*_events.pos`."""
    images, _ = flight
    path = written(images.parent, track(np.array([*AT.values()]) + 0.0004))
    found = read_acquisition(images, positions=path)
    off = (place(found) - cameras()) * [111_000.0, 89_000.0, 1.0]
    assert np.abs(off).max() < 8.0 * 0.001 + 2e-3  # m, flown in the ms to which the epochs are written
    assert found.facts["positions"].endswith("by time of marks")


def test_photos_with_their_own_time_in_utc_are_moved_too(tmp_path: pathlib.Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for number, seconds in AT.items():
        image(images, f"DJI_{number:04d}.JPG", seconds + 0.02)
    path = written(tmp_path, track(EPOCHS))
    alone = read_acquisition(images, positions=path)
    assert any("no lever arm" in one for one in alone.assumed)
    marks(images)
    check_cameras(read_acquisition(images, positions=path))
    for number in AT:  # two cameras of a drone, as of a thermal and a visible one, share a number
        image(images, f"DJI_20230615100000_{number:04d}_T.JPG", AT[number] + 0.02)
    both = read_acquisition(images, positions=path)
    off = (place(both) - np.concatenate([cameras(), cameras()])) * [111_000.0, 89_000.0, 1.0]
    assert np.abs(off).max() < 2e-3
    marks(images, {2: 9000.0})  # of another flight: images stay at their own times, without offsets
    marks(images, name="102_Timestamp.MRK")
    several = read_acquisition(images, positions=path)
    assert any("no lever arm" in one for one in several.assumed)


def test_photos_in_a_gap_or_without_a_mark_are_left_out_and_named(flight) -> None:
    images, path = flight
    path = written(path.parent, track(EPOCHS[(EPOCHS < 12.0) | (EPOCHS > 14.0)]))
    found = read_acquisition(images, positions=path)
    assert found.names.tolist() == ["DJI_0001.JPG", "DJI_0003.JPG"]
    check_cameras(found, slice(None, None, 2))
    assert any("1 of 3 images" in one and "left out: DJI_0002.JPG" in one for one in found.assumed)
    marks(images, {1: AT[1]})
    assert read_acquisition(images, positions=path).names.tolist() == ["DJI_0001.JPG"]


def test_photos_are_read_one_by_one_on_the_command_line(flight) -> None:
    images, path = flight
    path = written(path.parent, track(EPOCHS[(EPOCHS < 12.0) | (EPOCHS > 14.0)]))
    result = CliRunner().invoke(app, ["inspect", str(images), "--positions", str(path), "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert [one["name"] for one in told["unread"]] == ["DJI_0002.JPG"]
    assert "DJI_0002.JPG was not taken within it" in told["unread"][0]["reason"]
    assert "no image" not in told["unread"][0]["reason"]
    heights = [row["height_m"] for row in told["exposures"]]
    np.testing.assert_allclose(heights, cameras()[::2, 2], atol=2e-3)


def test_photos_by_a_local_clock_need_marks(flight) -> None:
    images, path = flight
    (images / "100_Timestamp.MRK").unlink()
    for content in (track(EPOCHS), track(np.array([*AT.values()]))):
        with pytest.raises(
            TableError, match=r"are not in UTC .*Put DJI's marks of the flight \(\.MRK\) beside"
        ) as told:
            read_acquisition(images, positions=written(path.parent, content))
        assert "\n" not in str(told.value)


def test_marks_that_do_not_fit_are_refused_in_a_line(flight) -> None:
    images, path = flight
    marks(images, name="101_Timestamp.MRK")
    with pytest.raises(TableError, match=r"not clear: 100_Timestamp\.MRK and 101_Timestamp\.MRK; leave those"):
        read_acquisition(images, positions=path)
    (images / "101_Timestamp.MRK").unlink()
    photo(images, 3, AT[3] + 700.0)
    with pytest.raises(TableError, match="they are not of one flight"):
        read_acquisition(images, positions=path)
    with pytest.raises(TableError, match="they are not of one flight"):
        read_acquisitions(images, positions=path)
    photo(images, 3)
    marks(images, {2: AT[2]})
    late = written(images.parent, track(np.array([30.0123, 31.0456])))
    with pytest.raises(
        TableError, match=r"no image was taken at one of its times, .*; the first is of 2023-06-15T10:00:12"
    ):
        read_acquisition(images, positions=late)
    path = written(path.parent, track(EPOCHS))
    marks(images, {number: seconds + 3600.0 for number, seconds in AT.items()})
    with pytest.raises(TableError, match="no image was taken within it: it is from 2023-06-15T10:00:00"):
        read_acquisition(images, positions=path)
    for number in AT:
        (images / f"DJI_{number:04d}.JPG").rename(images / f"DJI_{number + 500:04d}.JPG")
    with pytest.raises(TableError, match=r"it has none of the images: they are DJI_0501\.JPG"):
        read_acquisition(images, positions=path)
