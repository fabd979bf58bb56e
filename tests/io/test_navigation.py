"""Navigation records: what the file says is what the trajectory does, and what it cannot mean is refused in words.

The format is our own, CSV, described in `docs/howto/navigation.md`; its layouts are those of `test_table_layouts`. Held
against: rows written by hand, and what NumPy makes of them.
"""

from __future__ import annotations

import pathlib

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Geodetic, Pose, Trajectory
from jaxgeo.io import TableError, VerticalDatumError, read_navigation, undulation
from jaxgeo.rotations import R_from_heading_pitch_roll

COUNT = 12
TIMES = 1000.0 + 0.1 * np.arange(COUNT)
COLUMNS = {
    "record": np.arange(COUNT),
    "time_s": TIMES,
    "lat_deg": 36.3 + 1e-5 * np.arange(COUNT),
    "lon_deg": -84.1 + 1e-5 * np.arange(COUNT),
    "height_m": 5500.0 + 0.1 * np.arange(COUNT),
    "heading_deg": np.linspace(-1.0, 1.2, COUNT) % 360.0,  # through north
    "pitch_deg": np.linspace(1.0, 0.5, COUNT),
    "roll_deg": np.linspace(-0.5, 0.5, COUNT),
    "gimbal_outer_deg": np.linspace(60.0, 62.0, COUNT),
    "gimbal_inner_deg": np.linspace(179.0, 181.2, COUNT),
}
COLUMNS["gimbal_inner_deg"] = (COLUMNS["gimbal_inner_deg"] + 180.0) % 360.0 - 180.0  # wraps
VELOCITY = {"velocity_north_mps": 11.1, "velocity_east_mps": 8.9, "velocity_down_mps": -1.0}
READINGS = ("outer", "inner")


def text(columns: dict) -> str:
    cells = [np.broadcast_to(np.asarray(column), (COUNT,)) for column in columns.values()]
    lines = [",".join(str(cell) for cell in row) for row in zip(*cells, strict=True)]
    return "\n".join([",".join(columns), *lines]) + "\n"


@pytest.fixture
def flight(tmp_path: pathlib.Path):
    """Writes a file of records and returns its path: columns changed, left out (None), or a whole text."""

    def write(content: str | None = None, **change) -> pathlib.Path:
        columns = {name: column for name, column in {**COLUMNS, **change}.items() if column is not None}
        path = tmp_path / "flight.csv"
        path.write_text(text(columns) if content is None else content, encoding="utf-8")
        return path

    return write


def at(name: str, index: int, value: float | str) -> dict:
    """A column with one cell changed."""
    cells = np.asarray(COLUMNS[name]).astype(object)
    cells[index] = value
    return {name: cells}


def test_knots_are_the_records(flight) -> None:
    trajectory = read_navigation(flight(), READINGS, height_datum="ellipsoid")
    np.testing.assert_array_equal(trajectory.times, TIMES)
    poses = trajectory.poses
    np.testing.assert_allclose(poses.position.to_degrees()[0], COLUMNS["lat_deg"], atol=1e-13, rtol=0)  # deg
    np.testing.assert_allclose(poses.position.to_degrees()[1], COLUMNS["lon_deg"], atol=1e-13, rtol=0)
    np.testing.assert_array_equal(poses.position.height, COLUMNS["height_m"])
    for name in ("heading", "pitch", "roll"):
        np.testing.assert_allclose(np.rad2deg(getattr(poses, name)), COLUMNS[f"{name}_deg"], atol=1e-12, rtol=0)
    outer, inner = np.rad2deg(np.asarray(trajectory.gimbal_readings)).T
    np.testing.assert_allclose(outer, COLUMNS["gimbal_outer_deg"], atol=1e-12, rtol=0)
    np.testing.assert_allclose(inner, np.linspace(179.0, 181.2, COUNT), atol=1e-12, rtol=0)  # unwrapped
    assert trajectory.velocity_ned is None


