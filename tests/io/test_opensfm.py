"""Reconstructions of OpenSfM: cameras by its formula, worlds level at a reference or in a grid, refusals by key.

Held against: the reconstruction of the block Miaoli as OpenDroneMap wrote it, OpenSfM's published camera models written
out in NumPy, and PROJ.
"""

from __future__ import annotations

import copy
import json
import pathlib
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo import WGS84, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.earth import Geodetic, R_ecef_from_enu
from jaxgeo.io import (
    TableError,
    VerticalDatumError,
    read_opensfm,
    read_opensfm_cameras,
    read_orientations,
    undulation,
    write_orientations,
)
from jaxgeo.io.acquisitions import acquisition_of_opensfm, read_acquisition
from jaxgeo.io.given_camera import given_camera
from jaxgeo.io.orientations import Orientations
from jaxgeo.sensor import Fisheye

BROWN = {
    "projection_type": "brown", "width": 1368, "height": 912, "focal_x": 0.666, "focal_y": 0.667, "c_x": -0.0015,
    "c_y": 0.00475, "k1": -0.264, "k2": 0.102, "p1": 0.0007, "p2": 0.0003, "k3": -0.026,
}  # fmt: skip
PERSPECTIVE = {"projection_type": "perspective", "width": 600, "height": 800, "focal": 0.9, "k1": -0.05, "k2": 0.01}
RADIAL = {**BROWN, "projection_type": "radial"}
FISHEYE = {"projection_type": "fisheye", "width": 600, "height": 800, "focal": 0.4, "k1": -0.03, "k2": 0.01}
OPENCV_FISHEYE = {
    "projection_type": "fisheye_opencv", "width": 1368, "height": 912, "focal_x": 0.37, "focal_y": 0.371,
    "c_x": -0.0015, "c_y": 0.00475, "k1": -0.03, "k2": 0.01, "k3": -0.002, "k4": 0.0004,
}  # fmt: skip
LAT, LON, ALTITUDE = 24.6801, 120.9512, 12.5
POINTS = {"1": [3.0, -4.0, 1.5], "7": [-20.0, 12.0, -2.0], "8": [15.0, 11.0, 0.0]}
# Rotation vectors from the world (east, north, up) to a camera that looks down, more or less.
SHOTS = {"a.jpg": ([2.9, 0.4, -0.2], [0.0, 5.0, 100.0]), "b.jpg": ([1.9, -1.98, 0.55], [-71.0, 19.0, 110.0])}


def content(**change: Any) -> list[dict[str, Any]]:
    one = {
        "cameras": {"v2 brown": BROWN, "old": PERSPECTIVE},
        "shots": {
            name: {"rotation": rotation, "translation": translation, "camera": camera, "scale": 1.0}
            for (name, (rotation, translation)), camera in zip(SHOTS.items(), ("v2 brown", "old"), strict=True)
        },
        "points": {name: {"coordinates": xyz, "color": [255.0, 0.0, 0.0]} for name, xyz in POINTS.items()},
        "reference_lla": {"latitude": LAT, "longitude": LON, "altitude": ALTITUDE},
        "biases": {},
    }
    return [{key: value for key, value in (copy.deepcopy(one) | change).items() if value is not None}]


@pytest.fixture
def file(tmp_path: pathlib.Path):
    """Writes a file, of JSON or of a text, and returns its path."""

    def write(content: Any) -> pathlib.Path:
        path = tmp_path / "reconstruction.json"
        path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
        return path

    return write


def pixel(camera: dict[str, Any], p: np.ndarray) -> np.ndarray:
    """OpenSfM's projection of a point in the camera's frame, and its way from normalised coordinates to pixels."""
    x, y = p[:2] / p[2]
    r2 = x * x + y * y
    k1, k2, k3, p1, p2 = (camera.get(key, 0.0) for key in ("k1", "k2", "k3", "p1", "p2"))
    if camera["projection_type"] != "brown":
        k3 = p1 = p2 = 0.0
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if camera["projection_type"].startswith("fisheye"):  # of the angle: FisheyeProjection, then Disto24 or Disto2468
        theta2, k4 = np.arctan2(np.hypot(x, y), 1.0) ** 2, camera.get("k4", 0.0)
        radial = 1.0 + theta2 * (k1 + theta2 * (k2 + theta2 * (camera.get("k3", 0.0) + theta2 * k4)))
        radial = radial * np.sqrt(theta2 / r2) if r2 else 1.0
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)
    focal = [camera.get(key, camera.get("focal")) for key in ("focal_x", "focal_y")]
    normalised = np.array(focal) * [xd, yd] + [camera.get("c_x", 0.0), camera.get("c_y", 0.0)]
    return normalised * max(camera["width"], camera["height"]) - 0.5 + np.array([camera["width"], camera["height"]]) / 2


