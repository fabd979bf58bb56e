"""Drone log records with a position and camera angles relative to north and level, as exposures."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.earth import Geodetic
from jaxgeo.io._csv import POSE_COLUMNS
from jaxgeo.io.acquisitions._attitudes import attitudes_of
from jaxgeo.io.acquisitions._takeoff import heights_above_takeoff
from jaxgeo.io.acquisitions.blocks import CHOICES
from jaxgeo.io.acquisitions.record import Acquisition, UnstatedDatum, for_each
from jaxgeo.io.acquisitions.sentences import heights_are
from jaxgeo.io.datum_names import known_datum
from jaxgeo.io.errors import A_WRONG_GUESS, OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.given_camera import AS_GIVEN, OWN_CAMERA
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.io.sentinels import Sentinel, sentinel_of
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_FORWARD, R_HEAD_FROM_CAMERA_NADIR

QUANTITIES = ("position", "height", "camera angles")
LIMITS = {
    "lat": (-90.0, 90.0, "deg"),
    "lon": (-180.0, 180.0, "deg"),
    "altitude": POSE_COLUMNS["height_m"],
    "above_takeoff": POSE_COLUMNS["height_m"],
    "yaw": (-360.0, 360.0, "deg"),
    "pitch": (-180.0, 180.0, "deg"),
    "roll": (-180.0, 180.0, "deg"),
}
ANGLES = "Angles of the camera are against level and true north, as its gimbal has them."


@dataclass(frozen=True)
class LogRecord:
    """One record: raw `values` by the file's names, for `sentinel_of`, and the numbers of `LIMITS`.

    Angles in deg: yaw from true north, pitch above the horizon, roll; heights in m; None if missing.
    `time` in s, NaN if unknown. `where` names the record in messages.
    """

    name: str
    where: str
    values: Mapping[str, Any]
    numbers: Mapping[str, float | None]
    time: float


def acquisition_of_records(
    path: str | os.PathLike[str],
    form: str,
    records: Sequence[LogRecord],
    sentinels: tuple[Sentinel, ...],
    *,
    height_datum: str | float | None,
    takeoff_height: float | None,
    cameras: FrameCamera | None,
    camera: str | None,
    facts: Mapping[str, str],
    assumed: Sequence[str] = (),
    time_is_utc: bool = False,
    of_body: bool = False,
) -> Acquisition:
    """Exposures of records; those with unknown position, height or angles are left out, and counted.

    Without `cameras` they have no sensor; a camera is mounted by `Mount.nadir()`, with `Gimbal.fixed()`. Angles of the
    records are the camera's, which looks ahead at zero, or if `of_body` the aircraft's, whose mount may be another.
    Raises `UnstatedDatum` if neither `height_datum` nor `takeoff_height` is given; `TableError` for a value out of
    range, and if no record remains.
    """
    if cameras is not None:
        check_is(cameras, FrameCamera, "cameras")
    if camera is not None:
        raise TableError(f"{path}: camera={camera!r} is asked for, but the file names no cameras. Give {OWN_CAMERA}.")
    records = [_without_nan(record) for record in records]
    for record in records:
        _check_range(path, record)
    height_name = "above_takeoff" if takeoff_height is not None else "altitude"
    known, notes = _known(path, records, sentinels, height_name)
    columns = {
        name: np.array([record.numbers[name] for record in known], np.float64)
        for name in ("lat", "lon", height_name, "yaw", "pitch", "roll")
    }
    height, of_heights = _heights(path, columns, known[0], height_datum, takeoff_height)
    position = Geodetic(lat=np.deg2rad(columns["lat"]), lon=np.deg2rad(columns["lon"]), height=height)
    yaw, pitch, roll = (np.deg2rad(columns[name]) for name in ("yaw", "pitch", "roll"))
    heading, pitch, roll = (yaw, pitch, roll) if of_body else nadir_attitude(yaw, pitch, roll)
    pose = Pose(position, heading, pitch, roll)
    times = np.array([record.time for record in known])
    timed = bool(np.all(np.isfinite(times)))
    count = len(known)
    sensor = None if cameras is None else for_each(Sensor(cameras, Gimbal.fixed(), Mount.nadir()), count)
    of_camera = [] if cameras is None else [AS_GIVEN]
    of_times = [] if timed else [_no_times(known)]
    return Acquisition(
        path=os.fspath(path),
        form=form,
        names=np.array([record.name for record in known]),
        sensor=sensor,
        shots=Shot(pose, np.zeros((count, 0)), times if timed else np.zeros(count)),
        assumed=(*of_heights, *([] if of_body else [ANGLES]), *assumed, *of_camera, *of_times, *notes),
        facts={"records": f"{count} of {len(records)}", **facts},
        tags=tuple(dict(record.values) for record in known),
        time_is_utc=time_is_utc and timed,
        of_camera=not of_body,
        above_takeoff=_above_takeoff(known),
        start=min(record.time for record in records if math.isfinite(record.time)) if timed else None,
    )


def _above_takeoff(records: Sequence[LogRecord]) -> np.ndarray | None:
    """Heights (n,) in m above the take-off, NaN where the log does not tell them; None if it never does."""
    found = np.array([record.numbers.get("above_takeoff") for record in records], np.float64)
    return found if np.isfinite(found).any() else None


def _without_nan(record: LogRecord) -> LogRecord:
    """The record with None for numbers that are NaN, by which logs say that one is unknown."""
    if not any(value is not None and math.isnan(value) for value in record.numbers.values()):
        return record
    numbers = {name: None if value is None or math.isnan(value) else value for name, value in record.numbers.items()}
    return dataclasses.replace(record, numbers=numbers)


def _no_times(records: Sequence[LogRecord]) -> str:
    """A note on times that are not used."""
    without = [record for record in records if not math.isfinite(record.time)]
    if len(without) == len(records):
        return "Times are not in the file, or not in a form that is read; they are 0."
    return (
        f"Times are unknown in {len(without)} of {len(records)} records (the first is {without[0].where}); they are 0 "
        f"in all."
    )


def nadir_attitude(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(heading, pitch, roll) in rad of a body whose `Mount.nadir()` camera has these gimbal angles.

    Gimbal angles are relative to north and level, for a camera that looks ahead at zero: Rz(yaw) Ry(pitch) Rx(roll).
    """
    turn = np.asarray(R_HEAD_FROM_CAMERA_FORWARD) @ np.asarray(R_HEAD_FROM_CAMERA_NADIR).T  # 90 deg of pitch
    R = _R_from_yaw_pitch_roll(yaw, pitch, roll) @ turn
    heading, nose, leaning = attitudes_of(R)
    level = roll == 0.0  # exact, and continuous where the camera looks ahead
    return tuple(np.where(level, *pair) for pair in ((yaw, heading), (pitch + 0.5 * np.pi, nose), (0.0, leaning)))  # type: ignore[return-value]


