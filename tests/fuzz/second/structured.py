"""Second readings of JSON, YAML, TOML, XML and subtitles: by `json`, PyYAML, `tomllib`, lxml and a pattern."""

from __future__ import annotations

import pathlib
import re
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyproj
import yaml
from scipy.spatial.transform import Rotation
from support.video_files import texts_in

from tests.fuzz.second.compared import (
    DEGREES,
    decoded,
    egm96,
    in_map,
    number,
    of_json,
    of_opk,
    same,
    same_attitude,
    same_names,
    same_places,
    same_turn,
)
from tests.fuzz.second.tables import same_gimbal

OPENSFM_LENSES = {
    "perspective": ("k1", "k2"),
    "simple_radial": ("k1",),
    "radial": ("k1", "k2"),
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("k1", "k2"),
    "fisheye_opencv": ("k1", "k2", "k3", "k4"),
}
ONE_FOCAL = ("perspective", "fisheye")  # the others have a principal point too


def same_camera(camera: Any, size: Any, focal: Any, principal: Any, lens: Mapping[str, Any]) -> None:
    """A frame camera: columns and rows, pixels, coefficients by name; all others zero."""
    same("size of a camera", [camera.width, camera.height], size)
    same("focal length", camera.focal_px, np.broadcast_to(focal, (2,)), 1e-9)
    same("principal point", camera.principal_px, principal, 1e-9)
    names = getattr(camera.distortion, "names", ())
    same("lens", [getattr(camera.distortion, name) for name in names], [lens.get(name, 0.0) for name in names])
    assert all(lens[name] == 0.0 for name in lens if name not in names), lens


def _opensfm_camera(camera: Any, stated: Mapping[str, Any]) -> None:
    kind = stated.get("projection_type", "perspective")
    width, height = stated["width"], stated["height"]
    longer = max(width, height)
    names = ("focal", "focal") if kind in ONE_FOCAL else ("focal_x", "focal_y")
    offset = [0.0 if kind in ONE_FOCAL else stated.get(name, 0.0) for name in ("c_x", "c_y")]
    principal = np.array([width - 1.0, height - 1.0]) / 2.0 + longer * np.array(offset)
    lens = {name: stated.get(name, 0.0) for name in OPENSFM_LENSES[kind]}
    same_camera(camera, (width, height), [longer * stated[name] for name in names], principal, lens)


def cameras_of_opensfm(path: pathlib.Path, cameras: Mapping[str, Any]) -> None:
    stated = of_json(path.read_bytes())
    same_names("cameras", list(cameras), list(stated))
    for name, camera in cameras.items():
        _opensfm_camera(camera, stated[name])


def _part(path: pathlib.Path) -> Any:
    stated = of_json(path.read_bytes())
    return stated[0] if isinstance(stated, list) else stated


def points_of_opensfm(path: pathlib.Path, found: Any) -> None:
    """Points, centres and rotations in the reconstruction's frame."""
    stated = _part(path)
    points = stated.get("points", {})
    same_names("points", found.point_names, list(points))
    same("points", found.points, np.reshape([one["coordinates"] for one in points.values()], (-1, 3)))
    same_names("shots", found.names, list(stated["shots"]))
    R, centres = _turns(stated["shots"].values())
    same("centres", found.centres, centres, 1e-9 * max(1.0, np.abs(centres).max()))
    same("rotations", found.R_enu_from_camera, R, 1e-9)
    for name, camera in found.cameras.items():
        _opensfm_camera(camera, stated["cameras"][name])


def _turns(shots: Any) -> tuple[np.ndarray, np.ndarray]:
    vectors = np.array([[one["rotation"], one["translation"]] for one in shots], np.float64)
    R = Rotation.from_rotvec(vectors[:, 0]).as_matrix().transpose(0, 2, 1)
    return R, -np.einsum("nij,nj->ni", R, vectors[:, 1])


def shots_of_opensfm(path: pathlib.Path, found: Any) -> None:
    """Shots on the Earth: east-north-up about the reference, by PROJ's topocentric conversion."""
    stated = _part(path)
    same_names("shots", found.names, list(stated["shots"]))
    R, centres = _turns(stated["shots"].values())
    lla = stated["reference_lla"]
    lat0, lon0, h0 = (float(lla[name]) for name in ("latitude", "longitude", "altitude"))
    to_enu = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lon_0={lon0!r} +lat_0={lat0!r} +h_0={h0!r}"
    )
    position = found.shots.pose.position
    enu = np.stack(to_enu.transform(np.rad2deg(position.lon), np.rad2deg(position.lat), position.height), axis=-1)
    same("centres", enu, centres, 1e-6 + 1e-9 * np.abs(centres).max())
    R_ecef_from_enu = _R_ecef_from_enu(np.deg2rad(lat0), np.deg2rad(lon0))
    R_local = np.stack(
        [_R_ecef_from_enu(*at) for at in zip(np.atleast_1d(position.lat), np.atleast_1d(position.lon), strict=True)]
    )
    flip = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    _camera_of_first(found, stated)
    same_attitude(found.shots.pose, flip @ R_local.transpose(0, 2, 1) @ R_ecef_from_enu @ R)


