"""Exterior orientation tables of an image block: positions and angles, in a map or geographic, as poses."""

from __future__ import annotations

import os
import pathlib
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pyproj

from jaxgeo._checks import check_is, require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io._angle_doubts import angle_doubts
from jaxgeo.io._columns import Columns, refuse_doubles, refuse_nowhere
from jaxgeo.io._csv import Limits
from jaxgeo.io._map_grid import MapGrid, metric_map, understood_crs
from jaxgeo.io._orientation_columns import (
    ALIASES,
    EARTH_COLUMNS,
    MAP_COLUMNS,
    SIGMA_COLUMNS,
    TIME,
    angle_columns,
    datum_of,
    in_degrees,
    read_orientation_columns,
    stated_crs,
)
from jaxgeo.io._prj import name_of, prj_beside, read_prj
from jaxgeo.io._unread_columns import unread_columns
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.io.vertical import is_unnamed
from jaxgeo.sensor import Pose


@dataclass(frozen=True)
class Orientations:
    """Exterior orientations of n images, by image name.

    `pose` holds n entries: geodetic positions of the perspective centres and attitudes of the body that carries the
    camera in `Mount.nadir()` with `Gimbal.fixed()`. `camera` are names of cameras (n,), `sigma` (n, 6) standard
    deviations of north, east and down in m and of heading, pitch and roll in rad, `time` (n,) in s; each None if
    unknown. `assumed` are sentences on the reader's assumptions; `of_camera`: the angles are the camera's
    own, not an aircraft's. Raises `ValueError` for inconsistent fields and for a repeated image.
    """

    names: np.ndarray
    pose: Pose
    camera: np.ndarray | None = None
    sigma: np.ndarray | None = None
    time: np.ndarray | None = None
    assumed: tuple[str, ...] = ()
    of_camera: bool = False

    def __post_init__(self) -> None:
        check_is(self.pose, Pose, "pose", "One Pose, whose fields hold an entry for each image.")
        from jaxgeo.adjust.records import as_names  # heavy, and rarely needed

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
        """A subset of the images, by index or mask."""
        camera, sigma, time = (None if x is None else x[rows] for x in (self.camera, self.sigma, self.time))
        pose = jax.tree.map(lambda x: x[rows], self.pose)
        return Orientations(self.names[rows], pose, camera, sigma, time, self.assumed, self.of_camera)


OF_PROGRAMS = {*(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)), "f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2"}

OF_GROUPS = ("shot", "flight")  # read by `jaxgeo.io.shot_groups`


