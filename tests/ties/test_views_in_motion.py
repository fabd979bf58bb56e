"""Mutual correction of images from a rolling shutter, of late navigation and through the air, and its options."""

from __future__ import annotations

import json
import pathlib
from dataclasses import replace

import numpy as np
import pytest
from support.command_runner import CliRunner
from support.drone_image_files import packet, write_image
from support.image_folder import write_folder
from support.surveyed_strip import ABOVE, APART, COUNT, NAMES, Surveyed, errors_of, pixels, surveyed

from jaxgeo import Atmosphere, Shot
from jaxgeo.adjust import ImagePoints, Prior, Unknowns
from jaxgeo.cli import app
from jaxgeo.io.acquisitions.velocities import read_velocities
from jaxgeo.ties import MapControl, Views, correct
from jaxgeo.ties.motion import motion_of, runs_of
from tests.test_cli_locate import DJI

READOUT, LATE = 0.3, 0.4  # s
VELOCITY = np.array([0.0, 0.5 * APART, 0.0])  # m/s, east, north, up
CHECK = ("p3", "p6")


def places(strip: Surveyed) -> dict[str, np.ndarray]:
    """Places of tie points and surveyed points in the frame of the true views."""
    middle, rng = strip.true.centre.mean(axis=0), np.random.default_rng(1)
    flat = np.stack(np.meshgrid(np.linspace(-60, 60, 6), np.linspace(-130, 130, 12)), axis=-1).reshape(-1, 2)
    ground = np.column_stack([middle[:2] + flat, middle[2] - ABOVE + rng.uniform(-15.0, 15.0, len(flat))])
    known = {f"p{k}": one for k, one in enumerate(strip.place)}
    return known | {f"tie {k}": one for k, one in enumerate(ground)}


def rolled(strip: Surveyed, seen: ImagePoints) -> ImagePoints:
    """Measurements as of a camera that reads its rows in `READOUT` s."""
    where, uv = places(strip), seen.uv.copy()
    for k, (image, point) in enumerate(zip(seen.image.tolist(), seen.point.tolist(), strict=True)):
        number, exact = NAMES.index(image), where[point][None]
        row = still = pixels(strip.true, number, exact)[0]
        for _ in range(20):
            moved = VELOCITY * READOUT * (row[1] - 95.5) / 192.0
            row = pixels(strip.true, number, exact - moved)[0]
        uv[k] += row - still
    inside = np.all((uv > 0.0) & (uv < [255.0, 191.0]), axis=1)
    return replace(seen, uv=uv).of(inside).seen_often(known=list(strip.control.name))


def rolling(seed: int) -> Surveyed:
    strip = surveyed(seed, check=CHECK)
    control = replace(strip.control, marks=rolled(strip, strip.control.marks))
    return replace(strip, ties=rolled(strip, strip.ties), control=control)


@pytest.mark.costly
def test_a_readout_is_corrected_and_found() -> None:
    """Poses and check points within their standard deviations; without the readout, far beyond."""
    strip = rolling(3)
    views = strip.given.moving(VELOCITY, np.zeros(3), readout=READOUT)
    found = correct(views, strip.ties, control=strip.control)
    images = found.adjustment.images
    errors = errors_of(strip, images.centre, images.R_frame_from_camera)
    weight = np.linalg.inv(found.adjustment.covariance_of_images)
    assert np.einsum("ni,nij,nj->", errors, weight, errors) < 3.0 * 6 * COUNT
    assert found.excess < 0.1  # px
    residuals = found.control_residuals
    assert residuals is not None
    own = residuals.of_role("check")
    assert np.sqrt(np.mean((residuals.px[own] / residuals.sigma_px[own]) ** 2)) < 1.8
    assert "middle row, with a readout of 0.3 s" in found.words()
    assert found.rms_before < correct(strip.given, strip.ties).rms_before
    unknown = correct(strip.given.moving(VELOCITY, np.zeros(3)), strip.ties, Unknowns(readout=Prior(1.0)),
                      control=strip.control)  # fmt: skip
    (parameter,) = unknown.adjustment.parameters
    assert parameter.sigma < 0.05
    assert abs(parameter.value - READOUT) < 4.0 * parameter.sigma
    assert "Focal length and principal point are held" in unknown.words()
    again = unknown.control_residuals
    assert again is not None
    assert np.sqrt(np.mean((again.px[own] / again.sigma_px[own]) ** 2)) < 1.8
    assert np.all(again.sigma_px[own] > 0.99 * residuals.sigma_px[own])  # those of the readout come in


