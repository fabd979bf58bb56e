"""Camera of telemetry: from the fields of view in the packets, or given by the caller."""

from __future__ import annotations

import math
import os
from typing import Any

import jax
import numpy as np

from jaxgeo.io.acquisitions._klv_columns import DERIVED, Columns, Numbers
from jaxgeo.io.acquisitions.record import for_each
from jaxgeo.io.errors import TableError
from jaxgeo.io.given_camera import FORMS, Lens, frame_camera, given_camera, resized
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Sensor
from jaxgeo.sensor.distortion import NoDistortion
from jaxgeo.uncertainty.sources import InteriorOrientation

# Relative standard deviations of the focal length. Fields of view in packets come from a zoom position, in
# steps of 0.003 deg, for a lens of unknown distortion. Target width and slant range are both estimates, the
# width in steps of 0.15 m, and give the field of view over ground that is level across the image.
TOLD_SIGMA, DERIVED_SIGMA = 0.01, 0.05
USUAL_SIZES = ((1280, 720), (640, 480), (1280, 1024), (1024, 1024))  # one per aspect ratio, in pixels


def camera_of(path: Any, camera: FrameCamera | str | os.PathLike[str] | None) -> FrameCamera | Lens | None:
    """The caller's camera, used instead of fields of view. Raises `TableError` for a name, and as `given_camera`."""
    given = None if camera is None else given_camera(camera)
    if isinstance(given, str):
        raise TableError(f"{path}: telemetry names no cameras, so camera={given!r} is none of it. Give {FORMS}.")
    return given


def size_of(given: FrameCamera | Lens | None) -> tuple[int, int] | None:
    """The image size in pixels of a given camera."""
    return (given.width, given.height) if isinstance(given, FrameCamera) else given.size if given else None


def usual_size(columns: Columns) -> tuple[int, int]:
    """An image size in pixels by the ratio of the fields of view; 16:9 if only one is known."""
    across, down = columns["field_across"], columns["field_down"]
    ratios = np.tan(0.5 * across) / np.tan(0.5 * down)
    ratio = np.median(ratios[np.isfinite(ratios)]) if np.isfinite(ratios).any() else 16.0 / 9.0
    return min(USUAL_SIZES, key=lambda size: abs(math.log(size[0] / size[1] / ratio)))


def sensor_of(path: Any, columns: Columns, size: tuple[int, int], given: FrameCamera | Lens | None) -> Sensor:
    """The camera along the x axis of a head rotated by azimuth, elevation and roll, in this order, in the body."""
    count = len(columns["time"])
    camera = _camera_of(columns, size) if given is None else for_each(_given(path, given, size), count)
    turn = 2.0 * np.pi
    limits = np.array([[-turn, turn], [-np.pi, np.pi], [-np.pi, np.pi]])
    gimbal = Gimbal.three_axis(limits=limits, reference="body")
    return Sensor(camera, for_each(gimbal, count), for_each(Mount.forward(), count))


def lens_errors(numbers: Numbers, sensor: Sensor) -> tuple[InteriorOrientation, str]:
    """(focal length errors of n packets by the source of the field of view; as a sentence).

    The principal point has no error of its own: the angles in the packets refer to the image centre.
    """
    is_derived = numbers.origin == DERIVED
    shares = np.where(is_derived, DERIVED_SIGMA, TOLD_SIGMA)
    focal = np.asarray(sensor.camera.focal_px)[:, 0]  # pyright: ignore[reportAttributeAccessIssue]
    sigma = np.stack([shares * focal, np.zeros(len(focal)), np.zeros(len(focal))], axis=-1)
    kinds = [] if is_derived.all() else [f"{100.0 * TOLD_SIGMA:g} % by fields of view in the packets"]
    kinds += [f"{100.0 * DERIVED_SIGMA:g} % by target width and slant range"] if is_derived.any() else []
    note = (
        f"Focal length sigma: {', '.join(kinds)}; the principal point has no error of its own, as the angles are those "
        f"of the middle of the image."
    )
    return jax.tree.map(np.asarray, jax.vmap(InteriorOrientation)(sigma)), note


def _camera_of(columns: Columns, size: tuple[int, int]) -> FrameCamera:
    """The cameras of n packets from their fields of view."""
    half = np.array(size) / 2.0
    focal = half / np.tan(0.5 * np.stack([columns["field_across"], columns["field_down"]], axis=-1))
    focal = np.where(np.isfinite(focal), focal, focal[:, ::-1])  # square pixels where one field is unknown
    count = len(focal)
    principal = np.broadcast_to(half - 0.5, (count, 2))
    return FrameCamera(focal, principal, for_each(NoDistortion(), count), *size)


def _given(path: Any, given: FrameCamera | Lens, size: tuple[int, int]) -> FrameCamera:
    if isinstance(given, Lens):
        return frame_camera(given, *size, given.size[0] if given.size else None)
    camera = resized(given, *size)
    if camera is None:
        raise TableError(
            f"{path}: camera= has {given.width} x {given.height} pixels, and the images are of another shape, "
            f"{size[0]} x {size[1]}."
        )
    return camera