@pytest.mark.parametrize(
    "camera", [BROWN, PERSPECTIVE, RADIAL, FISHEYE, OPENCV_FISHEYE], ids=lambda camera: camera["projection_type"]
)
def test_cameras_project_as_opensfm_does(file, camera: dict[str, Any]) -> None:
    cameras = read_opensfm_cameras(file({"one": camera}))
    assert list(cameras) == ["one"]
    for p in ([0.0, 0.0, 2.0], [0.3, -0.2, 1.5], [-0.5, 0.25, 1.0]):
        uv, _ = cameras["one"].project(np.array(p))
        np.testing.assert_allclose(uv, pixel(camera, np.array(p)), atol=1e-9)  # px


def test_cameras_of_a_reconstruction_are_those_of_its_file_of_cameras(file) -> None:
    (whole,) = content()
    alone = read_opensfm_cameras(file(whole["cameras"]))
    for form in (whole, [whole], [whole, whole]):
        cameras = read_opensfm_cameras(file(form))
        assert list(cameras) == list(alone)
        for name, camera in cameras.items():
            np.testing.assert_array_equal(camera.focal_px, alone[name].focal_px)
    name = next(iter(alone))
    (other,) = content()
    other["cameras"] = {name: PERSPECTIVE | {"focal": 0.123}}
    with pytest.raises(TableError, match=f"its reconstructions differ in camera '{name}'"):
        read_opensfm_cameras(file([whole, other]))


@pytest.mark.parametrize("count", [1, 2])
def test_a_file_of_cameras_gives_a_table_its_cameras(file, tmp_path: pathlib.Path, count: int) -> None:
    """By the names in the table; a file with one camera also where one is meant."""
    cameras = dict(zip(["one", "two"][:count], [BROWN, RADIAL], strict=False))
    path, table = file(cameras), tmp_path / "orientations.csv"
    rows = [f"{name}.jpg,47,11,900,10,20,0,{name}" for name in cameras]
    table.write_text("\n".join(["image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,camera", *rows]) + "\n")
    found = read_acquisition(table, height_datum="ellipsoid", camera=f"{path}")
    assert found.sensor is not None
    of_file = read_opensfm_cameras(path)
    for row, name in enumerate(cameras):
        sensor, _, _ = found.exposure(row)
        np.testing.assert_array_equal(sensor.camera.focal_px, of_file[name].focal_px)
    if count == 1:
        assert isinstance(given_camera(f"{path}"), FrameCamera)
        return
    with pytest.raises(TableError, match="it has 2 cameras, one, two; here one is meant"):
        given_camera(f"{path}")


def test_a_world_level_at_the_reference(file) -> None:
    found = read_opensfm(file(content()), height_datum="ellipsoid")
    assert found.names.tolist() == ["a.jpg", "b.jpg"]
    assert found.camera.tolist() == ["v2 brown", "old"]
    assert list(found.cameras) == ["v2 brown", "old"]
    assert found.point_names.tolist() == ["1", "7", "8"]
    np.testing.assert_array_equal(found.points, list(POINTS.values()))
    for k, (rotation, translation) in enumerate(SHOTS.values()):
        R = Rotation.from_rotvec(rotation).as_matrix()
        np.testing.assert_allclose(found.R_enu_from_camera[k], R.T, atol=1e-14)
        np.testing.assert_allclose(found.centres[k], -R.T @ translation, atol=1e-12)
    assert found.reference is not None
    assert float(found.reference.height) == ALTITUDE


def test_points_are_seen_on_the_earth_where_they_are_in_the_file(file) -> None:
    found = read_opensfm(file(content()), height_datum="ellipsoid")
    poses, points = found.poses(), found.positions()
    for k, (name, (rotation, translation)) in enumerate(SHOTS.items()):
        sensor = Sensor(found.cameras[found.camera[k]], Gimbal.fixed(), Mount.nadir())
        project = jax.jit(lambda pose, p, sensor=sensor: sensor.project_ecef(Shot(pose), WGS84.to_ecef(p))[0])
        for j, xyz in enumerate(POINTS.values()):
            p_camera = Rotation.from_rotvec(rotation).apply(xyz) + translation
            uv = project(*(jax.tree.map(lambda x, i=i: x[i], one) for one, i in ((poses, k), (points, j))))
            expected = pixel(BROWN if name == "a.jpg" else PERSPECTIVE, p_camera)
            np.testing.assert_allclose(uv, expected, atol=1e-5)  # px; of rounding in ECEF


