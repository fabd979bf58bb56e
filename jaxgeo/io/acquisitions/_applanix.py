"""Records of Applanix files: headerless float64 arrays, with clock and range checks."""

from __future__ import annotations

import pathlib

import numpy as np

from jaxgeo.io._csv import POSE_COLUMNS
from jaxgeo.io._regular import check_regular
from jaxgeo.io.errors import TableError
from jaxgeo.io.navigation import WEEK
from jaxgeo.io.sentinels import SBET

# Fields of a record, all float64, little-endian. Velocities are along the axes of the wander frame (`_wander`).
# Accelerations and rates are unused: the file does not state whether rates are relative to the Earth or inertial.
FIELDS = (
    "time", "lat", "lon", "height", "velocity_x", "velocity_y", "velocity_z", "roll", "pitch", "platform_heading",
    "wander", "acceleration_x", "acceleration_y", "acceleration_z", "rate_x", "rate_y", "rate_z",
)  # fmt: skip
ERROR_FIELDS = (
    "time", "north", "east", "down", "velocity_north", "velocity_east", "velocity_down", "roll", "pitch", "heading",
)  # fmt: skip
TURN = 2.0 * np.pi
_HEIGHTS = POSE_COLUMNS["height_m"][:2]
# Lowest and highest value of the fields in use, and the unit; a heading or a wander angle may have wrapped twice.
LIMITS = {
    "lat": (-np.pi / 2, np.pi / 2, "rad"),
    "lon": (-TURN, TURN, "rad"),
    "height": (*_HEIGHTS, "m"),
    "velocity_x": (-2e4, 2e4, "m/s"),
    "velocity_y": (-2e4, 2e4, "m/s"),
    "velocity_z": (-2e4, 2e4, "m/s"),
    "roll": (-np.pi, np.pi, "rad"),
    "pitch": (-np.pi / 2, np.pi / 2, "rad"),
    "platform_heading": (-2.0 * TURN, 2.0 * TURN, "rad"),
    "wander": (-2.0 * TURN, 2.0 * TURN, "rad"),
}
NEW_WEEK = 60.0  # s: longest part missing at the end of a week where the clock restarts
Fields = dict[str, np.ndarray]


def mapped(path: str, what: str, fields: tuple[str, ...]) -> np.ndarray:
    """Memory-mapped records of a file (n, fields)."""
    width = 8 * len(fields)
    check_regular(path, TableError)
    try:
        if pathlib.Path(path).is_dir():
            raise TableError(f"{path}: this is a folder; give the {what} file in it.")
        size = pathlib.Path(path).stat().st_size
        if size and not size % width:
            return np.memmap(path, "<f8", "r").reshape(-1, len(fields))
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such {what} file.") from None
    except OSError as error:
        raise TableError(f"{path}: the {what} file cannot be read: {error}.") from error
    if not size:
        raise TableError(f"{path}: the file is empty.")
    others = {"an SBET file": 8 * len(FIELDS), "a file of its errors, smrmsg": 8 * len(ERROR_FIELDS)}
    other = next((name for name, other in others.items() if other != width and not size % other), None)
    why = f"is it {other}?" if other else "the file is cut off, or no such file; copy or export it again."
    raise TableError(
        f"{path}: {size} bytes are {size // width} records of {what} ({width} bytes each) and {size % width} bytes "
        f"more; {why}"
    )


def clock_of(path: str, records: np.ndarray) -> tuple[np.ndarray, bool]:
    """The times of all records in s, and whether a week rollover was unwrapped."""
    times = np.array(records[:, 0])
    known = np.isfinite(times) & (np.abs(times) <= 1e11)
    if not np.all(known):
        number = int(np.argmin(known))
        raise TableError(f"{path}, record {number}: time is {times[number]:.9g} s; the file is damaged, or none.")
    steps = np.diff(times)
    back = np.flatnonzero(steps <= 0.0)
    carried_on = len(back) == 1 and bool(0.0 < steps[back[0]] + WEEK <= NEW_WEEK)
    if carried_on:
        times[back[0] + 1 :] += WEEK
    elif len(back):
        number = int(back[0]) + 1
        how = "time stands still" if steps[back[0]] == 0.0 else "time running backwards"
        raise TableError(
            f"{path}, records {number - 1} and {number}: {how}, from {times[number - 1]:.9g} s to "
            f"{times[number]:.9g} s; sort the records and drop those that are there twice."
        )
    return times, carried_on


def numbers_of(path: str, records: np.ndarray, picked: np.ndarray) -> Fields:
    """The fields in use of the picked records, checked for range and a known position."""
    rows = np.asarray(records[picked])
    numbers = {name: np.array(rows[:, FIELDS.index(name)], np.float64) for name in LIMITS}
    for name, (low, high, unit) in LIMITS.items():
        fine = (numbers[name] >= low) & (numbers[name] <= high)  # NaN is not
        if not np.all(fine):
            row = int(np.argmin(fine))
            raise TableError(
                f"{path}, record {picked[row]}: {name} is {numbers[name][row]:.9g}, outside [{low:.6g}, {high:.6g}] "
                f"{unit}; the file is damaged, or no SBET."
            )
    nowhere = np.flatnonzero((numbers["lat"] == 0.0) & (numbers["lon"] == 0.0))
    if len(nowhere):
        raise TableError(
            f"{path}, record {picked[nowhere[0]]}: latitude and longitude are zero ({SBET[0].reason}); the file is "
            f"damaged, or no SBET. Export it again, or take out the {len(nowhere)} records of that place."
        )
    return numbers


def wrapped(angle: np.ndarray) -> np.ndarray:
    """An angle in rad wrapped to [-pi, pi]."""
    return angle - TURN * np.round(angle / TURN)
