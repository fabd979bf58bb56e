"""PX4's logs (ULog, .ulg): photos (camera_capture) with the attitude of the camera or the aircraft."""

from __future__ import annotations

import contextlib
import io
import math
import os
import struct
from typing import Any

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.io._regular import check_regular
from jaxgeo.io.acquisitions._flight_logs import LogRecord, acquisition_of_records
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.sentinels import PX4
from jaxgeo.sensor import FrameCamera

FORM = "flight log of PX4"
MAGIC = b"ULog\x01\x12\x35"
PHOTOS, MOUNTS = "camera_capture", ("gimbal_device_attitude_status", "mount_orientation")
NEEDED = ("lat", "lon", "alt", "q[0]", "q[1]", "q[2]", "q[3]")
FIXED = (
    "The log has no angles of a gimbal: q is taken as the aircraft's attitude, and the camera to look straight down, "
    "fixed to it, with the top of its image to the nose."
)
GIMBAL = "The log has angles of a gimbal ({topic}): q is taken as the camera's attitude, looking ahead at zero."
CORRUPT = "Parts of the log are damaged and left out, photos in them too."
LEVER = "Positions are the autopilot's: no lever arm to the camera is added."


def read_px4(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    cameras: FrameCamera | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the photos (topic `camera_capture`) of a PX4 log (ULog), with pyulog, named by `seq`, else from 0.

    Fields as in PX4's message reference: `lat`, `lon`, `alt` above mean sea level, `timestamp_utc` in us, `result` (0
    is a photo that failed), `q` from the camera, or the aircraft, to north-east-down, in the order w, x, y, z. It is
    the camera's if the log has `gimbal_device_attitude_status` or `mount_orientation`.

    `height_datum`, `cameras` and `camera` as in `read_airdata`. Raises `ImportError` without the extra `logs`;
    `TableError` for a log without photos, or damaged; else as `read_airdata`.
    """
    require_x64()
    topics, is_corrupt = _topics(path)
    photos = topics.get(PHOTOS)
    if not photos or not any(len(column) for column in photos.values()):
        raise TableError(f"{path}: there is no {PHOTOS}, of a photo; PX4 logs it where a camera trigger is set up.")
    lacking = [name for name in NEEDED if name not in photos]
    if lacking:
        raise TableError(f"{path}: its {PHOTOS} has no {', '.join(lacking)}.")
    topic = next((one for one in MOUNTS if one in topics), None)
    count = len(photos["lat"])
    numbers = photos.get("seq", np.arange(count))
    names = numbers if len(np.unique(numbers)) == count else np.arange(count)
    rows = [{name: column[k].item() for name, column in photos.items()} for k in range(count)]
    records = [
        LogRecord(
            str(name),
            f"photo {name}",
            row,
            {
                "lat": _finite(row["lat"]),
                "lon": _finite(row["lon"]),
                "altitude": _finite(row["alt"]),
                **dict(zip(("yaw", "pitch", "roll"), _angles([row[f"q[{i}]"] for i in range(4)]), strict=True)),
            },
            row["timestamp_utc"] / 1e6 if row.get("timestamp_utc") else math.nan,
        )
        for name, row in zip(names.tolist(), rows, strict=True)
    ]
    return acquisition_of_records(
        path,
        FORM,
        records,
        PX4,
        height_datum=height_datum,
        takeoff_height=None,
        cameras=cameras,
        camera=camera,
        facts={},
        assumed=(FIXED if topic is None else GIMBAL.format(topic=topic), LEVER, *([CORRUPT] if is_corrupt else [])),
        time_is_utc=True,
        of_body=topic is None,
    )


def _topics(path: str | os.PathLike[str]) -> tuple[dict[str, dict[str, np.ndarray]], bool]:
    """(columns of the first instance of each topic, whether parts of the file could not be read)."""
    ULog, error_classes = _pyulog()
    check_regular(path, TableError)
    silent = contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO())
    try:
        with silent[0], silent[1]:  # it prints what it cannot read
            log = ULog(os.fspath(path), [PHOTOS, *MOUNTS])
    except error_classes as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise TableError(f"{path}: damaged, or no log of PX4: {reason}.") from error
    return {one.name: one.data for one in reversed(log.data_list)}, bool(log.file_corruption)


def _pyulog() -> tuple[Any, tuple[type[Exception], ...]]:
    """(the reader, what it raises for damaged files)."""
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogException
    except ImportError as error:
        raise ImportError("Logs of PX4 are read by pyulog: pip install 'jaxgeo[logs]'.") from error
    classes = (ULogException, struct.error, TypeError, AttributeError, ArithmeticError, MemoryError, LookupError)
    return ULog, (*classes, ValueError, OSError)


def _angles(q: list[float]) -> tuple[float | None, float | None, float | None]:
    """(yaw, pitch, roll) in deg of a quaternion; None if it is none. Where the pitch is 90 deg, the roll is zero."""
    length = math.sqrt(sum(one * one for one in q))
    if not abs(length - 1.0) < 0.01:
        return None, None, None
    w, x, y, z = (one / length for one in q)
    down = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    if abs(down) > 1.0 - 1e-9:
        yaw, roll = math.atan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z)), 0.0
    else:
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return math.degrees(yaw), math.degrees(math.asin(down)), math.degrees(roll)


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None