def _camera_of_first(found: Any, stated: Mapping[str, Any]) -> None:
    import jax

    name = next(iter(stated["shots"].values()))["camera"]
    _opensfm_camera(jax.tree.map(lambda leaf: np.asarray(leaf)[0], found.sensor.camera), stated["cameras"][name])


def _R_ecef_from_enu(lat: Any, lon: Any) -> np.ndarray:
    (sp, cp), (sl, cl) = (np.sin(lat), np.cos(lat)), (np.sin(lon), np.cos(lon))
    return np.array([[-sl, -sp * cl, cp * cl], [cl, -sp * sl, cp * sl], [0.0, cp, sp]])


def _numeric(value: Any) -> float:
    """A number of YAML; a text that is one counts, as `1e5` is a text in YAML 1.1."""
    return number(value) if isinstance(value, str) else float(value)


def cameras_of_orthority(path: pathlib.Path, cameras: Mapping[str, Any]) -> None:
    stated = yaml.load(path.read_text("utf-8-sig"), Loader=yaml.CSafeLoader)
    if "type" in stated and not isinstance(stated["type"], dict):
        stated = {stated.get("name", "unknown"): stated}
    same_names("cameras", list(cameras), list(stated))
    for camera, one in zip(cameras.values(), stated.values(), strict=True):
        size = np.array([_numeric(side) for side in one["im_size"]])
        focal = np.array([_numeric(f) for f in np.atleast_1d(np.array(one["focal_len"], object))])
        sensor = one.get("sensor_size")
        focal = focal * size / [_numeric(side) for side in sensor] if sensor is not None else focal * size[0]
        offset = [_numeric(one.get(key, 0.0)) for key in ("cx", "cy")]
        names = [*(f"k{k}" for k in range(1, 7)), "p1", "p2"]
        lens = {name: _numeric(one.get(name, 0.0)) for name in names}
        same_camera(camera, size, focal, (size - 1.0) / 2.0 + size.max() * np.array(offset), lens)


def exposures_of_orthority(path: pathlib.Path, found: Any) -> None:
    """GeoJSON: positions and angles in rad in the map `world_crs`."""
    stated = of_json(path.read_bytes())
    tags = [feature["properties"] for feature in stated["features"]]
    same_names("images", found.names, [one["filename"] for one in tags])
    x, y, z = np.array([one["xyz"] for one in tags], np.float64).T
    lat, lon, azimuth = in_map(stated["world_crs"], x, y)
    same_places(found.shots.pose.position, lat, lon, z)
    same_attitude(found.shots.pose, of_opk(*np.array([one["opk"] for one in tags], np.float64).T, azimuth))


def camera(path: pathlib.Path, found: Any) -> None:
    _toml_camera(tomllib.loads(path.read_text("utf-8-sig"))["camera"], found)


def _toml_camera(stated: Mapping[str, Any], camera: Any) -> None:
    width, height = stated["width"], stated["height"]
    centre = np.array([width - 1.0, height - 1.0]) / 2.0
    if "focal_px" in stated:
        focal, principal = stated["focal_px"], stated.get("principal_px", centre)
    else:
        pitch = stated["pixel_pitch_um"] * 1e-3
        focal = stated["focal_length_mm"] / pitch
        principal = centre + np.array(stated.get("principal_point_mm", [0.0, 0.0])) / pitch
    same_camera(camera, (width, height), focal, principal, stated.get("distortion", {}))


def scene(path: pathlib.Path, found: Any) -> None:
    stated = tomllib.loads(path.read_text("utf-8-sig"))
    _toml_camera(stated["camera"], found.sensor.camera)
    assert found.title == stated.get("title", "")
    pose, mount, gimbal = stated.get("pose"), stated.get("mount", {}), stated.get("gimbal", {"kind": "fixed"})
    same("lever of the body", found.sensor.mount.lever_body, mount.get("lever_body_m", [0.0] * 3))
    same("lever of the head", found.sensor.mount.lever_head, mount.get("lever_head_m", [0.0] * 3))
    if pose is None:
        assert found.shot is None
        return
    names = {"two_axis": ("outer", "inner"), "mirror": ("depression", "azimuth"), "level": ("yaw", "pitch", "roll")}
    readings = [gimbal[f"{name}_deg"] for name in names.get(gimbal["kind"], ())]
    same("readings", np.rad2deg(found.shot.gimbal_readings), readings, DEGREES)
    lat, lon, datum = float(pose["lat_deg"]), float(pose["lon_deg"]), pose["height_datum"]
    above = {"ellipsoid": 0.0, "EPSG:5773": float(egm96(lat, lon))}.get(datum, datum)
    if not isinstance(above, str):
        same("height", found.shot.pose.position.height, pose["height_m"] + above, 1e-3)
    same("latitude", np.rad2deg(found.shot.pose.position.lat), lat, DEGREES)
    same_turn("longitude", np.rad2deg(found.shot.pose.position.lon), lon)
    if "map_crs" not in pose:
        angles = np.rad2deg([found.shot.pose.heading, found.shot.pose.pitch, found.shot.pose.roll])
        same_turn("angles", angles, [pose["heading_deg"], pose["pitch_deg"], pose["roll_deg"]])
    assert (found.errors is None) == ("errors" not in stated)


