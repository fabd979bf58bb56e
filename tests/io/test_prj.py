"""CRS of tables from `.prj` files: beside them, and by name on the command line; the one stated goes first."""

from __future__ import annotations

import json
import pathlib
import shlex

import jax
import numpy as np
import pyproj
import pytest
from support.command_files import prepare
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.io import read_orientations
from jaxgeo.io.acquisitions._position_tables import read_positions
from jaxgeo.io.errors import TableError

TABLE = "image,x,y,z,omega,phi,kappa\na,759900.0,4023100.0,3500.0,1.0,-2.0,30.0\n"
PLACES = "image,x,y,z\na,759900.0,4023100.0,3500.0\n"
ESRI = pyproj.CRS("EPSG:32616").to_wkt("WKT1_ESRI")
SAID = "Coordinates are in WGS 84 / UTM zone 16N (EPSG:32616), by opk.prj beside the file."


@pytest.fixture
def table(tmp_path: pathlib.Path) -> pathlib.Path:
    path = tmp_path / "opk.csv"
    path.write_text(TABLE)
    return path


def same(one, other) -> None:
    for a, b in zip(jax.tree.leaves(one.pose), jax.tree.leaves(other.pose), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


@pytest.mark.parametrize("ending", [".prj", ".PRJ"])
def test_a_prj_beside_a_table_is_its_crs(table: pathlib.Path, ending: str) -> None:
    stated = read_orientations(table, height_datum="ellipsoid", crs="EPSG:32616")
    table.with_suffix(ending).write_text(ESRI)
    found = read_orientations(table, height_datum="ellipsoid")
    same(found, stated)
    assert [one for one in found.assumed if ".prj" in one.lower()] == [SAID.replace(".prj", ending)]


def test_a_map_without_a_name_is_told_by_its_projection(table: pathlib.Path) -> None:
    table.with_suffix(".prj").write_text(pyproj.CRS("+proj=tmerc +lon_0=-84 +datum=WGS84").to_wkt("WKT1_ESRI"))
    (said,) = [one for one in read_orientations(table, height_datum="ellipsoid").assumed if ".prj" in one]
    assert said == (
        "Coordinates are in a map without a name (Transverse Mercator, longitude of natural origin -84 deg, "
        "WGS 84), by opk.prj beside the file."
    )


def test_a_stated_crs_goes_first(table: pathlib.Path) -> None:
    """That of the caller, without a word of the file beside."""
    table.with_suffix(".prj").write_text(pyproj.CRS("EPSG:32617").to_wkt())
    found = read_orientations(table, height_datum="ellipsoid", crs="EPSG:32616")
    assert not any(".prj" in one for one in found.assumed)
    assert np.rad2deg(found.pose.position.lon[0]) < -83.0


def test_a_table_of_latitudes_has_no_map(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "lla.csv"
    path.write_text("image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg\na,36.3,-84.1,3500,0,0,0\n")
    path.with_suffix(".prj").write_text(ESRI)
    found = read_orientations(path, height_datum="ellipsoid")
    assert not any(".prj" in one for one in found.assumed)


def test_positions_beside_images_have_one_too(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "opk.csv"
    path.write_text(PLACES)
    path.with_suffix(".prj").write_text(ESRI)
    found = read_positions(path, height_datum="ellipsoid", crs=None)
    assert np.rad2deg(found.position.lon[0]) == pytest.approx(-84.1, abs=0.1)
    assert SAID in found.assumed


def test_text_that_is_no_crs_is_refused(table: pathlib.Path) -> None:
    table.with_suffix(".prj").write_text("nonsense")
    with pytest.raises(TableError, match=r"opk\.prj: PROJ does not know this CRS, 'nonsense': state the CRS itself"):
        read_orientations(table, height_datum="ellipsoid")


def test_without_it_the_message_names_the_file_that_would_do(table: pathlib.Path) -> None:
    with pytest.raises(TableError, match=r'such as crs="EPSG:32616" .*, or put its opk\.prj beside it\.'):
        read_orientations(table, height_datum="ellipsoid")


def run(line: str):
    return CliRunner().invoke(app, shlex.split(line))


def test_the_command_line_takes_a_prj_and_says_which(tmp_path: pathlib.Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path, "opk.csv")
    pathlib.Path("map.prj").write_text(ESRI)
    line = "inspect opk.csv --camera-datum ellipsoid --json"
    stated, named = (run(f"{line} --source-crs {crs}") for crs in ("EPSG:32616", "map.prj"))
    assert stated.exit_code == named.exit_code == 0, named.output
    (one, other) = (json.loads(told.stdout)["parts"] for told in (stated, named))
    assert one == other
    assert "jaxgeo: --source-crs map.prj: WGS 84 / UTM zone 16N (EPSG:32616)." in named.stderr
    pathlib.Path("opk.prj").write_text(ESRI)
    beside = run(line)
    assert json.loads(beside.stdout)["parts"] == one
    assert SAID in json.loads(beside.stdout)["assumed"]


@pytest.mark.parametrize(
    "name, words",
    [("nowhere.prj", "--source-crs nowhere.prj: there is no such file."), ("bad.prj", "bad.prj: PROJ does not know")],
)
def test_a_wrong_prj_is_told_in_a_line(tmp_path: pathlib.Path, monkeypatch, name: str, words: str) -> None:
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path, "opk.csv")
    pathlib.Path("bad.prj").write_text("nonsense")
    result = run(f"inspect opk.csv --camera-datum ellipsoid --source-crs {name}")
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert words in line
