"""COLMAP by pycolmap: features, exhaustive matching and incremental mapping of a few images."""

from __future__ import annotations

import pathlib
import tempfile
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo.sensor import FrameCamera

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


@dataclass(frozen=True)
class Reconstructed:
    """Images by name with their centres (n, 3) and R_frame_from_camera in the frame of the navigation, RMS residual per
    axis in px, numbers of points and of measurements, and processor seconds of matching and of mapping."""

    name: list[str]
    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    residual_px: float
    points: int
    measurements: int
    matching_s: float
    mapping_s: float
    version: str


def reconstructed(folder: pathlib.Path, names: list[str], camera: FrameCamera, centre: np.ndarray) -> Reconstructed:
    """COLMAP's own reconstruction with a known camera, aligned to positions of the navigation (n, 3) by a similarity.

    The camera is its `FULL_OPENCV` model, kept fixed; all else are its defaults. Raises `RuntimeError` if it finds no
    model, `ValueError` for a camera with other coefficients than that model.
    """
    import pycolmap  # pyright: ignore[reportMissingImports]

    pycolmap.logging.minloglevel = 2
    focal, principal = np.asarray(camera.focal_px), np.asarray(camera.principal_px)
    lens = dict(zip(camera.distortion.names, np.asarray(camera.distortion.coefficients()).tolist(), strict=True))
    if any(value != 0.0 for name, value in lens.items() if name not in COEFFICIENTS):
        raise ValueError(f"the camera has distortion that FULL_OPENCV of COLMAP does not have: {lens}.")
    eight = [lens.get(name, 0.0) for name in COEFFICIENTS]
    values = [*focal, *(principal + 0.5), *eight]  # its pixel centres are at halves
    reader = pycolmap.ImageReaderOptions(
        camera_model="FULL_OPENCV", camera_params=",".join(repr(float(x)) for x in values)
    )
    with tempfile.TemporaryDirectory() as place:
        database = pathlib.Path(place) / "database.db"
        began = time.process_time()
        pycolmap.extract_features(
            database, folder, names, pycolmap.CameraMode.SINGLE, reader, device=pycolmap.Device.cpu
        )
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
        matched = time.process_time()
        options = pycolmap.IncrementalPipelineOptions(
            ba_refine_focal_length=False,
            ba_refine_principal_point=False,
            ba_refine_extra_params=False,
            min_model_size=2,
            multiple_models=False,
        )
        found = pycolmap.incremental_mapping(database, folder, pathlib.Path(place), options)
        mapped = time.process_time()
    if not found:
        raise RuntimeError("COLMAP finds no model.")
    model = max(found.values(), key=lambda one: one.num_reg_images())
    images = {model.images[i].name: model.images[i] for i in model.reg_image_ids()}
    seen = [name for name in names if name in images]
    scale, turn, shift = similarity(
        np.array([images[name].projection_center() for name in seen]), centre[[names.index(name) for name in seen]]
    )
    R = np.array([turn @ images[name].cam_from_world().rotation.matrix().T for name in seen])
    place_of = np.array([scale * turn @ images[name].projection_center() + shift for name in seen])
    squares = _squares(model)
    return Reconstructed(
        seen,
        place_of,
        R,
        float(np.sqrt(np.mean(squares) / 2.0)),
        model.num_points3D(),
        model.compute_num_observations(),
        matched - began,
        mapped - matched,
        pycolmap.__version__,
    )


def _squares(model: Any) -> np.ndarray:
    """Squared residuals in px2 of all measurements."""
    found = []
    for i in model.reg_image_ids():
        image = model.images[i]
        for point in image.points2D:
            if point.has_point3D():
                off = image.project_point(model.points3D[point.point3D_id].xyz) - point.xy
                found.append(float(np.sum(np.asarray(off) ** 2)))
    return np.array(found)


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """(scale, rotation, shift) that best map points (n, 3) to others, after Umeyama (1991)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = U @ flip @ Vt
    scale = float(np.sum(S * np.diagonal(flip)) / np.sum(a**2))
    return scale, R, target.mean(axis=0) - scale * R @ source.mean(axis=0)
