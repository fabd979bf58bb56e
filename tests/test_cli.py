"""The command line: every pixel gets a row, every mistake one clean message and exit code 2."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import pathlib
import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from support.command_runner import CliRunner

from jaxgeo._destination import destination
from jaxgeo.cli import app
from jaxgeo.demo import Demo, scene_file
from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io import undulation
from jaxgeo.io.tables import FIX_COLUMNS
from jaxgeo.status import Status

DEM = str(pathlib.Path(scene_file()).with_name("jacksboro.tif"))
HEADER = "name,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,gimbal_outer_deg,gimbal_inner_deg,u,v"
ROWS = {
    "axis": "36.318,-84.105,5500,160,1,-0.5,72,0,1199.5,2399.5",
    "upwards": "36.318,-84.105,5500,160,1,-0.5,95,0,1199.5,2399.5",
    "unknown": "nan,-84.105,5500,160,1,-0.5,72,0,1199.5,2399.5",
    "beside": "36.318,-84.105,5500,160,1,-0.5,72,0,-1199.5,2399.5",
    "away": "36.318,-84.105,5500,340,1,-0.5,72,0,1199.5,2399.5",
}


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def shots_file(tmp_path: pathlib.Path):
    def write(text: str) -> pathlib.Path:
        path = tmp_path / "shots.csv"
        path.write_text(text)
        return path

    return write


def all_rows() -> str:
    return "\n".join([HEADER, *(f"{name},{row}" for name, row in ROWS.items())]) + "\n"


def locate_shots(path: pathlib.Path, *more: str | pathlib.Path):
    return run("locate", "--scene", scene_file(), "--dem", DEM, "--shots", path, *more)


@pytest.mark.costly
def test_every_row_of_a_table_comes_back(shots_file) -> None:
    result = locate_shots(shots_file(all_rows()))
    assert result.exit_code == 0, result.stderr
    rows = list(csv.DictReader(io.StringIO(result.stdout)))
    assert [row["name"] for row in rows] == list(ROWS)
    status = {row["name"]: row["status"] for row in rows}
    assert status["axis"] == "hit"
    assert status["upwards"] == "rises_away"
    assert status["unknown"] == "invalid_input"
    assert status["beside"] == "outside_image"
    assert status["away"] in ("leaves_terrain", "ray_misses_terrain")
    for row in rows:
        assert (row["fix_lat_deg"] == "") == (row["status"] != "hit")
        assert row["roll_deg"] == "-0.5", "columns are carried through as written"
    lat, lon, height, msl = (float(rows[0][name]) for name in list(FIX_COLUMNS)[:4])
    assert height - msl == pytest.approx(float(undulation(np.array(lat), np.array(lon))), abs=2e-4)
    assert "5 pixels" in result.stderr
    for name in set(status.values()):
        assert Status[name].message[:40] in result.stderr


@pytest.mark.costly
def test_a_pixel_on_the_command_line_is_the_same_fix(shots_file) -> None:
    result = run(
        "locate", "--scene", scene_file(), "--dem", DEM, "--pixel", "1199.5,2399.5", "--no-accuracy", "--format", "csv"
    )
    assert result.exit_code == 0, result.stderr
    (alone,) = csv.DictReader(io.StringIO(result.stdout))
    in_table = next(csv.DictReader(io.StringIO(locate_shots(shots_file(all_rows())).stdout)))
    assert {name: alone[name] for name in FIX_COLUMNS} == {name: in_table[name] for name in FIX_COLUMNS}


@pytest.mark.slow
def test_air_in_the_scene_moves_the_fix(tmp_path: pathlib.Path) -> None:
    """By some metres here, towards the camera: 5 km up, 72 degrees off nadir."""
    scene = tmp_path / "scene.toml"
    scene.write_text(scene_file().read_text(encoding="utf-8") + "\n[air]\n", encoding="utf-8")
    ranges = []
    for path in (scene_file(), scene):
        result = run(
            "locate", "--scene", path, "--dem", DEM, "--pixel", "1199.5,2399.5", "--format", "csv", "--no-accuracy"
        )
        assert result.exit_code == 0, result.stderr
        (row,) = csv.DictReader(io.StringIO(result.stdout))
        ranges.append(float(row["slant_range_m"]))
    assert 0.3 < ranges[0] - ranges[1] < 30.0


@pytest.mark.costly
def test_geojson_keeps_what_has_no_place(shots_file, tmp_path: pathlib.Path) -> None:
    output = tmp_path / "fixes.geojson"
    assert locate_shots(shots_file(all_rows()), "--output", output).exit_code == 0
    features = json.loads(output.read_text())["features"]
    assert len(features) == len(ROWS)
    lon, lat, height = features[0]["geometry"]["coordinates"]
    assert (round(lon), round(lat)) == (-84, 36)
    assert 200.0 < height < 1100.0
    assert features[0]["properties"]["u"] == 1199.5
    assert [feature["geometry"] is None for feature in features] == [False, True, True, True, True]


@pytest.mark.parametrize("pixel", ["inf,1", "nan,1", "-inf,nan", "1e400,1"])
def test_a_pixel_that_is_no_number_is_refused(pixel: str) -> None:
    result = run("locate", "--scene", scene_file(), "--dem", DEM, "--no-accuracy", f"--pixel={pixel}")
    assert result.exit_code == 2
    assert f"--pixel '{pixel}': expected COLUMN,ROW" in " ".join(result.stderr.split())


@pytest.mark.costly
def test_only_the_readings_of_the_gimbal_are_numbers(shots_file) -> None:
    extra = {"gimbal_note": "fine day", "gimbal_yaw_deg": "n/a", "gimbal_serial": "007"}
    lines = all_rows().splitlines()
    text = "\n".join([",".join([lines[0], *extra]), *(",".join([line, *extra.values()]) for line in lines[1:])]) + "\n"
    path = shots_file(text)
    result = locate_shots(path, "--format", "geojson")
    assert result.exit_code == 0, result.stderr
    for feature in json.loads(result.stdout)["features"]:
        assert {name: feature["properties"][name] for name in extra} == extra
        assert feature["properties"]["gimbal_inner_deg"] == 0.0
    assert next(csv.DictReader(io.StringIO(locate_shots(path).stdout)))["gimbal_serial"] == "007"


@pytest.mark.costly
def test_degrees_have_ten_decimals(shots_file) -> None:
    row = next(csv.DictReader(io.StringIO(locate_shots(shots_file(all_rows())).stdout)))
    for name in ("fix_lat_deg", "fix_lon_deg"):
        assert len(row[name].split(".")[1]) >= 10, "1e-10 deg are 0.01 mm"


@pytest.mark.slow
def test_the_table_on_the_screen_fits_and_says_the_status() -> None:
    result = run("locate", "--scene", scene_file(), "--dem", DEM, "--pixel", "10,10", "--pixel=-10,10")
    assert result.exit_code == 0, result.stderr
    assert "outside_image" in result.stdout
    assert "hit" in result.stdout


WRONG_TABLES = [
    (all_rows().replace(",v\n", "\n", 1).replace(",2399.5\n", "\n"), ["no column v", "The columns needed are"]),
    (all_rows().replace("36.318,", "36.3.18,", 1), ["row 2", "column lat_deg", "'36.3.18'", "deg"]),
    (all_rows().replace("36.318,", "136.318,", 1), ["row 2", "lat_deg", "136.318", "[-90, 90] deg"]),
    (all_rows() + "short,1,2\n", ["row 7", "3 cells", "11"]),
    (all_rows().replace("name,", "status,"), ["column status", "rename"]),
    (all_rows().replace("name,", "u,"), ["column u", "twice"]),
    (all_rows().replace(".", ","), ["decimals are written with commas"]),
    (all_rows().replace("lat_deg", "Lat_Deg"), ["column lat_deg", "Did you mean lat_deg by 'Lat_Deg'?", "capitals"]),
    (all_rows().replace("heading_deg", "headin_deg"), ["Did you mean heading_deg by 'headin_deg'?"]),
    (HEADER + "\n", ["no rows"]),
    ("", ["is empty"]),
]


@pytest.mark.parametrize("text, words", WRONG_TABLES, ids=[" ".join(words[0].split()[:4]) for _, words in WRONG_TABLES])
def test_wrong_tables(shots_file, text: str, words: list[str]) -> None:
    assert_refused(locate_shots(shots_file(text)), "shots.csv", *words)


def test_wrong_scene(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(scene_file().read_text().replace("heading_deg = 160.0", "heading_rad = 2.8"))
    result = run("locate", "--scene", path, "--dem", DEM, "--pixel", "1,1")
    assert_refused(result, str(path), "heading_rad = 2.8", "write heading_deg, in deg")


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--dem", DEM, "--pixel", "1;2"], ["'1;2'", "COLUMN,ROW"]),
        (["--pixel", "1,2"], ["--dem", "--ground"]),
        (["--dem", DEM, "--pixel", "1,2", "--shots", "shots.csv"], ["--pixel", "--shots"]),
        (["--dem", "nowhere.tif", "--pixel", "1,2"], ["nowhere.tif"]),
        (["--dem", DEM, "--pixel", "1,2", "--dem-datum", "EPSG:999999"], ["EPSG:999999", "ellipsoid"]),
        (["--dem", DEM, "--shots", "nowhere.csv"], ["nowhere.csv"]),
        (["--dem", DEM, "--pixel", "1,2", "--output", "no/such/folder/x.csv"], ["no/such/folder"]),
    ],
    ids=["pixel", "no ground", "both", "dem", "datum", "shots", "output"],
)
def test_wrong_options(arguments: list[str], words: list[str]) -> None:
    assert_refused(run("locate", "--scene", scene_file(), *arguments), *words)


@pytest.mark.parametrize(
    "option, words", [("--scene", "the scene file in it"), ("--shots", "the table of shots in it")]
)
def test_a_folder_is_no_input(tmp_path: pathlib.Path, option: str, words: str) -> None:
    files = {"--scene": scene_file(), "--shots": tmp_path / "shots.csv"} | {option: tmp_path}
    arguments = [part for pair in files.items() for part in pair]
    assert_refused(run("locate", "--dem", DEM, *arguments), str(tmp_path), "this is a folder", words)


WRONG_PLACES = [
    ("folder", "this is a folder"),
    (".", "this is a folder"),
    ("nowhere/x.csv", "there is no folder nowhere"),
    ("nowhere/x.png", "there is no folder nowhere"),
    ("fixes.xyz", "unsupported file type .xyz"),
    ("fixes.txt", "unsupported file type .txt"),
    ("fixes", "the name has no extension"),
    ("x" * 300 + ".csv", "it cannot be written: File name too long"),
]


@pytest.mark.parametrize("command", ["locate", "demo"])
@pytest.mark.parametrize("output, words", WRONG_PLACES, ids=[output[:20] for output, _ in WRONG_PLACES])
def test_a_wrong_place_is_told_before_the_work(tmp_path, monkeypatch, command: str, output: str, words: str) -> None:
    def work(*_):
        raise AssertionError("the work has begun")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxgeo.cli.locate.read_inputs", work)
    monkeypatch.setattr("jaxgeo.demo.Making", work)
    (tmp_path / "folder").mkdir()
    arguments = ["--scene", scene_file(), "--dem", DEM, "--pixel", "1,2"] if command == "locate" else []
    assert_refused(run(command, *arguments, "--output", output), "--output", output, words)
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_file_that_may_not_be_written_is_told(tmp_path: pathlib.Path, monkeypatch) -> None:
    monkeypatch.setattr(os, "access", lambda _, mode: mode != os.W_OK)  # root may write anywhere
    arguments = ["--scene", scene_file(), "--dem", DEM, "--pixel", "1,2", "--output", tmp_path / "x.csv"]
    assert_refused(run("locate", *arguments), "x.csv", "may not be written")


def test_demo_does_not_write_a_scene_onto_a_folder(tmp_path: pathlib.Path) -> None:
    result = run("demo", "--output", tmp_path / "x.png", "--write-scene", tmp_path)
    assert_refused(result, "--write-scene", "this is a folder")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.costly
def test_a_pipe_stays_a_pipe(tmp_path: pathlib.Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reader.start()
    result = run("locate", "--scene", scene_file(), "--dem", DEM, "--pixel", "1,2", "--no-accuracy", "-o", pipe)
    reader.join(timeout=10.0)
    assert result.exit_code == 0, result.stderr
    assert pipe.is_fifo()
    assert read[0].startswith("u,v,fix_lat_deg")


def test_a_link_stays_a_link(tmp_path: pathlib.Path) -> None:
    target, link = tmp_path / "target.csv", tmp_path / "link.csv"
    target.write_text("old")
    link.symlink_to(target)
    with destination("--output", link) as stream:
        stream.write("new")
        stream.flush()
        assert target.read_text() == "old"
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert sorted(tmp_path.iterdir()) == [link, target]


def assert_refused(result, *words: str) -> None:
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    for word in words:
        assert word in result.stderr.replace("\n", " ")
    assert result.stderr.startswith("jaxgeo: ")


def test_no_partial_output_is_left(tmp_path: pathlib.Path, shots_file) -> None:
    output = tmp_path / "fixes.csv"
    assert locate_shots(shots_file(""), "--output", output).exit_code == 2
    assert list(tmp_path.iterdir()) == [tmp_path / "shots.csv"]


def test_files_of_the_demo_are_written_without_running_it(tmp_path: pathlib.Path) -> None:
    scene, dem = tmp_path / "scene.toml", tmp_path / "dem.tif"
    result = run("demo", "--write-scene", scene, "--write-dem", dem)
    assert (result.exit_code, result.stdout) == (0, "")
    assert scene.read_bytes() == scene_file().read_bytes()
    assert dem.read_bytes() == scene_file().with_name("jacksboro.tif").read_bytes()
    assert sorted(tmp_path.iterdir()) == [dem, scene]
    assert_refused(run("demo", "--write-scene", scene, "--write-dem", scene), "both name", "name two files")


@pytest.mark.slow
def test_demo_shows_a_table_and_a_picture(tmp_path: pathlib.Path) -> None:
    picture, scene = tmp_path / "demo.png", tmp_path / "scene.toml"
    result = run("demo", "--output", picture, "--write-scene", scene)
    assert result.exit_code == 0, result.output
    assert result.stdout.count("hit") == 20
    assert scene.read_text() == scene_file().read_text()
    import matplotlib.image

    pixels = matplotlib.image.imread(picture)
    assert pixels.shape[0] > 800
    assert pixels.shape[1] > 1400
    assert float(np.std(pixels[..., :3])) > 0.1


@pytest.mark.slow
def test_nothing_of_the_demo_but_its_picture_needs_matplotlib(tmp_path: pathlib.Path, monkeypatch) -> None:
    without_matplotlib(monkeypatch)
    assert_table_and_hint(run("demo", "--output", tmp_path / "demo.png"), tmp_path)


def without_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)


def assert_table_and_hint(result, folder: pathlib.Path) -> None:
    assert result.exit_code == 1, "the table is there, the picture is not"
    assert result.stdout.count("hit") == 20
    assert "figure:" not in result.stdout
    assert "pip install 'jaxgeo[plot]'" in result.stderr
    assert "Traceback" not in result.output
    assert list(folder.iterdir()) == []


@pytest.fixture
def made() -> Demo:
    """All of a demonstration that the table needs, without the work."""
    count = 20
    position = Geodetic(lat=np.full(count, 0.63), lon=np.full(count, -1.47), height=np.full(count, 300.0))
    number = np.ones(count)
    fix = Fix(position, np.zeros((count, 3)), number, number, number, number, np.full(count, Status.hit, np.int8))
    errors = SimpleNamespace(number=7, checked="circles", budget="shares")
    made = object.__new__(Demo)
    vars(made).update(title="Somewhere", uv=np.zeros((count, 2)), fix=fix, errors=errors)
    return made


def test_demo_without_matplotlib_shows_the_table_and_a_hint(tmp_path: pathlib.Path, monkeypatch, made: Demo) -> None:
    without_matplotlib(monkeypatch)
    making = SimpleNamespace(seen=lambda: made, whole=lambda _: made)
    monkeypatch.setattr("jaxgeo.demo.Making", lambda: contextlib.nullcontext(making))
    result = run("demo", "--output", tmp_path / "demo.png")
    assert_table_and_hint(result, tmp_path)
    for words in ("Somewhere", "fix 7", "circles", "shares"):
        assert words in result.stdout


def test_help_says_what_demo_does_without_matplotlib() -> None:
    text = " ".join(run("demo", "--help").stdout.split())
    assert "jaxgeo[plot]" in text
    assert "exit code is 1" in text


@pytest.mark.costly
def test_the_package_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "jaxgeo", "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "locate" in done.stdout
