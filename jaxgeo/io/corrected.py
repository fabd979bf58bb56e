"""Adjusted blocks as files: orientations with standard deviations, and tie points with residuals."""

from __future__ import annotations

import csv
import os
import pathlib

import jax
import numpy as np

from jaxgeo._destination import destination
from jaxgeo.adjust import Adjustment, LocalFrame
from jaxgeo.io._cells import Rows, safe_cell
from jaxgeo.io.opensfm import Reconstruction
from jaxgeo.io.orientations import Orientations
from jaxgeo.observation import Exposure
from jaxgeo.sensor import Gimbal, Mount, Pose, Sensor, Shot

STEP = 1e-6  # rad: of the differences between angles
TIE_COLUMNS = ("image", "point", "u", "v", "sigma_u_px", "sigma_v_px", "residual_u_px", "residual_v_px")


def orientations_of(found: Adjustment) -> Orientations:
    """The adjusted orientations as `write_orientations` takes them, with their standard deviations.

    Raises `TypeError` for a block off the Earth.
    """
    frame, images = found.block.frame, found.images
    if not isinstance(frame, LocalFrame):
        raise TypeError("the block has no place on the Earth: its frame is Cartesian.")
    R, covariance = images.R_frame_from_camera, found.covariance_of_images
    pose = _poses(found, R)
    given = _angles(pose)
    by_turn = np.stack([_wrapped(_angles(_poses(found, R @ _turn(axis))) - given) / STEP for axis in range(3)], axis=2)
    angles = np.einsum("nij,njk,nik->ni", by_turn, covariance[:, 3:, 3:], by_turn)
    east_north_up = np.diagonal(covariance, axis1=1, axis2=2)[:, :3]
    sigma = np.sqrt(np.maximum(np.concatenate([east_north_up[:, [1, 0, 2]], angles], axis=1), 0.0))
    return Orientations(images.name, pose, camera=images.camera, sigma=sigma, of_camera=True)


def exposures_of(found: Adjustment) -> list[Exposure]:
    """The adjusted images as exposures, in their order: each of a sensor whose camera looks down from the body.

    Raises `TypeError` for a block off the Earth.
    """
    poses, images, cameras = orientations_of(found).pose, found.images, found.cameras
    sensors = {name: Sensor(camera, Gimbal.fixed(), Mount.nadir()) for name, camera in cameras.items()}
    exposures = []
    for row, camera in enumerate(images.camera.tolist()):
        pose = jax.tree.map(lambda x, row=row: np.asarray(x)[row], poses)
        exposures.append(Exposure(sensors[camera], Shot(pose, np.zeros(0))))
    return exposures


def write_image_ties(path: str | os.PathLike[str], found: Adjustment) -> None:
    """Write the measurements of an adjusted block as CSV: image, point, pixel, its standard deviation and residual.

    Pixels are (column, row), u and v, with centres at integers; residuals are adjusted less measured, px. The file
    appears only when complete. Raises `ValueError` for a path that does not end in .csv.
    """
    target = pathlib.Path(path)
    if target.suffix.lower() != ".csv":
        raise ValueError(f"{target}: tie points of images are written as CSV; name a file that ends in .csv.")
    observed = found.block.observations
    numbers = np.concatenate([observed.uv, observed.sigma, found.residuals], axis=1)
    with destination("tie points", target) as stream:
        writer = csv.writer(Rows(stream), lineterminator="\r\n")
        writer.writerow(TIE_COLUMNS)
        for image, point, row in zip(observed.image, observed.point, numbers, strict=True):
            writer.writerow([safe_cell(str(image)), safe_cell(str(point)), *(f"{x:.4f}" for x in row)])


def _poses(found: Adjustment, R: np.ndarray) -> Pose:
    images, frame = found.images, found.block.frame
    assert isinstance(frame, LocalFrame)
    none = np.zeros(0, str), np.zeros((0, 3))
    return Reconstruction({}, images.name, images.camera, images.centre, R, *none, frame.origin).poses()


def _angles(pose: Pose) -> np.ndarray:
    return np.stack([np.asarray(x) for x in (pose.heading, pose.pitch, pose.roll)], axis=1)


def _wrapped(angles: np.ndarray) -> np.ndarray:
    return np.remainder(angles + np.pi, 2.0 * np.pi) - np.pi


def _turn(axis: int) -> np.ndarray:
    """Rotation by `STEP` about an axis."""
    x, y, z = STEP * np.eye(3)[axis]
    return np.eye(3) + np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
