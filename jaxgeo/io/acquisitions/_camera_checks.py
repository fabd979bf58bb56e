"""Cameras that hardly exist: fields of view beyond those of lenses, and pixels that are not square."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.acquisitions.sentences import DOUBT
from jaxgeo.sensor import FrameCamera

NARROW, WIDE = 0.1, 150.0  # deg, across the image: a telescope, and more than lenses without distortion cover
SQUARE = 1.1  # largest ratio of the sides of a pixel


def camera_doubts(camera: FrameCamera) -> list[str]:
    """Sentences on a camera, or several in a batch, whose field of view or pixels are those of no camera."""
    size = np.array([camera.width, camera.height])
    focal = np.asarray(camera.focal_px, np.float64).reshape(-1, 2)
    fields = np.rad2deg(2.0 * np.arctan(0.5 * size / focal))
    image = f"{camera.width} x {camera.height} pixels"
    for row in np.flatnonzero((fields.max(axis=1) > WIDE) | (fields.min(axis=1) < NARROW))[:1]:
        across, down = fields[row]
        return [
            f"{DOUBT}The field of view is {across:.3g} x {down:.3g} deg, by a focal length of {focal[row, 0]:.5g} "
            f"pixels of an image of {image}. Is the focal length in the unit that is meant, and of this image?"
        ]
    ratio = focal[:, 0] / focal[:, 1]
    for row in np.flatnonzero(np.maximum(ratio, 1.0 / ratio) > SQUARE)[:1]:
        return [
            f"{DOUBT}Pixels are not square: the focal length is {focal[row, 0]:.5g} pixels along columns and "
            f"{focal[row, 1]:.5g} along rows of an image of {image}. Is this its size, width first?"
        ]
    return []


def with_camera_doubts(read: Callable[..., Acquisition]) -> Callable[..., Acquisition]:
    """A reader whose exposures have these sentences among the assumptions."""

    @functools.wraps(read)
    def wrapped(*args: Any, **how: Any) -> Acquisition:
        found = read(*args, **how)
        camera = None if found.sensor is None else found.sensor.camera
        doubts = camera_doubts(camera) if isinstance(camera, FrameCamera) else []
        return dataclasses.replace(found, assumed=(*found.assumed, *doubts)) if doubts else found

    return wrapped
