"""Comparison of an answer with a second reading, and the numbers and texts of a file read strictly."""

from __future__ import annotations

import functools
import json
import re
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyproj

from jaxgeo.io.dem import DATA

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
METRES, DEGREES = 1e-6, 1e-9


def number(word: str) -> float:
    """A decimal number as every program reads it. Raises `ValueError`: `1_0`, Arabic digits and `nan` are none."""
    if not NUMBER.fullmatch(word):
        raise ValueError(f"{word[:40]!r} is not a number")
    return float(word)


def decoded(content: bytes) -> str:
    """A text file by its mark, else UTF-16 where every other byte is zero, else UTF-8, else Windows' code page."""
    for mark, encoding in ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if content.startswith(mark):
            return content.decode(encoding)
    for encoding, start in (("utf-16-le", 1), ("utf-16-be", 0)):
        zeros = content[:256][start::2]
        if len(zeros) > 1 and zeros.count(0) > 0.7 * len(zeros):
            return content.decode(encoding)
    try:
        return content.decode()
    except UnicodeDecodeError:
        return content.decode("cp1252")


def of_json(content: bytes) -> Any:
    """JSON of a text file; a whole number of more digits than a double can hold is infinite, as Python refuses it."""
    return json.loads(decoded(content), parse_int=lambda word: int(word) if len(word) < 400 else float(word))


def same(what: str, ours: Any, theirs: Any, atol: float = 0.0, rtol: float = 1e-12) -> None:
    """Raises `AssertionError` where numbers differ by more than `atol` and `rtol` of themselves, or are not as many."""
    ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    assert ours.shape == theirs.shape, f"{what}: shape {ours.shape}, by the second reading {theirs.shape}"
    off = ~(np.abs(ours - theirs) <= atol + rtol * np.abs(theirs)) & ~(np.isnan(ours) & np.isnan(theirs))
    assert not off.any(), f"{what}: {ours[off][:3]}, by the second reading {theirs[off][:3]}"


def same_names(what: str, ours: Sequence[Any], theirs: Sequence[Any]) -> None:
    found, stated = [str(one) for one in ours], [str(one) for one in theirs]
    assert found == stated, f"{what}: {found[:5]}, by the second reading {stated[:5]}"


def same_turn(what: str, ours: Any, theirs: Any, atol: float = DEGREES) -> None:
    """As `same` of angles in deg, whole turns apart."""
    ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    assert ours.shape == theirs.shape, f"{what}: shape {ours.shape}, by the second reading {theirs.shape}"
    off = (ours - theirs + 180.0) % 360.0 - 180.0
    assert np.all(np.abs(off) <= atol + 1e-12 * np.abs(theirs)), f"{what}: {ours}, by the second reading {theirs}"


def same_places(position: Any, lat: Any, lon: Any, height: Any) -> None:
    """Positions in rad against latitudes and longitudes in deg, heights in m above the ellipsoid."""
    same("latitude", np.rad2deg(position.lat), lat, DEGREES)
    same_turn("longitude", np.rad2deg(position.lon), lon)
    same("height", position.height, height, METRES)


@functools.cache
def _egm96() -> tuple[np.ndarray, Any]:
    import rasterio

    with rasterio.open(DATA / "us_nga_egm96_15.tif") as data:
        return data.read(1), data.transform


def egm96(lat: Any, lon: Any) -> np.ndarray:
    """Undulation of EGM96 in m: the grid of 15', bilinear."""
    grid, transform = _egm96()
    return bilinear(grid, transform, np.asarray(lat), np.asarray(lon))


def bilinear(grid: np.ndarray, transform: Any, lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    """A geographic grid of pixels' centres between its posts; columns may go all round the Earth."""
    turn = round(360.0 / transform.a)
    col = (lon - transform.c) / transform.a - 0.5
    row = (lat - transform.f) / transform.e - 0.5
    col = col % turn if grid.shape[1] >= turn else col
    r = np.clip(np.floor(row).astype(int), 0, grid.shape[0] - 2)
    c = np.floor(col).astype(int)
    c = c if grid.shape[1] >= turn else np.clip(c, 0, grid.shape[1] - 2)
    right = (c + 1) % grid.shape[1] if grid.shape[1] >= turn else c + 1
    y, x = row - r, col - c
    top = grid[r, c] * (1.0 - x) + grid[r, right] * x
    return top * (1.0 - y) + (grid[r + 1, c] * (1.0 - x) + grid[r + 1, right] * x) * y


def in_map(crs: str | int, x: Any, y: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(latitude, longitude, azimuth of grid north) in deg of places in a map, by PROJ: the last by a step of 1 m."""
    to_earth = pyproj.Transformer.from_crs(crs, "EPSG:4979", always_xy=True)
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    (lon, lat), (lon1, lat1) = to_earth.transform(x, y), to_earth.transform(x, y + 1.0)
    azimuth = pyproj.Geod(ellps="WGS84").inv(lon, lat, lon1, lat1)[0]
    return np.asarray(lat), np.asarray(lon), np.asarray(azimuth)


def turn(axis: str, angle: Any) -> np.ndarray:
    """Rotations by angles in rad about x, y or z."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler(axis, np.reshape(angle, (-1, 1))).as_matrix()


R_BODY_FROM_CAMERA = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # one that looks down
R_NED_FROM_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def same_attitude(pose: Any, R_ned_from_camera: np.ndarray, atol: float = 1e-7) -> None:
    """Poses of bodies whose cameras look down against rotations of (right, down, forward).

    Near the vertical of an axis an arc sine has half the digits.
    """
    R = turn("z", pose.heading) @ turn("y", pose.pitch) @ turn("x", pose.roll) @ R_BODY_FROM_CAMERA
    off = np.abs(R - R_ned_from_camera).max()
    assert off <= atol, f"attitude: off by {off:.2e} rad from the second reading"


def of_opk(omega: Any, phi: Any, kappa: Any, azimuth: Any = 0.0) -> np.ndarray:
    """Rotations from (right, down, forward) of cameras with photogrammetric angles in rad, in a map turned by deg."""
    R_map_from_image = turn("x", omega) @ turn("y", phi) @ turn("z", kappa)
    R_enu_from_map = turn("z", -np.deg2rad(np.broadcast_to(azimuth, np.shape(omega))))
    return R_NED_FROM_ENU @ R_enu_from_map @ R_map_from_image @ np.diag([1.0, -1.0, -1.0])


def doubles(content: bytes, columns: int) -> np.ndarray:
    """Whole records of little-endian doubles, (records, columns)."""
    count = len(content) // (8 * columns)
    return np.array(struct.unpack(f"<{count * columns}d", content[: 8 * columns * count])).reshape(count, columns)
