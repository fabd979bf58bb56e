"""Scenes that mislead matching: a periodic texture, water, and moving shadows. No wrong pose is accepted."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation
from support.drone_strip import CELL, SENSOR, SHAPE, Strip, ground, strip, views_of

from jaxgeo import Geodetic
from jaxgeo.ortho import Orthoimage, render
from jaxgeo.terrain import TangentGrid
from jaxgeo.ties import Correction, Matching, correct, find_ties

pytestmark = pytest.mark.costly

PERIOD = 8.0  # m, less than the errors of the search area are
CERTAIN = 0.999


def seen(here: Strip, values: np.ndarray, of: int | None = None) -> list[np.ndarray]:
    """Images of a map without noise; the last of the strip is not on it."""
    centre = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    grid = TangentGrid.centred(centre, spacing=(CELL, CELL), shape=SHAPE)
    rows = range(len(here.true) - 1) if of is None else [of]
    return [render(SENSOR, here.true[k], Orthoimage.of(values, grid), ground()).values[0] for k in rows]


def texture(seed: int) -> np.ndarray:
    """A random map of mean 100 and standard deviation 50."""
    rng = np.random.default_rng(seed)
    noise = [scipy.ndimage.gaussian_filter(rng.normal(size=SHAPE), width) for width in (1.0, 2.5, 6.0)]
    return 100.0 + 30.0 * sum(one / np.std(one) for one in noise)


def periodic(here: Strip) -> list[np.ndarray]:
    """Only a lattice that repeats every `PERIOD`."""
    rows, cols = np.indices(SHAPE) * (2.0 * np.pi * CELL / PERIOD)
    return seen(here, 100.0 + 40.0 * (np.sin(rows) + np.sin(cols) + 0.5 * np.sin(2.0 * cols + rows)))


def rows_of_trees(here: Strip) -> list[np.ndarray]:
    """A lattice over a weak random texture."""
    rows, cols = np.indices(SHAPE) * (2.0 * np.pi * CELL / PERIOD)
    return seen(here, 100.0 + 40.0 * (np.sin(rows) + np.sin(cols)) + 0.2 * (texture(0) - 100.0))


def water(here: Strip) -> list[np.ndarray]:
    """Half of the ground has a texture of its own in every image."""
    is_water = np.broadcast_to(np.arange(SHAPE[1])[None, :] < 0.5 * SHAPE[1], SHAPE)
    return [seen(here, np.where(is_water, texture(10 + k), texture(0)), k)[0] for k in range(len(here.true) - 1)]


def shadows(here: Strip) -> list[np.ndarray]:
    """Dark patches that all move by 2 m from image to image, over a fifth of the ground."""
    blobs = scipy.ndimage.gaussian_filter(np.random.default_rng(5).normal(size=SHAPE), 8.0)
    dark = blobs > np.quantile(blobs, 0.8)
    moved = [np.roll(dark, (4 * k, 4 * k), axis=(0, 1)) for k in range(len(here.true) - 1)]
    return [seen(here, np.where(one, 0.35, 1.0) * texture(0), k)[0] for k, one in enumerate(moved)]


def errors_of(here: Strip, found: Correction) -> np.ndarray:
    """Errors (n, 6) of the adjusted orientations: centre in m, rotation about the camera's axes in rad."""
    true = views_of(here.names, here.true)
    rows = [here.names.index(name) for name in found.names]
    exact = np.asarray(found.views.frame.from_ecef(np.asarray(true.frame.to_ecef(true.centre[rows]))))
    turn = np.swapaxes(true.R_frame_from_camera[rows], 1, 2) @ found.adjustment.images.R_frame_from_camera
    return np.hstack([found.adjustment.images.centre - exact, Rotation.from_matrix(turn).as_rotvec()])


@functools.cache
def outcome(scene) -> tuple[Strip, Correction | None]:
    """The strip with images of a scene, and its correction: None if no tie points were found."""
    here = strip()
    rng = np.random.default_rng(7)
    images = [one + 0.05 * np.std(one) * rng.normal(size=one.shape) for one in scene(here)]
    here = replace(here, images=[*images, here.images[-1]])
    ties = find_ties(here.views, ground(1.0), here.pictures, Matching(sigma_height=2.0), points=48)
    return here, None if ties.observations is None else correct(here.views, ties)


@pytest.mark.parametrize("scene", [periodic, rows_of_trees])
def test_repeated_texture_is_not_tied(scene) -> None:
    assert outcome(scene)[1] is None


@pytest.mark.parametrize("scene", [water, shadows])
def test_no_wrong_pose_is_accepted(scene) -> None:
    """Each adjusted image errs within the chi-square bound of its covariance; the others are named."""
    here, found = outcome(scene)
    assert found is not None
    covariance = found.adjustment.covariance_of_images
    squared = [e @ np.linalg.solve(c, e) for e, c in zip(errors_of(here, found), covariance, strict=True)]
    assert max(squared) < scipy.stats.chi2.ppf(CERTAIN, 6)
    assert found.names == here.names[:4]
    assert found.unconnected == ["image 4"]


WRONG = pytest.mark.xfail(strict=True, reason="matches on edges of shadows that move alike are not all left out")


@pytest.mark.parametrize("scene", [water, pytest.param(shadows, marks=WRONG)])
def test_errors_of_all_images_together_are_as_predicted(scene) -> None:
    here, found = outcome(scene)
    assert found is not None
    errors = errors_of(here, found).ravel()
    together = errors @ np.linalg.solve(found.adjustment.covariance[: errors.size, : errors.size], errors)
    assert together < scipy.stats.chi2.ppf(CERTAIN, errors.size)