def test_heights_are_made_ellipsoidal(file) -> None:
    found = read_opensfm(file(content()), height_datum="EPSG:5773")
    assert found.reference is not None
    assert float(found.reference.height) == pytest.approx(ALTITUDE + float(undulation(LAT, LON)), abs=1e-6)


def test_without_a_reference_the_frame_is_its_own(file) -> None:
    found = read_opensfm(file(content(reference_lla=None, points=None)))
    assert found.reference is None
    assert found.points.shape == (0, 3)
    assert len(found) == 2
    for where in (found.poses, found.positions):
        with pytest.raises(ValueError, match="no reference_lla: its frame has no place on the Earth"):
            where()


def in_grid(crs: str) -> tuple[list[dict[str, Any]], np.ndarray]:
    """The same block as OpenDroneMap writes it: shots and points in a grid about a reference at whole metres.

    Also the positions of shots and points in ECEF.
    """
    to_map = pyproj.Transformer.from_crs(4326, crs, always_xy=True)
    x0, y0 = (round(u) for u in to_map.transform(LON, LAT))
    lon0, lat0 = to_map.transform(x0, y0, direction="INVERSE")
    local = [-Rotation.from_rotvec(r).as_matrix().T @ t for r, t in SHOTS.values()] + list(POINTS.values())
    reference = Geodetic.from_degrees(lat=lat0, lon=lon0, height=0.0)
    ecef = np.asarray(WGS84.to_ecef(reference)) + np.array(local) @ np.asarray(R_ecef_from_enu(reference)).T
    lon, lat, height = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(*ecef.T)
    xyz = np.stack([*np.subtract(to_map.transform(lon, lat), [[x0], [y0]]), height], axis=-1)
    block = content(reference_lla={"latitude": lat0, "longitude": lon0, "altitude": 0.0})
    convergence = np.radians(pyproj.Proj(crs).get_factors(lon, lat).meridian_convergence)
    for k, shot in enumerate(block[0]["shots"].values()):
        R_camera_from_map = Rotation.from_rotvec(shot["rotation"]) * Rotation.from_euler("z", -convergence[k])
        shot["rotation"] = R_camera_from_map.as_rotvec().tolist()
        shot["translation"] = (-R_camera_from_map.apply(xyz[k])).tolist()
    for point, coordinates in zip(block[0]["points"].values(), xyz[2:], strict=True):
        point["coordinates"] = coordinates.tolist()
    return block, ecef


def test_a_world_in_a_grid(file) -> None:
    block, ecef = in_grid("EPSG:32651")
    path = file(block)
    with pytest.raises(TableError, match=r"whole metres of EPSG:32651.* crs='EPSG:32651'.* crs='topocentric'"):
        read_opensfm(path, height_datum="ellipsoid")
    found = read_opensfm(path, height_datum="ellipsoid", crs="EPSG:32651")
    places = [jax.jit(jax.vmap(WGS84.to_ecef))(one) for one in (found.poses().position, found.positions())]
    np.testing.assert_allclose(np.concatenate(places), ecef, atol=1e-5, rtol=0)  # m
    for k, (rotation, _) in enumerate(SHOTS.values()):
        R = Rotation.from_rotvec(rotation).as_matrix().T
        np.testing.assert_allclose(found.R_enu_from_camera[k], R, atol=1e-4)  # the ground is bent: 1e-5 over 100 m
    level = read_opensfm(path, height_datum="ellipsoid", crs="topocentric")
    assert np.abs(level.centres - found.centres).max() > 0.5  # m: what to mistake the one for the other costs


