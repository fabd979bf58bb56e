"""Exposures of a video or a log at given times: interpolated between neighbouring records, or the nearest record."""

from __future__ import annotations

import dataclasses
import datetime
import functools
import math
import os
import re
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxgeo._text_numbers import number_in
from jaxgeo.earth import Geodetic
from jaxgeo.io._utc import utc_text
from jaxgeo.io.acquisitions.record import Acquisition, Reported
from jaxgeo.io.errors import TableError
from jaxgeo.sensor import Pose, Shot

CLOCK = re.compile(r"(?:([0-9]{1,3}):)?([0-9]{1,2}):([0-9]{1,2}(?:[.,][0-9]{1,9})?)")
OFFSETS = "HH:MM:SS, MM:SS or s after the start of the file (00:01:23.5, 83.5)"
FORMS = f"{OFFSETS}, or a UTC time (2024-05-10T10:20:31Z)"
LONGEST = 2.0  # s between two records that are interpolated
LARGEST_TURN = np.deg2rad(20.0)  # of any angle between them
SAME = 1e-6  # s: a record of this time is taken as it is

Times = Sequence[str | float]


def by_time(read: Callable[..., Acquisition]) -> Callable[..., Acquisition]:
    """The reader with the option `times`."""

    @functools.wraps(read)
    def timed(path: str | os.PathLike[str], *, times: Times | None = None, **how: Any) -> Acquisition:
        found = read(path, **how)
        return found if times is None else at_times(found, times)

    return timed


def at_times(found: Acquisition, times: Times) -> Acquisition:
    """Exposures at `times`, in one of `FORMS`, named by them: HH:MM:SS after the start, or as a UTC time.

    Position and angles are interpolated linearly between the two records around a time, if these are at most 2 s
    apart, of cameras mounted alike, and turned by less than 20 deg; else they are those of the nearest record. All
    else, such as the focal length, is the nearest record's. Sentences say which, and why. Raises `TableError` for
    records without times, a time outside their range, and a text that is no time.
    """
    clock = np.asarray(found.shots.time, np.float64)
    if not np.any(clock) or (np.any(clock == 0.0) and np.ptp(clock) > 1e8):  # zero where it is unknown
        raise TableError(f"{found.path}: times of its records are missing; leave times= out.")
    start = found.start if found.start is not None else float(clock.min())
    order = np.argsort(clock, kind="stable")
    seconds = [_seconds(found, one, start) for one in times]
    for written, one in zip(times, seconds, strict=True):
        _check_inside(found, written, one, clock, start)
    known = clock[order]
    after = np.clip(np.searchsorted(known, seconds, side="left"), 1 if len(known) > 1 else 0, len(known) - 1)
    pairs = [(int(order[max(k - 1, 0)]), int(order[k])) for k in after]
    nearest = [min(pair, key=lambda k, at=at: abs(clock[k] - at)) for pair, at in zip(pairs, seconds, strict=True)]
    each, notes, widest = [], [], 0.0
    for written, at, pair, near in zip(times, seconds, pairs, nearest, strict=True):
        one, other = (found.exposure(k) for k in pair)
        apart = float(clock[pair[1]] - clock[pair[0]])
        if abs(clock[near] - at) <= SAME:
            each.append(found.exposure(near)[1])
            continue
        share = (at - clock[pair[0]]) / apart if apart > 0.0 else 0.0
        between = _between(one[:2], other[:2], float(share), apart)
        if isinstance(between, str):
            away = abs(float(clock[near] - at))
            notes.append(
                f"The exposure at {written} is that of the nearest record, {found.names[near]}, {away:.3g} s away: "
                f"{between}."
            )
            each.append(_at(found.exposure(near)[1], at))
        else:
            widest = max(widest, apart)
            each.append(between)
    if widest:
        notes.insert(0, f"Poses are interpolated linearly between neighbouring records, {widest:.3g} s apart at most.")
    notes.append(f"Times are counted from the earliest record of the file{_utc_shown(found, start)}.")
    rows = np.array(nearest)
    sensor, sources = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], (found.sensor, found.sources))
    shots = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *each)
    return dataclasses.replace(
        found,
        names=np.array([_name(one, at - start) for one, at in zip(times, seconds, strict=True)]),
        sensor=sensor,
        shots=shots,
        sources=sources,
        assumed=(*found.assumed, *notes),
        reported=None if found.reported is None else _reported(found.reported, rows),
        above_takeoff=None if found.above_takeoff is None else found.above_takeoff[rows],
        tags=tuple(found.tags[k] for k in nearest) if found.tags else (),
    )


