"""Orthority parameter files: cameras in YAML, orientations in GeoJSON or CSV, as exposures."""

from __future__ import annotations

import dataclasses
import os
import pathlib
from collections import Counter
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import pyproj

from jaxgeo._checks import require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io._crs_reach import check_crs
from jaxgeo.io._csv import POSE_COLUMNS
from jaxgeo.io._dialect import header_of
from jaxgeo.io._json import number_of, read_json, shown, value_of
from jaxgeo.io._map_grid import MapGrid, metric_map, understood_crs
from jaxgeo.io._orientation_columns import KNOWN
from jaxgeo.io._regular import check_regular
from jaxgeo.io._text import read_text
from jaxgeo.io._yaml import read_yaml
from jaxgeo.io.acquisitions.blocks import (
    CHOICES,
    NO_ERRORS,
    NO_TIMES,
    acquisition_of_orientations,
    check_one_size,
    rows_of,
    sensor_of,
    shots_of,
)
from jaxgeo.io.acquisitions.record import Acquisition, UnstatedDatum
from jaxgeo.io.acquisitions.sentences import heights_are
from jaxgeo.io.errors import A_WRONG_GUESS, TableError, VerticalDatumError
from jaxgeo.io.given_camera import AS_READ
from jaxgeo.io.orientations import poses_of_opk
from jaxgeo.io.vertical import height_shift, is_unnamed
from jaxgeo.sensor import BrownConrady, FrameCamera, Pose