def read_orientations(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
    linear_alteration_above: float | np.ndarray | None = None,
) -> Orientations:
    """Read the orientations of an image block: one row per image, in a table of any layout that `read_csv` detects.

    Without `crs` the columns are `image`, `lat_deg`, `lon_deg`, `height_m`, `heading_deg` (from true north),
    `pitch_deg`, `roll_deg`: the attitude of a body with the camera in `Mount.nadir()`. OpenDroneMap's
    `odm_lla_rpy.csv` uses the same, so a gimbal 60 deg below level has a pitch of 30 deg.
    With `crs`, a map such as "EPSG:2154", they are `image`, `x_m`, `y_m`, `z_m`, `omega_deg`, `phi_deg`, `kappa_deg`
    (a `.prj` file beside such a table is used if `crs` is not given):
    the photogrammetric angles of `Pose.from_omega_phi_kappa`, R_map_from_image = Rx(omega) Ry(phi) Rz(kappa), in the
    grid of that map at the image. Positions are exact, and the grid convergence is applied at each image. Headings in
    a map are from grid north: R_map_from_image = Rz(-heading) Rx(pitch) Ry(roll). In a `crs` of longitudes (x)
    and latitudes (y) in deg, and in geographic tables, omega, phi and kappa refer to east, north and up at the image.
    The optional columns `camera`, `time_s`, `height_datum` and, all six or none, `sigma_north_m`, `sigma_east_m`,
    `sigma_down_m`, `sigma_heading_deg`, `sigma_pitch_deg`, `sigma_roll_deg` are used if present; others are ignored.

    Accepted aliases, in any case: `filename` or `nom` for the image; `x`, `y`, `z`, `omega` or `o`, `phi` or `p`,
    `kappa` or `k` (`odm_xyz_opk.csv`, and the OPK files of IGN, whose angles are the same: their world to camera,
    Rx(pi) times the extrinsic x-y-z rotation by (-omega, -phi, -kappa), is the inverse of the above); `latitude`,
    `longitude`, `altitude`, `yaw`, `pitch`, `roll`; angles in gon under `omega_gon`, `phi_gon` and `kappa_gon` (or
    `omega[gon]` and so on), in rad under `omega_rad`, and heading, pitch and roll likewise, all three or none. Image
    names are kept as written.
    Exports of other programs are read directly: Pix4D's external camera parameters, Metashape's cameras ("Omega Phi
    Kappa") and reference (with the CRS in its comment), RealityCapture's internal and external parameters, MicMac's
    `#F=N X Y Z W P K`, in deg as OriConvert takes them. Orientations of the aerial triangulation programs PAT-B
    (`.ori`: image, X, Y, Z and rotation matrix, as in PCI Geomatics, "Using Pat-B in OrthoEngine") and BINGO (records
    `ORIA` of `itera.dat`: image, X, Y, Z, phi, omega, kappa in gon) are such tables in a map.

    - `height_datum`: datum of the heights: "ellipsoid", "EPSG:5773" (EGM96 mean sea level), an undulation in
      m, the path of a geoid grid; as in scene files. None if the CRS has a vertical part, or the table a column
      `height_datum`, in which each row states one of the first three.
    - `linear_alteration_above`: ground heights below in m above the same datum, one or one per image,
      if camera heights were stretched by the scale k of the map: z = Z + (k - 1) (Z - ground). Z is used.

    Raises `TableError` with row and column for columns that are missing, cells that are unknown, not numbers or out of
    range, a position of latitude and longitude zero, a repeated image, a map that is unknown to PROJ, not in metres or
    not that of the file; `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit
    floats off.
    """
    require_x64()
    columns = read_orientation_columns(path)
    by_prj = of_prj(columns, crs)
    crs, height_datum = crs_of(columns, crs), datum_of(columns, height_datum)
    wanted = check_columns(columns, crs)
    names = columns.names("image")
    refuse_doubles(columns.table, names.tolist(), "image {} is there twice")
    numbers = {name: columns.numbers(name, limits) for name, limits in wanted.items()}
    doubts = angle_doubts(columns, numbers)
    numbers = in_degrees(numbers)
    sigma = _sigma(columns)
    if crs is None and linear_alteration_above is not None:
        raise TableError(f"{path}: linear_alteration_above= is of heights in a map; give its crs too.")
    try:
        pose, notes = _poses(columns, numbers, crs, height_datum, linear_alteration_above)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error
    camera = columns.names("camera") if "camera" in columns else None
    time = columns.numbers("time_s", TIME) if "time_s" in columns else None
    of_camera = "omega_deg" in numbers or (crs is not None and "x_m" in numbers)
    return Orientations(names, pose, camera, sigma, time, (*by_prj, *notes, *_of_program(columns), *doubts), of_camera)


def crs_of(columns: Columns, crs: Any) -> Any:
    """The CRS of a table: the caller's, else the file's, else that of the `.prj` file of a table in a map.

    Raises `TableError` if the first two differ, and as `read_prj`.
    """
    own = stated_crs(columns)
    if own is None and crs is None:
        beside = _prj_of(columns)
        return None if beside is None else read_prj(beside)
    if own is None or crs is None:
        return crs if own is None else own
    (given, _), (stated, _) = understood_crs(columns.table.path, crs), understood_crs(columns.table.path, own)
    if not given.equals(stated, ignore_axis_order=True):
        raise TableError(f"{columns.table.path}: the file says that it is in {own.name!r}, but crs={crs!r}; leave crs= "
                         f"out.")  # fmt: skip
    return crs


def of_prj(columns: Columns, crs: Any) -> list[str]:
    """The assumption on the CRS of a table where `crs_of` takes it from its `.prj` file; `crs` is the caller's."""
    beside = None if crs is not None or stated_crs(columns) is not None else _prj_of(columns)
    return (
        [] if beside is None else [f"Coordinates are in {name_of(read_prj(beside))}, by {beside.name} beside the file."]
    )


def _prj_of(columns: Columns) -> pathlib.Path | None:
    """The `.prj` file of a table that is in a map."""
    return prj_beside(columns.table.path) if "x_m" in columns and "lat_deg" not in columns else None