@pytest.mark.costly
def test_a_time_offset_is_found_with_control() -> None:
    strip = surveyed(2, check=CHECK)
    moved = np.asarray(strip.given.centre) + LATE * VELOCITY
    views = replace(strip.given, centre=moved).moving(VELOCITY, np.zeros(3))
    found = correct(views, strip.ties, Unknowns(time_offset=Prior(1.0)), control=strip.control)
    (parameter,) = found.adjustment.parameters
    assert (parameter.whose, parameter.name, parameter.unit) == ("strip strip", "time offset", "s")
    assert abs(parameter.value - LATE) < 4.0 * parameter.sigma < 1.0
    assert not found.doubtful  # moved by 5 m, as the offset allows, where the navigation errs by 2 m


@pytest.mark.costly
def test_refraction_is_that_of_the_atmosphere() -> None:
    """At 150 m it is far below a pixel: results are as without, but not the same."""
    strip = surveyed(2, check=CHECK)
    without, found = (correct(one, strip.ties, control=strip.control)
                      for one in (strip.given, replace(strip.given, atmosphere=Atmosphere())))  # fmt: skip
    off = np.abs(found.adjustment.images.centre - without.adjustment.images.centre)
    assert 0.0 < np.max(off) < 1e-2  # m
    assert found.adjustment.refractions == {"1": 1.0}


def test_velocities_by_differences_end_at_turns() -> None:
    """Two strips to the north and back, 100 m apart, without a pause between them."""
    step = np.array([[0.0, 15.0, 0.0]] * 4 + [[17.0, 5.0, 0.0]] + [[0.0, -15.0, 0.0]] * 4)
    place = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    turns = np.broadcast_to(np.eye(3), (10, 3, 3))
    velocity, _ = motion_of(place, turns, np.arange(10.0), np.full(10, "a"))
    np.testing.assert_allclose(velocity, [[0.0, 15.0, 0.0]] * 5 + [[0.0, -15.0, 0.0]] * 5, atol=1e-12)
    curve = np.stack([np.cos(0.3 * np.arange(10.0)), np.sin(0.3 * np.arange(10.0)), np.zeros(10)], axis=1)
    velocity, _ = motion_of(50.0 * curve, turns, np.arange(10.0), np.full(10, "a"))
    inner = np.stack([-curve[:, 1], curve[:, 0], np.zeros(10)], axis=1)[1:-1] * 15.0
    np.testing.assert_allclose(velocity[1:-1], inner, atol=0.3)


def test_a_time_offset_is_an_error_that_images_share() -> None:
    views = surveyed(4).true.moving()
    assert views.velocity is not None
    assert views.turn_rate is not None
    late = views.with_time_offset(0.2)
    effect = 0.2 * np.concatenate([views.velocity, views.turn_rate], axis=1)
    more = late.covariance_of_pair(0, 2) - views.covariance_of_pair(0, 2)
    both = np.concatenate([effect[0], effect[2]])
    np.testing.assert_allclose(more, np.outer(both, both), atol=1e-12)
    assert views.with_time_offset(0.0) is views


def test_velocities_by_differences_end_at_gaps() -> None:
    strip = surveyed(4)
    true = strip.true.moving()
    assert true.velocity is not None
    np.testing.assert_allclose(true.velocity, np.broadcast_to(VELOCITY, (COUNT, 3)), atol=0.05)
    time = np.array([0.0, 1.0, 2.0, 20.0, 21.0, 22.0])
    north = np.outer(10.0 * time, [0.0, 1.0, 0.0])
    assert runs_of(time, np.full(6, "a"), north).tolist() == [0, 0, 0, 1, 1, 1]
    both = np.repeat(np.arange(3), 2)
    assert runs_of(time[both], np.array(["a", "b"] * 3), north[both]).tolist() == [0, 1, 0, 1, 0, 1]
    kept = true.moving(readout=0.01)
    np.testing.assert_array_equal(kept.velocity, true.velocity)
    assert kept.readout == {"1": 0.01}
    with pytest.raises(ValueError, match="there is no camera 'main'; known are 1"):
        strip.given.moving(readout={"main": 0.01})


