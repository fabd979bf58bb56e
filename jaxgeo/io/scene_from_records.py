"""Scene writer: a scene file of a sensor and a shot."""

from __future__ import annotations

import dataclasses
import os
import pathlib
import tempfile
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import check_is, require_x64
from jaxgeo._destination import destination
from jaxgeo.earth import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_ned
from jaxgeo.io._schema import READINGS
from jaxgeo.io.errors import one_line
from jaxgeo.io.errors_writer import errors_table
from jaxgeo.io.scene import KINDS, SceneError, read_scene
from jaxgeo.io.scene_writer import SAME, mount_keys, same
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Sensor, Shot
from jaxgeo.sensor.distortion import NoDistortion
from jaxgeo.uncertainty.sources import AbstractSource, Attitude, Boresight, GimbalAngles, GimbalMounting, LeverArm

LOOKS = {"down": Mount.nadir, "forward": Mount.forward}
OF_AXES = (Attitude, Boresight, GimbalAngles, GimbalMounting, LeverArm)  # errors about axes of aircraft and gimbal
OFF_AT_MOST = (1e-6, 1e-9)  # m and rad: between the lines of sight of the records and of the file

Table = dict[str, Any]


def write_scene(
    path: str | os.PathLike[str],
    sensor: Sensor,
    shot: Shot,
    *,
    sources: Sequence[AbstractSource] = (),
    atmosphere: Atmosphere | None = None,
    title: str = "",
    comment: str = "",
) -> tuple[str, ...]:
    """Write a sensor and a shot as a scene file, with heights above the ellipsoid; `comment` lines come first.

    Gimbal, mount and attitude are written as they are if a scene file has such ones. Otherwise the camera is written
    as mounted on an aircraft that flies in the direction of its image, with position and attitude of the camera.
    `sources` become the table [errors]. `read_scene` reads lines of sight back to 1e-6 m and 1e-9 rad. Returns a
    sentence for each thing that is written in another form or left out: then errors of angles are left out.

    The file appears only when complete. Raises `SceneError` for what a scene file cannot hold: cameras other than frame
    cameras, distortion other than that of Brown and Conrady, air other than the standard atmosphere, poses that are not
    finite; `TypeError` and `ValueError` for other wrong arguments, and for a path that cannot be written to.

    >>> import os, tempfile
    >>> from jaxgeo.io.scene import read_scene
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3000.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=8.0, height=900.0, heading=30.0)
    >>> shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-60.0, roll=0.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     said = jaxgeo.io.write_scene(os.path.join(folder, "scene.toml"), sensor, shot)
    ...     again = read_scene(os.path.join(folder, "scene.toml"))
    >>> print(said, again.sensor.gimbal.names)
    () ('yaw', 'pitch', 'roll')
    """
    import tomlkit  # only needed for writing scenes

    require_x64()
    check_is(sensor, Sensor, "sensor")
    check_is(shot, Shot, "shot", "One shot.")
    sensor, shot = jax.tree.map(jnp.asarray, (sensor, shot))
    if any(np.ndim(leaf) for leaf in jax.tree.leaves(shot.pose)):
        raise ValueError("shot: a scene has one; got a batch of them.")
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(shot)):
        raise SceneError("the pose and the gimbal readings are to be finite to be written as a scene.")
    whole: Table = {"title": title} if title else {}
    whole |= {"camera": _camera(sensor.camera)}
    kept = _as_it_is(sensor, shot)
    said = []
    if kept is None:
        said.append(
            "a scene file has no key for this gimbal or mount: position and attitude of the camera are written as "
            "those of an aircraft with a camera that looks down."
        )
    whole |= _of_camera(sensor, shot) if kept is None else kept
    whole |= _air(atmosphere)
    errors = [one for one in sources if kept is not None or not isinstance(one, OF_AXES)]
    for one in sources:
        if one not in errors:
            said.append(f"errors of {one.label} are left out: they are about axes that this scene file does not have.")
    if errors:
        from jaxgeo.uncertainty import ErrorModel

        whole["errors"] = errors_table(ErrorModel(tuple(errors)))
    document = tomlkit.document()
    for line in comment.splitlines():
        document.add(tomlkit.comment(one_line(line)))
    document.update(whole)
    text = tomlkit.dumps(document)
    _check_same(pathlib.Path(path), text, sensor, shot)
    with destination("path", pathlib.Path(path)) as stream:
        stream.write(text)
    return tuple(said)


def _camera(camera: Any) -> Table:
    if not isinstance(camera, FrameCamera):
        raise SceneError(f"a scene file has a frame camera; this is a {type(camera).__name__}.")
    across, down = np.asarray(camera.focal_px, np.float64).tolist()
    same = abs(across - down) <= SAME * across
    table: Table = {"width": int(camera.width), "height": int(camera.height)}
    table |= {"focal_px": across if same else [across, down]}
    table |= {"principal_px": np.asarray(camera.principal_px, np.float64).tolist()}
    lens = camera.distortion
    if isinstance(lens, BrownConrady):
        table["distortion"] = {name: float(np.asarray(getattr(lens, name))) for name in lens.names}
    elif not isinstance(lens, NoDistortion):
        raise SceneError(
            f"a scene file has the distortion of Brown and Conrady; this camera has {type(lens).__name__}. Fit one to "
            f"it, or use the file itself in place of a scene."
        )
    return table