def has_vertical(path: Any, crs: Any) -> bool:
    """Whether a CRS states the vertical datum."""
    vertical = None if crs is None else understood_crs(path, crs)[1]
    return vertical is not None and not is_unnamed(vertical)


def _is_geographic(path: Any, crs: Any) -> bool:
    return crs is not None and understood_crs(path, crs)[0].is_geographic


def check_columns(columns: Columns, crs: Any) -> dict[str, Limits]:
    """The required columns of the caller's kind of table; raises `TableError` if some are missing."""
    path = columns.table.path
    in_map, on_earth = ("x_m" in columns or "y_m" in columns), ("lat_deg" in columns or "lon_deg" in columns)
    is_geographic = _is_geographic(path, crs)
    why = ""
    if crs is None and in_map and not on_earth:
        raise TableError(which_map(columns))
    if crs is not None and on_earth and not in_map and not is_geographic:
        why = f" {columns.called.get('lat_deg', columns.called.get('lon_deg'))} is on the Earth: leave crs= out."
    if crs is None or (is_geographic and not in_map):
        wanted = EARTH_COLUMNS | angle_columns(columns, first="hpr")
    else:
        wanted = MAP_COLUMNS | angle_columns(columns, first="opk")
    columns.require(["image", *wanted], ALIASES, why)
    return wanted


def which_map(columns: Columns) -> str:
    """Message that the CRS of a table is unstated, with an example that fits its numbers."""
    called = [columns.called[key] for key in ("x_m", "y_m") if key in columns]
    cells = [columns.table.numbers(one, (-1e12, 1e12, "m"), unknown_too=True) for one in called]
    reason = f"{columns.table.path}: {called[0]} is {{}}, and the file states no CRS: pass "
    if len(cells) == 2 and _in_degrees(*cells):
        return f'{reason.format("in deg")}crs="EPSG:4326".'
    beside = pathlib.Path(columns.table.path).with_suffix(".prj").name
    map_crs = 'such as crs="EPSG:32616" for UTM zone 16 north'
    return f"{reason.format('projected')}that of its map, {map_crs}, or put its {beside} beside it."


def _in_degrees(x: np.ndarray, y: np.ndarray) -> bool:
    """Whether coordinates look like longitudes and latitudes in deg."""
    return bool(np.all(np.abs(x) <= 360.0) and np.all(np.abs(y) <= 90.0))


def _sigma(columns: Columns) -> np.ndarray | None:
    there = [name for name in SIGMA_COLUMNS if name in columns]
    if not there:
        return None
    columns.require(SIGMA_COLUMNS, {}, f" With {there[0]}, give the standard deviations of all six, or none.")
    values = [columns.numbers(name, limits) for name, limits in SIGMA_COLUMNS.items()]
    return np.stack([*values[:3], *(np.deg2rad(angle) for angle in values[3:])], axis=-1)


def _poses(
    columns: Columns, numbers: dict[str, np.ndarray], crs: Any, height_datum: str | float | None, ground: Any
) -> tuple[Pose, list[str]]:
    """(poses, assumptions about their angles)."""
    position, convergence = positions_of(columns, numbers, crs, height_datum, ground)
    is_map = crs is not None and not _is_geographic(columns.table.path, crs)
    if "omega_deg" in numbers:
        omega, phi, kappa = (np.deg2rad(numbers[name]) for name in ("omega_deg", "phi_deg", "kappa_deg"))
        notes = [] if is_map else ["Omega, phi and kappa are taken against east, north and up at each image."]
        return jax.tree.map(np.asarray, poses_of_opk(position, omega, phi, kappa, convergence)), notes
    heading, pitch, roll = (np.deg2rad(numbers[name]) for name in ("heading_deg", "pitch_deg", "roll_deg"))
    if not is_map:
        return Pose(position, heading, pitch, roll), []
    low, high = np.rad2deg(np.min(convergence)), np.rad2deg(np.max(convergence))
    span = f"{low:.2f}" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} to {high:.2f}"
    notes = [f"Headings are taken from the map's grid north, {span} deg clockwise of true north here."]
    return Pose(position, heading + convergence, pitch, roll), notes


