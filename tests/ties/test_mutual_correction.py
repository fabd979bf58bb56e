"""Tie points between rendered images, and the navigation that they correct: against the poses that rendered them."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation
from support.drone_strip import ERRORS, SENSOR, Strip, ground, strip, views_of
from support.misleading_scenes import periodic, rows_of_trees, shadows, shown, squared_errors, water
from support.unlike_images import off_true_rays

from jaxgeo import Exposure
from jaxgeo.adjust import ImagePoints
from jaxgeo.ties import Correction, Matching, Ties, Views, candidate_pairs, correct, find_ties

pytestmark = pytest.mark.costly

OFF = 3.0  # m: error of the terrain's height
MATCHING = Matching(sigma_height=4.0)


@pytest.fixture(scope="module")
def here() -> Strip:
    return strip()


@pytest.fixture(scope="module")
def ties(here: Strip) -> Ties:
    return find_ties(here.views, ground(OFF), here.pictures, MATCHING, points=48)


@pytest.fixture(scope="module")
def corrected(here: Strip, ties: Ties) -> Correction:
    return correct(here.views, ties)


def errors_of(here: Strip, found: Correction) -> np.ndarray:
    """Errors (n, 6) of the adjusted orientations: centre in m, rotation about the camera's axes in rad."""
    true = views_of(here.names, here.true)
    rows = [here.names.index(name) for name in found.names]
    origin = np.asarray(found.views.frame.to_ecef(found.adjustment.images.centre))
    away = (origin - np.asarray(true.frame.to_ecef(true.centre[rows]))) @ np.asarray(true.frame.R_ecef_from_local)
    turn = np.swapaxes(true.R_frame_from_camera[rows], 1, 2) @ found.adjustment.images.R_frame_from_camera
    return np.concatenate([away, Rotation.from_matrix(turn).as_rotvec()], axis=1)


def test_neighbours_are_paired(here: Strip) -> None:
    pairs = [pair[:2] for pair in candidate_pairs(here.views, ground())]
    assert {(0, 1), (1, 2), (2, 3)} <= set(pairs)
    assert not any(4 in pair for pair in pairs)


def test_ties_are_where_the_true_poses_have_them(here: Strip, ties: Ties) -> None:
    assert ties.observations is not None
    off = np.linalg.norm(off_true_rays(here, ties.observations)[0], axis=1)
    assert len(off) > 60
    assert np.median(off) < 0.15  # px
    assert np.mean(off > 1.0) < 0.03


def test_an_unconnected_image_is_named(ties: Ties, corrected: Correction) -> None:
    assert ties.unconnected == corrected.unconnected == ["image 4"]
    assert "image 4" in corrected.words()
    assert "shift of all positions" in corrected.words()


def test_errors_are_as_predicted(here: Strip, corrected: Correction) -> None:
    """The prediction is not too small; of relative errors it is too large, as these images are very sharp."""
    assert corrected.rms_before > 0.5
    assert corrected.rms_after < 0.1 * corrected.rms_before
    errors = errors_of(here, corrected).ravel()
    covariance = corrected.adjustment.covariance
    squared = errors @ np.linalg.solve(covariance, errors)
    assert squared < 24 + 3.5 * np.sqrt(48)  # chi-square of 24 errors
    assert np.max(np.abs(errors) / np.sqrt(np.diagonal(covariance))) > 0.5


def test_neighbours_agree_better_than_by_navigation(here: Strip, corrected: Correction) -> None:
    """Relative position of rectified neighbours: how far one ground point is apart in two images."""
    true = views_of(here.names, here.true)

    def apart(R: np.ndarray, centre: np.ndarray) -> float:
        shifts = []
        for k in range(4):
            look = true.centre[k] + true.R_frame_from_camera[k][:, 2] * 150.0 / -true.R_frame_from_camera[k][2, 2]
            ray = R[k] @ (true.R_frame_from_camera[k].T @ (look - true.centre[k]))
            shifts.append((centre[k] + ray * (look[2] - centre[k][2]) / ray[2] - look)[:2])
        return float(np.sqrt(np.mean(np.diff(shifts, axis=0) ** 2)))

    given, found = here.views, corrected.adjustment.images
    moved = np.asarray(true.frame.from_ecef(np.asarray(given.frame.to_ecef(found.centre))))
    before = apart(
        given.R_frame_from_camera, np.asarray(true.frame.from_ecef(np.asarray(given.frame.to_ecef(given.centre))))
    )
    after = apart(found.R_frame_from_camera, moved)
    assert after < before / 3.0


