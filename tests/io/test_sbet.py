"""SBET files: a made flight comes back as it was flown, errors between their records, and wrong files are named.

Held against: `2-points.sbet` of PDAL's public tests, two records of a real POSPac trajectory, with the numbers that its
`SbetReaderTest` expects; the layout of SBET records as Applanix publishes it (17 float64: time, latitude, longitude,
altitude, x, y, z velocity, roll, pitch, platform heading, wander angle, accelerations, rates); and for the horizontal
axes of the wander frame the reader of SNV and SBET files by J. Skaloud (EPFL, 2001), whose formula is written out in
`test_velocities_by_the_formula_of_others`. Files of errors (smrmsg) against the layout of PDAL's `readers.smrmsg`.
"""

from __future__ import annotations

import pathlib
from typing import Any

import jax
import numpy as np
import pytest

from jaxgeo import WGS84
from jaxgeo.earth import R_ecef_from_ned
from jaxgeo.io import TableError, undulation
from jaxgeo.io.acquisitions.sbet import SbetRecords, read_sbet

RATE, COUNT, START = 50.0, 151, 345_600.0
SPEED, CLIMB, COURSE, DRIFT = 60.0, 2.5, np.deg2rad(205.0), np.deg2rad(-4.0)
WANDER = np.deg2rad(37.0)


def flight(wander: float = WANDER, start: float = START) -> np.ndarray:
    """A climb straight on: the nose is off the course by the drift, and the platform's frame turned to the left."""
    times = START + np.arange(COUNT) / RATE
    north, east = SPEED * np.cos(COURSE), SPEED * np.sin(COURSE)
    lat, height = np.deg2rad(51.0) * np.ones(COUNT), 1200.0 + CLIMB * (times - START)
    for k in range(1, COUNT):
        lat[k] = lat[k - 1] + north / RATE / (_radii(lat[k - 1])[0] + height[k - 1])
    rate = east / ((_radii(lat)[1] + height) * np.cos(lat))
    lon = np.deg2rad(7.0) + np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) / RATE])
    x, y = _turned(north, east, wander)
    records = np.zeros((COUNT, 17))
    records[:, :4] = np.stack([times + start - START, lat, lon, height], axis=-1)
    records[:, 4:7] = x, -y, CLIMB
    records[:, 7:11] = np.deg2rad(1.5), np.deg2rad(3.0), COURSE + DRIFT + wander, wander
    records[:, 11:] = np.random.default_rng(1).normal(0.0, 0.1, (COUNT, 6))
    return records


def _radii(lat: Any) -> tuple[Any, Any]:
    w2 = 1.0 - WGS84.e2 * np.sin(lat) ** 2
    return WGS84.a * (1.0 - WGS84.e2) / w2**1.5, WGS84.a / np.sqrt(w2)


def _turned(north: float, east: float, wander: float) -> tuple[float, float]:
    """Components along axes that lie the wander angle left of north and east."""
    return north * np.cos(wander) - east * np.sin(wander), north * np.sin(wander) + east * np.cos(wander)


def errors(every: float = 1.0, first: float = START, count: int = 5) -> np.ndarray:
    records = np.ones((count, 10))
    records[:, 0] = first + every * np.arange(count)
    records[:, 1:4] = np.arange(count)[:, None] * 0.01 + [0.02, 0.03, 0.05]
    records[:, 7:10] = np.arange(count)[:, None] * 0.1 + [0.5, 0.6, 1.2]
    return records


@pytest.fixture
def file(tmp_path: pathlib.Path):
    def write(records: np.ndarray, name: str = "flight.sbet", order: str = "<") -> pathlib.Path:
        path = tmp_path / name
        records.astype(f"{order}f8").tofile(path)
        return path

    return write


