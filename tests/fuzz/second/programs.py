"""Second readings of exports of photogrammetry programs, logs of autopilots and flight apps."""

from __future__ import annotations

import pathlib
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.fuzz.second.compared import (
    DEGREES,
    R_NED_FROM_ENU,
    decoded,
    in_map,
    number,
    same,
    same_attitude,
    same_names,
    same_places,
    same_turn,
    turn,
)
from tests.fuzz.second.structured import same_camera
from tests.fuzz.second.tables import Rows, any_of, same_gimbal, tables
from tests.fuzz.sound_programs import OFFSET, UNDULATION, UTM

FAR = 3e6  # m from the central meridian, beyond which series of the map differ by mm
BLOCK = 10  # lines of an image of Pix4D
BROWN = ("k1", "k2", "k3", "p1", "p2")
AHEAD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # forward, right, down of (right, down, ahead)


def pix4d(path: pathlib.Path, found: Any) -> None:
    """Ten lines an image below seven of the header: size, K, distortion, centre, rows of R from the world."""
    lines = [line.split() for line in re.split(r"\r\n|\r|\n|\f|\v", decoded(path.read_bytes())) if line.strip()][7:]
    blocks = [lines[k : k + BLOCK] for k in range(0, len(lines), BLOCK)]
    same_names("images", found.names, [" ".join(block[0][:-2]) for block in blocks])
    numbers = [[np.array([number(word) for word in row]) for row in block[1:]] for block in blocks]
    centres = np.array([block[5] for block in numbers]) + OFFSET
    _in_utm(found, centres, np.array([np.array(block[6:]).T for block in numbers]), 2e-3)  # R is made a rotation
    K, lens = np.array(numbers[0][:3]), [*numbers[0][3], *numbers[0][4]]
    camera = _first(found.sensor.camera)
    size = [number(word) for word in blocks[0][0][-2:]]
    same_camera(camera, size, [K[0, 0], K[1, 1]], K[:2, 2] - 0.5, dict(zip(BROWN, lens, strict=True)))


def cam(path: pathlib.Path, camera: Any) -> None:
    """Lines of a key and a number in mm; the last counts. 400 pixels are as wide as the sensor."""
    text = decoded(path.read_bytes())
    words = [line.split() for line in text.splitlines()]
    keys = {row[0]: row[1] for row in words if len(row) == 2}
    width = re.search(r"sensor width of\s+([0-9.]+)", text)
    assert width is not None
    f, px, py, k1, k2, k3, p1, p2 = (number(keys[key]) for key in ("F", "Px", "Py", "K1", "K2", "K3", "T1", "T2"))
    scale = 400.0 / number(width[1])
    lens = {"k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2}
    same_camera(camera, (400, 300), f * scale, np.array([px, py]) * scale - 0.5, lens)


def model(stem: str, ending: str) -> Callable[[pathlib.Path, Any], None]:
    """A file of a COLMAP model: cameras, or images in the map."""

    def second(path: pathlib.Path, found: Any) -> None:
        content = path.read_bytes()
        if stem == "cameras":
            return _colmap_camera(_cameras_bin(content) if ending == ".bin" else _cameras_txt(content), found)
        images = list(_images_bin(content) if ending == ".bin" else _images_txt(content))
        same_names("images", found.names, [name for name, _ in images])
        poses = np.array([pose for _, pose in images])
        R = Rotation.from_quat(poses[:, [1, 2, 3, 0]]).as_matrix().transpose(0, 2, 1)
        return _in_utm(found, -np.einsum("nij,nj->ni", R, poses[:, 4:]), R)

    return second


def _colmap_camera(stated: tuple[str, float, float, list[float]], found: Any) -> None:
    kind, width, height, parameters = stated
    assert kind in ("OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV"), kind
    names = ("k1", "k2", "k3", "k4") if "FISHEYE" in kind else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    lens = dict(zip(names, parameters[4:], strict=False))
    same_camera(
        _first(found.sensor.camera), (width, height), parameters[:2], np.array(parameters[2:4]) - 0.5, lens
    )  # fmt: skip


def _cameras_txt(content: bytes) -> tuple[str, float, float, list[float]]:
    rows = [line.split() for line in decoded(content).splitlines() if line.strip() and not line.strip().startswith("#")]
    row = next(row for row in rows if number(row[0]) == 7.0)
    return row[1], number(row[2]), number(row[3]), [number(word) for word in row[4:]]


def _cameras_bin(content: bytes) -> tuple[str, float, float, list[float]]:
    names = {4: ("OPENCV", 8), 5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12)}
    at, found = 8, {}
    for _ in range(struct.unpack_from("<Q", content)[0]):
        key, kind, width, height = struct.unpack_from("<iiQQ", content, at)
        name, count = names[kind]
        found[key] = name, width, height, list(struct.unpack_from(f"<{count}d", content, at + 24))
        at += 24 + 8 * count
    return found[7]


