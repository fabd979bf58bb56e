"""MicMac orientations (Ori-*/Orientation-IMAGE.xml) with their calibrations, as exposures."""

from __future__ import annotations

import os
import pathlib
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np
import pyproj

from jaxgeo._checks import check_is, require_x64
from jaxgeo._text_numbers import numbers_in, words_of
from jaxgeo.io._rotations import rotation_near
from jaxgeo.io.acquisitions._world_frames import FRAMES, poses_in_frame
from jaxgeo.io.acquisitions._xml import numbers_of, root_of
from jaxgeo.io.acquisitions.blocks import NO_ERRORS, NO_TIMES, check_one_size, rows_of, sensor_of, shots_of
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.given_camera import AS_GIVEN, AS_READ
from jaxgeo.sensor import BrownConrady, FrameCamera

FORM = "orientation of MicMac"
CONVENTION = "eConvApero_DistM2C"
START, END = "Orientation-", ".xml"
GIVEN = "given"  # name of the caller's camera
CORNER = (
    "PP is taken from the corner of the first pixel, as MicMac's default, half of SzIm, is: half a pixel less here."
)
WAY_OUT = "give the camera, camera=... (a lens or a file), for undistorted images"


def files_of_orientations(path: str | os.PathLike[str]) -> list[pathlib.Path]:
    """The orientation files of a folder, by name."""
    return sorted(one for one in pathlib.Path(path).glob(f"{START}*{END}") if one.is_file())


