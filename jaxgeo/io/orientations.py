"""Orientations of the images of a block: tables of positions and angles, in a map or on the Earth, as poses."""

from __future__ import annotations

import csv
import os
import pathlib
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pyproj

from jaxgeo._checks import check_is, require_x64
from jaxgeo._destination import destination
from jaxgeo.adjust.records import as_names
from jaxgeo.earth import Geodetic
from jaxgeo.io._columns import Columns, read_columns, refuse_doubles
from jaxgeo.io._csv import POSE_COLUMNS, Limits
from jaxgeo.io._map_grid import MapGrid, metric_map
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.io.tables import poses_of
from jaxgeo.io.vertical import height_shift
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.sensor import Pose

# What columns may be called; IGN writes NOM X Y Z O P K CAMERA, OpenDroneMap's tools the words.
ALIASES = {
    "image": ("filename", "nom"),
    "camera": (),
    "time_s": (),
    "x_m": ("x",),
    "y_m": ("y",),
    "z_m": ("z",),
    "omega_deg": ("omega", "o"),
    "phi_deg": ("phi", "p"),
    "kappa_deg": ("kappa", "k"),
    "lat_deg": ("latitude",),
    "lon_deg": ("longitude",),
    "height_m": ("altitude",),
    "heading_deg": ("yaw_deg", "yaw"),
    "pitch_deg": ("pitch",),
    "roll_deg": ("roll",),
}
GON = 0.9  # deg
# The same angles in gon, in place of those in deg: our name in deg, and what the column in gon may be called.
IN_GON = {
    f"{angle}_deg": (f"{angle}_gon", f"{angle}[gon]", f"{angle} [gon]", f"{angle}(gon)", f"{angle} (gon)")
    for angle in ("omega", "phi", "kappa")
}
GRID_COLUMNS: dict[str, Limits] = {
    "x_m": (-1e8, 1e8, "m"),
    "y_m": (-1e8, 1e8, "m"),
    "z_m": POSE_COLUMNS["height_m"],
    "omega_deg": (-360.0, 360.0, "deg"),
    "phi_deg": (-360.0, 360.0, "deg"),
    "kappa_deg": (-360.0, 360.0, "deg"),
}
SIGMA_COLUMNS: dict[str, Limits] = {f"sigma_{axis}_m": (1e-12, 1e6, "m") for axis in ("north", "east", "down")} | {
    f"sigma_{angle}_deg": (1e-12, 360.0, "deg") for angle in ("heading", "pitch", "roll")
}
TIME: Limits = (-1e11, 1e11, "s")
# Decimals that are written: a hundredth of a millimetre for latitudes, 1e-8 deg for angles, a nanosecond.
DECIMALS = {"x_m": 4, "y_m": 4, "z_m": 4, "height_m": 4, "lat_deg": 10, "lon_deg": 10, "time_s": 9}
DECIMALS_OF_ANGLES = 8


