"""Pix4D's calibrated camera (*_pix4d_calibrated_internal_camera_parameters.cam), as a frame camera."""

from __future__ import annotations

import os
import pathlib
import re
from collections.abc import Iterable

from jaxgeo._text_numbers import number_in, words_of
from jaxgeo.io._text import read_text
from jaxgeo.io.errors import TableError
from jaxgeo.sensor import BrownConrady, FrameCamera

ENDING = "_pix4d_calibrated_internal_camera_parameters.cam"
TWIN = "_calibrated_internal_camera_parameters.cam"  # the same camera for Inpho: it has the size of the images
START = re.compile(r"Pix4D camera calibration file\s+\S+", re.IGNORECASE)
SENSOR = re.compile(r"#\s*Focal Length.* sensor width of\s+([0-9.]+)\s*x\s*([0-9.]+)\s*mm", re.IGNORECASE)
SIZE = re.compile(r"#\s*Image size\s+([0-9]{1,7})\s*x\s*([0-9]{1,7})\s*pixel", re.IGNORECASE)
KEYS = ("F", "Px", "Py", "K1", "K2", "K3", "T1", "T2")
MOST_PIXELS = 10_000_000  # largest focal length and distance of the principal point
SQUARE = 0.01  # relative tolerance between the pixel pitches of columns and rows


def pix4d_camera(path: str | os.PathLike[str]) -> FrameCamera:
    """Read the camera of a `PROJECT_pix4d_calibrated_internal_camera_parameters.cam`.

    Layout as Pix4D writes it: F, Px and Py in mm of a sensor whose width and height are in a comment, distortion K1 K2
    K3 T1 T2 of OpenCV's formula; the principal point is counted from the image's corner. The number of pixels is that
    of `PROJECT_calibrated_internal_camera_parameters.cam` beside it. Raises `TableError` for several cameras in the
    file, values that are missing or not numbers, and an unknown number of pixels; `FileNotFoundError`.
    """
    what = "calibration of Pix4D"
    lines = [line.strip() for line in read_text(path, what).splitlines() if line.strip()]
    count = sum(START.fullmatch(line) is not None for line in lines)
    if count != 1:
        raise TableError(f"{path}: it has {count or 'no'} cameras ('Pix4D camera calibration file'); expected one, as "
                         f"in *{ENDING}.")  # fmt: skip
    sensor = next(filter(None, map(SENSOR.match, lines)), None)
    side = [] if sensor is None else [number_in(one) or 0.0 for one in sensor.groups()]
    if len(side) != 2 or min(side) <= 0.0:
        raise TableError(f"{path}: the sensor width in mm is missing.")
    found = {words[0]: number_in(words[1]) for words in map(words_of, lines) if len(words) == 2 and words[0] in KEYS}
    wrong = [key for key in KEYS if found.get(key) is None]
    if wrong:
        raise TableError(f"{path}: {wrong[0]} is missing, or no number.")
    focal, x, y, k1, k2, k3, t1, t2 = (found[key] or 0.0 for key in KEYS)
    width, height = _size(pathlib.Path(path))
    pitch = side[0] / width
    if abs(side[1] / height / pitch - 1.0) > SQUARE or not 0.0 < focal / pitch <= MOST_PIXELS:
        raise TableError(f"{path}: a sensor of {side[0]:g} x {side[1]:g} mm with F {focal:g} mm is none of {width} x "
                         f"{height} pixels.")  # fmt: skip
    if not max(abs(x), abs(y)) / pitch <= MOST_PIXELS:
        raise TableError(f"{path}: the principal point {x:g}, {y:g} mm is none of a sensor of {side[0]:g} x "
                         f"{side[1]:g} mm.")  # fmt: skip
    return frame_camera_of(
        (width, height), (focal / pitch, focal / pitch), (x / pitch, y / pitch), (k1, k2, k3), (t1, t2)
    )


def frame_camera_of(
    size: tuple[int, int],
    focal: tuple[float, float],
    principal: tuple[float, float],
    radial: Iterable[float],
    tangential: Iterable[float],
) -> FrameCamera:
    """A camera of Pix4D in pixels, its principal point from the image's corner."""
    (k1, k2, k3), (p1, p2) = map(float, radial), map(float, tangential)
    lens = BrownConrady(k1=k1, k2=k2, p1=p1, p2=p2, k3=k3) if any((k1, k2, k3, p1, p2)) else None
    return FrameCamera.from_pixels(
        focal_px=focal,
        width=size[0],
        height=size[1],
        principal_px=(principal[0] - 0.5, principal[1] - 0.5),
        distortion=lens,
    )


def _size(path: pathlib.Path) -> tuple[int, int]:
    """Columns and rows of the images, from Inpho's file of the same project."""
    twin = path.with_name(path.name.removesuffix(ENDING) + TWIN)
    if not path.name.endswith(ENDING) or not twin.is_file():
        name = twin.name if path.name.endswith(ENDING) else f"PROJECT{TWIN}"
        raise TableError(
            f"{path}: it does not state the number of pixels, and {name}, which does, is not beside it; copy it there, "
            f"or read PROJECT_calibrated_camera_parameters.txt, which needs no other camera."
        )
    found = next(filter(None, map(SIZE.match, read_text(twin, "calibration of Pix4D").splitlines())), None)
    if found is None or "0" in found.groups():
        raise TableError(f"{twin}: the size of the images ('#Image size') is missing.")
    return int(found[1]), int(found[2])