def test_a_heading_passes_through_north_the_short_way(flight) -> None:
    trajectory = read_navigation(flight(), READINGS, height_datum="ellipsoid")
    middle = trajectory.at(float(TIMES[COUNT // 2 - 1] + 0.05)).pose  # halfway between records 5 and 6
    expected = R_from_heading_pitch_roll(*jnp.deg2rad(jnp.array([0.1, 0.75, 0.0])))
    np.testing.assert_allclose(middle.R_ned_from_body, expected, atol=1e-6)


def test_velocities_are_taken_where_the_file_has_them(flight) -> None:
    trajectory = read_navigation(flight(**VELOCITY), READINGS, height_datum="ellipsoid")
    assert trajectory.velocity_ned is not None
    np.testing.assert_array_equal(trajectory.velocity_ned, np.broadcast_to([11.1, 8.9, -1.0], (COUNT, 3)))
    np.testing.assert_allclose(trajectory.velocity_ned_at(float(TIMES[3])), [11.1, 8.9, -1.0], atol=1e-9)


def test_heights_are_made_ellipsoidal(flight) -> None:
    trajectory = read_navigation(flight(), READINGS, height_datum="EPSG:5773")
    geoid = undulation(COLUMNS["lat_deg"], COLUMNS["lon_deg"])
    np.testing.assert_allclose(trajectory.poses.position.height, COLUMNS["height_m"] + geoid, atol=1e-3)  # m
    trajectory = read_navigation(flight(), READINGS, height_datum=-30.0)
    np.testing.assert_allclose(trajectory.poses.position.height, COLUMNS["height_m"] - 30.0, atol=1e-9)


def test_readings_may_be_given_instead(flight) -> None:
    path = flight(gimbal_outer_deg=None, gimbal_inner_deg=None)
    held = read_navigation(path, READINGS, height_datum="ellipsoid", gimbal_readings=[0.1, 0.2])
    np.testing.assert_array_equal(held.gimbal_readings, np.broadcast_to([0.1, 0.2], (COUNT, 2)))
    moving = np.linspace(0.0, 1.0, 2 * COUNT).reshape(COUNT, 2)
    given = read_navigation(path, height_datum="ellipsoid", gimbal_readings=moving)
    np.testing.assert_array_equal(given.gimbal_readings, moving)
    assert read_navigation(path, height_datum="ellipsoid").gimbal_readings.shape == (COUNT, 0)


def test_the_file_and_the_records_make_one_trajectory(flight) -> None:
    from_file = read_navigation(flight(), READINGS, height_datum="ellipsoid")
    c = COLUMNS
    position = Geodetic.from_degrees(lat=c["lat_deg"], lon=c["lon_deg"], height=c["height_m"])
    angles = [np.deg2rad(c[f"{name}_deg"]) for name in ("heading", "pitch", "roll")]
    readings = np.unwrap(np.deg2rad(np.stack([c[f"gimbal_{name}_deg"] for name in READINGS], axis=-1)), axis=0)
    by_hand = Trajectory.from_knots(TIMES, Pose(position, *angles), readings)
    for time in (1000.0, 1000.03, 1000.77):
        one, other = from_file.at(time), by_hand.at(time)
        np.testing.assert_allclose(one.pose.R_ned_from_body, other.pose.R_ned_from_body, atol=1e-12)
        np.testing.assert_allclose(one.pose.position.height, other.pose.position.height, atol=1e-6)  # m
        np.testing.assert_allclose(one.gimbal_readings, other.gimbal_readings, atol=1e-12)


BACKWARDS = TIMES - np.where(np.arange(COUNT) > 4, 0.25, 0.0)
TWICE = np.where(np.arange(COUNT) == 5, TIMES[4], TIMES)
GAP = TIMES + np.where(np.arange(COUNT) > 6, 5.0, 0.0)
NEW_WEEK = (604_799.5 + 0.1 * np.arange(COUNT)) % 604_800.0
WRONG_RECORDS = [
    ({"roll_deg": None}, ["no column roll_deg", "The columns needed are time_s, lat_deg"]),
    ({"roll_deg": None, "Roll_deg": 0.0}, ["no column roll_deg", "Did you mean roll_deg by 'Roll_deg'?"]),
    ({"gimbal_outer_deg": None, "gimbal_inner_deg": None}, ["no column gimbal_outer_deg, gimbal_inner_deg", "in rad"]),
    ({"gimbal_inner_deg": None}, ["no column gimbal_inner_deg", "gimbal_readings="]),
    ({"velocity_north_mps": 1.0, "velocity_east_mps": 1.0}, ["no column velocity_down_mps", "all three", "climb"]),
    (at("lat_deg", 3, "36.3.1"), ["flight.csv, row 5, column lat_deg", "'36.3.1' is not a number", "deg"]),
    (at("lat_deg", 3, "136.3"), ["row 5, column lat_deg", "136.3 is outside [-90, 90] deg"]),
    (at("pitch_deg", 0, "nan"), ["row 2, column pitch_deg", "unknown (nan)"]),
    (at("height_m", 0, "inf"), ["row 2, column height_m", "'inf' is not a number; expected m"]),
    (at("time_s", 2, ""), ["row 4, column time_s", "unknown (empty); expected s."]),
    ({"time_s": BACKWARDS}, ["rows 6 and 7, column time_s", "time running backwards, from 1000.4 s to 1000.25 s"]),
    ({"time_s": TWICE}, ["rows 6 and 7, column time_s", "time stands still"]),
    ({"time_s": NEW_WEEK}, ["time running backwards", "GPS week", "604800"]),
    ({"time_s": GAP}, ["flight.csv: there is a gap of 5.1 s before row 9", "allow the gap"]),
    ({"heading_deg": np.where(np.arange(COUNT) > 4, 150.0, 0.0)}, ["turns by 150", "up to row 7", "which way"]),
]


@pytest.mark.parametrize("change, words", WRONG_RECORDS, ids=[words[0][:40] for _, words in WRONG_RECORDS])
def test_wrong_records(flight, change: dict, words: list[str]) -> None:
    with pytest.raises(TableError) as refusal:
        read_navigation(flight(**change), READINGS, height_datum="ellipsoid")
    assert str(refusal.value).startswith(str(flight()))
    assert "knot" not in str(refusal.value)
    assert "in rad?" not in str(refusal.value)
    for word in words:
        assert word in str(refusal.value)


def test_too_few_records(flight) -> None:
    lines = text(COLUMNS).splitlines()
    for count, words in ((0, "no rows below the header"), (1, "one record only")):
        with pytest.raises(TableError, match=words):
            read_navigation(flight("\n".join(lines[: 1 + count])), READINGS, height_datum="ellipsoid")


def test_blank_lines_do_not_shift_the_rows_named(flight) -> None:
    lines = text({**COLUMNS, "time_s": BACKWARDS}).splitlines()
    with pytest.raises(TableError, match="rows 8 and 9, column time_s"):
        read_navigation(flight("\n".join([lines[0], "", *lines[1:3], "", *lines[3:]])), READINGS, height_datum=0.0)


def test_a_gap_may_be_allowed(flight) -> None:
    trajectory = read_navigation(flight(time_s=GAP), READINGS, height_datum="ellipsoid", longest_gap=6.0)
    assert float(trajectory.end) == pytest.approx(1006.1)


def test_what_the_caller_gives_wrong(flight) -> None:
    with pytest.raises(VerticalDatumError, match=r"flight\.csv: height_datum='EPSG:0' is unknown to PROJ"):
        read_navigation(flight(), READINGS, height_datum="EPSG:0")
    with pytest.raises(TableError, match="column gimbal_outer_deg, and gimbal_readings= are given too"):
        read_navigation(flight(), READINGS, height_datum="ellipsoid", gimbal_readings=[0.0, 0.0])
    path = flight(gimbal_outer_deg=None, gimbal_inner_deg=None)
    for given in ([0.0], np.zeros((3, 2)), 0.0):
        with pytest.raises(ValueError, match=r"gimbal_readings must have the shape \(2,\) or \(12, 2\), in rad"):
            read_navigation(path, READINGS, height_datum="ellipsoid", gimbal_readings=given)
    with pytest.raises(FileNotFoundError, match="there is no such file of navigation records"):
        read_navigation(path.with_name("nowhere.csv"), height_datum="ellipsoid")
    with pytest.raises(TypeError, match="height_datum"):
        read_navigation(path)  # pyright: ignore[reportCallIssue]
