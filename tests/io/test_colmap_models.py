"""COLMAP models, text and binary: cameras, poses and frames; damaged ones and unstated frames are refused.

Held against: the layout of COLMAP's documentation ("Output Format", whose cameras.txt is read as printed there), its
camera models (src/colmap/sensor/models.h) and ENU frame (GPSTransform::EllToENU: about the first position, its height
included), here in NumPy and with SciPy's rotations and PROJ.
"""

from __future__ import annotations

import pathlib
import struct
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo import WGS84
from jaxgeo.earth import Geodetic
from jaxgeo.io import TableError, read_acquisition, read_acquisitions
from jaxgeo.io.acquisitions import UnstatedDatum, read_colmap
from jaxgeo.io.acquisitions.detect import form_of

LAT, LON, TALL = 36.3, -84.2, 310.5
WIDTH, HEIGHT = 400, 300
ENU = f"enu:{LAT},{LON},{TALL}"
NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5,
           "FULL_OPENCV": 6, "SIMPLE_RADIAL_FISHEYE": 8, "RADIAL_FISHEYE": 9}  # fmt: skip
CAMERAS: dict[str, tuple[float, ...]] = {
    "SIMPLE_PINHOLE": (277.0, 203.5, 148.0),
    "PINHOLE": (277.0, 279.5, 203.5, 148.0),
    "SIMPLE_RADIAL": (277.0, 203.5, 148.0, -0.05),
    "RADIAL": (277.0, 203.5, 148.0, -0.05, 0.02),
    "OPENCV": (277.0, 279.5, 203.5, 148.0, -0.05, 0.02, 0.0012, -0.0007),
    "FULL_OPENCV": (277.0, 279.5, 203.5, 148.0, -0.05, 0.02, 0.0012, -0.0007, 0.003, 0.01, -0.004, 0.001),
    "SIMPLE_RADIAL_FISHEYE": (277.0, 203.5, 148.0, -0.05),
    "RADIAL_FISHEYE": (277.0, 203.5, 148.0, -0.05, 0.02),
    "OPENCV_FISHEYE": (277.0, 279.5, 203.5, 148.0, -0.05, 0.02, 0.003, -0.001),
}
# The camera looks down, 25 deg off nadir, the top of its image towards 110 deg; centres are 600 m above the origin.
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])  # right, down, forward in east, north, up
R_ENU = Rotation.from_euler("z", -110.0, degrees=True).as_matrix() @ DOWN @ Rotation.from_euler(
    "x", 25.0, degrees=True).as_matrix()  # fmt: skip
CENTRE_ENU = np.array([40.0, -25.0, 600.0])
GROUND_ENU = CENTRE_ENU + R_ENU @ np.array([130.0, -95.0, 560.0])


def enu_axes() -> tuple[np.ndarray, np.ndarray]:
    """(ECEF of the origin, rotation from east-north-up there to ECEF)."""
    at = np.array(pyproj.Transformer.from_crs(4979, 4978, always_xy=True).transform(LON, LAT, TALL))
    lat, lon = np.radians([LAT, LON])
    east = [-np.sin(lon), np.cos(lon), 0.0]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    return at, np.stack([east, north, np.cross(east, north)], axis=1)


