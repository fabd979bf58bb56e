"""Camera parameters of Pix4D: cameras, poses, offset and map; what is not read is refused in a line.

Held against: Pix4D's articles "What does the Output Params Folder contain" (the layout of calibrated_camera_parameters,
offset.xyz, wkt.prj and pix4d_calibrated_internal_camera_parameters.cam; m = K [R|-Rt] X) and "How are the Internal and
External Camera Parameters defined" (distortion). The pixel of a ground point is computed here in NumPy.
"""

from __future__ import annotations

import pathlib
from typing import Any

import jax
import numpy as np
import pyproj
import pytest

from jaxgeo.io import TableError, UnstatedDatum, read_acquisition, read_acquisitions
from jaxgeo.io.acquisitions.detect import form_of
from jaxgeo.io.given_camera import given_camera
from tests.io.test_colmap_models import CENTRE_ENU, ENU, GROUND_ENU, R_ENU, enu_axes

SIZE, FOCAL, PRINCIPAL = (400, 300), 277.0, (203.5, 148.0)
RADIAL, TANGENTIAL = (-0.05, 0.02, -0.003), (0.0012, -0.0007)
OFFSET = np.array([30.0, -20.0, 500.0])
UTM, CORNER = "EPSG:32616", np.array([751000.0, 4020000.0, 0.0])
PROJECT = "field"
HEADER = """fileName imageWidth imageHeight\x20
camera matrix K [3x3]
radial distortion [3x1]
tangential distortion [2x1]
camera position t [3x1]
camera rotation R [3x3]
camera model m = K [R|-Rt] X

"""


def words(numbers: Any) -> str:
    return " ".join(map(repr, np.asarray(numbers, float).tolist()))


def block(name: str, centre: np.ndarray, R_world_from_camera: np.ndarray, size: tuple[int, int] = SIZE) -> str:
    K = [[FOCAL, 0.0, PRINCIPAL[0]], [0.0, FOCAL, PRINCIPAL[1]], [0.0, 0.0, 1.0]]
    lines = [*K, RADIAL, TANGENTIAL, centre, *R_world_from_camera.T]
    return "\n".join([f"{name} {size[0]} {size[1]}", *map(words, lines)]) + "\n"


def project(folder: pathlib.Path, centre: np.ndarray = CENTRE_ENU) -> pathlib.Path:
    """A project of one image: parameters relative to an offset."""
    folder.mkdir(exist_ok=True)
    text = HEADER + block("an image.JPG", centre - OFFSET, R_ENU)
    (folder / f"{PROJECT}_offset.xyz").write_text(words(OFFSET), encoding="utf-8")
    path = folder / f"{PROJECT}_calibrated_camera_parameters.txt"
    path.write_text(text, encoding="utf-8")
    return path


def pixel() -> np.ndarray:
    """Pix4D's projection of the ground point, and half a pixel from the corner to the centre of the first pixel."""
    x, y, z = R_ENU.T @ (GROUND_ENU - CENTRE_ENU)
    x, y = x / z, y / z
    (r1, r2, r3), (t1, t2), s = RADIAL, TANGENTIAL, (x / 1.0) ** 2 + y**2
    radial = 1.0 + r1 * s + r2 * s**2 + r3 * s**3
    u = radial * x + 2.0 * t1 * x * y + t2 * (s + 2.0 * x**2)
    v = radial * y + 2.0 * t2 * x * y + t1 * (s + 2.0 * y**2)
    return FOCAL * np.array([u, v]) + PRINCIPAL - 0.5


@jax.jit
def projected(sensor: Any, shot: Any, p_ecef: Any) -> Any:
    return sensor.project_ecef(shot, p_ecef)[0]


def test_a_ground_point_is_seen_where_pix4d_projects_it(tmp_path: pathlib.Path) -> None:
    path = project(tmp_path)
    found = read_acquisition(path, crs=ENU, height_datum="ellipsoid")
    sensor, shot, _ = found.exposure(0)
    origin, axes = enu_axes()
    np.testing.assert_allclose(projected(sensor, shot, origin + axes @ GROUND_ENU), pixel(), atol=1e-5)
    assert found.names.tolist() == ["an image.JPG"]
    assert form_of(tmp_path).name == form_of(path).name == found.form
    several = read_acquisitions([tmp_path], crs=ENU, height_datum="ellipsoid")
    assert (len(several), several.unread) == (1, ())
    assert any("field_offset.xyz: 30, -20, 500 m" in one for one in found.assumed)


def test_the_map_is_that_of_the_file_beside_it(tmp_path: pathlib.Path) -> None:
    path = project(tmp_path, CORNER + CENTRE_ENU)
    with pytest.raises(TableError, match=r"field_wkt.prj is not beside it\); give crs="):
        read_acquisition(path, height_datum="ellipsoid")
    (tmp_path / f"{PROJECT}_wkt.prj").write_text(pyproj.CRS(UTM).to_wkt("WKT1_GDAL"), encoding="utf-8")
    with pytest.raises(UnstatedDatum, match="UTM zone 16N"):
        read_acquisition(path)
    found = read_acquisition(path, height_datum="ellipsoid")
    sensor, shot, _ = found.exposure(0)
    x, y, z = CORNER + GROUND_ENU
    ground = pyproj.Transformer.from_crs(UTM, 4978, always_xy=True).transform(x, y, z)
    np.testing.assert_allclose(projected(sensor, shot, np.array(ground)), pixel(), atol=0.2)  # px: scale of the map
    assert any("as field_wkt.prj says" in one for one in found.assumed)


