"""Camera calibration from a drone image's tags, in pixels of the file, in order of reliability.

A calibration in the image first, then the package's table of cameras, then EXIF.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from jaxgeo.io._csv import Limits
from jaxgeo.io.acquisitions._image_tags import ImageTags
from jaxgeo.io.camera_table import KnownCamera, known_camera
from jaxgeo.io.errors import TableError
from jaxgeo.io.given_camera import CLOSE, FORMS, focal_of_film, sigma_of_film

OFF_CENTRE = 0.1  # of half the image: largest offset of the principal point from the centre
LONGEST_FOCAL = 50.0  # widths of the image: 1800 mm on 35 mm film, more than twice what drones zoom to
UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # mm, of FocalPlaneResolutionUnit
MILLIMETRES: Limits = (1e-3, 1e5, "mm")
PIXELS: Limits = (1.0, 1e7, "pixels")
UNDISTORTED = (
    "The lens is taken to be free of distortion, since nothing is said of it: what it bends at the corners counts as "
    "an error of the focal length."
)
# Relative standard deviations of the focal length: of a calibration of this very camera, of a design value, of lengths
# in mm rounded by EXIF, and of an unknown lens distortion, whose displacement at the corners acts there like a wrong
# focal length.
CALIBRATED, DESIGNED, ROUNDED, BENT = 0.003, 0.01, 0.02, 0.02
# Of the principal point, relative to the width: calibrated, and assumed at the image centre or from the design.
CALIBRATED_POINT, MIDDLE = 0.001, 0.005


@dataclass(frozen=True)
class Calibration:
    """Focal length and principal point in pixels (columns, rows), pixel centres at integers, and their source.

    `coefficients` are the eight of `BrownConrady`, in its order; `focal_sigma` is the relative standard deviation of
    the focal length, `principal_sigma` that of the principal point relative to the width.
    """

    focal: tuple[float, float]
    principal: tuple[float, float]
    how: str
    coefficients: tuple[float, ...] = (0.0,) * 8
    assumed: tuple[str, ...] = ()
    focal_sigma: float = CALIBRATED
    principal_sigma: float = CALIBRATED_POINT

    def scaled(self, across: float, down: float) -> Calibration:
        """The calibration of a resized image; the image edges, not the pixel centres, are kept in place."""
        focal = self.focal[0] * across, self.focal[1] * down
        principal = (self.principal[0] + 0.5) * across - 0.5, (self.principal[1] + 0.5) * down - 0.5
        return replace(self, focal=focal, principal=principal)

    def undistorted(self) -> Calibration:
        """The calibration without known distortion: its effect is added to the focal length error."""
        return replace(self, assumed=(*self.assumed, UNDISTORTED), focal_sigma=math.hypot(self.focal_sigma, BENT))


def calibration_of(tags: ImageTags) -> Calibration:
    """The camera of an image at its full size: the maker's calibration, else the table of cameras, else EXIF.

    Raises `TableError` if none of them is available, and for a cropped image.
    """
    width, height = full_size(tags)
    check_whole(tags, width, height)
    for way in (_dji_dewarp, _skydio, _pix4d, _dji_designed, _table, _exif_metric, _exif_film):
        found = way(tags, width, height)
        if found is not None:
            break
    else:
        raise TableError(
            f"{tags.path}: nothing says what the focal length is in pixels (no calibration, FocalPlaneXResolution "
            f"or FocalLengthIn35mmFilm, and {camera_shown(tags)} of {width} x {height} pixels is not in the table of "
            f"cameras); give {FORMS}."
        )
    _check(tags, found, width, height)
    return in_file(tags, found, width, height)


def check_whole(tags: ImageTags, width: int, height: int) -> None:
    """Raises `TableError` for a file whose aspect ratio differs from the camera's full image."""
    if abs(tags.width / width / (tags.height / height) - 1.0) > CLOSE:
        raise TableError(
            f"{tags.path}: the image has {tags.width} x {tags.height} pixels, its tags speak of {width} x {height}: it "
            f"was cut or turned. Take the file as the drone wrote it, or give {FORMS}."
        )


