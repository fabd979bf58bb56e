"""The commands of coverage: what they print and write is what the functions find, and mistakes are told in words."""

from __future__ import annotations

import csv
import io
import json
import pathlib
import re
from collections.abc import Callable

import numpy as np
import pyogrio
import pytest
import rasterio
from rasterio.windows import from_bounds
from support.command_files import prepare
from support.command_runner import CliRunner

from jaxgeo import Geodetic, coverage
from jaxgeo.cli import app
from jaxgeo.cli._inputs import shots_of
from jaxgeo.demo import scene_file
from jaxgeo.io import example_dem, read_navigation
from jaxgeo.io.scene import read_scene
from jaxgeo.status import Status
from jaxgeo.studies import li2020

DEM = str(pathlib.Path(scene_file()).with_name("jacksboro.tif"))
POSE = "lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg"
READINGS = ",gimbal_outer_deg,gimbal_inner_deg"
SHOTS = {
    "whole": "36.318,-84.105,5500,160,1,-0.5,72,0",
    "a bit on": "36.315,-84.104,5500,160,1,-0.5,72,0",
    "over the horizon": "36.318,-84.105,5500,160,1,-0.5,84,0",
}
RECORDS = 41


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def assert_refused(result, *words: str) -> None:
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    for word in words:
        assert word in result.stderr.replace("\n", " ")
    assert result.stderr.startswith("jaxgeo: ")


def words_of(text: str) -> list[str]:
    return " ".join(text.split()).split()


@pytest.fixture
def shots_file(tmp_path: pathlib.Path) -> pathlib.Path:
    path = tmp_path / "shots.csv"
    rows = [f"{name},{row}" for name, row in SHOTS.items()]
    path.write_text("\n".join([f"name,{POSE}{READINGS}", *rows]) + "\n")
    return path


@pytest.fixture
def flight(tmp_path: pathlib.Path):
    """Writes navigation records of straight and level flight at 170 m/s; `change` puts other cells into rows."""

    def write(*, columns: str = READINGS, first_times: tuple[str, ...] = ()) -> pathlib.Path:
        step = 0.5 * 170.0
        times = [*first_times, *(f"{100.0 + 0.5 * k}" for k in range(len(first_times), RECORDS))]
        lines = [f"time_s,{POSE}{columns}"]
        for k, time in enumerate(times):
            lat, lon = 36.35 - k * step * 0.866 / 110_940.0, -84.10 + k * step * 0.5 / 89_640.0
            lines.append(f"{time},{lat:.9f},{lon:.9f},5500,150,0,0{',72,0' if columns else ''}")
        path = tmp_path / "flight.csv"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def scene_with(tmp_path: pathlib.Path, old: str, new: str) -> pathlib.Path:
    path = tmp_path / "scene.toml"
    text = scene_file().read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


def footprint(*arguments: str | pathlib.Path):
    return run("footprint", "--scene", scene_file(), "--dem", DEM, *arguments)


@pytest.mark.slow
def test_footprint_of_the_scene(tmp_path: pathlib.Path) -> None:
    output = tmp_path / "footprint.geojson"
    result = footprint("--output", output, "--edges")
    assert result.exit_code == 0, result.stderr
    row = words_of(result.stdout.split("\n \n")[0].splitlines()[3])
    assert row[0] == "0"
    assert row[-1] == "hit"
    area, hidden, columns, rows, along, across = (float(word) for word in row[1:-1])
    scene = read_scene(scene_file())
    assert scene.shot is not None
    found = coverage.footprint(scene.sensor, scene.shot, example_dem())
    assert (area, hidden) == pytest.approx((1e-6 * found.area, found.hidden_length), abs=0.1)  # km2, m
    assert (columns, rows, along, across) == pytest.approx((7.845, 3.442, 7.902, 1.203), abs=2e-3)  # m
    assert "1 footprint" in result.stderr
    assert "The whole edge of the image sees ground." in result.stderr
    features = json.loads(output.read_text())["features"]
    assert features[0]["properties"]["kind"] == "outline"
    assert {feature["properties"]["kind"] for feature in features[1:]} == {"edge"}
    assert features[0]["properties"]["area_m2"] == pytest.approx(1e6 * area, abs=500.0)


@pytest.mark.slow
def test_footprints_of_a_table(tmp_path: pathlib.Path, shots_file: pathlib.Path) -> None:
    """A row for every shot, whatever became of it; the one over the horizon has no area, and says why."""
    output = tmp_path / "footprints.geojson"
    result = footprint("--shots", shots_file, "--output", output, "--tolerance", "20")
    assert result.exit_code == 0, result.stderr
    features = [feature["properties"] for feature in json.loads(output.read_text())["features"]]
    assert [one["name"] for one in features] == list(SHOTS)
    assert [one["gimbal_outer_deg"] for one in features] == [72.0, 72.0, 84.0]
    assert [one["status"] for one in features] == ["hit", "hit", "crosses_horizon"]
    assert features[0]["area_m2"] == pytest.approx(69.46e6, rel=1e-3)
    assert features[2]["area_m2"] is None
    assert "crosses_horizon" in result.stdout
    assert "3 footprints" in result.stderr
    assert Status.crosses_horizon.message in result.stderr


