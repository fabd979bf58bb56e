"""Columns of tables that nothing reads are named in one sentence, with the name that a misspelt one may mean."""

from __future__ import annotations

import pathlib

import pytest
from support.command_files import prepare
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.io import read_check_points, read_orientations
from jaxgeo.io._unread_columns import unread_columns
from jaxgeo.io.acquisitions._position_tables import read_positions

KNOWN = {"time_s", "lat_deg", "lon_deg", "height_m"}


@pytest.mark.parametrize(
    "header, said",
    [
        (["time_s", "lat_deg"], []),
        (["lat_deg", "tiem_s"], ["Columns that are not read: tiem_s (meant as time_s?)."]),
        (["lat_deg", "time"], ["Columns that are not read: time (meant as time_s?)."]),
        (["time_s", "time"], ["Columns that are not read: time."]),
        (["lat_deg", "", "colour"], ["Columns that are not read: colour."]),
        (list("abcdefgh"), ["Columns that are not read: a, b, c, d, e, f and 2 more."]),
    ],
)
def test_the_sentence(header: list[str], said: list[str]) -> None:
    assert unread_columns(header, KNOWN) == said


def unread(notes) -> list[str]:
    return [one for one in notes if "not read" in one]


def test_of_orientations_and_positions(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("Image,Latitude,lon,alt,yaw,pitch,roll,time\na,36.3,-84.1,3500,0,0,0,7\n")
    said = ["Columns that are not read: time (meant as time_s?)."]
    assert unread(read_orientations(path, height_datum="ellipsoid").assumed) == said
    assert unread(read_positions(path, height_datum="ellipsoid", crs=None).assumed) == said
    path.write_text(path.read_text().replace(",time\n", ",time_s\n"))
    found = read_orientations(path, height_datum="ellipsoid")
    assert not unread(found.assumed)
    assert found.time is not None


def test_of_check_points(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("image,point,u,v,lat_deg,lon_deg,height_m,flights\na,P1,1,2,36.3,-84.1,300,1\n")
    found = read_check_points(path, height_datum="ellipsoid")
    assert found.unread == ("Columns that are not read: flights (meant as flight?).",)
    assert found.flight is None


def test_of_navigation_records_on_the_command_line(tmp_path: pathlib.Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path, "flight.csv scene.toml dem.tif")
    text = pathlib.Path("flight.csv").read_text().splitlines()
    rows = [f"{text[0]},velocity_north", *(f"{row},1.0" for row in text[1:])]
    pathlib.Path("flight.csv").write_text("\n".join(rows) + "\n")
    line = "overlap --scene scene.toml --dem dem.tif --navigation flight.csv --times 1,2"  # not within the flight
    told = CliRunner().invoke(app, line.split())
    assert told.exit_code == 2
    assert (
        "jaxgeo: flight.csv: Columns that are not read: velocity_north (meant as velocity_north_mps?)." in told.stderr
    )


@pytest.mark.costly
def test_of_points_to_validate(tmp_path: pathlib.Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path, "images points.csv dem.tif")
    path = pathlib.Path("points.csv")
    path.write_text(path.read_text().replace("height_m", "height_m,sigma_est_m", 1).replace("\n", ",1\n").replace(
        "sigma_est_m,1", "sigma_est_m", 1))  # fmt: skip
    line = "validate images --points points.csv --points-datum ellipsoid --camera-datum ellipsoid --dem dem.tif"
    told = CliRunner().invoke(app, line.split())
    assert told.exit_code == 0, told.output
    assert "jaxgeo: points.csv: Columns that are not read: sigma_est_m (meant as sigma_east_m?)." in told.stderr
