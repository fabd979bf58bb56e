"""Error file (smrmsg) of an SBET, interpolated between its records."""

from __future__ import annotations

import os

import numpy as np

from jaxgeo.io.acquisitions._applanix import ERROR_FIELDS, clock_of, mapped
from jaxgeo.io.errors import TableError

ARC_MINUTE = np.pi / 10_800.0
LARGEST_ERRORS = {"m": 1e5, "arc minutes": 10_800.0}
GAP = 10.0  # times the median interval: longer intervals are gaps


def errors_at(path: str | os.PathLike[str], of: str, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(position north, east, down in m (n, 3), heading, pitch, roll in rad (n, 3)) of an error file at `times`."""
    path = os.fspath(path)
    records = mapped(path, "smrmsg", ERROR_FIELDS)
    clock, _ = clock_of(path, records)
    interval = float(np.median(np.diff(clock))) if len(clock) > 1 else 0.0
    if times[0] < clock[0] - interval or times[-1] > clock[-1] + interval:  # it may start at the next full second
        raise TableError(
            f"{path}: it covers {clock[0]:.9g} to {clock[-1]:.9g} s, but the records of {of} that are read "
            f"{times[0]:.9g} to {times[-1]:.9g} s. Do the two files belong together?"
        )
    first = max(int(np.searchsorted(clock, times[0], side="right")) - 1, 0)
    last = min(int(np.searchsorted(clock, times[-1], side="left")) + 1, len(clock))
    gaps = np.diff(clock[first:last]) > GAP * interval
    if np.any(gaps):
        number = first + int(np.argmax(gaps))
        raise TableError(
            f"{path}, records {number} and {number + 1}: nothing from {clock[number]:.9g} to {clock[number + 1]:.9g} "
            f"s; read the parts before and after with between=."
        )
    values: dict[str, np.ndarray] = {}
    for name in ("north", "east", "down", "heading", "pitch", "roll"):
        unit = "m" if name in ("north", "east", "down") else "arc minutes"
        column = np.array(records[first:last, ERROR_FIELDS.index(name)])
        fine = (column > 0.0) & (column <= LARGEST_ERRORS[unit])
        if not np.all(fine):
            row = int(np.argmin(fine))
            raise TableError(
                f"{path}, record {first + row}: the error of {name} is {column[row]:.9g} {unit}; expected a standard "
                f"deviation above 0, up to {LARGEST_ERRORS[unit]:g}. Is it the smrmsg file?"
            )
        values[name] = np.interp(times, clock[first:last], column)
    position = np.stack([values[name] for name in ("north", "east", "down")], axis=-1)
    attitude = np.stack([values[name] for name in ("heading", "pitch", "roll")], axis=-1)
    return position, attitude * ARC_MINUTE
