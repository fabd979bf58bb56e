"""Scene update writer: a scene file with a new pose and sensor constants, everything else unchanged."""

from __future__ import annotations

import os
import pathlib
import tomllib
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import ValidationError

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.io._mistakes import explain
from jaxgeo.io._schema import PoseTable, SceneTable
from jaxgeo.io.scene import SceneError, grid_convergence, metres_of_map, read_scene, transformer_of_map
from jaxgeo.io.vertical import height_shift
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.distortion import NoDistortion

# Decimals written: about 1e-7 m for latitudes, 1e-11 rad for angles, 1e-7 m and 1e-9 pixels for lengths.
DECIMALS = {"lat_deg": 12, "lon_deg": 12, "height_m": 7, "easting_m": 7, "northing_m": 7}
DECIMALS_OF_ANGLES, DECIMALS_OF_LENGTHS = 10, 9
SAME = 1e-12  # in rad, or relative: smaller differences of sensor parts count as equal

Changes = dict[tuple[str, ...], Any]


def write_updated_scene(
    path: str | os.PathLike[str],
    scene: str | os.PathLike[str],
    shot: Shot,
    sensor: Sensor | None = None,
) -> None:
    """Write the scene file `scene` with its pose and gimbal readings replaced by those of `shot`; comments are kept.

    The pose has the scene's form: height above the same datum, attitude as heading, pitch and roll
    or as omega, phi and kappa in the same map. `sensor` is the updated sensor, if it changed: focal length, principal
    point, distortion (Brown-Conrady), the rotation of the gimbal's base and lever arms are written where they differ.
    `read_scene` reads the result back to 1e-6 m and 1e-9 rad. The file appears only when complete.

    Raises `SceneError` for a scene without a pose, for numbers that a scene file cannot hold, and for a changed
    part of the sensor that has no key in scene files (named); as `read_scene`; `ValueError` for a path that cannot be
    written to, or a shot that does not match the scene; `VerticalDatumError`.
    """
    source = pathlib.Path(scene)
    check_is(shot, Shot, "shot", "One shot of the scene.")
    before = read_scene(source)
    if before.shot is None:
        raise SceneError(f"{source}: [pose] is missing, so there is none to replace; poses come from a table of shots.")
    text = source.read_bytes().decode("utf-8-sig")
    table = SceneTable.model_validate(tomllib.loads(text))
    assert table.pose is not None
    changes = _pose_changes(source, table.pose, shot) | _reading_changes(source, before.sensor.gimbal, shot)
    if sensor is not None:
        check_is(sensor, Sensor, "sensor")
        changes |= dict(_sensor_changes(source, table, before.sensor, sensor))
    text = _with_changes(source, text, changes)
    with destination("scene", pathlib.Path(path)) as stream:
        stream.write(text)


def _with_changes(source: pathlib.Path, text: str, changes: Changes) -> str:
    """The scene's text with values replaced, validated as a scene."""
    import tomlkit  # only needed for writing scenes
    from tomlkit.items import InlineTable

    document = tomlkit.parse(text)
    for (*tables, key), value in changes.items():
        table: Any = document
        for name in tables:
            if name not in table:
                is_inline = isinstance(table, InlineTable)
                table[name] = tomlkit.inline_table() if is_inline else tomlkit.table()
            table = table[name]
        table[key] = value
    text = tomlkit.dumps(document)
    content: dict[str, Any] = tomllib.loads(text)
    try:
        SceneTable.model_validate(content)
    except ValidationError as error:
        reasons = "\n".join(f"{source}, updated: {line}" for line in explain(error, content))
        raise SceneError(reasons) from None
    return text


def _pose_changes(source: pathlib.Path, table: PoseTable, shot: Shot) -> Changes:
    pose, time = shot.pose, float(np.asarray(shot.time))
    shapes = {np.shape(leaf) for leaf in jax.tree.leaves(pose)} - {()}
    if shapes:
        raise ValueError(f"{source}: a scene has one shot; got poses of shape {shapes.pop()}.")
    lat, lon, height = (float(np.asarray(x)) for x in pose.position.to_degrees())
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(pose)):
        raise ValueError(f"{source}: the updated pose is not finite; it is no result that can be written.")
    above = height_shift(table.height_datum).from_ellipsoid(*(np.array([x]) for x in (lon, lat, height)))
    if not np.isfinite(above[0]):
        raise SceneError(f"{source}: height_datum = {table.height_datum!r} is not defined at {lat:.6f}, {lon:.6f} deg.")
    numbers = {"lat_deg": lat, "lon_deg": lon}
    if table.is_on_map and table.map_crs is not None:
        x, y = transformer_of_map(table.map_crs).transform(lon, lat, direction="INVERSE")[:2]
        unit = metres_of_map(table.map_crs)
        numbers = {"easting_m": unit * float(x), "northing_m": unit * float(y)}
    numbers |= {"height_m": float(above[0])} | _attitude(table, pose, lon, lat)
    changes: Changes = {
        ("pose", key): round(value, DECIMALS.get(key, DECIMALS_OF_ANGLES)) for key, value in numbers.items()
    }
    return changes if time == table.time_s else changes | {("pose", "time_s"): time}


def _attitude(table: PoseTable, pose: Pose, lon: float, lat: float) -> dict[str, float]:
    """The angles in deg in the form of the scene's pose."""
    if table.omega_deg is not None and table.map_crs is not None:
        angles = pose.to_omega_phi_kappa(convergence=grid_convergence(table.map_crs, lon, lat))
        names = ("omega_deg", "phi_deg", "kappa_deg")
    else:
        names = ("heading_deg", "pitch_deg", "roll_deg")
        angles = (pose.heading, pose.pitch, pose.roll)
        heading, pitch, roll = (np.rad2deg(float(np.asarray(angle))) for angle in angles)
        if pose.deflection is not None or abs(heading) > 360.0 or abs(pitch) > 90.0 or abs(roll) > 180.0:
            angles = heading_pitch_roll_from_R(pose.R_ned_from_body)
    return {name: float(np.rad2deg(float(np.asarray(angle)))) for name, angle in zip(names, angles, strict=True)}


