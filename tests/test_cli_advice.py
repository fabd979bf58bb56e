"""Refusals of drone images print what to type next: every option in them is run as it is printed."""

from __future__ import annotations

import json
import pathlib
import re
import shlex
from typing import Any

import pytest
from support.command_runner import CliRunner
from support.drone_image_files import CAMERA, FULL, PLACE, packet, write_image

from jaxgeo.cli import app
from jaxgeo.cli._option_names import as_typed
from tests.test_cli_locate import DJI, GROUND

ANGLES = [f"drone-dji:Gimbal{name}Degree" for name in ("Yaw", "Pitch", "Roll")]
LENSLESS = {name: value for name, value in DJI.items() if "Calibrated" not in name}
CAMERA_FILE = "[camera]\nwidth = 40\nheight = 30\nfocal_length_mm = 8.8\npixel_pitch_um = 240.0\n"
LENSES = ["--camera focal=8.8mm,pitch=2.41um", "--camera focal=8.8mm,sensor=13.2mm", "--camera focal=3666px"]
OF_OPENSFM = {"projection_type": "perspective", "width": 40, "height": 30, "focal": 8.8 / 0.24 / 40}
LENSES += ["--camera camera.toml", "--camera cameras.json"]
DATUMS = ["--camera-datum ellipsoid"]
# Tags of XMP, options of the file, options typed beside, what is refused, and the ways out that are printed.
CASES: dict[str, tuple[dict[str, Any], dict[str, Any], list[str], str, list[str]]] = {
    "no focal length": (LENSLESS, {"exif": {}}, DATUMS, "nothing says what the focal length is", LENSES),
    "digital zoom": (DJI, {"exif": CAMERA | {0xA404: 2.0}}, DATUMS, "magnified 2 times", LENSES),
    "cut": (DJI, {"size": (40, 20)}, DATUMS, "it was cut or turned", LENSES[:3]),
    "calibration of another size": (
        DJI | {"drone-dji:CalibratedOpticalCenterX": "100", "drone-dji:CalibratedOpticalCenterY": "100"},
        {},
        DATUMS,
        "the calibration is of another size of image",
        LENSES,
    ),
    "a focal length that does not fit": (
        DJI | {"drone-dji:CalibratedFocalLength": "36.6"},
        {},
        DATUMS,
        "does not fit an image",
        LENSES,
    ),
    "a lens without a unit": (DJI, {}, [*DATUMS, "--camera focal=8.8"], "focal=8.8 is not a number above zero", LENSES),
    "a pixel size in mm": (
        DJI,
        {},
        [*DATUMS, "--camera focal=8.8mm,pitch=2.41mm"],
        "pitch=2.41mm is not a number above zero in um (pitch=2.41um?)",
        LENSES,
    ),
    "a camera that is not known": (DJI, {}, [*DATUMS, "--camera FC9998"], "is not in the table of cameras", LENSES),
    "another size than the table's": (DJI, {}, [*DATUMS, "--camera ZH20T"], "has images of 4056 x 3040", LENSES),
    "angles all zero": (
        DJI | dict.fromkeys(ANGLES, "+0.00") | {"drone-dji:FlightYawDegree": "+121.30"},
        {},
        DATUMS,
        "how the camera was turned is unknown",
        ["--gimbal aircraft,-90,0"],
    ),
    "no angles": (
        {name: value for name, value in DJI.items() if name not in ANGLES},
        {},
        DATUMS,
        "nothing says how the camera was turned",
        ["--gimbal 0,-90,0"],
    ),
    "a decimal comma": (DJI | {ANGLES[1]: "-60,0"}, {}, DATUMS, "a decimal comma", ["--gimbal 0,-90,0"]),
    "half a gimbal": (
        {name: value for name, value in DJI.items() if name != ANGLES[2]},
        {},
        DATUMS,
        "all three are needed",
        ["--gimbal 0,-90,0"],
    ),
    "altitude 0": (
        DJI | {"drone-dji:AbsoluteAltitude": "+0.00"},
        {"gps": PLACE | {6: 0.0}},
        [],
        "its height is unknown",
        ["--takeoff-height"],
    ),
}


def run(*words: str):
    return CliRunner().invoke(app, ["inspect", *words])


def printed(line: str) -> list[str]:
    """Options with their values, as a line tells them."""
    found = re.findall(r"--[a-z][a-z-]*(?: [^\s();]*[^\s();.,:])?", line)
    return list(dict.fromkeys(found))


@pytest.mark.costly
@pytest.mark.parametrize("case", CASES)
def test_every_way_out_works_as_it_is_printed(tmp_path: pathlib.Path, monkeypatch, case: str) -> None:
    tags, options, typed, reason, ways = CASES[case]
    monkeypatch.chdir(tmp_path)
    write_image(tmp_path / "a.jpg", packet(tags), make="DJI", **options)
    (tmp_path / "camera.toml").write_text(CAMERA_FILE)
    (tmp_path / "cameras.json").write_text(json.dumps({"one": OF_OPENSFM}))
    given = [word for one in typed for word in shlex.split(one)]
    result = run("a.jpg", *given)
    assert result.exit_code != 0
    (line,) = result.stderr.strip().splitlines()
    assert reason in line
    told = [one for one in printed(line) if not one.startswith("--camera '")]
    assert set(ways) <= set(told)
    for way in told:
        name = way.split()[0]
        if case == "cut" and way in ("--camera camera.toml", "--camera cameras.json"):
            continue  # of images of that shape
        others = [word for one in typed if not one.startswith(name) for word in shlex.split(one)]
        value = ["300"] if way == "--takeoff-height" else []
        result = run("a.jpg", *others, *shlex.split(way), *value)
        assert result.exit_code == 0, (way, result.stderr)


