"""OpenSfM and OpenDroneMap reconstructions: cameras, shots and points of a `reconstruction.json`."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyproj

from jaxgeo._checks import require_x64
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu, R_ecef_from_ned
from jaxgeo.io._csv import POSE_COLUMNS
from jaxgeo.io._json import number_of, read_json, shown, size_of, table_of, value_of, vectors_of
from jaxgeo.io._map_grid import MapGrid, metric_map
from jaxgeo.io.errors import A_WRONG_GUESS, OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.rotations import R_from_rotation_vector, heading_pitch_roll_from_R
from jaxgeo.sensor import BrownConrady, Fisheye, FrameCamera, Pose
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_NADIR, R_ned_from_map

TOPOCENTRIC = "topocentric"
WHOLE_METRES = 1e-4  # m
LARGEST_TURN, LARGEST_DISTANCE = 1e3, 1e9  # limits of rotation vectors in rad and of coordinates in m

# OpenSfM's keys of the focal lengths, the principal point and the coefficients of each projection.
PROJECTIONS = {
    "perspective": (("focal", "focal"), (), ("k1", "k2")),
    "simple_radial": (("focal_x", "focal_y"), ("c_x", "c_y"), ("k1",)),
    "radial": (("focal_x", "focal_y"), ("c_x", "c_y"), ("k1", "k2")),
    "brown": (("focal_x", "focal_y"), ("c_x", "c_y"), ("k1", "k2", "k3", "p1", "p2")),
    "fisheye": (("focal", "focal"), (), ("k1", "k2")),
    "fisheye_opencv": (("focal_x", "focal_y"), ("c_x", "c_y"), ("k1", "k2", "k3", "k4")),
}
FISHEYES = ("fisheye", "fisheye_opencv")
# Its others: more terms, or more than half a sphere.
UNREAD = ("fisheye62", "fisheye624", "dual", "spherical", "equirectangular")
WAY_OUT = "undistort the images (opensfm undistort), and read the reconstruction that this writes"


@dataclass(frozen=True)
class Reconstruction:
    """Cameras by name, n shots and m points, in m east-north-up about a reference, or without one in a local frame.

    `names` of images and `camera`, the camera of each, are (n,); `centres` (n, 3) perspective centres and
    `R_enu_from_camera` (n, 3, 3); `point_names` (m,) and `points` (m, 3). `reference` is a single position or None.
    """

    cameras: dict[str, FrameCamera]
    names: np.ndarray
    camera: np.ndarray
    centres: np.ndarray
    R_enu_from_camera: np.ndarray
    point_names: np.ndarray
    points: np.ndarray
    reference: Geodetic | None

    def __len__(self) -> int:
        return len(self.names)

    def poses(self) -> Pose:
        """The poses of n shots on the Earth: of bodies that carry the camera in `Mount.nadir()`, `Gimbal.fixed()`.

        Raises `ValueError` without a reference.
        """
        return jax.tree.map(np.asarray, _poses(self._placed(), self.centres, self.R_enu_from_camera))

    def positions(self) -> Geodetic:
        """The m points on the Earth. Raises `ValueError` without a reference."""
        return jax.tree.map(np.asarray, _on_earth(self._placed(), self.points))

    def _placed(self) -> Geodetic:
        if self.reference is None:
            raise ValueError("the reconstruction has no reference_lla: its frame has no place on the Earth.")
        return self.reference


def read_opensfm(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
    part: int | None = None,
) -> Reconstruction:
    """Read the reconstruction in a `reconstruction.json` of OpenSfM or OpenDroneMap.

    Shots are rotation vectors and translations from the world to the camera (right, down, forward). With a
    `reference_lla` in the file, the world is east-north-up about it: exact, by ECEF. OpenDroneMap converts its
    reconstruction.json to a UTM grid, minus the reference's coordinates there (the original is in
    reconstruction.topocentric.json beside it): heights are then altitudes, and north is grid north. Camera sizes are
    from the file; images may be larger.

    - `height_datum`: datum of the altitudes: "ellipsoid", "EPSG:5773" (EGM96 mean sea level), an undulation
      in m; as in scene files. Required for a file with a reference: it depends on the positions of its images.
    - `crs`: the CRS of the world, such as "EPSG:32651", or "topocentric". Required if the reference has
      whole metres in UTM, as OpenDroneMap chooses it; else topocentric by default.
    - `part`: which of several reconstructions in the file, from 0; required if there are more than one.

    Projections: perspective, simple_radial, radial, brown, with the distortion as `BrownConrady` by the same formula,
    and fisheye, fisheye_opencv as `Fisheye`, of which rays within 90 deg of the axis are read.
    Raises `TableError`, the key named, for values that are missing, not numbers or repeated, another projection of a
    camera with shots (dual, spherical and others), a shot of an unknown camera, a file that is truncated or
    not JSON; `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    content = _part(path, read_json(path, "reconstruction"), part)
    where = f"{path}" if part is None else f"{path}, [{part}]"
    written = table_of(where, content, "cameras")
    shots, points = table_of(where, content, "shots"), content.get("points", {})
    if not isinstance(points, dict):
        raise TableError(f"{where}, points: expected points by name; got {shown(points)}.")
    if not shots:
        raise TableError(f"{where}, shots: there are none.")
    for name, shot in shots.items():
        camera = value_of(f"{where}, shots, {name}", shot, "camera")
        if not isinstance(camera, str) or camera not in written:
            raise TableError(f"{where}, shots, {name}: camera {shown(camera)} is not among the file's cameras.")
    used = {shot["camera"] for shot in shots.values()}
    cameras = _cameras(
        f"{where}, cameras", {name: one for name, one in written.items() if name in used or not _is_unread(one)}
    )
    limits = {"rotation": LARGEST_TURN, "translation": LARGEST_DISTANCE}
    vectors = [vectors_of(f"{where}, shots", shots, key, largest) for key, largest in limits.items()]
    centres, R_world_from_camera = (np.asarray(x) for x in _from_world(*vectors))
    xyz = vectors_of(f"{where}, points", points, "coordinates", LARGEST_DISTANCE)
    reference, world = None, (centres, R_world_from_camera, xyz)
    if content.get("reference_lla") is not None:
        reference, world = _placed(where, content["reference_lla"], world, height_datum, crs)
    elif crs is not None:
        raise TableError(f"{where}: there is no reference_lla, so its frame is its own; leave crs= out.")
    camera = np.array([shot["camera"] for shot in shots.values()], dtype=str)
    names, point_names = (np.array(list(table), dtype=str) for table in (shots, points))
    return Reconstruction(cameras, names, camera, world[0], world[1], point_names, world[2], reference)


def read_opensfm_cameras(path: str | os.PathLike[str]) -> dict[str, FrameCamera]:
    """Read the cameras of OpenSfM or OpenDroneMap by name: of a `cameras.json`, or of a `reconstruction.json`.

    Cameras that are not read (spherical and others) are left out if there are more. Raises as `read_opensfm`, and
    `TableError` for cameras of several reconstructions of the same name that differ.
    """
    require_x64()
    content = read_json(path, "camera")
    parts = content if isinstance(content, list) else [content]
    cameras: dict[str, Any] = {}
    for part in parts or [parts]:
        table = part.get("cameras", part) if isinstance(part, dict) else part
        if not isinstance(table, dict) or not table:
            raise TableError(f"{path}: expected cameras by name; got {shown(table)}.")
        for name, camera in table.items():
            if not isinstance(camera, dict):
                raise TableError(f"{path}, {name}: expected a camera, with its projection_type; got {shown(camera)}.")
            if cameras.setdefault(name, camera) != camera:
                raise TableError(f"{path}: its reconstructions differ in camera {name!r}; make a file of each.")
    read = {name: camera for name, camera in cameras.items() if not _is_unread(camera)}
    return _cameras(f"{path}", read or cameras)


def _part(path: str | os.PathLike[str], content: Any, part: int | None) -> dict[str, Any]:
    """One of the reconstructions in a file."""
    parts = content if isinstance(content, list) else [content]
    if not parts or not all(isinstance(one, dict) for one in parts):
        raise TableError(f"{path}: expected a list of reconstructions; got {shown(content)}.")
    if part is None and len(parts) > 1:
        sizes = ", ".join(str(len(table_of(f"{path}, [{k}]", one, "shots"))) for k, one in enumerate(parts))
        raise TableError(f"{path}: {len(parts)} reconstructions, of {sizes} shots; choose one with part=, from 0.")
    if not 0 <= (part or 0) < len(parts):
        raise TableError(f"{path}: part={part}, but there are {len(parts)} reconstructions, from 0.")
    return parts[part or 0]


def _cameras(where: str, table: Mapping[str, Any]) -> dict[str, FrameCamera]:
    return {name: _camera(f"{where}, {name}", camera) for name, camera in table.items()}


def _is_unread(camera: Any) -> bool:
    return isinstance(camera, dict) and camera.get("projection_type") in UNREAD


def _camera(where: str, camera: Any) -> FrameCamera:
    """A camera in pixels: OpenSfM normalises by the longer side of the image, about the image centre."""
    kind = camera.get("projection_type", "perspective") if isinstance(camera, dict) else camera
    if not isinstance(kind, str) or kind not in PROJECTIONS:
        remedy = f": {WAY_OUT}." if kind in UNREAD else f"; only {', '.join(PROJECTIONS)} are."
        raise TableError(f"{where}: projection_type {shown(kind)} is not read{remedy}")
    focal_keys, offset_keys, coefficients = PROJECTIONS[kind]
    width, height = (size_of(where, camera, key) for key in ("width", "height"))
    longer, centre = max(width, height), np.array([width - 1, height - 1]) / 2.0
    focal = np.array([number_of(where, camera, key) for key in focal_keys])
    offset = np.array([number_of(where, camera, key, 0.0) for key in offset_keys] or [0.0, 0.0])
    lens = Fisheye if kind in FISHEYES else BrownConrady
    distortion = lens(**{key: number_of(where, camera, key, 0.0) for key in coefficients})
    if np.any(focal <= 0.0):
        raise TableError(f"{where}: focal lengths must be positive; got {focal.tolist()}.")
    principal_px = centre + longer * offset
    return FrameCamera.from_pixels(
        focal_px=longer * focal, width=width, height=height, principal_px=principal_px, distortion=distortion
    )


def _placed(
    where: str, lla: Any, world: tuple[np.ndarray, ...], height_datum: str | float | None, crs: Any
) -> tuple[Geodetic, tuple[np.ndarray, ...]]:
    """(the reference, centres, rotations and points in east-north-up about it)."""
    where = f"{where}, reference_lla"
    lat, lon, altitude = (number_of(where, lla, key) for key in ("latitude", "longitude", "altitude"))
    if not (abs(lat) <= 90.0 and abs(lon) <= 360.0):
        raise TableError(f"{where}: latitude {lat:g}, longitude {lon:g} deg are not on the Earth.")
    if lat == 0.0 and lon == 0.0:
        raise TableError(
            f"{where}: latitude and longitude are zero, which is written where no image has a position. Reconstruct "
            f"with positions, or take reference_lla out to read it in a frame of its own."
        )
    low, high, _ = POSE_COLUMNS["height_m"]
    if not low <= altitude <= high:
        raise TableError(f"{where}: altitude {altitude:g} m is outside [{low:g}, {high:g}] m.")
    if height_datum is None:
        raise TableError(
            f"{where}: the vertical datum of altitudes is not stated; {A_WRONG_GUESS}. Pass "
            f'height_datum=...: "ellipsoid", "EPSG:5773" (EGM96 mean sea level), an undulation in m.'
        )
    if crs is None:
        _refuse_whole_metres(where, lat, lon)
    height = _heights(where, np.array([lon]), np.array([lat]), np.array([altitude]), height_datum)[0]
    reference = Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=np.float64(height))
    if crs is None or (isinstance(crs, str) and crs.lower() == TOPOCENTRIC):
        return reference, world
    horizontal, vertical = metric_map(where, crs)
    grid = MapGrid.about_lonlat(where, horizontal, np.array([lon]), np.array([lat]))
    origin = np.array([*(u[0] for u in grid.from_lonlat(np.array([lon]), np.array([lat]))), 0.0])
    centres, R_map_from_camera, points = world
    x, y, z = (centres + origin).T
    position = _of_map(where, grid, x, y, z, height_datum, vertical)
    enu, R_enu_from_camera = _turned(reference, position, grid.convergence(x, y), R_map_from_camera)
    x, y, z = (points + origin).T
    on_earth = _of_map(where, grid, x, y, z, height_datum, vertical)
    arrays = enu, R_enu_from_camera, _from_earth(reference, on_earth)
    return reference, tuple(np.asarray(array) for array in arrays)


def _refuse_whole_metres(where: str, lat: float, lon: float) -> None:
    """Raises `TableError` for a reference as OpenDroneMap writes it, whose world may be a grid or topocentric."""
    if abs(lat) > 84.0:
        return
    middle = math.floor((lon + 180.0) / 6.0)
    for zone in {(middle + step) % 60 + 1 for step in (-1, 0, 1)}:
        code = (32600 if lat >= 0.0 else 32700) + zone
        x, y = pyproj.Transformer.from_crs("EPSG:4326", code, always_xy=True).transform(lon, lat)
        if max(abs(x - round(x)), abs(y - round(y))) < WHOLE_METRES:
            raise TableError(
                f"{where}: it lies at whole metres of EPSG:{code}, {x:.0f} E {y:.0f} N, as OpenDroneMap chooses it. "
                f"Its reconstruction.json is in that grid: pass crs='EPSG:{code}'; its reconstruction.topocentric.json "
                f"is not: pass crs='{TOPOCENTRIC}'."
            )


def _of_map(
    where: str,
    grid: MapGrid,
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    height_datum: str | float,
    vertical: pyproj.CRS | None,
) -> Geodetic:
    lon, lat = grid.to_lonlat(x, y)
    if not np.all(np.isfinite(lon) & np.isfinite(lat)):
        raise TableError(f"{where}: the map of crs= does not reach every shot and point.")
    return Geodetic(
        lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=_heights(where, lon, lat, z, height_datum, vertical)
    )


def _heights(
    where: str,
    lon: np.ndarray,
    lat: np.ndarray,
    z: np.ndarray,
    datum: str | float,
    vertical: pyproj.CRS | None = None,
) -> np.ndarray:
    try:
        return ellipsoidal_heights(lon, lat, z, datum, vertical)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{where}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{where}: {error}") from error


@eqx.filter_jit
@jax.vmap
def _from_world(rotation: Any, translation: Any) -> tuple[Any, Any]:
    """(perspective centre, R_world_from_camera) of a shot."""
    R_world_from_camera = R_from_rotation_vector(rotation).T
    return -R_world_from_camera @ translation, R_world_from_camera


@eqx.filter_jit
def _on_earth(reference: Geodetic, enu: Any) -> Geodetic:
    R, origin = R_ecef_from_enu(reference), WGS84.to_ecef(reference)
    return jax.vmap(lambda p: WGS84.to_geodetic(origin + R @ p))(enu)


@eqx.filter_jit
def _from_earth(reference: Geodetic, position: Geodetic) -> Any:
    R, origin = R_ecef_from_enu(reference), WGS84.to_ecef(reference)
    return jax.vmap(lambda one: R.T @ (WGS84.to_ecef(one) - origin))(position)


@eqx.filter_jit
def _turned(reference: Geodetic, position: Geodetic, convergence: Any, R_map_from_camera: Any) -> tuple[Any, Any]:
    """(centres, R_enu_from_camera) about the reference, of cameras with attitudes in a map grid at their positions."""

    def turned(position: Geodetic, convergence: Any, R_map_from_camera: Any) -> Any:
        R_ecef_from_camera = R_ecef_from_ned(position) @ R_ned_from_map(convergence) @ R_map_from_camera
        return R_ecef_from_enu(reference).T @ R_ecef_from_camera

    return _from_earth(reference, position), jax.vmap(turned)(position, convergence, R_map_from_camera)


@eqx.filter_jit
def _poses(reference: Geodetic, centres: Any, R_enu_from_camera: Any) -> Pose:
    def pose(position: Geodetic, R_enu_from_camera: Any) -> Pose:
        R_ned_from_camera = R_ecef_from_ned(position).T @ R_ecef_from_enu(reference) @ R_enu_from_camera
        return Pose(position, *heading_pitch_roll_from_R(R_ned_from_camera @ jnp.asarray(R_HEAD_FROM_CAMERA_NADIR).T))

    return jax.vmap(pose)(_on_earth(reference, centres), R_enu_from_camera)
