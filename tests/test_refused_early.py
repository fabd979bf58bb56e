"""Arguments that cannot work are refused before anything is compiled, by every command and by the writers.

A row is a call and words of its refusal; all run in one fresh process, in which compiling a program is a fault.
"""

from __future__ import annotations

import functools
import json
import os
import pathlib
import subprocess
import sys
from typing import Any

import pytest
from support import refused_early

from jaxgeo.cli import app

SCENE = "--scene scene.toml --dem dem.tif"
LOCATE = "jaxgeo locate scene.toml --dem dem.tif"
SHOTS = "jaxgeo locate --scene scene.toml --dem dem.tif --shots"
REPORT = f"jaxgeo report {SCENE}"
FOOTPRINT = f"jaxgeo footprint {SCENE}"
OVERLAP = f"jaxgeo overlap {SCENE} --navigation flight.csv"
PLAN = f"jaxgeo plan {SCENE} --navigation flight.csv"
RECTIFY = f"jaxgeo rectify image.tif {SCENE}"
REGISTER = f"jaxgeo register image.tif --reference ortho.tif {SCENE} --attitude-sigma 0.3"
GU = f"jaxgeo study gu2017 --image image.tif --reference ortho.tif {SCENE}"
NO_CODE = "--crs '+proj=tmerc +lon_0=-84'"
MOON = "--crs IAU_2015:30110"
MAP = "jaxgeo.io.write_accuracy_map('a.tif', scene.sensor, scene.shot, dem, errors, {})"
ORTHO = "jaxgeo.io.rectify_file('a.tif', 'image.tif', scene.sensor, scene.shot, dem, {})"
MAP_OF_LEVEL = "jaxgeo.io.write_accuracy_map('a.tif', scene.sensor, scene.shot, level, errors)"

