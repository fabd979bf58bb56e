"""Sensors of drone images, from their tags or a given camera, with interior-orientation errors."""

from __future__ import annotations

import os
from typing import Any

import jax
import numpy as np

from jaxgeo.io.acquisitions._calibrations import (
    Calibration,
    arrays_of,
    calibration_by_table,
    calibration_of,
    exif_focal,
    full_size,
    interior_sigma,
)
from jaxgeo.io.acquisitions._digital_zoom import magnified_calibration, magnified_note, zoom_of
from jaxgeo.io.acquisitions._image_tags import ImageTags
from jaxgeo.io.acquisitions._makers import Maker
from jaxgeo.io.acquisitions._rigs import on_rig
from jaxgeo.io.acquisitions.record import for_each
from jaxgeo.io.camera_table import camera_models, named_camera, names_of
from jaxgeo.io.errors import TableError
from jaxgeo.io.given_camera import AS_GIVEN, FORMS, Lens, frame_camera, given_camera, resized
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Sensor
from jaxgeo.sensor.distortion import NoDistortion
from jaxgeo.uncertainty.sources import InteriorOrientation

# Yaw and other angles may exceed the drones' nominal limits: DJI writes pitches of -90.1 deg.
LIMITS = np.pi * np.array([[-2.0, 2.0], [-1.0, 1.0], [-1.0, 1.0]])

GivenCamera = FrameCamera | str | os.PathLike[str]


def sensor_of_images(
    tags: list[ImageTags], maker: Maker, camera: GivenCamera | None, notes: dict[str, None]
) -> tuple[Sensor, tuple[InteriorOrientation, ...], str]:
    """(sensors and their interior-orientation errors, with an entry for each image; focal length as text).

    `notes` gets a sentence for each assumption. Raises `TableError`, and as `given_camera`.
    """
    gimbal = Gimbal.three_axis(limits=LIMITS)
    mount = Mount.forward() if maker.looks == "forward" else Mount.nadir()
    if maker.looks == "down":
        notes |= {"Yaw, pitch and roll are taken in Pix4D's sense: of the camera, at zero looking straight down.": None}
    notes |= {maker.note: None} if maker.note else {}
    gimbal, mount = for_each(gimbal, len(tags)), on_rig(tags, for_each(mount, len(tags)), notes)
    given = None if camera is None else given_camera(camera)
    if isinstance(given, FrameCamera | Lens):
        made, how = _as_given(tags[0], given, notes)
        return Sensor(for_each(made, len(tags)), gimbal, mount), (), _focal_shown(made.focal_px, how)
    found = [_by_tags(one) if given is None else _by_name(one, given) for one in tags]
    notes |= dict.fromkeys(line for one in found for line in one.assumed)
    made = _camera(found, tags[0].width, tags[0].height)
    source = jax.tree.map(np.asarray, jax.vmap(InteriorOrientation)(interior_sigma(found, tags[0].width)))
    notes |= dict.fromkeys(_error_notes(found, source))
    ways = " or ".join(dict.fromkeys(one.how for one in found))
    return Sensor(made, gimbal, mount), (source,), _focal_shown(made.focal_px, ways)


def _as_given(tags: ImageTags, given: FrameCamera | Lens, notes: dict[str, None]) -> tuple[FrameCamera, str]:
    size, zoom = (tags.width, tags.height), zoom_of(tags)
    notes |= {AS_GIVEN: None} | ({magnified_note(zoom): None} if zoom > 1.0 else {})
    if isinstance(given, Lens):
        if given.size not in (None, size):
            raise TableError(f"{tags.path}: the image has {size[0]} x {size[1]} pixels; leave size= of camera= out.")
        return frame_camera(given, *size, full_width=full_size(tags)[0]), "as given"
    made = given if (given.width, given.height) == size else resized(given, *size)
    if made is None:
        raise TableError(
            f"{tags.path}: the image has {size[0]} x {size[1]} pixels, the camera given {given.width} x "
            f"{given.height}, which is another shape; give the camera of these images."
        )
    if made is not given:
        notes |= {
            f"The camera given has {given.width} x {given.height} pixels, the image {size[0]} x {size[1]}: it is taken "
            f"as the whole image at another size.": None
        }
    return made, "as given"


def _by_tags(tags: ImageTags) -> Calibration:
    zoom = zoom_of(tags)
    return calibration_of(tags) if zoom == 1.0 else magnified_calibration(tags, zoom)


def _by_name(tags: ImageTags, name: str) -> Calibration:
    """The calibration of a named camera, from the table of cameras."""
    width, height = full_size(tags)
    known = named_camera(name, width, height, exif_focal(tags))
    zoom = zoom_of(tags)
    if known is not None and zoom > 1.0:
        return magnified_calibration(tags, zoom, known)
    if known is not None:
        found = calibration_by_table(known, width, height)
        return found.scaled(tags.width / width, tags.height / height)
    named = [one for one in camera_models() if name.strip().lower() in names_of(one)]
    if not named:
        raise TableError(f"{tags.path}: camera={name!r} is not in the table of cameras. Give {FORMS}.")
    sizes = ", ".join(dict.fromkeys(f"{w} x {h}" for one in named for w, h, _ in one.modes))
    raise TableError(
        f"{tags.path}: camera={name!r} has images of {sizes} pixels in the table of cameras (a zoom also needs "
        f"EXIF:FocalLength), and this one has {width} x {height}. Give {FORMS}."
    )


def _camera(found: list[Calibration], width: int, height: int) -> FrameCamera:
    focal, principal, coefficients = arrays_of(found)
    distortion = BrownConrady(*coefficients.T) if np.any(coefficients) else NoDistortion()
    return FrameCamera(focal, principal, distortion, width, height)


def _error_notes(found: list[Calibration], source: InteriorOrientation) -> list[str]:
    """Sentences on the interior-orientation errors."""
    shares = np.array([100.0 * one.focal_sigma for one in found])
    sigma = np.asarray(source.sigma)
    focal, point = span_shown(sigma[:, 0], ".3g"), span_shown(sigma[:, 1], ".3g")
    return [
        f"Focal length sigma: {span_shown(shares, '.2g')} %, {focal} pixels (default for its source).",
        f"Principal point sigma: {point} pixels (default for its source).",
    ]


def _focal_shown(focal: Any, how: str) -> str:
    return f"{span_shown(np.asarray(focal), '.6g')} pixels ({how})"


def span_shown(numbers: np.ndarray, form: str) -> str:
    """The smallest and largest of some numbers as text, one number if equal."""
    low, high = format(numbers.min(), form), format(numbers.max(), form)
    return low if low == high else f"{low} to {high}"
