"""Litchi flight logs (CSV): drone and gimbal records several times a second, as exposures."""

from __future__ import annotations

import os

from jaxgeo._checks import require_x64
from jaxgeo.io._csv import read_csv
from jaxgeo.io.acquisitions._flight_logs import acquisition_of_records
from jaxgeo.io.acquisitions._log_tables import LogLayout, moment_in, photos_shown, records_of
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.sentinels import LITCHI
from jaxgeo.sensor import FrameCamera

FORM = "flight log of Litchi"
LAYOUT = LogLayout(
    "latitude", "longitude", ("gimbalyawraw",), ("gimbalpitchraw",), ("gimbalrollraw",), (), ("altitude",),
    "istakingphoto", angle=0.1,
)  # fmt: skip
RAW = "gimbalYawRaw, gimbalPitchRaw and gimbalRollRaw are taken to be in tenths of a degree."


def read_litchi(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    takeoff_height: float | None = None,
    cameras: FrameCamera | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the records of a Litchi CSV flight log, named by their numbers from 0; as `read_airdata`.

    Columns as the app writes them: `latitude`, `longitude`, `altitude(m)` or `(feet)` above the take-off,
    `datetime(utc)`, `gimbalPitchRaw`, `gimbalRollRaw`, `gimbalYawRaw` in tenths of a degree against true north and
    level, `istakingphoto`. There is no other height: `takeoff_height`, in m above the ellipsoid, or
    `height_datum` if given, is required.

    Raises `TableError` without `takeoff_height`; else as `read_airdata`.
    """
    require_x64()
    if takeoff_height is None:
        raise TableError(
            f"{path}: its only heights are above the take-off: give takeoff_height=..., the height of that point in m "
            f"above {'the ellipsoid' if height_datum is None else f'height_datum={height_datum!r}'}."
        )
    table = read_csv(path, FORM, (), known=("latitude", "longitude"))
    records = records_of(table, LAYOUT, True, lambda cells: moment_in(cells.get("datetime", "")))
    return acquisition_of_records(
        path,
        FORM,
        records,
        LITCHI,
        height_datum=height_datum,
        takeoff_height=takeoff_height,
        cameras=cameras,
        camera=camera,
        facts={"photos": photos_shown(records, LAYOUT)},
        assumed=(RAW,),
        time_is_utc=any("datetime(utc)" in name.lower() for name in table.header),
    )
