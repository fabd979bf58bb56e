"""Image blocks as exposures: OpenSfM and OpenDroneMap reconstructions, and orientation tables."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any, TypeAlias

import jax
import numpy as np
import pyproj

from jaxgeo._checks import check_is
from jaxgeo.io._json import read_json, shown
from jaxgeo.io._map_grid import understood_crs
from jaxgeo.io._orientation_columns import datum_of, read_orientation_columns
from jaxgeo.io.acquisitions.record import Acquisition, UnstatedDatum, for_each
from jaxgeo.io.acquisitions.sentences import heights_are
from jaxgeo.io.errors import A_WRONG_GUESS, TableError
from jaxgeo.io.given_camera import AS_GIVEN, AS_READ
from jaxgeo.io.opensfm import Reconstruction, read_opensfm
from jaxgeo.io.orientations import Orientations, check_columns, crs_of, has_vertical, read_orientations
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.distortion import NoDistortion
from jaxgeo.uncertainty.sources import AbstractSource, Attitude, Position

Cameras: TypeAlias = Mapping[str, FrameCamera]

CHOICES = (
    'Pass height_datum="ellipsoid" (WGS 84), height_datum="EPSG:5773" (EGM96 mean sea level), an undulation in m, or '
    "the path of a geoid grid."
)
NO_ERRORS = "No accuracies in the file."
NO_TIMES = "When images were taken is not in the file; their time is 0."
CAPTURE_TIME = "Times are the file's capture_time, in s since 1970 by the camera's clock, of an unknown time zone."
ELLIPSOID = "Attitude is relative to the ellipsoid normal (deflection of the vertical ignored)."


def acquisition_of_opensfm(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
    part: int | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the shots of an OpenSfM or OpenDroneMap `reconstruction.json`, each with its camera, by image name.

    `height_datum`, `crs` and `part` as in `read_opensfm`. Images of one record have one size: `camera`, a name in the
    file, selects the images of one camera. Times are the `capture_time` of the images, if all have one, else 0; other
    fields of a shot are in `tags`. Raises `UnstatedDatum` without `height_datum`, `TableError` for cameras of several
    sizes (named), a camera without images, and a reconstruction without georeference; else as
    `read_opensfm`.
    """
    if height_datum is None:
        _refuse_unstated(path, part)
    block = read_opensfm(path, height_datum=height_datum, crs=crs, part=part)
    if block.reference is None:
        raise TableError(f"{path}: there is no reference_lla, so the reconstruction has no place on the Earth.")
    rows = rows_of(path, block.camera, camera)
    check_one_size(path, block.cameras, block.camera[rows])
    content = read_json(path, "reconstruction")
    written = (content[part or 0] if isinstance(content, list) else content)["shots"]
    names = block.names[rows]
    tags = tuple({key: value for key, value in written[name].items() if key not in _READ} for name in names)
    times = np.array([_time(one) for one in tags])
    timed = not np.any(np.isnan(times))
    return Acquisition(
        path=os.fspath(path),
        form="reconstruction of OpenSfM",
        names=names,
        sensor=sensor_of(block.cameras, block.camera[rows]),
        shots=shots_of(_some(block.poses(), rows), times if timed else None),
        assumed=(
            heights_are(height_datum),
            CAPTURE_TIME if timed else NO_TIMES,
            NO_ERRORS,
            AS_READ,
            "Camera size is from the file; images may be larger.",
        ),
        facts=_facts(block, rows),
        tags=tags,
    )


