"""Digitally zoomed images: the camera from the table of cameras, with a longer focal length."""

from __future__ import annotations

import math
from dataclasses import replace

from jaxgeo.io.acquisitions._calibrations import (
    MIDDLE,
    Calibration,
    calibration_by_table,
    camera_shown,
    check_whole,
    full_size,
    in_file,
    known_of,
)
from jaxgeo.io.acquisitions._image_tags import ImageTags
from jaxgeo.io.camera_table import SAME_FOCAL, KnownCamera
from jaxgeo.io.given_camera import FORMS

RATIO = "EXIF:DigitalZoomRatio"
LEAST = 1.001  # minimum ratio that counts as zoom
UNSURE = 0.02  # relative standard deviation of the focal length per unit of magnification


def zoom_of(tags: ImageTags) -> float:
    """Digital zoom ratio of the image; 1 without zoom."""
    zoom = None if tags.unknown("digital zoom") else tags.number(RATIO, (0.0, 1e4, "times"))
    return zoom if zoom is not None and zoom > LEAST else 1.0


def magnified_calibration(tags: ImageTags, zoom: float, named: KnownCamera | None = None) -> Calibration:
    """The camera of a digitally zoomed image from the table of cameras, by name (`named`) or by the tags.

    If the image has the full size of one of the camera's modes, the central part of the detector was upsampled to
    it, and the focal length in pixels is multiplied by the zoom. The standard deviation of the focal length grows with
    the magnification, and so does that of the principal point, as the part may be off-centre. A calibration in
    the image is not used, since it may refer to before or after the zoom. Raises `TableError` for other cameras and
    sizes.
    """
    width, height = full_size(tags)
    check_whole(tags, width, height)
    known = known_of(tags, width, height) if named is None else named
    if known is None or not _is_resampled(tags, known, width, height):
        raise tags.wrong(
            RATIO,
            f"the image is magnified {zoom:g} times, and {camera_shown(tags)} with {width} x {height} pixels of it is "
            f"not in the table of cameras, which would give the part of the detector. Give the camera with its "
            f"focal length {zoom:g} times as long: {FORMS}.",
        )
    plain = calibration_by_table(known, width, height)
    more = UNSURE * (zoom - 1.0)
    note = (
        f"{RATIO} {zoom:g}: the image has the {width} x {height} pixels of the whole detector, so it is taken as the "
        f"middle part made so much larger: the focal length is {zoom:g} times that of the table, and its "
        f"sigma is {100.0 * more:.3g} % larger."
    )
    found = replace(
        plain,
        focal=(plain.focal[0] * zoom, plain.focal[1] * zoom),
        how=f"{plain.how}, magnified {zoom:g} times",
        assumed=(*plain.assumed, note),
        focal_sigma=math.hypot(plain.focal_sigma, more),
        principal_sigma=MIDDLE * zoom,
    )
    return in_file(tags, found, width, height)


def _is_resampled(tags: ImageTags, known: KnownCamera, width: int, height: int) -> bool:
    """Whether the image has the full size of a camera mode, with any optical zoom at its long end."""
    model = known.model
    if model.zoom_mm is not None and known.focal_mm < model.zoom_mm[1] * (1.0 - SAME_FOCAL):
        return False
    return any((width, height) == mode[:2] for mode in model.modes)


def magnified_note(zoom: float) -> str:
    """Sentence: the caller's camera is used unchanged."""
    return (
        f"{RATIO} {zoom:g}: the camera that is given is taken as that of the magnified image, its focal length "
        f"{zoom:g} times that of the lens."
    )
