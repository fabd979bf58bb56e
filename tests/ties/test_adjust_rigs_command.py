"""`jaxgeo adjust` on images of two cameras on one gimbal: shots and flights by name, time, folder and table."""

from __future__ import annotations

import json
import pathlib
import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.command_runner import CliRunner
from support.image_folder import ImageFolder
from support.rig_folder import write_rig_folder

from jaxgeo import Shot
from jaxgeo.cli import app
from jaxgeo.cli._adjust_rigs import RigOptions
from jaxgeo.cli._common import UserError

OPTIONS = ("--dem-datum", "ellipsoid", "--dem-sigma", "3", "--points", "60")


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, ["adjust", *map(str, arguments)])


@pytest.mark.parametrize(
    "given, words",
    [
        ({"shots_by": "0.2"}, r"--shots-by 0\.2: expected name, or a time such as 0\.2s \(s, min or h; above zero\)"),
        ({"shots_by": "-1s"}, r"--shots-by -1s: expected name, or a time"),
        ({"shots_by": "folder"}, r"--shots-by folder: expected name, or a time"),
        ({"flights_by": "20"}, r"--flights-by 20: expected folder, or a time such as 20min"),
        ({"mounting_sigma": -1.0}, r"--mounting-sigma"),
    ],
)
def test_wrong_values_are_refused_with_what_is_expected(given, words) -> None:
    with pytest.raises(UserError, match=words):
        RigOptions(**given).check_options()


@pytest.fixture(scope="module")
def here(tmp_path_factory) -> ImageFolder:
    return write_rig_folder(tmp_path_factory.mktemp("rig"))


def assert_refused(result, *words: str) -> None:
    assert result.exit_code == 2, result.output
    last = result.stderr.strip().splitlines()[-1]
    for word in words:
        assert word in last


@pytest.mark.costly
def test_a_folder_with_two_cameras_finds_their_relative_orientation(here: ImageFolder, tmp_path: pathlib.Path) -> None:
    result = run(
        *here.arguments, *OPTIONS, "--shots-by", "name", "--flights-by", "1h", "-o", tmp_path / "out", "--json"
    )
    assert result.exit_code == 0, result.output
    assert "jaxgeo: 3 shots of 2 cameras (3 of T, 3 of W); 1 flight" in result.stderr
    assert "Mounting sigma of each camera against camera W: 1 deg (default)" in " ".join(result.stderr.split())
    content = json.loads(result.stdout)
    assert content["shots"] == {"count": 3, "images_of_cameras": {"T": 3, "W": 3}}
    assert content["flights"] == 1
    assert len(content["adjusted"]) == 6
    assert any("Camera W against camera T, in 3 shots: turned by" in line for line in content["words"])
    (one,) = content["relative_orientations"]
    assert (one["camera"], one["against"]) == ("W", "T")
    turns = []
    for exposure in here.true[:2]:
        assert isinstance(exposure.motion, Shot)
        turns.append(np.asarray(exposure.sensor.sight(exposure.motion).R_ecef_from_camera))
    true = np.rad2deg(Rotation.from_matrix(turns[1].T @ turns[0]).as_rotvec())
    assert np.max(np.abs(true)) > 0.9
    sigma = np.array(one["sigma_turned_deg"])
    assert np.all(np.abs(np.array(one["turned_deg"]) - true) < 4.0 * sigma)
    assert np.all(sigma < 0.5)


@pytest.mark.costly
def test_images_of_other_shots_are_refused(here: ImageFolder, tmp_path: pathlib.Path) -> None:
    """Two infrared images under each other's names: by their tags, before any image is matched."""
    mixed = tmp_path / "images"
    shutil.copytree(here.images, mixed)
    (mixed / "DJI_0000_T.jpg").rename(mixed / "x")
    (mixed / "DJI_0002_T.jpg").rename(mixed / "DJI_0000_T.jpg")
    (mixed / "x").rename(mixed / "DJI_0002_T.jpg")
    out = tmp_path / "out"
    refused = run(mixed, *here.arguments[1:], *OPTIONS, "--shots-by", "name", "-o", out)
    assert_refused(refused, "--shots-by name: images DJI_0000_", "both of shot 0", "m apart", "Are images mixed up?")
    assert not out.exists()
    for options, words in (
        (("--shots-by", "0.1s", "--flights-by", "0.5s"), "shots of 2 cameras (3 of 1, 3 of 2); 3 flights"),
        (("--shots-by", "5s"), "3 shots of 2 cameras"),
    ):
        assert words in run(here.images, *here.arguments[1:], "--points", "4", *OPTIONS[:4], *options, "-o", out).stderr


@pytest.mark.costly
def test_groups_that_are_none_are_refused(here: ImageFolder, tmp_path: pathlib.Path) -> None:
    wide = tmp_path / "images"
    wide.mkdir()
    for name in here.names[::2]:
        shutil.copy(here.images / name, wide)
    for options, words in (
        (("--shots-by", "name"), "no two of 3 images in one folder have names that are alike but for their last part"),
        (("--shots-by", "0.5s"), "no two images of different cameras are taken within this time; there are 1 camera"),
        (("--mounting-sigma", "0.5"), "--mounting-sigma 0.5 is for shots of several cameras; give --shots-by too"),
    ):
        refused = run(wide, *here.arguments[1:], *OPTIONS, *options, "-o", tmp_path / "out")
        assert_refused(refused, words)


@pytest.mark.costly
def test_columns_of_a_table_name_shots_flights_and_cameras(here: ImageFolder, tmp_path: pathlib.Path) -> None:
    """Cameras that are equal differ by their column; what contradicts is refused by its name."""
    header = "image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,Shot,flight,camera"
    rows = [
        [name, f"{47.0 + 3e-4 * (k // 2)}", "11.0,680,0,0,0", f"{7 + k // 2}", f"{k // 4}", "ab"[k % 2]]
        for k, name in enumerate(here.names)
    ]
    table, cameras = tmp_path / "poses.csv", tmp_path / "cameras.json"
    alike = {"projection_type": "perspective", "width": 256, "height": 192, "focal": 240.0 / 256.0}
    cameras.write_text(json.dumps({"a": alike, "b": alike}))
    given = ("--images", here.images, *here.arguments[1:], *OPTIONS, "--camera", cameras)
    for column, value, words in (
        (3, "8", "column shot: images DJI_0000_T.jpg and DJI_0001_T.jpg are both of shot 8 and of camera b"),
        (4, "1", "column shot: images DJI_0000_W.jpg and DJI_0000_T.jpg are both of shot 7, but of flights 0 and 1"),
    ):
        cells = [list(row) for row in rows]
        cells[1][column] = value
        table.write_text("\n".join([header, *(",".join(row) for row in cells), ""]))
        refused = run(table, *given, "-o", tmp_path / "out")
        assert_refused(refused, words)
        assert "2 cameras (3 of a, 3 of b)" in refused.stderr
        assert "not read" not in refused.stderr
