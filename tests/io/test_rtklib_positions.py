"""Positions of images from RTKLIB's solutions (.pos): their times, interpolation, errors and refusals.

Held against: the manual of RTKLIB 2.4.2, appendix B.1, with lines as its programs write them in public files (SAMPLE);
the epoch of GPS and the leap seconds of IERS; a circle flown in NumPy for the interpolation.
"""

from __future__ import annotations

import dataclasses
import datetime
import pathlib
from typing import Any

import numpy as np
import pytest
from support.command_runner import CliRunner
from support.drone_image_files import packet, write_image

from jaxgeo.cli import app
from jaxgeo.io import TableError, UnstatedDatum, read_acquisition, read_acquisitions, with_positions
from jaxgeo.io.acquisitions._position_tables import read_positions
from jaxgeo.io.acquisitions.detect import form_of
from tests.io.test_positions import DJI

SAMPLE = """% program   : rnx2rtkp ver.EX 2.5.1
% obs start : 2026/09/15 08:49:49.0 GPST (week2436 204589.0s)
%
% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)
%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio
2436 204589.000   44.470303520   90.294603461   613.3524   2  21   0.9212   0.8230   2.5620   0.3087  -0.5878  -0.7088   0.00    0.0
2436 204601.000   44.470302864   90.294602471   615.8615   1  19   0.0034   0.0031   0.0099   0.0009  -0.0028  -0.0019   0.00    5.1
"""  # noqa: E501
HEADER = SAMPLE.splitlines()[3] + "\n" + SAMPLE.splitlines()[4] + "\n"
START = datetime.datetime(2023, 6, 15, 10, 0, 0, tzinfo=datetime.UTC).timestamp()  # UTC
LEAP = 18.0  # s
LAT, LON, TALL, RADIUS, SPEED = 36.3, -84.2, 420.0, 40.0, 8.0
RADII = 6.359e6, 6.386e6  # m, of the meridian and across it there: (deg to rad) per m only has to be smooth


def circle(time: np.ndarray) -> np.ndarray:
    """Latitude and longitude in deg and height in m, (n, 3), at times in s after the start."""
    turn = SPEED / RADIUS * time
    lat = LAT + np.rad2deg(RADIUS * np.sin(turn) / RADII[0])
    lon = LON + np.rad2deg(RADIUS * np.cos(turn) / (RADII[1] * np.cos(np.radians(LAT))))
    return np.stack([lat, lon, TALL + 2.0 * np.sin(turn)], axis=-1)


def track(time: np.ndarray, *, sigma: tuple[float, float, float] = (0.01, 0.02, 0.03), quality: int = 1) -> str:
    """Solutions at times in s after the start, in GPS time."""
    lines = [HEADER]
    for t, (lat, lon, height) in zip(time, circle(time), strict=True):
        moment = datetime.datetime.fromtimestamp(START + LEAP, tz=datetime.UTC) + datetime.timedelta(seconds=float(t))
        stamp = moment.strftime("%Y/%m/%d %H:%M:%S.%f")[:-3]
        deviations = " ".join(f"{one:8.4f}" for one in sigma)
        lines.append(f"{stamp} {lat:.12f} {lon:.12f} {height:.4f} {quality} 15 {deviations} 0 0 0 0.00 9.9\n")
    return "".join(lines)


def image(folder: pathlib.Path, name: str, after: float) -> pathlib.Path:
    moment = datetime.datetime.fromtimestamp(START, tz=datetime.UTC) + datetime.timedelta(seconds=after)
    tags = DJI | {"drone-dji:UTCAtExposure": moment.strftime("%Y:%m:%d %H:%M:%S.%f")}
    write_image(folder / name, packet(tags), make="DJI")
    return folder / name


def written(folder: pathlib.Path, text: str) -> pathlib.Path:
    path = folder / "flight.pos"
    path.write_text(text, encoding="utf-8")
    return path