@pytest.mark.slow
def test_an_incomplete_footprint_has_the_part_over_known_ground(tmp_path: pathlib.Path) -> None:
    """With the status and the exit code of an incomplete one; a complete one has no partial area."""
    prepare(tmp_path, "images dem.tif")
    small = tmp_path / "small.tif"
    with rasterio.open(tmp_path / "dem.tif") as whole:
        window = from_bounds(-84.107, 36.3135, -84.098, 36.3180, whole.transform).round_offsets().round_lengths()
        profile = {"driver": "GTiff", "height": window.height, "width": window.width, "count": 1}
        profile |= {"crs": whole.crs, "dtype": whole.dtypes[0], "transform": whole.window_transform(window)}
        with rasterio.open(small, "w", **profile) as part:
            part.write(whole.read(1, window=window), 1)
    given = [str(tmp_path / "images"), "--camera-datum", "ellipsoid", "--dem"]
    told = run("footprint", *given, small, "--json")
    assert told.exit_code == 1, told.output
    for one in json.loads(told.stdout)["footprints"]:
        assert one["status"] == "leaves_terrain"
        assert one["area_km2"] is None
        assert 0.2 < one["covered_share"] < 0.8
        assert 0.05 < one["covered_area_km2"] < 0.5
    shown = run("footprint", *given, small).stdout
    assert "partial" in shown
    assert "of image" in shown
    whole = json.loads(run("footprint", *given, DEM, "--json").stdout)["footprints"][0]
    assert (whole["status"], whole["covered_area_km2"], whole["covered_share"]) == ("hit", None, None)


@pytest.mark.slow
def test_overlap_over_part_of_the_ground_names_the_parts(tmp_path: pathlib.Path, flight) -> None:
    """The elevation model is cut so that two images of a flight are partly over it."""
    prepare(tmp_path, "dem.tif")
    small = tmp_path / "small.tif"
    with rasterio.open(tmp_path / "dem.tif") as whole:
        window = from_bounds(-84.30, 36.20, -84.08, 36.30, whole.transform).round_offsets().round_lengths()
        profile = {"driver": "GTiff", "height": window.height, "width": window.width, "count": 1}
        profile |= {"crs": whole.crs, "dtype": whole.dtypes[0], "transform": whole.window_transform(window)}
        with rasterio.open(small, "w", **profile) as part:
            part.write(whole.read(1, window=window), 1)
    given = ("overlap", "--scene", scene_file(), "--dem", small, "--navigation", flight(), "--times", "101,103")
    told = run(*given, "--json")
    content = json.loads(told.stdout)
    assert told.exit_code == 1
    assert content["pairs"][0]["status"] not in ("hit", "images_apart")
    assert list(content["partial"]) == ["101 s", "103 s"]
    assert all(0.0 < one["covered_share"] < 1.0 for one in content["partial"].values())
    assert "partial: share of the image that sees known ground, and its area: 101 s " in told.stderr


def test_the_aircraft_of_point_may_stand_on_the_command_line(tmp_path: pathlib.Path) -> None:
    """In place of the pose of a scene, of one that has none, and of a file."""
    text = scene_file().read_text()
    start = text.index("[pose]")
    bare = tmp_path / "bare.toml"
    bare.write_text(text[:start] + text[text.index("[errors]") :])
    aims = ("--target", "36.31,-84.25,900", "--target-datum", "EPSG:5773", "--quiet")
    place = ("--position", "36.318,-84.105,5500", "--attitude", "160,1,-0.5")
    own = run("point", "--scene", scene_file(), *aims)
    assert own.exit_code == 0, own.output
    given = run("point", "--scene", bare, *aims, *place, "--camera-datum", "EPSG:5773")
    assert given.exit_code == 0, given.output
    assert given.stdout == own.stdout
    assert run("point", "--scene", scene_file(), *aims, *place).stdout == own.stdout, "heights as in the scene"
    assert run("point", "--scene", scene_file(), *aims, "--attitude", "161,1,-0.5").stdout != own.stdout
    level = run("point", "--scene", bare, *aims[:-1], *place[:2], "--camera-datum", "EPSG:5773")
    assert "assumed: The aircraft is level and heads north. (--attitude" in level.stderr
    prepare(tmp_path, "DJI_0042.JPG")
    image = ("point", tmp_path / "DJI_0042.JPG", "--camera-datum", "ellipsoid", *aims)
    there = run(*image, "--position", "36.318,-84.105,900")
    assert there.stdout == run(*image).stdout
    assert run(*image, "--position", "36.319,-84.105,900").stdout != there.stdout


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--position", "36.3,-84.1"), ["--position '36.3,-84.1'", "LAT,LON,HEIGHT"]),
        (("--position", "-184.1,36.3,5500"), ["--position", "is it LON,LAT?"]),
        (("--attitude", "1,2"), ["--attitude '1,2'", "HEADING,PITCH,ROLL"]),
    ],
)
def test_a_wrong_aircraft_is_refused(arguments: tuple[str, ...], words: list[str]) -> None:
    assert_refused(run("point", "--scene", scene_file(), "--line-of-sight", "250,18", *arguments), *words)