def test_a_map_does_not_go_with_a_readout() -> None:
    strip = surveyed(4)
    views = strip.given.moving(VELOCITY, np.zeros(3), readout=READOUT)
    empty = object.__new__(MapControl)
    with pytest.raises(ValueError, match="the views have a readout; leave one of the two out"):
        correct(views, strip.ties, map_control=empty)


def write(folder: pathlib.Path, speeds: list[tuple[str, str, str] | None]) -> list[pathlib.Path]:
    """Images with DJI's tags of their speeds."""
    folder.mkdir(exist_ok=True)
    for k, speed in enumerate(speeds):
        own = {} if speed is None else {f"drone-dji:Flight{a}Speed": one for a, one in zip("XYZ", speed, strict=True)}
        write_image(folder / f"{k}.jpg", packet(DJI | own), make="DJI")
    return [folder / f"{k}.jpg" for k in range(len(speeds))]


def test_speeds_of_tags_are_north_east_down(tmp_path: pathlib.Path) -> None:
    files = write(tmp_path, [("+5.10", "+7.40", "-0.20"), None])
    np.testing.assert_array_equal(read_velocities(files)[0], [5.1, 7.4, -0.2])
    assert np.all(np.isnan(read_velocities(files)[1]))
    still = write(tmp_path, [("+0.00", "+0.00", "+0.00")] * 2)
    assert np.all(np.isnan(read_velocities(still)))  # some models write no others


def run(*arguments: str):
    return CliRunner().invoke(app, ["adjust", *arguments])


@pytest.mark.slow
def test_the_command_adjusts_a_time_offset(tmp_path: pathlib.Path) -> None:
    """Images with speeds in their tags; refused, before any is matched, where there are none."""
    here = write_folder(tmp_path, count=4)
    options = [
        *here.arguments,
        "--dem-datum",
        "ellipsoid",
        "--dem-sigma",
        "3",
        "--points",
        "40",
        "-o",
        f"{tmp_path / 'o'}",
    ]
    refused = run(*options, "--time-offset-sigma", "0.05")
    assert refused.exit_code == 2
    assert "--time-offset-sigma needs the speeds of the images" in refused.stderr
    for path in here.images.glob("*.jpg"):
        data = path.read_bytes()
        tag, added = b'drone-dji:CalibratedFocalLength="', b'drone-dji:FlightXSpeed="9.5" drone-dji:FlightYSpeed="0.1" '
        added += b'drone-dji:FlightZSpeed="0.0" '
        path.write_bytes(_longer(data, tag, added))
    result = run(*options, "--time-offset-sigma", "0.05", "--readout", "-0.02", "--refraction", "--json")
    assert result.exit_code == 0, result.stderr
    content = json.loads(result.stdout)
    (offset,) = (one for one in content["parameters"] if one["name"] == "time offset")
    assert (offset["of"], offset["unit"]) == ("navigation", "s")
    assert abs(offset["value"]) < 4.0 * offset["sigma"] < 0.21
    assert any("FlightXSpeed" in one for one in content["assumed"])
    assert any("readout of -0.02 s" in one for one in content["words"])


def _longer(data: bytes, before: bytes, added: bytes) -> bytes:
    """A JPEG file with more text in its packet of XMP, whose segment states its length."""
    at = data.index(before)
    segment = data.rindex(b"\xff\xe1", 0, at)
    length = int.from_bytes(data[segment + 2 : segment + 4], "big") + len(added)
    return data[: segment + 2] + length.to_bytes(2, "big") + data[segment + 4 : at] + added + data[at:]


def test_wrong_values_are_refused() -> None:
    base = ["images", "--camera-datum", "ellipsoid", "--dem", "dem.tif", "-o", "out"]
    for options, words in (
        (["--readout", "30"], "--readout 30: give the readout time in s, up to 10: 0.03 is 30 ms."),
        (["--readout-sigma", "0"], "--readout-sigma 0: give a sigma above zero"),
        (["--time-offset-sigma", "-1"], "--time-offset-sigma -1"),
        (["--refraction", "--reference", "map.tif"], "--refraction: images are registered to --reference"),
        (["--readout", "-0.02", "--reference", "map.tif"], "--readout: images are registered to --reference"),
    ):
        result = run(*base, *options)
        assert result.exit_code == 2
        assert words in result.stderr


def test_views_of_shots_have_no_motion_unless_asked() -> None:
    views: Views = surveyed(4).given
    assert views.velocity is None
    assert views.readout == {}
    assert all(isinstance(one.motion, Shot) for one in views.exposure)
