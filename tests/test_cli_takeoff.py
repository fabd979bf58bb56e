"""`--takeoff-height dem`: heights above the take-off on the elevation model under the first exposure."""

from __future__ import annotations

import json
import pathlib
import re
from typing import Any

import pytest
import typer
from support.command_files import LAT, LON, prepare
from support.command_runner import CliRunner
from test_cli_flights import CAMERA, log

import jaxgeo
from jaxgeo.cli import app

IMAGE = "DJI_0042.JPG --takeoff-height dem --dem dem.tif"
LOG = f"flight.csv --takeoff-height dem --dem dem.tif --camera {CAMERA}"
LINES = {
    "locate": f"{IMAGE} --pixel 1,2",
    "report": f"{IMAGE} --pixel 1,2 -o out.html",
    "view": f"{IMAGE} --no-browser",
    "footprint": IMAGE,
    "point": f"{IMAGE} --target 36.27,-84.268",
    "overlap": LOG,
    "plan": f"{LOG} --overlap 0.5 -o out.csv",
    "accuracy-map": f"{IMAGE} --resolution 100 -o out.tif",
    "rectify": f"{IMAGE} -o out.tif",
    "adjust": "images --takeoff-height dem --dem dem.tif -o out",
    "register": f"{IMAGE} --reference ortho.tif --position-sigma 20 --attitude-sigma 0.3 -o out",
    "validate": "images --takeoff-height dem --dem dem.tif --points points.csv --points-datum ellipsoid",
}


class Reached(ValueError):
    """The elevation model was read for the take-off."""


def run(line: str) -> Any:
    return CliRunner().invoke(app, line.split(), prog_name="jaxgeo")


def with_both() -> set[str]:
    """Commands that take heights above a take-off, and an elevation model."""
    group: Any = typer.main.get_command(app)
    found = set()
    for name, command in group.commands.items():
        options = {option for param in command.params for option in param.opts}
        if {"--takeoff-height", "--dem"} <= options:
            found.add(name)
    return found


@pytest.fixture
def here(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def height_at(lat: float, lon: float) -> float:
    place = jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
    return float(jaxgeo.io.example_dem().height_at(place))


def test_the_take_off_is_on_the_ground_under_the_image(here: pathlib.Path) -> None:
    """As if its height were typed; and it is printed."""
    prepare(here, f"locate {IMAGE}")
    height = height_at(LAT, LON)
    line = f"locate {IMAGE} --no-accuracy --json"
    found, typed = run(line), run(line.replace("--takeoff-height dem", f"--takeoff-height {height:.3f}"))
    assert found.exit_code == 0, found.output
    assert f"The take-off is at {height:.2f} m above the ellipsoid, as the ground under DJI_0042.JPG." in found.stderr
    fixes = [json.loads(one.stdout)["fixes"] for one in (found, typed)]
    assert fixes[0] == fixes[1]
    assert any("take-off" in one for one in json.loads(found.stdout)["assumed"])


def test_of_a_flight_it_is_the_earliest_exposure(here: pathlib.Path) -> None:
    """Whatever the order of the rows."""
    prepare(here, "locate --dem dem.tif")
    path = log(here, ("33.500", "31.000", "32.000"), (15, 3590, 5))
    lat, lon = 36.3 + 1e-4, float(re.search(r"-84\.\d+", path.read_text())[0])  # type: ignore[index]
    found = run(f"footprint {LOG} --json")
    assert f"The take-off is at {height_at(lat, lon):.2f} m above the ellipsoid" in found.stderr


@pytest.mark.parametrize("name", sorted(LINES))
def test_every_command_has_it(name: str, here: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(LINES) == with_both() - {"dem"}

    def read(*_: Any) -> None:
        raise Reached("reached")

    line = f"{name} {LINES[name]}"
    prepare(here, line)
    if LOG in line:
        log(here)
    monkeypatch.setattr("jaxgeo.cli._takeoff.read_terrain", read)
    result = run(line)
    assert result.exit_code == 2, result.output
    assert "reached" in result.stderr


@pytest.mark.parametrize(
    "line, words",
    [
        ("locate DJI_0042.JPG --takeoff-height dem --ground 300", "under the first exposure; give --dem."),
        (f"locate {IMAGE} --camera-datum ellipsoid", "above the ellipsoid already; leave --camera-datum out."),
        (
            f"locate {IMAGE.replace('height dem', 'height low')}",
            "--takeoff-height 'low': expected a height in m",
        ),
        (
            "inspect DJI_0042.JPG --takeoff-height dem",
            "is for commands with --dem; give the height of the take-off",
        ),
        ("scene DJI_0042.JPG --takeoff-height dem -o s.toml", "is for commands with --dem; give the height"),
        (f"footprint {LOG} --dem-bounds -84.4,36.35,-84.3,36.4", "no height under the first exposure, flight.csv"),
    ],
)
def test_where_there_is_no_ground_it_is_refused(line: str, words: str, here: pathlib.Path) -> None:
    prepare(here, line)
    if LOG in line:
        log(here)
    result = run(line)
    assert result.exit_code == 2, result.output
    assert words in " ".join(result.stderr.split())
