"""Camera arguments: a lens as text, a camera file, a table name, or a `FrameCamera`."""

from __future__ import annotations

import dataclasses
import math
import os
import pathlib
import re
from typing import Any

from jaxgeo.io.errors import TableError
from jaxgeo.sensor import FrameCamera
from jaxgeo.sensor.camera import LONGEST, PITCHES

FORMS = (
    'camera="focal=8.8mm,pitch=2.41um" (focal length and pixel size), camera="focal=8.8mm,sensor=13.2mm" (and width of '
    'the sensor), camera="focal=3666px" (focal length in pixels of the image), camera="film=24mm" (that equivalent for '
    '35 mm film), camera="camera.toml" (a scene file, or its table [camera] alone), or camera="cameras.json" (of '
    "OpenSfM or OpenDroneMap)"
)
OWN_CAMERA = (
    'camera="focal=8.8mm,pitch=2.41um,size=5472x3648"; of a focal length for 35 mm film, '
    'camera="film=24mm,size=3840x2160"'
)  # for files that know no camera
UNITS = {"focal": ("mm", "px"), "film": ("mm",), "pitch": ("um",), "sensor": ("mm",), "size": ("",)}
IN_MM = {"nm": 1e-6, "um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3}
RANGES = {  # of lengths in the first unit of each, as those of `FrameCamera.from_metric` and scene files
    "focal": (0.0, 1e3 * LONGEST),
    "film": (0.0, 1e3 * LONGEST),
    "pitch": (1e6 * PITCHES[0], 1e6 * PITCHES[1]),
    "sensor": (0.0, 1e3 * LONGEST),
}
AS_GIVEN = "The camera is taken as given, without error unless sigmas of its interior orientation are given too."
AS_READ = "Cameras are taken from the file, without error unless sigmas of the interior orientation are given too."
CLOSE = 0.005  # relative tolerance between the scales of columns and rows of resized images
FILM_DIAGONAL = math.hypot(36.0, 24.0)  # mm
# Relative standard deviations of focal lengths for 35 mm film: against calibrations of 15 models the error was -10 to
# +2 %, which 1.645 times 6 % covers; for images cropped to a video aspect ratio it was 9 % over the table of cameras.
FILM, FILM_CUT = 0.06, 0.09
WIDE = 1.6  # aspect ratio above which an image was cropped from a 4:3 or 3:2 detector
_VALUE = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)\s*", re.ASCII)


@dataclasses.dataclass(frozen=True)
class Lens:
    """Focal length in mm, with pixel size in um or sensor width in mm; or in pixels; or for 35 mm film; optionally an
    image size."""

    focal_mm: float | None = None
    focal_px: float | None = None
    pitch_um: float | None = None
    sensor_mm: float | None = None
    size: tuple[int, int] | None = None
    film_mm: float | None = None

    def focal_at(self, width: int, full_width: int) -> float:
        """Focal length in pixels of an image `width` pixels wide, resized from the camera's `full_width`."""
        if self.focal_px is not None:
            return self.focal_px
        assert self.focal_mm is not None
        if self.sensor_mm is not None:
            return self.focal_mm / self.sensor_mm * width
        assert self.pitch_um is not None
        return 1e3 * self.focal_mm / self.pitch_um * width / full_width


def given_camera(camera: FrameCamera | str | os.PathLike[str]) -> FrameCamera | Lens | str:
    """Parse a camera: a lens from text with "=", a camera from a .toml file, Pix4D's .cam or OpenSfM's .json, else a
    name.

    Raises `TableError` for an invalid lens, for lengths out of the ranges of `FrameCamera.from_metric`, and a file with
    several cameras, `SceneError` for a file, `FileNotFoundError`.

    >>> from jaxgeo.io.given_camera import given_camera
    >>> lens = given_camera("focal=8.8mm,pitch=2.41um")
    >>> print(round(lens.focal_at(width=5472, full_width=5472), 3))
    3651.452
    """
    if isinstance(camera, FrameCamera):
        return camera
    text = os.fspath(camera)
    ending = pathlib.Path(text).suffix.lower()
    if ending == ".toml":
        from jaxgeo.io.scene import read_camera

        return read_camera(text)
    if ending == ".cam":
        from jaxgeo.io.pix4d_camera import pix4d_camera

        return pix4d_camera(text)
    if ending == ".json":
        cameras = _cameras_of_file(text)
        if len(cameras) > 1:
            raise TableError(
                f"{text}: it has {len(cameras)} cameras, {', '.join(cameras)}; here one is meant. For a table of "
                "orientations that names the camera of each image, it is taken as it is."
            )
        return next(iter(cameras.values()))
    return _lens(text) if "=" in text else text


def cameras_by_name(camera: FrameCamera | str | os.PathLike[str]) -> FrameCamera | dict[str, FrameCamera]:
    """One camera with its image size, or the cameras of a file with several; raises as `whole_camera`."""
    if not isinstance(camera, FrameCamera) and pathlib.Path(camera).suffix.lower() == ".json":
        cameras = _cameras_of_file(camera)
        return cameras if len(cameras) > 1 else next(iter(cameras.values()))
    return whole_camera(camera)


def is_a_name(camera: Any) -> bool:
    """Whether a camera is given by a name."""
    return isinstance(camera, str) and "=" not in camera and not camera.lower().endswith((".toml", ".cam", ".json"))


def _cameras_of_file(path: str | os.PathLike[str]) -> dict[str, FrameCamera]:
    from jaxgeo.io.opensfm import read_opensfm_cameras

    return read_opensfm_cameras(path)