def read_micmac(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
    camera: str | None = None,
    cameras: FrameCamera | None = None,
) -> Acquisition:
    """Read MicMac orientations: a folder `Ori-...` or one `Orientation-IMAGE.xml`, by image name.

    Layout and conventions as in MicMac's documentation and iTowns' reader of these files: `Centre`; `L1`, `L2`, `L3`
    rows of the rotation of camera axes (right, down, forward) to the world, convention `eConvApero_DistM2C`. The
    calibration is `Interne`, or the file `FileInterne` by its name in the same folder: `F`, `PP`, `SzIm` in pixels,
    without distortion or with `ModRad` of up to three coefficients about the principal point.

    - `crs`, `height_datum`: the frame of the block and the datum of its heights, as in `read_colmap`.
    - `camera`: selects the images of one calibration file by its name; images of one record have one size.
    - `cameras`: one camera in place of the calibrations.

    Raises `TableError` for a missing `crs`, other conventions, angles in place of a matrix, calibrations that are
    missing or of another lens model (named), damaged files; `UnstatedDatum`; `VerticalDatumError`;
    `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    place = pathlib.Path(path)
    files: Sequence[pathlib.Path] = files_of_orientations(place) if place.is_dir() else [place]
    if not files:
        raise TableError(f"{path}: no {START}IMAGE{END} in this folder.")
    if cameras is not None:
        check_is(cameras, FrameCamera, "cameras")
    cones = [_cone(one) for one in files]
    names = np.array([one.name.removeprefix(START).removesuffix(END) for one in files])
    calibrations = [GIVEN if cameras is not None else _calibration(*one) for one in zip(files, cones, strict=True)]
    taken_by = np.array([one if isinstance(one, str) else one.name for one in calibrations])
    rows = rows_of(path, taken_by, camera)
    known = {name: cameras if cameras is not None else _camera(files[k], cones[k], calibrations[k])
             for name, k in {str(taken_by[k]): k for k in rows}.items()}  # fmt: skip
    check_one_size(path, known, taken_by[rows])
    poses = [_pose(files[k], cones[k]) for k in rows]
    centres, R_world_from_camera = (np.array(one) for one in zip(*poses, strict=True))
    if crs is None:
        at = ", ".join(f"{x:.6g}" for x in centres[0])
        raise TableError(f"{path}: orientations of MicMac state no frame (the first camera is at {at}); give {FRAMES}.")
    pose, notes = poses_in_frame(path, crs, height_datum, centres, R_world_from_camera)
    of_camera = (AS_GIVEN,) if cameras is not None else (AS_READ, CORNER)
    return Acquisition(
        path=os.fspath(path),
        form=FORM,
        names=names[rows],
        sensor=sensor_of(known, taken_by[rows]),
        shots=shots_of(pose),
        assumed=(*notes, NO_ERRORS, *of_camera, NO_TIMES),
        facts={"images": f"{len(rows)} of {len(files)}", "cameras": ", ".join(known)},
    )


def _cone(path: pathlib.Path) -> ET.Element:
    """The OrientationConique of a file."""
    root = root_of(path, FORM)
    cone = root if root.tag == "OrientationConique" else root.find("OrientationConique")
    if cone is None:
        raise TableError(f"{path}: there is no <OrientationConique>, so it is no {FORM}.")
    projection = (cone.findtext("TypeProj") or "eProjStenope").strip()
    if projection != "eProjStenope":
        raise TableError(f"{path}: its projection is {projection[:40]!r}; only eProjStenope (frame cameras) is read.")
    return cone


def _pose(path: pathlib.Path, cone: ET.Element) -> tuple[np.ndarray, np.ndarray]:
    """(centre, rotation of right, down, forward to the world)."""
    own, whole = cone.findtext("Externe/KnownConv"), cone.findtext("ConvOri/KnownConv")
    convention = (own or whole or "").strip()
    if convention != CONVENTION:
        raise TableError(f"{path}: its convention is {convention[:40]!r}; only {CONVENTION} is read.")
    rotation = cone.find("Externe/ParamRotation/CodageMatr")
    if rotation is None:
        raise TableError(f"{path}: there is no rotation matrix (CodageMatr); angles are not read.")
    lines = [numbers_of(f"{path}, {name}", rotation.find(name), 3) for name in ("L1", "L2", "L3")]
    centre = numbers_of(f"{path}, Centre", cone.find("Externe/Centre"), 3)
    return centre, rotation_near(f"{path}, CodageMatr", np.array(lines))


def _calibration(path: pathlib.Path, cone: ET.Element) -> pathlib.Path | str:
    """The calibration file of an orientation, or its name if it is within it."""
    if cone.find("Interne") is not None:
        return path.name
    written = (cone.findtext("FileInterne") or "").strip()
    if not written:
        raise TableError(f"{path}: there is neither a calibration (Interne) nor its file (FileInterne); {WAY_OUT}.")
    return path.parent / pathlib.PurePosixPath(written.replace("\\", "/")).name


def _camera(path: pathlib.Path, cone: ET.Element, calibration: pathlib.Path | str) -> FrameCamera:
    found, where = cone.find("Interne"), f"{path}"
    if isinstance(calibration, pathlib.Path):
        where = f"{calibration}"
        if not calibration.is_file():
            raise TableError(f"{path}: its calibration {calibration.name} is not beside it; copy it there, or "
                             f"{WAY_OUT}.")  # fmt: skip
        root = root_of(calibration, "calibration of MicMac")
        found = root if root.tag == "CalibrationInternConique" else root.find("CalibrationInternConique")
    if found is None:
        raise TableError(f"{where}: there is no <CalibrationInternConique>.")
    convention = (found.findtext("KnownConv") or "").strip()
    if convention != CONVENTION:
        raise TableError(f"{where}: its convention is {convention[:40]!r}; only {CONVENTION} is read.")
    principal, size = (numbers_of(f"{where}, {name}", found.find(name), 2) for name in ("PP", "SzIm"))
    focal = float(numbers_of(f"{where}, F", found.find("F"), 1)[0])
    if not 0.0 < focal < 1e7 or np.any(size != np.floor(size)) or np.any((size < 1.0) | (size > 1e7)):
        raise TableError(f"{where}: F {focal:g} or SzIm {size.tolist()} are none of a camera.")
    lenses = found.findall("CalibDistortion")
    if len(lenses) > 1:
        raise TableError(f"{where}: it has {len(lenses)} distortions; one is read: {WAY_OUT}.")
    lens = _lens(where, lenses[0], principal, focal) if lenses else None
    return FrameCamera.from_pixels(
        focal_px=focal,
        width=int(size[0]),
        height=int(size[1]),
        principal_px=(principal[0] - 0.5, principal[1] - 0.5),
        distortion=lens,
    )


def _lens(where: str, distortion: ET.Element, principal: np.ndarray, focal: float) -> BrownConrady | None:
    """Radial polynomial in pixels about the principal point, as coefficients of unit focal length."""
    model = next((one for one in distortion if isinstance(one.tag, str)), None)
    if model is None or model.tag == "ModNoDist":
        return None
    if model.tag != "ModRad":
        kind = (model.findtext("TypeModele") or model.tag).strip()
        raise TableError(f"{where}: the distortion {kind[:40]} is not read; only ModRad is: {WAY_OUT}.")
    centre = numbers_of(f"{where}, CDist", model.find("CDist"), 2)
    written = [numbers_in(words_of(one.text or "")) for one in model.findall("CoeffDist")]
    if any(one is None or len(one) > 1 for one in written):
        raise TableError(f"{where}: CoeffDist is not a number.")
    terms = [float(one[0]) for one in written if one]
    if not any(terms):
        return None
    if np.max(np.abs(centre - principal)) > 1e-3:
        raise TableError(f"{where}: the distortion is about CDist, which is not PP; that is not read: {WAY_OUT}.")
    if any(terms[3:]):
        raise TableError(f"{where}: it has more than three radial coefficients, which are not read: {WAY_OUT}.")
    k1, k2, k3 = (term * focal ** (2 * (k + 1)) for k, term in enumerate([*terms, 0.0, 0.0, 0.0][:3]))
    return BrownConrady(k1=k1, k2=k2, k3=k3)
