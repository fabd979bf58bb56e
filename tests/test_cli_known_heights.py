"""What heights are above: `--takeoff-height dem`, on the elevation model, and datums that nobody states."""

from __future__ import annotations

import json
import pathlib
import re
from typing import Any

import numpy as np
import pytest
import rasterio
from support.command_files import DJI, LAT, LON, prepare
from support.command_runner import CliRunner
from support.drone_image_files import FULL, packet, write_image
from test_cli_dem import commands_with
from test_cli_flights import CAMERA, log

import jaxgeo
from jaxgeo.cli import app
from jaxgeo.cli._acquisitions import KnownHeights, ReadingOptions
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._known_heights import with_known_heights
from jaxgeo.cli._options import DemOptions
from jaxgeo.cli._takeoff_sigma import FirstExposure, TakeoffSigma, doubt_of, takeoff_sigma
from jaxgeo.uncertainty import sources

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
    "inspect": IMAGE,
    "scene": f"{IMAGE} -o s.toml",
    "validate": "images --takeoff-height dem --dem dem.tif --points points.csv --points-datum ellipsoid",
}


class Reached(UserError):
    """The elevation model was read for the take-off."""


def run(line: str) -> Any:
    return CliRunner().invoke(app, line.split(), prog_name="jaxgeo")