def _lens(text: str) -> Lens:
    found: dict[str, Any] = {}
    for part in text.split(","):
        name, _, written = part.partition("=")
        name = name.strip().lower()
        if name not in UNITS or name in found or not written.strip():
            raise _wrong(text, f"{part.strip()!r} is none of focal=, film=, pitch=, sensor=, size=, each once")
        found[name] = _size(text, written) if name == "size" else _quantity(text, name, written)
    if "film" in found and not set(found) - {"film", "size"}:
        return Lens(film_mm=found["film"][0], size=found.get("size"))
    if "film" in found:
        raise _wrong(text, "a focal length for 35 mm film, film=, goes with size= alone")
    if "focal" not in found:
        raise _wrong(text, "the focal length is missing")
    focal, unit = found["focal"]
    pitch, sensor = (found.get(name, (None, ""))[0] for name in ("pitch", "sensor"))
    if unit == "px" and (pitch or sensor):
        raise _wrong(text, "a focal length in px needs neither pitch nor sensor")
    if unit == "mm" and (pitch is None) == (sensor is None):
        raise _wrong(text, "a focal length in mm needs either the pixel size, pitch=, or the sensor width, sensor=")
    return Lens(focal if unit == "mm" else None, focal if unit == "px" else None, pitch, sensor, found.get("size"))


def _quantity(text: str, name: str, written: str) -> tuple[float, str]:
    matched = _VALUE.fullmatch(written.lower().replace("µ", "u").replace("μ", "u"))
    units = UNITS[name]
    if matched is None or matched[2] not in units or not 0.0 < float(matched[1]) < math.inf:
        meant = None if matched is None else _meant(name, float(matched[1]), matched[2])
        hint = "" if meant is None else f" ({name}={meant}?)"
        raise _wrong(text, f"{name}={written.strip()} is not a number above zero in {' or '.join(units)}{hint}")
    value, unit = float(matched[1]), matched[2]
    if unit == units[0] and not _is_in_range(name, value):
        low, high = RANGES[name]
        limits = f"from {low:g} to {high:g}" if low else f"at most {high:g}"
        raise _wrong(text, f"{name}={written.strip()} is no such length of a camera; expected {limits} {unit}")
    return value, unit


def _meant(name: str, value: float, unit: str) -> str | None:
    """A length in the expected unit that a value in another unit, or in none, may stand for.

    It is converted, or if that is out of range, with its unit replaced; None if neither is in range.
    """
    expected = UNITS[name][0]
    same = [value] if len(UNITS[name]) == 1 else []
    converted = [float(f"{value * IN_MM[unit] / IN_MM[expected]:.12g}")] if unit in IN_MM else []
    fitting = [one for one in (*converted, *same) if _is_in_range(name, one)]
    return f"{fitting[0]:.12g}{expected}" if fitting else None


def _is_in_range(name: str, value: float) -> bool:
    low, high = RANGES[name]
    return low <= value <= high and value > 0.0


def _size(text: str, written: str) -> tuple[int, int]:
    matched = re.fullmatch(r"\s*([1-9]\d{0,5})\s*[x*]\s*([1-9]\d{0,5})\s*", written.lower(), re.ASCII)
    if matched is None:
        raise _wrong(text, f"size={written.strip()} is not the pixels of an image, such as size=5472x3648")
    return int(matched[1]), int(matched[2])


def _wrong(text: str, reason: str) -> TableError:
    return TableError(f"camera={text!r}: {reason}. Give {FORMS}.")


def frame_camera(lens: Lens, width: int, height: int, full_width: int | None = None) -> FrameCamera:
    """The camera of a lens for an image size: principal point at the centre, no distortion."""
    if lens.film_mm is not None:
        focal = focal_of_film(lens.film_mm, width, height)
    else:
        focal = lens.focal_at(width, full_width or width)
    return FrameCamera.from_pixels(focal_px=focal, width=width, height=height)


def focal_of_film(film_mm: float, width: int, height: int) -> float:
    """Focal length in pixels of one for 35 mm film, in proportion to the diagonals of image and film."""
    return film_mm * math.hypot(width, height) / FILM_DIAGONAL


def sigma_of_film(width: int, height: int) -> float:
    """Relative standard deviation of a focal length by the rule of 35 mm film."""
    return FILM_CUT if max(width, height) > WIDE * min(width, height) else FILM


def whole_camera(camera: FrameCamera | str | os.PathLike[str]) -> FrameCamera:
    """A camera with its image size, for files that lack it. Raises `TableError` if a lens has none."""
    given = given_camera(camera)
    if isinstance(given, FrameCamera):
        return given
    if isinstance(given, str) or given.size is None:
        raise TableError(
            f"camera={camera!r}: the size of the images is missing; say it too, as in "
            f'camera="focal=8.8mm,pitch=2.41um,size=5472x3648".'
        )
    return frame_camera(given, *given.size)


def resized(camera: FrameCamera, width: int, height: int) -> FrameCamera | None:
    """A camera for resized copies of its images; None if their aspect ratio differs."""
    across, down = width / camera.width, height / camera.height
    if abs(across / down - 1.0) > CLOSE:
        return None
    fu, fv = (camera.focal_px[k] for k in range(2))
    u, v = (camera.principal_px[k] for k in range(2))
    principal = [(u + 0.5) * across - 0.5, (v + 0.5) * down - 0.5]
    return FrameCamera.from_pixels(
        focal_px=[fu * across, fv * down],
        width=width,
        height=height,
        principal_px=principal,
        distortion=camera.distortion,
    )