def in_file(tags: ImageTags, found: Calibration, width: int, height: int) -> Calibration:
    """The calibration of a full-size image, in pixels of a file that may be a smaller copy."""
    across, down = tags.width / width, tags.height / height
    if across == 1.0 and down == 1.0:
        return found
    note = (
        f"Image was resized ({tags.width} x {tags.height} of {width} x {height}): focal length and principal point "
        f"scaled by {across:.6g}."
    )
    return replace(found.scaled(across, down), assumed=(*found.assumed, note))


def camera_shown(tags: ImageTags) -> str:
    return " ".join(tags.camera).strip() or "a camera without a name"


def full_size(tags: ImageTags) -> tuple[int, int]:
    """Columns and rows of the camera's full image, to which its calibration refers."""
    sides = [tags.number(f"EXIF:Pixel{axis}Dimension", (0.0, 1e6, "pixels")) for axis in "XY"]
    if not all(sides):
        return tags.width, tags.height
    return int(sides[0] or 0), int(sides[1] or 0)


def _check(tags: ImageTags, found: Calibration, width: int, height: int) -> None:
    points = [(found.how, found.principal), ("drone-dji:CalibratedOpticalCenter", _dji_centre(tags) or found.principal)]
    for how, point in points:
        if any(
            abs(2.0 * (one + 0.5) / side - 1.0) > OFF_CENTRE for one, side in zip(point, (width, height), strict=True)
        ):
            raise TableError(
                f"{tags.path}: the principal point ({how}) at {point[0]:.1f}, {point[1]:.1f} is far from the middle of "
                f"{width} x {height} pixels: the calibration is of another size of image. Give {FORMS}."
            )
    if not 0.1 * width < min(found.focal) <= max(found.focal) < LONGEST_FOCAL * width:
        raise TableError(
            f"{tags.path}: a focal length of {found.focal[0]:g} pixels ({found.how}) does not fit an image {width} "
            f"pixels wide. Give {FORMS}."
        )


def _middle(width: int, height: int) -> tuple[float, float]:
    return (width - 1) / 2.0, (height - 1) / 2.0


def _dji_dewarp(tags: ImageTags, width: int, height: int) -> Calibration | None:
    """Focal lengths, offsets of the principal point from the centre, and k1 k2 p1 p2 k3, optionally k4 k5 k6."""
    for name, count in (("drone-dji:DewarpData", 9), ("drone-dji:DewarpDataK6", 12)):
        numbers = tags.numbers(name)
        if not numbers or numbers[0] == 0.0:  # the value of an uncalibrated camera
            continue
        if len(numbers) != count:
            raise tags.wrong(name, f"{len(numbers)} numbers; expected {count}: fx, fy, cx, cy and the distortion.")
        middle = _middle(width, height)
        found = Calibration((numbers[0], numbers[1]), (middle[0] + numbers[2], middle[1] + numbers[3]), f"{name}")
        if tags.number("drone-dji:DewarpFlag", (0.0, 1.0, "")) == 1.0:
            note = "The image is said to be freed of distortion (DewarpFlag 1): focal length and principal point stay."
            return replace(found, assumed=(note,))
        return replace(found, coefficients=(*numbers[4:], *[0.0] * (12 - count)))
    return None