def test_wrong_matches_are_left_out(here: Strip, ties: Ties, corrected: Correction) -> None:
    observed = ties.observations
    assert observed is not None
    rng = np.random.default_rng(3)
    wrong = rng.random(len(observed)) < 0.3
    uv = np.where(wrong[:, None], rng.uniform([0.0, 0.0], [255.0, 191.0], (len(observed), 2)), observed.uv)
    found = correct(here.views, ImagePoints(observed.image, observed.point, uv, observed.sigma))
    assert found.unconnected == ["image 4"]
    away = found.adjustment.images.centre - corrected.adjustment.images.centre
    assert np.max(np.abs(away) / corrected.adjustment.sigma_of_images[:, :3]) < 4.0
    assert found.left_out >= 0.8 * np.count_nonzero(wrong)


def test_blocks_that_cannot_be_tied_are_refused(here: Strip) -> None:
    with pytest.raises(ValueError, match="two images or more"):
        find_ties(views_of(here.names[:1], here.given[:1]), ground(), here.pictures)
    with pytest.raises(ValueError, match="no two of 2 images overlap"):
        find_ties(views_of(["a", "b"], [here.given[0], here.given[4]]), ground(), here.pictures)
    views = [Exposure(SENSOR, here.given[0])] * 2
    with pytest.raises(ValueError, match="no error of position"):
        Views.of(["a", "b"], views, [ERRORS[1:], ERRORS[1:]])


def test_points_seen_from_one_position_are_left_out(here: Strip, ties: Ties) -> None:
    """An image and its twin at the same place share points without parallax; all else is adjusted as without them."""
    observed = ties.observations
    assert observed is not None
    rows = np.flatnonzero(observed.image == here.names[0])
    twin = ImagePoints(
        np.concatenate([observed.image, np.repeat([here.names[0], here.names[4]], len(rows))]),
        np.concatenate([observed.point, *2 * [np.char.add("alone ", observed.point[rows].astype(str))]]),
        np.concatenate([observed.uv, observed.uv[rows], observed.uv[rows]]),
        np.concatenate([observed.sigma, observed.sigma[rows], observed.sigma[rows]]),
    )
    views = replace(
        here.views,
        centre=np.concatenate([here.views.centre[:4], here.views.centre[:1]]),
        R_frame_from_camera=np.concatenate([here.views.R_frame_from_camera[:4], here.views.R_frame_from_camera[:1]]),
    )
    found = correct(views, twin)
    alone = correct(here.views, observed)
    assert found.names == alone.names
    assert here.names[4] in found.unconnected
    assert found.left_out == alone.left_out + 2 * len(rows)
    assert np.allclose(found.moved, alone.moved, atol=1e-6)
    with pytest.raises(ValueError, match="parallel"):
        correct(views, twin.of(np.char.startswith(twin.point.astype(str), "alone")))


# Scenes that mislead matching: a periodic texture, water, and moving shadows. No wrong pose is accepted.

CERTAIN = 0.999


@functools.cache
def outcome(scene) -> tuple[Strip, Correction | None]:
    """The strip with images of a scene, and its correction: None if no tie points were found."""
    here = shown(strip(), scene)
    ties = find_ties(here.views, ground(1.0), here.pictures, Matching(sigma_height=2.0), points=48)
    return here, None if ties.observations is None else correct(here.views, ties)


@pytest.mark.parametrize("scene", [periodic, pytest.param(rows_of_trees, marks=pytest.mark.slow)])
def test_repeated_texture_is_not_tied(scene) -> None:
    assert outcome(scene)[1] is None


@pytest.mark.parametrize("scene", [pytest.param(water, marks=pytest.mark.slow), shadows])
def test_no_wrong_pose_is_accepted(scene) -> None:
    """Adjusted images err within the chi-square bounds of their covariances, each and together; the others are
    named."""
    here, found = outcome(scene)
    assert found is not None
    each, together = squared_errors(here, found)
    assert max(each) < scipy.stats.chi2.ppf(CERTAIN, 6)
    assert together < scipy.stats.chi2.ppf(CERTAIN, 6 * len(each))
    assert found.names == here.names[:4]
    assert found.unconnected == ["image 4"]
