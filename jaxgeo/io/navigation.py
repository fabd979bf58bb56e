"""Navigation records (CSV in degrees and metres) as a trajectory in radians."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence

import numpy as np

from jaxgeo._checks import as_array, as_float64, require_x64
from jaxgeo.io._columns import refuse_nowhere
from jaxgeo.io._csv import POSE_COLUMNS, CsvTable, Limits, gimbal_columns, read_csv
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.tables import poses_of, readings_of
from jaxgeo.sensor import Pose, Trajectory
from jaxgeo.sensor.camera import Numbers

TIME: dict[str, Limits] = {"time_s": (-1e11, 1e11, "s")}
VELOCITY: dict[str, Limits] = {
    f"velocity_{axis}_mps": (-2e4, 2e4, "m/s") for axis in ("north", "east", "down")
}  # over the ground
WEEK = 604_800.0  # s, period of the GPS time of week


def read_navigation(
    path: str | os.PathLike[str],
    readings: Sequence[str] = (),
    *,
    height_datum: str | float,
    gimbal_readings: Numbers | None = None,
    longest_gap: float | None = None,
) -> Trajectory:
    """Read a trajectory from the navigation records of a CSV file, one per row, in order of time.

    Columns: `time_s`, `lat_deg`, `lon_deg`, `height_m`, `heading_deg`, `pitch_deg`, `roll_deg`, and
    `gimbal_<name>_deg` for each of `readings`, the gimbal's names (`sensor.gimbal.names`). Velocities over the ground
    `velocity_north_mps`, `velocity_east_mps`, `velocity_down_mps` are used if present. Other columns are
    ignored. Headings may pass through north, and readings are unwrapped along the shorter arc.

    - `height_datum`: datum of the heights: "ellipsoid", "EPSG:5773" (EGM96 mean sea level), an undulation in
      m; as in scene files.
    - `gimbal_readings`: instead of columns, readings in rad: (axes,) constant, or (records, axes).
    - `longest_gap`: in s, between two records; by default ten median intervals.

    Raises `TableError` (row and column named) for columns that are missing, repeated or incomplete, for cells that are
    unknown, not numbers or out of range, for times that do not increase, fewer than two records, gaps, and rotations
    too large to be unambiguous; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    columns = {} if gimbal_readings is not None else gimbal_columns(readings)
    wanted = TIME | POSE_COLUMNS | columns
    hints = dict.fromkeys(columns, "Readings that are not in the file are given with gimbal_readings=, in rad.")
    table = read_csv(path, "file of navigation records", wanted, hints=hints)
    if gimbal_readings is not None:
        _check_said_once(table, readings)
    wanted |= _velocity_columns(table)
    numbers = {name: table.numbers(name, limits) for name, limits in wanted.items()}
    refuse_nowhere(table, "lat_deg", numbers["lat_deg"], numbers["lon_deg"])
    _check_times(table, numbers["time_s"])
    angles = _angles(table, numbers, readings, gimbal_readings)
    velocity = np.stack([numbers[name] for name in VELOCITY], axis=-1) if VELOCITY.keys() <= wanted.keys() else None
    poses = _poses(table, numbers, height_datum)
    try:
        return Trajectory.from_knots(numbers["time_s"], poses, angles, velocity_ned=velocity, longest_gap=longest_gap)
    except ValueError as error:
        raise TableError(f"{path}: {_of_rows(str(error), table.lines)}") from error


def _check_said_once(table: CsvTable, readings: Sequence[str]) -> None:
    there = [name for name in gimbal_columns(readings) if name in table.header]
    if there:
        raise TableError(
            f"{table.path}: the file has a column {there[0]}, and gimbal_readings= are given too; leave one out."
        )


def _velocity_columns(table: CsvTable) -> dict[str, Limits]:
    """The velocity columns, all or none."""
    missing = [name for name in VELOCITY if name not in table.header]
    if len(missing) == len(VELOCITY):
        return {}
    if missing:
        raise TableError(
            f"{table.path}: no column {', '.join(missing)}, but {_others(missing)}; give all three components of the "
            f"velocity or none. Down is positive: a rate of climb changes its sign."
        )
    return VELOCITY


def _others(missing: list[str]) -> str:
    return " and ".join(name for name in VELOCITY if name not in missing)


def _check_times(table: CsvTable, times: np.ndarray) -> None:
    if len(table) < 2:
        raise TableError(f"{table.path}: one record only; a trajectory needs two or more.")
    steps = np.diff(times)
    if np.all(steps > 0.0):
        return
    after = int(np.argmax(steps <= 0.0)) + 1
    before, now = times[after - 1], times[after]
    how = "time stands still" if now == before else "time running backwards"
    advice = "sort the records and drop those that are there twice"
    if 0.0 <= now < 0.5 * WEEK < before <= WEEK:
        advice = f"if it is seconds of a GPS week, add {WEEK:.0f} to all that come after its end"
    lines = f"rows {table.lines[after - 1]} and {table.lines[after]}"
    raise TableError(f"{table.path}, {lines}, column time_s: {how}, from {before:.9g} s to {now:.9g} s; {advice}.")


def _angles(
    table: CsvTable, numbers: Mapping[str, np.ndarray], readings: Sequence[str], given: Numbers | None
) -> np.ndarray:
    """Gimbal readings (records, axes) in rad, unwrapped."""
    if given is None:
        angles = readings_of(numbers, readings, len(table))
    else:
        angles = np.asarray(as_float64(as_array(given, "gimbal_readings"), "gimbal_readings"))
        axes = angles.shape[-1] if angles.ndim else 0
        if angles.shape not in ((axes,), (len(table), axes)) or (readings and axes != len(readings)):
            axes = len(readings) or "axes"
            raise ValueError(
                f"{table.path}: gimbal_readings must have the shape ({axes},) or ({len(table)}, {axes}), in rad; "
                f"got {angles.shape}."
            )
        angles = np.broadcast_to(angles, (len(table), angles.shape[-1]))
    return np.unwrap(angles, axis=0)


def _poses(table: CsvTable, numbers: Mapping[str, np.ndarray], height_datum: str | float) -> Pose:
    try:
        return poses_of(numbers, height_datum)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{table.path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{table.path}: {error}") from error


def _of_rows(message: str, lines: Sequence[int]) -> str:
    """A trajectory's message about its knots, rewritten for the rows of the file."""
    message = re.sub(r"\bknot (\d+)", lambda knot: f"row {lines[int(knot[1])]}", message)
    return message.replace("knots", "records").removesuffix(" Are the angles in rad?")  # the file has them in deg