def _as_it_is(sensor: Sensor, shot: Shot) -> Table | None:
    """Gimbal, mount and pose as in the records; None if a scene file has no keys for them."""
    mount, pose = sensor.mount, shot.pose
    kind = next((name for name, make in KINDS.items() if same(_unlimited(make()), _unlimited(sensor.gimbal))), None)
    turns = {looks: make().R_head_from_camera for looks, make in LOOKS.items()}
    looks = next((name for name, R in turns.items() if same(R, mount.R_head_from_camera)), None)
    angles, readings = _degrees(pose.heading, pose.pitch, pose.roll), _degrees(*shot.gimbal_readings)
    most = np.array([360.0, 90.0, 180.0, *(360.0 for _ in readings)])
    if kind is None or looks is None or pose.deflection is not None or np.any(np.abs([*angles, *readings]) > most):
        return None
    table: Table = {"gimbal": {"kind": kind, **_named([f"{name}_deg" for name in READINGS[kind]], readings)}}
    if not same(KINDS[kind](), sensor.gimbal):
        table["gimbal"]["limits_deg"] = np.rad2deg(np.asarray(sensor.gimbal.limits, np.float64)).tolist()
    table["mount"] = {"camera_looks": looks, **dict(mount_keys(Mount(), mount))}
    return table | _pose(pose.position, angles, shot)


def _unlimited(gimbal: Gimbal) -> Gimbal:
    return dataclasses.replace(gimbal, limits=np.broadcast_to([-1.0, 1.0], np.shape(gimbal.limits)))


def _named(names: Sequence[str], values: Sequence[float]) -> Table:
    return dict(zip(names, values, strict=True))


def _of_camera(sensor: Sensor, shot: Shot) -> Table:
    """Position and attitude of the camera, as those of an aircraft."""
    down = jnp.asarray(Mount.nadir().R_head_from_camera)
    sight = sensor.sight(shot)
    position = WGS84.to_geodetic(sight.centre)
    attitude = heading_pitch_roll_from_R(R_ecef_from_ned(position).T @ sight.R_ecef_from_camera @ down.T)
    table: Table = {"gimbal": {"kind": "fixed"}, "mount": {"camera_looks": "down"}}
    return table | _pose(position, _degrees(*attitude), shot)


def _pose(position: Any, angles: list[float], shot: Shot) -> Table:
    lat, lon, height = (float(np.asarray(one)) for one in position.to_degrees())
    table: Table = {"lat_deg": lat, "lon_deg": lon, "height_m": height, "height_datum": "ellipsoid"}
    table |= _named(("heading_deg", "pitch_deg", "roll_deg"), angles)
    time = float(np.asarray(shot.time))
    return {"pose": table | ({"time_s": time} if time else {})}


def _air(air: Atmosphere | None) -> Table:
    if air is None:
        return {}
    if not same(air, Atmosphere(sea_level=air.sea_level)):
        raise SceneError("a scene file has the standard atmosphere, or what was measured; this one is computed.")
    return {"air": {"sea_level_m": float(np.asarray(air.sea_level))}}


def _check_same(path: pathlib.Path, text: str, sensor: Sensor, shot: Shot) -> None:
    """Raises `SceneError` if the text is no scene, or has other lines of sight."""
    with tempfile.TemporaryDirectory() as folder:
        trial = pathlib.Path(folder) / "scene.toml"
        trial.write_text(text, encoding="utf-8")
        try:
            scene = read_scene(trial)
        except SceneError as error:
            raise SceneError(f"{path}: not written. {str(error).replace(str(trial), 'The scene')}") from None
    assert scene.shot is not None
    camera: Any = sensor.camera
    columns, rows = (np.linspace(0.0, side - 1.0, 3) for side in (camera.width, camera.height))
    uv = jnp.asarray(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))
    here, there = sensor.sight(shot), scene.sensor.sight(scene.shot)
    apart = float(jnp.linalg.norm(here.centre - there.centre))
    mine, other = (
        jax.vmap(one.camera.ray)(uv)[0] @ look.R_ecef_from_camera.T
        for one, look in ((sensor, here), (scene.sensor, there))
    )
    angle = float(np.nanmax(np.linalg.norm(np.asarray(mine - other), axis=1), initial=0.0))
    if apart > OFF_AT_MOST[0] or angle > OFF_AT_MOST[1]:
        raise SceneError(f"{path}: not written, its lines of sight would be off by {apart:.3g} m and {angle:.3g} rad.")


def _degrees(*angles: Any) -> list[float]:
    return [float(np.rad2deg(float(np.asarray(angle)))) for angle in angles]
