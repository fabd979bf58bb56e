"""One grammar for all commands: flags, refusals in a line, exit codes, one JSON object, no input overwritten."""

from __future__ import annotations

import csv
import io
import itertools
import json
import os
import pathlib
import re
import subprocess
import sys
import types
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from support.command_files import DEM, FILES, prepare
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.cli._common import report_errors
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._locate_options import GroundOptions, LocateOptions, ObservationOptions
from jaxgeo.cli._results import plain
from jaxgeo.cli._screen import bars_on_stderr, stderr, track, working
from jaxgeo.status import Status

GROUP = typer.main.get_command(app)
SCENE = "--scene scene.toml --dem dem.tif"
SMALL = "image.tif --scene scene.toml --dem dem.tif"
MOST_MEMORY = 12_000_000_000  # bytes of addresses, several times what is resident
SIGMAS = "--position-sigma 20 --attitude-sigma 0.3"


def commands_of(group, above: tuple[str, ...] = ()):
    """(words, command) of all commands."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands_of(command, (*above, name))
        else:
            yield (*above, name), command


COMMANDS = dict(commands_of(GROUP))
NAMES = [" ".join(words) for words in COMMANDS]


def run(line: str):
    return CliRunner().invoke(app, line.split(), prog_name="jaxgeo")


def options_of(words: tuple[str, ...]) -> dict[str, object]:
    """Options of a command by their long names."""
    return {
        next((one for one in param.opts if one.startswith("--")), ""): param
        for param in COMMANDS[words].params
        if param.opts[0].startswith("-")
    }


@pytest.fixture
def folder(tmp_path: pathlib.Path, monkeypatch):
    """Where commands are run; `folder(line)` writes the files that a line names, and tells their names."""
    monkeypatch.chdir(tmp_path)

    def prepared(line: str) -> set[str]:
        prepare(tmp_path, line)
        return {path.name for path in tmp_path.iterdir()}

    return prepared


@pytest.mark.parametrize("name", NAMES)
def test_flags_that_all_have(name: str) -> None:
    options = options_of(tuple(name.split()))
    assert {"--json", "--debug", "--quiet"} <= set(options)
    assert "--traceback" not in options
    if "--output" in options:
        assert "-o" in options["--output"].opts


QUIET = [
    pytest.param("locate DJI_0042.JPG --camera-datum ellipsoid --ground 300 --no-accuracy", marks=pytest.mark.costly),
    "scene DJI_0042.JPG --camera-datum ellipsoid -o out.toml",
    pytest.param("point --scene scene.toml --line-of-sight 250,18.5", marks=pytest.mark.costly),
]


@pytest.mark.parametrize("line", QUIET)
def test_quiet_leaves_nothing_on_stderr_but_errors(line: str, folder) -> None:
    folder(line)
    aloud, quiet = run(line), run(f"{line} --quiet")
    assert aloud.exit_code == quiet.exit_code == 0
    assert aloud.stderr
    assert quiet.stderr == ""
    assert quiet.stdout == aloud.stdout
    refused = run(f"{line} -q --debug --no-such")
    assert refused.exit_code == 2
    assert "--no-such: no such option" in refused.stderr
    assert run(line).stderr == aloud.stderr  # not kept from one command to the next


@pytest.mark.parametrize("name", NAMES)
def test_every_flag_says_what_it_is_for(name: str) -> None:
    for flag, option in options_of(tuple(name.split())).items():
        assert option.help, flag


# A command line for every flag that there is; what it takes, as it takes it. They are all parsed here, and the shorter
# ones are run; what the flags do is tested beside the commands.
LINES = [
    "inspect DJI_0042.JPG --camera-datum ellipsoid --json --tags --debug",
    "inspect DJI_0042.JPG --takeoff-height 800 -o exposures.csv",
    "inspect DJI_0042.JPG --camera-datum ellipsoid --camera focal=8.8mm,pitch=2.41um --gimbal 30,-90,0 --json",
    "inspect flight.klv --image-size 640,480 --upright --keep-damaged --json",
    "inspect opk.csv --source-crs EPSG:32616 --camera-datum EPSG:5773 --json",
    "inspect reconstruction.json --camera one --camera-datum -31 --json",
    "point --scene scene.toml --line-of-sight 250,18.5 --pixel 1200,2400 --json",
    "scene DJI_0042.JPG --camera-datum ellipsoid -o out.toml --json --debug",
    "dem --json --debug",
]
LONG_LINES = [
    f"locate {SCENE} --shots shots.csv --dem-datum EPSG:5773 --format geojson --shard 1/1 --debug",
    "locate DJI_0042.JPG --camera-datum ellipsoid --ground 300 --pixel 10,20 --exposure DJI_0042.JPG --accuracy "
    "--probability 0.95 --position-sigma 1 --gimbal-sigma 0.2 --focal-sigma 3px --principal-sigma 2,1px "
    "--dem-sigma 4 --refraction -o fixes.geojson --crs EPSG:32616 --heights EPSG:5773 --mgrs --json",
    "report DJI_0042.JPG --camera-datum ellipsoid --ground 300 --dem-datum EPSG:5773 --pixel 10,20 --exposure "
    "DJI_0042.JPG --probability 0.95 --position-sigma 1 --gimbal-sigma 0.2 --focal-sigma 3px "
    "--principal-sigma 2px --dem-sigma 4 --title Title --details 1 -o out.html --json --debug",
    f"report {SCENE} --shots shots.csv --shard 1/1 --details 0 -o out.html",
    f"footprint {SCENE} --shots shots.csv --dem-datum EPSG:5773 --camera-datum ellipsoid --tolerance 30 "
    "-o out.geojson --crs EPSG:32616 --edges --json --debug",
    f"point {SCENE} --target 36.27,-84.268,900 --dem-datum EPSG:5773 --target-datum ellipsoid --json --debug",
    f"overlap {SCENE} --navigation flight.csv --times 101,103 --along rows --dem-datum EPSG:5773 "
    "--camera-datum ellipsoid -o out.csv --format csv --json --debug",
    f"overlap {SCENE} --shots shots.csv",
    f"overlap {SCENE} --shots strips.csv --strips",
    "footprint DJI_0042.JPG --camera-datum ellipsoid --dem dem.tif",
    "point DJI_0042.JPG --camera-datum ellipsoid --target 36.3155,-84.104,340 --target-datum EPSG:5773 --json",
    "point --scene scene.toml --position 36.318,-84.105,5500 --attitude 160,1,-0.5 --line-of-sight 250,18.5 --json",
    f"plan {SCENE} --navigation flight.csv --overlap 0.9 --timing ground --place near --start 110 --along rows "
    "--side-overlap 0.3 --dem-datum EPSG:5773 --camera-datum ellipsoid -o out.csv --json --debug",
    f"rectify {SMALL} --crs EPSG:32616 --bounds 745000,4018500,745900,4019400 --resolution 15 --band 1 --json "
    "--interpolation cubic --cog --status --no-hidden-mask --dem-datum EPSG:5773 -o out.tif --debug",
    f"rectify {SMALL} --like ortho.tif -o out.tif",
    f"accuracy-map {SCENE} --dem-datum EPSG:5773 --crs EPSG:32616 --resolution 1000 --samples 0 "
    "--probability 0.95 --json -o out.tif",
    "validate images --points points.csv --points-datum ellipsoid --camera-datum ellipsoid --dem dem.tif --point-sigma "
    "0.1 --pixel-sigma 1 --calibrate out.toml --json -o out.png",
    f"register {SMALL} --reference ortho.tif {SIGMAS} --focal-sigma 1px --principal-sigma 1px "
    "--reference-sigma 5 --registration-sigma 0.1 --dem-sigma 1 --dem-correlation 300 "
    "--dem-datum EPSG:5773 --block 200 --probability 0.99 --pixel 40,150 "
    "--band 1 --reference-band 1 -o results --json --debug",
]
READING = (
    "--nodata -9999 --nodata 0 --height-unit ft --dem-band 1 --dem-bounds -85,36,-84,37 --assume-wgs84 --allow-remote "
    "--allow-outside --mirror https://host --proxy http://host:1 --offline"
)
FILE = (
    "--takeoff-height 8 --source-crs EPSG:32616 --camera a --image-size 64,48 --upright --keep-damaged --stream 1 "
    "--errors e --no-velocities --interior i --reconstruction 1 --gimbal 1,2,3 --positions p --time 1 --exposure a"
)
MANY = "locate DJI_0042.JPG --camera-datum ellipsoid --ground 300 --cluster local:1 --resume -o fixes"
MANY_MORE = [
    "rectify images --camera-datum ellipsoid --dem dem.tif --cluster local:1 --resume -o orthos",
    "rectify reconstruction.json --images images --camera-datum ellipsoid --dem dem.tif -o orthos",
    "rectify FILE --dem dem.tif --takeoff-height 8 --source-crs EPSG:32616 --camera a --image-size 64,48 --upright "
    "--keep-damaged --stream 1 --errors e --no-velocities --interior i "
    "--reconstruction 1 --gimbal 1,2,3 --positions p --time 1 "
    "-o out.tif",
    "report images --camera-datum ellipsoid --ground 300 --cluster local:1 -o out.html",
    "accuracy-map images --camera-datum ellipsoid --dem dem.tif --cluster local:1 --resume --exposure a -o maps",
    "accuracy-map FILE --ground 300 --takeoff-height 8 --source-crs EPSG:32616 --camera a --image-size 64,48 --upright "
    "--keep-damaged --stream 1 --errors e --no-velocities --interior i "
    "--reconstruction 1 --gimbal 1,2,3 --positions p --time 1 "
    "-o out.tif",
    f"accuracy-map {SCENE} {READING} -o out.tif",
    f"validate {SCENE} --points points.csv --points-datum ellipsoid --pixel-origin corner {READING} -o out.png",
    "validate FILE --points p --ground 300 --takeoff-height 8 --source-crs EPSG:32616 --camera a --image-size 64,48 "
    "--upright --keep-damaged --stream 1 --errors e --no-velocities --interior i "
    "--reconstruction 1 --gimbal 1,2,3 --positions p "
    "--time 1",
    f"validate {SCENE} --points p --refraction --position-sigma 1 --attitude-sigma 1 --gimbal-sigma 0.2 --focal-sigma "
    "3px --principal-sigma 2px --dem-sigma 4 --dem-correlation 400 --dem-datum EPSG:5773 --calibrate e.toml "
    "--each-axis --debug",
    f"accuracy-map {SCENE} --refraction --position-sigma 1 --attitude-sigma 1 --gimbal-sigma 0.2 --focal-sigma 3px "
    "--principal-sigma 2px --dem-sigma 4 --dem-correlation 400 --bounds 1,2,3,4 --cog --debug -o out.tif",
]
FIELD = f"locate {SCENE} --attitude-sigma 0.1 --dem-correlation 400 --json"
PARSED = [  # whose files are not made here, or whose work is that of lines that are run
    MANY,
    *MANY_MORE,
    f"locate {SCENE} {READING}",
    f"locate {SCENE} -o fixes.gpkg --style",
    f"report {SCENE} {READING} -o out.html",
    f"footprint {SCENE} {READING}",
    f"point {SCENE} --target 36.27,-84.268 {READING}",
    f"overlap {SCENE} --shots shots.csv {READING}",
    f"plan {SCENE} --navigation flight.csv --overlap 0.9 {READING} -o out.csv",
    f"plan FILE --dem dem.tif --overlap 0.9 {FILE} -o out.csv",
    f"plan FILE --ground 300 --dem-datum EPSG:5773 --overlap 0.9 {FILE} -o out.csv",
    f"rectify {SMALL} {READING} -o out.tif",
    f"register {SMALL} --reference ortho.tif {SIGMAS} {READING} -o results",
    f"adjust FILE --images i --dem dem.tif {FILE.removesuffix(' --exposure a')} --camera-datum ellipsoid --dem-sigma 2 "
    "--points 100 --least-correlation 0.6 --no-self-calibrate --crs EPSG:32616 --dem-datum EPSG:5773 -o out --json "
    "--debug",
    f"adjust FILE --dem dem.tif {READING} -o out",
    "adjust FILE --images i --dem dem.tif --reference map.tif --reference-sigma 0.5 --register a --register b "
    "--measure orientation --features sift -o out",
    "adjust FILE --images i --dem dem.tif --shots-by 0.2s --flights-by folder --mounting-sigma 0.5 -o out",
    "adjust FILE --images i --dem dem.tif --camera-datum ellipsoid --gcp gcp_list.txt --gcp-datum EPSG:5773 "
    "--gcp-sigma 0.02,0.02,0.04 --pixel-sigma 0.5 --pixel-origin corner --check 7 --check 9 --report "
    "--mosaic m.tif --resolution 0.1 -o out",
    "adjust FILE --images i --dem dem.tif --time-offset-sigma 0.05 --readout -0.03 --readout-sigma 0.01 --refraction "
    "-o out",
    f"footprint FILE --dem dem.tif {FILE}",
    f"footprint FILE --ground 300 --dem-datum EPSG:5773 {FILE} -o footprints.gpkg --style",
    f"point FILE --target 1,2,3 {FILE} --camera-datum ellipsoid",
    f"overlap FILE --dem dem.tif {FILE}",
    f"overlap FILE --ground 300 --dem-datum EPSG:5773 {FILE}",
    f"inspect FILE --dem dem.tif --dem-datum EPSG:5773 {READING}",
    f"scene FILE --dem dem.tif --dem-datum EPSG:5773 {READING} -o out.toml",
    f"scene FILE {FILE} --scene camera.toml --camera-datum ellipsoid -o out.toml",
    f"register FILE --reference ortho.tif --dem dem.tif {FILE.removesuffix(' --exposure a')} --camera-datum ellipsoid "
    "-o out",
    f"study gu2017 --image a --reference b --dem c --scene d {READING}",
    f"report {SCENE} --attitude-sigma 0.1 --dem-correlation 400 --refraction --details 0 -o out.html",
    "dem 36.3,-84.2 --radius 100 --archive srtm --mirror https://host --proxy http://host:1 --offline -o out.tif",
    "dem --bounds -85,36,-84,37 --archive https://host/{S}{W}.tif --dem-datum EPSG:5773",
    "dem --for FILE --scene s --camera-datum EPSG:5773 --takeoff-height 8 --source-crs EPSG:32616 --camera a "
    "--image-size 64,48 --upright --keep-damaged --stream 1 --errors e --no-velocities --interior i "
    "--reconstruction 1 --gimbal 1,2,3 "
    "--positions p --time 1",
    "dem --geoid EPSG:3855 --clear-cache",
    "locate images --detections found.csv --pixel-origin corner --anchor bottom",
    "locate images --detections labels --class-names data.yaml",
    "report images --detections found.csv --pixel-origin corner --anchor bottom -o out.html",
    "report images --detections labels --class-names data.yaml -o out.html",
    f"view {SCENE} --shots shots.csv --shard 1/1 --dem-datum EPSG:5773 --attitude-sigma 0.1 --dem-correlation 400 "
    f"{READING}",
    "view images --pixel 10,20 --ground 300 --probability 0.95 --position-sigma 1 --gimbal-sigma 0.2 --focal-sigma 3px "
    "--principal-sigma 2px --dem-sigma 4 --refraction --images images --tiles URL --port 8000 --no-browser --json "
    "--debug",
    f"view FILE {FILE} --camera-datum ellipsoid",
    "view images --detections found.csv --pixel-origin corner --anchor bottom",
    "view images --detections labels --class-names data.yaml",
    "inspect video.ts --stream 1 --time 00:00:01",
    "inspect flight.klv -o track.gpx",
    "inspect mission.sbet --errors smrmsg.out --no-velocities",
    "inspect ext_param.geojson --interior int_param.yaml",
    "inspect reconstruction.json --reconstruction 1",
    "inspect images --positions geo.txt",
    "locate images --positions geo.txt",
    "report images --positions geo.txt -o out.html",
    "locate FILE --takeoff-height 8 --source-crs EPSG:32616 --camera a --image-size 64,48 --upright --keep-damaged "
    "--stream 1 --errors e --no-velocities --interior i --reconstruction 1 --gimbal 1,2,3 --time 1",
    "report FILE --takeoff-height 8 --source-crs EPSG:32616 --camera a --image-size 64,48 --upright --keep-damaged "
    "--stream 1 --errors e --no-velocities --interior i --reconstruction 1 --gimbal 1,2,3 --time 1 -o out.html",
    f"register {SMALL} --reference ortho.tif {SIGMAS} --gimbal-sigma 0.1 --measure orientation -o out",
    "doctor --json --debug",
    "demo -o picture.png --write-scene scene.toml --write-dem dem.tif --json --debug",
    "study all -o out --seed 1 --json --debug",
    "study li2020 -o out --seed 1 --json --debug",
    "study li2023 -o out --samples 100 --seed 1 --cluster local:1 --json --debug",
    "study xue2019 -o out --size 500 --trials 3 --seed 1 --plane-limit 0.3 --height-limit 0.4 --limit-source A --json "
    "--debug",
    "study gu2017 -o out --seed 1 --image a --reference b --dem c --scene d --dem-datum EPSG:5773 "
    "--position-sigma 50 --attitude-sigma 0.5 --json --debug",
]


def parsed(line: str):
    """(command's words, context) of a line."""
    words = line.split()
    name = tuple(words[:2]) if words[0] == "study" else (words[0],)
    return name, COMMANDS[name].make_context("jaxgeo", words[len(name) :])


def test_no_flag_is_without_a_line() -> None:
    used: dict[tuple[str, ...], set[str]] = {}
    for line in [*LINES, *LONG_LINES, FIELD, *PARSED]:
        name, context = parsed(line)
        given = {param for param in context.params if _is_given(context, param)}
        used.setdefault(name, set()).update(given)
    for name, command in COMMANDS.items():
        everywhere = {"help", "quiet"}  # of all commands, for which there is one test
        missing = {param.name for param in command.params if param.name not in everywhere} - used[name]
        assert not missing, f"{' '.join(name)}: no command line in the tests has {', '.join(sorted(missing))}"


def _is_given(context, name: str) -> bool:
    return context.get_parameter_source(name).name == "COMMANDLINE"


def as_one_object(result, name: str) -> dict:
    told = json.loads(result.stdout)
    assert list(told)[:4] == ["command", "jaxgeo", "inputs", "assumed"]
    assert told["command"] == name
    assert "numpy" in told["versions"]
    assert isinstance(told["assumed"], list)
    return told


def check_line(folder, line: str) -> None:
    before = folder(line)
    words = line.split()
    result = run(line)
    assert result.exit_code == 0, result.output
    assert "Traceback" not in result.stderr
    written = [word for flag, word in itertools.pairwise(words) if flag == "-o"]
    now = {path.name for path in pathlib.Path().iterdir()}
    assert set(written) <= now
    assert all(name.startswith(pathlib.Path(written[0]).stem) for name in now - before)
    if "--json" in words:
        told = as_one_object(result, words[0])
        assert not {"debug", "as_json"} & set(told["inputs"])
        assert told["inputs"]


@pytest.mark.parametrize("line", LINES, ids=[line[:40] for line in LINES])
def test_lines(folder, line: str) -> None:
    check_line(folder, line)


@pytest.mark.slow
@pytest.mark.parametrize("line", LONG_LINES, ids=[line[:40] for line in LONG_LINES])
def test_long_lines(folder, line: str) -> None:
    check_line(folder, line)


@pytest.mark.parametrize("table, is_field", [("terrain_correlation_m = 400\n", True), ("", False)])
def test_a_field_of_heights_is_noticed_before_anything_is_compiled(tmp_path, table: str, is_field: bool) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(f"[errors]\nterrain_m = 5\n{table}", encoding="utf-8")
    ground = GroundOptions(dem=["dem.tif"])
    for given in (ObservationOptions(scene=scene), ObservationOptions(files=[scene])):
        assert LocateOptions(given, ground).has_terrain_field is is_field
        assert LocateOptions(given, ground, sigmas=Sigmas(dem_correlation=400.0)).has_terrain_field


@pytest.mark.slow
def test_samples_of_a_field_of_heights_from_a_shell(folder) -> None:
    """What XLA's older emitter needs over 17 GB to compile: the command's own choice of compiler takes 2."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    folder(FIELD)
    command = f"ulimit -v {MOST_MEMORY // 1024} && exec {sys.executable} -m jaxgeo {FIELD}"
    done = subprocess.run(["sh", "-c", command], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (fix,) = as_one_object(SimpleNamespace(stdout=done.stdout), "locate")["fixes"]
    assert fix["status"] == "hit"
    assert fix["ce90_m"] > 100.0


REFUSED = [
    (
        "adjust DJI_0042.JPG --camera-datum ellipsoid --dem dem.tif -o out",
        r"DJI_0042\.JPG: adjust needs two images or more; give a folder of images, or a file of poses with --images .*",
    ),
    (
        "adjust images --camera-datum ellipsoid --dem dem.tif --resolution 1 -o out",
        r"--resolution is for the cells of a mosaic; give --mosaic FILE too\.",
    ),
    (
        "adjust images --camera-datum ellipsoid --dem dem.tif --gcp gcp_list.txt -o out",
        r"--gcp gcp_list\.txt: state the vertical datum of its heights with --gcp-datum.*",
    ),
    (
        "adjust images --camera-datum ellipsoid --dem dem.tif --shots-by 0.2 -o out",
        r"--shots-by 0\.2: expected name, or a time such as 0\.2s \(s, min or h; above zero\)\.",
    ),
    (
        "adjust images --camera-datum ellipsoid --dem dem.tif --features sift --measure orientation -o out",
        r"--measure orientation: is how areas are compared, but --features sift matches keypoints; give one of .*",
    ),
    (
        "adjust images --camera-datum ellipsoid --dem dem.tif --readout 30 -o out",
        r"--readout 30: give the readout time in s, up to 10: 0\.03 is 30 ms\.",
    ),
    ("locte", r"locte: no such command; did you mean locate\? See jaxgeo --help\."),
    ("study li2024", r"li2024: no such command; did you mean li20\d\d\? See jaxgeo study --help\."),
    ("--frobnicate", r"--frobnicate: no such option\. See jaxgeo --help\."),
    (f"footprint {SCENE} --tolerence 3", r"--tolerence: .* did you mean --tolerance\? See jaxgeo footprint --help\."),
    (f"footprint {SCENE} --tolerance fine", r"--tolerance.*: expected a number\. See jaxgeo footprint --help\."),
    (f"footprint {SCENE} --tolerance", r"--tolerance: its value is missing\. See .*--help\."),
    ("plan --dem dem.tif --overlap 0.1 -o out.csv", r"give a FILE that jaxgeo inspect reads, or --scene SCENE\.toml\."),
    (f"plan {SCENE} --overlap 0.1 -o out.csv", r"give --navigation FILE with a scene, or a FILE of exposures.*"),
    ("footprint --dem", r"--dem: its value is missing\. See .*--help\."),
    ("rectify --scene scene.toml", r"IMAGE is missing: The image.*\. See jaxgeo rectify --help\."),
    (f"rectify {SMALL} --band x -o a.tif", r"--band.*: expected a whole number\. See jaxgeo rectify --help\."),
    (
        f"rectify {SMALL} --interpolation bilinar -o a.tif",
        r"--interpolation 'bilinar': expected nearest or bilinear or cubic; did you mean bilinear\? .*",
    ),
    ("doctor here", r"here: unexpected argument; .*\? See jaxgeo doctor --help\."),
    (f"footprint {SCENE} --traceback", r"--traceback: no such option\. See jaxgeo footprint --help\."),
    ("footprint --scene none.toml --dem dem.tif", r"none\.toml: .*"),
    ("footprint --scene scene.toml --dem none.tif", r".*none\.tif.*"),
    ("footprint --scene scene.toml --dem scene.toml", r"scene\.toml: .*"),
    ("footprint --scene dem.tif --dem dem.tif", r"dem\.tif: .*"),
    (f"footprint {SCENE} --shots empty.csv", r"empty\.csv: .*"),
    (f"overlap {SCENE} --shots header.csv", r"header\.csv: .*no rows.*"),
    (f"plan {SCENE} --navigation empty.csv --overlap 0.1 -o out.csv", r"empty\.csv: .*"),
    (f"plan {SCENE} --navigation scene.toml --overlap 0.1 -o out.csv", r"scene\.toml.*"),
    ("inspect none.JPG", r"none\.JPG: .*no such file.*"),
    ("inspect cut.klv", r"cut\.klv: .*packet.*"),
    ("inspect empty.csv", r"empty\.csv: .*empty.*"),
    ("inspect plain.JPG", r"plain\.JPG: .*"),
    ("locate plain.JPG --ground 300", r"plain\.JPG: .*"),
    ("locate cut.klv --ground 300", r"cut\.klv: .*packet.*"),
    ("inspect noise.tif", r"noise\.tif: .*"),
    ("inspect deep.json", r"deep\.json: more than 64 levels of lists.*"),
    ("inspect cut.sbet", r"cut\.sbet: .*136.*"),
    (
        f"locate {SCENE} --dem-datum 5773.5",
        r"dem\.tif: --dem-datum 5773\.5 would be a constant undulation.*|--dem-datum 5773\.5 would .*",
    ),
    ("inspect opk.csv --camera-datum ellipsoid", r"opk\.csv.* states no CRS: .*, such as --source-crs EPSG:32616 .*"),
    ("rectify noise.tif --scene scene.toml --dem dem.tif -o out.tif", r"noise\.tif: .*"),
    ("footprint --scene scene.toml --dem noise.tif", r"noise\.tif: .*"),
    ("locate --scene scene.toml --dem noise.tif", r"noise\.tif: .*"),
    (f"footprint {SCENE} -o no/out.gpkg", r"--output no/out\.gpkg: there is no folder no;.*"),
    (f"overlap {SCENE} --shots shots.csv -o no/out.csv", r"--output no/out\.csv: there is no folder no;.*"),
    (f"plan {SCENE} --navigation flight.csv --overlap 0.1 -o no/out.csv", r"--output no/out\.csv: .*no folder.*"),
    ("inspect flight.klv -o no/out.csv", r"--output no/out\.csv: there is no folder no;.*"),
    (
        "validate DJI_0042.JPG --points gcp_list.txt --camera-datum ellipsoid --ground 300",
        r"--points gcp_list\.txt: state the vertical datum of its heights with --points-datum.*",
    ),
    (
        "validate DJI_0042.JPG --points points.csv --points-datum ellipsoid --camera-datum ellipsoid --dem dem.tif",
        r"image DJI_0043\.JPG of point P2 is not among the images: DJI_0042\.JPG\.",
    ),
    (
        "validate DJI_0042.JPG --points empty.csv --points-datum ellipsoid --camera-datum ellipsoid --dem dem.tif",
        r"empty\.csv: .*",
    ),
    ("validate DJI_0042.JPG --points points.csv --ground 3 --each-axis", r"--each-axis is for the calibrated sigmas.*"),
    ("validate DJI_0042.JPG --points points.csv --ground 3 -o a.gif", r"--output a\.gif: unsupported .*; use \.png.*"),
    ("validate DJI_0042.JPG --points points.csv --ground 3 --calibrate a.csv", r"--calibrate a\.csv: .*; use \.toml\."),
    ("demo -o no/out.png", r"--output no/out\.png: there is no folder no;.*"),
    ("study li2020 -o empty.csv", r"--output empty\.csv: this is a file; name a folder for the results\."),
    ("study gu2017 --image image.tif", r"a real image needs --reference, --dem, --scene as well;.*"),
]
MADE_WRONG = {
    "empty.csv": b"",
    "header.csv": b"lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,gimbal_outer_deg,gimbal_inner_deg\n",
    "noise.tif": bytes(range(256)) * 4,
    "deep.json": b"[" * 100_000,
}


def make_wrong(line: str) -> None:
    """Files that are none of what their names say."""
    for word in line.split():
        if word in MADE_WRONG:
            pathlib.Path(word).write_bytes(MADE_WRONG[word])
    if "cut.klv" in line:
        whole = pathlib.Path("whole.klv")
        FILES["flight.klv"](whole)
        pathlib.Path("cut.klv").write_bytes(whole.read_bytes()[:40])
        whole.unlink()
    if "cut.sbet" in line:
        whole = pathlib.Path("whole.sbet")
        FILES["mission.sbet"](whole)
        pathlib.Path("cut.sbet").write_bytes(whole.read_bytes()[:-40])
        whole.unlink()
    if "plain.JPG" in line:
        from PIL import Image

        Image.new("RGB", (8, 6)).save("plain.JPG")


@pytest.mark.costly
@pytest.mark.parametrize("line, pattern", REFUSED, ids=[line[:50] for line, _ in REFUSED])
def test_a_mistake_is_one_line(folder, line: str, pattern: str) -> None:
    folder(line)
    make_wrong(line)
    before = {path.name: path.stat().st_mtime_ns for path in pathlib.Path().iterdir()}
    result = run(line)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    (told,) = result.stderr.splitlines()
    assert re.fullmatch(f"jaxgeo: (?:{pattern})", told), told
    assert {path.name: path.stat().st_mtime_ns for path in pathlib.Path().iterdir()} == before


@pytest.mark.parametrize("output, crs", [("a.kml", "EPSG:32616"), ("a.gpkg", "EPSG:99999")])
def test_a_map_that_the_output_cannot_have_is_told_before_the_work(folder, monkeypatch, output: str, crs: str) -> None:
    line = f"locate DJI_0042.JPG --camera-datum ellipsoid --ground 300 -o {output} --crs {crs}"
    folder(line)
    monkeypatch.setattr("jaxgeo.cli.locate.locate_inputs", failing(AssertionError("it was computed")))
    result = run(line)
    assert result.exit_code == 2, result.output
    assert result.stderr.splitlines()[-1].startswith(f"jaxgeo: {output}: ")
    assert not pathlib.Path(output).exists()


OVERWRITING = [
    "inspect opk.csv --source-crs EPSG:32616 --camera-datum ellipsoid -o opk.csv",
    f"footprint {SCENE} --shots shots.csv -o shots.gpkg",
    f"footprint {SCENE} -o dem.gpkg",
    f"overlap {SCENE} --shots shots.csv -o shots.csv",
    f"overlap {SCENE} --navigation flight.csv --times 101,103 -o flight.csv",
    f"plan {SCENE} --navigation flight.csv --overlap 0.1 -o flight.csv",
    f"rectify {SMALL} -o image.tif",
    f"rectify {SMALL} --like ortho.tif -o ortho.tif",
    f"locate {SCENE} --shots shots.csv -o shots.csv",
]


@pytest.mark.parametrize("line", OVERWRITING, ids=[line[:40] for line in OVERWRITING])
def test_what_is_read_is_not_overwritten(folder, line: str) -> None:
    folder(line)
    output = pathlib.Path(line.split()[-1])
    if not output.exists():
        source = next(path for path in pathlib.Path().iterdir() if path.stem == output.stem)
        output.symlink_to(source)  # under another name, and yet one file
    before = output.read_bytes()
    result = run(line)
    assert result.exit_code == 2, result.output
    assert result.stderr.count("\n") == 1
    assert f"--output {output}: this is an input, and would be overwritten; name another." in result.stderr
    assert output.read_bytes() == before


def test_the_scene_of_the_package_is_not_overwritten_by_itself() -> None:
    from jaxgeo.demo import scene_file

    before = scene_file().read_bytes()
    result = run(f"demo --write-scene {scene_file()} -o nowhere/x.png")
    assert result.exit_code == 2
    assert "this is an input" in result.stderr
    assert scene_file().read_bytes() == before


@pytest.mark.parametrize("shell, words", [("bash", "complete -o default -F"), ("zsh", "compdef"), ("fish", "complete")])
def test_completion_is_shown(shell: str, words: str, monkeypatch) -> None:
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    result = CliRunner().invoke(app, ["--show-completion", shell], prog_name="jaxgeo")
    assert result.exit_code == 0, result.output
    assert words in result.stdout
    assert "_JAXGEO_COMPLETE" in result.stdout


@pytest.mark.parametrize(
    "typed, expected",
    [
        ("jaxgeo over", {"overlap"}),
        ("jaxgeo footprint --tol", {"--tolerance"}),
        ("jaxgeo rectify --interpolation ", {"nearest", "bilinear", "cubic"}),
        ("jaxgeo overlap --along c", {"columns"}),
        ("jaxgeo study ", {"all", "li2020", "li2023", "xue2019", "gu2017"}),
    ],
)
def test_completion_completes(typed: str, expected: set[str]) -> None:
    words = typed.split(" ")
    environment = {"_JAXGEO_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(words) - 1)}
    result = CliRunner().invoke(app, [], prog_name="jaxgeo", env=environment)
    assert expected <= {word.split(",")[-1] for word in result.stdout.split()}, result.output


def test_the_version_is_told() -> None:
    result = run("--version")
    assert result.exit_code == 0
    assert re.fullmatch(r"jaxgeo (\d+\.\d+.*|not installed)\n", result.stdout)


def test_help_tells_the_codes_of_exit() -> None:
    text = " ".join(run("--help").stdout.split())
    for words in ("0 done", "1 done, but without a result", "2 usage", "70 internal error", "130 interrupted"):
        assert words in text


def test_without_anything_there_is_help() -> None:
    result = run("")
    assert "footprint" in result.output
    assert "Traceback" not in result.output


def failing(error: BaseException):
    """A function that raises an error as one of the package's would."""

    def fail(*_: object, **__: object) -> None:
        raise error

    names = {**fail.__globals__, "__name__": "jaxgeo.made_for_a_test"}
    return types.FunctionType(fail.__code__, names, closure=fail.__closure__)


@pytest.mark.parametrize(
    "error, code, words",
    [
        (ZeroDivisionError("by\nnothing"), 70, "internal error: unexpected ZeroDivisionError (by nothing);"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (ImportError("no module named x; pip install 'jaxgeo[gis]'"), 2, "pip install 'jaxgeo[gis]'"),
        (MemoryError(), 2, "out of memory"),
    ],
    ids=["fault", "Ctrl-C", "extra", "memory"],
)
@pytest.mark.parametrize("more", ["", " --debug"])
def test_what_goes_wrong_is_one_line(folder, monkeypatch, error, code: int, words: str, more: str) -> None:
    monkeypatch.setattr("jaxgeo.io.scene.read_scene", failing(error))
    line = f"footprint {SCENE} -o out.gpkg"
    before = folder(line)
    result = run(line + more)
    assert result.exit_code == code
    lines = result.stderr.splitlines()
    assert words in lines[-1]
    assert lines[-1].startswith("jaxgeo: ")
    is_shown = bool(more) and code != 130
    assert ("Traceback" in result.stderr) == is_shown
    assert is_shown or len(lines) == 1
    assert {path.name for path in pathlib.Path().iterdir()} == before


def test_a_closed_pipe_is_no_mistake() -> None:
    with pytest.raises(BrokenPipeError), report_errors(debug=False):
        raise BrokenPipeError


@pytest.mark.slow
def test_a_reader_that_leaves_is_not_told(tmp_path: pathlib.Path) -> None:
    """`jaxgeo inspect ... --json | head -1`, with more to say than a pipe holds."""
    source = tmp_path / "eo.csv"
    rows = [f"{k},36.3,-84.1,{900 + k},0,0,0" for k in range(3000)]
    source.write_text("\n".join(["image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg", *rows]) + "\n")
    command = [sys.executable, "-m", "jaxgeo", "inspect", str(source), "--camera-datum", "ellipsoid", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "{\n"
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode in (0, 1)


@pytest.mark.costly
@pytest.mark.skipif(os.name != "posix", reason="a shell closes it")
def test_a_closed_stdout_is_no_fault() -> None:
    command = ["sh", "-c", '"$0" -m jaxgeo --version >&-', sys.executable]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_progress_is_not_shown_where_nobody_sees_it(capsys) -> None:
    with working("working"):
        assert list(track([1, 2], "counting")) == [1, 2]
    assert capsys.readouterr() == ("", "")


def test_progress_goes_to_stderr(capsys, monkeypatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    assert stderr().is_terminal
    with working("pondering"):
        pass
    list(track([1, 2], "counting"))
    with bars_on_stderr():
        print("a bar of the library's")
    out, err = capsys.readouterr()
    assert out == ""
    for words in ("pondering", "counting", "a bar of the library's"):
        assert words in err


def test_json_holds_what_python_has(tmp_path: pathlib.Path) -> None:
    given = {
        "a": np.float64("nan"),
        "b": np.arange(3),
        "c": [Status.hit, tmp_path, (1, 2.5)],
        4: np.bool_(True),
        "d": None,
    }
    told = plain(given)
    assert told == {"a": None, "b": [0, 1, 2], "c": ["hit", str(tmp_path), [1, 2.5]], "4": True, "d": None}
    assert json.loads(json.dumps(told, allow_nan=False)) == told


def test_json_has_all_digits_and_the_readings_of_the_screen(folder) -> None:
    line = "point --scene scene.toml --line-of-sight 250,18.5"
    folder(line)
    shown, told = run(line), run(f"{line} --json")
    assert shown.exit_code == told.exit_code == 0
    content = as_one_object(told, "point")
    assert [f"{name}_deg = {value:.6f}" for name, value in content["readings_deg"].items()] == shown.stdout.splitlines()
    assert content["status"] == "hit"
    assert content["inputs"] == {"scene": "scene.toml", "line_of_sight": "250,18.5"}
    assert told.stderr == shown.stderr


@pytest.mark.costly
def test_an_answer_that_there_is_not_is_told_as_json_too(folder) -> None:
    line = "point --scene scene.toml --line-of-sight 250,-60 --json"
    folder(line)
    result = run(line)
    assert result.exit_code == 1
    assert as_one_object(result, "point")["status"] == "outside_gimbal_range"


@pytest.mark.slow
def test_json_of_overlaps_is_the_table_with_all_digits(folder) -> None:
    line = f"overlap {SCENE} --shots shots.csv -o out.csv --json"
    folder(line)
    result = run(line)
    assert result.exit_code == 0, result.output
    pairs = as_one_object(result, "overlap")["pairs"]
    rows = list(csv.DictReader(io.StringIO(pathlib.Path("out.csv").read_text())))
    assert [pair["status"] for pair in pairs] == [row["status"] for row in rows]
    for pair, row in zip(pairs, rows, strict=True):
        assert pair["near"] == pytest.approx(float(row["near"]), abs=1e-6)


def test_studies_as_json(monkeypatch) -> None:
    """Every table, a row as names and cells."""
    from jaxgeo.studies.sheet import Sheet

    sheet = Sheet("one", "One", {"what": "", "how much": ".1f"}, [["a", 1.23456], ["b", None]], "Made up.")
    study = SimpleNamespace(run=lambda **_: None, sheets_of=lambda _: [sheet])
    monkeypatch.setattr("jaxgeo.studies.li2020.run", study.run)
    monkeypatch.setattr("jaxgeo.studies.li2020.sheets_of", study.sheets_of)
    result = run("study li2020 --json")
    assert result.exit_code == 0, result.output
    (table,) = as_one_object(result, "study li2020")["tables"]
    assert table["rows"] == [{"what": "a", "how much": 1.23456}, {"what": "b", "how much": None}]
    assert [line.partition(" about ")[0] for line in result.stderr.splitlines()] == ["jaxgeo: takes"]


def test_the_dem_of_the_examples_is_that_of_the_package() -> None:
    assert DEM.is_file()
    assert os.access(DEM, os.R_OK)
