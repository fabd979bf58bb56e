"""AirData flight logs (CSV): drone and gimbal records several times a second, as exposures."""

from __future__ import annotations

import calendar
import math
import os
import time as clock
from collections.abc import Mapping

from jaxgeo._checks import require_x64
from jaxgeo._text_numbers import number_in
from jaxgeo.io._csv import CsvTable, read_csv
from jaxgeo.io.acquisitions._flight_logs import acquisition_of_records
from jaxgeo.io.acquisitions._log_tables import LogLayout, columns_of, photos_shown, records_of
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.sentinels import AIRDATA
from jaxgeo.sensor import FrameCamera

FORM = "flight log of AirData"
LAYOUT = LogLayout(
    "latitude", "longitude", ("gimbal_heading",), ("gimbal_pitch",), ("gimbal_roll",),
    ("altitude_above_sealevel", "altitude"), ("height_above_takeoff",), "isphoto",
)  # fmt: skip


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
    - `takeoff_height`: instead, the height of the take-off in m above the ellipsoid, or `height_datum` if
      given, to which `height_above_takeoff` is added.
    - `cameras`: the camera, with the size of its images; without it exposures have no sensor.
    - `camera`: a camera name; not applicable to such files.

    Raises `UnstatedDatum`; `TableError` for columns that are missing, in another unit, not numbers or out of range;
    `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    table = read_csv(path, FORM, (), known=("latitude", "longitude"))
    start = _start(table)
    records = records_of(table, LAYOUT, takeoff_height is not None, lambda cells: _time(cells, start))
    return acquisition_of_records(
        path,
        FORM,
        records,
        AIRDATA,
        height_datum=height_datum,
        takeoff_height=takeoff_height,
        cameras=cameras,
        camera=camera,
        facts={"photos": photos_shown(records, LAYOUT)},
        time_is_utc=start is not None,
    )


def _time(cells: Mapping[str, str], start: float | None) -> float:
    return math.nan if start is None else start + _milliseconds(cells.get("time")) / 1e3


def _start(table: CsvTable) -> float | None:
    """UTC in s since 1970 at the zero of the log's milliseconds; None if unknown."""
    columns = columns_of(table)
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