def _dji_designed(tags: ImageTags, width: int, height: int) -> Calibration | None:
    """The design focal length in pixels; some cameras write it in mm, and no centre."""
    name = "drone-dji:CalibratedFocalLength"
    focal = None if tags.unknown("calibration") else tags.number(name, PIXELS)
    if focal is None:
        return None
    in_mm = tags.number("EXIF:FocalLength", MILLIMETRES) if not tags.unknown("focal length") else None
    if in_mm is not None and focal <= 0.1 * width and 0.5 < focal / in_mm < 2.0:
        for way in (_table, _exif_metric, _exif_film):
            found = way(tags, width, height)
            if found is not None:
                note = f"{name} {focal:g} is taken to be in mm, since it is close to EXIF:FocalLength {in_mm:g}."
                scale = focal / in_mm
                same = (found.focal[0] * scale, found.focal[1] * scale)
                return replace(found, focal=same, how=f"{name} in mm, {found.how}", assumed=(*found.assumed, note))
    principal = _dji_centre(tags) or _middle(width, height)
    found = Calibration((focal, focal), principal, name, focal_sigma=DESIGNED, principal_sigma=MIDDLE)
    return found.undistorted()


def _table(tags: ImageTags, width: int, height: int) -> Calibration | None:
    known = known_of(tags, width, height)
    return None if known is None else calibration_by_table(known, width, height)


def known_of(tags: ImageTags, width: int, height: int) -> KnownCamera | None:
    """The table entry for an image's make, model, EXIF focal length and size."""
    return known_camera(*tags.camera, width, height, exif_focal(tags))


def exif_focal(tags: ImageTags) -> float | None:
    """EXIF's focal length in mm, None if unknown."""
    return None if tags.unknown("focal length") else tags.number("EXIF:FocalLength", (0.0, 1e5, "mm"))


def calibration_by_table(known: KnownCamera, width: int, height: int) -> Calibration:
    """The calibration of a table entry, for an image of its full size."""
    model, focal = known.model, known.focal_mm / known.pitch_mm
    note = (
        f"The camera is taken from the table of cameras: {model.name}, focal length {known.focal_mm:g} mm, pixels of "
        f"{1e3 * known.pitch_mm:.4g} um; the principal point as the middle of the image."
    )
    middle, how = _middle(width, height), f"table of cameras: {model.name}"
    found = Calibration((focal, focal), middle, how, (0.0,) * 8, (note,), model.focal_sigma, MIDDLE)
    return found.undistorted()


def _dji_centre(tags: ImageTags) -> tuple[float, float] | None:
    if tags.unknown("optical centre"):
        return None
    x, y = (tags.number(f"drone-dji:CalibratedOpticalCenter{axis}", PIXELS) for axis in "XY")
    return None if x is None or y is None else (x - 0.5, y - 0.5)  # DJI's image centre is half the width


def _skydio(tags: ImageTags, width: int, height: int) -> Calibration | None:
    focal, centre = (
        [tags.number(f"drone-skydio:{name}/{axis}", PIXELS) for axis in "XY"]
        for name in ("CalibratedFocalLength", "CalibratedOpticalCenter")
    )
    if focal[0] is None or focal[1] is None:
        return None
    middle = _middle(width, height)
    principal = middle if centre[0] is None or centre[1] is None else (centre[0], centre[1])  # as (width - 1) / 2
    found = Calibration((focal[0], focal[1]), principal, "drone-skydio:CalibratedFocalLength")
    radial = tags.numbers("drone-skydio:DewarpData")
    if not radial:
        return found.undistorted()
    if len(radial) != 3:
        raise tags.wrong("drone-skydio:DewarpData", f"{len(radial)} numbers; expected 3: k1, k2, k3.")
    k1, k2, k3 = radial
    note = (
        "Skydio's DewarpData are taken as the radial k1, k2, k3 of OpenCV's formula; if that is wrong, what it bends "
        "at the corners counts as an error of the focal length."
    )
    bent = (k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0)
    return replace(found, coefficients=bent, assumed=(note,), focal_sigma=math.hypot(found.focal_sigma, BENT))


