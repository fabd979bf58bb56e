"""Adjusted blocks as models of other programs: `reconstruction.json` of OpenSfM, and the text model of COLMAP."""

from __future__ import annotations

import json
import os
import pathlib
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgeo._destination import destination
from jaxgeo.adjust import Adjustment, LocalFrame
from jaxgeo.io.errors import UnwritableLens
from jaxgeo.sensor import FrameCamera
from jaxgeo.sensor.distortion import BrownConrady, Fisheye, NoDistortion

CORNER = 0.5  # px: COLMAP counts from the corner of the first pixel, `FrameCamera` from its centre
GREY = [128, 128, 128]
TERMS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # in the order of FULL_OPENCV
OF_FISHEYE = ("k1", "k2", "k3", "k4")


def write_opensfm(path: str | os.PathLike[str], found: Adjustment) -> None:
    """Write an adjusted block as a `reconstruction.json` of OpenSfM, which `read_opensfm` reads.

    Cameras are `brown`, or `fisheye_opencv`; focal lengths and principal points in units of the longer side of the
    image. Shots are rotation vectors and translations from the world to the camera (right, down, forward), in
    east-north-up about `reference_lla`, whose altitude is ellipsoidal. Points are the tie points, grey.

    The file appears only when complete. Raises `TypeError` for a block off the Earth, `UnwritableLens` for a lens that
    OpenSfM does not have (another formula, or k4 to k6 of `BrownConrady`), `ValueError` for a path that cannot be
    written to.
    """
    frame = frame_on_earth(found)
    lat, lon, height = (float(x) for x in frame.origin.to_degrees())
    turn, translation = _to_camera(found)
    content = {
        "cameras": {name: _opensfm_camera(name, camera) for name, camera in found.cameras.items()},
        "shots": {
            str(name): {
                "camera": str(camera),
                "rotation": Rotation.from_matrix(R).as_rotvec().tolist(),
                "translation": t.tolist(),
                "orientation": 1,
            }
            for name, camera, R, t in zip(found.images.name, found.images.camera, turn, translation, strict=True)
        },
        "points": {
            str(name): {"color": GREY, "coordinates": place.tolist()}
            for name, place in zip(found.points.name, found.points.place, strict=True)
        },
        "reference_lla": {"latitude": lat, "longitude": lon, "altitude": height},
    }
    with destination("reconstruction", pathlib.Path(path)) as stream:
        json.dump([content], stream, indent=1)


