"""DJI's marks of photos (`Timestamp.MRK`): number, time, offset of the camera from the antenna, position.

Layout: DJI, "Matrice 4 Series User Manual" (2025), "Image Log File", and "Phantom 4 RTK White Paper V2": times in GPS
week and seconds, offsets in mm, positive where the centre of the CMOS is north of, east of and below the phase centre
of the antenna.
"""

from __future__ import annotations

import functools
import os
import pathlib
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.io._json import shown
from jaxgeo.io._text import read_text
from jaxgeo.io.acquisitions._rtklib import GPS_EPOCH, WEEK, leap_seconds
from jaxgeo.io.errors import TableError
from jaxgeo.io.sentinels import MARKS, sentinel_of

_NUMBER = r"\s*(-?\d{1,12}(?:\.\d*)?)\s*"
MARK = re.compile(  # ASCII digits only
    rf"\s*(\d{{1,9}})\s{_NUMBER}\s\[(\d{{1,6}})\]\s{_NUMBER},N\s{_NUMBER},E\s{_NUMBER},V\s{_NUMBER},Lat\s{_NUMBER},Lon\s"
    rf"{_NUMBER},Ellh\s{_NUMBER},{_NUMBER},{_NUMBER}\s(\d{{1,6}})\s*,Q\s*",
    re.ASCII,
)
FIELDS = ("time of week", "week", "N", "E", "V", "Lat", "Lon", "Ellh", "sigma north", "sigma east", "sigma up", "Q")
ENDING = ".mrk"


@dataclass(frozen=True)
class Marks:
    """n marks: `numbers` (n,) of the photos; `time` (n,) in s since 1970 in UTC, NaN where unknown; `offset` (n, 3) in
    m, north, east and down from the antenna to the camera; `fields` of the marks, as written."""

    path: str
    numbers: np.ndarray
    time: np.ndarray
    offset: np.ndarray
    fields: tuple[dict[str, float], ...]


def read_marks(path: str | os.PathLike[str]) -> Marks:
    """The marks of a file. Raises `TableError` with the row of a line that is no mark, and for a repeated photo."""
    status = os.stat(path) if os.path.exists(path) else None
    return _read(os.fspath(path), None if status is None else (status.st_mtime_ns, status.st_size))


@functools.lru_cache(maxsize=2)  # one file serves many images
def _read(path: str, _: Any) -> Marks:
    numbers: list[int] = []
    fields: list[dict[str, float]] = []
    for row, line in enumerate(read_text(path, "file of marks").splitlines(), 1):
        if not line.strip():
            continue
        found = MARK.fullmatch(line)
        if found is None:
            raise TableError(f"{path}, row {row}: not a mark of a photo: {shown(line.strip())}.")
        photo, *rest = found.groups()
        if int(photo) in numbers:
            raise TableError(f"{path}: photo {photo} is there twice.")
        numbers.append(int(photo))
        fields.append(dict(zip(FIELDS, map(float, rest), strict=True)))
    offset = np.array([[one["N"], one["E"], one["V"]] for one in fields]) / 1e3
    return Marks(path, np.array(numbers), np.array([_utc(one) for one in fields]), offset, tuple(fields))


def marks_beside(images: str, positions: str, *, needed: bool) -> Marks | None:
    """The only file of marks in the folder of the images, else in that of a file of positions; None without one.

    Of several in one folder none is used, and `TableError` is raised if they are `needed`.
    """
    place = pathlib.Path(images)
    for folder in dict.fromkeys((place if place.is_dir() else place.parent, pathlib.Path(positions).parent)):
        files = _files_in(folder, folder.stat().st_mtime_ns)
        if len(files) > 1:
            if needed:
                raise TableError(f"{folder}: which marks are of these images is not clear: {files[0].name} and "
                                 f"{files[1].name}; leave those of the flight there only.")  # fmt: skip
            return None
        if files:
            return read_marks(files[0])
    return None


@functools.lru_cache(maxsize=8)  # one folder holds many images
def _files_in(folder: pathlib.Path, _: int) -> list[pathlib.Path]:
    """The files of marks in a folder, by name."""
    return sorted(one for one in folder.iterdir() if one.suffix.lower() == ENDING and one.is_file())


def moved(position: Geodetic, offset: np.ndarray) -> Geodetic:
    """Positions (n,) in rad and m moved by offsets (n, 3) in m, north, east and down, of up to some metres."""
    lat, lon, height = (np.asarray(one) for one in (position.lat, position.lon, position.height))
    across = WGS84.a / np.sqrt(1.0 - WGS84.e2 * np.sin(lat) ** 2)
    along = across * (1.0 - WGS84.e2) / (1.0 - WGS84.e2 * np.sin(lat) ** 2)
    north, east, down = np.asarray(offset).T
    return Geodetic(
        lat=lat + north / (along + height),
        lon=lon + east / ((across + height) * np.cos(lat)),
        height=height - down,
    )


def _utc(fields: dict[str, float]) -> float:
    """A time in s since 1970 in UTC; NaN if the receiver had none."""
    if sentinel_of(MARKS, "time", fields):
        return np.nan
    time = GPS_EPOCH + WEEK * fields["week"] + fields["time of week"]
    return time - leap_seconds(time)