def cam(cameras: int = 1) -> str:
    mm = 0.005
    return "".join(
        f"Pix4D camera calibration file {k}\n\n#Focal Length mm assuming a sensor width of {400 * mm}x{300 * mm}mm\n"
        f"F {FOCAL * mm!r}\n#Principal Point mm\nPx {PRINCIPAL[0] * mm!r}\nPy {PRINCIPAL[1] * mm!r}\n"
        f"#Symmetrical Lens Distortion Coeffs\nK1 {RADIAL[0]}\nK2 {RADIAL[1]}\nK3 {RADIAL[2]}\n"
        f"#Tangential Lens Distortion Coeffs\nT1 {TANGENTIAL[0]}\nT2 {TANGENTIAL[1]}\n"
        for k in range(cameras)
    )


def test_the_camera_file_is_the_camera_of_a_table_of_angles(tmp_path: pathlib.Path) -> None:
    """Both exports of one image see the ground point at one pixel."""
    path = tmp_path / f"{PROJECT}_pix4d_calibrated_internal_camera_parameters.cam"
    path.write_text(cam(), encoding="utf-8")
    with pytest.raises(TableError, match=r"parameters\.cam, which does, is not beside"):
        given_camera(path)
    (tmp_path / f"{PROJECT}_calibrated_internal_camera_parameters.cam").write_text(
        "camera_calibration_file 0\n\n#Image size 400x300 pixel\nFOCAL 1.385\n", encoding="utf-8"
    )
    x, y, z = CORNER + CENTRE_ENU
    R = R_ENU @ np.diag([1.0, -1.0, -1.0])  # right, up, out of the scene
    phi, omega, kappa = np.arcsin(R[0, 2]), np.arctan2(-R[1, 2], R[2, 2]), np.arctan2(-R[0, 1], R[0, 0])
    table = tmp_path / f"{PROJECT}_calibrated_external_camera_parameters.txt"
    table.write_text(
        f"imageName X Y Z Omega Phi Kappa\na.JPG {x} {y} {z} {words(np.degrees([omega, phi, kappa]))}\n",
        encoding="utf-8",
    )
    found = read_acquisition(table, crs=UTM, height_datum="ellipsoid", camera=str(path))
    sensor, shot, _ = found.exposure(0)
    x, y, z = CORNER + GROUND_ENU
    ground = pyproj.Transformer.from_crs(UTM, 4978, always_xy=True).transform(x, y, z)
    np.testing.assert_allclose(projected(sensor, shot, np.array(ground)), pixel(), atol=0.2)  # px: scale of the map
    for text, reason in (
        (cam(2), "it has 2 cameras"),
        (cam().replace("F 1", "G 1"), "F is missing, or no number"),
        (cam().replace("2.0x1.5mm", "2.0x2.0mm"), "is none of 400 x 300 pixels"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(TableError, match=reason):
            given_camera(path)


def test_images_of_several_sizes_are_told_by_their_camera(tmp_path: pathlib.Path) -> None:
    path = project(tmp_path)
    path.write_text(path.read_text() + "\n" + block("b.JPG", CENTRE_ENU, R_ENU, (640, 480)), encoding="utf-8")
    with pytest.raises(TableError, match="'camera 1' 400 x 300, 'camera 2' 640 x 480"):
        read_acquisition(path, crs=ENU, height_datum=0.0)
    assert read_acquisition(path, crs=ENU, height_datum=0.0, camera="camera 2").names.tolist() == ["b.JPG"]


REFUSED: dict[str, tuple[str, str, str]] = {
    "fisheye": ("camera matrix K [3x3]\nradial distortion [3x1]", "camera matrix K [3x3]\nfisheye distortion [4x1]",
                "'fisheye distortion .* only perspective cameras are read"),
    "cut": (words(R_ENU.T[2]) + "\n", "", "an image.JPG: the file ends within it"),
    "skew": ("277.0 0.0 203.5", "277.0 0.5 203.5", "must be fx 0 cx, 0 fy cy, 0 0 1; got 277 0.5 203.5, "),
    "rotation": (words(R_ENU.T[2]), "0.1 0.2 -0.9", "an image.JPG: it is no rotation"),
    "number": ("203.5", "203,5", "row 10: expected 3 numbers; got '277.0 0.0 203,5'"),
    "size": ("JPG 400 300", "JPG 400", "row 9: expected an image's name, width and height"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_read_is_refused_in_a_line(tmp_path: pathlib.Path, case: str) -> None:
    old, new, reason = REFUSED[case]
    path = project(tmp_path)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(TableError, match=reason) as refusal:
        read_acquisition(path, crs=ENU, height_datum=0.0)
    assert "\n" not in str(refusal.value)


def test_a_missing_offset_is_asked_for(tmp_path: pathlib.Path) -> None:
    path = project(tmp_path)
    (tmp_path / f"{PROJECT}_offset.xyz").unlink()
    with pytest.raises(TableError, match=r"relative to field_offset.xyz, which is not beside it"):
        read_acquisition(path, crs=ENU, height_datum=0.0)