def test_a_scene_without_a_pose_asks_for_a_position(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "bare.toml"
    text = scene_file().read_text()
    path.write_text(text[: text.index("[pose]")])
    said = run("point", "--scene", path, "--line-of-sight", "250,18")
    assert_refused(said, "[pose] is missing; pointing without --position needs it.")
    said = run("point", "--scene", path, "--line-of-sight", "250,18", "--position", "36.3,-84.1,5500")
    assert_refused(said, "--position: say what its height is above, with --camera-datum.")


def test_images_from_one_place_have_no_direction_of_flight(tmp_path: pathlib.Path) -> None:
    prepare(tmp_path, "images dem.tif")
    given = ("overlap", tmp_path / "images", "--camera-datum", "ellipsoid", "--dem", tmp_path / "dem.tif", "--quiet")
    assert_refused(run(*given, "--along", "rows"), "DJI_0042.JPG and DJI_0043.JPG are taken from one place")


@pytest.mark.parametrize("command", ["locate", "view", "accuracy-map", "report"])
def test_commands_of_pixels_offer_the_reported_ground(tmp_path: pathlib.Path, command: str) -> None:
    output = {"accuracy-map": ["-o", tmp_path / "a.tif", "--resolution", "5"], "report": ["-o", tmp_path / "a.html"]}
    assert_refused(run(command, scene_file(), *output.get(command, [])), "give the ground", "--ground reported")


@pytest.mark.parametrize("command", ["footprint", "overlap"])
def test_commands_of_images_do_not_offer_it(command: str) -> None:
    said = run(command, "--scene", scene_file(), *(["--shots", "shots.csv"] if command == "overlap" else []))
    assert_refused(said, "give the ground")
    assert "reported" not in said.stderr


@pytest.mark.slow
def test_point_at_the_ground_of_the_dem_and_at_a_height() -> None:
    """What the optical axis of the demo's scene sees is looked at by its own readings."""
    point = ("point", "--scene", scene_file(), "--target")
    on_ground = run(*point, "36.26902887,-84.26795441", "--dem", DEM)
    assert on_ground.exit_code == 0, on_ground.output
    assert on_ground.stdout.splitlines() == ["outer_deg = 72.000000", "inner_deg = 0.000000"]
    assert "564.57 m above the ellipsoid" in on_ground.stderr
    assert Status.hit.message in on_ground.stderr
    at_height = run(*point, "36.26902887,-84.26795441,564.5726", "--target-datum", "ellipsoid")
    assert at_height.exit_code == 0, at_height.output
    assert at_height.stdout == on_ground.stdout
    above_the_sea = run(*point, "36.26902887,-84.26795441,564.5726")
    assert "533.61 m above the ellipsoid" in above_the_sea.stderr, "heights of the scene are above EGM96"


def test_point_along_a_line_of_sight() -> None:
    result = run("point", "--scene", scene_file(), "--line-of-sight", "250,18.5")
    assert result.exit_code == 0, result.output
    readings = [float(line.split(" = ")[1]) for line in result.stdout.splitlines()]
    assert readings == pytest.approx([71.0, -0.3], abs=0.1)
    assert "hit" in result.stderr


@pytest.mark.costly
def test_point_at_the_other_side_of_the_earth_without_a_dem() -> None:
    """An exchanged latitude and longitude: never a success."""
    result = run("point", "--scene", scene_file(), "--target", "-84.2,36.3,400", "--target-datum", "ellipsoid")
    assert result.exit_code == 1, result.output
    assert Status.below_horizon.message in result.stderr
    assert "is it LON,LAT?" in result.stderr


@pytest.mark.costly
def test_point_out_of_range_tells_the_nearest() -> None:
    """60 deg above the horizon: the frame of two axes comes as far as the plane of its base."""
    result = run("point", "--scene", scene_file(), "--line-of-sight", "250,-60")
    assert result.exit_code == 1, result.output
    outer, inner = (float(line.split(" = ")[1]) for line in result.stdout.splitlines())
    assert max(abs(outer), abs(inner)) == pytest.approx(90.0, abs=1e-5)
    assert Status.outside_gimbal_range.message in result.stderr
    assert 59.0 < float(result.stderr.split("pointing error ")[1].split()[0]) < 61.0


@pytest.mark.slow
def test_point_at_what_is_hidden() -> None:
    """Ground behind a ridge: the readings hold, and the exit code says that it is not seen."""
    result = run("point", "--scene", scene_file(), "--dem", DEM, "--target", "36.2,-84.35,0", "--target-datum", "0")
    assert result.exit_code == 1, result.output
    assert [line.split(" = ")[0] for line in result.stdout.splitlines()] == ["outer_deg", "inner_deg"]
    assert Status.hidden_by_terrain.message in result.stderr
    assert re.search(r"0\.00 m above the ellipsoid, \d+\.\d\d m below the ground of --dem", result.stderr)


@pytest.mark.costly
def test_a_target_above_the_ground_says_how_far() -> None:
    place = Geodetic.from_degrees(lat=36.269, lon=-84.268, height=0.0)
    ground = float(example_dem().height_at(place))
    words = ("--target", "36.269,-84.268,1560", "--target-datum", "ellipsoid", "--dem", DEM)
    result = run("point", "--scene", scene_file(), *words)
    assert result.exit_code == 0, result.output
    assert f"1560.00 m above the ellipsoid, {1560.0 - ground:.2f} m above the ground of --dem" in result.stderr


@pytest.mark.slow
def test_overlaps_of_a_flight(tmp_path: pathlib.Path, flight) -> None:
    path, output = flight(), tmp_path / "overlaps.csv"
    arguments = ("overlap", "--scene", scene_file(), "--dem", DEM, "--navigation", path, "--times", "101,103,107")
    result = run(*arguments, "--output", output)
    assert result.exit_code == 0, result.output
    rows = list(csv.DictReader(io.StringIO(output.read_text())))
    assert [(row["before"], row["after"]) for row in rows] == [("101 s", "103 s"), ("103 s", "107 s")]
    scene, dem = read_scene(scene_file()), example_dem()
    trajectory = read_navigation(path, ("outer", "inner"), height_datum="EPSG:5773")
    before, after = (coverage.MovingExposure(trajectory, np.float64(time)) for time in (101.0, 103.0))
    found = coverage.overlap(scene.sensor, before, after, dem)
    for name in ("near", "far", "least", "side", "area"):
        assert float(rows[0][name]) == pytest.approx(float(getattr(found, name)), abs=2e-6)
    assert float(rows[0]["step_m"]) == pytest.approx(340.0, abs=5.0)
    assert [row["status"] for row in rows] == ["hit", "hit"]
    assert "2 pairs" in result.stderr


@pytest.mark.slow
def test_overlaps_of_a_table_of_shots(shots_file: pathlib.Path) -> None:
    """The last image looks beyond the terrain: that pair has a status, and no numbers."""
    result = run("overlap", "--scene", scene_file(), "--dem", DEM, "--shots", shots_file, "--along", "rows")
    assert result.exit_code == 0, result.output
    first, second = (words_of(line) for line in result.stdout.splitlines()[3:5])
    assert first[:2] == ["0", "1"]
    assert 0.9 < float(first[2]) < float(first[3]) < 1.0
    assert second == ["1", "2", "leaves_terrain"]
    assert Status.leaves_terrain.message in result.stderr


def plan(path: pathlib.Path, output: pathlib.Path, *more: str | pathlib.Path):
    return run("plan", "--scene", scene_file(), "--dem", DEM, "--navigation", path, "--output", output, *more)


def exposures(output: pathlib.Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(output.read_text())))