def _reading_changes(source: pathlib.Path, gimbal: Gimbal, shot: Shot) -> Changes:
    readings = np.asarray(shot.gimbal_readings)
    if readings.shape != (len(gimbal.names),) or not np.isfinite(readings).all():
        raise ValueError(
            f"{source}: the scene's gimbal has readings {', '.join(gimbal.names) or 'none'}; got {readings.tolist()}."
        )
    named = zip(gimbal.names, np.rad2deg(readings).tolist(), strict=True)
    return {("gimbal", f"{name}_deg"): round(value, DECIMALS_OF_ANGLES) for name, value in named}


def _sensor_changes(
    source: pathlib.Path, table: SceneTable, before: Sensor, after: Sensor
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Differences, by key. Raises `SceneError` for those without a key."""
    if not same(before.gimbal, after.gimbal):
        raise _no_key(
            source, "the gimbal's axes, signs, gains, offsets and limits", "[gimbal] has its kind and readings"
        )
    if not same(before.mount.R_head_from_camera, after.mount.R_head_from_camera):
        raise _no_key(source, "R_head_from_camera", "[mount] camera_looks is down or forward")
    yield from _mount_changes(before, after)
    if not (isinstance(before.camera, FrameCamera) and isinstance(after.camera, FrameCamera)):
        raise _no_key(source, f"a {type(after.camera).__name__}", "[camera] is a frame camera")
    yield from _camera_changes(source, table, before.camera, after.camera)
    yield from _distortion_changes(source, before.camera, after.camera)


def _mount_changes(before: Sensor, after: Sensor) -> Iterator[tuple[tuple[str, ...], Any]]:
    for key, value in mount_keys(before.mount, after.mount):
        is_angle = isinstance(value, float)
        yield ("mount", key), round(value, DECIMALS_OF_ANGLES) if is_angle else _lengths(value)


def mount_keys(before: Mount, after: Mount) -> Iterator[tuple[str, float | list[float]]]:
    """Keys of [mount] whose values differ: angles of the gimbal's base in deg, lever arms in m."""
    if not same(before.R_body_from_base, after.R_body_from_base):
        angles = heading_pitch_roll_from_R(jnp.asarray(after.R_body_from_base))
        for name, angle in zip(("heading", "pitch", "roll"), angles, strict=True):
            yield f"base_{name}_deg", float(np.rad2deg(float(np.asarray(angle))))
    for name in ("lever_body", "lever_head"):
        if not same(getattr(before, name), getattr(after, name)):
            yield f"{name}_m", np.asarray(getattr(after, name), np.float64).tolist()


def _camera_changes(
    source: pathlib.Path, table: SceneTable, before: FrameCamera, after: FrameCamera
) -> Iterator[tuple[tuple[str, ...], Any]]:
    size = np.array([after.width, after.height])
    if (before.width, before.height) != (after.width, after.height):
        raise _no_key(source, "another width or height", "an update leaves the image's size as it is")
    camera = table.camera
    pitch_px = 1.0 if camera.pixel_pitch_um is None else camera.pixel_pitch_um * 1e-3  # mm, or pixels, in a pixel
    if not same(before.focal_px, after.focal_px):
        across, down = np.asarray(after.focal_px, np.float64)
        if abs(across - down) <= SAME * across:
            key = "focal_px" if camera.focal_px is not None else "focal_length_mm"
            yield ("camera", key), round(across * pitch_px, DECIMALS_OF_LENGTHS)
        elif camera.focal_px is not None:
            yield ("camera", "focal_px"), _lengths((across, down))
        else:
            raise _no_key(
                source,
                "a focal length that differs along columns and rows",
                "[camera] focal_length_mm is one number; say focal_px = [along columns, along rows]",
            )
    if not same(before.principal_px, after.principal_px):
        place = np.asarray(after.principal_px, np.float64)
        if camera.focal_px is not None:
            yield ("camera", "principal_px"), _lengths(place)
        else:
            yield ("camera", "principal_point_mm"), _lengths((place - (size - 1) / 2.0) * pitch_px)


def _distortion_changes(
    source: pathlib.Path, before: FrameCamera, after: FrameCamera
) -> Iterator[tuple[tuple[str, ...], Any]]:
    if same(before.distortion, after.distortion):
        return
    if not isinstance(after.distortion, BrownConrady) or not isinstance(before.distortion, BrownConrady | NoDistortion):
        raise _no_key(source, f"a {type(after.distortion).__name__}", "[camera.distortion] is of Brown and Conrady")
    for name in after.distortion.names:
        yield ("camera", "distortion", name), float(np.asarray(getattr(after.distortion, name)))


def _lengths(values: Any) -> list[float]:
    return [round(float(value), DECIMALS_OF_LENGTHS) for value in np.asarray(values)]


def same(before: Any, after: Any) -> bool:
    """Whether two records, or arrays, have the same type and values."""
    if jax.tree.structure(before) != jax.tree.structure(after):
        return False
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True)
    return all(np.shape(a) == np.shape(b) and np.allclose(a, b, rtol=SAME, atol=SAME) for a, b in pairs)


def _no_key(source: pathlib.Path, what: str, why: str) -> SceneError:
    return SceneError(f"{source}: a scene file has no key for {what} ({why}), so the update cannot be written.")
