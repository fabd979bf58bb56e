"""Control of a block by surveyed points: against the truth of a simulated strip, whose navigation has a common offset
that images alone do not show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.surveyed_strip import (
    COUNT,
    NAMES,
    OFFSET,
    SURVEY,
    Surveyed,
    errors_of,
    pixels,
    positions,
    surveyed,
)

from jaxgeo.adjust import ImagePoints
from jaxgeo.ties import Control, Correction, check_control, correct

CHECK = ("p3", "p6")


def corrected(strip: Surveyed, control: Control | None = None) -> Correction:
    return correct(strip.given, strip.ties, control=strip.control if control is None else control)


def moved(strip: Surveyed, by: list[float], names: tuple[str, ...] | None = None) -> Control:
    """The control with points moved by metres east, north, up; by default all."""
    control = strip.control
    own = np.ones(len(control), bool) if names is None else np.isin(control.name, names)
    place = np.asarray(strip.true.frame.from_geodetic(control.position)) + own[:, None] * np.array(by)
    return replace(control, position=positions(strip.true, place))


@pytest.fixture(scope="module")
def strip() -> Surveyed:
    return surveyed(3, check=CHECK)


@pytest.mark.costly
def test_control_removes_the_shift_that_images_do_not_show(strip: Surveyed) -> None:
    alone, found = correct(strip.given, strip.ties), corrected(strip)
    errors = [
        errors_of(strip, one.adjustment.images.centre, one.adjustment.images.R_frame_from_camera)[:, :3].mean(axis=0)
        for one in (alone, found)
    ]
    assert np.allclose(alone.sigma_of_mean, OFFSET, rtol=0.02)
    assert np.all(found.sigma_of_mean < 0.2 * alone.sigma_of_mean)
    assert np.linalg.norm(errors[0]) > 2.0  # m, of the seed
    assert np.all(np.abs(errors[1]) < 3.0 * found.sigma_of_mean)
    assert "images alone" not in found.words().lower()


@pytest.mark.costly
def test_errors_with_control_are_as_predicted() -> None:
    """Over 10 draws: squared errors of the poses by their covariance, and of check points by theirs, are chi-square;
    the covariance of a mean position is that of the whole covariance."""
    squares, of_checks, seeds = 0.0, [], 10
    for seed in range(seeds):
        strip = surveyed(seed, check=CHECK)
        found = corrected(strip)
        assert not found.blunders
        images = found.adjustment.images
        errors = errors_of(strip, images.centre, images.R_frame_from_camera).ravel()
        covariance = found.adjustment.covariance[: 6 * COUNT, : 6 * COUNT]
        squares += errors @ np.linalg.solve(covariance, errors)
        residuals = found.control_residuals
        assert residuals is not None
        own = residuals.role == "check"
        assert residuals.name[own].tolist() == list(CHECK)
        of_checks += [residuals.enu[own] / residuals.sigma_enu[own]]
        of_checks += [(residuals.px / residuals.sigma_px)[residuals.of_role("check")]]
    freedom = 6 * COUNT * seeds
    assert abs(squares - freedom) < 3.0 * np.sqrt(2.0 * freedom)
    normal = np.concatenate([one.ravel() for one in of_checks])
    assert 0.7 < np.sqrt(np.mean(normal**2)) < 1.3
    assert np.max(np.abs(normal)) < 4.5
    mean = np.tile(np.eye(3, 6), COUNT) / COUNT
    assert np.allclose(np.sqrt(np.diagonal(mean @ covariance @ mean.T)), found.sigma_of_mean, rtol=1e-6)


@pytest.mark.costly
def test_residuals_of_check_points_are_those_of_collinearity(strip: Surveyed) -> None:
    """Pixels against the collinearity equations, places against the rays' least squares by differences."""
    found = corrected(strip)
    residuals, images = found.control_residuals, found.adjustment.images
    assert residuals is not None
    views = replace(strip.given, centre=images.centre, R_frame_from_camera=images.R_frame_from_camera)
    place = strip.control.ground(strip.given.frame)
    for point in CHECK:
        k = place.name.tolist().index(point)
        for row in np.flatnonzero(residuals.point == point):
            image = str(residuals.image[row])
            marks = strip.control.marks
            measured = marks.uv[(marks.point == point) & (marks.image == image)][0]
            expected = pixels(views, NAMES.index(image), place.place[k : k + 1])[0] - measured
            assert np.allclose(residuals.px[row], expected, atol=1e-6)
        there = place.place[k] + residuals.enu[residuals.name.tolist().index(point)]
        off = [
            pixels(views, NAMES.index(str(marks.image[row])), there[None])[0] - marks.uv[row]
            for row in np.flatnonzero(marks.point == point)
        ]
        assert np.sqrt(np.mean(np.square(off))) < 2.0 * 0.5  # px, the sigma of marks