@pytest.mark.parametrize(
    "wishes, interval",
    [(("--timing", "fixed:2.5"), 2.5), (("--timing", "velocity-height", "--overlap", "0.9", "--start", "103"), None)],
    ids=["fixed", "velocity-height"],
)
@pytest.mark.slow
def test_plan(tmp_path: pathlib.Path, flight, wishes: tuple[str, ...], interval: float | None) -> None:
    """The gimbal's readings are those of the scene, where the records have none."""
    output = tmp_path / "exposures.csv"
    result = plan(flight(columns=""), output, *wishes)
    assert result.exit_code == 0, result.output
    rows = exposures(output)
    times = np.array([float(row["time_s"]) for row in rows])
    near = np.array([float(row["overlap_near"]) for row in rows[1:]])
    assert {row["gimbal_outer_deg"] for row in rows} == {"72.00000000"}
    assert {row["status"] for row in rows[1:]} == {"hit"}
    if interval is None:
        assert times[0] == 103.0
        np.testing.assert_allclose(near, 0.9, rtol=0, atol=0.02)
    else:
        np.testing.assert_allclose(times, 100.0 + interval * np.arange(9), rtol=0, atol=1e-9)
    assert f"{len(rows)} exposures from {times[0]:.3f} to {times[-1]:.3f} s" in result.stderr
    assert f"mean {near.mean():.4f}, worst {near.min():.4f}" in result.stderr


@pytest.mark.slow
def test_plan_by_the_ground(tmp_path: pathlib.Path, flight) -> None:
    output = tmp_path / "exposures.csv"
    result = plan(flight(), output, "--overlap", "0.9", "--place", "least")
    assert result.exit_code == 0, result.output
    assert "least: mean 0.9000, worst 0.9000" in result.stderr
    again = run("footprint", "--scene", scene_file(), "--dem", DEM, "--shots", output, "--camera-datum", "ellipsoid")
    assert again.exit_code == 0, again.output
    assert f"{len(exposures(output))} footprints" in again.stderr


def test_a_table_of_shots_may_state_what_its_heights_are_above(tmp_path: pathlib.Path) -> None:
    """Its own column is read before the scene; without it, the scene's datum, EGM96, holds."""
    scene, path = read_scene(scene_file()), tmp_path / "shots.csv"
    lines = f"{POSE}{READINGS}", SHOTS["whole"]
    found = []
    for column in (("", ""), (",height_datum", ",EPSG:5773"), (",height_datum", ",ellipsoid")):
        path.write_text("\n".join(f"{line}{more}" for line, more in zip(lines, column, strict=True)) + "\n")
        shots, _ = shots_of(scene, scene_file(), path, None)
        found.append(float(shots.pose.position.height[0]))
    assert found == pytest.approx([5468.745, 5468.745, 5500.0], abs=0.01)  # m


BESIDE = "beside it (with latitude and longitude exchanged it would be on it)."
SEES_NONE = "the image sees no ground: the elevation model reaches from"


