"""Images of single bands (MicaSense, Parrot Sequoia): the lens, the attitude, and the camera's turn on its mount.

Held against: Pix4D's "Specifications of xmp.camera tags" (focal length and principal point in mm, distortion R1 R2 R3
T1 T2, RigRelatives) and MicaSense's library (image.py: R = Rx Ry Rz of RigRelatives takes this camera's rays to those
of the reference camera; pixels are mm times FocalPlaneXResolution; DLS angles in rad). The pixel of a point is computed
here in NumPy and SciPy.
"""

from __future__ import annotations

import pathlib
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from PIL.TiffImagePlugin import IFDRational
from scipy.spatial.transform import Rotation
from support.drone_image_files import PLACE_DEG, packet, write_image

from jaxgeo.io import TableError, read_acquisition

WIDTH, HEIGHT, DENSITY = 1280, 960, 266.666667  # pixels, pixels per mm
FOCAL, PRINCIPAL = 5.45, (2.43, 1.82)  # mm
LENS = (-0.1, 0.15, -0.07, 0.0003, -0.0002)
RELATIVES = (0.35, -0.42, 0.17)  # deg
ATTITUDE = (41.0, 3.0, -2.0)  # yaw, pitch, roll, deg
CAMERA = {
    "Camera:PerspectiveFocalLength": str(FOCAL),
    "Camera:PerspectiveFocalLengthUnits": "mm",
    "Camera:PrincipalPoint": "2.43,1.82",
    "Camera:PerspectiveDistortion": list(LENS),
    "Camera:RigRelatives": "0.35, -0.42, 0.17",
    "Camera:BandName": "NIR",
    "Camera:ModelType": "perspective",
}
NAMES = ("Yaw", "Pitch", "Roll")
LIGHT_SENSOR = {f"DLS:{name}": repr(float(np.radians(one))) for name, one in zip(NAMES, ATTITUDE, strict=True)}
OF_PIX4D = {f"Camera:{name}": str(one) for name, one in zip(NAMES, ATTITUDE, strict=True)}
EXIF = {0xA20E: IFDRational(266666667, 1000000), 0xA20F: IFDRational(266666667, 1000000), 0xA210: 4}


def band(path: pathlib.Path, tags: dict[str, Any], make: str = "MicaSense", model: str = "RedEdge-M") -> pathlib.Path:
    return write_image(path, packet(tags), make=make, model=model, exif=EXIF, size=(WIDTH, HEIGHT))


def pixel(ned: np.ndarray) -> np.ndarray:
    R_ned_from_mount = Rotation.from_euler("ZYX", ATTITUDE, degrees=True).as_matrix()
    forward, right, down = R_ned_from_mount.T @ ned
    R_mount_from_band = np.eye(3)
    for axis, angle in zip("xyz", RELATIVES, strict=True):
        R_mount_from_band = R_mount_from_band @ Rotation.from_euler(axis, angle, degrees=True).as_matrix()
    x, y, z = R_mount_from_band.T @ np.array([right, -forward, down])
    x, y, (k1, k2, k3, p1, p2) = x / z, y / z, LENS
    r2 = x**2 + y**2
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)
    v = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y**2)
    return DENSITY * (FOCAL * np.array([u, v]) + PRINCIPAL) - 0.5


def ecef(ned: np.ndarray) -> np.ndarray:
    (lat, lon), height = np.radians(PLACE_DEG[:2]), PLACE_DEG[2]
    axes = np.array([
        [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], [-np.sin(lon), np.cos(lon), 0.0],
        [-np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), -np.sin(lat)],
    ])  # fmt: skip
    at = pyproj.Transformer.from_crs(4979, 4978, always_xy=True).transform(PLACE_DEG[1], PLACE_DEG[0], height)
    return np.array(at) + ned @ axes


@jax.jit
def projected(sensor: Any, shot: Any, p_ecef: Any) -> Any:
    return sensor.project_ecef(shot, p_ecef)[0]


@pytest.mark.parametrize("tags", [LIGHT_SENSOR, OF_PIX4D], ids=["DLS", "Camera"])
def test_a_ground_point_is_seen_where_the_band_has_it(tmp_path: pathlib.Path, tags: dict[str, str]) -> None:
    found = read_acquisition(band(tmp_path / "IMG_0001_4.tif", CAMERA | tags), height_datum="ellipsoid")
    sensor, shot, _ = found.exposure(0)
    point = np.array([25.0, 30.0, 110.0])
    np.testing.assert_allclose(projected(sensor, shot, ecef(point)), pixel(point), atol=1e-4)  # px
    assert found.facts["band"] == "NIR"
    assert any("RigRelatives" in one for one in found.assumed)
    assert any("light sensor" in one for one in found.assumed) == (tags is LIGHT_SENSOR)


def test_bands_of_one_photo_are_one_record_with_a_mount_each(tmp_path: pathlib.Path) -> None:
    band(tmp_path / "IMG_0001_1.tif", CAMERA | LIGHT_SENSOR | {"Camera:RigRelatives": "0,0,0"})
    band(tmp_path / "IMG_0001_2.tif", CAMERA | LIGHT_SENSOR)
    found = read_acquisition(tmp_path, height_datum="ellipsoid")
    sensor: Any = found.sensor
    turn = np.swapaxes(sensor.mount.R_head_from_camera[0], -1, -2) @ sensor.mount.R_head_from_camera[1]
    angle = np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0))
    assert angle == pytest.approx(np.linalg.norm(RELATIVES), rel=1e-2)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"Camera:RigRelatives": "0.1,0.2"}, "IMG_0001_1.tif, Camera:RigRelatives: 2 numbers; expected 3"),
        ({"Camera:ModelType": "fisheye"}, "Camera:ModelType: fisheye lenses are not read"),
        ({"DLS:Pitch": "100"}, r"DLS:Pitch: 100 is outside \[-3.14159, 3.14159\] rad"),
    ],
)
def test_what_is_not_read_is_refused_in_a_line(tmp_path: pathlib.Path, change: dict[str, str], words: str) -> None:
    path = band(tmp_path / "IMG_0001_1.tif", CAMERA | LIGHT_SENSOR | change)
    with pytest.raises(TableError, match=words) as refusal:
        read_acquisition(path, height_datum="ellipsoid")
    assert "\n" not in str(refusal.value)