def errors_m(found: Any, time: np.ndarray) -> np.ndarray:
    """Distances in m from the circle."""
    lat, lon, height = circle(time).T
    at = found.shots.pose.position
    north = (np.rad2deg(at.lat) - lat) * np.pi / 180.0 * RADII[0]
    east = (np.rad2deg(at.lon) - lon) * np.pi / 180.0 * RADII[1] * np.cos(np.radians(LAT))
    return np.sqrt(north**2 + east**2 + (at.height - height) ** 2)


def test_positions_are_interpolated_to_the_times_of_images(tmp_path: pathlib.Path) -> None:
    """At 5 epochs a second the cubic is true to 0.1 mm, where the nearest epoch is 0.8 m off."""
    path = written(tmp_path, track(np.arange(0.0, 60.0, 0.2)))
    (tmp_path / "images").mkdir()
    times = np.array([7.31, 20.09])
    for name, time in zip(("a.jpg", "b.jpg"), times, strict=True):
        image(tmp_path / "images", name, time)
    found = read_acquisition(tmp_path / "images", positions=path)
    assert found.names.tolist() == ["a.jpg", "b.jpg"]
    assert np.all(errors_m(found, times) < 2e-4)  # m
    np.testing.assert_allclose(found.sources[0].sigma, [[0.01, 0.02, 0.03]] * 2)
    assert found.facts["positions"] == "RTKLIB solutions, 2 of 2 images, by time"
    told = " ".join(found.assumed)
    for words in ("GPS time; UTC is 18 s", "no lever arm", "300 fixed (Q 1)", "interpolated in the 300 epochs"):
        assert words in told


def test_events_of_a_camera_are_taken_as_they_are(tmp_path: pathlib.Path) -> None:
    events = np.array([3.2137, 5.5511, 8.0173])
    path = written(tmp_path, track(events))
    found = read_acquisition(image(tmp_path, "a.jpg", 5.9), positions=path)
    assert errors_m(found, events[1:2])[0] < 1e-4  # m
    assert any("taken to be exposures" in one for one in found.assumed)


def test_whole_seconds_widen_the_errors_by_the_way_in_a_second(tmp_path: pathlib.Path) -> None:
    """A time cut to whole seconds is up to 1 s early: rms 1 / sqrt(3) of the way, here 8 m in all."""
    path = written(tmp_path, track(np.arange(0.0, 60.0, 0.2)))
    found = read_acquisition(image(tmp_path, "a.jpg", 12.0), positions=path)
    assert np.linalg.norm(found.sources[0].sigma[0]) == pytest.approx(SPEED / np.sqrt(3.0), rel=0.02)
    assert any("whole seconds: positions are uncertain by the way in a second (8.0 m)" in one for one in found.assumed)


def test_images_outside_a_trajectory_or_in_a_gap_are_left_out(tmp_path: pathlib.Path) -> None:
    time = np.arange(0.0, 60.0, 0.2)
    path = written(tmp_path, track(time[(time < 20.0) | (time > 25.0)]))
    (tmp_path / "images").mkdir()
    for name, after in (("a.jpg", 7.31), ("gap.jpg", 22.0), ("late.jpg", 70.5)):
        image(tmp_path / "images", name, after)
    found = read_acquisition(tmp_path / "images", positions=path)
    assert found.names.tolist() == ["a.jpg"]
    assert any(
        "2 of 3 images are not in flight.pos and are left out: gap.jpg, late.jpg" in one for one in found.assumed
    )


def test_solutions_that_are_not_fixed_are_told(tmp_path: pathlib.Path) -> None:
    path = written(tmp_path, track(np.arange(0.0, 10.0, 0.2), quality=2))
    found = read_acquisition(image(tmp_path, "a.jpg", 7.31), positions=path)
    assert "Images at solutions that are not fixed: float (Q 2)." in found.assumed
    images = tmp_path / "images"
    images.mkdir()
    for name, after in (("a.jpg", 3.31), ("b.jpg", 4.31), ("c.jpg", 7.31)):
        image(images, name, after)
    found = read_acquisition(images, positions=path)
    assert "Images at solutions that are not fixed: 3 float (Q 2)." in found.assumed