def write_colmap(folder: str | os.PathLike[str], found: Adjustment) -> None:
    """Write an adjusted block as COLMAP's text model: cameras.txt, images.txt, points3D.txt.

    Layout: COLMAP documentation, "Output Format". Cameras are PINHOLE, FULL_OPENCV or OPENCV_FISHEYE, numbered from 1
    as the images are; the first pixel's centre is (0.5, 0.5). The world is east-north-up about the origin that a
    comment in images.txt states as `enu:LAT,LON,HEIGHT`, which `read_colmap` takes as `crs`. The folder is created.

    Each file appears only when complete. Raises as `write_opensfm`; k4 to k6 are written.
    """
    target, frame = pathlib.Path(folder), frame_on_earth(found)
    target.mkdir(parents=True, exist_ok=True)
    number = {name: k for k, name in enumerate(found.cameras, 1)}
    lines = [" ".join([f"{number[name]}", *_colmap_camera(name, camera)]) for name, camera in found.cameras.items()]
    _write(target / "cameras.txt", ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", *lines])
    rows = _measurements(found)
    lat, lon, height = (float(x) for x in frame.origin.to_degrees())
    head = [
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "# POINTS2D[] as (X, Y, POINT3D_ID)",
        f"# frame: enu:{lat:.10f},{lon:.10f},{height:.4f}",
    ]
    _write(target / "images.txt", [*head, *_colmap_images(found, number, rows)])
    _write(target / "points3D.txt", ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]", *_colmap_points(found, rows)])


def frame_on_earth(found: Adjustment) -> LocalFrame:
    """The frame of the block. Raises `TypeError` for one that is Cartesian."""
    frame = found.block.frame
    if not isinstance(frame, LocalFrame):
        raise TypeError("the block has no place on the Earth: its frame is Cartesian.")
    return frame


def _to_camera(found: Adjustment) -> tuple[np.ndarray, np.ndarray]:
    """(rotations (n, 3, 3), translations (n, 3) in m) from the frame to the cameras."""
    turn = np.swapaxes(found.images.R_frame_from_camera, 1, 2)
    return turn, -np.einsum("nij,nj->ni", turn, found.images.centre)


def _measurements(found: Adjustment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row of the image, row of the point, position among the measurements of its image), each (m,)."""
    observed = found.block.observations
    of_image = {str(name): k for k, name in enumerate(found.images.name)}
    of_point = {str(name): k for k, name in enumerate(found.points.name)}
    image = np.array([of_image[str(name)] for name in observed.image])
    point = np.array([of_point[str(name)] for name in observed.point])
    count, place = np.zeros(len(of_image), int), np.zeros(len(image), int)
    for k, row in enumerate(image):
        place[k] = count[row]
        count[row] += 1
    return image, point, place


def _colmap_images(found: Adjustment, number: dict[str, int], rows: tuple[np.ndarray, ...]) -> list[str]:
    image, point, _ = rows
    turn, translation = _to_camera(found)
    quaternions = np.roll(Rotation.from_matrix(turn).as_quat(), 1, axis=1)
    uv = found.block.observations.uv + CORNER
    lines = []
    for k, name in enumerate(found.images.name):
        pose = " ".join(f"{x:.12g}" for x in [*quaternions[k], *translation[k]])
        lines.append(f"{k + 1} {pose} {number[str(found.images.camera[k])]} {_one_line(str(name))}")
        own = np.flatnonzero(image == k)
        lines.append(" ".join(f"{uv[i, 0]:.4f} {uv[i, 1]:.4f} {point[i] + 1}" for i in own))
    return lines


def _colmap_points(found: Adjustment, rows: tuple[np.ndarray, ...]) -> list[str]:
    image, point, place = rows
    sizes = np.linalg.norm(found.residuals, axis=1)
    lines = []
    for k, where in enumerate(found.points.place):
        own = np.flatnonzero(point == k)
        track = " ".join(f"{image[i] + 1} {place[i]}" for i in own)
        lines.append(f"{k + 1} {' '.join(f'{x:.6f}' for x in where)} 128 128 128 {np.mean(sizes[own]):.4f} {track}")
    return lines


def interior_of_lens(camera: FrameCamera) -> tuple[np.ndarray, np.ndarray]:
    """(focal lengths (2,), principal point (2,)) in px; pixel (0, 0) is the centre of the first."""
    focal = np.broadcast_to(np.asarray(camera.focal_px, float), (2,))
    return focal, np.broadcast_to(np.asarray(camera.principal_px, float), (2,))


def _opensfm_camera(name: str, camera: FrameCamera) -> dict[str, Any]:
    lens = camera.distortion
    focal, principal = interior_of_lens(camera)
    longer = max(camera.width, camera.height)
    offset = (principal - 0.5 * (np.array([camera.width, camera.height]) - 1.0)) / longer
    common = {
        "width": camera.width,
        "height": camera.height,
        "focal_x": focal[0] / longer,
        "focal_y": focal[1] / longer,
        "c_x": offset[0],
        "c_y": offset[1],
    }
    if isinstance(lens, Fisheye):
        return {"projection_type": "fisheye_opencv", **common, **{key: float(getattr(lens, key)) for key in OF_FISHEYE}}
    terms = _brown(name, lens)
    if any(terms[key] for key in ("k4", "k5", "k6")):
        raise UnwritableLens(f"camera {name}: OpenSfM has no lens with k4, k5, k6; write the model of COLMAP.")
    return {"projection_type": "brown", **common, **{key: terms[key] for key in ("k1", "k2", "k3", "p1", "p2")}}


def _colmap_camera(name: str, camera: FrameCamera) -> list[str]:
    lens = camera.distortion
    focal, principal = interior_of_lens(camera)
    if isinstance(lens, Fisheye):
        model, terms = "OPENCV_FISHEYE", [float(getattr(lens, key)) for key in OF_FISHEYE]
    elif isinstance(lens, NoDistortion):
        model, terms = "PINHOLE", []
    else:
        model, terms = "FULL_OPENCV", list(_brown(name, lens).values())
    values = [*focal, *(principal + CORNER), *terms]
    return [model, f"{camera.width}", f"{camera.height}", *(f"{x:.12g}" for x in values)]


def _brown(name: str, lens: Any) -> dict[str, float]:
    """Coefficients by name, zero without distortion. Raises `UnwritableLens` for another lens."""
    if isinstance(lens, NoDistortion):
        return dict.fromkeys(TERMS, 0.0)
    if not isinstance(lens, BrownConrady):
        raise UnwritableLens(
            f"camera {name}: OpenSfM and COLMAP have no lens {type(lens).__name__}; only BrownConrady and Fisheye are "
            f"written."
        )
    return {key: float(getattr(lens, key)) for key in TERMS}


def _one_line(name: str) -> str:
    if "\n" in name or "\r" in name:
        raise ValueError(f"image {name!r}: a name in COLMAP's model has one line; rename it.")
    return name


def _write(target: pathlib.Path, lines: list[str]) -> None:
    with destination("model", target) as stream:
        stream.write("\n".join([*lines, ""]))
