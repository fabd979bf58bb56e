"""Planned exposures: a table that reads back as the flight it was made of."""

from __future__ import annotations

import csv
import pathlib
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Deflection, Geodetic, Pose, Shot, Status
from jaxgeo.io import read_navigation, write_exposures

COUNT = 5
NAMES = ("outer", "inner")
POSITION = Geodetic(
    lat=np.deg2rad(47.0 + 1e-3 * np.arange(COUNT)), lon=np.deg2rad(np.full(COUNT, 11.1)), height=np.full(COUNT, 3000.25)
)
POSE = Pose(POSITION, np.deg2rad(np.linspace(-2.0, 2.0, COUNT)), np.deg2rad(np.linspace(0.5, 1.0, COUNT)), 0.01)
SHOTS = Shot(POSE, np.deg2rad(np.linspace(-60.0, 60.0, 2 * COUNT)).reshape(COUNT, 2), 100.0 + 0.8 * np.arange(COUNT))
OVERLAPS = SimpleNamespace(
    near=np.array([0.6, 0.61, np.nan, -0.1]),
    far=np.full(COUNT - 1, 0.7),
    status=np.array([Status.hit, Status.hit, Status.rises_away, Status.hit], np.int8),
)


def read(path: pathlib.Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_the_flight_comes_back(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "plan.csv"
    write_exposures(path, SHOTS, NAMES, overlaps=OVERLAPS)
    (datum,) = {row["height_datum"] for row in read(path)}
    back = read_navigation(path, NAMES, height_datum=datum)
    np.testing.assert_allclose(back.times, SHOTS.time, atol=1e-9, rtol=0)  # s
    np.testing.assert_allclose(back.gimbal_readings, SHOTS.gimbal_readings, atol=2e-10, rtol=0)  # rad
    np.testing.assert_allclose(back.poses.position.lat, POSITION.lat, atol=2e-12, rtol=0)
    np.testing.assert_allclose(back.poses.position.height, POSITION.height, atol=1e-4, rtol=0)  # m
    np.testing.assert_allclose(np.sin(back.poses.heading), np.sin(POSE.heading), atol=2e-10, rtol=0)
    np.testing.assert_allclose(back.poses.roll, 0.01, atol=2e-10, rtol=0)


def test_columns_and_what_the_first_shares_with_nothing(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "plan.csv"
    write_exposures(path, SHOTS, NAMES, overlaps=OVERLAPS)
    rows = read(path)
    assert ",".join(rows[0]) == (
        "exposure,time_s,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,gimbal_outer_deg,gimbal_inner_deg,"
        "overlap_near,overlap_far,status,height_datum"
    )
    assert [row["exposure"] for row in rows] == list("01234")
    assert [row["overlap_near"] for row in rows] == ["", "0.600000", "0.610000", "", "-0.100000"]
    assert [row["status"] for row in rows] == ["", "hit", "hit", "rises_away", "hit"]
    assert rows[0]["heading_deg"] == "358.00000000"
    write_exposures(path, SHOTS, NAMES)
    assert "status" not in read(path)[0]


def test_an_attitude_against_the_plumb_line_is_written_about_the_normal(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "plan.csv"
    bent = Deflection(np.full(COUNT, 5e-5), np.full(COUNT, -3e-5))
    shots = eqx.tree_at(lambda s: s.pose.deflection, SHOTS, bent, is_leaf=lambda x: x is None)
    write_exposures(path, shots, NAMES)
    (datum,) = {row["height_datum"] for row in read(path)}
    back = read_navigation(path, NAMES, height_datum=datum)
    whole = jax.tree.map(lambda x: jnp.broadcast_to(x, (COUNT,)), shots.pose)
    expected, found = (jax.vmap(lambda pose: pose.R_ned_from_body)(pose) for pose in (whole, back.poses))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_shot_outside_the_flight_has_empty_cells(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "plan.csv"
    write_exposures(path, jax.tree.map(lambda x: np.asarray(x) * np.nan, SHOTS), NAMES)
    assert all(value == "" for name, value in read(path)[0].items() if name not in ("exposure", "height_datum"))


@pytest.mark.parametrize(
    "change, error, message",
    [
        ({"path": "plan.txt"}, ValueError, r"name a file that ends in \.csv"),
        ({"path": "nowhere/plan.csv"}, ValueError, "there is no folder"),
        ({"readings": ("outer",)}, ValueError, r"readings of outer.*shape \(5, 2\)"),
        ({"shots": Shot(Pose(POSITION), np.zeros(2), 0.0)}, ValueError, r"times of shape \(\)"),
        ({"overlaps": SimpleNamespace(near=0.5, far=0.5, status=np.int8(0))}, ValueError, "must have 4 entries"),
    ],
)
def test_wrong_requests_leave_no_file(tmp_path, change: dict, error: type, message: str) -> None:
    given = {"path": "plan.csv", "shots": SHOTS, "readings": NAMES, **change}
    given["path"] = tmp_path / given["path"]
    with pytest.raises(error, match=message):
        write_exposures(**given)
    assert list(tmp_path.iterdir()) == []
