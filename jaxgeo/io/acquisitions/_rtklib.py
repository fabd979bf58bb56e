"""RTKLIB position solutions (.pos): epochs with position, standard deviations and quality.

Layout: RTKLIB ver. 2.4.2 manual, appendix B.1 "Positioning Solution File".
"""

from __future__ import annotations

import calendar
import functools
import os
import re
import time as clock
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo._text_numbers import number_in, numbers_in, words_of
from jaxgeo.io._json import shown
from jaxgeo.io._text import read_text
from jaxgeo.io.errors import TableError

HEADER = re.compile(r"%\s*(GPST|UTC|JST)\s+(latitude|x-ecef|e-baseline)(\S*)", re.IGNORECASE)
DATE = re.compile(r"\d{4}/\d{1,2}/\d{1,2}", re.ASCII)
TIME = re.compile(r"(\d{1,2}:\d{2}:\d{2})(\.\d{0,9})?", re.ASCII)
QUALITY = {1: "fixed", 2: "float", 3: "SBAS", 4: "DGPS", 5: "single", 6: "PPP"}
GPS_EPOCH = 315_964_800.0  # s since 1970
WEEK = 604_800.0  # s
LEAPS = (  # UTC in s since 1970 from which GPS is ahead by so many s (IERS Bulletin C), the latest first
    (1_483_228_800.0, 18.0), (1_435_708_800.0, 17.0), (1_341_100_800.0, 16.0), (1_230_768_000.0, 15.0),
    (1_136_073_600.0, 14.0),
)  # fmt: skip
FIRST_LEAP = 13.0  # s, from 1999 on
JST = 32_400.0  # s ahead of UTC
GRID = 0.05  # s: receivers measure at whole multiples of it, cameras do not
NEAR_GRID = 2e-3  # s
MOSTLY = 0.8  # share of epochs on the grid from which a file is a trajectory


@dataclass(frozen=True)
class Solutions:
    """n epochs: `time` (n,) in s since 1970 in UTC, ascending; `lat`, `lon` in deg, `height` in m; `sigma` (n, 3) of
    north, east, up in m, zero where unknown; `quality` (n,). `is_track`: epochs of a receiver, not of a camera;
    `is_ellipsoidal` whether heights are above the ellipsoid, None if unstated; `notes` are sentences."""

    time: np.ndarray
    lat: np.ndarray
    lon: np.ndarray
    height: np.ndarray
    sigma: np.ndarray
    quality: np.ndarray
    is_track: bool
    is_ellipsoidal: bool | None
    notes: tuple[str, ...]


def is_solutions(text: str) -> bool:
    """Whether the first lines of a file are those of RTKLIB's solutions."""
    return any(HEADER.match(line.strip()) for line in text.splitlines() if line.startswith("%"))


def read_solutions(path: str | os.PathLike[str]) -> Solutions:
    """The solutions of a file. Raises `TableError` with the row."""
    status = os.stat(path) if os.path.exists(path) else None
    return _read(os.fspath(path), None if status is None else (status.st_mtime_ns, status.st_size))


@functools.lru_cache(maxsize=2)  # one file serves many images
def _read(path: str, _: Any) -> Solutions:
    text = read_text(path, "file of RTKLIB")
    comments = [line.strip() for line in text.splitlines() if line.startswith("%")]
    header = next((found for line in comments if (found := HEADER.match(line))), None)
    if header is None:
        raise TableError(f"{path}: there is no header (%  GPST  latitude(deg) ...); set out-outhead to on.")
    scale, kind, unit = header[1].upper(), header[2].lower(), header[3]
    if kind != "latitude":
        raise TableError(f"{path}: its positions are {kind}; set the solution format to Lat/Lon/Height (llh).")
    in_minutes = unit.startswith("(d'")
    first = 2 + (6 if in_minutes else 2)  # words before the height
    rows = [(i, words_of(re.sub(r"[,;]", " ", line))) for i, line in enumerate(text.splitlines(), 1)
            if line.strip() and not line.startswith("%")]  # fmt: skip
    if not rows:
        raise TableError(f"{path}: there are no solutions below the header.")
    epochs = np.empty((len(rows), 8))
    for k, (row, words) in enumerate(rows):
        numbers = numbers_in(words[2 : first + 6])
        if len(words) < first + 6 or numbers is None:
            raise TableError(f"{path}, row {row}: expected time, position, height, Q, ns, sdn, sde, sdu; got "
                             f"{shown(' '.join(words))}.")  # fmt: skip
        angles = [_degrees(*numbers[:3]), _degrees(*numbers[3:6])] if in_minutes else numbers[:2]
        height, quality, _, *sigma = numbers[first - 2 :]
        epochs[k] = _seconds(path, row, words[0], words[1], scale), *angles, height, quality, *sigma
        _check(path, row, epochs[k])
    steps = np.diff(epochs[:, 0])
    if np.any(steps <= 0.0):
        raise TableError(
            f"{path}, row {rows[int(np.argmax(steps <= 0.0)) + 1][0]}: its time is not after the one above."
        )
    ellipsoidal = [found[1].lower() for line in comments if (found := re.search(r"height=WGS84/(\w+)", line, re.I))]
    return Solutions(
        time=epochs[:, 0], lat=epochs[:, 1], lon=epochs[:, 2], height=epochs[:, 3], sigma=epochs[:, 5:],
        quality=epochs[:, 4].astype(int), is_track=_is_track(epochs[:, 0]),
        is_ellipsoidal=ellipsoidal[0].startswith("ellipsoid") if ellipsoidal else None,
        notes=(_scale_note(scale, epochs[0, 0]),),
    )  # fmt: skip