@pytest.mark.parametrize(
    "command, words",
    [
        pytest.param("plan --timing fixed:4 -o out.csv", SEES_NONE, marks=pytest.mark.costly),
        pytest.param("overlap --times 101,103", f"101 s and 103 s: {SEES_NONE}", marks=pytest.mark.slow),
        pytest.param(
            "overlap --times 101,103 --along rows",
            "no pair has an overlap: the elevation model reaches from",
            marks=pytest.mark.slow,
        ),
        pytest.param("footprint", "no footprint is complete: the elevation model reaches from", marks=pytest.mark.slow),
        pytest.param(
            "accuracy-map --resolution 90 -o map.tif",
            "no line of sight of the image comes down on the terrain: the elevation model reaches from",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_camera_beside_the_elevation_model_is_the_reason(
    tmp_path: pathlib.Path, flight, monkeypatch, command: str, words: str
) -> None:
    """Latitude and longitude exchanged: in the words of `jaxgeo locate`, whatever the command needed of the ground."""
    text = scene_file().read_text().replace("lat_deg = 36.318", "lat_deg = -84.105")
    (tmp_path / "scene.toml").write_text(text.replace("lon_deg = -84.105", "lon_deg = 36.318"))
    header, *rows = flight().read_text().splitlines()
    cells = [row.split(",") for row in rows]
    lines = [header, *(",".join([t, lon, lat, *more]) for t, lat, lon, *more in cells)]
    (tmp_path / "flight.csv").write_text("\n".join(lines) + "\n")
    monkeypatch.chdir(tmp_path)
    flown = ["--navigation", "flight.csv"] if command.startswith(("plan", "overlap")) else []
    result = run(*command.split(), "--scene", "scene.toml", "--dem", DEM, *flown)
    assert result.exit_code in (1, 2), result.output
    assert words in result.stderr
    assert result.stderr.endswith(f"{BESIDE}\n")


@pytest.mark.slow
def test_a_plan_is_a_table_of_shots_of_its_scene(tmp_path: pathlib.Path, flight) -> None:
    """Its heights are above the ellipsoid, as its column says, and those of the scene above EGM96."""
    output, ground = tmp_path / "exposures.csv", ("--scene", scene_file(), "--ground", "300")
    planned = run("plan", *ground, "--navigation", flight(), "--timing", "fixed:4", "--along", "rows", "-o", output)
    assert planned.exit_code == 0, planned.output
    shares = [float(row["overlap_near"]) for row in exposures(output)[1:]]
    again = run("overlap", *ground, "--shots", output, "--along", "rows", "--json")
    assert [one["near"] for one in json.loads(again.stdout)["pairs"]] == pytest.approx(shares, abs=1e-5)
    told = run("footprint", *ground, "--shots", output, "--json", "--tolerance", "100")
    assert {one["status"] for one in json.loads(told.stdout)["footprints"]} == {"hit"}


TARGET = ["point", "--scene", scene_file()]
OVERLAP = ["overlap", "--scene", scene_file(), "--dem", DEM]
PLAN = ["plan", "--scene", scene_file(), "--dem", DEM, "--navigation", "FLIGHT", "--output", "plan.csv"]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["plan", "overlap", "footprint"])
def test_long_commands_show_how_far_they_are(tmp_path: pathlib.Path, monkeypatch, flight, command: str) -> None:
    """On a terminal, on stderr; not with --quiet, and not in a pipe."""
    given = {
        "plan": ("--navigation", flight(), "--overlap", "0.9", "-o", tmp_path / "plan.csv"),
        "overlap": ("--navigation", flight(), "--times", "101,103,107"),
        "footprint": (),
    }[command]
    words = {"plan": "planning, s of the flight", "overlap": "computing overlaps", "footprint": "computing footprints"}
    line = (command, "--scene", scene_file(), "--dem", DEM, *given)
    assert words[command] not in run(*line).output
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    shown = run(*line)
    assert words[command] in shown.stderr
    assert words[command] not in shown.stdout
    assert words[command] not in run(*line, "--quiet").output


FOOTPRINT = ["footprint", "--scene", scene_file(), "--dem", DEM]
MISTAKES = [
    ([*TARGET], ["--target", "--line-of-sight"]),
    ([*TARGET, "--target", "36.2"], ["'36.2'", "LAT,LON"]),
    ([*TARGET, "--target", "36.2,-84.2"], ["give its height", "--dem"]),
    ([*TARGET, "--target", "96.2,-84.2,100"], ["96.2", "deg"]),
    ([*TARGET, "--target", "46.2,-84.2", "--dem", DEM], ["the elevation model reaches from", "beside it"]),
    ([*TARGET, "--line-of-sight", "250"], ["'250'", "AZIMUTH,DEPRESSION"]),
    ([*TARGET, "--line-of-sight", "250,100"], ["depression", "90"]),
    ([*TARGET, "--line-of-sight", "250,18", "--dem", DEM], ["--dem needs --target"]),
    ([*OVERLAP], ["--navigation", "--shots"]),
    ([*OVERLAP, "--navigation", "FLIGHT"], ["--times"]),
    ([*OVERLAP, "--navigation", "FLIGHT", "--times", "101"], ["at least two exposure times"]),
    ([*OVERLAP, "--navigation", "FLIGHT", "--times", "103,101"], ["decreasing times", "103 s to 101 s"]),
    ([*OVERLAP, "--navigation", "FLIGHT", "--times", "103;101"], ["'103;101'", "numbers in s"]),
    ([*OVERLAP, "--navigation", "FLIGHT", "--times", "103,400"], ["400 s is outside", "100 to 120 s"]),
    ([*OVERLAP, "--shots", "nowhere.csv"], ["nowhere.csv"]),
    ([*OVERLAP, "--shots", "SHOTS", "--output", "x.txt"], ["unsupported file type .txt"]),
    ([*PLAN], ["needs --overlap"]),
    ([*PLAN, "--overlap", "1"], ["--overlap 1", "[0, 1)"]),
    ([*PLAN, "--overlap", "-0.1"], ["--overlap -0.1", "[0, 1)"]),
    ([*PLAN, "--timing", "fixed:30"], ["the navigation is too short"]),
    ([*PLAN, "--overlap", "0.9", "--start", "400"], ["start", "100 to 120 s", "400 s"]),
    ([*PLAN, "--overlap", "0.9", "--timing", "fixed:2"], ["leave one out"]),
    ([*PLAN, "--timing", "fixed:0"], ["'fixed:0'", "above 0 s"]),
    ([*PLAN, "--timing", "fixed"], ["'fixed'", "fixed:PERIOD"]),
    ([*PLAN, "--timing", "soon", "--overlap", "0.9"], ["'soon'", "velocity-height"]),
    ([*PLAN, "--timing", "velocity-height", "--overlap", "0.9", "--place", "least"], ["--timing ground"]),
    ([*PLAN[:-1], "plan.txt", "--overlap", "0.9"], ["unsupported file type .txt"]),
    ([*PLAN[:-1], "no/such/folder/plan.csv", "--overlap", "0.9"], ["no/such/folder"]),
    ([*FOOTPRINT, "--output", "x.shp"], ["unsupported file type .shp"]),
    ([*FOOTPRINT, "--output", "no/such/folder/x.gpkg"], ["no/such/folder"]),
    ([*FOOTPRINT, "--output", "x.gpkg", "--crs", "EPSG:999999"], ["does not know the crs 'EPSG:999999'"]),
    ([*FOOTPRINT, "--tolerance", "0"], ["--tolerance 0", "above 0 m"]),
]


LATE = ("46.2,-84.2",)  # those of these mistakes are seen only after programs were compiled


def is_late(arguments: list[str]) -> bool:
    return any(argument in LATE for argument in arguments)


@pytest.mark.costly
@pytest.mark.parametrize(
    "arguments, words",
    [pytest.param(*one, marks=pytest.mark.slow if is_late(one[0]) else ()) for one in MISTAKES],
    ids=[f"{k}-{one[0]}" for k, (one, _) in enumerate(MISTAKES)],
)
def test_mistakes(tmp_path, monkeypatch, flight, shots_file, arguments: list[str], words: list[str]) -> None:
    monkeypatch.chdir(tmp_path)
    files = {"FLIGHT": flight(), "SHOTS": shots_file}
    result = run(*(files.get(argument, argument) if isinstance(argument, str) else argument for argument in arguments))
    assert_refused(result, *words)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flight.csv", "shots.csv"]


def test_records_with_a_gap(tmp_path: pathlib.Path, flight) -> None:
    result = plan(flight(first_times=("0",)), tmp_path / "plan.csv", "--overlap", "0.9")
    assert_refused(result, "a gap of 100.5 s before row", "the longest allowed is 5 s", "each as a file")
    assert "longest_gap" not in result.output


def test_records_that_run_backwards(tmp_path: pathlib.Path, flight) -> None:
    path = flight(first_times=("100.0", "100.5", "100.2"))
    result = plan(path, tmp_path / "plan.csv", "--overlap", "0.9")
    assert_refused(result, "rows 3 and 4", "time running backwards")


def test_a_table_of_one_shot(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "shots.csv"
    path.write_text(f"{POSE}{READINGS}\n{SHOTS['whole']}\n")
    assert_refused(run(*OVERLAP, "--shots", path), "at least two rows")


def test_a_camera_without_a_field(tmp_path: pathlib.Path) -> None:
    """No pixels, or pixels of no size, are no field of view."""
    for old, new, least in (
        ("width = 2400", "width = 0", "greater than 0"),
        ("pixel_pitch_um = 5.5", "pixel_pitch_um = 0.0", "at least 0.5 um"),
    ):
        scene = scene_with(tmp_path, old, new)
        result = run("footprint", "--scene", scene, "--dem", DEM)
        assert_refused(result, str(scene), new, least)


def test_readings_must_come_from_somewhere(tmp_path: pathlib.Path, flight) -> None:
    text = scene_file().read_text()
    scene = tmp_path / "scene.toml"
    scene.write_text(text[: text.index("[pose]")] + '[shots]\nheight_datum = "ellipsoid"\n')
    arguments = ("--scene", scene, "--dem", DEM)
    result = run("overlap", *arguments, "--navigation", flight(columns=""), "--times", "101,103")
    assert_refused(result, "gimbal_outer_deg", "[pose]")
    assert_refused(run("footprint", *arguments), "[pose] is missing")


@pytest.mark.slow
def test_study_of_overlap(tmp_path: pathlib.Path, monkeypatch) -> None:
    """With a folder, made where it is missing, files of the tables and pictures, and the verdicts on the screen."""
    short = li2020.run(flights=False)
    monkeypatch.setattr("jaxgeo.studies.li2020.run", lambda **_: short)
    folder = tmp_path / "a" / "study"
    result = run("study", "li2020", "--output", folder)
    assert result.exit_code == 0, result.output
    assert "Verdicts" in result.stdout
    assert "Compensation of attitude" not in result.stdout
    assert "Compensation of attitude" in (folder / "tables.md").read_text()
    assert {"tables.md", "overlaps.csv", "footprints.png", "folding.png"} <= {path.name for path in folder.iterdir()}


NADIR = """
[camera]
focal_px = 1000.0
width = 1000
height = 800
[gimbal]
kind = "fixed"
[mount]
camera_looks = "down"
"""
STRIP_METRES = (111_000.0, 90_000.0)  # m per deg of latitude and longitude there, roughly


def strips_scene(tmp_path: pathlib.Path, *, named: bool = False, tilted: bool = False) -> tuple[str, ...]:
    """Arguments of two strips of four nadir images there and back, 600 m apart over 1000 m of relief-free ground."""
    (tmp_path / "nadir.toml").write_text(NADIR)
    rows = []
    for number, (east, heading) in enumerate(((0.0, 0.0), (600.0, 180.0))):
        for k in range(4)[:: 1 if not number else -1]:
            lat, lon = 36.3 + 250.0 * k / STRIP_METRES[0], -84.25 + east / STRIP_METRES[1]
            roll = 85.0 if tilted and (number, k) == (1, 2) else 0.0
            rows.append(f"s{number}i{k},{lat:.8f},{lon:.8f},1500,{heading},0,{roll},ellipsoid,{'AB'[number]}")
    column = "strip" if named else "remark"
    (tmp_path / "strips.csv").write_text("\n".join([f"name,{POSE},height_datum,{column}", *rows]) + "\n")
    return "--scene", str(tmp_path / "nadir.toml"), "--shots", str(tmp_path / "strips.csv"), "--ground", "500"


@pytest.mark.costly
@pytest.mark.parametrize("named", [False, True])
def test_strips_have_forward_and_side_overlap(tmp_path: pathlib.Path, named: bool) -> None:
    """Over level ground: 1 - step / length along, 1 - spacing / width across; the step from strip to strip is none."""
    given = strips_scene(tmp_path, named=named)
    result = run("overlap", *given, "--strips", "--json", "-o", tmp_path / "out.csv")
    assert result.exit_code == 0, result.stderr
    content = json.loads(result.stdout)
    first, second = ("A", "B") if named else (1, 2)
    assert [pair["strip"] for pair in content["pairs"]] == [first] * 3 + [second] * 3
    assert content["pairs"][0]["before"] == "s0i0"
    forward, back, side = content["strips"]
    for one in (forward, back):
        assert one["images"] == 4
        assert (one["least"], one["mean"]) == pytest.approx((1.0 - 250.0 / 800.0,) * 2, abs=5e-3)
    assert (side["strip"], side["next_strip"]) == (first, second)
    assert content["strips_without_side"] == {}
    assert side["spacing_m"] == pytest.approx(600.0, abs=5.0)
    assert (side["least"], side["mean"]) == pytest.approx((1.0 - side["spacing_m"] / 1000.0,) * 2, abs=2e-3)
    assert side["lon_deg"] == pytest.approx(-84.25 + 300.0 / STRIP_METRES[1], abs=1e-4)
    with open(tmp_path / "out.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows] == ["forward", "forward", "side"]
    assert float(rows[2]["least"]) == pytest.approx(side["least"], abs=1e-6)
    assert float(rows[0]["mean"]) == pytest.approx(forward["mean"], abs=1e-6)


def test_a_strip_of_which_an_image_sees_no_ground_is_named(tmp_path: pathlib.Path) -> None:
    result = run("overlap", *strips_scene(tmp_path, tilted=True), "--strips", "--json")
    assert result.exit_code == 0, result.stderr
    content = json.loads(result.stdout)
    assert [one["kind"] for one in content["strips"]] == ["forward", "forward"]
    assert list(content["strips_without_side"]) == ["2"]
    assert "strip 2: its side overlap is unknown: s1i2: " in result.stderr


def test_strips_that_are_none_are_refused(tmp_path: pathlib.Path, shots_file: pathlib.Path) -> None:
    given = "--scene", scene_file(), "--shots", shots_file, "--dem", DEM
    assert_refused(run("overlap", *given, "--strips"), "--strips: the course of the 3 images is that of one strip")
    text = shots_file.read_text().splitlines()
    lines = [f"{text[0]},strip", *(f"{line},{name}" for line, name in zip(text[1:], "aab", strict=True))]
    shots_file.write_text("\n".join(lines) + "\n")
    assert_refused(run("overlap", *given, "--strips"), "strip b has one image; a strip needs two or more")


def change_rows(given: tuple[str, ...], change: Callable[[list[list[str]]], list[list[str]]]) -> None:
    """Change the rows, as cells, of the table of shots that is the file of the option --shots."""
    path = pathlib.Path(given[given.index("--shots") + 1])
    header, *rows = path.read_text().splitlines()
    path.write_text(
        "\n".join([header, *(",".join(cells) for cells in change([row.split(",") for row in rows]))]) + "\n"
    )


def displaced(rows: list[list[str]], strip: str, north: float, east: float, turn: bool = False) -> list[list[str]]:
    """Rows of which those of a strip are displaced in m, and with `turn` lie one after the other to the east."""
    found = []
    for k, (name, lat, lon, height, heading, *rest) in enumerate(rows):
        if rest[-1] == strip:
            place = (36.3, -84.25 + 250.0 * k / STRIP_METRES[1]) if turn else (float(lat), float(lon))
            lat, lon = f"{place[0] + north / STRIP_METRES[0]:.8f}", f"{place[1] + east / STRIP_METRES[1]:.8f}"
            heading = "90" if turn else heading
        found.append([name, lat, lon, height, heading, *rest])
    return found


def test_images_one_after_the_other_askew_are_said(tmp_path: pathlib.Path) -> None:
    """From strip to strip, 600 m to the east and 500 m to the north."""
    given = strips_scene(tmp_path)
    change_rows(given, lambda rows: displaced([rows[0], [*rows[7][:4], "0", *rows[7][5:]]], "B", 500.0, 0.0))
    result = run("overlap", *given)
    assert "invalid_input: s0i0 and s1i0: the way from one image to the next is along neither side" in result.stderr
    change_rows(given, lambda rows: displaced(rows, "B", -250.0, -600.0))
    assert "is along neither side" not in run("overlap", *given).stderr


@pytest.mark.parametrize("turn", [False, True])
def test_strips_of_which_none_lie_side_by_side_are_said(tmp_path: pathlib.Path, turn: bool) -> None:
    """One behind the other, and across each other."""
    given = strips_scene(tmp_path, named=True)
    change_rows(given, lambda rows: displaced(rows, "B", 0.0 if turn else 9000.0, 0.0, turn))
    result = run("overlap", *given, "--strips", "--json")
    assert result.exit_code == 0, result.stderr
    assert "no strips lie side by side" in result.stderr
    content = json.loads(result.stdout)
    assert [(row["kind"], row["strip"]) for row in content["strips"]] == [("forward", "A"), ("forward", "B")]
    assert list(content["strips_without_side"]) == ["A", "B"]
    assert all("no strips lie side by side" in why for why in content["strips_without_side"].values())


def test_a_strip_across_two_others_is_said_to_have_no_side(tmp_path: pathlib.Path) -> None:
    given = strips_scene(tmp_path, named=True)
    more = lambda rows: [[f"c{k}", *row[1:-1], "C"] for k, row in enumerate(rows) if row[-1] == "B"]  # noqa: E731
    change_rows(given, lambda rows: displaced([*rows, *more(rows)], "C", 0.0, -1000.0, turn=True))
    result = run("overlap", *given, "--strips", "--json")
    assert result.exit_code == 0, result.stderr
    assert "strip C: no other strip lies beside it" in result.stderr
    assert list(json.loads(result.stdout)["strips_without_side"]) == ["C"]


@pytest.mark.parametrize("empty", [[5], list(range(8))])
def test_a_shot_without_a_strip_is_refused(tmp_path: pathlib.Path, empty: list[int]) -> None:
    given = strips_scene(tmp_path, named=True)
    change_rows(given, lambda rows: [[*row[:-1], "" if k in empty else row[-1]] for k, row in enumerate(rows)])
    name = "s1i2" if empty == [5] else "s0i0"
    result = run("overlap", *given, "--strips")
    assert_refused(result, f"data row {empty[0] + 1} of --shots FILE (shot {name})", 'nothing in the column "strip"')


def test_a_shot_under_the_wrong_strip_is_named(tmp_path: pathlib.Path) -> None:
    given = strips_scene(tmp_path, named=True)
    change_rows(given, lambda rows: [[*row[:-1], "B" if k == 1 else row[-1]] for k, row in enumerate(rows)])
    result = run("overlap", *given, "--strips")
    assert_refused(result, "the shots of strip B do not lie on a line: s0i1 is 5", "m off that of its neighbours")


def test_shots_of_a_strip_are_put_in_order_of_flight(tmp_path: pathlib.Path) -> None:
    """With the overlaps of the table in order."""
    given = strips_scene(tmp_path, named=True)
    change_rows(given, lambda rows: [rows[k] for k in (1, 4, 0, 7, 2, 5, 3, 6)])
    result = run("overlap", *given, "--strips", "--json")
    assert result.exit_code == 0, result.stderr
    assert "strip A: its shots are not in order of flight" in result.stderr
    content = json.loads(result.stdout)
    assert [one["before"] for one in content["pairs"]][:3] == ["s0i0", "s0i1", "s0i2"]
    for one in content["strips"][:2]:
        assert one["least"] == pytest.approx(1.0 - 250.0 / 800.0, abs=5e-3)


@pytest.mark.costly
def test_a_plan_has_the_spacing_for_a_side_overlap(tmp_path: pathlib.Path) -> None:
    """Over level ground 0.7 of the width; flown at it, the strips have the wanted overlap."""
    (tmp_path / "nadir.toml").write_text(NADIR)
    records = [f"{10.0 * k},{36.3 + 250.0 * k / STRIP_METRES[0]:.8f},-84.25,1500,0,0,0" for k in range(6)]
    (tmp_path / "flight.csv").write_text("\n".join([f"time_s,{POSE}", *records]) + "\n")
    given = ("--scene", tmp_path / "nadir.toml", "--navigation", tmp_path / "flight.csv", "--ground", "500")
    line = ("plan", *given, "--camera-datum", "ellipsoid", "--overlap", "0.6", "-o", tmp_path / "p.csv")
    result = run(*line, "--side-overlap", "0.3", "--json")
    assert result.exit_code == 0, result.stderr
    (strip,) = json.loads(result.stdout)["strips"]
    for side in ("left", "right"):
        assert strip[f"{side}_m"] == pytest.approx(700.0, abs=1.0)
        assert strip[f"{side}_least"] == pytest.approx(0.3, abs=2e-4)
    said = f"next strip for a side overlap of 0.3 at least: {strip['left_m']:.1f} m to the left"
    assert said in " ".join(result.stderr.split())
    assert "strips" not in json.loads(run(*line, "--json").stdout)
    assert_refused(run(*line, "--side-overlap", "30"), "--side-overlap 30: must be in [0, 1), a share: 0.3 for 30 %")


@pytest.mark.costly
def test_a_plan_becomes_footprints_and_overlaps_by_files(tmp_path: pathlib.Path) -> None:
    """The exposures that `plan` writes are shots of `footprint` and of `overlap`: the same places and overlaps."""
    (tmp_path / "nadir.toml").write_text(NADIR)
    records = [f"{10.0 * k},{36.3 + 250.0 * k / STRIP_METRES[0]:.8f},-84.25,1500,0,0,0" for k in range(5)]
    (tmp_path / "flight.csv").write_text("\n".join([f"time_s,{POSE}", *records]) + "\n")
    exposures, outlines, overlaps = (tmp_path / name for name in ("plan.csv", "outlines.geojson", "overlaps.csv"))
    scene = ("--scene", tmp_path / "nadir.toml", "--ground", "500")
    flight = ("--navigation", tmp_path / "flight.csv", "--camera-datum", "ellipsoid")
    timing = ("--overlap", "0.6", "--timing", "velocity-height")
    assert run("plan", *scene, *flight, *timing, "-o", exposures).exit_code == 0
    shots = (*scene, "--shots", exposures)
    assert run("footprint", *shots, "--tolerance", "20", "-o", outlines).exit_code == 0
    assert run("overlap", *shots, "-o", overlaps).exit_code == 0
    with open(exposures, newline="") as file:
        planned = list(csv.DictReader(file))
    with open(overlaps, newline="") as file:
        found = list(csv.DictReader(file))
    features = json.loads(outlines.read_text())["features"]
    assert len(planned) == len(features) == len(found) + 1 >= 4
    for one, feature in zip(planned, features, strict=True):
        ring = np.array(feature["geometry"]["coordinates"][0])
        assert ring[:, 0].min() < float(one["lon_deg"]) < ring[:, 0].max()
        assert ring[:, 1].min() < float(one["lat_deg"]) < ring[:, 1].max()
        assert feature["properties"]["complete"] is True
        assert feature["properties"]["covered_share"] == 1.0
    for one, pair in zip(planned[1:], found, strict=True):
        for place in ("near", "far"):
            assert float(pair[place]) == pytest.approx(float(one[f"overlap_{place}"]), abs=2e-6)
    assert [float(pair["near"]) for pair in found] == pytest.approx([0.6] * len(found), abs=2e-3)


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".kml"])
def test_files_say_which_footprints_are_partial(tmp_path: pathlib.Path, suffix: str) -> None:
    """An image with its upper part above the horizon has no outline, `complete` is false, and a share sees ground."""
    (tmp_path / "nadir.toml").write_text(NADIR)
    rows = ["a,36.3,-84.25,1500,0,0,0,ellipsoid,9", "b,36.3,-84.25,1500,0,80,0,ellipsoid,9"]
    shots = tmp_path / "shots.csv"
    shots.write_text("\n".join([f"name,{POSE},height_datum,covered_share", *rows]) + "\n")
    output = tmp_path / f"out{suffix}"
    given = "--scene", tmp_path / "nadir.toml", "--shots", shots, "--ground", "500", "--tolerance", "20"
    result = run("footprint", *given, "-o", output, "--json")
    assert result.exit_code == 0, result.stderr
    if suffix == ".geojson":
        found = [one["properties"] for one in json.loads(output.read_text())["features"]]
    else:
        _, _, _, columns = pyogrio.raw.read(output)
        names = pyogrio.read_info(output)["fields"]
        found = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
    whole, partial = found
    assert bool(whole["complete"]) is True
    assert whole["covered_share"] == 1.0
    assert bool(partial["complete"]) is False
    dip = np.arccos(6371.0 / 6372.0)  # of the horizon of level ground, from 1 km above it
    rows_seen = 400.0 + 1000.0 * np.tan(np.deg2rad(90.0 - 80.0) - dip)
    assert partial["covered_share"] == pytest.approx(rows_seen / 800.0, abs=0.01)
    assert partial["covered_share"] == json.loads(result.stdout)["footprints"][1]["covered_share"]