@pytest.mark.parametrize("bad", [1, 2, 3])
def test_counts_of_a_folder_are_over_all_its_images(tmp_path: pathlib.Path, bad: int) -> None:
    """Images of a folder are read one by one: no sentence or fact counts one image as all."""
    images = tmp_path / "images"
    images.mkdir()
    for k in range(3):
        image(images, f"{'abc'[k]}.jpg", 2.31 + 3.0 * k)
    fixed, single = track(np.arange(0.0, 12.0, 0.2)), track(np.arange(0.0, 12.0, 0.2), quality=5)
    split = len(HEADER.splitlines()) + round((2.31 + 3.0 * bad - 1.5) / 0.2)  # between two images
    path = written(tmp_path, "\n".join([*single.splitlines()[:split], *fixed.splitlines()[split:], ""]))
    found = read_acquisitions(images, positions=path)
    (said,) = (one for one in found.assumed if "not fixed" in one)
    assert said == "Images at solutions that are not fixed: single (Q 5)." + (
        "" if bad == 3 else f" ({bad} of 3 files)"
    )
    (part,) = found.parts
    assert part.facts["positions"] == "RTKLIB solutions, by time"
    assert not any("1 of 1" in one for one in (*part.assumed, *part.facts.values()))


def test_times_and_errors_of_a_public_file(tmp_path: pathlib.Path) -> None:
    """Week 2436 and 204589 s are 2026-09-15 08:49:49 in GPS time, as its header says."""
    path = written(tmp_path, SAMPLE)
    assert form_of(path).name == "file of positions"
    table: Any = read_positions(path, height_datum=None, crs=None)
    utc = datetime.datetime(2026, 9, 15, 8, 49, 49, tzinfo=datetime.UTC).timestamp() - LEAP
    np.testing.assert_allclose(table.time, [utc, utc + 12.0], atol=1e-6)
    np.testing.assert_allclose(table.sigma, [[0.9212, 0.8230, 2.5620], [0.0034, 0.0031, 0.0099]])
    np.testing.assert_allclose(np.rad2deg(table.position.lat), [44.470303520, 44.470302864], atol=1e-12)


@pytest.mark.parametrize(
    "header, cells, utc",
    [
        ("%  GPST", "2013/01/15 01:02:03.250", "2013-01-15T01:01:47.250"),  # 16 leap seconds in 2013
        ("%  UTC", "2023/06/15 01:02:03.250", "2023-06-15T01:02:03.250"),
        ("%  JST", "2023/06/15 01:02:03.250", "2023-06-14T16:02:03.250"),
    ],
)
def test_time_scales(tmp_path: pathlib.Path, header: str, cells: str, utc: str) -> None:
    text = HEADER.replace("%  GPST", header) + f"{cells} 44.5 90.25 600.0 1 9 0.01 0.01 0.02\n"
    table = read_positions(written(tmp_path, text), height_datum=None, crs=None)
    assert table.time is not None
    assert table.time[0] == pytest.approx(np.datetime64(utc, "ms").astype(float) / 1e3, abs=1e-6)


def test_degrees_minutes_seconds_and_commas(tmp_path: pathlib.Path) -> None:
    text = HEADER.replace("latitude(deg) longitude(deg)", "latitude(d'\")   longitude(d'\")")
    text += "2023/06/15 01:02:03.000, 36 18 03.6,-84 12 36.0, 600.0, 1, 9, 0.01, 0.02, 0.03, 0, 0, 0, 0.0, 5.0\n"
    table = read_positions(written(tmp_path, text), height_datum=None, crs=None)
    at = table.position
    np.testing.assert_allclose(np.rad2deg([at.lat[0], at.lon[0]]), [36.301, -84.21], atol=1e-12)


