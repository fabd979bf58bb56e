"""Flight logs as tables: columns with units in their names, several records a second, as log records."""

from __future__ import annotations

import calendar
import math
import re
import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from jaxgeo._text_numbers import BLANKS, no_number, number_in
from jaxgeo.io._csv import UNKNOWN_WORDS, CsvTable
from jaxgeo.io.acquisitions._flight_logs import LogRecord
from jaxgeo.io.errors import TableError

METRES = {"feet": 0.3048, "ft": 0.3048, "meters": 1.0, "metres": 1.0, "m": 1.0}
COLUMN = re.compile(r"\s*([^()\[\]]*?)\s*(?:[(\[]([^()\[\]]*)[)\]])?\s*")
MOMENT = re.compile(r"(\d{4})[-/](\d{1,2})[-/](\d{1,2})[ T](\d{1,2}:\d{2}:\d{2})(\.\d{1,9})?", re.ASCII)
HEIGHTS = ("altitude", "above_takeoff")


@dataclass(frozen=True)
class LogLayout:
    """Columns of a program's logs by our quantities, in lower case and without units; the first present is used.

    `angle` is the unit of the camera's angles in deg, `photo` the column that marks photos; `altitude` and
    `above_takeoff` may be empty, if the program writes none.
    """

    lat: str
    lon: str
    yaw: tuple[str, ...]
    pitch: tuple[str, ...]
    roll: tuple[str, ...]
    altitude: tuple[str, ...]
    above_takeoff: tuple[str, ...]
    photo: str
    angle: float = 1.0


def columns_of(table: CsvTable) -> dict[str, tuple[int, str]]:
    """Index and unit of each column, by its name in lower case: without its unit, unless that is another's name."""
    found: dict[str, tuple[int, str]] = {}
    for index, written in enumerate(table.header):
        parts = COLUMN.fullmatch(written)
        name, unit = (written, "") if parts is None else (parts[1], parts[2] or "")
        found.setdefault(name.lower() if name.lower() not in found else written.lower(), (index, unit.lower()))
    return found


def records_of(
    table: CsvTable, layout: LogLayout, by_takeoff: bool, time_of: Callable[[Mapping[str, str]], float]
) -> list[LogRecord]:
    """The records of a table, `time_of` from the cells of one; heights are above the take-off if `by_takeoff`.

    Raises `TableError` for columns that are missing or in another unit, and cells that are not numbers.
    """
    columns = columns_of(table)
    places = _places(table, columns, layout, by_takeoff)
    return [_record(table, columns, places, row, time_of) for row in range(len(table))]


def photos_shown(records: list[LogRecord], layout: LogLayout) -> str:
    """The photos among records, by name."""
    photos = [record.name for record in records if _is_set(record.values.get(layout.photo))]
    more = ", ..." if len(photos) > 5 else ""
    return f"{len(photos)} ({', '.join(photos[:5])}{more})" if photos else "none marked"


def moment_in(written: str) -> float:
    """A date and time, year first, in s since 1970 as if in UTC; NaN if it is none."""
    found = MOMENT.match(written.strip())
    if found is None:
        return math.nan
    try:
        whole = calendar.timegm(clock.strptime(f"{found[1]}-{found[2]}-{found[3]} {found[4]}", "%Y-%m-%d %H:%M:%S"))
    except ValueError:
        return math.nan
    return whole + float(f"0{found[5] or '.0'}") if whole > 0 else math.nan


def _places(
    table: CsvTable, columns: Mapping[str, tuple[int, str]], layout: LogLayout, by_takeoff: bool
) -> dict[str, tuple[int, float]]:
    """Column index and factor for each quantity."""
    wanted = {"lat": (layout.lat,), "lon": (layout.lon,), "yaw": layout.yaw, "pitch": layout.pitch,
              "roll": layout.roll, "altitude": layout.altitude, "above_takeoff": layout.above_takeoff}  # fmt: skip
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
        factor = METRES[unit] if ours in HEIGHTS else layout.angle if ours in ("yaw", "pitch", "roll") else 1.0
        found[ours] = index, factor
    return found


def _record(
    table: CsvTable,
    columns: Mapping[str, tuple[int, str]],
    places: Mapping[str, tuple[int, float]],
    row: int,
    time_of: Callable[[Mapping[str, str]], float],
) -> LogRecord:
    cells = table.cells[row]
    values = {name: cells[index].strip() for name, (index, _) in columns.items()}
    numbers: dict[str, float | None] = {"altitude": None, "above_takeoff": None}
    for ours, (index, factor) in places.items():
        cell = cells[index].strip(BLANKS)
        if cell.lower() in UNKNOWN_WORDS:
            numbers[ours] = None
            continue
        number = number_in(cell)
        if number is None:
            raise table.wrong(row, table.header[index], f"{no_number(cell)}.")
        numbers[ours] = factor * number
    return LogRecord(str(row), f"row {table.lines[row]}", values, numbers, time_of(values))


def _is_set(cell: object) -> bool:
    return str(cell).strip().lower() in ("1", "1.0", "true", "yes")