def metashape(path: pathlib.Path, found: Any) -> None:
    """Aligned cameras of a chunk: transforms of 4 x 4, then the chunk's to ECEF."""
    from lxml import etree

    text = re.sub(r"^\s*<\?xml[^>]*\?>", "", decoded(path.read_bytes()))
    root = etree.fromstring(text, etree.XMLParser(resolve_entities=False, huge_tree=False))
    chunk = root if root.tag == "chunk" else root.find("chunk")
    aligned = [one for one in chunk.iter("camera") if one.find("transform") is not None]
    same_names("cameras", found.names, [one.get("label", one.get("id", "")) for one in aligned])
    R, shift, scale = np.eye(3), np.zeros(3), 1.0
    whole = chunk.find("transform")
    if whole is not None and len(whole):
        texts = {one.tag: _floats(one.text) for one in whole if isinstance(one.tag, str)}
        R = texts.get("rotation", np.eye(3)).reshape(3, 3)
        shift, scale = texts.get("translation", shift), texts.get("scale", np.ones(1))[0]
    matrices = np.array([_floats(one.findtext("transform")).reshape(4, 4) for one in aligned])
    position = found.shots.pose.position
    ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    centres = np.stack(ecef.transform(np.rad2deg(position.lon), np.rad2deg(position.lat), position.height), axis=-1)
    expected = shift + scale * matrices[:, :3, 3] @ R.T
    same("centres", centres, expected, 1e-6 + 2e-3 * scale * np.abs(matrices[:, :3, 3]).max())  # R is made orthonormal
    sensor = next(one for one in chunk.iter("sensor") if one.get("id", "") == aligned[0].get("sensor_id", ""))
    calibration = sensor.find("calibration[@class='adjusted']")
    calibration = sensor.find("calibration") if calibration is None else calibration
    focal = np.asarray(found.sensor.camera.focal_px)[0]
    f = _floats(calibration.findtext("f"))[0]
    same("focal length", focal, [f + _floats(calibration.findtext("b1") or "0")[0], f], 1e-9)


def _floats(text: str | None) -> np.ndarray:
    return np.array([number(word) for word in (text or "").split()])


def subtitles(path: pathlib.Path, found: Any) -> None:
    """`name: number` in each cue: every exposure is one of them, in their order; the others are counted."""
    text = "\n".join(decoded(path.read_bytes()).splitlines())
    time = r"^.*\d+:\d\d:\d\d[,.]\d+\s*-->\s*\d+:\d\d:\d\d[,.]\d+.*$"
    _are_of(re.split(time, text, flags=re.MULTILINE)[1:], found)


def captions(path: pathlib.Path, found: Any) -> None:
    """The same of the samples of a text track."""
    _are_of(texts_in(path.read_bytes()), found)


def _are_of(cues: Iterable[str], found: Any) -> None:
    rows = []
    for cue in cues:
        fields = re.findall(
            r"(\w+)\s*:\s*([-+]?[0-9][^\s\]\[,;)}<>]*)", re.sub(r"<[^>]*>", " ", " ".join(cue.split("\n")))
        )
        values = {name.lower().replace("longtitude", "longitude"): _or_none(value) for name, value in fields}
        row = [values.get(name) for name in ("latitude", "longitude", "abs_alt", "gb_yaw", "gb_pitch", "gb_roll")]
        if None not in row and row[:2] != [0.0, 0.0] and row[2] != 0.0 and row[3:] != [0.0] * 3:
            rows.append(row)
    position = found.shots.pose.position
    lat = np.rad2deg(position.lat)
    kept = [next((k for k, row in enumerate(rows) if abs(row[0] - one) < DEGREES), -1) for one in lat]
    assert -1 not in kept, f"latitudes {lat}, by the second reading {[row[0] for row in rows]}"
    _, lon, height, yaw, pitch, roll = np.array([rows[k] for k in kept], np.float64).T
    same_turn("longitude", np.rad2deg(position.lon), lon)
    same("height", position.height, height + egm96(lat, lon), 1e-3)
    same_gimbal(found.shots.pose, yaw, pitch, roll)


def _or_none(word: str | None) -> float | None:
    try:
        return None if word is None else number(word)
    except ValueError:
        return None
