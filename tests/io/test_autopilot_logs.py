"""Flight logs of ArduPilot and PX4: positions, attitudes, times of photos, and what is refused.

Held against: ArduPilot's AP_Camera/LogStructure.h and AP_Mount/LogStructure.h (CAM, MNT: fields, formats, units) with
the layout of its dataflash messages; PX4's CameraCapture.msg and "ULog File Format". The logs are packed here byte by
byte, the pixel of a ground point is computed in NumPy and SciPy: the aircraft's attitude is Rz(yaw) Ry(pitch) Rx(roll).
"""

from __future__ import annotations

import calendar
import pathlib
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation
from support.autopilot_logs import AT, POINTED, dataflash, dataflash_text, ulog

from jaxgeo import FrameCamera
from jaxgeo.io import TableError, UnstatedDatum, read_acquisition, undulation
from jaxgeo.io.acquisitions.detect import form_of

FOCAL, WIDTH, HEIGHT = 2600.0, 3840, 2160
CAMERA = FrameCamera.from_pixels(focal_px=FOCAL, width=WIDTH, height=HEIGHT)
GROUND = np.array([60.0, 50.0, 300.0])  # m north, east and down of the camera
BODY, HEAD = (30.5, -3.0, 2.0), (41.5, -60.0, 2.0)  # yaw, pitch, roll of the aircraft and of the mount, deg
AHEAD = np.array([200.0, 190.0, 300.0])  # a point that the mount's camera sees
TIME = calendar.timegm((2023, 5, 4, 10, 20, 31)) + 0.25


def R_ned_from(angles: tuple[float, float, float]) -> np.ndarray:
    return Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()


def quaternion(angles: tuple[float, float, float]) -> list[float]:
    x, y, z, w = Rotation.from_euler("ZYX", angles, degrees=True).as_quat()
    return [w, x, y, z]


def pixel_below(R: np.ndarray, ground: np.ndarray) -> list[float]:
    """A camera that looks down from the aircraft, the top of its image to the nose: right, backward, down."""
    forward, right, down = R.T @ ground
    return [(WIDTH - 1) / 2 + FOCAL * right / down, (HEIGHT - 1) / 2 - FOCAL * forward / down]


def pixel_ahead(R: np.ndarray, ground: np.ndarray) -> list[float]:
    """A camera that looks along its forward axis."""
    forward, right, down = R.T @ ground
    return [(WIDTH - 1) / 2 + FOCAL * right / forward, (HEIGHT - 1) / 2 + FOCAL * down / forward]


def ecef(ned: np.ndarray, height: float) -> np.ndarray:
    lat, lon = np.radians([AT["Lat"], AT["Lng"]])
    axes = np.array([
        [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], [-np.sin(lon), np.cos(lon), 0.0],
        [-np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), -np.sin(lat)],
    ])  # fmt: skip
    at = pyproj.Transformer.from_crs(4979, 4978, always_xy=True).transform(AT["Lng"], AT["Lat"], height)
    return np.array(at) + ned @ axes


@jax.jit
def projected(sensor: Any, shot: Any, p_ecef: Any) -> Any:
    return sensor.project_ecef(shot, p_ecef)[0]


LOGS = {  # content, options, height above the ellipsoid, pixel expected, the point, words of an assumption
    "flight.bin": (dataflash([AT]), {"takeoff_height": 600.0}, pixel_below(R_ned_from(BODY), GROUND), GROUND,
                   "fixed to"),
    "flight.log": (dataflash_text([AT]), {"takeoff_height": 600.0}, pixel_below(R_ned_from(BODY), GROUND), GROUND,
                   "fixed to"),
    "mount.bin": (dataflash([AT], [POINTED]), {"takeoff_height": 600.0}, pixel_ahead(R_ned_from(HEAD), AHEAD), AHEAD,
                  "nearest record in time (0.04 s"),
    "flight.ulg": (ulog([quaternion(BODY)]), {"height_datum": "ellipsoid"}, pixel_below(R_ned_from(BODY), GROUND),
                   GROUND, "fixed to"),
    "gimbal.ulg": (ulog([quaternion(HEAD)], gimbal=True), {"height_datum": "ellipsoid"},
                   pixel_ahead(R_ned_from(HEAD), AHEAD), AHEAD, "gimbal_device_attitude_status"),
}  # fmt: skip


def written(folder: pathlib.Path, name: str, content: bytes | str) -> pathlib.Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("name", LOGS)
def test_a_ground_point_is_seen_where_the_camera_looks(tmp_path: pathlib.Path, name: str) -> None:
    content, how, expected, ground, words = LOGS[name]
    path = written(tmp_path, name, content)
    assert form_of(path).name == f"flight log of {'PX4' if name.endswith('ulg') else 'ArduPilot'}"
    found = read_acquisition(path, cameras=CAMERA, **how)
    assert found.names.tolist() == ["7"]
    sensor, shot, _ = found.exposure(0)
    assert 0.0 < expected[0] < WIDTH
    assert 0.0 < expected[1] < HEIGHT
    np.testing.assert_allclose(projected(sensor, shot, ecef(ground, 900.0)), expected, atol=0.01)  # px: float32 angles
    assert found.time_is_utc
    assert float(found.shots.time[0]) == pytest.approx(TIME, abs=1e-6)
    assert any(words in one for one in found.assumed)
    assert found.of_camera == (name in ("mount.bin", "gimbal.ulg"))


