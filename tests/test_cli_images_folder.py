"""--images FOLDER of every command that has it: a wrong folder is named, with what was looked for and what to give."""

from __future__ import annotations

import pathlib
import re
import shlex
import shutil

import pytest
from support.command_files import prepare
from support.command_runner import CliRunner

from jaxgeo.cli import app

OPTIONS = {"rectify": ["-o", "orthos"], "adjust": ["-o", "adjusted"], "view": ["--no-browser"]}
CASES = {
    "no such folder": ("nowhere/images", ["there is no such folder", "{here} exists"]),
    "a file": ("DJI_0042.JPG", ["this is a file", "--images ."]),
    "no images": ("empty", ["no image (.jpg, .jpeg, ", "reconstruction.json names a"]),
    "other images": ("other", ["none of the images is there", "reconstruction.json names a", "has DJI_0042.JPG"]),
    "images below": ("above", ["reconstruction.json names a", "give the folder below it", "'above/of two words'"]),
}


@pytest.fixture
def here(tmp_path: pathlib.Path, monkeypatch) -> pathlib.Path:
    """Folders without the image `a`, which the reconstruction names."""
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path, "reconstruction.json dem.tif DJI_0042.JPG")
    for name in ("empty", "other", "above/of two words"):
        (tmp_path / name).mkdir(parents=True)
    shutil.copy("DJI_0042.JPG", "other")
    shutil.copy("DJI_0042.JPG", "above/of two words/a.JPG")
    return tmp_path


def run(command: str, folder: str):
    given = ["reconstruction.json", "--images", folder, "--camera-datum", "ellipsoid", "--dem", "dem.tif", "--quiet"]
    return CliRunner().invoke(app, [command, *given, *OPTIONS[command]])


@pytest.mark.parametrize("command", list(OPTIONS))
@pytest.mark.parametrize("folder, words", CASES.values(), ids=list(CASES))
def test_a_wrong_folder_is_told_with_what_was_sought(
    here: pathlib.Path, command: str, folder: str, words: list[str]
) -> None:
    result = run(command, folder)
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"jaxgeo: --images {folder}: ")
    for word in words:
        assert word.format(here=here) in line
    assert not any((here / name).exists() for name in ("orthos", "adjusted")), "nothing is written"


def test_the_folder_that_is_named_instead_is_taken(here: pathlib.Path) -> None:
    """By `adjust`, which then finds one image where it needs two."""
    found = re.search(r"that has them: (--images .*)$", run("adjust", "above").stderr.strip())
    assert found is not None
    _, folder = shlex.split(found[1])
    assert "needs two images or more" in run("adjust", folder).stderr