# Coefficients of each supported camera type; those of `UNREAD` must be zero.
TYPES = {
    "pinhole": (),
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
UNREAD = ("s1", "s2", "s3", "s4", "tx", "ty")  # opencv thin prism and tilted sensor
FORM = "parameter file of Orthority"
LARGEST_ANGLE = 2.0 * np.pi


def read_orthority(
    interior: str | os.PathLike[str],
    exterior: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the images of an Orthority exterior parameter file, with the cameras of its interior parameter file.

    `interior` is YAML (`*_int_param.yaml`; needs PyYAML): cameras of type pinhole, brown or opencv by name.
    `exterior` is GeoJSON (`*_ext_param.geojson`: positions and angles in rad in the map `world_crs`) or CSV with
    `filename` and either `x`, `y`, `z`, `omega`, `phi`, `kappa` in a map, given by a .prj file of the same name or by
    `crs`, or `latitude`, `longitude`, `altitude`, `roll`, `pitch`, `yaw`; in degrees.

    Orthority treats the map as a plane at ground scale. Here positions are exact and the grid convergence is applied
    at each image, so the ground follows the curved Earth, below that plane by r^2 / 2R at distance r, at true scale.

    - `height_datum`: datum of the heights, as in scene files; optional if the map's CRS states it.
    - `crs`: the map's CRS, if the file does not name it.
    - `camera`: selects the images of that camera; images of one record have one size.

    Raises `UnstatedDatum`, `TableError` with file and key for a camera of another type or a missing one, values
    that are missing or out of range, cameras of several sizes, a map that contradicts `crs`; `VerticalDatumError`;
    `FileNotFoundError`; `ImportError` without PyYAML; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    cameras = read_orthority_cameras(interior)
    path = pathlib.Path(exterior)
    if path.suffix.lower() in (".geojson", ".json"):
        return _of_geojson(path, cameras, height_datum, crs, camera)
    return _of_csv(path, cameras, height_datum, crs, camera)


def read_orthority_cameras(path: str | os.PathLike[str]) -> dict[str, FrameCamera]:
    """Read the cameras of an Orthority interior parameter file, by name; raises as `read_orthority`."""
    require_x64()
    content = read_yaml(path, "interior parameter file", extra="orthority")
    if not isinstance(content, dict) or not content:
        raise TableError(f"{path}: expected cameras by name; got {shown(content)}.")
    if "type" in content and not isinstance(content["type"], dict):  # one camera at the top level
        content = {str(content.get("name", "unknown")): content}
    return {str(name): _camera(f"{path}, {name}", table) for name, table in content.items()}


def _camera(where: str, table: Any) -> FrameCamera:
    kind = str(value_of(where, table, "type")).lower()
    if kind not in TYPES:
        raise TableError(f"{where}: type {kind!r} is not read; only {', '.join(TYPES)} are.")
    known = {"type", "name", "im_size", "focal_len", "sensor_size", "cx", "cy", *TYPES[kind]}
    known |= set(UNREAD) if kind == "opencv" else set()
    strange = [str(key) for key in table if key not in known]
    if strange:
        raise TableError(f"{where}: {strange[0]} is not a parameter of type {kind}.")
    turned = [name for name in UNREAD if number_of(where, table, name, 0.0) != 0.0]
    if turned:
        raise TableError(f"{where}: {turned[0]} is not zero; a lens with thin prism or tilt is not read.")
    size = np.array(_pair(where, table, "im_size"))
    if np.any(size != np.round(size)):
        raise TableError(f"{where}: im_size must be whole numbers of pixels; got {size.tolist()}.")
    focal = np.array(_pair(where, table, "focal_len", one_too=True))
    if "sensor_size" in table:
        focal_px = focal * size / _pair(where, table, "sensor_size")
    elif size[1] > size[0]:
        raise TableError(
            f"{where}: focal_len without sensor_size is a share of the sensor's width to the program Orthority and of "
            f"its longer side to Orthority's manual; of an upright image, write sensor_size too."
        )
    else:
        focal_px = focal * size[0]
    offset = np.array([number_of(where, table, key, 0.0) for key in ("cx", "cy")])
    width, height = (int(side) for side in size)
    lens = BrownConrady(**{key: number_of(where, table, key, 0.0) for key in TYPES[kind]}) if TYPES[kind] else None
    return FrameCamera.from_pixels(
        focal_px=focal_px,
        width=width,
        height=height,
        principal_px=(size - 1.0) / 2.0 + size.max() * offset,
        distortion=lens,
    )


def _pair(where: str, table: Mapping[str, Any], key: str, *, one_too: bool = False) -> list[float]:
    """Two positive numbers (along columns, along rows) under a key; one applies to both, if `one_too`."""
    value = value_of(where, table, key)
    pair = [value, value] if one_too and not isinstance(value, list) else value
    if not isinstance(pair, list) or len(pair) != 2:
        raise TableError(f"{where}: {key} must be two numbers; got {shown(value)}.")
    numbers = [number_of(where, {key: one}, key) for one in pair]
    if min(numbers) <= 0.0:
        raise TableError(f"{where}: {key} must be above zero; got {shown(value)}.")
    return numbers


def _of_geojson(
    path: pathlib.Path,
    cameras: Mapping[str, FrameCamera],
    height_datum: str | float | None,
    crs: Any,
    camera: str | None,
) -> Acquisition:
    content = read_json(path, "exterior parameter file")
    stated = value_of(f"{path}", content, "world_crs")
    check_crs(f"{path}", stated, TableError)
    if crs is not None and not _same(f"{path}", crs, stated):
        raise TableError(f"{path}: the file's world_crs is {shown(stated)}, but crs={crs!r}; leave crs= out.")
    features = value_of(f"{path}", content, "features")
    if not isinstance(features, list) or not features:
        raise TableError(f"{path}: features must be a list of images; got {shown(features)}.")
    tags = [value_of(f"{path}, features[{k}]", feature, "properties") for k, feature in enumerate(features)]
    names = [str(value_of(f"{path}, features[{k}]", one, "filename")) for k, one in enumerate(tags)]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise TableError(f"{path}: image {twice[0]} is there twice.")
    taken_by = _taken_by(path, cameras, names, [one.get("camera") for one in tags])
    rows = rows_of(path, taken_by, camera)
    check_one_size(path, cameras, taken_by[rows])
    names, tags = [names[row] for row in rows], tuple(tags[row] for row in rows)
    xyz, opk = (_vectors(path, names, tags, key) for key in ("xyz", "opk"))
    poses = _poses_in_map(path, names, xyz, opk, stated, height_datum)
    return Acquisition(
        path=os.fspath(path),
        form=FORM,
        names=np.array(names),
        sensor=sensor_of(cameras, taken_by[rows]),
        shots=shots_of(poses),
        assumed=(heights_are(height_datum), NO_ERRORS, AS_READ, NO_TIMES),
        facts={"images": f"{len(names)}", "map": understood_crs(path, stated)[0].name},
        tags=tags,
    )


def _of_csv(
    path: pathlib.Path,
    cameras: Mapping[str, FrameCamera],
    height_datum: str | float | None,
    crs: Any,
    camera: str | None,
) -> Acquisition:
    """Read a CSV file: an orientation table with Orthority's column names."""
    named = path.with_suffix(".prj")
    words = _words(path)
    mixed = {"x", "roll"} <= words or {"latitude", "omega"} <= words
    if mixed and not {"x", "omega"} <= words:
        raise TableError(f"{path}: x with roll, or latitude with omega, are not read; write positions and angles both "
                         f"in the map, or both on the Earth.")  # fmt: skip
    if crs is None and {"x", "omega"} <= words:
        if not named.exists():
            raise TableError(f"{path}: which map x and y are in is not in the file, nor in {named.name} beside it; "
                             f"pass crs=.")  # fmt: skip
        check_regular(named, TableError)
        crs = named.read_text(encoding="utf-8-sig", errors="replace").strip()
        check_crs(f"{named}", crs, TableError)
    only = next(iter(cameras.values())) if len(cameras) == 1 and "camera" not in words else cameras
    table = acquisition_of_orientations(path, cameras=only, height_datum=height_datum, crs=crs, camera=camera)
    return dataclasses.replace(table, form=FORM)


def _words(path: pathlib.Path) -> set[str]:
    """The column names in lower case; none if the file cannot be read, which its reader then reports."""
    try:
        text = read_text(path, "exterior parameter file")
    except (OSError, ValueError):
        return set()
    return {word.strip(" '\"").lower() for word in header_of(text, KNOWN)}


def _taken_by(path: Any, cameras: Mapping[str, FrameCamera], names: list[str], given: list[Any]) -> np.ndarray:
    """The camera name of each image; the only camera if the file names none."""
    missing = [name for name, camera in zip(names, given, strict=True) if camera is None]
    if missing and len(cameras) > 1:
        raise TableError(f"{path}: image {missing[0]} has no camera, and there are {', '.join(cameras)}; name one.")
    return np.array([next(iter(cameras)) if camera is None else str(camera) for camera in given], dtype=str)


def _vectors(path: Any, names: list[str], tags: tuple[Mapping[str, Any], ...], key: str) -> np.ndarray:
    """Three finite numbers under a key for each image, (n, 3)."""
    found = np.empty((len(names), 3))
    for row, (name, one) in enumerate(zip(names, tags, strict=True)):
        value = value_of(f"{path}, {name}", one, key)
        if not isinstance(value, list) or len(value) != 3:
            raise TableError(f"{path}, {name}: {key} must be three numbers; got {shown(value)}.")
        found[row] = [number_of(f"{path}, {name}", {key: number}, key) for number in value]
    return found


def _poses_in_map(
    path: Any, names: list[str], xyz: np.ndarray, opk: np.ndarray, crs: Any, height_datum: str | float | None
) -> Pose:
    """Poses from omega, phi, kappa in a map."""
    horizontal, vertical = metric_map(path, crs)
    if height_datum is None and (vertical is None or is_unnamed(vertical)):
        raise UnstatedDatum(
            f"{path}: the CRS {horizontal.name!r} has no vertical part, so the vertical datum of its heights is not "
            f"stated; {A_WRONG_GUESS}. {CHOICES}"
        )
    large = np.any(np.abs(opk) > LARGEST_ANGLE, axis=1)
    if np.any(large):
        row = int(np.argmax(large))
        raise TableError(
            f"{path}, {names[row]}: opk is {shown(opk[row].tolist())}, beyond a turn; GeoJSON of Orthority is in rad."
        )
    x, y, z = xyz.T
    grid = MapGrid.about(path, horizontal, x, y)
    lon, lat = grid.to_lonlat(x, y)
    convergence = grid.convergence(x, y)
    try:
        shift = height_shift(height_datum, vertical)
        height = np.asarray(shift.to_ellipsoid(lon, lat, z))
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    low, high, _ = POSE_COLUMNS["height_m"]
    lost = ~(np.isfinite(convergence) & np.isfinite(height) & (height >= low) & (height <= high))
    if np.any(lost):
        row = int(np.argmax(lost))
        raise TableError(
            f"{path}, {names[row]}: xyz {shown(xyz[row].tolist())} has no place in {horizontal.name!r}, or no height."
        )
    position = Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height)
    omega, phi, kappa = opk.T
    return jax.tree.map(np.asarray, poses_of_opk(position, omega, phi, kappa, convergence))


def _same(path: Any, one: Any, other: Any) -> bool:
    first, second = (understood_crs(path, crs)[0] for crs in (one, other))
    return first.equals(second, ignore_axis_order=True)