def test_heights_above_mean_sea_level_need_their_datum(tmp_path: pathlib.Path) -> None:
    for name, content in (("a.bin", dataflash([AT])), ("a.ulg", ulog([quaternion(BODY)]))):
        path = written(tmp_path, name, content)
        with pytest.raises(UnstatedDatum, match="the first is 900 m"):
            read_acquisition(path)
        height = read_acquisition(path, height_datum="EPSG:5773").shots.pose.position.height[0]
        assert float(height) == pytest.approx(900.0 + float(undulation(AT["Lat"], AT["Lng"])), abs=1e-6)


def test_photos_without_a_position_are_left_out_and_those_of_two_cameras_told_apart(tmp_path: pathlib.Path) -> None:
    photos = [AT, AT | {"I": 1, "GPSWeek": 0}, AT | {"Img": 8, "Lat": 0.0, "Lng": 0.0}]
    found = read_acquisition(written(tmp_path, "a.bin", dataflash(photos)), height_datum=0.0)
    assert found.names.tolist() == ["0/7", "1/7"]
    assert any("1 of 3 records are left out: position unknown" in one for one in found.assumed)
    assert not found.time_is_utc  # a time is unknown
    failed = ulog([quaternion(BODY)] * 2, result=(0, 1))
    found = read_acquisition(written(tmp_path, "a.ulg", failed), height_datum=0.0)
    assert found.names.tolist() == ["8"]


def test_a_gimbal_straight_down_keeps_its_heading(tmp_path: pathlib.Path) -> None:
    """Where yaw and roll turn about one axis, as most photos of surveys."""
    R = R_ned_from((30.5, -90.0, 0.0))
    path = written(tmp_path, "a.ulg", ulog([quaternion((30.5, -90.0, 0.0))], gimbal=True))
    sensor, shot, _ = read_acquisition(path, cameras=CAMERA, height_datum=0.0).exposure(0)
    point = np.array([60.0, 50.0, 300.0])
    np.testing.assert_allclose(projected(sensor, shot, ecef(point, 900.0)), pixel_ahead(R, point), atol=2.0)  # float32


TWO = dataflash_text([AT, AT | {"Img": 8, "Lat": 36.31}])
KEPT = {  # content, photos, words of an assumption
    "mark.log": (TWO.encode("utf-8-sig"), ["7", "8"], ""),
    "utf16.log": (TWO.encode("utf-16"), ["7", "8"], ""),
    "carriage returns.log": (TWO.replace("\n", "\r"), ["7", "8"], ""),
    "cut.log": (TWO[:-30], ["7"], "The log ends within a message, which is left out"),
    "no end of line.log": (TWO[:-1], ["7"], "The log ends within a message"),  # its last number may be cut
    "cut.bin": (dataflash([AT, AT | {"Img": 8}])[:-10], ["7"], "The log ends within a message"),
    "page.bin": (dataflash([AT]) + bytes(600), ["7"], "Parts of the log are damaged and left out"),
    "unknown.log": (TWO.replace("36.31", "nan"), ["7"], "1 of 2 records are left out: position missing"),
}


@pytest.mark.parametrize("name", KEPT)
def test_what_is_whole_of_a_log_is_read_and_the_rest_told(tmp_path: pathlib.Path, name: str) -> None:
    content, photos, words = KEPT[name]
    found = read_acquisition(written(tmp_path, name, content), height_datum=0.0)
    assert found.names.tolist() == photos
    damages = [one for one in found.assumed if "left out" in one]
    assert len(damages) == bool(words)
    assert words in "".join(damages)


def test_damage_of_a_log_of_px4_is_told(tmp_path: pathlib.Path) -> None:
    content = ulog([quaternion(BODY)] * 6)
    last = content.rindex(b"D\x03\x00") - 2  # where the last photo begins
    found = read_acquisition(written(tmp_path, "a.ulg", content[:last] + bytes(9) + content[last:]), height_datum=0.0)
    assert len(found) < 6
    assert any("Parts of the log are damaged" in one for one in found.assumed)


REFUSED = {
    "no length.bin": (dataflash([AT]).replace(b"\xa3\x95\x80\xa0\x34", b"\xa3\x95\x80\xa0\x00"), "'CAM' of 0 bytes"),
    "text.bin": (dataflash([AT]).replace(b"eeefff", b"eeeffn"), "Y of a message CAM is .*, not a number"),
    "no photo.bin": (dataflash([]), "there is no message CAM"),
    "no photo.ulg": (ulog([]), "there is no camera_capture"),
    "noise.bin": (dataflash([AT]).replace(b"\xa3\x95\xa0", b"abc"), "there is no message CAM"),
    "cut.log": (dataflash_text([AT])[:40], "damaged, or no log of ArduPilot|there is no message CAM"),
    "nowhere.ulg": (ulog([[0.0, 0.0, 0.0, 0.0]]), "no record has a position"),
    "far.bin": (dataflash([AT | {"Lat": 200.0}]), "photo 7: lat 200 is outside"),
    "cut.ulg": (ulog([quaternion(BODY)])[:12], "damaged, or no log of PX4"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_refused_in_a_line(tmp_path: pathlib.Path, name: str, capfd) -> None:
    content, words = REFUSED[name]
    with pytest.raises(TableError, match=words) as refusal:
        read_acquisition(written(tmp_path, name, content), height_datum=0.0)
    assert "\n" not in str(refusal.value)
    assert capfd.readouterr() == ("", "")
