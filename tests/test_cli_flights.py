"""Flights of `jaxgeo plan` from the exposures of a file, and images of such exposures on level ground."""

from __future__ import annotations

import json
import pathlib

import numpy as np
import pytest
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.cli._common import UserError
from jaxgeo.cli._flights import flight_of
from jaxgeo.io import read_navigation, read_observations
from tests.io.test_flight_log_programs import litchi

SCALE = 400.0 * 2.41e-6 / 8.8e-3  # m of ground at 500 m in a pixel, seen from 900 m
CAMERA = "focal=8.8mm,pitch=2.41um,size=5472x3648"
NO_GROUND = "give the ground: --dem FILE, an elevation model; --dem copernicus"
SECONDS = ("31.000", "32.000", "33.500")


def log(
    folder: pathlib.Path, seconds: tuple[str, ...] = SECONDS, yaws: tuple[int, ...] = (3590, 5, 15)
) -> pathlib.Path:
    path = folder / "flight.csv"
    rows = [
        {"latitude": str(36.3 + 1e-4 * k), "datetime(utc)": f"2021-05-04 10:20:{second}", "gimbalYawRaw": str(yaw),
         "gimbalPitchRaw": "-900", "gimbalRollRaw": "0"}
        for k, (second, yaw) in enumerate(zip(seconds, yaws, strict=True))
    ]  # fmt: skip
    path.write_text(litchi(*rows), encoding="utf-8")
    return path


def test_exposures_of_a_file_are_the_flight_of_their_navigation(tmp_path: pathlib.Path) -> None:
    found = flight_of(read_observations(log(tmp_path), takeoff_height=600.0, camera=CAMERA))
    assert (float(found.trajectory.start), found.started) == (0.0, 1_620_123_631.0)  # 2021-05-04 10:20:31 UTC
    records = tmp_path / "records.csv"
    records.write_text(
        "time_s,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg\n"
        + "".join(f"{at},{36.3 + 1e-4 * k},-84.2,900,{yaw},0,0\n"
                  for k, (at, yaw) in enumerate(((0.0, 359.0), (1.0, 0.5), (2.5, 1.5)))),
        encoding="utf-8",
    )  # fmt: skip
    expected = read_navigation(records, height_datum="ellipsoid")
    ours, theirs = found.trajectory.at(0.7).pose, expected.at(0.7).pose
    np.testing.assert_allclose(ours.position.lat, theirs.position.lat, atol=1e-12)
    np.testing.assert_allclose(np.sin(ours.heading - theirs.heading), 0.0, atol=1e-12)
    assert found.sensor.camera.width == 5472  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    "seconds, yaws, words",
    [
        (("31.000", "31.000", "31.000"), (0, 0, 0), "fewer than two exposures at different times"),
        (("x", "x", "x"), (0, 0, 0), "its exposures have no times"),
        (("31.000", "32.000", "33.000"), (0, 1700, 0), "exposures? [01] to [12]|exposure 1"),
    ],
    ids=["one time", "no times", "turn"],
)
def test_what_is_no_flight_is_refused(
    tmp_path: pathlib.Path, seconds: tuple[str, ...], yaws: tuple[int, ...], words: str
) -> None:
    observed = read_observations(log(tmp_path, seconds, yaws), takeoff_height=600.0, camera=CAMERA)
    with pytest.raises(UserError, match=words) as refusal:
        flight_of(observed)
    assert "\n" not in str(refusal.value)


def test_a_gap_is_refused_with_what_can_be_done_on_the_command_line(tmp_path: pathlib.Path) -> None:
    seconds = tuple(f"{at:06.3f}" for at in (1.0, 2.0, 3.0, 50.0))
    observed = read_observations(log(tmp_path, seconds, (0, 0, 0, 0)), takeoff_height=600.0, camera=CAMERA)
    with pytest.raises(UserError, match=r"a gap of 47 s .*the longest allowed is 10 s .*each as a file") as refusal:
        flight_of(observed)
    assert "longest_gap" not in str(refusal.value)


@pytest.mark.costly
def test_a_footprint_on_level_ground_is_the_image_enlarged(tmp_path: pathlib.Path) -> None:
    """Straight down the scale is the height above the ground over the focal length."""
    line = ["footprint", str(log(tmp_path, ("31.000",), (0,))), "--takeoff-height", "600", "--camera", CAMERA]
    output = tmp_path / "footprints.geojson"
    result = CliRunner().invoke(app, [*line, "--ground", "500", "--json", "-o", str(output), "--style"])
    assert result.exit_code == 0, result.output
    assert "SimpleFill" in output.with_suffix(".qml").read_text(encoding="utf-8")
    (found,) = json.loads(result.stdout)["footprints"]
    assert found["area_km2"] == pytest.approx(
        1e-6 * 5472 * 3648 * SCALE**2, rel=3e-4
    )  # the area is that on the ellipsoid, below
    assert found["columns_m"] == pytest.approx(SCALE, rel=1e-4)
    for wrong, words in (
        ([], NO_GROUND),
        (["--ground", "1", "--dem", "dem.tif"], "--dem and --ground exclude each other: give one of them."),
        (["--ground", "1", "--style"], "--style needs --output FILE"),
        (["--ground", "reported"], "--ground 'reported': expected a height in m"),
        (["--ground", "1", "--nodata", "0"], "--nodata"),
    ):
        refused = CliRunner().invoke(app, [*line, *wrong])
        assert refused.exit_code == 2
        assert words in refused.stderr


@pytest.mark.slow
def test_overlap_on_level_ground_is_by_the_length_of_the_image(tmp_path: pathlib.Path) -> None:
    """Straight down over level ground, images of one flight share all but the way between them."""
    even = str(log(tmp_path, ("31.000", "32.000", "33.000"), (0, 0, 0)))
    line = [even, "--takeoff-height", "600", "--camera", CAMERA, "--ground", "500"]
    away = 1e-4 * 111_000.0  # m from an exposure to the next, within 0.1 %
    result = CliRunner().invoke(app, ["overlap", *line, "--json"])
    assert result.exit_code == 0, result.output
    for pair in json.loads(result.stdout)["pairs"]:
        assert pair["near"] == pytest.approx(1.0 - away / (3648 * SCALE), abs=1e-4)
    refused = CliRunner().invoke(app, ["overlap", *line[:-2]])
    assert refused.exit_code == 2
    assert NO_GROUND in refused.stderr


@pytest.mark.slow
def test_exposures_on_level_ground_are_planned_by_the_length_of_the_image(tmp_path: pathlib.Path) -> None:
    """Straight down over level ground, each image of a plan is as much of its length farther as it shares less."""
    even = str(log(tmp_path, ("31.000", "32.000", "33.000"), (0, 0, 0)))
    line = [even, "--takeoff-height", "600", "--camera", CAMERA, "--ground", "500"]
    away = 1e-4 * 111_000.0  # m/s, within 0.1 %
    output = tmp_path / "plan.csv"
    result = CliRunner().invoke(app, ["plan", *line, "--overlap", "0.99", "--json", "-o", str(output)])
    assert result.exit_code == 0, result.output
    planned = json.loads(result.stdout)["exposures"]
    assert len(planned) >= 3
    assert planned[1]["time_s"] - planned[0]["time_s"] == pytest.approx(0.01 * 3648 * SCALE / away, rel=2e-3)
    refused = CliRunner().invoke(app, ["plan", *line[:-2], "--overlap", "0.99", "-o", str(output)])
    assert refused.exit_code == 2
    assert NO_GROUND in refused.stderr