def _images_txt(content: bytes) -> Iterator[tuple[str, list[float]]]:
    is_pose = True
    for line in decoded(content).splitlines():
        words = line.split()
        if is_pose and (not words or words[0].startswith("#")):
            continue
        if is_pose:
            yield " ".join(words[9:]), [number(word) for word in words[1:8]]
        is_pose = not is_pose


def _images_bin(content: bytes) -> Iterator[tuple[str, list[float]]]:
    at = 8
    for _ in range(struct.unpack_from("<Q", content)[0]):
        pose = list(struct.unpack_from("<7d", content, at + 4))
        end = content.index(b"\0", at + 64)
        (points,) = struct.unpack_from("<Q", content, end + 1)
        yield content[at + 64 : end].decode(), pose
        at = end + 9 + 24 * points


def _in_utm(found: Any, centres: np.ndarray, R_map_from_camera: np.ndarray, atol: float = 1e-7) -> None:
    lat, lon, azimuth = in_map(UTM, *centres[:, :2].T)
    if np.all(np.abs(centres[:, 0] - 5e5) < FAR):
        same_places(found.shots.pose.position, lat, lon, centres[:, 2] + UNDULATION)
    R_enu_from_map = turn("z", -np.deg2rad(azimuth))
    same_attitude(found.shots.pose, R_NED_FROM_ENU @ R_enu_from_map @ R_map_from_camera, atol)


def _first(camera: Any) -> Any:
    import jax

    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], camera)


def dataflash(path: pathlib.Path, found: Any) -> None:
    """Every photo is a message CAM of the bytes, by a format that is stated anywhere."""
    content = path.read_bytes()
    formats: dict[int, list[tuple[str, str, list[str]]]] = {}
    stated: dict[str, list[dict[str, float]]] = {"CAM": [], "MNT": []}
    starts = [found.start() for found in re.finditer(rb"\xa3\x95", content)]
    for at in starts:
        if content[at + 2 : at + 3] == b"\x80" and at + 89 <= len(content):
            kind, _, name, codes, columns = struct.unpack_from("<BB4s16s64s", content, at + 3)
            if _text(name) in stated:
                formats.setdefault(kind, []).append((_text(name), _text(codes), _text(columns).split(",")))
    for at in starts:
        for name, codes, columns in formats.get(content[at + 2] if at + 2 < len(content) else -1, []):
            row = _unpacked(content, at + 3, codes, columns)
            if row is not None:
                stated[name].append(row)
    _autopilot(found, stated["CAM"], stated["MNT"])


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("latin-1")


def _unpacked(content: bytes, at: int, codes: str, columns: list[str]) -> dict[str, float] | None:
    kinds = {"L": ("i", 1e-7), "e": ("i", 1e-2), "E": ("I", 1e-2), "c": ("h", 1e-2), "C": ("H", 1e-2), "M": ("B", 1.0)}
    form = "<" + "".join(kinds.get(code, (code, 1.0))[0] for code in codes)
    try:
        values = struct.unpack_from(form, content, at)
    except struct.error:
        return None
    return {
        name: value * kinds.get(code, ("", 1.0))[1]
        for name, code, value in zip(columns, codes, values, strict=False)
        if not isinstance(value, bytes)
    }