def test_geodetic_heights_need_their_datum(tmp_path: pathlib.Path) -> None:
    path = written(tmp_path, SAMPLE.replace("WGS84/ellipsoidal", "WGS84/geodetic"))
    with pytest.raises(UnstatedDatum, match="its heights are geodetic"):
        read_positions(path, height_datum=None, crs=None)
    table = read_positions(path, height_datum=-40.0, crs=None)
    np.testing.assert_allclose(table.position.height, [573.3524, 575.8615], atol=1e-9)


UNSOLVED = SAMPLE.replace("   1  19 ", "   0  19 ").replace("   2  21 ", "   0  21 ")
REFUSED = {
    "baseline": (SAMPLE.replace("latitude(deg) longitude(deg)  height(m)", "e-baseline(m) n-baseline(m)"), {},
                 "its positions are e-baseline; set the solution format"),
    "cut": (SAMPLE + "2436 204613.000   44.47030", {}, "row 8: expected time, position"),
    "no number": (SAMPLE.replace("615.8615", "615,86x5"), {}, "row 7: expected time, position"),
    "latitude": (SAMPLE.replace("44.470302864", "144.470302864"), {}, "row 7: latitude 144.47.*are no position"),
    "order": (SAMPLE + SAMPLE.splitlines()[5] + "\n", {}, "row 8: its time is not after the one above"),
    "week": (SAMPLE.replace("2436 204601.000", "2436 904601.000"), {}, "no date and time, nor GPS week"),
    "date": (SAMPLE.replace("2436 204601.000", "2026/13/15 08:50:01.000"), {}, "is no date and time"),
    "quality": (SAMPLE.replace("   1  19 ", "  77  19 "), {}, "77 is no quality"),
    "sigma": (SAMPLE.replace("0.0034", "-0.0034"), {}, "a standard deviation is negative"),
    "empty": (HEADER, {}, "there are no solutions below the header"),
    "datum": (SAMPLE, {"height_datum": "EPSG:5773"}, "heights are above the ellipsoid; leave height_datum="),
    "crs": (SAMPLE, {"crs": "EPSG:32616"}, "leave crs= out"),
    "no solution": (UNSOLVED, {}, "no epoch has a solution"),
    "another day": (track(np.arange(0.0, 5.0, 0.2)), {}, "a.jpg was not taken within it: it is from 2023-06-15T10:00"),
    "other events": (SAMPLE.replace(".000 ", ".123 "), {}, "a.jpg was taken at none of its times, 2026-09-15T08:49"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_files_that_do_not_fit_are_refused_in_a_line(tmp_path: pathlib.Path, case: str) -> None:
    text, how, words = REFUSED[case]
    path = written(tmp_path, text)
    with pytest.raises(TableError, match=words) as refusal:
        read_acquisition(image(tmp_path, "a.jpg", 900.31), positions=path, **({"height_datum": None} | how))
    assert "\n" not in str(refusal.value)


def test_times_that_are_not_utc_are_refused(tmp_path: pathlib.Path) -> None:
    path = written(tmp_path, track(np.arange(0.0, 10.0, 0.2)))
    found = dataclasses.replace(read_acquisition(image(tmp_path, "a.jpg", 5.1), height_datum=0.0), time_is_utc=False)
    with pytest.raises(TableError, match=r"joined by time, but the times of .* are not in UTC"):
        with_positions(found, path)


def test_solutions_on_the_command_line(tmp_path: pathlib.Path) -> None:
    path = written(tmp_path, track(np.arange(0.0, 60.0, 0.2)))
    shown = CliRunner().invoke(app, ["inspect", str(image(tmp_path, "a.jpg", 7.31)), "--positions", str(path)])
    assert shown.exit_code == 0, shown.output
    assert "RTKLIB solutions, by time" in shown.output
    alone = CliRunner().invoke(app, ["inspect", str(path)])
    assert alone.exit_code != 0
    assert "give the images, with this file as --positions" in " ".join(alone.output.split())
