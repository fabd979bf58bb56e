"""Flight Reader's and PhantomHelp's CSV of DJI flight records: drone and gimbal records, as exposures."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping

from jaxgeo._checks import require_x64
from jaxgeo._text_numbers import number_in
from jaxgeo.io._csv import CsvTable, read_csv
from jaxgeo.io.acquisitions._flight_logs import acquisition_of_records
from jaxgeo.io.acquisitions._log_tables import LogLayout, moment_in, photos_shown, records_of
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.sentinels import FLIGHT_READER
from jaxgeo.sensor import FrameCamera

FORM = "flight log of Flight Reader"
LAYOUT = LogLayout(
    "osd.latitude", "osd.longitude", ("gimbal.yaw",), ("gimbal.pitch",), ("gimbal.roll",), ("osd.altitude",),
    ("osd.height",), "camera.isphoto",
)  # fmt: skip
FLY_TIME = "Times are in s since the motors started (OSD.flyTime): the dates in the file are local."


def read_flight_reader(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    takeoff_height: float | None = None,
    cameras: FrameCamera | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the records of a DJI flight record as Flight Reader (and PhantomHelp's log viewer) exports it to CSV, named
    by their numbers from 0; as `read_airdata`.

    Columns by Flight Reader's field descriptions: `OSD.latitude`, `OSD.longitude`, `OSD.altitude` above the sea and
    `OSD.height` above the take-off, each [ft] or [m], `GIMBAL.pitch`, `GIMBAL.roll`, `GIMBAL.yaw` in deg against true
    north and level, `CAMERA.isPhoto`. Times are UTC where `CUSTOM.date [UTC]` and `CUSTOM.updateTime [UTC]` have the
    year first and 24 hours, else `OSD.flyTime [s]`. Raises as `read_airdata`.
    """
    require_x64()
    table = read_csv(path, FORM, (), known=("osd.latitude", "osd.longitude"))
    is_utc = _is_utc(table)
    records = records_of(table, LAYOUT, takeoff_height is not None, _utc if is_utc else _fly_time)
    has_times = any(math.isfinite(record.time) for record in records)
    return acquisition_of_records(
        path,
        FORM,
        records,
        FLIGHT_READER,
        height_datum=height_datum,
        takeoff_height=takeoff_height,
        cameras=cameras,
        camera=camera,
        facts={"photos": photos_shown(records, LAYOUT)},
        assumed=() if is_utc or not has_times else (FLY_TIME,),
        time_is_utc=is_utc,
    )


def _is_utc(table: CsvTable) -> bool:
    header = {name.strip().lower() for name in table.header}
    if not {"custom.date [utc]", "custom.updatetime [utc]"} <= header:
        return False
    rows = table.rows
    names = {name.strip().lower(): name for name in table.header}
    date, time = names["custom.date [utc]"], names["custom.updatetime [utc]"]
    return all(not str(row[time]).strip().lower().endswith("m") for row in rows) and any(
        math.isfinite(moment_in(f"{row[date]} {row[time]}")) for row in rows
    )


def _utc(cells: Mapping[str, str]) -> float:
    return moment_in(f"{cells['custom.date']} {cells['custom.updatetime']}")


def _fly_time(cells: Mapping[str, str]) -> float:
    """OSD.flyTime [s]; beside it a column of that name without a unit has minutes and seconds as text."""
    number = number_in(cells.get("osd.flytime [s]", cells.get("osd.flytime", "")))
    return math.nan if number is None else number