def pixel_of(model: str, parameters: tuple[float, ...], p: np.ndarray) -> np.ndarray:
    """COLMAP's projection, and half a pixel from the corner to the centre of the first pixel."""
    x, y = p[:2] / p[2]
    r2 = x * x + y * y
    one_focal = model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
    fx, fy, cx, cy, *k = (parameters[0], *parameters) if one_focal else parameters
    if model.endswith("_FISHEYE"):
        theta = np.arctan(np.sqrt(r2))
        far = theta * (1.0 + sum(one * theta ** (2 * i + 2) for i, one in enumerate(k))) / np.sqrt(r2)
        return np.array([fx * far * x + cx, fy * far * y + cy]) - 0.5
    k1, k2, p1, p2, k3, k4, k5, k6 = [*k, *[0.0] * (8 - len(k))]
    radial = (1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1.0 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.array([fx * u + cx, fy * v + cy]) - 0.5


def pose_words(R_world_from_camera: np.ndarray, centre: np.ndarray) -> list[float]:
    """QW QX QY QZ TX TY TZ."""
    R = R_world_from_camera.T
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    return [float(one) for one in (w, x, y, z, *(-R @ centre))]


def write_text(folder: pathlib.Path, model: str, pose: list[float], *, points: str = "1.5 2.5 -1 3.0 4.0 7") -> None:
    words = " ".join(map(repr, CAMERAS[model]))
    (folder / "cameras.txt").write_text(
        f"# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"# Number of cameras: 1\n7 {model} {WIDTH} {HEIGHT} {words}\n", encoding="utf-8")  # fmt: skip
    line = f"{' '.join(map(repr, pose))} 7"
    (folder / "images.txt").write_text(
        "# Image list with two lines of data per image:\n"
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#   POINTS2D[] as (X, Y, POINT3D_ID)\n"
        f"3 {line} a/one.jpg\n{points}\n5 {line} two of it.jpg\n\n", encoding="utf-8")  # fmt: skip


def write_binary(folder: pathlib.Path, model: str, pose: list[float]) -> None:
    parameters = CAMERAS[model]
    content = struct.pack("<QiiQQ", 1, 7, NUMBERS[model], WIDTH, HEIGHT) + struct.pack(
        f"<{len(parameters)}d", *parameters
    )
    (folder / "cameras.bin").write_bytes(content)
    content = struct.pack("<Q", 2)
    for number, name, points in ((3, b"a/one.jpg", 2), (5, b"two of it.jpg", 0)):
        content += struct.pack("<I7dI", number, *pose, 7) + name + b"\0" + struct.pack("<Q", points)
        content += struct.pack("<ddQ", 1.5, 2.5, 2**64 - 1) * points
    (folder / "images.bin").write_bytes(content)


@jax.jit
def projected(sensor: Any, shot: Any, p_ecef: Any) -> Any:
    return sensor.project_ecef(shot, p_ecef)[0]


def seen(found: Any, p_ecef: np.ndarray) -> np.ndarray:
    sensor, shot, _ = found.exposure(found.index_of("a/one.jpg"))
    return np.asarray(projected(sensor, shot, p_ecef))


def check_pixel(found: Any, model: str, ground_ecef: np.ndarray) -> None:
    expected = pixel_of(model, CAMERAS[model], R_ENU.T @ (GROUND_ENU - CENTRE_ENU))
    assert 0.0 < expected[0] < WIDTH
    assert 0.0 < expected[1] < HEIGHT
    np.testing.assert_allclose(seen(found, ground_ecef), expected, atol=1e-5)  # pixels


@pytest.mark.parametrize("written", [write_text, write_binary])
def test_a_ground_point_is_seen_where_colmap_projects_it(tmp_path: pathlib.Path, written: Any) -> None:
    """In east-north-up about the first position, as the model_aligner writes it."""
    written(tmp_path, "OPENCV", pose_words(R_ENU, CENTRE_ENU))
    found = read_acquisition(tmp_path, crs=ENU, height_datum="ellipsoid")
    assert found.names.tolist() == ["a/one.jpg", "two of it.jpg"]
    assert found.form == "model of COLMAP"
    assert found.facts["cameras"] == "7 (OPENCV)"
    origin, axes = enu_axes()
    check_pixel(found, "OPENCV", origin + axes @ GROUND_ENU)


@pytest.mark.parametrize("model", CAMERAS)
def test_every_camera_model_projects_as_colmap_does(tmp_path: pathlib.Path, model: str) -> None:
    """In geocentric coordinates."""
    origin, axes = enu_axes()
    write_binary(tmp_path, model, pose_words(axes @ R_ENU, origin + axes @ CENTRE_ENU))
    found = read_colmap(tmp_path / "images.bin", crs="EPSG:4978", height_datum="ellipsoid")
    check_pixel(found, model, origin + axes @ GROUND_ENU)


def test_a_model_in_a_map_is_turned_by_its_grid_convergence(tmp_path: pathlib.Path) -> None:
    """At the camera the grid of UTM is turned and scaled: a ground point near the nadir, found with PROJ."""
    to_map = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:32616", always_xy=True)
    x, y = to_map.transform(LON, LAT)[:2]
    write_text(tmp_path, "RADIAL", pose_words(DOWN, np.array([x, y, TALL + 500.0])))
    found = read_colmap(tmp_path, crs="EPSG:32616", height_datum="ellipsoid")
    lon, lat = to_map.transform(x + 60.0, y + 40.0, direction="INVERSE")[:2]
    point = WGS84.to_ecef(Geodetic.from_degrees(lat=lat, lon=lon, height=TALL))
    scale = pyproj.Proj(32616).get_factors(LON, LAT).meridional_scale
    expected = pixel_of("RADIAL", CAMERAS["RADIAL"], np.array([60.0 / scale, -40.0 / scale, 500.0]))
    np.testing.assert_allclose(seen(found, np.asarray(point)), expected, atol=0.01)  # curvature of the Earth


@pytest.mark.parametrize("lean", [0.0, 1e-15, 1e-13, 1e-10])
def test_a_camera_that_looks_to_the_horizon_keeps_its_attitude(tmp_path: pathlib.Path, lean: float) -> None:
    """Where heading and roll of the body that carries it turn about one axis, and beside it."""
    R_level = DOWN @ Rotation.from_euler("x", np.pi / 2.0 - lean).as_matrix()
    write_text(tmp_path, "PINHOLE", pose_words(R_level, CENTRE_ENU))
    found = read_colmap(tmp_path, crs=ENU, height_datum="ellipsoid")
    origin, axes = enu_axes()
    ground = CENTRE_ENU + R_level @ np.array([130.0, -95.0, 560.0])
    expected = pixel_of("PINHOLE", CAMERAS["PINHOLE"], np.array([130.0, -95.0, 560.0]))
    np.testing.assert_allclose(seen(found, origin + axes @ ground), expected, atol=1e-5)  # pixels


def test_altitudes_above_another_datum_are_raised(tmp_path: pathlib.Path) -> None:
    origin, axes = enu_axes()
    write_text(tmp_path, "PINHOLE", pose_words(axes @ R_ENU, origin + axes @ CENTRE_ENU))
    low, high = (read_colmap(tmp_path, crs="EPSG:4978", height_datum=one) for one in ("ellipsoid", 31.5))
    np.testing.assert_allclose(high.shots.pose.position.height - low.shots.pose.position.height, 31.5, atol=1e-6)
    assert any("Heights are above a surface 31.5 m" in one for one in high.assumed)


def test_cameras_as_the_documentation_prints_them(tmp_path: pathlib.Path) -> None:
    (tmp_path / "cameras.txt").write_text(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        "# Number of cameras: 3\n1 SIMPLE_PINHOLE 3072 2304 2559.81 1536 1152\n"
        "2 PINHOLE 3072 2304 2560.56 2560.56 1536 1152\n3 SIMPLE_RADIAL 3072 2304 2559.69 1536 1152 -0.0218531\n",
        encoding="utf-8",
    )
    (tmp_path / "images.txt").write_text(
        "1 0.851773 0.0165051 0.503764 -0.142941 -0.737434 1.02973 3.74354 1 P1180141.JPG\n"
        "2362.39 248.498 58396 1784.7 268.254 59027 1784.7 268.254 -1\n"
        "2 0.851773 0.0165051 0.503764 -0.142941 -0.737434 1.02973 3.74354 3 P1180142.JPG\n1190.83 663.957 23056\n",
        encoding="utf-8",
    )
    found = read_colmap(tmp_path, crs=ENU, height_datum="ellipsoid")
    sensor: Any = found.sensor
    camera = sensor.camera
    np.testing.assert_allclose(camera.focal_px, [[2559.81, 2559.81], [2559.69, 2559.69]])
    np.testing.assert_allclose(camera.principal_px, [[1535.5, 1151.5]] * 2)
    np.testing.assert_allclose(camera.distortion.k1, [0.0, -0.0218531])
    assert read_colmap(tmp_path, crs=ENU, height_datum="ellipsoid", camera="3").names.tolist() == ["P1180142.JPG"]


@pytest.mark.parametrize("written, ending", [(write_text, ".txt"), (write_binary, ".bin")])
def test_a_model_is_told_by_its_content(tmp_path: pathlib.Path, written: Any, ending: str) -> None:
    written(tmp_path, "RADIAL", pose_words(R_ENU, CENTRE_ENU))
    for place in (tmp_path, tmp_path / f"cameras{ending}", tmp_path / f"images{ending}"):
        assert form_of(place).name == "model of COLMAP"
    several = read_acquisitions([tmp_path], crs=ENU, height_datum="ellipsoid")
    assert len(several) == 2
    assert not several.unread


def edit(folder: pathlib.Path, name: str, old: str, new: str) -> None:
    path = folder / name
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def cut(folder: pathlib.Path, name: str, size: int) -> None:
    path = folder / name
    path.write_bytes(path.read_bytes()[:size])


REFUSED: dict[str, tuple[Any, Any, str]] = {
    "fisheye": (write_text, lambda f: edit(f, "cameras.txt", "RADIAL 400 300 277.0 203.5 148.0 -0.05 0.02",
                                           "FOV 400 300 277 277 200 150 0.5"),
                "camera 7: the camera model FOV is not read"),
    "too few": (write_text, lambda f: edit(f, "cameras.txt", " 0.02\n", "\n"), "RADIAL has 5 parameters; got 4"),
    "unknown model": (write_text, lambda f: edit(f, "cameras.txt", "RADIAL", "CUBIC"), "'CUBIC' is no camera model"),
    "no size": (write_text, lambda f: edit(f, "cameras.txt", "400 300", "0 300"), "0 x 300 pixels are no size"),
    "no focal": (write_text, lambda f: edit(f, "cameras.txt", "277.0", "-277.0"), "focal lengths must be positive"),
    "no camera": (write_text, lambda f: edit(f, "cameras.txt", "\n7 ", "\n8 "), "of camera 7, not in"),
    "no points": (write_text, lambda f: edit(f, "images.txt", "1.5 2.5 -1 3.0 4.0 7\n", ""), "a second pose"),
    "twice": (write_text, lambda f: edit(f, "images.txt", "two of it.jpg", "a/one.jpg"), "is there twice"),
    "short pose": (write_text, lambda f: edit(f, "images.txt", " two of it.jpg", ""), "row 6: expected IMAGE_ID"),
    "alone": (write_text, lambda f: (f / "cameras.txt").unlink(), "cameras.txt beside it, which is missing"),
    "cut in camera": (write_binary, lambda f: cut(f, "cameras.bin", 50), "ends within a camera"),
    "cut in points": (write_binary, lambda f: cut(f, "images.bin", 135), "ends within the points of image"),
    "cut in image": (write_binary, lambda f: cut(f, "images.bin", 170), "ends within an image"),
    "more": (write_binary, lambda f: (f / "images.bin").write_bytes((f / "images.bin").read_bytes() + b"more"),
             "4 bytes follow the last record"),
    "count": (write_binary, lambda f: (f / "images.bin").write_bytes(
        struct.pack("<Q", 10**6) + (f / "images.bin").read_bytes()[8:]), "1000000 records do not fit"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_damaged_files_are_refused_in_a_line(tmp_path: pathlib.Path, case: str) -> None:
    written, damage, words = REFUSED[case]
    written(tmp_path, "RADIAL", pose_words(R_ENU, CENTRE_ENU))
    damage(tmp_path)
    ending = ".txt" if written is write_text else ".bin"
    with pytest.raises(TableError, match=words) as refusal:
        read_acquisition(tmp_path / f"images{ending}", crs=ENU, height_datum="ellipsoid")
    assert "\n" not in str(refusal.value)


def test_heights_that_no_camera_has_are_refused_in_a_map_too(tmp_path: pathlib.Path) -> None:
    write_text(tmp_path, "RADIAL", pose_words(DOWN, np.array([751000.0, 4020000.0, -900000.0])))
    with pytest.raises(TableError, match=r"a camera is -900000 m above the ellipsoid"):
        read_acquisition(tmp_path, crs="EPSG:32616", height_datum=0.0)


def test_the_frame_of_a_comment_is_that_of_the_argument(tmp_path: pathlib.Path) -> None:
    write_text(tmp_path, "RADIAL", pose_words(R_ENU, CENTRE_ENU))
    expected = read_acquisition(tmp_path, crs=ENU, height_datum="ellipsoid")
    images = tmp_path / "images.txt"
    images.write_text(f"# written by hand\n# frame: {ENU}\n{images.read_text(encoding='utf-8')}", encoding="utf-8")
    found = read_acquisition(tmp_path)
    for mine, theirs in zip(jax.tree.leaves(found.shots), jax.tree.leaves(expected.shots), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert any(ENU in one for one in found.assumed)
    other = read_acquisition(tmp_path, crs=ENU.replace("36.", "37."), height_datum="ellipsoid")
    assert not np.allclose(other.shots.pose.position.lat, found.shots.pose.position.lat)
    with pytest.raises(TableError, match="above the ellipsoid; got height_datum='EPSG:5773'"):
        read_acquisition(tmp_path, height_datum="EPSG:5773")


FRAMES: dict[str, tuple[bool, dict[str, Any], type[Exception], str]] = {
    "no frame": (False, {"height_datum": "ellipsoid"}, TableError, 'states no frame.*crs="EPSG:4978"'),
    "looks geocentric": (True, {"height_datum": "ellipsoid"}, TableError, "They look geocentric"),
    "no datum": (False, {"crs": ENU}, UnstatedDatum, "origin is at a height of 310.5 m.*height_datum="),
    "no datum, ECEF": (True, {"crs": "EPSG:4978"}, UnstatedDatum, "cameras are geocentric"),
    "ECEF as local": (True, {"crs": ENU, "height_datum": 0.0}, TableError, "km from the origin.*EPSG:4978"),
    "local as ECEF": (False, {"crs": "EPSG:4978", "height_datum": 0.0}, TableError, "its frame is none of ECEF"),
    "local as map": (False, {"crs": "EPSG:32616", "height_datum": 0.0}, TableError, "looks like a local frame"),
    "degrees": (False, {"crs": "EPSG:4326", "height_datum": 0.0}, TableError, "is no map"),
    "no origin": (False, {"crs": "enu:36.3,-84.2", "height_datum": 0.0}, TableError, "is not enu:LAT,LON,HEIGHT"),
    "unknown": (False, {"crs": "the moon", "height_datum": 0.0}, TableError, "unknown to PROJ"),
    "other datum": (True, {"crs": "EPSG:7789", "height_datum": 0.0}, TableError, "not geocentric of WGS 84"),
    "no such camera": (
        False,
        {"crs": ENU, "height_datum": 0.0, "camera": "9"},
        TableError,
        "no image is of camera='9'",
    ),
}


@pytest.mark.parametrize("case", FRAMES)
def test_a_frame_that_is_unstated_or_does_not_fit_is_refused(tmp_path: pathlib.Path, case: str) -> None:
    in_ecef, how, kind, words = FRAMES[case]
    origin, axes = enu_axes()
    pose = pose_words(axes @ R_ENU, origin + axes @ CENTRE_ENU) if in_ecef else pose_words(R_ENU, CENTRE_ENU)
    write_text(tmp_path, "RADIAL", pose)
    with pytest.raises(kind, match=words) as refusal:
        read_acquisition(tmp_path, **how)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_every_shorter_file_is_refused(tmp_path: pathlib.Path, name: str) -> None:
    write_binary(tmp_path, "OPENCV", pose_words(R_ENU, CENTRE_ENU))
    path = tmp_path / name
    content = path.read_bytes()
    for size in range(len(content)):
        path.write_bytes(content[:size])
        with pytest.raises(TableError):
            read_colmap(tmp_path / "images.bin", crs=ENU, height_datum=0.0)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "cameras.txt", "images.txt"])
def test_a_damaged_byte_is_refused_or_read_as_numbers(tmp_path: pathlib.Path, name: str) -> None:
    """Whatever byte is lost: a refusal in a line, or finite poses; never another error."""
    (write_binary if name.endswith("bin") else write_text)(tmp_path, "OPENCV", pose_words(R_ENU, CENTRE_ENU))
    path = tmp_path / name
    content = path.read_bytes()
    reasons = []
    for at in range(0, len(content), 7):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0xA5]) + content[at + 1 :])
        try:
            found = read_colmap(path, crs=ENU, height_datum=0.0)
        except TableError as error:
            reasons.append(str(error))
        else:
            assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(found.shots))
    assert reasons
    assert not any("\n" in reason for reason in reasons)