def test_poses_in_a_grid_are_those_of_a_table_of_angles(file, tmp_path: pathlib.Path) -> None:
    """R_map_from_camera = Rx(omega) Ry(phi) Rz(kappa) of the camera's axes, as `odm_xyz_opk.csv` has them."""
    block, _ = in_grid("EPSG:32651")
    found = read_opensfm(file(block), height_datum="EPSG:5773", crs="EPSG:32651")
    path = tmp_path / "block.csv"
    write_orientations(path, Orientations(found.names, found.poses()), crs="EPSG:32651", height_datum="EPSG:5773")
    reference = block[0]["reference_lla"]
    origin = pyproj.Transformer.from_crs(4326, 32651, always_xy=True).transform(
        reference["longitude"], reference["latitude"]
    )
    for shot, row in zip(block[0]["shots"].values(), path.read_text().splitlines()[1:], strict=True):
        _, *cells = row.split(",")
        R_camera_from_map = Rotation.from_rotvec(shot["rotation"])
        xyz = -R_camera_from_map.inv().apply(shot["translation"]) + [*origin, 0.0]
        np.testing.assert_allclose([float(cell) for cell in cells[:3]], xyz, atol=1e-4, rtol=0)  # m
        angles = Rotation.from_euler("XYZ", [float(cell) for cell in cells[3:6]], degrees=True)
        np.testing.assert_allclose(
            angles.as_matrix(), R_camera_from_map.inv().as_matrix() @ np.diag([1.0, -1.0, -1.0]), atol=1e-8
        )


def test_one_of_several(file) -> None:
    path = file([*content(), *content(shots={"c": next(iter(content()[0]["shots"].values()))})])
    with pytest.raises(TableError, match=r"2 reconstructions, of 2, 1 shots; choose one with part="):
        read_opensfm(path, height_datum="ellipsoid")
    assert read_opensfm(path, height_datum="ellipsoid", part=1).names.tolist() == ["c"]
    with pytest.raises(TableError, match=r"part=2, but there are 2 reconstructions"):
        read_opensfm(path, height_datum="ellipsoid", part=2)


def with_shot(**change: Any) -> list[dict[str, Any]]:
    block = content()
    block[0]["shots"]["a.jpg"].update(change)
    return block


def with_camera(**change: Any) -> list[dict[str, Any]]:
    return content(cameras={"v2 brown": {**BROWN, **change}, "old": PERSPECTIVE})


def no_focal() -> list[dict[str, Any]]:
    block = content()
    del block[0]["cameras"]["old"]["focal"]
    return block