def shares(quality: np.ndarray) -> str:
    """How many solutions are of each quality: "800 fixed (Q 1), 20 float (Q 2)"."""
    kinds, counts = np.unique(quality, return_counts=True)
    return ", ".join(
        f"{count} {QUALITY.get(int(kind), 'other')} (Q {kind})" for kind, count in zip(kinds, counts, strict=True)
    )


def leap_seconds(time: float) -> float:
    """GPS minus UTC in s, at a time in s since 1970."""
    return next((leap for start, leap in LEAPS if time >= start), FIRST_LEAP)


def _scale_note(scale: str, time: float) -> str:
    if scale == "GPST":
        return f"Its times are GPS time; UTC is {leap_seconds(time):.0f} s (leap seconds) behind."
    return "Its times are UTC." if scale == "UTC" else "Its times are Japanese time, 9 h ahead of UTC."


def _degrees(degrees: float, minutes: float, seconds: float) -> float:
    return np.copysign(abs(degrees) + minutes / 60.0 + seconds / 3600.0, degrees)


def _seconds(path: str, row: int, first: str, second: str, scale: str) -> float:
    """A time in s since 1970 in UTC."""
    moment = TIME.fullmatch(second)
    if DATE.fullmatch(first) and moment:
        try:
            whole = calendar.timegm(clock.strptime(f"{first} {moment[1]}", "%Y/%m/%d %H:%M:%S"))
        except ValueError:
            raise TableError(f"{path}, row {row}: {first} {second} is no date and time.") from None
        time = whole + float(f"0{moment[2] or '.0'}")
    else:
        week, tow = number_in(first), number_in(second)
        if week is None or tow is None or not (0.0 <= week < 1e4 and 0.0 <= tow <= WEEK):
            raise TableError(
                f"{path}, row {row}: {shown(f'{first} {second}')} is no date and time, nor GPS week and s."
            )
        time = GPS_EPOCH + WEEK * week + tow
    if scale == "GPST":
        return time - leap_seconds(time)
    return time - (JST if scale == "JST" else 0.0)


def _check(path: str, row: int, epoch: np.ndarray) -> None:
    _, lat, lon, height, quality, *sigma = epoch
    if not (abs(lat) <= 90.0 and abs(lon) <= 360.0 and -2e3 <= height <= 2e6):
        raise TableError(f"{path}, row {row}: latitude {lat:g}, longitude {lon:g}, height {height:g} are no position.")
    if quality != int(quality) or not 0 <= quality <= 9:
        raise TableError(f"{path}, row {row}: {quality:g} is no quality (Q), a whole number from 0 to 9.")
    if min(sigma) < 0.0:
        raise TableError(f"{path}, row {row}: a standard deviation is negative.")


def _is_track(time: np.ndarray) -> bool:
    """Whether epochs are at whole multiples of `GRID`, as a receiver's and not a camera's."""
    off = np.abs(np.remainder(time + 0.5 * GRID, GRID) - 0.5 * GRID)
    return len(time) > 1 and bool(np.mean(off < NEAR_GRID) >= MOSTLY)
