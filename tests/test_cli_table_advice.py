"""Refusals of tables, logs and positions print what to type next; followed as it is printed, that leads to fixes."""

from __future__ import annotations

import pathlib
import shlex

import numpy as np
import pytest
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.io.scene import read_scene
from tests.io.test_flight_logs import airdata, subtitles
from tests.test_cli_advice import printed

UTM = "--source-crs EPSG:32616"
DATUMS = ["--camera-datum ellipsoid", "--camera-datum EPSG:5773"]
LENS = "--camera focal=8.8mm,pitch=2.41um,size=5472x3648"
LENSES = ["--scene SCENE.toml", LENS, "--camera film=24mm,size=3840x2160"]
TAKEOFF = "--takeoff-height"
SCENE = """[camera]
width = 5472
height = 3648
focal_length_mm = 8.8
pixel_pitch_um = 2.41
[gimbal]
kind = "two_axis"
outer_deg = 72.0
inner_deg = 5.0
[pose]
lat_deg = 36.3
lon_deg = -84.2
height_m = 900.0
height_datum = "ellipsoid"
heading_deg = 0.0
pitch_deg = 0.0
roll_deg = 0.0
"""
PLACE = "751000.12 4020000.34 900.5"
# What is written, and what each refusal must print, one after the other, until there is a fix.
FILES: dict[str, tuple[str, list[list[str]]]] = {
    "pix4d.txt": (f"imageName X Y Z Omega Phi Kappa\na.JPG {PLACE} 5 -12 89\n", [[UTM], DATUMS, LENSES]),
    "metashape.txt": (
        f"# Cameras (1)\n# PhotoID, X, Y, Z, Omega, Phi, Kappa\n{'a ' + PLACE + ' 5 -12 89'}\n".replace("  ", " "),
        [[UTM], DATUMS, LENSES],
    ),
    "reference.csv": (
        f'#CoordinateSystem: PROJCS["WGS 84 / UTM zone 16N"]\n#Label,X/East,Y/North,Z/Altitude,Yaw,Pitch,Roll\n'
        f"a,{PLACE.replace(' ', ',')},30,20,0\n",
        [DATUMS, LENSES],
    ),
    "realitycapture.csv": (
        f"#name,x,y,alt,heading,pitch,roll\na,{PLACE.replace(' ', ',')},30,20,0\n", [[UTM], DATUMS, LENSES],
    ),
    "micmac.txt": (
        "#F=N Y X Z K W P\na.JPG 36.3 -84.2 900.0 30 -20 0\n", [["--source-crs EPSG:4326"], DATUMS, LENSES],
    ),
    "block.ori": (
        "             101                    751000.12000   4020000.34000       900.50000\n"
        "  0.000000000000 -1.000000000000  0.000000000000  1.000000000000  0.000000000000\n"
        "  0.000000000000  0.000000000000  0.000000000000  1.000000000000\n",
        [[UTM], DATUMS, LENSES],
    ),
    "itera.dat": (f"ORIA a {PLACE} -1.333 0.556 99.2 1\n", [[UTM], DATUMS, LENSES]),
    "earth.csv": (
        "image;lat;lon;alt;yaw;pitch;roll\na;36,3;-84,2;900,0;30;20;0\n", [DATUMS, [LENS]],
    ),
    "DJI_0001.SRT": (subtitles(), [[*DATUMS, TAKEOFF], LENSES]),
    "airdata.csv": (airdata(), [[*DATUMS, TAKEOFF], LENSES]),
}  # fmt: skip


def run(*words: str):
    return CliRunner().invoke(app, [*words])


@pytest.mark.costly
@pytest.mark.parametrize("name", FILES)
def test_following_the_advice_leads_to_a_file_that_is_read(tmp_path: pathlib.Path, monkeypatch, name: str) -> None:
    """Each way out that is printed is taken as it is printed: it brings the next refusal, or a fix."""
    text, steps = FILES[name]
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "SCENE.toml").write_text(SCENE, encoding="utf-8")
    monkeypatch.setattr("jaxgeo.cli.locate._locate_rows", lambda options, *rest: _inputs_only(options))
    given: list[str] = []
    for number, ways in enumerate(steps):
        result = run("locate", name, "--ground", "300", *given)
        assert result.exit_code == 2, result.output
        (line,) = result.stderr.strip().splitlines()
        told = printed(line)
        assert set(ways) <= set(told), line
        for way in told:
            value = ["300"] if way == TAKEOFF else []
            result = run("locate", name, "--ground", "300", *given, *shlex.split(way), *value)
            is_last = number == len(steps) - 1
            if is_last:
                assert result.exit_code == 0, (way, result.output)
            else:
                assert set(steps[number + 1]) <= set(printed(result.stderr)), (way, result.stderr)
        given += shlex.split(ways[0])


def _inputs_only(options) -> None:
    """All that `locate` reads and checks, without a program of JAX."""
    from jaxgeo._checks import enable_x64
    from jaxgeo.cli._locate_inputs import inputs_of

    enable_x64()
    inputs_of(options, False)


@pytest.mark.parametrize("name", ["pix4d.txt", "realitycapture.csv", "DJI_0001.SRT"])
def test_of_a_scene_the_camera_alone_belongs_to_angles_of_the_camera(tmp_path: pathlib.Path, name: str) -> None:
    """A gimbal's readings on top of angles that hold them already would be tens of degrees off, without a word."""
    from jaxgeo.io import read_observations

    (tmp_path / name).write_text(FILES[name][0], encoding="utf-8")
    scene = tmp_path / "SCENE.toml"
    scene.write_text(SCENE, encoding="utf-8")
    how = {} if name.endswith("SRT") else {"crs": "EPSG:32616"}
    observed = read_observations(tmp_path / name, scene=scene, height_datum="ellipsoid", **how)
    assert observed.gimbal_names == ()
    sensor = observed.batches[0].sensor
    assert sensor.gimbal.names == ()
    assert any("without gimbal and mount" in one for one in observed.assumed)
    camera = read_scene(scene).sensor.camera
    np.testing.assert_array_equal(np.asarray(sensor.camera.focal_px)[0], camera.focal_px)


def test_positions_alone_say_how_they_are_used(tmp_path: pathlib.Path, monkeypatch) -> None:
    from tests.io.test_positions import DJI, GEO, MARK, packet, write_image

    monkeypatch.chdir(tmp_path)
    (tmp_path / "images").mkdir()
    write_image(tmp_path / "images" / "DJI_0001.JPG", packet(DJI), make="DJI")
    for name, text in (("geo.txt", GEO), ("Timestamp.MRK", MARK.format(1, 36.3, -84.2, 50))):
        (tmp_path / name).write_text(text)
        result = run("inspect", name)
        assert result.exit_code == 2
        (way,) = printed(result.stderr)
        assert way == f"--positions {name}"
        result = run("inspect", "images", *shlex.split(way))
        assert result.exit_code == 0, result.output
        if name == "geo.txt":
            assert "--camera-datum ellipsoid" in printed(" ".join(result.output.split()))
            assert run("inspect", "images", *shlex.split(way), "--camera-datum", "ellipsoid").exit_code == 0