@pytest.mark.costly
@pytest.mark.parametrize("metres", [4.0, 8.0])
def test_a_wrong_control_point_is_named_and_left_out(metres: float) -> None:
    """By its name and its error; what is adjusted is as without it."""
    strip = surveyed(1)
    found = corrected(strip, moved(strip, [0.0, 0.0, metres], ("p1",)))
    (blunder,) = found.blunders
    assert (blunder.point, blunder.image) == ("p1", "")
    assert abs(blunder.error[2] - metres) < 2.0
    assert "p1" in found.words()
    assert found.control_residuals is not None
    assert found.control_residuals.role.tolist().count("left out") == 1
    right = corrected(strip, replace(strip.control, check=("p1",)))
    away = found.adjustment.images.centre - right.adjustment.images.centre
    assert np.max(np.abs(away) / right.adjustment.sigma_of_images[:, :3]) < 1.0


@pytest.mark.costly
def test_a_wrong_pixel_of_a_control_point_is_named(strip: Surveyed) -> None:
    marks = strip.control.marks
    row = int(np.flatnonzero((marks.point == "p4") & (marks.image == "image 2"))[0])
    uv = marks.uv.copy()
    uv[row] += [8.0, -5.0]
    found = corrected(strip, replace(strip.control, marks=ImagePoints(marks.image, marks.point, uv, marks.sigma)))
    (blunder,) = found.blunders
    assert (blunder.point, blunder.image) == ("p4", "image 2")
    assert np.allclose(blunder.error, [8.0, -5.0], atol=2.5)


@pytest.mark.costly
def test_control_that_fits_much_worse_than_stated_is_doubted(strip: Surveyed) -> None:
    """Pixels off by 3 px with stated 0.5 px: these are taken to be that much less sure, and it is said."""
    marks = strip.control.marks
    uv = marks.uv + 3.0 * np.random.default_rng(8).normal(size=marks.uv.shape)
    found = corrected(
        strip, replace(strip.control, marks=ImagePoints(marks.image, marks.point, uv, marks.sigma), check=())
    )
    assert 1.5 < found.excess_of_control < 4.5
    assert "much worse than its standard deviations explain" in found.words()
    assert "much worse" not in corrected(strip).words()


@pytest.mark.costly
def test_control_of_another_datum_is_refused_with_its_shift(strip: Surveyed) -> None:
    """Not far from the rays of its pixels for this navigation, and yet against all else."""
    wrong = moved(strip, [0.0, 0.0, 60.0])
    check_control(strip.given, wrong)
    with pytest.raises(ValueError, match=r"the control contradicts .* moved by .*, -6[0-3]\.\d+ m \(east, north, up\)"):
        corrected(strip, wrong)


@pytest.mark.costly
def test_points_in_one_image_count(strip: Surveyed) -> None:
    """Two points in one image each hold the block better than the navigation does."""
    marks = strip.control.marks
    rows = [int(np.flatnonzero(marks.point == name)[0]) for name in ("p1", "p5")]
    ground = strip.control.ground(strip.true.frame).of(["p1", "p5"])
    control = Control(ground.name, positions(strip.true, ground.place), SURVEY, marks.of(rows))
    found, alone = corrected(strip, control), correct(strip.given, strip.ties)
    assert np.all(found.sigma_of_mean < 0.7 * alone.sigma_of_mean)
    errors = errors_of(strip, found.adjustment.images.centre, found.adjustment.images.R_frame_from_camera)
    assert np.all(np.abs(errors[:, :3].mean(axis=0)) < 3.0 * found.sigma_of_mean)


@pytest.mark.parametrize(
    "by, words",
    [
        ([0.0, 500.0, 0.0], r"8 of 8 points lie far .* moved by [+-]\d+, -(49|50)\d, [+-]\d+ m"),
        ([0.0, 0.0, 1e6], r"8 of 8 points lie far"),
    ],
)
def test_control_of_another_place_is_refused(strip: Surveyed, by: list[float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        check_control(strip.given, moved(strip, by))


def test_exchanged_names_are_refused(strip: Surveyed) -> None:
    marks = strip.control.marks
    point = np.select([marks.point == "p1", marks.point == "p7"], ["p7", "p1"], marks.point)
    control = replace(strip.control, marks=ImagePoints(marks.image, point, marks.uv, marks.sigma))
    with pytest.raises(ValueError, match=r"point p[17] lies far from the rays.* So does p[17]"):
        check_control(strip.given, control)


def test_pixels_outside_of_images_and_unknown_images_are_refused(strip: Surveyed) -> None:
    control, marks = strip.control, strip.control.marks
    uv = marks.uv.copy()
    uv[3] = [256.0, 10.0]
    with pytest.raises(ValueError, match=r"pixel 256, 10 lies outside of image .* 256 x 192"):
        check_control(strip.given, replace(control, marks=ImagePoints(marks.image, marks.point, uv, 1.0)))
    image = marks.image.astype("<U9")
    image[0] = "elsewhere"
    with pytest.raises(ValueError, match="image elsewhere of point p0 is not among the images"):
        check_control(strip.given, replace(control, marks=ImagePoints(image, marks.point, marks.uv, 1.0)))


@pytest.mark.parametrize(
    "change, words",
    [
        ({"sigma_enu": 0.0}, "sigma_enu must be positive"),
        ({"check": ["p99"]}, "check point p99 is not among the points"),
        ({"name": ["p0"] * 8}, "point p0 is there 8 times"),
        ({"name": [f"p{k}" for k in range(7)] + ["other"]}, "point p7 is measured in images, but has no position"),
    ],
)
def test_contradictory_control_is_refused(strip: Surveyed, change: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(strip.control, **{"check": ()} | change)