@pytest.mark.parametrize("wander", [WANDER, 0.0, -2.9, 5.0])
def test_heading_and_velocity_are_of_true_north(file, wander: float) -> None:
    found = read_sbet(file(flight(wander)))
    assert len(found) == COUNT
    assert found.velocity_ned is not None
    course = np.arctan2(found.velocity_ned[:, 1], found.velocity_ned[:, 0])
    np.testing.assert_allclose(np.exp(1j * course), np.exp(1j * COURSE), atol=1e-12)
    np.testing.assert_allclose(np.exp(1j * found.poses.heading), np.exp(1j * (COURSE + DRIFT)), atol=1e-12)
    np.testing.assert_allclose(found.velocity_ned[:, 2], -CLIMB, atol=0)
    assert np.all(np.abs(found.poses.heading) <= np.pi)
    assert any("does not name its datum" in sentence for sentence in found.assumed)


def test_velocities_are_those_of_the_positions_in_ecef(file) -> None:
    found = read_sbet(file(flight()))
    assert found.velocity_ned is not None
    here = jax.jit(jax.vmap(lambda p: (WGS84.to_ecef(p), R_ecef_from_ned(p))))
    ecef, R = (np.asarray(x) for x in here(found.poses.position))
    moved = (ecef[2:] - ecef[:-2]) * RATE / 2.0
    expected = np.einsum("nij,nj->ni", R[1:-1], found.velocity_ned[1:-1])
    np.testing.assert_allclose(moved, expected, atol=2e-3)  # m/s


def test_a_trajectory_passes_its_knots(file) -> None:
    records = read_sbet(file(flight()), every=0.1)
    assert records.number.tolist() == list(range(0, COUNT, 5))
    trajectory = records.trajectory()
    shots = jax.jit(jax.vmap(trajectory.at))(records.times)
    for ours, theirs in zip(jax.tree.leaves(shots.pose), jax.tree.leaves(records.poses), strict=True):
        np.testing.assert_allclose(np.exp(1j * ours), np.exp(1j * theirs), atol=1e-8)  # the heights, in m, too
    whole = read_sbet(file(flight()))
    middle = whole.times[5:-5] + 0.3 / RATE
    heights = np.asarray(jax.jit(jax.vmap(lambda t: trajectory.at(t).pose.position.height))(middle))
    np.testing.assert_allclose(heights, 1200.0 + CLIMB * (middle - START), atol=2e-3)  # m
    assert np.asarray(trajectory.velocity_ned).shape == (31, 3)


def test_a_part_reaches_to_the_records_about_it(file) -> None:
    found = read_sbet(file(flight()), between=(START + 1.005, START + 1.995))
    assert (found.number[0], found.number[-1]) == (50, 100)
    thin = read_sbet(file(flight()), between=(START + 1.005, START + 1.995), every=0.3)
    np.testing.assert_allclose(thin.times - START, [1.0, 1.3, 1.6, 1.9, 2.0], atol=1e-9)
    assert thin.facts["read"].startswith("5 records")
    with pytest.raises(TableError, match=r"covers 345600 to 345603 s, but between=345602 to 345604 s"):
        read_sbet(file(flight()), between=(START + 2.0, START + 4.0))
    with pytest.raises(ValueError, match="between must be first and last"):
        read_sbet(file(flight()), between=(START + 2.0, START + 1.0))
    with pytest.raises(ValueError, match="every must be above 0 s"):
        read_sbet(file(flight()), every=0.0)


def test_an_acquisition_of_records(file) -> None:
    path, smrmsg = file(flight()), file(errors(), "smrmsg.out")
    found = read_sbet(path, errors=smrmsg, between=(START + 0.98, START + 1.02)).acquisition()
    assert found.names.tolist() == ["49", "50", "51"]
    assert found.sensor is None
    assert not found.time_is_utc
    assert len(found) == 3
    _, shot, (position, attitude) = found.exposure(1)
    assert float(shot.time) == START + 1.0
    np.testing.assert_allclose(position.sigma, [0.03, 0.04, 0.06], atol=1e-12)  # m
    np.testing.assert_allclose(np.rad2deg(attitude.sigma) * 60.0, [1.3, 0.7, 0.6], atol=1e-9)  # heading, pitch, roll
    assert read_sbet(path).acquisition().sources == ()