def dataflash_text(path: pathlib.Path, found: Any) -> None:
    """Every photo is a line CAM, by the columns of a line FMT."""
    stated: dict[str, list[dict[str, float]]] = {"CAM": [], "MNT": []}
    columns: dict[str, list[list[str]]] = {"CAM": [], "MNT": []}
    text = decoded(path.read_bytes())
    lines = [line.split(", ") for line in text.split("\n" if "\n" in text else "\r")]
    for words in lines:
        if words[0] == "FMT" and len(words) > 5 and words[3] in columns:
            columns[words[3]].append([name.strip() for word in words[5:] for name in word.split(",")])
    for words in lines:
        for names in columns.get(words[0], []):
            row = {name: _or_nan(word.strip()) for name, word in zip(names, words[1:], strict=False)}
            stated[words[0]].append(row)
    _autopilot(found, stated["CAM"], stated["MNT"])


def _or_nan(word: str) -> float:
    try:
        return number(word)
    except ValueError:
        return np.nan


def _autopilot(found: Any, photos: list[dict[str, float]], mounts: list[dict[str, float]]) -> None:
    """Each exposure has the place and the angles of a stated photo, or of the mount."""
    import jax

    above = "RelAlt" if "take-off" in " ".join(found.assumed) else "Alt"
    for k in range(len(found.names)):
        pose = jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k : k + 1], found.shots.pose)
        lat, lon = np.rad2deg(pose.position.lat[0]), np.rad2deg(pose.position.lon[0])
        near = [
            one
            for one in photos
            if abs(one.get("Lat", np.nan) - lat) < 1e-9 and abs(one.get("Lng", np.nan) - lon) < 1e-9
        ]
        heights = [one.get(above, np.nan) + (600.0 if above == "RelAlt" else 0.0) for one in near]
        assert any(abs(height - pose.position.height[0]) < 1e-6 for height in heights), f"photo at {lat}, {lon}: none"
        names = ("Pitch", "Roll") if found.of_camera else ("P", "R")
        stated = mounts if found.of_camera else near
        rows = [
            (yaw, *(one.get(name, np.nan) for name in names))
            for one in stated
            for yaw in (_yaws(one, near) if found.of_camera else [one.get("Y", np.nan)])
        ]
        _any_attitude(pose, rows, found.of_camera)


def _yaws(mount: Mapping[str, float], photos: list[dict[str, float]]) -> list[float]:
    return [mount.get("YawE", np.nan), *(photo.get("Y", np.nan) + mount.get("YawB", np.nan) for photo in photos)]


def _any_attitude(pose: Any, rows: list[tuple[float, float, float]], of_camera: bool) -> None:
    errors: list[AssertionError] = []
    for yaw, pitch, roll in rows:
        try:
            if of_camera:
                same_gimbal(pose, [yaw], [pitch], [roll])
            else:
                angles = np.rad2deg([pose.heading[0], pose.pitch[0], pose.roll[0]])
                same_turn("angles", angles, [yaw, pitch, roll])
        except (AssertionError, ValueError) as error:
            errors.append(AssertionError(str(error)))
        else:
            return
    raise (errors or [AssertionError("no stated angles")])[0]


def px4(path: pathlib.Path, found: Any) -> None:
    """Every photo is a place in the bytes as PX4 writes it: time, latitude, longitude, number, height, quaternion."""
    content = path.read_bytes()
    places = np.rad2deg(np.asarray([found.shots.pose.position.lat, found.shots.pose.position.lon])).T
    for k, (lat, lon) in enumerate(places):
        rows = (struct.unpack_from("<ddIff4f", content, at) for at in range(len(content) - 43))
        matches = [row for row in rows if abs(row[0] - lat) < DEGREES and abs(row[1] - lon) < DEGREES]
        height = found.shots.pose.position.height[k]
        assert any(values[3] == height for values in matches), f"photo at {lat}, {lon}, {height}: not in the file"
        turns = [values[5:9] for values in matches if np.linalg.norm(values[5:9]) > 0.5]
        R = [Rotation.from_quat([x, y, z, w]).as_matrix() for w, x, y, z in turns]
        own = _attitude(found, k)
        assert any(np.abs(own - one @ (AHEAD if found.of_camera else _BELOW)).max() < 1e-5 for one in R), "attitude"


