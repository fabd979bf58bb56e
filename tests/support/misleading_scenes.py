"""Scenes that mislead matching, seen by the images of a strip: a periodic texture, water, and moving shadows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from jaxgeo import Geodetic
from jaxgeo.ortho import Orthoimage, render
from jaxgeo.terrain import TangentGrid
from jaxgeo.ties import Correction
from support.drone_strip import CELL, SENSOR, SHAPE, Strip, ground, views_of

PERIOD = 8.0  # m, less than the errors of the search area are
NOISE = 0.05  # of the standard deviation of an image


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
    return 100.0 + 30.0 * np.sum([one / np.std(one) for one in noise], axis=0)


def plain(here: Strip, seed: int = 0) -> list[np.ndarray]:
    """Random texture alone."""
    return seen(here, texture(100 * seed))


def periodic(here: Strip, seed: int = 0) -> list[np.ndarray]:
    """Only a lattice that repeats every `PERIOD`."""
    turn = 0.3 * seed
    rows, cols = np.indices(SHAPE) * (2.0 * np.pi * CELL / PERIOD)
    rows, cols = np.cos(turn) * rows - np.sin(turn) * cols, np.sin(turn) * rows + np.cos(turn) * cols
    return seen(here, 100.0 + 40.0 * (np.sin(rows) + np.sin(cols) + 0.5 * np.sin(2.0 * cols + rows)))


def rows_of_trees(here: Strip, seed: int = 0) -> list[np.ndarray]:
    """A lattice over a weak random texture."""
    rows, cols = np.indices(SHAPE) * (2.0 * np.pi * CELL / PERIOD)
    return seen(here, 100.0 + 40.0 * (np.sin(rows) + np.sin(cols)) + 0.2 * (texture(100 * seed) - 100.0))


def water(here: Strip, seed: int = 0) -> list[np.ndarray]:
    """Half of the ground has a texture of its own in every image."""
    is_water = np.broadcast_to(np.arange(SHAPE[1])[None, :] < 0.5 * SHAPE[1], SHAPE)
    count, first = len(here.true) - 1, 100 * seed
    return [seen(here, np.where(is_water, texture(first + 10 + k), texture(first)), k)[0] for k in range(count)]


def shadows(here: Strip, seed: int = 0) -> list[np.ndarray]:
    """Dark patches that all move by 2 m from image to image, over a fifth of the ground."""
    blobs = scipy.ndimage.gaussian_filter(np.random.default_rng(100 * seed + 5).normal(size=SHAPE), 8.0)
    dark = blobs > np.quantile(blobs, 0.8)
    moved = [np.roll(dark, (4 * k, 4 * k), axis=(0, 1)) for k in range(len(here.true) - 1)]
    return [seen(here, np.where(one, 0.35, 1.0) * texture(100 * seed), k)[0] for k, one in enumerate(moved)]


def shown(here: Strip, scene: Callable[..., list[np.ndarray]], seed: int = 0) -> Strip:
    """The strip with noisy images of a scene."""
    rng = np.random.default_rng(seed + 7)
    images = [one + NOISE * np.std(one) * rng.normal(size=one.shape) for one in scene(here, seed)]
    return replace(here, images=[*images, here.images[-1]])


def errors_of(here: Strip, found: Correction) -> np.ndarray:
    """Errors (n, 6) of the adjusted orientations: centre in m, rotation about the camera's axes in rad."""
    true = views_of(here.names, here.true)
    rows = [here.names.index(name) for name in found.names]
    exact = np.asarray(found.views.frame.from_ecef(np.asarray(true.frame.to_ecef(true.centre[rows]))))
    turn = np.swapaxes(true.R_frame_from_camera[rows], 1, 2) @ found.adjustment.images.R_frame_from_camera
    return np.hstack([found.adjustment.images.centre - exact, Rotation.from_matrix(turn).as_rotvec()])


def squared_errors(here: Strip, found: Correction) -> tuple[list[float], float]:
    """Squared errors by their covariance: those of each image, of 6 degrees of freedom, and of all together."""
    errors = errors_of(here, found)
    each = zip(errors, found.adjustment.covariance_of_images, strict=True)
    covariance = found.adjustment.covariance[: errors.size, : errors.size]
    flat = errors.ravel()
    return [float(e @ np.linalg.solve(c, e)) for e, c in each], float(flat @ np.linalg.solve(covariance, flat))