def test_errors_between_their_records(file) -> None:
    path, smrmsg = file(flight()), file(errors(), "smrmsg.out")
    found = read_sbet(path, errors=smrmsg)
    position, attitude = found.sources_at([START + 0.25, START + 2.5])
    np.testing.assert_allclose(position.sigma, [[0.0225, 0.0325, 0.0525], [0.045, 0.055, 0.075]], atol=1e-12)
    np.testing.assert_allclose(np.rad2deg(attitude.sigma[:, 0]) * 60.0, [1.225, 1.45], atol=1e-9)
    for time in (START - 0.1, np.nan):
        with pytest.raises(ValueError, match=r"s is outside its records, 345600 to 345603 s"):
            found.sources_at(time)
    with pytest.raises(ValueError, match="read without errors="):
        read_sbet(path).sources_at(START)
    late = read_sbet(path, errors=file(errors(first=START + 0.4), "late.out"))  # as a rate of 1 Hz begins later
    assert late.position_sigma is not None
    np.testing.assert_allclose(late.position_sigma[:20], [[0.02, 0.03, 0.05]] * 20, atol=1e-12)


def test_a_clock_in_utc(file) -> None:
    zero = 315_964_800.0 + 2000 * 604_800.0 - 18.0
    found = read_sbet(file(flight()), errors=file(errors(), "smrmsg.out"), clock_zero=zero)
    assert found.acquisition().time_is_utc
    np.testing.assert_allclose(found.times - zero - START, np.arange(COUNT) / RATE, atol=1e-6)  # s
    position, _ = found.sources_at(zero + START + 1.0)
    np.testing.assert_allclose(position.sigma, [[0.03, 0.04, 0.06]], atol=1e-7)


def test_a_new_week_and_the_date_line(file) -> None:
    records = flight(start=604_799.0)
    records[:, 0] %= 604_800.0
    records[:, 2] += np.pi - records[70, 2]
    wrapped = records.copy()
    wrapped[wrapped[:, 2] > np.pi, 2] -= 2.0 * np.pi
    beyond, found = (read_sbet(file(one)) for one in (records, wrapped))
    np.testing.assert_allclose(found.times, 604_799.0 + np.arange(COUNT) / RATE, atol=1e-6)
    assert any("counts on beyond 604800 s" in sentence for sentence in found.assumed)
    for one in (beyond, found):
        assert np.ptp(one.poses.position.lon) > 6.0
        assert np.all(np.abs(one.poses.position.lon) <= np.pi)
    np.testing.assert_allclose(beyond.poses.position.lon, found.poses.position.lon, atol=1e-14)
    ends = jax.jit(jax.vmap(WGS84.to_ecef))(found.trajectory().poses.position)
    assert np.linalg.norm(np.diff(np.asarray(ends), axis=0), axis=1).max() < 1.3  # m in 0.02 s, across the date line


def test_heights_above_the_sea(file) -> None:
    found = read_sbet(file(flight()), height_datum="EPSG:5773")
    expected = 1200.0 + float(undulation(51.0, 7.0))
    assert float(found.poses.position.height[0]) == pytest.approx(expected, abs=1e-3)


def test_velocities_that_are_unknown_or_left_out(file) -> None:
    records = flight()
    records[:, 4:7] = 0.0
    found = read_sbet(file(records))
    assert found.velocity_ned is None
    assert any("zero throughout though the positions move" in sentence for sentence in found.assumed)
    found = read_sbet(file(with_other_z()), velocities=False)
    assert found.velocity_ned is None
    assert np.asarray(found.trajectory().velocity_ned_at(START + 1.5))[2] == pytest.approx(-CLIMB, abs=1e-3)
    still = records.copy()
    still[:, 1:4] = still[0, 1:4]
    standing = read_sbet(file(still)).velocity_ned
    assert standing is not None
    assert not np.any(standing)


def with_other_z() -> np.ndarray:
    records = flight()
    records[:, 6] *= -1.0
    return records


def with_right_and_down() -> np.ndarray:
    records = flight()
    records[:, 5:7] *= -1.0
    return records


