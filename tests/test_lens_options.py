"""Options of the errors of a lens: zero without a unit, and sentences that hold where they are given."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest
from support.command_runner import CliRunner
from support.drone_image_files import packet, write_image
from support.klv_packets import local_set, usual

from jaxgeo.cli import app
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import Sigmas, errors_given, interior_errors
from jaxgeo.cli._locate_inputs import inputs_of
from jaxgeo.cli._locate_options import GroundOptions, LocateOptions, ObservationOptions
from jaxgeo.io import read_acquisition, read_observations
from jaxgeo.sensor import Gimbal
from jaxgeo.uncertainty.sources import InteriorOrientation, Position
from tests.test_cli_locate import DJI

POSE = """[pose]
lat_deg = 36.0
lon_deg = -84.0
height_m = 1000.0
height_datum = "ellipsoid"
heading_deg = 0.0
pitch_deg = 0.0
roll_deg = 0.0
"""
STATED = (InteriorOrientation(np.array([7.0, 3.0, 4.0])), Position.from_ned(north=1.0, east=1.0, down=1.0))


def lens(focal: str | None, principal: str | None) -> list[float] | None:
    given = errors_given(STATED, Sigmas(focal=focal, principal=principal), Gimbal.fixed(), "a.jpg", None)
    assert any(isinstance(one, Position) for one in given)
    found = [np.asarray(one.sigma).tolist() for one in given if isinstance(one, InteriorOrientation)]
    return found[0] if found else None


@pytest.mark.parametrize("zero", ["0", "0.0", " 0", "0px", "-0"])
def test_zero_needs_no_unit(zero: str) -> None:
    assert lens(zero, None) == [0.0, 3.0, 4.0]
    assert lens(None, zero) == [7.0, 0.0, 0.0]
    assert lens(zero, zero) is None
    assert lens(None, "0,0") == [7.0, 0.0, 0.0]


@pytest.mark.parametrize("text", ["5", "0,0", "0,5", "zero", "", "nan", "0deg"])
def test_what_is_not_zero_needs_its_unit(text: str) -> None:
    with pytest.raises(UserError, match=r"--focal-sigma .*: expected a length with its unit"):
        interior_errors(text, None, "a.jpg", None)


def assumed(path: pathlib.Path, sigmas: Sigmas) -> list[str]:
    given, reading = ObservationOptions(files=[path]), ReadingOptions(height_datum="ellipsoid")
    return inputs_of(LocateOptions(given, GroundOptions(level="300"), reading, sigmas), True).assumed


@pytest.mark.parametrize("focal", ["0", "5px"])
def test_what_a_lens_bends_is_told_as_it_is_among_the_errors(tmp_path: pathlib.Path, focal: str) -> None:
    path = write_image(tmp_path / "a.jpg", packet(DJI), make="DJI")
    counted = [one for one in assumed(path, Sigmas()) if "counts as an error of the focal length" in one]
    assert len(counted) == 1
    told = assumed(path, Sigmas(focal=focal))
    assert not any("counts as an error" in one or one.startswith("Focal length sigma") for one in told)
    (bent,) = [one for one in told if "free of distortion" in one]
    assert bent.endswith(f"distortion at the corners is covered only as far as --focal-sigma {focal} allows.")
    assert any(one.startswith("Principal point sigma") for one in told)


DOUBTFUL = {
    "a.jpg focal=35px": "",
    "a.jpg focal=5px": "The field of view is 152 x 143 deg, by a focal length of 5 pixels of an image of",
    "scene.toml": "The field of view is 0.0859 x 0.0573 deg",
    "a.klv 1080,1920": "Pixels are not square: the focal length is 513",
    "a.klv 1920,1080": "",
}


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.costly] if case == "scene.toml" else []) for case in DOUBTFUL]
)
def test_a_camera_that_hardly_exists_is_doubtful(tmp_path: pathlib.Path, case: str) -> None:
    """The same sentence by the reader, for observations, and for commands about whole images."""
    name, _, given = case.partition(" ")
    write_image(tmp_path / "a.jpg", packet(DJI), make="DJI")
    (tmp_path / "a.klv").write_bytes(local_set(usual()))
    (tmp_path / "scene.toml").write_text(f"[camera]\nwidth = 6000\nheight = 4000\nfocal_px = 4e6\n{POSE}")
    size = {"image_size": tuple(map(int, given.split(",")))} if "," in given else {}
    how = {"camera": given, "height_datum": "ellipsoid"} if given.startswith("focal") else size
    told = [read_acquisition(tmp_path / name, **how).assumed, read_observations(tmp_path / name, **how).assumed]
    doubts = [[one for one in some if one.startswith("Check: ")] for some in told]
    words = DOUBTFUL[case]
    assert [len(some) for some in doubts] == [bool(words)] * 2
    assert all(words in some[0] for some in doubts if some)
    if name == "scene.toml":
        result = CliRunner().invoke(app, ["footprint", str(tmp_path / name), "--ground", "0"])
        assert f"check: {words}" in result.stderr