COMMANDS = (
    (f"{LOCATE} --probability 1.5", "--probability 1.5: must be between 0 and 1"),
    (f"{LOCATE} --pixel 10", "expected COLUMN,ROW"),
    (f"{LOCATE} --exposure a", "--exposure needs a FILE"),
    (f"{LOCATE} --ground 300", "give one of them"),
    ("jaxgeo locate scene.toml --ground high", "expected a height in m"),
    ("jaxgeo locate scene.toml --dem nowhere.tif", "nowhere.tif"),
    (f"{LOCATE} --dem-sigma -1", "--dem-sigma -1: a standard deviation must be zero or more"),
    (f"{LOCATE} --focal-sigma 5", "a length with its unit"),
    (f"{LOCATE} --gimbal-sigma 1,2,3", "expected one number in deg, or OUTER,INNER"),
    (f"{LOCATE} --no-accuracy --dem-sigma 1", "leave one out"),
    (f"{LOCATE} -o nowhere/a.csv", "there is no folder nowhere"),
    (f"{LOCATE} -o locked/a.csv", "it may not be written"),
    (f"{LOCATE} -o .", "this is a folder"),
    (f"{LOCATE} -o dem.tif.csv/a.csv", "there is no folder"),
    (f"{LOCATE} -o a.txt", "unsupported file type .txt"),
    (f"{LOCATE} -o a.kml --format csv", "--format csv conflicts with --output a.kml"),
    (f"{LOCATE} --mgrs", "--mgrs need --output FILE"),
    (f"{LOCATE} -o a.csv --crs EPSG:99999", "PROJ does not know crs"),
    (f"{LOCATE} -o a.csv --crs EPSG:5773", "a map needs a projected or geographic crs"),
    (f"{LOCATE} -o a.csv --heights EPSG:99999", "is no vertical CRS that PROJ knows"),
    (f"{LOCATE} -o a.kml --crs EPSG:32616", "KML has longitudes and latitudes on WGS 84"),
    (f"{LOCATE} -o a.geojson {NO_CODE}", "GeoJSON names a crs by its code"),
    (f"{SHOTS} with-kind.csv -o a.geojson", "the attribute 'kind' is one that the file has by itself"),
    (f"{SHOTS} with-geometry.csv -o a.gpkg", "the attribute 'geometry' is one that the file has by itself"),
    (f"{SHOTS} with-ce90_m.csv --accuracy --position-sigma 1 -o a.csv", "the attribute 'ce90_m' is one"),
    (f"{SHOTS} shots.csv -o shots.csv", "this is an input, and would be overwritten"),
    (f"without pyarrow: {LOCATE} -o a.parquet", "pip install 'jaxgeo[gis]'"),
    (f"without mgrs: {LOCATE} -o a.csv --mgrs", "pip install 'jaxgeo[gis]'"),
    (f"without pyogrio: {LOCATE} -o a.gpkg", "pip install 'jaxgeo[gis]'"),
    (f"without pyogrio: {FOOTPRINT} -o a.gpkg", "pip install 'jaxgeo[gis]'"),
    ("jaxgeo locate DJI_0042.JPG --dem dem.tif", "--camera-datum"),
    ("jaxgeo locate DJI_0042.JPG --dem dem.tif --camera-datum ellipsoid --exposure a", "no exposure has this name"),
    ("jaxgeo locate DJI_0042.JPG --dem dem.tif --camera-datum ellipsoid --stream 1", "takes no --stream"),
    ("jaxgeo locate DJI_0042.JPG --dem dem.tif --camera-datum ellipsoid --attitude-sigma 1", "give --gimbal-sigma"),
    (f"{REPORT} -o a.pdf", "unsupported file type .pdf; use .html"),
    (f"{REPORT} -o nowhere/a.html", "there is no folder nowhere"),
    (f"{REPORT} -o locked/a.html", "it may not be written"),
    (f"{REPORT} -o a.html --details -1", "--details -1"),
    (f"{REPORT} -o a.html --probability 0", "must be between 0 and 1"),
    (f"{REPORT} -o a.html --pixel 10", "expected COLUMN,ROW"),
    (f"without bokeh: {REPORT} -o a.html", "pip install 'jaxgeo[report]'"),
    (f"{FOOTPRINT} -o a.csv", "use .geojson, .json, .gpkg"),
    (f"{FOOTPRINT} -o nowhere/a.gpkg", "there is no folder nowhere"),
    (f"{FOOTPRINT} -o locked/a.gpkg", "it may not be written"),
    (f"{FOOTPRINT} -o a.gpkg --crs EPSG:99999", "PROJ does not know the crs"),
    (f"{FOOTPRINT} -o a.geojson {NO_CODE}", "GeoJSON names a crs by its code"),
    (f"{FOOTPRINT} --tolerance 0", "--tolerance 0: must be above 0 m"),
    (f"{FOOTPRINT} --camera-datum ellipsoid", "applies to the heights of a FILE of exposures"),
    (f"{FOOTPRINT} --shots shots.csv --camera-datum EPSG:99999", "is unknown to PROJ"),
    (f"{FOOTPRINT} --shots shots.csv -o shots.csv.gpkg/a.gpkg", "there is no folder"),
    (f"jaxgeo point {SCENE}", "give either --target"),
    (f"jaxgeo point {SCENE} --target 36.31", "expected LAT,LON"),
    (f"jaxgeo point {SCENE} --target 100,-84.25", "latitudes from -90 to 90; is it LON,LAT?"),
    (f"jaxgeo point {SCENE} --target 10,10", "the target is at 10.0000 deg north, 10.0000 deg east"),
    (f"jaxgeo point {SCENE} --target 10,10,300", "or leave --dem out"),
    ("jaxgeo point --scene scene.toml --target 36.31,-84.25", "give its height, LAT,LON,HEIGHT"),
    (
        "jaxgeo point --scene scene.toml --target 36.31,-84.25,300 --camera-datum EPSG:99999",
        "applies to the heights of a FILE of exposures",
    ),
    (
        f"jaxgeo point {SCENE} --target 36.31,-84.25 --camera-datum ellipsoid",
        "applies to the heights of a FILE of exposures",
    ),
    (f"jaxgeo point {SCENE} --line-of-sight 250,18", "--dem needs --target"),
    ("jaxgeo point --scene scene.toml --line-of-sight 250,100", "depression must lie in [-90, 90]"),
    (
        "jaxgeo point --scene scene.toml --line-of-sight 250,18 --pixel 9999,5",
        "outside the image of 2400 x 4800 pixels",
    ),
    ("jaxgeo point --scene scene.toml --line-of-sight 250,18 --dem-datum EPSG:5773", "leave it out"),
    ("jaxgeo point --scene scene.toml --line-of-sight 250,18 --nodata 0", "--nodata needs --dem"),
    (f"{OVERLAP} --times 101", "give at least two exposure times"),
    (f"{OVERLAP} --times 1,2", "1 s is outside flight.csv, which covers 100 to 120 s"),
    (f"{OVERLAP} --times 103,101", "decreasing times"),
    (f"{OVERLAP} --times 101,103 -o a.txt", "use .csv"),
    (f"{OVERLAP} --times 101,103 -o nowhere/a.csv", "there is no folder nowhere"),
    (f"{OVERLAP} --times 101,103 -o locked/a.csv", "it may not be written"),
    (f"jaxgeo overlap {SCENE} --shots one.csv", "overlap needs at least two rows"),
    (f"{PLAN} --overlap 1.2 -o a.csv", "must be in [0, 1)"),
    (f"{PLAN} -o a.csv", "needs --overlap"),
    (f"{PLAN} --overlap 0.1 -o a.gpkg", "use .csv"),
    (f"{PLAN} --overlap 0.1 -o nowhere/a.csv", "there is no folder nowhere"),
    (f"{PLAN} --overlap 0.1 -o locked/a.csv", "it may not be written"),
    (f"{PLAN} --overlap 0.1 --start 5 -o a.csv", "start must lie on the trajectory"),
    (f"{PLAN} --timing fixed:100 -o a.csv", "the navigation is too short"),
    (f"{PLAN} --timing fixed:0.000001 -o a.csv", "more than 10000 exposures in 20 s; give 0.002 s or more"),
    (f"{RECTIFY} -o a.png", "name a file that ends in .tif"),
    (f"{RECTIFY} -o nowhere/a.tif", "there is no folder nowhere"),
    (f"{RECTIFY} -o locked/a.tif", "no file can be written here"),
    (f"{RECTIFY} -o dem.tif", "this is an input, and would be overwritten"),
    (f"{RECTIFY} -o a.tif --crs EPSG:99999", "PROJ does not know the crs"),
    (f"{RECTIFY} -o a.tif --crs EPSG:5773", "a map needs a projected or geographic crs"),
    (f"{RECTIFY} -o a.tif {MOON}", "but a ballpark one"),
    (f"{RECTIFY} -o a.tif --resolution 0", "resolution must be positive"),
    (f"{RECTIFY} -o a.tif --bounds 1,2,3,4", "give the CRS of the bounds with --crs"),
    (f"{RECTIFY} -o a.tif --crs EPSG:32616 --bounds 4,3,2,1", "west < east"),
    (f"{RECTIFY} -o a.tif --crs EPSG:32616 --bounds 0,0,1e7,1e7 --resolution 0.01", "more than a file can have"),
    (f"{RECTIFY} -o a.tif --band 4", "there is no band 4"),
    (f"{RECTIFY} -o a.tif --like nowhere.tif", "nowhere.tif: no such file"),
    (f"{RECTIFY} -o a.tif --like image.tif", "this is on no map"),
    (f"jaxgeo rectify dem.tif {SCENE} -o a.tif --status --resolution 5,x", "one size, or ACROSS,DOWN"),
    (f"jaxgeo rectify ortho.tif {SCENE} -o a.tif", "the image has 400 columns and 400 rows"),
    (f"{REGISTER} --position-sigma 0 -o a", "give a standard deviation above zero"),
    (f"{REGISTER} --position-sigma 9 -o a --pixel 999,5", "outside the image of 256 x 192 pixels"),
    (f"{REGISTER} --position-sigma 9 -o a --block 10", "must be at least 32 cells"),
    (f"{REGISTER} --position-sigma 9 -o a --probability 0.4", "must be between 0.5 and 1"),
    (f"{REGISTER} --position-sigma 9 -o a --gimbal-sigma 1", "has no readings"),
    (f"{REGISTER} --position-sigma 9 -o a --focal-sigma 0.1mm", "is given in pixels"),
    (f"{REGISTER} --position-sigma 9 -o a --reference-sigma -3", "must be zero or more"),
    (f"{REGISTER} --position-sigma 9 -o a --band 3", "there is no band 3"),
    (f"{REGISTER} --position-sigma 9 -o a --reference-band 3", "there is no band 3"),
    (f"{REGISTER} --position-sigma 9 -o image.tif", "this is a file; name a folder"),
    (f"{REGISTER} --position-sigma 9 -o image.tif/a", "image.tif is a file"),
    (f"{REGISTER} --position-sigma 9 -o locked", "not writable"),
    (f"{REGISTER} --position-sigma 9 -o locked/a", "not writable"),
    ("jaxgeo study li2020 -o dem.tif", "this is a file; name a folder"),
    ("jaxgeo study li2020 -o locked", "not writable"),
    ("jaxgeo study li2023 --samples 1", "samples must be at least 2"),
    ("jaxgeo study li2023 --seed -1", "--seed -1: must be a whole number, 0 or more"),
    ("jaxgeo study xue2019 --size 0", "must be 243 m or more"),
    ("jaxgeo study xue2019 --trials -1", "trials must be 0 or more"),
    ("jaxgeo study xue2019 --seed -1", "--seed -1"),
    ("jaxgeo study gu2017 --seed -1", "--seed -1"),
    ("jaxgeo study all --seed -1", "--seed -1"),
    ("jaxgeo study xue2019 --plane-limit 0.3", "need --limit-source"),
    ("jaxgeo study xue2019 --limit-source CH/Z", "need --limit-source"),
    ("jaxgeo study xue2019 --height-limit 0 --limit-source CH/Z", "--height-limit 0: must be a length in m"),
    ("jaxgeo study gu2017 --image image.tif", "needs --reference, --dem, --scene as well"),
    ("jaxgeo study gu2017 --position-sigma 3", "applies to a real image"),
    (f"{GU} --position-sigma -1", "must be a standard deviation above zero"),
    (f"{GU} --attitude-sigma 0", "must be a standard deviation above zero"),
    (GU.replace("--image image.tif", "--image ortho.tif"), "the image has 400 columns and 400 rows"),
    ("jaxgeo demo -o a.foo", "unsupported file type .foo"),
    ("jaxgeo demo -o nowhere/a.png", "there is no folder nowhere"),
    ("jaxgeo demo -o locked/a.png", "it may not be written"),
    ("jaxgeo demo -o a.png --write-scene a.png", "the figure is written there"),
    ("jaxgeo demo -o a.png --write-scene nowhere/a.toml", "there is no folder nowhere"),
    ("jaxgeo inspect flight.klv -o nowhere/a.csv", "there is no folder nowhere"),
    ("jaxgeo inspect flight.klv -o a.txt", "use .csv"),
    ("jaxgeo inspect flight.klv -o flight.klv", "use .csv"),
)
STATEMENTS = (
    (MAP.format("crs='EPSG:99999'"), "PROJ does not know the crs"),
    (MAP.format("crs='IAU_2015:30110'"), "but a ballpark one"),
    (MAP.format("resolution=-1.0"), "resolution must be positive"),
    (MAP.format("bounds=(0.0, 0.0, 1.0, 1.0)"), "name it with crs="),
    (MAP.format("probability=1.5"), "probability"),
    (MAP.format("sampling=jaxgeo.Sampling(count=-1)"), "count must be a whole number"),
    (MAP.format("cuont=5"), "cuont"),
    (MAP.format("sampling=jaxgeo.Sampling(draws='sobol')"), "draws"),
    (MAP.replace("errors", "None").format(""), "errors"),
    (MAP.replace("a.tif", "a.png").format(""), "name a file that ends in .tif"),
    (MAP.replace("a.tif", "nowhere/a.tif").format(""), "there is no folder"),
    (MAP_OF_LEVEL, "no spacing; give the size of a cell"),
    (ORTHO.format("interpolation='cubic'"), "interpolation"),
    (ORTHO.format("hiden_tolerance=1.0"), "hiden_tolerance"),
    (ORTHO.format("bands=[4]"), "there is no band 4"),
    (ORTHO.format("crs='EPSG:5773'"), "a map needs a projected or geographic crs"),
)
CALLS = (*COMMANDS, *STATEMENTS)

