"""Blocks of views: images, measurements and control, with the navigation of the cameras themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxgeo.adjust import Block, GroundPoints, ImagePoints, Images, Navigation
from jaxgeo.adjust.exposures import LEAST_ATTITUDE, LEAST_POSITION
from jaxgeo.adjust.kept import Kept, control_of
from jaxgeo.sensor import Mount
from jaxgeo.ties.shared import OF_SHOT
from jaxgeo.ties.views import Views

STRIP = "strip"  # name of the only one


def block_of_views(views: Views, observations: ImagePoints, ground: GroundPoints | None = None) -> Block:
    """The block of those images that have observations, with those control points that have any."""
    rows = np.flatnonzero(np.isin(views.name, observations.image))
    images = Images(views.name[rows], views.camera[rows], views.centre[rows], views.R_frame_from_camera[rows])
    cameras = {name: views.cameras[name] for name in dict.fromkeys(images.camera.tolist())}
    if ground is not None:
        seen = ground.name[np.isin(ground.name, observations.point)].tolist()
        ground = ground.of(seen) if seen else None
    return Block(
        views.frame,
        cameras,
        images,
        observations,
        ground,
        navigation=_navigation(views).of(rows),
        readout={name: value for name, value in views.readout.items() if name in cameras},
        atmosphere=views.atmosphere,
    )


def _navigation(views: Views) -> Navigation:
    """Navigation of the cameras themselves: perspective centres, and rotations about the camera's axes."""
    count, eye = len(views), np.eye(3)
    each = np.broadcast_to(eye, (count, 3, 3))
    position, attitude = (views.own[:, part, part] for part in (np.s_[:3], np.s_[3:]))
    zero = np.zeros(3)
    return Navigation(
        position=views.centre,
        R_frame_from_body=views.R_frame_from_camera,
        R_frame_from_reference=views.R_frame_from_camera,
        R_base_from_head=each,
        information_position=information_of(position, LEAST_POSITION),
        information_attitude=information_of(attitude, LEAST_ATTITUDE),
        mount=views.camera,
        strip=np.full(count, STRIP),
        time=np.zeros(count),
        mounts={str(name): (Mount(eye, eye, zero, zero), False) for name in views.cameras},
        common=views.common,
        velocity=views.velocity,
        turn_rate=views.turn_rate,
    )


def shots_of_block(block: Block) -> np.ndarray:
    """A number (n,) for each image, the same for images that share errors of one shot."""
    common = {} if block.navigation is None else block.navigation.common
    of_shots = [np.any(effects != 0.0, axis=1) for name, effects in common.items() if OF_SHOT in name]
    if not of_shots:
        return np.arange(len(block.images))
    shared = np.stack([*of_shots, *np.diag(~np.any(of_shots, axis=0))], axis=1)
    return np.unique(shared, axis=0, return_inverse=True)[1].ravel()


def free_poses(block: Block) -> int:
    """Number of images whose orientations are free of each other: those of one shot count once."""
    return len(np.unique(shots_of_block(block)))


def with_places(block: Block, kept: Kept) -> Kept:
    """Without the measurements of points that a single shot still shows and that are not control."""
    shot = shots_of_block(block)
    if len(np.unique(shot)) == len(shot):
        return kept
    known = control_of(block).name[kept.control].tolist()
    rows = in_several(block.observations, shot[block.images.rows_of(block.observations.image)], kept.rows, known)
    return Kept(rows, kept.control)


def in_several(observations: ImagePoints, shot: np.ndarray, rows: np.ndarray, known: Sequence[str]) -> np.ndarray:
    """Flags (k,) of those measurements among `rows` whose points are `known`, or in two shots or more by these; `shot`
    (k,) is that of each."""
    names, point = observations.point_numbers
    pairs = np.unique(np.stack([point[rows], shot[rows]], axis=1), axis=0)
    often = np.bincount(pairs[:, 0], minlength=len(names)) >= 2
    return rows & (often | np.isin(names, list(known)))[point]


def information_of(covariance: np.ndarray, least: float) -> np.ndarray:
    """W (n, 3, 3) with W' W the inverse of covariances, which a standard deviation is added to."""
    return np.linalg.inv(np.linalg.cholesky(covariance + least**2 * np.eye(3)))