@pytest.fixture
def here(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def height_at(lat: float, lon: float) -> float:
    place = jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
    return float(jaxgeo.io.example_dem().height_at(place))


@pytest.mark.costly
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


@pytest.mark.parametrize("times", [None, ["1"], ["0.5", "2"]])
def test_of_a_flight_it_is_the_earliest_exposure(
    times: list[str] | None, here: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the order of the rows, and whichever moments are asked for."""
    prepare(here, "locate --dem dem.tif")
    path = log(here, ("33.500", "31.000", "32.000"), (15, 3590, 5))
    given = ReadingOptions(takeoff_height="dem", camera=CAMERA, times=times)
    found = with_known_heights(given, [path], None, ["dem.tif"], DemOptions())
    lat, lon = 36.3 + 1e-4, float(re.search(r"-84\.\d+", path.read_text())[0])  # type: ignore[index]
    assert float(found.takeoff_height or "nan") == pytest.approx(height_at(lat, lon), abs=1e-3)
    assert f"as the ground under exposure 1 of {path}" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.costly if name == "register" else ()) for name in sorted(LINES)]
)
def test_every_command_has_it(name: str, here: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(LINES) == commands_with("--takeoff-height", "--dem")

    def read(*_: Any) -> None:
        raise Reached("reached")

    line = f"{name} {LINES[name]}"
    prepare(here, line)
    if LOG in line:
        log(here)
    monkeypatch.setattr("jaxgeo.cli._known_heights.read_terrain", read)
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
        ("inspect DJI_0042.JPG --takeoff-height dem", "under the first exposure; give --dem."),
        ("scene DJI_0042.JPG --takeoff-height dem -o s.toml", "under the first exposure; give --dem."),
        ("inspect DJI_0042.JPG --dem dem.tif", "--dem is for --takeoff-height dem here; give that too"),
        ("inspect DJI_0042.JPG --nodata 0", "--nodata needs --dem FILE."),
        ("scene DJI_0042.JPG --dem-datum 0 -o s.toml", "--dem-datum 0 applies to --dem; leave it out."),
        (
            f"footprint {LOG} --dem-bounds -84.4,36.35,-84.3,36.4",
            "no height under the first exposure, exposure 0 of flight.csv",
        ),
    ],
)
def test_where_there_is_no_ground_it_is_refused(line: str, words: str, here: pathlib.Path) -> None:
    prepare(here, line)
    if LOG in line:
        log(here)
    result = run(line)
    assert result.exit_code == 2, result.output
    assert words in " ".join(result.stderr.split())


@pytest.mark.costly
def test_datums_that_nobody_states_are_asked_for_at_once(here: pathlib.Path) -> None:
    """Of the images and of the elevation model; with both given, as the message says, there is a fix."""
    prepare(here, "locate DJI_0042.JPG --dem dem.tif")
    with rasterio.open("dem.tif") as file:
        profile, heights = file.profile | {"crs": "EPSG:4326"}, file.read()
    with rasterio.open("bare.tif", "w", **profile) as file:
        file.write(heights)
    line = "footprint DJI_0042.JPG --dem bare.tif"
    result = run(line)
    assert result.exit_code == 2, result.output
    for option in ("--camera-datum", "--dem-datum"):
        assert f"{option}:" in result.stderr
    one = run(f"{line} --camera-datum ellipsoid")
    assert "--dem-datum" in one.stderr
    assert "--camera-datum" not in one.stderr
    assert run(f"{line} --camera-datum ellipsoid --dem-datum EPSG:5773").exit_code == 0


@pytest.mark.costly
@pytest.mark.parametrize(
    "line, words",
    [
        (
            "locate DJI_0042.JPG --no-accuracy --takeoff-height 900 --ground 100",
            "take-off is 800 m above --ground 100",
        ),
        ("footprint DJI_0042.JPG --takeoff-height 900 --ground 100", "take-off is 800 m above --ground 100"),
        (
            "footprint DJI_0042.JPG --camera-datum ellipsoid --ground 100 --dem-datum EPSG:5773",
            "the wrong one, --takeoff-height 100 --camera-datum EPSG:5773 in place of --camera-datum ellipsoid",
        ),
        (
            "locate DJI_0042.JPG --no-accuracy --camera-datum ellipsoid --ground 100",
            "the wrong one, --takeoff-height 100 in place of --camera-datum ellipsoid",
        ),
        (
            "locate flight.klv --no-accuracy --ground 1000",
            "frame centre 7[0-9]+ m below --ground 1000",
        ),
        ("locate DJI_0042.JPG --no-accuracy --takeoff-height 0 --ground 0", ""),
        ("locate DJI_0042.JPG --no-accuracy --takeoff-height 0 --ground 0 --camera-datum ellipsoid", ""),
        ("locate DJI_0042.JPG --no-accuracy --takeoff-height 0 --dem dem.tif", "Give --takeoff-height dem, or its"),
        (
            "locate DJI_0042.JPG --no-accuracy --takeoff-height 0 --ground 0 --dem-datum EPSG:5773",
            "take-off is at 0 m above the ellipsoid.*Give its height as --takeoff-height",
        ),
        ("locate DJI_0042.JPG --no-accuracy --takeoff-height 5 --ground 0", ""),
        ("locate flight.klv --no-accuracy --ground reported", ""),
    ],
)
def test_level_ground_far_from_what_the_files_report_is_doubtful(line: str, words: str, here: pathlib.Path) -> None:
    prepare(here, line)
    told = [one for one in run(line).stderr.splitlines() if "jaxgeo: check: " in one]
    assert len(told) == bool(words)
    for one in told:
        assert re.search(words, one)
        for way in re.findall(r"Give (--ground \d+)", one):
            assert "check: " not in run(f"{line.partition(' --ground')[0]} {way}").stderr
        for way, left_out in re.findall(
            r"the wrong one, (--takeoff-height .*?) in place of (--camera-datum \S+)\.$", one
        ):
            assert "check: The take-off" not in run(line.replace(left_out, way)).stderr
        assert "Give" in one or "take-off" in words


@pytest.mark.parametrize("zero", ["0", "0.0", "-0"])
def test_a_scene_needs_the_height_of_the_take_off(here: pathlib.Path, zero: str) -> None:
    """It has heights above a datum only; every way that the message names gives one."""
    prepare(here, "locate DJI_0042.JPG")
    refused = run(f"scene DJI_0042.JPG --takeoff-height {zero} -o s.toml")
    assert refused.exit_code == 2, refused.output
    said = " ".join(refused.stderr.split())
    assert f"--takeoff-height {zero}: heights are then above the take-off" in said
    assert not (here / "s.toml").exists()
    prepare(here, "scene DJI_0042.JPG --dem dem.tif")
    for way in (f"{zero} --camera-datum ellipsoid", "12.5", "dem --dem dem.tif"):
        found = run(f"scene DJI_0042.JPG --takeoff-height {way} -o s.toml")
        assert found.exit_code == 0, found.output
        assert 'height_datum = "ellipsoid"' in (here / "s.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["plan", "register"])
def test_plans_and_registered_scenes_need_the_height_of_the_take_off(here: pathlib.Path, command: str) -> None:
    """They are refused before anything is planned or matched, and nothing is written."""
    line = f"{command} {LINES[command]}"
    prepare(here, line)
    if command == "plan":
        log(here, ("31.000", "33.000", "35.000"), (0, 1, 2))
    before = {*here.iterdir()}
    refused = run(line.replace("--takeoff-height dem", "--takeoff-height 0"))
    assert refused.exit_code == 2, refused.output
    assert "--takeoff-height 0: heights are then above the take-off" in " ".join(refused.stderr.split())
    assert {*here.iterdir()} == before


def test_a_take_off_on_the_elevation_model_at_sea_level_has_a_known_height() -> None:
    assert ReadingOptions(takeoff_height="0").is_above_takeoff
    assert not KnownHeights(takeoff_height="0.000", takeoff_sigma=1.0).is_above_takeoff


def test_tables_name_heights_above_the_take_off_and_their_readers_refuse_them(here: pathlib.Path) -> None:
    """As exposures, as orientations and as shots of a scene; with the height of the take-off added they are read."""
    prepare(here, "locate DJI_0042.JPG")
    assert run("inspect DJI_0042.JPG --takeoff-height 0 -o shots.csv").exit_code == 0
    (row,) = json.loads(run("inspect DJI_0042.JPG --takeoff-height 0 --json").stdout)["exposures"]
    (known,) = json.loads(run("inspect DJI_0042.JPG --takeoff-height 250 --json").stdout)["exposures"]
    assert "height_m" not in row
    assert known["height_m"] - row["height_above_takeoff_m"] == pytest.approx(250.0)
    assert run("scene DJI_0042.JPG --takeoff-height 250 -o s.toml").exit_code == 0
    text = (here / "shots.csv").read_text(encoding="utf-8")
    for line in (
        "locate --scene s.toml --shots shots.csv --ground 0",
        "inspect shots.csv",
        "locate shots.csv --ground 0",
    ):
        refused = run(line)
        assert refused.exit_code == 2, refused.output
        said = " ".join(refused.stderr.split())
        assert "Its heights are in height_above_takeoff_m, above no datum: add the height of the take-off" in said
    header, cells = text.splitlines()
    columns = dict(zip(header.split(","), cells.split(","), strict=True))
    columns["height_m"] = f"{float(columns.pop('height_above_takeoff_m')) + 250.0}"
    (here / "shots.csv").write_text(f"{','.join(columns)}\n{','.join(columns.values())}\n", encoding="utf-8")
    shown = run("locate --scene s.toml --shots shots.csv --ground 0 --no-accuracy --json")
    direct = run("locate DJI_0042.JPG --takeoff-height 250 --ground 0 --no-accuracy --json")
    ours, theirs = (json.loads(one.stdout)["fixes"][0] for one in (shown, direct))
    for name in ("fix_lat_deg", "fix_lon_deg"):
        assert ours[name] == pytest.approx(theirs[name], abs=1e-8)  # deg: 1 mm


@pytest.mark.costly
def test_without_the_height_of_the_take_off_nothing_is_above_a_datum(here: pathlib.Path) -> None:
    """In JSON, on the terminal, through pipes, on pages and in footprints; with a datum for it all is as ever."""
    prepare(here, "locate DJI_0042.JPG")
    given = "DJI_0042.JPG --takeoff-height 0 --ground 2.5"
    found = run(f"locate {given} --no-accuracy --json")
    assert found.exit_code == 0, found.output
    assert "all heights are above the take-off, and above no datum" in " ".join(found.stderr.split())
    (row,) = json.loads(found.stdout)["fixes"]
    assert row["fix_height_above_takeoff_m"] == 2.5
    assert not {"fix_height_m", "fix_height_msl_m"} & set(row)
    shown = " ".join(run(f"locate {given} --no-accuracy").stdout.split())
    assert "height: m above the take-off" in shown
    assert not re.search("WGS 84|EGM96|msl", shown)
    (feature,) = json.loads(run(f"locate {given} --no-accuracy --format geojson").stdout)["features"]
    assert len(feature["geometry"]["coordinates"]) == 2
    header = run(f"locate {given} --no-accuracy --format csv").stdout.splitlines()[0].split(",")
    assert "fix_height_above_takeoff_m" in header
    assert not {"fix_height_m", "fix_height_msl_m"} & set(header)
    assert run(f"report {given} -o page.html").exit_code == 0
    page = (here / "page.html").read_text(encoding="utf-8")
    assert "2.50 m</b> above the take-off" in page
    assert not re.search("EGM96|height above WGS 84|[0-9] m above (the )?WGS 84", page)
    seen = run(f"footprint {given} --json")
    assert {*json.loads(seen.stdout)["footprints"][0]["outline"][0]} >= {"height_above_takeoff_m"}
    refused = run(f"footprint {given} -o f.geojson --crs EPSG:4979")
    assert refused.exit_code == 2
    assert "needs heights above a datum" in refused.stderr
    known = run(f"locate {given} --camera-datum ellipsoid --no-accuracy --json")
    (row,) = json.loads(known.stdout)["fixes"]
    assert row["fix_height_m"] == 2.5
    assert "no datum" not in known.stderr


def test_the_viewer_says_what_heights_are_above(here: pathlib.Path) -> None:
    from jaxgeo.view.data import _heights

    assert _heights({"fix_height_above_takeoff_m": 2.5}) == {"height_text": "2.50 m above the take-off"}
    known = _heights({"fix_height_m": 2.5, "fix_height_msl_m": -30.0})
    assert known["height_text"].endswith("above the WGS 84 ellipsoid")
    assert "EGM96" in known["msl_text"]


SLOPE_EAST, SLOPE_NORTH = 0.3, -0.4  # of the plane


class Plane:
    """Ground of a constant slope."""

    @staticmethod
    def normal_at(place: jaxgeo.Geodetic) -> np.ndarray:
        upward = np.array([-SLOPE_EAST, -SLOPE_NORTH, 1.0])
        return upward / np.linalg.norm(upward)

    @staticmethod
    def height_at(place: jaxgeo.Geodetic) -> float:
        return 400.0


def first(*given: Any, is_usual: bool = True) -> FirstExposure:
    return FirstExposure("a.jpg", LAT, LON, given, is_usual)


def test_the_take_off_is_as_sure_as_the_model_and_the_place_on_its_slope() -> None:
    """By NumPy, from the gradient of the plane and the covariance of the position."""
    position = sources.Position.from_ned(north=2.0, east=6.0, down=1.0)
    covariance, gradient = np.diag([2.0**2, 6.0**2]), np.array([SLOPE_NORTH, SLOPE_EAST])
    by_slope = float(np.sqrt(gradient @ covariance @ gradient))
    found = takeoff_sigma(Plane, first(position), Sigmas())
    assert found == pytest.approx((5.0, by_slope))
    assert found.total == pytest.approx(np.sqrt(25.0 + by_slope**2))
    stated = takeoff_sigma(Plane, first(position, sources.TerrainHeight.from_metres(2.5)), Sigmas())
    assert stated.of_model == pytest.approx(2.5)
    several = sources.TerrainField.of_variograms(gaussian=[(3.0, 100.0)], spherical=[(4.0, 500.0)])
    assert takeoff_sigma(Plane, first(position, several), Sigmas()).of_model == pytest.approx(5.0)
    typed = takeoff_sigma(Plane, first(position), Sigmas(dem=0.5, position="1"))
    assert typed == pytest.approx((0.5, np.hypot(SLOPE_NORTH, SLOPE_EAST)))


def test_a_stated_sigma_of_the_height_that_is_too_small_is_named() -> None:
    position = sources.Position.from_ned(north=2.0, east=6.0, down=1.0)
    sigma = TakeoffSigma(5.0, 2.0)
    assert doubt_of(sigma, first(position), Sigmas()) is None, "a default one gets the take-off's"
    for given, typed in ((first(position, is_usual=False), Sigmas()), (first(position), Sigmas(position="2,6,1"))):
        said = doubt_of(sigma, given, typed) or ""
        way = re.search(r"--position-sigma (\S+)$", said)
        assert way is not None
        assert doubt_of(sigma, given, Sigmas(position=way[1])) is None
        assert float(way[1].split(",")[2]) == pytest.approx(np.hypot(1.0, sigma.total), abs=0.1)
    assert doubt_of(sigma, first(position), Sigmas(position="9")) is None


@pytest.mark.costly
def test_the_accuracy_has_the_error_of_the_take_off(here: pathlib.Path) -> None:
    """The same figures as with the sigma of the height typed: root of the sum of squares with the default 5 m."""
    prepare(here, f"locate {IMAGE}")
    line = f"locate {IMAGE} --dem-sigma 4 --json"
    found = run(line)
    assert found.exit_code == 0, found.output
    said = re.search(
        r"Its sigma is ([0-9.]+) m: 4 m of the elevation model, ([0-9.]+) m", " ".join(found.stderr.split())
    )
    assert said is not None
    total, by_slope = float(said[1]), float(said[2])
    assert total == pytest.approx(np.hypot(4.0, by_slope), abs=0.01)
    dem, off = jaxgeo.io.example_dem(), 1e-6  # rad
    at = lambda lat, lon: float(dem.height_at(jaxgeo.Geodetic(lat=lat, lon=lon, height=0.0)))  # noqa: E731
    lat, lon = np.deg2rad([LAT, LON])
    per_north = (at(lat, lon) - at(lat - off, lon)) / (off * 6_371_000.0)
    per_east = (at(lat, lon) - at(lat, lon - off)) / (off * 6_371_000.0 * np.cos(lat))  # the place is between two cells
    assert by_slope == pytest.approx(3.0 * np.hypot(per_north, per_east), rel=0.02)
    down = np.hypot(5.0, np.hypot(4.0, 3.0 * np.hypot(per_north, per_east)))
    typed = run(f"{line} --position-sigma 3,3,{down:.6f}")
    without = run(f"locate DJI_0042.JPG --takeoff-height {height_at(LAT, LON):.3f} --dem dem.tif --dem-sigma 4 --json")
    radii = [json.loads(one.stdout)["fixes"][0]["ce90_m"] for one in (found, typed, without)]
    assert radii[0] == pytest.approx(radii[1], rel=5e-3)
    assert radii[0] > 1.05 * radii[2]


def test_a_sigma_of_no_take_off_is_refused(here: pathlib.Path) -> None:
    prepare(here, "locate DJI_0042.JPG")
    read = jaxgeo.io.read_acquisition
    assert read("DJI_0042.JPG", takeoff_height=300.0, takeoff_sigma=2.0).takeoff_sigma == 2.0
    found = jaxgeo.io.with_usual_errors(read("DJI_0042.JPG", takeoff_height=300.0, takeoff_sigma=12.0))
    assert any("3, 3, 13 m (N, E, D; default, with 12 m of the take-off)" in one for one in found.assumed)
    with pytest.raises(jaxgeo.io.TableError, match="takeoff_sigma= is that of takeoff_height="):
        read("DJI_0042.JPG", height_datum="ellipsoid", takeoff_sigma=2.0)
    for wrong in (-1.0, float("nan"), float("inf")):
        with pytest.raises(jaxgeo.io.TableError, match="takeoff_sigma= must be 0 m or more, and finite"):
            read("DJI_0042.JPG", takeoff_height=300.0, takeoff_sigma=wrong)


@pytest.mark.costly
@pytest.mark.parametrize(
    "ground, datum",
    [
        ("--dem dem.tif", "--camera-datum ellipsoid"),
        ("--dem dem.tif", "--takeoff-height 100"),
        ("--ground 320", "--camera-datum ellipsoid"),
        ("--ground 320 --dem-datum EPSG:5773", "--camera-datum ellipsoid"),
    ],
)
def test_a_wrong_altitude_of_an_image_is_replaced_as_printed(ground: str, datum: str, here: pathlib.Path) -> None:
    """The image is 99.9 m above the take-off, but by its altitude below the terrain."""
    prepare(here, "locate --dem dem.tif")
    write_image(here / "DJI_0042.JPG", packet(DJI | {"drone-dji:AbsoluteAltitude": "+200.0"}), make="DJI", size=FULL)
    line = f"locate DJI_0042.JPG --no-accuracy {ground} {datum}"
    refused = run(line)
    assert refused.exit_code == 1, refused.output
    said = re.search(
        r"m higher\. If the height of the camera is the wrong one \(99\.9 m above the take-off by the file\), "
        r"give (.*?) in place of (.*)\.$",
        " ".join(refused.stderr.split("jaxgeo: no pixel")[0].split()),
    )
    assert said is not None, refused.stderr
    assert said[2] == datum
    done = run(line.replace(datum, said[1]))
    assert done.exit_code == 0, done.output
    assert "1 hit" in " ".join(done.stderr.split())


@pytest.mark.costly
def test_a_wrong_height_of_a_scene_is_corrected_where_it_is(here: pathlib.Path) -> None:
    prepare(here, "locate --scene scene.toml --dem dem.tif shots.csv")
    scene, shots = here / "scene.toml", here / "shots.csv"
    scene.write_text(scene.read_text().replace("height_m = 5500.0", "height_m = 55.0"))
    line = "locate --scene scene.toml --dem dem.tif --no-accuracy"
    refused = " ".join(run(f"{line} --pixel 1200,2400").stderr.split())
    assert "If the height of the camera is the wrong one, correct height_m in scene.toml." in refused
    shots.write_text(shots.read_text().replace(",5500,", ",55,"))
    refused = " ".join(run(f"{line} --shots shots.csv --format table").stderr.split())
    assert "the wrong one, correct the column height_m of shots.csv." in refused
