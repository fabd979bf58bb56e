"""COLMAP models (text and binary) as exposures: cameras, images and the frame that the caller names."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pyproj

from jaxgeo._checks import require_x64
from jaxgeo.io.acquisitions._colmap_files import (
    ENDINGS,
    RawCamera,
    RawModel,
    files_of_model,
    is_colmap,
    read_model,
    stated_frame,
)
from jaxgeo.io.acquisitions._world_frames import FRAMES, RADII, poses_in_frame
from jaxgeo.io.acquisitions.blocks import NO_ERRORS, NO_TIMES, check_one_size, rows_of, sensor_of, shots_of
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.given_camera import AS_READ
from jaxgeo.sensor import BrownConrady, Fisheye, FrameCamera

__all__ = ["FORM", "files_of_model", "is_colmap", "read_colmap"]

FORM = "model of COLMAP"
# Distortion parameters of each model that is read, after the focal lengths and the principal point.
LENSES = {
    "SIMPLE_PINHOLE": (1, ()), "PINHOLE": (2, ()), "SIMPLE_RADIAL": (1, ("k1",)), "RADIAL": (1, ("k1", "k2")),
    "OPENCV": (2, ("k1", "k2", "p1", "p2")),
    "FULL_OPENCV": (2, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "SIMPLE_RADIAL_FISHEYE": (1, ("k1",)), "RADIAL_FISHEYE": (1, ("k1", "k2")),
    "OPENCV_FISHEYE": (2, ("k1", "k2", "k3", "k4")),
}  # fmt: skip
CORNER = 0.5  # pixels: COLMAP counts from the corner of the first pixel, `FrameCamera` from its centre


def read_colmap(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the images of a COLMAP model, each with its camera, by image name.

    `path` is the folder with cameras and images (.bin, else .txt), or one of these files. Layout as in COLMAP's
    documentation, "Output Format": quaternion (w, x, y, z) and translation from the world to the camera (right,
    down, forward); the centre of the first pixel is (0.5, 0.5). Camera models SIMPLE_PINHOLE, PINHOLE,
    SIMPLE_RADIAL, RADIAL, OPENCV and FULL_OPENCV are read, with the distortion as `BrownConrady`, and
    SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE and OPENCV_FISHEYE as `Fisheye`. A model states neither its frame nor its
    scale: `colmap model_aligner` gives both. `write_colmap` states the frame, with ellipsoidal
    heights, in a comment, which is read.

    - `crs`: "EPSG:4978" for a model aligned with `--alignment_type ecef`; "enu:LAT,LON,HEIGHT" for `enu`, whose
      origin is the first of the positions that COLMAP aligned to; a map in metres for positions in that map
      (`--ref_is_gps 0`), whose grid convergence is applied at each image.
    - `height_datum`: datum of the altitudes that the model was aligned with, which COLMAP takes for ellipsoidal.
    - `camera`: selects the images of one camera by its number; images of one record have one size.

    Raises `TableError` for a missing `crs`, without such a comment, or one that does not fit the positions, another
    camera model (named), a file that is damaged, cut off or misses its partner, cameras of several sizes;
    `UnstatedDatum` without `height_datum`; `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats
    off.
    """
    require_x64()
    model = read_model(path)
    taken_by = np.array([str(number) for number in model.camera])
    rows = rows_of(path, taken_by, camera)
    used = {str(number): model.cameras[number] for number in dict.fromkeys(model.camera[rows].tolist())}
    cameras = {name: _camera(f"{path}, camera {name}", raw) for name, raw in used.items()}
    check_one_size(path, cameras, taken_by[rows])
    R_world_from_camera = np.swapaxes(_rotations(model.quaternions[rows]), -1, -2)
    centres = -np.einsum("nij,nj->ni", R_world_from_camera, model.translations[rows])
    frame, of_comment = crs, []
    if crs is None and (frame := stated_frame(model)) is not None:
        height_datum = _of_ellipsoid(path, height_datum)
        of_comment = [f"The frame is that of the comment in images.txt, {frame}, above the ellipsoid."]
    if frame is None:
        _refuse_no_frame(path, centres)
    pose, notes = poses_in_frame(path, frame, height_datum, centres, R_world_from_camera)
    return Acquisition(
        path=os.fspath(path),
        form=FORM,
        names=model.names[rows],
        sensor=sensor_of(cameras, taken_by[rows]),
        shots=shots_of(pose),
        assumed=(*of_comment, *notes, NO_ERRORS, AS_READ, NO_TIMES, *_other_files(model)),
        facts={"images": f"{len(rows)} of {len(model.names)}", "cameras": _models(used)},
    )


def _rotations(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4), w first (Hamilton)."""
    w, x, y, z = quaternions.T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _camera(where: str, raw: RawCamera) -> FrameCamera:
    if raw.model not in LENSES:
        raise TableError(f"{where}: the camera model {raw.model} is not read; only {', '.join(LENSES)} are. Undistort "
                         f"the images (colmap image_undistorter), which gives PINHOLE.")  # fmt: skip
    count, names = LENSES[raw.model]
    focal, principal, others = raw.parameters[:count], raw.parameters[count : count + 2], raw.parameters[count + 2 :]
    if not 0.0 < min(focal) <= max(focal) < 1e7:
        raise TableError(f"{where}: focal lengths must be positive, in pixels; got {list(focal)}.")
    return FrameCamera.from_pixels(
        focal_px=(focal[0], focal[-1]),
        width=raw.width,
        height=raw.height,
        principal_px=(principal[0] - CORNER, principal[1] - CORNER),
        distortion=_lens(raw.model, dict(zip(names, others, strict=True))),
    )


def _lens(model: str, terms: dict[str, float]) -> BrownConrady | Fisheye | None:
    if model.endswith("_FISHEYE"):
        return Fisheye(**terms)
    return BrownConrady(**terms) if any(terms.values()) else None


def _refuse_no_frame(path: Any, centres: np.ndarray) -> None:
    radius = float(np.linalg.norm(centres[0]))
    guess = " They look geocentric." if RADII[0] < radius < 7e6 else ""
    raise TableError(
        f"{path}: a model of COLMAP states no frame (the first camera is at {', '.join(f'{x:.6g}' for x in centres[0])}"
        f").{guess} Align it to positions (colmap model_aligner) and give its frame: {FRAMES}."
    )


def _of_ellipsoid(path: Any, height_datum: str | float | None) -> str:
    """Datum of heights of a frame that `write_colmap` states. Raises `TableError` for another one given."""
    if height_datum not in (None, "ellipsoid", 0):
        raise TableError(
            f"{path}: the frame stated in images.txt is above the ellipsoid; got height_datum={height_datum!r}. Leave "
            f"it out, or state another frame with crs=."
        )
    return "ellipsoid"


def _models(used: dict[str, RawCamera]) -> str:
    return ", ".join(f"{name} ({raw.model})" for name, raw in used.items())


def _other_files(model: RawModel) -> list[str]:
    """A note on the text files beside the binary ones."""
    if model.ending == ENDINGS[0] and (model.folder / f"images{ENDINGS[1]}").is_file():
        return ["The folder has the model as text too; the binary files are read, as COLMAP does."]
    return []
