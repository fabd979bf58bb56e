"""Cameras with rotation matrices in a named frame (ECEF, east-north-up, a map) as poses on the Earth."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pyproj

from jaxgeo._text_numbers import numbers_in
from jaxgeo.earth import Geodetic
from jaxgeo.io._csv import POSE_COLUMNS
from jaxgeo.io._map_grid import MapGrid, metric_map
from jaxgeo.io._proj import UNKNOWN_CRS, known_crs
from jaxgeo.io.acquisitions._attitudes import attitudes_of
from jaxgeo.io.acquisitions.blocks import CHOICES
from jaxgeo.io.acquisitions.record import UnstatedDatum
from jaxgeo.io.acquisitions.sentences import heights_are
from jaxgeo.io.errors import A_WRONG_GUESS, OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.orientations import has_vertical
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.sensor import Pose
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_NADIR

ENU = re.compile(r"\s*enu\s*:(.*)", re.IGNORECASE)
FRAMES = (
    'crs="EPSG:4978" (geocentric), crs="enu:LAT,LON,HEIGHT" (east, north and up about that point, in deg and m) or '
    'crs="EPSG:32616" (a map in metres)'
)
RADII = (6.3e6, 1e8)  # m from the centre of the Earth: plausible camera range
LARGEST_BLOCK = 1e6  # m from the origin of a local frame to a camera


def poses_in_frame(
    path: Any, crs: Any, height_datum: Any, centres: np.ndarray, R_world_from_camera: np.ndarray
) -> tuple[Pose, tuple[str, ...]]:
    """(poses of n bodies that carry the cameras in `Mount.nadir()`, assumptions) from `centres` (n, 3) in m and
    rotations (n, 3, 3) of (right, down, forward) to the frame `crs`, which is one of `FRAMES`.

    Heights of all frames are above `height_datum`: in ECEF and ENU the datum of the altitudes that the block was
    aligned with. Raises `UnstatedDatum`, `TableError`, `VerticalDatumError`.
    """
    try:
        local = ENU.fullmatch(crs) if isinstance(crs, str) else None
        if local is not None:
            return _of_enu(path, _origin(path, crs, local[1]), height_datum, centres, R_world_from_camera)
        if _is_geocentric(path, crs):
            return _of_ecef(path, height_datum, centres, R_world_from_camera)
        return _of_map(path, crs, height_datum, centres, R_world_from_camera)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error


def pose_of_ecef(centres: np.ndarray, R_ecef_from_camera: np.ndarray) -> Pose:
    """Poses of bodies that carry cameras at ECEF positions in `Mount.nadir()`."""
    lon, lat, height = pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(*centres.T)
    lat, lon = np.deg2rad(lat), np.deg2rad(lon)
    return pose_of_ned(Geodetic(lat=lat, lon=lon, height=height), R_ned_from_ecef(lat, lon) @ R_ecef_from_camera)


def pose_of_ned(position: Geodetic, R_ned_from_camera: np.ndarray) -> Pose:
    """Poses of bodies that carry cameras with rotations (n, 3, 3) to local north-east-down in `Mount.nadir()`."""
    return Pose(position, *attitudes_of(R_ned_from_camera @ np.asarray(R_HEAD_FROM_CAMERA_NADIR).T))


def R_ned_from_ecef(lat: Any, lon: Any) -> np.ndarray:
    """Rotation (..., 3, 3) from ECEF to north-east-down at latitudes and longitudes in rad."""
    sin, cos = np.sin, np.cos
    north = np.stack([-sin(lat) * cos(lon), -sin(lat) * sin(lon), cos(lat)], axis=-1)
    east = np.stack([-sin(lon), cos(lon), np.zeros_like(lon)], axis=-1)
    down = np.stack([-cos(lat) * cos(lon), -cos(lat) * sin(lon), -sin(lat)], axis=-1)
    return np.stack([north, east, down], axis=-2)


def check_on_earth(path: Any, centres: np.ndarray, remedy: str) -> None:
    """Raises `TableError`, ending in `remedy`, if ECEF positions are not near the Earth."""
    radius = np.linalg.norm(centres, axis=1)
    if np.any((radius < RADII[0]) | (radius > RADII[1])):
        raise TableError(f"{path}: its cameras have no place on the Earth (the first is {radius[0]:.6g} m from its "
                         f"centre); {remedy}.")  # fmt: skip
    _check_heights(path, np.asarray(pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(*centres.T)[2]))


def _check_heights(path: Any, height: np.ndarray) -> None:
    """Raises `TableError` for heights above the ellipsoid that no camera has."""
    low, high, _ = POSE_COLUMNS["height_m"]
    wrong = ~((height >= low) & (height <= high))
    if np.any(wrong):
        raise TableError(
            f"{path}: a camera is {height[np.argmax(wrong)]:.6g} m above the ellipsoid, outside [{low:g}, {high:g}] m."
        )


def _is_geocentric(path: Any, crs: Any) -> bool:
    """Whether a CRS is ECEF of WGS 84. Raises `TableError` for one that is unknown, or geocentric of another datum."""
    try:
        known = known_crs(crs)
    except UNKNOWN_CRS as error:
        raise TableError(f"{path}: crs = {crs!r} is unknown to PROJ; give {FRAMES}.") from error
    if known.is_geocentric and not known.equals(pyproj.CRS(4978), ignore_axis_order=True):
        raise TableError(f"{path}: crs = {crs!r} ({known.name}) is not geocentric of WGS 84; give {FRAMES}.")
    return known.is_geocentric


def _origin(path: Any, crs: str, text: str) -> np.ndarray:
    """Latitude and longitude in deg and height in m of the origin in `crs`."""
    numbers = numbers_in(text.split(","))
    if numbers is None or len(numbers) != 3 or abs(numbers[0]) > 90.0 or abs(numbers[1]) > 360.0:
        raise TableError(f"{path}: crs = {crs!r} is not enu:LAT,LON,HEIGHT, deg and m, such as enu:36.3,-84.2,310.5.")
    return np.array(numbers)


def _refuse_unstated(path: Any, what: str) -> None:
    raise UnstatedDatum(
        f"{path}: {what}, but the file does not state the vertical datum of the altitudes that it was aligned with; "
        f"{A_WRONG_GUESS}. {CHOICES}"
    )


def _of_ecef(path: Any, datum: Any, centres: np.ndarray, R: np.ndarray) -> tuple[Pose, tuple[str, ...]]:
    check_on_earth(path, centres, f"its frame is none of ECEF: give {FRAMES}")
    if datum is None:
        _refuse_unstated(path, "its cameras are geocentric")
    pose = pose_of_ecef(centres, R)
    return _raised(pose, datum), (_frame("geocentric (ECEF, WGS 84)"), heights_are(datum))


def _of_enu(
    path: Any, origin: np.ndarray, datum: Any, centres: np.ndarray, R: np.ndarray
) -> tuple[Pose, tuple[str, ...]]:
    far = float(np.max(np.linalg.norm(centres, axis=1)))
    if far > LARGEST_BLOCK:
        raise TableError(f'{path}: a camera is {far / 1e3:.0f} km from the origin of crs="enu:..."; if the frame is '
                         f'geocentric, give crs="EPSG:4978".')  # fmt: skip
    if datum is None:
        _refuse_unstated(path, f"its origin is at a height of {origin[2]:g} m")
    lat, lon = np.deg2rad(origin[0]), np.deg2rad(origin[1])
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    at = np.array(to_ecef.transform(origin[1], origin[0], origin[2]))
    R_ecef_from_enu = R_ned_from_ecef(lat, lon).T @ np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    centres, R = at + centres @ R_ecef_from_enu.T, R_ecef_from_enu @ R
    check_on_earth(path, centres, f"give {FRAMES}")
    where = f"east, north and up about {origin[0]:.7f}, {origin[1]:.7f} deg (lat, lon) and {origin[2]:g} m"
    return _raised(pose_of_ecef(centres, R), datum), (_frame(where), heights_are(datum))


def _of_map(path: Any, crs: Any, datum: Any, centres: np.ndarray, R: np.ndarray) -> tuple[Pose, tuple[str, ...]]:
    horizontal, vertical = metric_map(path, crs)
    x, y, z = centres.T
    if np.all(np.abs(x) < LARGEST_BLOCK / 10.0) and np.all(np.abs(y) < LARGEST_BLOCK / 10.0):
        raise TableError(
            f"{path}: its cameras are at ({x[0]:.6g}, {y[0]:.6g}), which looks like a local frame and not like "
            f"{horizontal.name!r}; give {FRAMES}."
        )
    if datum is None and not has_vertical(path, crs):
        _refuse_unstated(path, f"its cameras are in {horizontal.name!r}")
    grid = MapGrid.about(path, horizontal, x, y)
    (lon, lat), turn = grid.to_lonlat(x, y), grid.convergence(x, y)
    if not np.all(np.isfinite(turn)):
        row = int(np.argmin(np.isfinite(turn)))
        raise TableError(f"{path}: ({x[row]:.10g}, {y[row]:.10g}) has no place in {horizontal.name!r}.")
    height = ellipsoidal_heights(lon, lat, z, datum, vertical)
    _check_heights(path, height)
    sin, cos, zero, one = np.sin(turn), np.cos(turn), np.zeros_like(turn), np.ones_like(turn)
    rows = [[-sin, cos, zero], [cos, sin, zero], [zero, zero, -one]]  # Rz(turn) of (northing, easting, down)
    R_ned_from_map = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    pose = pose_of_ned(Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height), R_ned_from_map @ R)
    return pose, (_frame(f"the map {horizontal.name!r}"), heights_are(datum))


def _raised(pose: Pose, datum: Any) -> Pose:
    """Poses whose altitudes above `datum` were taken for ellipsoidal heights."""
    at = pose.position
    height = ellipsoidal_heights(np.rad2deg(at.lon), np.rad2deg(at.lat), at.height, datum)  # type: ignore[arg-type]
    return Pose(Geodetic(lat=at.lat, lon=at.lon, height=height), pose.heading, pose.pitch, pose.roll)


def _frame(what: str) -> str:
    return f"The frame is {what}, with its scale in metres, as given."