def _seconds(found: Acquisition, written: str | float, start: float) -> float:
    """A time by the clock of the shots."""
    if not isinstance(written, str):
        return start + float(written)
    text = written.strip()
    clock = CLOCK.fullmatch(text)
    if clock is not None:
        minutes, last = int(clock[2]), float(clock[3].replace(",", "."))  # subtitles have commas
        if last < 60.0 and (clock[1] is None or minutes < 60):
            return start + 3600.0 * int(clock[1] or 0) + 60.0 * minutes + last
    number = number_in(text)
    if number is not None:
        return start + number
    try:
        moment = datetime.datetime.fromisoformat(text)
    except ValueError:
        raise TableError(f'{found.path}: times="{text}" is none of {FORMS}.') from None
    if moment.tzinfo is None:
        raise TableError(f'{found.path}: times="{text}" has no time zone; write {text}Z if it is UTC.')
    if not found.time_is_utc:
        raise TableError(f'{found.path}: times="{text}" is in UTC, but the times of the file are not; give {OFFSETS}.')
    return moment.timestamp()


def _check_inside(found: Acquisition, written: str | float, at: float, clock: np.ndarray, start: float) -> None:
    low, high = float(clock.min()), float(clock.max())
    if not low - SAME <= at <= high + SAME:
        times = "" if not found.time_is_utc else f" ({utc_text(low)} to {utc_text(high)})"
        raise TableError(
            f'{found.path}: times="{written}" is outside the file; its exposures are from {_shown(low - start)} to '
            f"{_shown(high - start)}{times}."
        )


def _between(before: tuple[Any, Shot], after: tuple[Any, Shot], share: float, apart: float) -> Shot | str:
    """A shot between two of (sensor, shot), `apart` seconds from each other; or why there is none."""
    (sensor, one), (sensor_after, other) = before, after
    if apart > LONGEST:
        return f"its neighbours are {apart:.3g} s apart, more than {LONGEST:g} s"
    if not _are_mounted_alike(sensor, sensor_after):
        return "its neighbours are of cameras that are not mounted alike"
    angles = [np.array([*_angles(shot), *np.atleast_1d(shot.gimbal_readings)], np.float64) for shot in (one, other)]
    turn = (angles[1] - angles[0] + np.pi) % (2.0 * np.pi) - np.pi
    if np.any(np.abs(turn) > LARGEST_TURN):
        most, limit = (math.degrees(float(angle)) for angle in (np.max(np.abs(turn)), LARGEST_TURN))
        return f"between its neighbours an angle turns by {most:.3g} deg, more than {limit:.0f}"
    heading, pitch, roll, *readings = angles[0] + share * turn
    lat, height = (float(a + share * (b - a)) for a, b in zip(_place(one), _place(other), strict=True))
    east = (float(other.pose.position.lon) - float(one.pose.position.lon) + np.pi) % (2.0 * np.pi) - np.pi
    position = Geodetic(lat=lat, lon=float(one.pose.position.lon) + share * east, height=height)
    time = float(one.time) + share * (float(other.time) - float(one.time))
    return Shot(Pose(position, heading, pitch, roll), np.array(readings), time)


def _angles(shot: Shot) -> tuple[float, float, float]:
    return float(shot.pose.heading), float(shot.pose.pitch), float(shot.pose.roll)


def _place(shot: Shot) -> tuple[float, float]:
    return float(shot.pose.position.lat), float(shot.pose.position.height)


def _at(shot: Shot, time: float) -> Shot:
    return dataclasses.replace(shot, time=np.float64(time))


def _are_mounted_alike(one: Any, other: Any) -> bool:
    """Whether two sensors have one mount and gimbal; focal lengths change with the zoom, and by steps of telemetry."""
    if one is None or other is None:
        return one is other
    pairs = zip(*(jax.tree.leaves((sensor.gimbal, sensor.mount)) for sensor in (one, other)), strict=True)
    return all(np.array_equal(*pair) for pair in pairs)


def _reported(reported: Reported, rows: np.ndarray) -> Reported:
    return Reported(jax.tree.map(lambda leaf: np.asarray(leaf)[rows], reported.centre), reported.slant_range[rows])


def _name(written: str | float, seconds: float) -> str:
    is_utc = isinstance(written, str) and ("T" in written or "-" in written[1:])
    return str(written).strip() if is_utc else _shown(seconds)


def _shown(seconds: float) -> str:
    """HH:MM:SS, with thousandths if there are any."""
    thousandths = math.floor(1e3 * abs(seconds) + 0.5)
    whole, rest = divmod(thousandths, 1000)
    sign = "-" if seconds < 0.0 and thousandths else ""
    fraction = f".{rest:03d}".rstrip("0") if rest else ""
    return f"{sign}{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}{fraction}"


def _utc_shown(found: Acquisition, start: float) -> str:
    return f", {utc_text(start)}" if found.time_is_utc else ""
