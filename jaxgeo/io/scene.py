"""Scene files (TOML): camera, gimbal, mount and one shot in degrees and metres, as records in radians.

Keys carry their units; `jaxgeo/data/demo_scene.toml` is a commented example.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import os
import pathlib
import threading
import tomllib
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
import pyproj
from pydantic import ValidationError

from jaxgeo._checks import require_x64
from jaxgeo._record import Record
from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.io._bounded import check_dotted_keys, check_nesting, read_bytes
from jaxgeo.io._mistakes import explain
from jaxgeo.io._proj import UNKNOWN_CRS, NoOperation, how_to_get, known_crs, operation
from jaxgeo.io._regular import check_regular
from jaxgeo.io._schema import AirTable, CameraFile, CameraTable, GimbalTable, MountTable, PoseTable, SceneTable
from jaxgeo.io.errors import OutsideDatum, RefusedFile, VerticalDatumError, one_line
from jaxgeo.io.geoid import undulation
from jaxgeo.io.limits import NESTING, PARAMETER_BYTES
from jaxgeo.io.scene_errors import model_of_table
from jaxgeo.io.vertical import LARGEST_UNDULATION, HeightShift, height_shift
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.platform import boresight_from_degrees
from jaxgeo.uncertainty.model import ErrorModel

KINDS: dict[str, Callable[[], Gimbal]] = {
    "two_axis": Gimbal.two_axis,
    "mirror": Gimbal.mirror_two_axis,
    "level": Gimbal.three_axis,
    "three_axis": functools.partial(Gimbal.three_axis, reference="body"),
    "fixed": Gimbal.fixed,
}
MOST_LINES = 20  # reported mistakes of a file
_Numbers = np.ndarray | list[float]


class SceneError(RefusedFile):
    """An invalid scene file; the message names the file and every wrong key, one line each."""

    def __init__(self, message: str = "") -> None:
        lines = str(message).split("\n")
        more = [f"... and {len(lines) - MOST_LINES} more mistakes."] if len(lines) > MOST_LINES else []
        super().__init__("")
        self.args = ("\n".join([*map(one_line, lines[:MOST_LINES]), *more]),)


class Scene(Record):
    """Content of a scene file: a sensor, and a shot unless poses come from a table of shots.

    `height_datum` is the file's datum of heights in a table of shots, or else of its pose;
    `atmosphere` is used for refraction, and `errors` are the standard deviations, if the file has them.
    """

    sensor: Sensor
    shot: Shot | None
    height_datum: str | float | None = eqx.field(static=True)
    title: str = eqx.field(static=True, default="")
    atmosphere: Atmosphere | None = None
    errors: ErrorModel | None = None


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene from a TOML file and validate every field.

    Raises `SceneError` naming the key, the value and the expected value; `FileNotFoundError`; `RuntimeError` with
    64-bit floats off.
    """
    require_x64()
    content, table = _read_table(pathlib.Path(path))
    try:
        for name, part in (("pose", table.pose), ("shots", table.shots)):
            if part is not None:
                _check_datum(name, part.height_datum, content[name]["height_datum"])
        sensor = Sensor(_camera(table.camera), _gimbal(table.gimbal), _mount(table.mount, table.gimbal.kind))
        shot = None if table.pose is None else _shot(table.pose, table.gimbal, sensor.gimbal)
        air = None if table.air is None else _air(table.air, table.pose)
        errors = (
            None if table.errors is None else model_of_table(table.errors, sensor.gimbal, pathlib.Path(path).parent)
        )
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from error
    stated = table.shots or table.pose
    return Scene(sensor, shot, stated.height_datum if stated else None, table.title, air, errors)


def load_scene(path: str | os.PathLike[str]) -> tuple[Sensor, Shot]:
    """The sensor and the shot of a scene file; raises as `read_scene`, and `SceneError` for a file without a pose."""
    scene = read_scene(path)
    if scene.shot is None:
        raise SceneError(f"{path}: [pose] is missing; it has lat_deg, lon_deg, height_m, height_datum and an attitude.")
    return scene.sensor, scene.shot


def read_camera(path: str | os.PathLike[str]) -> FrameCamera:
    """Read the camera of a scene file, or of a file with only the table [camera].

    Raises `SceneError` naming the key, the value and the expected value; `FileNotFoundError`; `RuntimeError` with
    64-bit floats off.
    """
    require_x64()
    content = _read_toml(pathlib.Path(path))
    if "camera" not in content:
        raise SceneError(
            f"{path}: [camera] is missing; it has width, height and focal_px, or focal_length_mm and more."
        )
    try:
        return _camera(CameraFile.model_validate(content).camera)
    except ValidationError as error:
        raise SceneError("\n".join(f"{path}: {line}" for line in explain(error, content))) from None
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from error


def _read_table(path: pathlib.Path) -> tuple[dict[str, Any], SceneTable]:
    """(content of the file as written, the same validated)."""
    content = _read_toml(path)
    try:
        return content, SceneTable.model_validate(content)
    except ValidationError as error:
        raise SceneError("\n".join(f"{path}: {line}" for line in explain(error, content))) from None