def other_velocities(wander: float) -> np.ndarray:
    records = flight()
    x, y = _turned(SPEED * np.cos(COURSE), SPEED * np.sin(COURSE), wander)
    records[:, 4:6] = x, -y
    return records


def along_north_east_down() -> np.ndarray:
    records = flight()
    records[:, 4:7] = SPEED * np.cos(COURSE), SPEED * np.sin(COURSE), -CLIMB
    return records


def test_the_axes_that_fit_the_positions_are_taken(file) -> None:
    """Those of Applanix, or y to the right and z down if only they fit; which, is said."""
    applanix, other = (read_sbet(file(records)) for records in (flight(), with_right_and_down()))
    assert applanix.velocity_ned is not None
    assert other.velocity_ned is not None
    np.testing.assert_array_equal(applanix.velocity_ned, other.velocity_ned)
    assert "y west and z up" in applanix.facts["velocities"]
    assert not any("Velocities" in sentence for sentence in applanix.assumed)
    assert "y east and z down" in other.facts["velocities"]
    assert any("Velocities are taken along x north, y east and z down" in sentence for sentence in other.assumed)


def test_velocities_by_the_formula_of_others(file) -> None:
    """North and east of Skaloud's reader: vn = x cos w - y sin w, ve = -x sin w - y cos w."""
    records = flight()
    x, y, w = records[:, 4], records[:, 5], records[:, 10]
    found = read_sbet(file(records)).velocity_ned
    assert found is not None
    expected = np.stack([x * np.cos(w) - y * np.sin(w), -x * np.sin(w) - y * np.cos(w)], axis=-1)
    np.testing.assert_allclose(found[:, :2], expected, atol=1e-12)  # m/s


# The first record of PDAL's `2-points.sbet`, as its `SbetReaderTest` has it, to the digits printed there.
OF_PDAL = (1.516310028360710e05, 5.680211852972264e-01, -2.041654392303940e00, 1.077152953296560e02)


