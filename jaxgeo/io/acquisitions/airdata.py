"""AirData flight logs (CSV): drone and gimbal records several times a second, as exposures."""

from __future__ import annotations

import calendar
import math
import os
import re
import time as clock
from collections.abc import Mapping

from jaxgeo._checks import require_x64
from jaxgeo._text_numbers import BLANKS, number_in
from jaxgeo.io._csv import UNKNOWN_WORDS, CsvTable, read_csv
from jaxgeo.io.acquisitions._flight_logs import LogRecord, acquisition_of_records
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.sentinels import AIRDATA
from jaxgeo.sensor import FrameCamera

FORM = "flight log of AirData"
METRES = {"feet": 0.3048, "ft": 0.3048, "meters": 1.0, "metres": 1.0, "m": 1.0}
COLUMN = re.compile(r"\s*([^()]*?)\s*(?:\(([^()]*)\))?\s*")
ANGLES = {"yaw": "gimbal_heading", "pitch": "gimbal_pitch", "roll": "gimbal_roll"}
HEIGHTS = {"altitude": ("altitude_above_sealevel", "altitude"), "above_takeoff": ("height_above_takeoff",)}


def read_airdata(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    takeoff_height: float | None = None,
    cameras: FrameCamera | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the records of an AirData CSV flight log, named by their numbers from 0; `facts` lists the photos, and
    `tags` all columns of a record.

    `gimbal_heading`, `gimbal_pitch` and `gimbal_roll` are the camera's angles, relative to true north and level; the
    pose is that of a body with the camera in `Mount.nadir()` and `Gimbal.fixed()`. Lengths are in the unit in brackets
    after the column name, feet or meters. Records without a fix (positions empty or zero, `gpslevel` 0) are
    left out, and counted in `assumed`.

    - `height_datum`: datum of `altitude_above_seaLevel`, else of `altitude`, as in scene files.
    - `takeoff_height`: instead, the height of the take-off in m above the ellipsoid, to which `height_above_takeoff`
      is added.
    - `cameras`: the camera, with the size of its images; without it exposures have no sensor.
    - `camera`: a camera name; not applicable to such files.

    Raises `UnstatedDatum`; `TableError` for columns that are missing, in another unit, not numbers or out of range;
    `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    table = read_csv(path, FORM, (), known=("latitude", "longitude"))
    columns = _columns(table)
    where = _places(table, columns, takeoff_height is not None)
    start = _start(table, columns)
    records = [_record(table, columns, where, row, start) for row in range(len(table))]
    photos = [record.name for record in records if _is_set(record.values.get("isphoto"))]
    shown = f"{len(photos)} ({', '.join(photos[:5])}{', ...' if len(photos) > 5 else ''})" if photos else "none marked"
    return acquisition_of_records(
        path,
        FORM,
        records,
        AIRDATA,
        height_datum=height_datum,
        takeoff_height=takeoff_height,
        cameras=cameras,
        camera=camera,
        facts={"photos": shown},
        time_is_utc=start is not None,
    )


def _columns(table: CsvTable) -> dict[str, tuple[int, str]]:
    """Index and unit of each column, by its name in lower case."""
    found: dict[str, tuple[int, str]] = {}
    for index, written in enumerate(table.header):
        parts = COLUMN.fullmatch(written)
        name, unit = (written, "") if parts is None else (parts[1], parts[2] or "")
        found.setdefault(name.lower(), (index, unit.lower()))
    return found


def _places(table: CsvTable, columns: Mapping[str, tuple[int, str]], by_takeoff: bool) -> dict[str, tuple[int, float]]:
    """Column index and unit factor for each quantity."""
    wanted = {"lat": ("latitude",), "lon": ("longitude",)} | {ours: (name,) for ours, name in ANGLES.items()} | HEIGHTS
    optional = "altitude" if by_takeoff else "above_takeoff"
    found: dict[str, tuple[int, float]] = {}
    for ours, names in wanted.items():
        name = next((name for name in names if name in columns), None)
        if name is None and ours != optional:
            raise TableError(f"{table.path}: no column {names[0]}; found {', '.join(table.header)}.")
        if name is None:
            continue
        index, unit = columns[name]
        if ours in HEIGHTS and unit not in METRES:
            raise TableError(f"{table.path}, column {table.header[index]}: its unit must be feet or meters.")
        found[ours] = index, METRES[unit] if ours in HEIGHTS else 1.0
    return found


def _record(
    table: CsvTable,
    columns: Mapping[str, tuple[int, str]],
    where: Mapping[str, tuple[int, float]],
    row: int,
    start: float | None,
) -> LogRecord:
    cells = table.cells[row]
    values = {name: cells[index].strip() for name, (index, _) in columns.items()}
    numbers: dict[str, float | None] = {"altitude": None, "above_takeoff": None}
    for ours, (index, factor) in where.items():
        cell = cells[index].strip(BLANKS)
        if cell.lower() in UNKNOWN_WORDS:
            numbers[ours] = None
            continue
        number = number_in(cell)
        if number is None:
            raise table.wrong(row, table.header[index], f"{cell[:60]!r} is not a number.")
        numbers[ours] = factor * number
    time = math.nan if start is None else start + _milliseconds(values.get("time")) / 1e3
    return LogRecord(str(row), f"row {table.lines[row]}", values, numbers, time)


def _start(table: CsvTable, columns: Mapping[str, tuple[int, str]]) -> float | None:
    """UTC in s since 1970 at the zero of the log's milliseconds; None if unknown."""
    if "datetime" not in columns or "time" not in columns:
        return None
    for cells in table.cells:
        written, after = (cells[columns[name][0]].strip() for name in ("datetime", "time"))
        try:
            moment = calendar.timegm(clock.strptime(written[:19].replace("T", " "), "%Y-%m-%d %H:%M:%S"))
        except ValueError:
            continue
        if moment > 0 and math.isfinite(milliseconds := _milliseconds(after)):
            return moment - milliseconds / 1e3
    return None


def _milliseconds(cell: str | None) -> float:
    number = number_in(cell or "")
    return math.nan if number is None else number


def _is_set(cell: object) -> bool:
    return str(cell).strip().lower() in ("1", "1.0", "true", "yes")