def _pix4d(tags: ImageTags, width: int, height: int) -> Calibration | None:
    """Lengths in mm, which need EXIF's pixel pitch; the distortion R1, R2, R3, T1, T2 uses the same formula."""
    if tags.text("Camera:ModelType").lower() == "fisheye":
        raise tags.wrong("Camera:ModelType", f"fisheye lenses are not read from tags; give {FORMS}.")
    focal = tags.number("Camera:PerspectiveFocalLength", MILLIMETRES)
    density = None if focal is None else _density(tags)
    if focal is None or density is None or tags.text("Camera:PerspectiveFocalLengthUnits").lower() not in ("", "mm"):
        return None
    point, bent = tags.numbers("Camera:PrincipalPoint"), tags.numbers("Camera:PerspectiveDistortion")
    if len(point) not in (0, 2):
        raise tags.wrong("Camera:PrincipalPoint", f"{len(point)} numbers; expected 2, in mm from the top left corner.")
    if len(bent) not in (0, 5):
        raise tags.wrong("Camera:PerspectiveDistortion", f"{len(bent)} numbers; expected 5: R1, R2, R3, T1, T2.")
    principal = (point[0] * density[0] - 0.5, point[1] * density[1] - 0.5) if point else _middle(width, height)
    found = Calibration((focal * density[0], focal * density[1]), principal, "Camera:PerspectiveFocalLength")
    if not bent:
        return found.undistorted()
    r1, r2, r3, t1, t2 = bent
    return replace(found, coefficients=(r1, r2, t1, t2, r3, 0.0, 0.0, 0.0))


def _density(tags: ImageTags) -> tuple[float, float] | None:
    """Pixels per mm of the sensor, along columns and rows."""
    unit = UNITS.get(int(tags.number("EXIF:FocalPlaneResolutionUnit", (0.0, 100.0, "")) or 2))
    x = tags.number("EXIF:FocalPlaneXResolution", (0.0, 1e9, "pixels"))
    y = tags.number("EXIF:FocalPlaneYResolution", (0.0, 1e9, "pixels")) or x
    return (x / unit, y / unit) if x and y and unit else None


def _exif_metric(tags: ImageTags, width: int, height: int) -> Calibration | None:
    density, focal = _density(tags), exif_focal(tags)
    if density is None or not focal:
        return None
    note = "The principal point is taken as the middle of the image."
    how, pixels = "EXIF:FocalLength and FocalPlaneXResolution", (focal * density[0], focal * density[1])
    found = Calibration(pixels, _middle(width, height), how, (0.0,) * 8, (note,), ROUNDED, MIDDLE)
    return found.undistorted()


def _exif_film(tags: ImageTags, width: int, height: int) -> Calibration | None:
    film = None
    if not tags.unknown("focal length for 35 mm film"):
        film = tags.number("EXIF:FocalLengthIn35mmFilm", (0.0, 1e5, "mm"))
    if not film:
        return None
    focal, sigma = focal_of_film(film, width, height), sigma_of_film(width, height)
    note = (
        f"The focal length is only known as that of a 35 mm film ({film:g} mm): it is taken to be in proportion to the "
        f"diagonals of image and film (sigma {100 * sigma:g} %); the principal point as the middle of the image."
    )
    how = "EXIF:FocalLengthIn35mmFilm"
    found = Calibration((focal, focal), _middle(width, height), how, (0.0,) * 8, (note,), sigma, MIDDLE)
    return found.undistorted()


def interior_sigma(found: list[Calibration], width: int) -> np.ndarray:
    """Standard deviations (n, 3) in pixels of focal length, principal column and row, for n images of `width`."""
    return np.array([[one.focal_sigma * one.focal[0], *[one.principal_sigma * width] * 2] for one in found])


def arrays_of(found: list[Calibration]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(focal lengths (n, 2), principal points (n, 2), coefficients (n, 8))."""
    focal, principal, coefficients = zip(*((one.focal, one.principal, one.coefficients) for one in found), strict=True)
    return np.array(focal), np.array(principal), np.array(coefficients)
