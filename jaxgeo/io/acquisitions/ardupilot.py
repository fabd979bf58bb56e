"""ArduPilot's dataflash logs (.bin, .log): photos (CAM) with the aircraft's attitude or the mount's angles."""

from __future__ import annotations

import contextlib
import io
import math
import os
import pathlib
import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.io._json import shown
from jaxgeo.io._regular import check_regular
from jaxgeo.io._text import read_text
from jaxgeo.io.acquisitions._flight_logs import LogRecord, acquisition_of_records
from jaxgeo.io.acquisitions._rtklib import GPS_EPOCH, WEEK, leap_seconds
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.sentinels import ARDUPILOT
from jaxgeo.sensor import FrameCamera

FORM = "flight log of ArduPilot"
BINARY, TEXT = b"\xa3\x95\x80", "FMT,"  # the start: a message that states a format
ODD = re.compile(rb"^(?:CAM|MNT),[^\n]*(?:[0-9]_[0-9]|[\x80-\xff])[^\n]*", re.MULTILINE)  # what only Python reads
HEADER = 3  # bytes of a binary message before its fields
NEEDED = ("Lat", "Lng", "Alt", "R", "P", "Y")
CLOSE = 1.0  # s between a photo and the mount's angles
FIXED = (
    "The log has no angles of a mount (MNT): the camera is taken to look straight down, fixed to the aircraft, with "
    "the top of its image to the nose."
)
MOUNT = (
    "Angles are the mount's (MNT), roll and pitch against level, by the nearest record in time ({worst:.2g} s at most)."
)
CUT = "The log ends within a message, which is left out: it was not written or copied to its end."
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
    photos, mounts, others, damages = _messages(path)
    if not photos:
        note = f"; it has {others} of TRIG, the moments of release" if others else ""
        raise TableError(
            f"{path}: there is no message CAM, of a photo{note}. Set CAM1_TYPE, and LOG_BITMASK to log it."
        )
    lacking = [name for name in NEEDED if name not in photos[0]]
    if lacking:
        raise TableError(f"{path}: its messages CAM have no {', '.join(lacking)}.")
    _check_numbers(path, "CAM", photos, (*NEEDED, "RelAlt", "TimeUS", "GPSWeek", "GPSTime"))
    _check_numbers(path, "MNT", mounts, ("Roll", "Pitch", "YawE", "YawB", "TimeUS"))
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
        assumed=(MOUNT.format(worst=worst) if by_mount else FIXED, LEVER, *damages),
        time_is_utc=True,
        of_body=not by_mount,
    )


def _messages(path: str | os.PathLike[str]) -> tuple[list[dict[str, Any]], list[dict[str, Any]], int, list[str]]:
    """(fields of messages CAM, those of MNT, number of messages TRIG, sentences about damage)."""
    readers = _pymavlink()
    check_regular(path, TableError)
    with open(path, "rb") as file:
        is_binary = file.read(len(BINARY)) == BINARY
    found: dict[str, list[dict[str, Any]]] = {"CAM": [], "MNT": [], "TRIG": []}
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed), _as_written(path) as place:
            log = readers[is_binary](place)
            with contextlib.closing(log):
                while (message := log.recv_match(type=list(found))) is not None:
                    found[message.get_type()].append(message.to_dict())
                is_cut = _is_cut(log, is_binary)
                odd = None if is_binary else ODD.search(log.data_map)
                if odd is not None:
                    line = odd[0].decode("utf-8", "replace").strip()
                    raise TableError(f"{path}: expected numbers in ASCII digits; got {shown(line)}.")
    except (TableError, FileNotFoundError):
        raise
    except Exception as error:  # pymavlink raises `Exception` itself, and whatever damaged bytes cause in it
        reason = str(error).strip() or type(error).__name__
        raise TableError(f"{path}: damaged, or no log of ArduPilot: {' '.join(reason.split())[:200]}.") from error
    damages = [CUT] if is_cut else []
    first = next((" ".join(line.split())[:120] for line in printed.getvalue().splitlines() if line.strip()), "")
    if first:
        damages.insert(0, f"Parts of the log are damaged and left out (the first: {first}).")
    return found["CAM"], found["MNT"], len(found["TRIG"]), damages


def _check_numbers(path: Any, kind: str, rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> None:
    """Raises `TableError` for a field that the log declares as something else than a number."""
    for name, value in ((name, row[name]) for row in rows for name in names if name in row):
        if not isinstance(value, int | float):
            raise TableError(f"{path}: {name} of a message {kind} is {shown(value)}, not a number.")


@contextlib.contextmanager
def _as_written(path: str | os.PathLike[str]) -> Iterator[str]:
    """A path that pymavlink reads: a copy of a text that is not in plain UTF-8 with line feeds."""
    with open(path, "rb") as file:
        head = file.read(4096)
    if head.startswith(BINARY) or (head.startswith(TEXT.encode()) and b"\n" in head):
        yield os.fspath(path)
        return
    text = read_text(path, FORM)
    with tempfile.TemporaryDirectory() as folder:
        copy = pathlib.Path(folder) / "flight.log"
        copy.write_text(text.replace("\r\n", "\n").replace("\r", "\n"), encoding="utf-8", newline="\n")
        yield os.fspath(copy)


def _is_cut(log: Any, is_binary: bool) -> bool:
    """Whether a log that was read to its end stops within a message."""
    content = log.data_map
    if is_binary:  # the reader stands behind the header of the message that it could not read
        header = content[log.offset - 3 : log.offset]
        return log.offset >= 3 and header[:2] == BINARY[:2] and header[2] in log.formats and log.remaining > 0
    last = content[content.rfind(b"\n") + 1 :].decode("utf-8", "replace")  # the reader takes lines with an end only
    return last.split(",")[0] in log.formats


class _Formats(dict[int, Any]):
    """Formats of messages by number. Raises `ValueError` for one without a length, at which the reader would stay."""

    def __setitem__(self, number: int, form: Any) -> None:
        if form.len < HEADER:
            raise ValueError(f"messages {form.name[:20]!r} of {form.len} bytes")
        super().__setitem__(number, form)


def _pymavlink() -> tuple[Any, Any]:
    """The readers of text and of binary logs."""
    try:
        from pymavlink import DFReader
    except ImportError as error:
        raise ImportError("Logs of ArduPilot are read by pymavlink: pip install 'jaxgeo[logs]'.") from error

    class Binary(DFReader.DFReader_binary):
        """The reader with its index made in Python, which takes as long; the compiled one prints past `sys.stderr`."""

        def init_arrays(self, progress_callback: Any = None) -> None:
            self.formats = _Formats(self.formats)
            super().init_arrays(progress_callback)

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