def acquisition_of_orientations(
    path: str | os.PathLike[str],
    *,
    cameras: FrameCamera | Cameras | None = None,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
    camera: str | None = None,
    linear_alteration_above: float | np.ndarray | None = None,
) -> Acquisition:
    """Read the images of an orientation table, with the errors that it states.

    - `cameras`: one camera for all images, or cameras by the names in the table's column `camera`; without it the
      exposures have no sensor. A camera is mounted by `Mount.nadir()`, with `Gimbal.fixed()`.
    - `camera`: selects the images of that camera; images of one record have one size.
    - `height_datum`, `crs` and `linear_alteration_above` as in `read_orientations`.

    Raises `UnstatedDatum` without `height_datum`, `TableError` for cameras of several sizes (named), a camera that is
    not given or has no images; else as `read_orientations`.
    """
    if cameras is not None and not isinstance(cameras, Mapping):
        check_is(cameras, FrameCamera, "cameras", "Or give a table of cameras by name.")
    columns = read_orientation_columns(path)
    of_map, height_datum = crs_of(columns, crs), datum_of(columns, height_datum)
    if height_datum is None and not has_vertical(path, of_map):
        check_columns(columns, of_map)
        raise UnstatedDatum(
            f"{os.fspath(path)}: a table of orientations does not state the vertical datum of its heights; "
            f"{A_WRONG_GUESS}. {CHOICES}"
        )
    table = read_orientations(path, height_datum=height_datum, crs=crs, linear_alteration_above=linear_alteration_above)
    if table.camera is not None:
        table = table.of(rows_of(path, table.camera, camera))
    elif camera is not None:
        raise TableError(f"{path}: camera={camera!r} is asked for, but there is no column camera.")
    stated = "by the table" if "height_datum" in columns else "as given"
    assumed = [heights_are(height_datum, stated), *table.assumed]
    assumed += [NO_ERRORS] if table.sigma is None else [_INDEPENDENT]
    assumed += [] if cameras is None else [AS_GIVEN]
    assumed += [ELLIPSOID] if of_map is None else []
    assumed += [NO_TIMES] if table.time is None else []
    if isinstance(cameras, FrameCamera) and table.camera is not None and len(np.unique(table.camera)) > 1:
        some = ", ".join(np.unique(table.camera))
        raise TableError(f"{path}: cameras is one, but images are of {some}; give cameras by name, or choose camera=.")
    return Acquisition(
        path=os.fspath(path),
        form="table of orientations",
        names=table.names,
        sensor=_sensor(path, cameras, table),
        shots=shots_of(table.pose, table.time),
        sources=stated_sources(table.sigma),
        assumed=tuple(assumed),
        of_camera=table.of_camera,
        facts={"images": f"{len(table)}"} | ({} if of_map is None else {"map": understood_crs(path, of_map)[0].name}),
    )


_INDEPENDENT = "Errors of one image are independent of another's: the file states none of their correlations."
_READ = ("rotation", "translation", "camera")


def rows_of(path: Any, taken_by: np.ndarray, camera: str | None) -> np.ndarray:
    """Row indices of a camera's images; all if no name is given. Raises `TableError` for a camera without images."""
    if camera is None:
        return np.arange(len(taken_by))
    rows = np.flatnonzero(taken_by == camera)
    if not len(rows):
        raise TableError(f"{path}: no image is of camera={camera!r}; they are of {', '.join(np.unique(taken_by))}.")
    return rows


def check_one_size(path: Any, cameras: Cameras, taken_by: np.ndarray) -> None:
    """Raises `TableError` for images of cameras of several sizes, of fisheyes and others, or of an unknown camera."""
    used = [str(name) for name in np.unique(taken_by)]
    unknown = [name for name in used if name not in cameras]
    if unknown:
        raise TableError(f"{path}: images are of camera {unknown[0]!r}, but known are {', '.join(cameras) or 'none'}.")
    sizes = {name: (cameras[name].width, cameras[name].height) for name in used}
    if len(set(sizes.values())) > 1:
        each = ", ".join(f"{name!r} {width} x {height}" for name, (width, height) in sizes.items())
        raise TableError(f"{path}: images are of cameras of several sizes: {each}; choose one with camera=.")
    kinds = {name: type(cameras[name].distortion).__name__ for name in used}
    if "Fisheye" in kinds.values() and len(set(kinds.values())) > 1:
        each = ", ".join(f"{name!r} {'a fisheye' if kind == 'Fisheye' else 'none'}" for name, kind in kinds.items())
        raise TableError(f"{path}: some images are of fisheyes and some are not: {each}; choose one with camera=.")