@dataclass(frozen=True)
class Orientations:
    """Where the cameras of n images were and how they were turned, by the images' names.

    `pose` holds n entries: geodetic positions of the perspective centres and attitudes of the body, that has the
    camera in `Mount.nadir()` with `Gimbal.fixed()`. `camera` are names of cameras (n,), `sigma` (n, 6) standard
    deviations of north, east and down in m and of heading, pitch and roll in rad, `time` (n,) in s; each None if
    unknown. Raises `ValueError` for fields that do not fit each other and for an image that is there twice.
    """

    names: np.ndarray
    pose: Pose
    camera: np.ndarray | None = None
    sigma: np.ndarray | None = None
    time: np.ndarray | None = None

    def __post_init__(self) -> None:
        check_is(self.pose, Pose, "pose", "One Pose, whose fields hold an entry for each image.")
        names = as_names(self.names, "names")
        unique, counts = np.unique(names, return_counts=True)
        if np.any(counts > 1):
            raise ValueError(f"image {unique[counts > 1][0]} is there {counts.max()} times; names must differ.")
        camera = None if self.camera is None else as_names(self.camera, "camera")
        sigma, time = (None if x is None else np.asarray(x, np.float64) for x in (self.sigma, self.time))
        count = len(names)
        for field, value, shape in (
            ("camera", camera, (count,)),
            ("sigma", sigma, (count, 6)),
            ("time", time, (count,)),
        ):
            if value is not None and value.shape != shape:
                raise ValueError(f"{field} must have the shape {shape} for {count} images; got {value.shape}.")
        shapes = {np.shape(leaf) for leaf in jax.tree.leaves(self.pose)} - {(), (count,)}
        if shapes:
            raise ValueError(f"pose must hold an entry for each of {count} images; got shape {shapes.pop()}.")
        pose = jax.tree.map(lambda x: np.broadcast_to(np.asarray(x, np.float64), (count,)), self.pose)
        for field, value in (("names", names), ("pose", pose), ("camera", camera), ("sigma", sigma), ("time", time)):
            object.__setattr__(self, field, value)

    def __len__(self) -> int:
        return len(self.names)

    def of(self, rows: Any) -> Orientations:
        """Some of the images, by index or flag."""
        optional = (None if x is None else x[rows] for x in (self.camera, self.sigma, self.time))
        return Orientations(self.names[rows], jax.tree.map(lambda x: x[rows], self.pose), *optional)