pytestmark = pytest.mark.slow  # all calls run in one process, that of the first test


def run(*lines: str) -> dict[str, dict[str, Any]]:
    """What became of each call, all in one process that has compiled nothing."""
    tests = pathlib.Path(__file__).parent
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([f"{tests.parent}", f"{tests}"]), "JAXGEO_CACHE_DIR": ""}
    program = [sys.executable, refused_early.__file__]
    done = subprocess.run(program, check=False, input="\n".join(lines), env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return {one["line"]: one for one in map(json.loads, done.stdout.splitlines())}


@functools.cache
def refusals() -> dict[str, dict[str, Any]]:
    return run(*(line for line, _ in CALLS))


@pytest.mark.parametrize("line, words", CALLS, ids=[line for line, _ in CALLS])
def test_what_cannot_work_is_refused_before_anything_is_compiled(line: str, words: str) -> None:
    one = refusals()[line]
    assert (one["code"], one["programs"]) == (2, []), one["told"]
    assert words in one["told"]


def test_every_command_has_its_rows() -> None:
    named = {one.name for one in app.registered_commands} | {"study"}
    assert named == {line.split("jaxgeo ")[1].split()[0] for line, _ in COMMANDS}


def test_the_guard_sees_what_is_compiled() -> None:
    line = "jaxgeo locate scene.toml --ground 300 --no-accuracy"
    one = run(line)[line]
    assert one["code"] == 70
    assert one["programs"]