def sensor_of(cameras: Cameras, taken_by: np.ndarray) -> Sensor:
    """The sensor of each of n images: cameras of one size by name, in `Mount.nadir()` with `Gimbal.fixed()`."""
    used, which = np.unique(taken_by, return_inverse=True)
    one_kind = _of_one_kind([cameras[str(name)] for name in used])
    camera = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves])[which], *one_kind)
    return Sensor(camera, *for_each((Gimbal.fixed(), Mount.nadir()), len(taken_by)))


def shots_of(poses: Pose, times: np.ndarray | None = None) -> Shot:
    """Shots of n poses, without gimbal readings; unknown times are 0."""
    count = np.size(poses.heading)
    return Shot(poses, np.zeros((count, 0)), np.zeros(count) if times is None else times)


def stated_sources(sigma: np.ndarray | None) -> tuple[AbstractSource, ...]:
    """Error sources of n images from standard deviations (n, 6): north, east, down, m; heading, pitch, roll, rad."""
    if sigma is None:
        return ()
    made = jax.vmap(Position)(sigma[:, :3]), jax.vmap(Attitude)(sigma[:, 3:])
    return jax.tree.map(np.asarray, made)


def _of_one_kind(cameras: list[FrameCamera]) -> list[FrameCamera]:
    """Cameras with one lens type: beside others, a perfect lens becomes a BrownConrady of zeros."""
    if len({type(camera.distortion) for camera in cameras}) == 1:
        return cameras
    zeros = BrownConrady()
    return [
        FrameCamera(one.focal_px, one.principal_px, zeros, one.width, one.height)
        if isinstance(one.distortion, NoDistortion)
        else one
        for one in cameras
    ]


def _sensor(path: Any, cameras: FrameCamera | Cameras | None, table: Orientations) -> Sensor | None:
    if cameras is None:
        return None
    if isinstance(cameras, FrameCamera):
        return for_each(Sensor(cameras, Gimbal.fixed(), Mount.nadir()), len(table))
    if table.camera is None:
        raise TableError(f"{path}: cameras are given by name, but there is no column camera; give one camera.")
    check_one_size(path, cameras, table.camera)
    return sensor_of(cameras, table.camera)


def _some(tree: Any, rows: np.ndarray) -> Any:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[rows], tree)


def _time(shot: Mapping[str, Any]) -> float:
    """Time of a shot, s; NaN if missing."""
    time: Any = shot.get("capture_time")
    known = isinstance(time, int | float) and not isinstance(time, bool) and math.isfinite(time) and time > 0.0
    return float(time) if known else math.nan


def _facts(block: Reconstruction, rows: np.ndarray) -> dict[str, str]:
    return {
        "images": f"{len(rows)} of {len(block)}",
        "cameras": ", ".join(np.unique(block.camera[rows])),
        "points": f"{len(block.points)}",
    }


def _refuse_unstated(path: str | os.PathLike[str], part: int | None) -> None:
    """Raises `UnstatedDatum`, quoting the file's altitudes, if it is georeferenced."""
    content = read_json(path, "reconstruction")
    parts = content if isinstance(content, list) else [content]
    if part is not None and 0 <= part < len(parts):
        parts = [parts[part]]
    for one in parts:
        lla = one.get("reference_lla") if isinstance(one, dict) else None
        if lla is not None:
            altitude = lla.get("altitude") if isinstance(lla, dict) else lla
            raise UnstatedDatum(
                f"{os.fspath(path)}: reference_lla has altitude {shown(altitude)}, but its vertical datum, that of "
                f"the images' altitudes, is not stated; {A_WRONG_GUESS}. {CHOICES}"
            )
