"""Options of the errors of a lens: zero without a unit, and sentences that hold where they are given."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest
from support.drone_image_files import packet, write_image

from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import Sigmas, errors_given, interior_errors
from jaxgeo.cli._locate_inputs import inputs_of
from jaxgeo.cli._locate_options import GroundOptions, LocateOptions, ObservationOptions
from jaxgeo.sensor import Gimbal
from jaxgeo.uncertainty.sources import InteriorOrientation, Position
from tests.test_cli_locate import DJI

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
