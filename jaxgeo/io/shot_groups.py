"""Which images are of one exposure of several cameras, and which of one flight: by their names, times or a table."""

from __future__ import annotations

import os
import pathlib
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from jaxgeo.io._orientation_columns import read_orientation_columns

# DJI_20240510102031_0042_T, DJI_0042_W, DJI_0042_MS_NIR, IMG_0042_3 (MicaSense), IMG_160908_142347_0042_GRE (Sequoia)
CAMERA_LAST = re.compile(r"(?P<shot>.*\d)[_-](?P<camera>(?:MS_)?[A-Za-z]+|\d{1,2})")
DATE = re.compile(r"(?<!\d)20\d{12}(?!\d)")  # of DJI; cameras of one exposure may differ by a second in it
ALIKE = 2.0  # s: dates of one exposure are no further apart
COLUMNS = ("shot", "flight", "camera")


def shots_by_name(names: Sequence[str | os.PathLike[str]]) -> tuple[np.ndarray, np.ndarray]:
    """(numbers of exposures (n,), names of cameras (n,)) of image files whose names differ only in their last part.

    The last part, behind a `_` or `-`, names the camera: `DJI_0042_T.JPG` and `DJI_0042_W.JPG`, `IMG_0042_1.tif` and
    `IMG_0042_2.tif`. Images of different folders are of different exposures. The date in names of DJI,
    `DJI_20240510102031_0042_T.JPG`, may differ by 2 s. An image without a last part is one of its own, of a camera
    named "-".
    """
    keys, cameras = [], []
    dates: dict[tuple[str, str], list[float]] = {}
    for name in names:
        path = pathlib.Path(name)
        parts = CAMERA_LAST.fullmatch(path.stem)
        cameras.append("-" if parts is None else parts["camera"])
        written = path.stem if parts is None else parts["shot"]
        date = DATE.search(written)
        key = f"{path.parent}", DATE.sub("", written)
        moment = 0.0 if date is None else _seconds(date[0])
        dates.setdefault(key, []).append(moment)
        keys.append((*key, moment))
    first = {key: np.sort(found) for key, found in dates.items()}
    numbers: dict[tuple[Any, ...], int] = {}
    shot = []
    for *key, moment in keys:
        known = first[key[0], key[1]]
        breaks = known[1:][np.diff(known) > ALIKE]
        shot.append(numbers.setdefault((*key, int(np.searchsorted(breaks, moment, side="right"))), len(numbers)))
    return np.array(shot), np.array(cameras)


def _seconds(date: str) -> float:
    try:
        return datetime.strptime(date, "%Y%m%d%H%M%S").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return 0.0


def shots_by_time(time: Any, camera: Any, seconds: float) -> np.ndarray:
    """Numbers (n,) of exposures: images of different cameras at times `time` (n,) in s, no more than `seconds` after
    the first of them. `camera` (n,) names the camera of each.

    Raises `ValueError` for a time that is not finite, or zero: unknown.
    """
    time, camera = np.asarray(time, np.float64), np.asarray(camera)
    unknown = ~np.isfinite(time) | (time == 0.0)
    if np.any(unknown):
        raise ValueError(
            f"the time of image {int(np.argmax(unknown))} is unknown ({int(np.sum(unknown))} such images)."
        )
    shot, number, start, taken = np.zeros(len(time), int), -1, -np.inf, set()
    for row in np.argsort(time, kind="stable").tolist():
        if time[row] - start > seconds or camera[row] in taken:
            number, start, taken = number + 1, time[row], set()
        shot[row] = number
        taken.add(camera[row])
    return shot


def flights_by_time(time: Any, seconds: float) -> np.ndarray:
    """Numbers (n,) of flights of images at times `time` (n,) in s: a new one begins where no image was taken for more
    than `seconds`. Raises `ValueError` as `shots_by_time`."""
    time = np.asarray(time, np.float64)
    shots_by_time(time, np.arange(len(time)), 0.0)
    order = np.argsort(time, kind="stable")
    flight = np.zeros(len(time), int)
    flight[order] = np.cumsum(np.concatenate([[False], np.diff(time[order]) > seconds]))
    return flight


def stated_groups(path: str | os.PathLike[str]) -> dict[str, dict[str, str]]:
    """By image name, the cells of those of the columns `shot`, `flight` and `camera` that a table of orientations has.

    Raises as `read_orientations`, and `TableError` for an empty cell.
    """
    columns = read_orientation_columns(path)
    written = {name.strip().lower(): name for name in columns.table.header}
    found = {one: _cells(columns, written[one]) for one in COLUMNS if one in written}
    if "image" not in columns or not found:
        return {}
    names = columns.names("image").tolist()
    return {name: {one: cells[row] for one, cells in found.items()} for row, name in enumerate(names)}


def _cells(columns: Any, name: str) -> list[str]:
    from jaxgeo.io._columns import names_of

    return names_of(columns.table, name).tolist()