REFUSED = {
    "no json": ("cameras:\n", "not a JSON file, or cut off"),
    "cut": (json.dumps(content())[:500], "not a JSON file, or cut off"),
    "empty list": ([], r"expected a list of reconstructions; got \[\]"),
    "no shots": (content(shots=None), "shots is missing; found cameras, points"),
    "none": (content(shots={}), "shots: there are none"),
    "a list of cameras": (content(cameras=[BROWN]), r"cameras: expected a table by name; got \[\{'proj"),
    "other": (with_camera(projection_type="cubic"), "v2 brown: projection_type 'cubic' is not read; only perspective"),
    "no focal": (no_focal(), "cameras, old: focal is missing; found projection_type, width"),
    "focal": (with_camera(focal_x=0.0), "v2 brown: focal lengths must be positive"),
    "width": (with_camera(width=10.5), "v2 brown: width must be a whole number of pixels above zero; got 10.5"),
    "nan": (with_camera(k1=float("nan")), "v2 brown: k1 must be a finite number; got nan"),
    "camera": (with_shot(camera="other"), "shots, a.jpg: camera 'other' is not among the file's cameras"),
    "rotation": (with_shot(rotation=[1.0, 2.0]), r"shots, a.jpg: rotation must be three finite numbers; got \[1.0"),
    "translation": (with_shot(translation=["1", 2, 3]), "a.jpg: translation must be three finite numbers"),
    "point": (content(points={"5": {"color": [1]}}), "points, 5: coordinates is missing; found color"),
    "points": (content(points=[1]), "points: expected points by name"),
    "reference": (content(reference_lla={"latitude": 1.0}), "reference_lla: longitude is missing; found latitude"),
    "nowhere": (content(reference_lla={"latitude": 0, "longitude": 0.0, "altitude": 0}), "longitude are zero, which"),
    "latitude": (content(reference_lla={"latitude": 91.0, "longitude": 0, "altitude": 0}), "latitude 91, longitude 0"),
    "twice": ('[{"cameras": {}, "cameras": {}}]', "'cameras' stands twice in one table"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_files(file, case: str) -> None:
    wrong, words = REFUSED[case]
    with pytest.raises(TableError, match=f"reconstruction.json.*{words}"):
        read_opensfm(file(wrong), height_datum="ellipsoid")


# The projection types of OpenSfM's `geometry/src/camera_instances.cc` and `io.py` that are not those of a plane.
NOT_PLANE = ("fisheye62", "fisheye624", "dual", "spherical", "equirectangular")


@pytest.mark.parametrize("kind", NOT_PLANE)
def test_cameras_without_an_image_plane_are_named_with_a_way_out(file, kind: str) -> None:
    lens = {"projection_type": kind, "width": 1368, "height": 912}
    path = file(content(cameras={"v2 brown": BROWN, "old": lens}))
    with pytest.raises(TableError, match=f"cameras, old: projection_type '{kind}' is not read: undistort") as refusal:
        read_opensfm(path, height_datum="ellipsoid")
    assert "\n" not in str(refusal.value)
    unused = file(content(cameras={"v2 brown": BROWN, "old": PERSPECTIVE, "not used": lens}))
    assert list(read_opensfm(unused, height_datum="ellipsoid").cameras) == ["v2 brown", "old"]


def test_images_of_a_fisheye_and_of_another_lens_are_read_apart(file) -> None:
    path = file(content(cameras={"v2 brown": BROWN, "old": OPENCV_FISHEYE}))
    with pytest.raises(
        TableError, match="some images are of fisheyes and some are not: 'old' a fisheye, 'v2 brown' none"
    ):
        acquisition_of_opensfm(path, height_datum="ellipsoid")
    found: Any = acquisition_of_opensfm(path, height_datum="ellipsoid", camera="old")
    assert isinstance(found.sensor.camera.distortion, Fisheye)


def test_what_the_caller_gives_wrong(file, tmp_path: pathlib.Path) -> None:
    path = file(content())
    with pytest.raises(TableError, match="reference_lla: the vertical datum of altitudes is not stated"):
        read_opensfm(path)
    with pytest.raises(VerticalDatumError, match="reference_lla: height_datum='EPSG:0' is unknown"):
        read_opensfm(path, height_datum="EPSG:0")
    with pytest.raises(TableError, match=r"crs = 'EPSG:4326' .* is no map"):
        read_opensfm(path, height_datum="ellipsoid", crs="EPSG:4326")
    with pytest.raises(FileNotFoundError, match="there is no such file of a reconstruction"):
        read_opensfm(tmp_path / "nowhere.json", height_datum="ellipsoid")
    with pytest.raises(TableError, match="there is no reference_lla, so its frame is its own"):
        read_opensfm(file(content(reference_lla=None)), crs="EPSG:32651")
    with pytest.raises(TableError, match=r"expected cameras by name; got \[\]"):
        read_opensfm_cameras(file([]))


def test_a_real_block_of_opendronemap(jaxgeo_test_data: pathlib.Path) -> None:
    """Its grid, its table of angles and the positions of its images, which OpenSfM keeps topocentric, agree."""
    folder = jaxgeo_test_data / "odm_miaoli"
    path = folder / "opensfm" / "reconstruction.json"
    found = read_opensfm(path, height_datum="ellipsoid", crs="EPSG:32651")
    table = read_orientations(folder / "odm_xyz_opk.csv", height_datum="ellipsoid", crs="EPSG:32651")
    rows = [table.names.tolist().index(name) for name in found.names]
    theirs, ours = table.of(rows).pose, found.poses()
    R = [np.asarray(jax.jit(jax.vmap(lambda one: one.R_ned_from_body))(pose)) for pose in (theirs, ours)]
    np.testing.assert_allclose(R[0], R[1], atol=2e-5)  # written to 0.001 deg
    np.testing.assert_allclose(_enu(theirs, found.reference), found.centres, atol=2e-3)  # m, written to 1 mm
    shots = json.loads(path.read_text())[0]["shots"]
    told = np.array([shots[name]["gps_position"] for name in found.names])
    assert np.abs(told - found.centres).max() < 0.1  # m: RTK
    level = read_opensfm(path, height_datum="ellipsoid", crs="topocentric")
    assert np.abs(told - level.centres).max() > 1.5  # m


def _enu(pose: Pose, reference: Geodetic | None) -> np.ndarray:
    assert reference is not None
    ecef = np.asarray(jax.jit(jax.vmap(WGS84.to_ecef))(pose.position)) - np.asarray(WGS84.to_ecef(reference))
    return ecef @ np.asarray(R_ecef_from_enu(reference))