def positions_of(
    columns: Columns, numbers: dict[str, np.ndarray], crs: Any, height_datum: str | float | None, ground: Any = None
) -> tuple[Geodetic, np.ndarray]:
    """(positions of the rows, grid convergence there in rad: zero if not in a map)."""
    path = columns.table.path
    if "lat_deg" in numbers:
        refuse_nowhere(columns.table, columns.called["lat_deg"], numbers["lat_deg"], numbers["lon_deg"])
    if crs is None:
        lat, lon = numbers["lat_deg"], numbers["lon_deg"]
        height = ellipsoidal_heights(lon, lat, numbers["height_m"], height_datum)  # type: ignore[arg-type]
        return Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height), np.zeros(len(lat))
    horizontal, vertical = understood_crs(path, crs)
    if not horizontal.is_geographic:
        metric_map(path, crs)  # raises for other units
    in_map = "x_m" in numbers
    x, y, z = (numbers[name] for name in (("x_m", "y_m", "z_m") if in_map else ("lon_deg", "lat_deg", "height_m")))
    if horizontal.is_geographic:
        _check_degrees(columns, horizontal, x, y)
    elif _in_degrees(x, y):
        raise columns.table.wrong(
            0,
            columns.called["x_m"],
            f"({x[0]:.10g}, {y[0]:.10g}) look like longitude and latitude in deg, but crs is {horizontal.name!r}; if "
            f'they are, give crs="EPSG:4326".',
        )
    grid = MapGrid.about(path, horizontal, x, y)
    lon, lat = grid.to_lonlat(x, y)
    convergence = np.where(np.isfinite(lat), 0.0, np.nan) if horizontal.is_geographic else grid.convergence(x, y)
    outside = ~np.isfinite(convergence)
    if np.any(outside):
        row = int(np.argmax(outside))
        reason = f"({x[row]:.10g}, {y[row]:.10g}) has no place in {horizontal.name!r}, or its axes are mirrored."
        raise columns.table.wrong(row, columns.called["x_m" if in_map else "lon_deg"], reason)
    if ground is not None:
        scale = grid.scale(lon, lat)
        z = (z + (scale - 1.0) * np.asarray(ground, np.float64)) / scale
    height = ellipsoidal_heights(lon, lat, z, height_datum, vertical)
    return Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height), convergence


def _check_degrees(columns: Columns, crs: pyproj.CRS, lon: np.ndarray, lat: np.ndarray) -> None:
    """Raises `TableError` for values that are not degrees, and for a position at zero."""
    name = columns.called.get("y_m", columns.called.get("lat_deg", ""))
    beyond = (np.abs(lat) > 90.0) | (np.abs(lon) > 360.0)
    if np.any(beyond):
        row = int(np.argmax(beyond))
        reason = f"({lon[row]:.10g}, {lat[row]:.10g}) are no longitude and latitude in deg, but crs is {crs.name!r}."
        if np.all(np.abs(lon) <= 90.0):
            reason += " They would be with the two exchanged: give the longitude before the latitude."
        raise columns.table.wrong(row, name, reason)
    refuse_nowhere(columns.table, name, lat, lon)


@eqx.filter_jit
@jax.vmap
def poses_of_opk(position: Geodetic, omega: Any, phi: Any, kappa: Any, convergence: Any) -> Pose:
    """Poses (n,) from omega, phi, kappa in a map, rad, at positions with that grid convergence."""
    return Pose.from_omega_phi_kappa(position, omega, phi, kappa, convergence=convergence)


def unread_of(columns: Columns) -> list[str]:
    """[a sentence on the columns of a table of orientations or positions that are not read], or []."""
    of_programs = {name for name in columns.table.header if name.lower() in OF_PROGRAMS}
    of_groups = {name for name in columns.table.header if name.strip().lower() in OF_GROUPS}
    known = {*ALIASES, *SIGMA_COLUMNS} - set(columns.called)
    return unread_columns(columns.table.header, known, read={*columns.called.values(), *of_programs, *of_groups})


def _of_program(columns: Columns) -> list[str]:
    """Assumptions about a program's columns."""
    header = [name.lower() for name in columns.table.header]
    notes = [*columns.notes, *unread_of(columns)]
    if "f=n" in header:
        notes.append(
            "W, P and K are taken as omega, phi and kappa in deg, as MicMac's OriConvert does; where they are pitch, "
            "roll and yaw, name the columns so."
        )
    if {"r11", "r33"} <= set(header):
        notes.append("The rotation matrices beside the angles are not read.")
    if {"f", "px", "py"} <= set(header):
        notes.append("Focal lengths and distortion in the file are not read: it does not say how large the images are.")
    return notes