_BELOW = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # a camera that looks down


def _attitude(found: Any, k: int) -> np.ndarray:
    pose = found.shots.pose
    heading, pitch, roll = (np.atleast_1d(np.asarray(one)[k]) for one in (pose.heading, pose.pitch, pose.roll))
    return (turn("z", heading) @ turn("y", pitch) @ turn("x", roll))[0] @ _BELOW


def app_log(columns: tuple[str, ...], height: str, angle: float, takeoff: float) -> Callable[[pathlib.Path, Any], None]:
    """Flight logs of apps: columns of latitude, longitude, yaw, pitch, roll; heights above the take-off."""

    def second(path: pathlib.Path, found: Any) -> None:
        def check(rows: Rows) -> None:
            keys = {re.sub(r"\s*[(\[].*", "", key.lower()): key for key in reversed(list(rows[0]))}
            feet = re.search(r"[(\[](feet|ft)[)\]]", keys[height].lower()) is not None
            kept = [rows[int(name)] for name in found.names]
            lat, lon, *angles = (np.array([number(row[keys[name]]) for row in kept]) for name in columns)
            above = np.array([number(row[keys[height]]) for row in kept]) * (0.3048 if feet else 1.0)
            same_places(found.shots.pose.position, lat, lon, takeoff + above)
            same_gimbal(found.shots.pose, *(angle * one for one in angles))

        any_of(tables(path), check)

    return second


def interpolated(path: pathlib.Path, found: Any) -> None:
    """One exposure at half a second into a log of Litchi: on the way between two records, or at one."""

    def check(rows: Rows) -> None:
        keys = {key.strip().lower(): key for key in reversed(list(rows[0]))}
        lat = [_or_nan(row[keys["latitude"]].strip()) for row in rows]
        ours = np.rad2deg(found.shots.pose.position.lat)
        assert np.nanmin(lat) - DEGREES <= ours[0] <= np.nanmax(lat) + DEGREES
        clock = [re.fullmatch(r"(.*):(\d\d\.\d+)", row.get(keys.get("datetime(utc)", ""), "").strip()) for row in rows]
        ends = [(one[1], number(one[2])) for one in clock if one]
        if len(rows) == len(ends) == 2 and np.all(np.isfinite(lat)) and ends[0][0] == ends[1][0]:
            (first, north), (last, other) = sorted((time, place) for (_, time), place in zip(ends, lat, strict=True))
            if last > first + 0.5 and "interpolated" in " ".join(found.assumed):
                same("latitude", ours, [np.interp(first + 0.5, (first, last), (north, other))], 1e-7)

    any_of(tables(path), check)


def band(path: pathlib.Path, found: Any) -> None:
    """Angles in rad of a light sensor, and the mount turned by RigRelatives in deg: Rx Ry Rz."""
    from tests.fuzz.second.drone_images import xmp_texts

    tags = xmp_texts(path.read_bytes())
    readings = np.asarray(found.shots.gimbal_readings)[0]
    if all(f"DLS:{name}" in tags for name in ("Yaw", "Pitch", "Roll")):
        angles = [np.rad2deg(number(tags[f"DLS:{name}"].strip())) for name in ("Yaw", "Pitch", "Roll")]
        pose = found.shots.pose
        own = np.rad2deg(readings if readings.size else [pose.heading[0], pose.pitch[0], pose.roll[0]])
        same_turn("angles", own, angles)
    turned = [number(word.strip()) for word in tags.get("Camera:RigRelatives", "0,0,0").split(",")]
    R = np.asarray(found.sensor.mount.R_head_from_camera)[0]
    cosine = (np.trace(Rotation.from_euler("XYZ", turned, degrees=True).as_matrix() @ R.T @ _head(found)) - 1.0) / 2.0
    assert cosine > 1.0 - 1e-12, f"the turn on the mount: {cosine}, {turned}"


def _head(found: Any) -> np.ndarray:
    """A mount without a turn: the one of the reader that looks down, or ahead."""
    R = np.asarray(found.sensor.mount.R_head_from_camera)[0]
    return min((AHEAD, _BELOW), key=lambda one: np.abs(one - R).max())