def _R_from_yaw_pitch_roll(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(angle), np.sin(angle)) for angle in (yaw, pitch, roll))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _check_range(path: Any, record: LogRecord) -> None:
    for name, (low, high, unit) in LIMITS.items():
        value = record.numbers.get(name)
        if value is not None and not low <= value <= high:
            raise TableError(f"{path}, {record.where}: {name} {value:g} is outside [{low:g}, {high:g}] {unit}.")


def _known(
    path: Any, records: Sequence[LogRecord], sentinels: tuple[Sentinel, ...], height: str
) -> tuple[list[LogRecord], list[str]]:
    """(complete records, sentences on the records left out)."""
    needed = {"position": ("lat", "lon"), "height": (height,), "camera angles": ("yaw", "pitch", "roll")}
    known, left = [], dict[str, int]()
    for record in records:
        reasons = [_unknown(record, quantity, needed[quantity], sentinels) for quantity in QUANTITIES]
        why = next(filter(None, reasons), "")
        if why:
            left[why] = left.get(why, 0) + 1
        else:
            known.append(record)
    notes = [f"{count} of {len(records)} records are left out: {why}." for why, count in left.items()]
    if not known:
        raise TableError(f"{path}: no record has a position, a height and camera angles: {'; '.join(left)}.")
    return known, notes


def _unknown(record: LogRecord, quantity: str, needed: Sequence[str], sentinels: tuple[Sentinel, ...]) -> str:
    """Why a quantity of a record is unknown; empty if it is known."""
    row = sentinel_of(sentinels, quantity, record.values)
    if row is not None:
        return f"{quantity} unknown ({', '.join(row.fields)}: {row.reason})"
    missing = any(record.numbers.get(name) is None for name in needed)
    return f"{quantity} missing" if missing else ""


def _heights(
    path: Any, columns: Mapping[str, np.ndarray], first: LogRecord, datum: str | float | None, takeoff: float | None
) -> tuple[np.ndarray, list[str]]:
    """(heights in m above the ellipsoid, assumptions)."""
    if takeoff is not None:
        lon, lat, above = columns["lon"], columns["lat"], columns["above_takeoff"]
        heights, where = heights_above_takeoff(path, lon, lat, above, takeoff, datum)
        return heights, [f"Heights are above {where}, by the barometer."]
    if datum is None:
        above = first.numbers.get("above_takeoff")
        shown = f"{first.numbers['altitude']:g} m" + ("" if above is None else f", {above:g} m above the take-off")
        choice = "" if above is None else (
            "; or takeoff_height=, the height of the point of take-off in m above the ellipsoid, to which the heights "
            "above it are added"
        )  # fmt: skip
        raise UnstatedDatum(
            f"{path}: the vertical datum of its altitude is not stated (the first is {shown}); {A_WRONG_GUESS}. "
            f"{CHOICES.removesuffix('.')}{choice}."
        )
    try:
        heights = ellipsoidal_heights(columns["lon"], columns["lat"], columns["altitude"], datum)
        return heights, [heights_are(known_datum(datum))]
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error