def _read_toml(path: pathlib.Path) -> dict[str, Any]:
    """The content of a TOML file; a byte order mark is skipped. Raises `SceneError`, `FileNotFoundError`."""
    check_regular(path, SceneError)
    try:
        text = read_bytes(path, PARAMETER_BYTES).decode("utf-8-sig")
        check_dotted_keys(path, text)
        content = tomllib.loads(text)
        check_nesting(path, content)
        return content
    except RefusedFile as error:
        raise SceneError(str(error)) from None
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such scene file.") from None
    except IsADirectoryError:
        raise SceneError(f"{path}: this is a folder; give the scene file in it.") from None
    except OSError as error:
        raise SceneError(f"{path}: the scene file cannot be read: {error.strerror}.") from error
    except RecursionError:
        raise SceneError(str(NESTING.refusal(path, None))) from None
    except ValueError as error:  # tomllib's own, invalid UTF-8, too long numbers
        raise SceneError(f"{path}: not a TOML file: {error}.") from error


def _check_datum(table: str, datum: str | float, written: Any) -> None:
    """Raises `ValueError` with the key and its value as written for an unusable vertical datum."""
    shown = f"[{table}] height_datum = {json.dumps(written, ensure_ascii=False)}"
    if isinstance(datum, float) and abs(datum) > LARGEST_UNDULATION:
        raise ValueError(
            f"{shown} would be an undulation in m, but the geoid stays within {LARGEST_UNDULATION:g} m of the "
            f'ellipsoid; a vertical datum is written "EPSG:5773", a text.'
        )
    try:
        height_shift(datum)
    except VerticalDatumError as error:
        reason = str(error).replace("as vertical_datum", "as height_datum")  # vertical_datum is an option of `read_dem`
        if reason.startswith(f"vertical_datum={datum!r}"):
            raise ValueError(shown + reason.removeprefix(f"vertical_datum={datum!r}")) from error
        raise ValueError(f"{shown}: {reason.removeprefix('vertical_datum: ')}") from error


def _camera(table: CameraTable) -> FrameCamera:
    distortion = None if table.distortion is None else BrownConrady(**table.distortion.model_dump())
    if table.focal_px is not None:
        return FrameCamera.from_pixels(
            focal_px=table.focal_px,
            width=table.width,
            height=table.height,
            principal_px=table.principal_px,
            distortion=distortion,
        )
    assert table.focal_length_mm is not None
    assert table.pixel_pitch_um is not None
    return FrameCamera.from_metric(
        focal_length=table.focal_length_mm * 1e-3,
        pixel_pitch=table.pixel_pitch_um * 1e-6,
        width=table.width,
        height=table.height,
        principal_point=[1e-3 * offset for offset in table.principal_point_mm or (0.0, 0.0)],
        distortion=distortion,
    )


def _gimbal(table: GimbalTable) -> Gimbal:
    made = KINDS[table.kind]()
    if table.limits_deg is None:
        return made
    limits = np.deg2rad(np.asarray(table.limits_deg, np.float64))
    if not np.all(limits[:, 0] < limits[:, 1]):
        raise ValueError(f"[gimbal] limits_deg = {table.limits_deg}: each is [least, largest], the least first.")
    return dataclasses.replace(made, limits=limits)


def _mount(table: MountTable, kind: str) -> Mount:
    looks = table.camera_looks or ("forward" if kind in ("level", "three_axis") else "down")
    make = Mount.forward if looks == "forward" else Mount.nadir
    R_body_from_base = boresight_from_degrees(
        heading=table.base_heading_deg, pitch=table.base_pitch_deg, roll=table.base_roll_deg
    )
    return make(
        R_body_from_base=R_body_from_base,
        lever_body=np.array(table.lever_body_m, np.float64),
        lever_head=np.array(table.lever_head_m, np.float64),
    )


def _shot(table: PoseTable, readings: GimbalTable, gimbal: Gimbal) -> Shot:
    if gimbal.names and not readings.readings:
        names = ", ".join(f"{name}_deg" for name in gimbal.names)
        raise ValueError(f"[gimbal] of kind {readings.kind!r} needs its readings for the pose: {names} (deg).")
    return Shot(_pose(table), gimbal.readings_from_degrees(**readings.readings), table.time_s)


def _air(table: AirTable, pose: PoseTable | None) -> Atmosphere:
    sea_level = table.sea_level_m
    if sea_level is None:
        if pose is None:
            raise ValueError(
                "[air] sea_level_m is missing: without a [pose] it must say how far mean sea level lies above the "
                "ellipsoid, in m (the undulation of the geoid)."
            )
        lon, lat = lonlat_of_pose(pose)
        sea_level = float(undulation(lat, lon))
    if table.pressure_hpa is None or table.temperature_c is None or table.height_msl_m is None:
        return Atmosphere(sea_level=sea_level)
    return Atmosphere.measured(
        pressure=100.0 * table.pressure_hpa,
        temperature=table.temperature_c + 273.15,
        height=table.height_msl_m + sea_level,
        sea_level=sea_level,
    )