@pytest.mark.parametrize(
    "lens, length",
    [("focal=120mm,pitch=0.144mm", 120.0 / 0.144), ("focal=12cm,pitch=144um", 120.0 / 0.144), ("film=3.6cm", None)],
)
def test_a_length_in_another_unit_is_proposed_in_the_right_one(tmp_path: pathlib.Path, lens: str, length) -> None:
    """The proposal, typed in its place, is the camera that was meant."""
    path = write_image(tmp_path / "a.jpg", packet(DJI), make="DJI")
    refused = run(f"{path}", *DATUMS[0].split(), "--camera", lens)
    assert refused.exit_code == 2, refused.output
    (meant,) = re.findall(r"\((\w+=[0-9.]+[a-z]+)\?\)", refused.stderr)
    name = meant.partition("=")[0]
    typed = ",".join(meant if part.startswith(f"{name}=") else part for part in lens.split(","))
    result = run(f"{path}", *DATUMS[0].split(), "--camera", typed, "--json")
    assert result.exit_code == 0, result.output
    sensor = json.loads(result.stdout)["sensor"]
    diagonal = (sensor["width"] ** 2 + sensor["height"] ** 2) ** 0.5
    expected = (
        36.0 / (36.0**2 + 24.0**2) ** 0.5 * diagonal if length is None else length * sensor["width"] / FULL[0]
    )  # resized
    assert sensor["focal_px"] == pytest.approx([expected, expected])


RTK = DJI | {"drone-dji:RtkFlag": "50", "drone-dji:AbsoluteAltitude": "+700.0", "drone-dji:RelativeAltitude": "+99.9"}


@pytest.mark.parametrize(
    "typed, words",
    [
        (["--camera-datum", "EPSG:5773"], r"Altitudes by RTK \(RtkFlag 50\) .* above EPSG:5773, .* 31\.\d m lower\."),
        (
            ["--takeoff-height", "624.5"],
            r"gives 600\.1 m above the ellipsoid for the take-off, 24\.4 m lower than --take",
        ),
        (["--takeoff-height", "610"], ""),  # the model explains it
    ],
)
def test_heights_by_rtk_contradict_what_is_typed(tmp_path: pathlib.Path, typed: list[str], words: str) -> None:
    path = write_image(tmp_path / "a.jpg", packet(RTK), make="DJI")
    told = [one for one in json.loads(run(str(path), *typed, "--json").stdout)["assumed"] if one.startswith("Check")]
    assert len(told) == bool(words)
    for one in told:
        assert re.search(words, one)
        (way,) = re.findall(r"Give (--camera-datum [a-z]+)", one)
        right = json.loads(run(str(path), *way.split(), "--json").stdout)
        assert right["exposures"][0]["height_m"] == 700.0
        assert not any(sentence.startswith("Check") for sentence in right["assumed"])
        assert "Heights are above the WGS 84 ellipsoid, as given." in right["assumed"]


def test_a_scene_gives_its_camera(tmp_path: pathlib.Path) -> None:
    """Its lens with its errors and its air, whatever the tags say; the pose is the image's."""
    path = write_image(tmp_path / "a.jpg", packet(LENSLESS), make="DJI", exif={})
    scene = tmp_path / "scene.toml"
    scene.write_text(f'{CAMERA_FILE}[gimbal]\nkind = "fixed"\n[errors]\nfocal_px = 0.5\n')
    words = ["locate", str(path), *GROUND, "--no-accuracy", "--json"]
    result = CliRunner().invoke(app, [*words, "--scene", str(scene)])
    assert result.exit_code == 0, result.stderr
    assert "Only the camera, its lens errors and the atmosphere of" in result.stderr
    both = CliRunner().invoke(app, [*words, "--scene", str(scene), "--camera", "focal=3666px"])
    assert "both give a camera; leave one out" in both.stderr


@pytest.mark.parametrize(
    "python, command",
    [
        ('give camera="focal=8.8mm,pitch=2.41um" (so)', "give --camera focal=8.8mm,pitch=2.41um (so)"),
        ('camera="Phantom 4 Pro".', "--camera 'Phantom 4 Pro'."),
        ("gimbal_deg=(121.3, -90, 0).", "--gimbal 121.3,-90,0."),
        ('gimbal_deg=("aircraft", -90, 0).', "--gimbal aircraft,-90,0."),
        ("Give height_datum=: x", "Give --camera-datum: x"),
        ("as takeoff_height=.", "as --takeoff-height."),
        ("leave size= of camera= out", "leave size= of --camera out"),
        ("no image is of camera='falcon'; they", "no image is of --camera 'falcon'; they"),
    ],
)
def test_words_of_readers_become_those_of_the_command_line(python: str, command: str) -> None:
    assert as_typed(python) == command
