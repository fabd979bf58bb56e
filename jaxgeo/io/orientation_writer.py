"""Orientation table writer: CSV, in a map or in geographic coordinates."""

from __future__ import annotations

import csv
import os
import pathlib
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pyproj

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo._text_numbers import number_in
from jaxgeo.io._cells import Rows, safe_cell
from jaxgeo.io._csv import POSE_COLUMNS
from jaxgeo.io._map_grid import MapGrid, metric_map
from jaxgeo.io._orientation_columns import DATUM, GRID_COLUMNS, SIGMA_COLUMNS
from jaxgeo.io.orientations import Orientations
from jaxgeo.io.vertical import height_shift
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.sensor import Pose

# Decimals written: a hundredth of a millimetre for latitudes, 1e-8 deg for angles, a nanosecond.
DECIMALS = {"x_m": 4, "y_m": 4, "z_m": 4, "height_m": 4, "lat_deg": 10, "lon_deg": 10, "time_s": 9}
DECIMALS_OF_ANGLES = 8


def write_orientations(
    path: str | os.PathLike[str],
    orientations: Orientations,
    *,
    crs: str | int | pyproj.CRS | None = None,
    height_datum: str | float = "ellipsoid",
) -> None:
    """Write orientations to a CSV file that `read_orientations` reads: geographic, or with `crs` in that map.

    Heights are written above `height_datum`, which must be that of `crs` if this has a vertical part; the last column
    states it, unless it is the path of a grid. Precision is 1e-4 m and 1e-8 deg; headings are from 0 to 360. The file
    appears only when complete.
    Raises `ValueError` for a path that cannot be written to and poses that are not finite, `TableError` for an
    unsuitable map, `VerticalDatumError` for heights.
    """
    check_is(orientations, Orientations, "orientations")
    target, pose = pathlib.Path(path), orientations.pose
    finite = np.all([np.isfinite(leaf) for leaf in jax.tree.leaves(pose)], axis=0)
    if not np.all(finite):
        raise ValueError(f"{target}: the pose of image {orientations.names[np.argmin(finite)]} is not finite.")
    lat, lon, height = (np.asarray(x) for x in pose.position.to_degrees())
    horizontal, vertical = (None, None) if crs is None else metric_map(target, crs)
    height = height_shift(height_datum, vertical).from_ellipsoid(lon, lat, height)
    if horizontal is None:
        heading, pitch, roll = (np.rad2deg(x) for x in _heading_pitch_roll(pose))
        numbers = dict(zip(POSE_COLUMNS, [lat, lon, height, np.remainder(heading, 360.0), pitch, roll], strict=True))
    else:
        grid = MapGrid.about_lonlat(target, horizontal, lon, lat)
        x, y = grid.from_lonlat(lon, lat)
        angles = _to_omega_phi_kappa(pose, grid.convergence(x, y))
        numbers = dict(zip(GRID_COLUMNS, [x, y, height, *(np.rad2deg(angle) for angle in angles)], strict=True))
    lost = ~np.all([np.isfinite(column) for column in numbers.values()], axis=0)
    if np.any(lost):
        raise ValueError(f"{target}: map or vertical datum do not reach image {orientations.names[np.argmax(lost)]}.")
    _write(target, orientations, numbers, f"{height_datum}")


def _write(target: pathlib.Path, orientations: Orientations, numbers: dict[str, np.ndarray], datum: str) -> None:
    columns: dict[str, list[str]] = {"image": orientations.names.tolist()}
    times = {} if orientations.time is None else {"time_s": orientations.time}
    for name, values in (numbers | times).items():
        columns[name] = [f"{value:.{DECIMALS.get(name, DECIMALS_OF_ANGLES)}f}" for value in values]
    if orientations.camera is not None:
        columns["camera"] = orientations.camera.tolist()
    if orientations.sigma is not None:
        sigma = np.concatenate([orientations.sigma[:, :3], np.rad2deg(orientations.sigma[:, 3:])], axis=1)
        columns |= {name: [f"{x:.9g}" for x in values] for name, values in zip(SIGMA_COLUMNS, sigma.T, strict=True)}
    if DATUM.fullmatch(datum) or number_in(datum) is not None:
        columns["height_datum"] = [datum] * len(orientations.names)
    with destination("orientations", target) as stream:
        writer = csv.writer(Rows(stream), lineterminator="\r\n")
        writer.writerow(columns)
        writer.writerows(map(safe_cell, row) for row in zip(*columns.values(), strict=True))


@eqx.filter_jit
@jax.vmap
def _to_omega_phi_kappa(pose: Pose, convergence: Any) -> tuple[Any, Any, Any]:
    return pose.to_omega_phi_kappa(convergence=convergence)


def _heading_pitch_roll(pose: Pose) -> tuple[Any, Any, Any]:
    """The attitude relative to the ellipsoid normal."""
    if pose.deflection is None:
        return pose.heading, pose.pitch, pose.roll
    return eqx.filter_jit(jax.vmap(lambda one: heading_pitch_roll_from_R(one.R_ned_from_body)))(pose)