def read_orientations(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float,
    crs: str | int | pyproj.CRS | None = None,
    linear_alteration_above: float | np.ndarray | None = None,
) -> Orientations:
    """The orientations of a block of images: a row for each, in a CSV file or with white space between columns.

    Without `crs` the columns are `image`, `lat_deg`, `lon_deg`, `height_m`, `heading_deg` (from true north),
    `pitch_deg`, `roll_deg`: the attitude of a body with the camera in `Mount.nadir()`. So does OpenDroneMap's
    `odm_lla_rpy.csv` count them, a gimbal 60 deg below level being a pitch of 30 deg.
    With `crs`, a map such as "EPSG:2154", they are `image`, `x_m`, `y_m`, `z_m`, `omega_deg`, `phi_deg`, `kappa_deg`:
    the photogrammetric angles of `Pose.from_omega_phi_kappa`, R_map_from_image = Rx(omega) Ry(phi) Rz(kappa), in the
    grid of that map at the image. Positions are exact, and the grid's convergence is allowed for at each.
    In both, `camera`, `time_s` and, all six or none, `sigma_north_m`, `sigma_east_m`, `sigma_down_m`,
    `sigma_heading_deg`, `sigma_pitch_deg`, `sigma_roll_deg` are taken where they are there; others are passed over.

    Also read, in any case of letters: `filename` or `nom` for the image; `x`, `y`, `z`, `omega` or `o`, `phi` or `p`,
    `kappa` or `k` (`odm_xyz_opk.csv`, and the OPK files of IGN, whose angles are the same: their world to camera,
    Rx(pi) times the extrinsic x-y-z rotation by (-omega, -phi, -kappa), is the inverse of the above); `latitude`,
    `longitude`, `altitude`, `yaw`, `pitch`, `roll`; angles in gon under `omega_gon`, `phi_gon` and `kappa_gon` (or
    `omega[gon]` and so on), all three or none. Names of images are kept as they are written.

    - `height_datum`: what heights are measured from: "ellipsoid", "EPSG:5773" (EGM96 mean sea level), an undulation in
      m, the path of a geoid grid; as in scene files.
    - `linear_alteration_above`: heights of the ground below in m above the same datum, one or one for each image,
      where camera heights were stretched with the scale k of the map: z = Z + (k - 1) (Z - ground). Z is taken.

    Raises `TableError` with row and column for columns that are missing, cells that are unknown, no number or out of
    range, an image that is there twice, a map that PROJ does not know or that is not in metres;
    `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    in_gon = {gon: tuple(others) for gon, *others in IN_GON.values()}
    columns = read_columns(path, "table of orientations", ALIASES | in_gon | dict.fromkeys(SIGMA_COLUMNS, ()))
    wanted = _wanted(columns, crs)
    names = columns.names("image")
    refuse_doubles(columns.table, names.tolist(), "image {} is there twice")
    numbers = {name: columns.numbers(name, limits) for name, limits in wanted.items()}
    numbers |= {name: GON * numbers[gon] for name, (gon, *_) in IN_GON.items() if gon in numbers}
    sigma = _sigma(columns)
    try:
        if crs is None:
            if linear_alteration_above is not None:
                raise TableError(f"{path}: linear_alteration_above= is of heights in a map; give its crs too.")
            pose = poses_of(numbers, height_datum)
        else:
            pose = _of_grid(columns, numbers, crs, height_datum, linear_alteration_above)
    except VerticalDatumError as error:  # there it is an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error
    camera = columns.names("camera") if "camera" in columns else None
    time = columns.numbers("time_s", TIME) if "time_s" in columns else None
    return Orientations(names, pose, camera, sigma, time)


def write_orientations(
    path: str | os.PathLike[str],
    orientations: Orientations,
    *,
    crs: str | int | pyproj.CRS | None = None,
    height_datum: str | float = "ellipsoid",
) -> None:
    """Orientations as a CSV file that `read_orientations` reads: on the Earth, or with `crs` in that map.

    Heights are written above `height_datum`. Digits end at 1e-4 m and 1e-8 deg; headings are written from 0 to 360.
    The file appears when all is written. Raises `ValueError` for a path that cannot be written to and poses that are
    not finite, `TableError` for a map that does not serve, `VerticalDatumError` for heights.
    """
    check_is(orientations, Orientations, "orientations")
    target, pose = pathlib.Path(path), orientations.pose
    finite = np.all([np.isfinite(leaf) for leaf in jax.tree.leaves(pose)], axis=0)
    if not np.all(finite):
        raise ValueError(f"{target}: the pose of image {orientations.names[np.argmin(finite)]} is not finite.")
    lat, lon, height = (np.asarray(x) for x in pose.position.to_degrees())
    height = height_shift(height_datum).from_ellipsoid(lon, lat, height)
    if crs is None:
        heading, pitch, roll = (np.rad2deg(x) for x in _heading_pitch_roll(pose))
        numbers = dict(zip(POSE_COLUMNS, [lat, lon, height, np.remainder(heading, 360.0), pitch, roll], strict=True))
    else:
        horizontal, _ = metric_map(target, crs)
        grid = MapGrid.about_lonlat(target, horizontal, lon, lat)
        x, y = grid.from_lonlat(lon, lat)
        angles = _to_omega_phi_kappa(pose, grid.convergence(x, y))
        numbers = dict(zip(GRID_COLUMNS, [x, y, height, *(np.rad2deg(angle) for angle in angles)], strict=True))
    lost = ~np.all([np.isfinite(column) for column in numbers.values()], axis=0)
    if np.any(lost):
        raise ValueError(f"{target}: map or vertical datum do not reach image {orientations.names[np.argmax(lost)]}.")
    _write(target, orientations, numbers)


def _write(target: pathlib.Path, orientations: Orientations, numbers: dict[str, np.ndarray]) -> None:
    columns: dict[str, list[str]] = {"image": orientations.names.tolist()}
    times = {} if orientations.time is None else {"time_s": orientations.time}
    for name, values in (numbers | times).items():
        columns[name] = [f"{value:.{DECIMALS.get(name, DECIMALS_OF_ANGLES)}f}" for value in values]
    if orientations.camera is not None:
        columns["camera"] = orientations.camera.tolist()
    if orientations.sigma is not None:
        sigma = np.concatenate([orientations.sigma[:, :3], np.rad2deg(orientations.sigma[:, 3:])], axis=1)
        columns |= {name: [f"{x:.9g}" for x in values] for name, values in zip(SIGMA_COLUMNS, sigma.T, strict=True)}
    with destination("orientations", target) as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def _wanted(columns: Columns, crs: Any) -> dict[str, Limits]:
    """The columns of the kind of table that a caller means."""
    in_map, on_earth = ([name for name in kind if name in columns] for kind in (GRID_COLUMNS, POSE_COLUMNS))
    why = ""
    if crs is None and in_map and not on_earth:
        why = f" {columns.called[in_map[0]]} is of a map: say which with crs=."
    if crs is not None and on_earth and not in_map:
        why = f" {columns.called[on_earth[0]]} is on the Earth: leave crs= out."
    wanted = POSE_COLUMNS if crs is None else _units(columns)
    columns.require(["image", *wanted], ALIASES, why)
    return wanted


def _units(columns: Columns) -> dict[str, Limits]:
    """The columns of a table in a map, its angles in gon where they are called so."""
    in_gon = [others[0] for others in IN_GON.values() if others[0] in columns]
    in_deg = [name for name in IN_GON if name in columns]
    if not in_gon:
        return GRID_COLUMNS
    if in_deg:
        both = f"{columns.called[in_gon[0]]} and {columns.called[in_deg[0]]}"
        raise TableError(f"{columns.table.path}: columns {both} are there; give all three angles in one unit.")
    angles: dict[str, Limits] = {}
    for name, (gon, *_) in IN_GON.items():
        low, high, _ = GRID_COLUMNS[name]
        angles[gon] = low / GON, high / GON, "gon"
    return {name: limits for name, limits in GRID_COLUMNS.items() if name not in IN_GON} | angles


def _sigma(columns: Columns) -> np.ndarray | None:
    there = [name for name in SIGMA_COLUMNS if name in columns]
    if not there:
        return None
    columns.require(SIGMA_COLUMNS, {}, f" With {there[0]}, give the standard deviations of all six, or none.")
    values = [columns.numbers(name, limits) for name, limits in SIGMA_COLUMNS.items()]
    return np.stack([*values[:3], *(np.deg2rad(angle) for angle in values[3:])], axis=-1)


def _of_grid(
    columns: Columns, numbers: dict[str, np.ndarray], crs: Any, height_datum: str | float, ground: Any
) -> Pose:
    """Poses of photogrammetric angles in a map."""
    path = columns.table.path
    horizontal, vertical = metric_map(path, crs)
    if vertical is not None:
        height_shift(height_datum, vertical)  # refuses a datum that is not that of the map
    x, y, z = (numbers[name] for name in ("x_m", "y_m", "z_m"))
    grid = MapGrid.about(path, horizontal, x, y)
    lon, lat = grid.to_lonlat(x, y)
    convergence = grid.convergence(x, y)
    outside = ~np.isfinite(convergence)
    if np.any(outside):
        row = int(np.argmax(outside))
        reason = f"({x[row]:.10g}, {y[row]:.10g}) has no place in {horizontal.name!r}, or its axes are mirrored."
        raise columns.table.wrong(row, columns.called["x_m"], reason)
    if ground is not None:
        scale = grid.scale(lon, lat)
        z = (z + (scale - 1.0) * np.asarray(ground, np.float64)) / scale
    height = ellipsoidal_heights(lon, lat, z, height_datum)
    position = Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height)
    omega, phi, kappa = (np.deg2rad(numbers[name]) for name in ("omega_deg", "phi_deg", "kappa_deg"))
    return jax.tree.map(np.asarray, poses_of_opk(position, omega, phi, kappa, convergence))


@eqx.filter_jit
@jax.vmap
def poses_of_opk(position: Geodetic, omega: Any, phi: Any, kappa: Any, convergence: Any) -> Pose:
    """Poses (n,) of photogrammetric angles in a map, rad, at positions with that convergence of its grid."""
    return Pose.from_omega_phi_kappa(position, omega, phi, kappa, convergence=convergence)


@eqx.filter_jit
@jax.vmap
def _to_omega_phi_kappa(pose: Pose, convergence: Any) -> tuple[Any, Any, Any]:
    return pose.to_omega_phi_kappa(convergence=convergence)


def _heading_pitch_roll(pose: Pose) -> tuple[Any, Any, Any]:
    """The attitude against the ellipsoid's normal."""
    if pose.deflection is None:
        return pose.heading, pose.pitch, pose.roll
    return eqx.filter_jit(jax.vmap(lambda one: heading_pitch_roll_from_R(one.R_ned_from_body)))(pose)