def test_a_real_trajectory(jaxgeo_test_data: pathlib.Path) -> None:
    """Velocities against the change of the positions by PROJ, the heading against the course."""
    pyproj = pytest.importorskip("pyproj")
    path = jaxgeo_test_data / "field" / "tab" / "2-points.sbet"
    if not path.exists():
        pytest.skip(f"no such data: {path}")
    found = read_sbet(path)
    position = found.poses.position
    first = (found.times[0], position.lat[0], position.lon[0], position.height[0])
    np.testing.assert_allclose(first, OF_PDAL, rtol=1e-14)
    assert found.velocity_ned is not None
    lon, lat, height = np.rad2deg(position.lon), np.rad2deg(position.lat), position.height
    topocentric = f"+proj=topocentric +lon_0={lon[0]:.15g} +lat_0={lat[0]:.15g} +h_0={height[0]:.15g} +ellps=WGS84"
    moved = pyproj.Transformer.from_pipeline(f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=cart +ellps=WGS84 +step {topocentric}").transform(lon[1], lat[1], height[1])  # fmt: skip
    by_positions = np.array([moved[1], moved[0], -moved[2]]) / np.diff(found.times)
    np.testing.assert_allclose(found.velocity_ned.mean(axis=0), by_positions, atol=0.03)  # m/s
    np.testing.assert_allclose(found.velocity_ned.mean(axis=0), [-2.341, 0.282, 0.031], atol=1.5e-3)
    course = np.arctan2(found.velocity_ned[0, 1], found.velocity_ned[0, 0])
    assert abs(np.rad2deg(course - found.poses.heading[0])) < 5.0


def changed(row: int, column: int | slice, value: float) -> np.ndarray:
    records = flight()
    records[row, column] = value
    return records


def in_degrees() -> np.ndarray:
    records = flight()
    records[:, [1, 2, 7, 8, 9, 10]] *= 180.0 / np.pi
    return records


REFUSED: dict[str, tuple[Any, str]] = {
    "degrees": (in_degrees, r"record 0: latitude 51 and longitude 7 look like degrees; angles of an SBET are in rad"),
    "z down": (
        with_other_z,
        r"differ by 5 m/s .* at 60.1 m/s \(medians\). They fit if taken as x north, y west and z d",
    ),
    "north and east": (along_north_east_down, "taken as north, east and down, not turned by the wander angle"),
    "other way": (lambda: other_velocities(-WANDER), "turned by the wander angle the other way"),
    "no frame": (lambda: other_velocities(1.0), r"of the positions, at 60.1 m/s \(medians\). Export the file"),
    "latitude": (lambda: changed(7, 1, 1.6), r"record 7: lat is 1.6, outside \[-1.5708, 1.5708\] rad"),
    "nan": (lambda: changed(9, 7, np.nan), "record 9: roll is nan, outside"),
    "nowhere": (lambda: changed(9, slice(1, 17), 0.0), "record 9: latitude and longitude are zero"),
    "never written": (lambda: np.zeros((1, 17)), "record 0: latitude and longitude are zero"),
    "speed": (lambda: changed(9, 4, 3e4), "record 9: velocity_x is 30000, outside"),
    "backwards": (lambda: flight()[::-1], "records 0 and 1: time running backwards, from 345603 s to 345602.98 s"),
    "twice": (lambda: flight()[[0, 1, 1, 2]], "records 1 and 2: time stands still"),
    "no time": (lambda: changed(3, 0, np.inf), "record 3: time is inf s"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_files(file, case: str) -> None:
    records, words = REFUSED[case]
    with pytest.raises(TableError, match=f"flight.sbet.*{words}"):
        read_sbet(file(records()))


def test_files_of_another_kind(file, tmp_path: pathlib.Path) -> None:
    path = file(flight())
    with pytest.raises(TableError, match=r"numbers are big-endian, .* write them anew: numpy.fromfile"):
        read_sbet(file(flight(), order=">"))
    path.write_bytes(flight().astype("<f8").tobytes()[:-56])
    with pytest.raises(TableError, match=r"20480 bytes are 150 records of SBET \(136 bytes each\) and 80 bytes more"):
        read_sbet(path)
    path.write_bytes(b"")
    with pytest.raises(TableError, match="the file is empty"):
        read_sbet(path)
    with pytest.raises(TableError, match="is it a file of its errors, smrmsg"):
        read_sbet(file(errors(), "smrmsg.out"))
    with pytest.raises(FileNotFoundError, match="there is no such SBET file"):
        read_sbet(tmp_path / "nowhere.sbet")
    with pytest.raises(TableError, match="this is a folder; give the SBET file in it"):
        read_sbet(tmp_path)


def test_errors_that_do_not_serve(file) -> None:
    def refused(records: np.ndarray, words: str) -> None:
        with pytest.raises(TableError, match=words):
            read_sbet(file(flight()), errors=file(records, "smrmsg.out"))

    refused(errors(count=2), r"smrmsg.out: it covers 345600 to 345601 s, but the records of .* 345600 to 345603 s")
    refused(errors(first=START + 10.0), "Do the two files belong together")
    refused(flight(), r"cut off|is it an SBET file|expected a standard deviation")
    zero = errors()
    zero[2, 8] = 0.0
    refused(zero, "record 2: the error of pitch is 0 arc minutes; expected a standard deviation above 0")
    holes = errors(every=0.01, count=301)[np.r_[:100, 200:301]]
    refused(holes, r"records 99 and 100: nothing from 345600.99 to 345602 s; .* with between=")
    refused(errors()[::-1], "time running backwards")


def test_gaps_and_turns_are_told_by_record(file) -> None:
    records = flight()[np.r_[:60, 100:151]]
    with pytest.raises(TableError, match=r"flight.sbet: there is a gap of 0.82 s before record 60 .*allow the gap"):
        read_sbet(file(records)).trajectory()
    assert isinstance(read_sbet(file(records)), SbetRecords)
    read_sbet(file(records)).trajectory(longest_gap=1.0)
    with pytest.raises(TableError, match="one record only; a trajectory needs two"):
        read_sbet(file(flight()[:1])).trajectory()
