"""Models of OpenSfM and COLMAP: cameras as their programs have them, read back."""

from __future__ import annotations

import json
import pathlib

import numpy as np
import pytest

from jaxgeo import FrameCamera
from jaxgeo.io.acquisitions._colmap_files import RawCamera
from jaxgeo.io.acquisitions.colmap import _camera
from jaxgeo.io.errors import UnwritableLens
from jaxgeo.io.opensfm import read_opensfm_cameras
from jaxgeo.io.reconstruction_writer import _colmap_camera, _opensfm_camera
from jaxgeo.sensor.distortion import BrownConrady, Ebner, Fisheye

LENSES = [
    None,
    BrownConrady(k1=-0.02, k2=0.003, p1=1e-4, p2=-2e-4, k3=1e-4),
    Fisheye(k1=0.01, k2=-0.002, k3=1e-4, k4=1e-5),
]


def made(lens) -> FrameCamera:
    return FrameCamera.from_pixels(
        focal_px=(900.0, 910.0), width=1200, height=800, principal_px=(603.3, 397.1), distortion=lens
    )


def assert_same(one: FrameCamera, other: FrameCamera) -> None:
    for uv in ([10.0, 20.0], [603.0, 397.0], [1100.0, 700.0]):
        assert np.allclose(one.ray(np.array(uv))[0], other.ray(np.array(uv))[0], atol=1e-11)


@pytest.mark.costly
@pytest.mark.parametrize("lens", LENSES)
def test_cameras_are_read_back(tmp_path: pathlib.Path, lens) -> None:
    camera = made(lens)
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"one": _opensfm_camera("one", camera)}))
    assert_same(read_opensfm_cameras(path)["one"], camera)
    model, width, height, *parameters = _colmap_camera("one", camera)
    assert_same(_camera("one", RawCamera(model, int(width), int(height), tuple(map(float, parameters)))), camera)


@pytest.mark.parametrize("lens", LENSES)
def test_pycolmap_projects_alike(lens) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="needs pycolmap")
    camera = made(lens)
    model, width, height, *parameters = _colmap_camera("one", camera)
    theirs = pycolmap.Camera(model=model, width=int(width), height=int(height), params=[float(x) for x in parameters])
    point = np.array([0.3, -0.2, 1.0])
    assert np.allclose(theirs.img_from_cam(point) - 0.5, camera.project(point)[0], atol=1e-6)


def test_lenses_that_programs_lack_are_refused() -> None:
    with pytest.raises(UnwritableLens, match="k4, k5, k6"):
        _opensfm_camera("one", made(BrownConrady(k4=0.01)))
    with pytest.raises(UnwritableLens, match="no lens Ebner"):
        _colmap_camera("one", made(Ebner([1e-3] * 12, 0.48)))
