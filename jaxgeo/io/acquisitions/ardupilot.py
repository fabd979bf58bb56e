"""ArduPilot's dataflash logs (.bin, .log): photos (CAM) with the aircraft's attitude or the mount's angles."""

from __future__ import annotations

import contextlib
import io
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.io._regular import check_regular
from jaxgeo.io.acquisitions._flight_logs import LogRecord, acquisition_of_records
from jaxgeo.io.acquisitions._rtklib import GPS_EPOCH, WEEK, leap_seconds
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.sentinels import ARDUPILOT
from jaxgeo.sensor import FrameCamera

FORM = "flight log of ArduPilot"
BINARY, TEXT = b"\xa3\x95\x80", b"FMT,"  # the first bytes: a message that states a format
NEEDED = ("Lat", "Lng", "Alt", "R", "P", "Y")
CLOSE = 1.0  # s between a photo and the mount's angles
FIXED = (
    "The log has no angles of a mount (MNT): the camera is taken to look straight down, fixed to the aircraft, with "
    "the top of its image to the nose."
)
MOUNT = (
    "Angles are the mount's (MNT), roll and pitch against level, by the nearest record in time ({worst:.2g} s at most)."
)
LEVER = "Positions are the autopilot's: no lever arm to the camera is added."


def read_ardupilot(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    takeoff_height: float | None = None,
    cameras: FrameCamera | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the photos (messages CAM) of an ArduPilot dataflash log, binary or as text, with pymavlink.

    Fields as in ArduPilot's log message documentation: `Lat`, `Lng`, `Alt` above mean sea level, `RelAlt` above home,
    `R`, `P`, `Y` of the aircraft in deg, `GPSWeek` and `GPSTime` in ms. Where the log has messages MNT of the mount,
    its `Roll`, `Pitch` and `YawE` (else `YawB` from the aircraft's `Y`) are the camera's angles. Photos are named by
    `Img`, with the camera's number before it if they are of several, else by their order from 0.

    `height_datum`, `takeoff_height` (that of home), `cameras` and `camera` as in `read_airdata`. Raises `ImportError`
    without the extra `logs`; `TableError` for a log without photos, or damaged; else as `read_airdata`.
    """
    require_x64()
    photos, mounts, others = _messages(path)
    if not photos:
        note = f"; it has {others} of TRIG, the moments of release" if others else ""
        raise TableError(
            f"{path}: there is no message CAM, of a photo{note}. Set CAM1_TYPE, and LOG_BITMASK to log it."
        )
    lacking = [name for name in NEEDED if name not in photos[0]]
    if lacking:
        raise TableError(f"{path}: its messages CAM have no {', '.join(lacking)}.")
    found = [_angles(photo, mounts) for photo in photos]
    by_mount = bool(mounts)
    names = _names(photos)
    records = [
        LogRecord(
            name,
            f"photo {name}",
            photo,
            {
                "lat": photo["Lat"],
                "lon": photo["Lng"],
                "altitude": photo["Alt"],
                "above_takeoff": photo.get("RelAlt"),
                **dict(zip(("yaw", "pitch", "roll"), angles, strict=True)),
            },
            _time(photo),
        )
        for name, photo, (angles, _) in zip(names, photos, found, strict=True)
    ]
    worst = max((apart for _, apart in found if math.isfinite(apart)), default=0.0)
    return acquisition_of_records(
        path,
        FORM,
        records,
        ARDUPILOT,
        height_datum=height_datum,
        takeoff_height=takeoff_height,
        cameras=cameras,
        camera=camera,
        facts={},
        assumed=(MOUNT.format(worst=worst) if by_mount else FIXED, LEVER),
        time_is_utc=True,
        of_body=not by_mount,
    )


def _messages(path: str | os.PathLike[str]) -> tuple[list[dict[str, Any]], list[dict[str, Any]], int]:
    """(fields of messages CAM, those of MNT, number of messages TRIG)."""
    readers = _pymavlink()
    check_regular(path, TableError)
    with open(path, "rb") as file:
        is_binary = file.read(len(BINARY)) == BINARY
    found: dict[str, list[dict[str, Any]]] = {"CAM": [], "MNT": [], "TRIG": []}
    silent = contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO())
    try:
        with silent[0], silent[1]:  # it prints what it cannot read
            log = readers[is_binary](os.fspath(path))
            with contextlib.closing(log):
                while (message := log.recv_match(type=list(found))) is not None:
                    found[message.get_type()].append(message.to_dict())
    except Exception as error:  # pymavlink raises `Exception` itself, and whatever damaged bytes cause in it
        reason = str(error).strip() or type(error).__name__
        raise TableError(f"{path}: damaged, or no log of ArduPilot: {' '.join(reason.split())[:200]}.") from error
    return found["CAM"], found["MNT"], len(found["TRIG"])


def _pymavlink() -> tuple[Any, Any]:
    """The readers of text and of binary logs."""
    try:
        from pymavlink import DFReader
    except ImportError as error:
        raise ImportError("Logs of ArduPilot are read by pymavlink: pip install 'jaxgeo[logs]'.") from error

    class Binary(DFReader.DFReader_binary):
        """The reader with its index made in Python, which takes as long; the compiled one prints past `sys.stderr`."""

        def init_arrays_fast(self, progress_callback: Any = None) -> None:
            self.init_arrays(progress_callback)

    return DFReader.DFReader_text, Binary


def _names(photos: Sequence[Mapping[str, Any]]) -> list[str]:
    several = len({photo.get("I") for photo in photos}) > 1
    names = [
        f"{photo.get('I')}/{photo.get('Img')}" if several else str(photo.get("Img", "")) for photo in photos
    ]  # fmt: skip
    unique = all(count == 1 for count in Counter(names).values()) and "Img" in photos[0]
    return names if unique else [str(k) for k in range(len(photos))]


def _time(photo: Mapping[str, Any]) -> float:
    """Time in s since 1970 in UTC; NaN if unknown."""
    week, milliseconds = photo.get("GPSWeek", 0), photo.get("GPSTime", 0)
    if not week:
        return math.nan
    time = GPS_EPOCH + WEEK * week + milliseconds / 1e3
    return time - leap_seconds(time)


def _angles(photo: Mapping[str, Any], mounts: Sequence[Mapping[str, Any]]) -> tuple[tuple[float | None, ...], float]:
    """((yaw, pitch, roll) in deg, s to the record of the mount): the aircraft's without records of a mount."""
    if not mounts:
        return (photo["Y"], photo["P"], photo["R"]), 0.0
    own = [one for one in mounts if one.get("I") == photo.get("I")] or mounts
    apart = np.abs(np.array([one.get("TimeUS", math.nan) for one in own], np.float64) - photo.get("TimeUS", math.nan))
    apart = np.where(np.isnan(apart), np.inf, apart) / 1e6
    nearest = int(np.argmin(apart))
    if not apart[nearest] <= CLOSE:
        return (None, None, None), math.inf
    mount = own[nearest]
    of_earth, of_body = mount.get("YawE", math.nan), mount.get("YawB", math.nan)
    yaw = of_earth if math.isfinite(of_earth) else (photo["Y"] + of_body + 180.0) % 360.0 - 180.0
    found = yaw, mount.get("Pitch", math.nan), mount.get("Roll", math.nan)
    return tuple(one if math.isfinite(one) else None for one in found), float(apart[nearest])