def _pose(table: PoseTable) -> Pose:
    lon, lat = lonlat_of_pose(table)
    try:
        height = ellipsoidal_heights([lon], [lat], [table.height_m], table.height_datum)[0]
    except (OutsideDatum, VerticalDatumError) as error:
        raise ValueError(f"[pose] {error}") from error
    position = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    if table.omega_deg is None or table.map_crs is None:
        heading, pitch, roll = _radians(table.heading_deg, table.pitch_deg, table.roll_deg)
        return Pose(position, heading, pitch, roll)
    angles = _radians(table.omega_deg, table.phi_deg, table.kappa_deg)
    return Pose.from_omega_phi_kappa(position, *angles, convergence=grid_convergence(table.map_crs, lon, lat))


def lonlat_of_pose(table: PoseTable) -> tuple[float, float]:
    """(longitude, latitude) of a pose on WGS 84, deg. Raises `ValueError`."""
    if table.lon_deg is not None and table.lat_deg is not None:
        return table.lon_deg, table.lat_deg
    assert table.map_crs is not None
    x, y = (length / metres_of_map(table.map_crs) for length in (table.easting_m or 0.0, table.northing_m or 0.0))
    lon, lat = (float(one) for one in transformer_of_map(table.map_crs).transform(x, y)[:2])
    if not (math.isfinite(lon) and math.isfinite(lat)):
        place = f"easting_m = {table.easting_m:.10g}, northing_m = {table.northing_m:.10g}"
        raise ValueError(f"[pose] {place} is no place on the map {table.map_crs!r}.")
    return lon, lat


def metres_of_map(map_crs: str) -> float:
    """The unit of a map, in m. Raises `ValueError`."""
    return float(_projected(map_crs).axis_info[0].unit_conversion_factor)


def transformer_of_map(map_crs: str) -> pyproj.Transformer:
    """The transformation from the map of a pose to longitude and latitude on WGS 84. Raises `ValueError`."""
    _projected(map_crs)
    try:
        return operation(map_crs, "EPSG:4326").transformer
    except NoOperation as error:
        raise ValueError(f"[pose] map_crs = {map_crs!r}: {error}. {how_to_get(error.missing)}") from error


def _radians(*angles_deg: float | None) -> list[float]:
    return [math.radians(angle) for angle in angles_deg if angle is not None]


def ellipsoidal_heights(
    lon_deg: _Numbers, lat_deg: _Numbers, height: _Numbers, datum: str | float | None, stated: pyproj.CRS | None = None
) -> np.ndarray:
    """Convert heights in m above a vertical datum to heights in m above the WGS 84 ellipsoid; arrays of one shape.

    `stated` is the vertical CRS that the file of the heights states, if any: the datum must agree with it,
    and if it counts depths, so do the heights. NaN stays NaN.
    Raises `VerticalDatumError` for a datum that is unknown or needs a missing grid, and
    `OutsideDatum`, a `ValueError`, outside the datum's grid.
    """
    lon, lat, height = (np.asarray(x, np.float64) for x in (lon_deg, lat_deg, height))
    known = np.isfinite(lon) & np.isfinite(lat) & np.isfinite(height)
    shift = height_shift(datum, stated) if stated is not None or datum is None else _shift(datum)
    result = np.full(height.shape, np.nan)
    if known.any():
        result[known] = shift.to_ellipsoid(lon[known], lat[known], height[known])
    lost = known & ~np.isfinite(result)
    if lost.any():
        raise OutsideDatum(
            f"height_datum = {datum!r} is not defined at {lat[lost][0]:.6f} deg, {lon[lost][0]:.6f} deg (lat, lon)."
        )
    return result


def _shift(datum: str | float) -> HeightShift:
    """The shift of a datum; cached unless it is a file, since PROJ's search is slower than converting many points."""
    if isinstance(datum, str) and not os.path.exists(datum):
        return _shift_of(datum, threading.get_ident())  # a transformer belongs to its thread
    return height_shift(datum)


@functools.lru_cache(maxsize=8)
def _shift_of(datum: str, thread: int) -> HeightShift:
    return height_shift(datum)


def grid_convergence(map_crs: str, lon_deg: float, lat_deg: float) -> float:
    """Grid convergence: direction of a map's grid north at a position in rad, clockwise from true north."""
    return math.radians(pyproj.Proj(_projected(map_crs)).get_factors(lon_deg, lat_deg).meridian_convergence)


def _projected(map_crs: str) -> pyproj.CRS:
    """The map of a pose. Raises `ValueError`."""
    try:
        crs = known_crs(map_crs)
    except UNKNOWN_CRS as error:
        raise ValueError(
            f"[pose] map_crs = {map_crs!r} is unknown to PROJ; expected for example 'EPSG:32617'."
        ) from error
    if crs.is_compound:
        raise ValueError(
            f"[pose] map_crs = {map_crs!r} has a vertical part, which is for height_datum; give the map alone."
        )
    if not crs.is_projected:
        raise ValueError(f"[pose] map_crs = {map_crs!r} ({crs.name}) is no map; expected a projected CRS.")
    return crs
