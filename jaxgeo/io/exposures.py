"""Planned exposures as a CSV table in degrees and metres, readable by `read_navigation`."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.coverage._overlap import Overlap
from jaxgeo.io._csv import POSE_COLUMNS, gimbal_columns
from jaxgeo.io.tables import write_csv
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.sensor import Pose, Shot
from jaxgeo.status import Status

# Decimals written: a nanosecond, a hundredth of a millimetre on the ground, a nanoradian.
DECIMALS = {"time_s": 9, "lat_deg": 10, "lon_deg": 10, "height_m": 4}
DECIMALS_OF_ANGLES, DECIMALS_OF_SHARES = 8, 6


def write_exposures(
    path: str | os.PathLike[str],
    shots: Shot,
    readings: Sequence[str] = (),
    *,
    overlaps: Overlap | Any = None,
) -> None:
    """Write n shots (a `Shot` whose fields hold n entries) to a CSV file, one row each.

    Columns: `exposure` (from 0), `time_s`, `lat_deg`, `lon_deg`, `height_m` (above the WGS 84 ellipsoid), `heading_deg`
    (0 to 360), `pitch_deg`, `roll_deg` (relative to the ellipsoid normal), `gimbal_<name>_deg` for each of `readings`,
    the gimbal's names. With `overlaps` (n - 1 entries, each with the previous shot) also `overlap_near`,
    `overlap_far`, as shares, and `status`, empty in the first row. `height_datum`, the last, is "ellipsoid" in each
    row, as `read_navigation` names it. NaN is written as an empty cell. The file appears only when complete.
    Raises `ValueError` for a path that cannot be written to, and for wrong numbers of entries.
    """
    target = pathlib.Path(path)
    check_is(shots, Shot, "shots", "One Shot, whose fields hold an entry for each exposure.")
    if target.suffix.lower() != ".csv":
        raise ValueError(f"{target}: planned exposures are written as CSV; name a file that ends in .csv.")
    count = np.size(shots.time)
    columns = _columns(target, shots, readings, count) | _shared(target, overlaps, count)
    columns["height_datum"] = ["ellipsoid"] * count
    rows = ({name: column[i] for name, column in columns.items()} for i in range(count))
    with destination("exposures", target) as stream:
        write_csv(rows, stream)


def _columns(target: pathlib.Path, shots: Shot, readings: Sequence[str], count: int) -> dict[str, list[Any]]:
    angles = np.asarray(shots.gimbal_readings)
    if np.ndim(shots.time) != 1 or not count or angles.shape != (count, len(readings)):
        raise ValueError(
            f"{target}: shots must hold one or more entries, each with readings of {', '.join(readings) or 'no axis'}; "
            f"got times of shape {np.shape(shots.time)} and gimbal_readings of shape {angles.shape}."
        )
    numbers = {"time_s": np.asarray(shots.time)} | dict(zip(POSE_COLUMNS, _pose(shots.pose, count), strict=True))
    numbers |= dict(zip(gimbal_columns(readings), np.rad2deg(angles.T), strict=True))
    texts = {name: _texts(values, DECIMALS.get(name, DECIMALS_OF_ANGLES)) for name, values in numbers.items()}
    return {"exposure": list(range(count)), **texts}


def _pose(pose: Pose, count: int) -> list[np.ndarray]:
    """The numbers of `POSE_COLUMNS`; scalars are broadcast."""
    pose = jax.tree.map(lambda x: jnp.broadcast_to(x, (count,)), pose)
    attitude = pose.heading, pose.pitch, pose.roll
    if pose.deflection is not None:
        attitude = jax.vmap(lambda one: heading_pitch_roll_from_R(one.R_ned_from_body))(pose)
    heading, pitch, roll = (np.rad2deg(np.asarray(angle)) for angle in attitude)
    places = [np.asarray(x) for x in pose.position.to_degrees()]
    return [*places, np.remainder(heading, 360.0), pitch, roll]


def _shared(target: pathlib.Path, overlaps: Any, count: int) -> dict[str, list[Any]]:
    """The columns of the overlap with the previous shot."""
    if overlaps is None:
        return {}
    wrong = [np.shape(x) for x in (overlaps.near, overlaps.far, overlaps.status) if np.shape(x) != (count - 1,)]
    if wrong:
        raise ValueError(
            f"{target}: overlaps of {count} shots must have {count - 1} entries, each with the shot before; got "
            f"shape {wrong[0]}."
        )
    shares = {f"overlap_{end}": np.append(np.nan, getattr(overlaps, end)) for end in ("near", "far")}
    words = [None, *(Status(int(code)).name for code in np.asarray(overlaps.status))]
    return {name: _texts(values, DECIMALS_OF_SHARES) for name, values in shares.items()} | {"status": words}


def _texts(values: np.ndarray, places: int) -> list[str | None]:
    """Formatted numbers, None for values that are not finite."""
    return [f"{x:.{places}f}" if np.isfinite(x) else None for x in values]
