"""Replacement of image positions by those of a table, joined by name, number or time."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
import pyproj

from jaxgeo._checks import check_is, require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io.acquisitions._image_cameras import span_shown
from jaxgeo.io.acquisitions._marks import Marks, marks_beside, moved
from jaxgeo.io.acquisitions._position_tables import ANTENNA, MOVED, PositionTable, read_positions
from jaxgeo.io.acquisitions._tracks import at_times, no_utc
from jaxgeo.io.acquisitions.drone_images import AXES, CAMERA_CLOCK, NO_ACCURACY, NO_TIME, POSITIONS
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.acquisitions.sentences import DOUBT
from jaxgeo.io.errors import TableError
from jaxgeo.uncertainty.sources import Position

NUMBER = re.compile(r"(?<!\d)(\d{4})(?!\d)")  # photo number in a name: DJI_0001.JPG, DJI_20230615124530_0001_V.JPG
FAR = 1000.0  # m between an image's own position and the table's: beyond it is another flight
FAR_UP = 200.0  # m between the two heights: more than the undulation of the geoid and the error of a barometer
LATE = 1.0  # s: tolerance between an image and its mark when joined by time
SPREAD = 10.0  # s: allowed spread of clock differences when joined by number
EARTH_RADIUS = 6.371e6  # m
OF_MARKS = "Times are those of the marks in {}, in UTC."
PLACED = ("Positions are the antenna's", "Positions are the camera's")  # sentences of tables that say what they are of


def with_positions(
    found: Acquisition,
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
) -> Acquisition:
    """Exposures with positions and position errors from a file instead of their own.

    Supported are OpenDroneMap's `geo.txt` and report `shots.geojson`, DJI's `Timestamp.MRK`, RTKLIB's solutions
    (`.pos`, latitude, longitude and height), and tables with the columns of `read_orientations` for names and
    positions, including `sigma_north_m`, `sigma_east_m`, `sigma_down_m`. Names match with or without their extension,
    in any case; marks match images by the four digits in the name, else by time in UTC. Solutions of RTKLIB match by
    time in UTC (GPS time less its leap seconds): epochs at a receiver's even times are interpolated, others (camera
    events) are those of images up to 1 s away; the positions are the antenna's, without a lever arm. With DJI's marks
    (one file `.MRK`) beside the images or beside the solutions, they match at the times of the marks, by the four
    digits in the names of the images, and positions are moved from the antenna to the camera by the marks' offsets.
    Times of marks in UTC replace those of a camera's clock without a time zone.
    Exposures that are missing in the file are left out, and named in `assumed`. If it has no heights, those of the
    exposures are kept.

    - `height_datum`: datum of the file's heights, unless the file states it, as marks do.
    - `crs`: the CRS of its positions, if they are projected and the file does not state it.

    Raises `UnstatedDatum`; `TableError` if the file has none of the exposures, and for a position more than 1 km from
    that in the image, or higher or lower by as much (from 200 m on a sentence in `assumed`); as the readers.
    """
    require_x64()
    check_is(found, Acquisition, "found")
    return with_table(found, read_positions(path, height_datum=height_datum, crs=crs))


def with_table(found: Acquisition, table: PositionTable) -> Acquisition:
    """As `with_positions`, for positions already read."""
    is_track, marks = table.is_track, _marks_of(found, table)
    offset, timed = np.zeros((len(found), 3)), found
    if marks is not None:
        timed, offset = _marked(found, marks)
        at_camera = MOVED.format(os.path.basename(marks.path))
        table = dataclasses.replace(table, assumed=tuple(at_camera if one == ANTENNA else one for one in table.assumed))
    table = at_times(timed, table) if is_track else table
    rows, by = _joined(timed, table)
    by = f"{'time' if is_track else by}{'' if marks is None else ' of marks'}"
    kept = np.flatnonzero(rows >= 0)
    if not len(kept):
        raise TableError(_none_joined(timed, table))
    _check_clocks(found, table, kept, rows[kept])
    doubts = _check_near(found, table, kept, rows[kept])
    pick = rows[kept]
    own = found.sensor, found.shots, found.sources, found.reported, found.above_takeoff
    sensor, shots, sources, reported, above_takeoff = jax.tree.map(lambda leaf: np.asarray(leaf)[kept], own)
    height = table.position.height[pick] if table.has_heights else shots.pose.position.height
    position = Geodetic(lat=table.position.lat[pick], lon=table.position.lon[pick], height=height)
    position = position if marks is None else moved(position, offset[kept])
    time, clock = _times(found, timed, table, kept, pick, marks)
    shots = dataclasses.replace(shots, pose=dataclasses.replace(shots.pose, position=position), time=time)
    others = tuple(source for source in sources if not isinstance(source, Position))
    if table.sigma is not None:
        others = (jax.tree.map(np.asarray, jax.vmap(Position)(table.sigma[pick])), *others)
    return dataclasses.replace(
        found,
        names=found.names[kept],
        sensor=sensor,
        shots=shots,
        sources=others,
        reported=reported,
        above_takeoff=above_takeoff,
        tags=tuple(found.tags[k] for k in kept) if found.tags else (),
        assumed=(*_of_images(found, table, clock), *table.assumed, *clock, *_notes(found, table, kept, pick), *doubts),
        facts=_facts(found, table, kept, pick, by),
        time_is_utc=found.time_is_utc or bool(clock),
        camera_time=np.asarray(found.shots.time)[kept] if clock else None,
    )


def check_one_flight(images: Sequence[Acquisition], table: PositionTable) -> None:
    """Raises `TableError` if the times of images read one by one and of a table are not of one flight, or if two
    images share a number. Images joined by name or by time need no check."""
    images = [_by_own_clock(one) for one in images]
    if table.names is None and table.numbers is None:
        by_folder: dict[str, list[Acquisition]] = {}
        for one in images:
            by_folder.setdefault(os.path.dirname(one.path), []).append(one)
        for some in by_folder.values():
            marks = _marks_of(some[0], table)
            if marks is not None and not all(one.time_is_utc for one in some):
                check_one_flight(some, _as_table(marks))
        return
    numbered = [one for one in images if all(map(_numbers_in, one.names))]
    if table.names is not None or len(numbered) < 2:
        return
    each = [one.shots for one in numbered]
    found = dataclasses.replace(
        numbered[0],
        names=np.concatenate([one.names for one in numbered]),
        sensor=None,
        shots=jax.tree.map(lambda *leaves: np.concatenate([np.asarray(leaf) for leaf in leaves]), *each),
        sources=(),
        reported=None,
        tags=(),
    )
    rows, _ = _joined(found, table)
    kept = np.flatnonzero(rows >= 0)
    _check_clocks(found, table, kept, rows[kept])


def _by_own_clock(found: Acquisition) -> Acquisition:
    """Exposures with the times of the camera, where those of marks are in their place."""
    if found.camera_time is None:
        return found
    return dataclasses.replace(
        found, shots=dataclasses.replace(found.shots, time=found.camera_time), time_is_utc=False, camera_time=None
    )


def _joined(found: Acquisition, table: PositionTable) -> tuple[np.ndarray, str]:
    """(table row of each exposure, -1 if missing; the join key)."""
    if table.names is not None:
        return _by_name(found, [str(name) for name in table.names]), "name"
    if table.numbers is None:
        return _by_time(found, table), "time"
    numbers = [_numbers_in(name) for name in found.names]
    if all(numbers):
        row_of = {int(number): row for row, number in enumerate(table.numbers)}
        rows = np.array([row_of.get(int(one[-1]), -1) for one in numbers])
        used = rows[rows >= 0]
        if len(set(used.tolist())) < len(used):
            raise TableError(f"{table.path}: two images have the number of one photo; join one flight at a time.")
        return rows, "number"
    return _by_time(found, table), "time"


def _marks_of(found: Acquisition, table: PositionTable) -> Marks | None:
    """The marks beside images or beside the solutions of a receiver; None for other positions, and if they are of other
    images whose times are known without them."""
    if table.names is not None or table.numbers is not None:
        return None
    marks = marks_beside(found.path, table.path, needed=not found.time_is_utc)
    if marks is None or not found.time_is_utc:
        return marks
    return marks if np.any(_mark_rows(found, _as_table(marks)) >= 0) else None


def _marked(found: Acquisition, marks: Marks) -> tuple[Acquisition, np.ndarray]:
    """(exposures with the times of their marks in UTC, NaN without one; offsets (n, 3) in m from antenna to camera).

    Raises `TableError` if none has a mark with a time, and for marks of another flight.
    """
    table = _as_table(marks)
    rows = _mark_rows(found, table)
    rows = np.where(np.isnan(marks.time[rows]), -1, rows)
    kept = np.flatnonzero(rows >= 0)
    if not len(kept):
        raise TableError(_none_joined(found, table))
    _check_clocks(found, table, kept, rows[kept])
    time = np.where(rows >= 0, marks.time[rows], np.nan)
    shots = dataclasses.replace(found.shots, time=time)
    return dataclasses.replace(found, shots=shots, time_is_utc=True), marks.offset[rows]


def _mark_rows(found: Acquisition, table: PositionTable) -> np.ndarray:
    """The row of the mark of each exposure, -1 if missing: by number, or by time if several images have one number, as
    those of several cameras have, and their times are in UTC. Raises as `_joined`."""
    numbers = [_numbers_in(name)[-1:] for name in found.names]
    is_unique = len({tuple(one) for one in numbers}) == len(numbers)
    return _joined(found, table)[0] if is_unique or not found.time_is_utc else _by_time(found, table)


def _as_table(marks: Marks) -> PositionTable:
    """Marks as a table that images are joined to by number, else by time; its positions are not used."""
    nowhere = np.full(len(marks.numbers), np.nan)
    position = Geodetic(lat=nowhere, lon=nowhere, height=nowhere)
    return PositionTable(marks.path, "DJI marks of photos", None, marks.numbers, position, False, time=marks.time)


def _numbers_in(name: str) -> list[str]:
    """The four-digit numbers in an image name."""
    return NUMBER.findall(os.path.basename(name))


def _by_name(found: Acquisition, names: list[str]) -> np.ndarray:
    rows = np.full(len(found), -1)
    for form in (str, lambda name: os.path.basename(name).lower(), _stem):
        keys: dict[str, list[int]] = {}
        for row, name in enumerate(names):
            keys.setdefault(form(name), []).append(row)
        for k, name in enumerate(found.names):
            matches = keys.get(form(str(name)), [])
            if rows[k] < 0 and len(matches) == 1:
                rows[k] = matches[0]
    return rows


def _stem(name: str) -> str:
    """A name without its folder and image extension, in lower case."""
    return re.sub(r"\.(jpe?g|tiff?|png|dng)$", "", os.path.basename(name).lower())


def _by_time(found: Acquisition, table: PositionTable) -> np.ndarray:
    if table.numbers is None and not found.time_is_utc:
        raise TableError(no_utc(found, table))
    if table.time is None or not found.time_is_utc:
        raise TableError(
            f"{table.path}: photos match by number and time, but {found.path} has no numbers of four digits in its "
            f"names, and no times in UTC."
        )
    apart = np.abs(np.asarray(found.shots.time)[:, None] - table.time[None, :])
    nearest = np.argmin(apart, axis=1)
    return np.where(apart[np.arange(len(nearest)), nearest] <= LATE, nearest, -1)


def _check_clocks(found: Acquisition, table: PositionTable, kept: np.ndarray, rows: np.ndarray) -> None:
    """Raises `TableError` if times show that images and marks of equal numbers are not of one flight."""
    times = np.asarray(found.shots.time)[kept]
    has_time = times > 0.0
    if table.time is None or np.sum(has_time) < 2:
        return
    difference = (times - table.time[rows])[has_time]
    if np.ptp(difference) > SPREAD:
        raise TableError(
            f"{table.path}: times of images and marks differ by {difference.min():.0f} to {difference.max():.0f} s, so "
            f"they are not of one flight; give the marks of the images' own folder."
        )


def _check_near(found: Acquisition, table: PositionTable, kept: np.ndarray, rows: np.ndarray) -> list[str]:
    """A sentence on heights that are far from those in the images. Raises `TableError` for positions of another flight,
    and for heights as far away."""
    own = found.shots.pose.position
    lat, lon = np.asarray(own.lat)[kept], np.asarray(own.lon)[kept]
    north = EARTH_RADIUS * (table.position.lat[rows] - lat)
    turn = np.remainder(table.position.lon[rows] - lon + np.pi, 2.0 * np.pi) - np.pi
    distance = np.hypot(north, EARTH_RADIUS * np.cos(lat) * turn)
    if np.any(distance > FAR):
        k = int(np.argmax(distance))
        raise TableError(
            f"{table.path}: the position of {found.names[kept[k]]} lies {distance[k] / 1e3:.1f} km from that in the "
            f"image; are they of one flight, and longitude and latitude in this order?"
        )
    if not table.has_heights:
        return []
    above = table.position.height[rows] - np.asarray(own.height)[kept]
    k = int(np.argmax(np.abs(above)))
    if abs(above[k]) < FAR_UP:
        return []
    said = (
        f"{table.path}: the position of {found.names[kept[k]]} lies {abs(above[k]):.0f} m "
        f"{'above' if above[k] > 0.0 else 'below'} the altitude in the image; are its heights in m?"
    )
    if abs(above[k]) > FAR:
        raise TableError(said)
    return [f"{DOUBT}{said}"]


def _none_joined(found: Acquisition, table: PositionTable) -> str:
    there: Any = next((one for one in (table.names, table.numbers) if one is not None), None)
    if there is None:
        first, last = (np.datetime64(int(one), "s") for one in (np.min(table.time), np.max(table.time)))  # type: ignore[arg-type]
        times = np.asarray(found.shots.time)
        own = np.datetime64(int(times[int(np.argmax(np.isfinite(times)))]), "s")  # images without a mark have no time
        if len(found) == 1:
            return (
                f"{table.path}: {found.names[0]} was taken at none of its times, {first} to {last} (UTC), but at {own}."
            )
        return f"{table.path}: no image was taken at one of its times, {first} to {last} (UTC); the first is of {own}."
    if len(found) == 1:
        return f"{table.path}: it has no position of {found.names[0]}, but of {_some(np.asarray(there).astype(str))}."
    return (
        f"{table.path}: it has none of the images: they are {_some(found.names)}, and it has "
        f"{_some(np.asarray(there).astype(str))}."
    )


def _times(
    found: Acquisition,
    timed: Acquisition,
    table: PositionTable,
    kept: np.ndarray,
    rows: np.ndarray,
    marks: Marks | None,
) -> tuple[np.ndarray, list[str]]:
    """(times of the images kept, a sentence if they are those of marks in UTC in place of the camera's clock)."""
    own = np.asarray(found.shots.time)[kept]
    if found.time_is_utc:
        return own, []
    if marks is not None:
        return np.asarray(timed.shots.time)[kept], [OF_MARKS.format(os.path.basename(marks.path))]
    if table.numbers is not None and table.time is not None:
        return np.asarray(table.time)[rows], [OF_MARKS.format(os.path.basename(table.path))]
    return own, []


def _of_images(found: Acquisition, table: PositionTable, clock: list[str]) -> list[str]:
    """Assumptions about the images, without those about the replaced positions and times."""
    gone = ["How well the positions", "The errors of position"] + (["Heights are"] if table.has_heights else [])
    gone += [POSITIONS] if any(one.startswith(PLACED) for one in table.assumed) else []
    gone += [CAMERA_CLOCK, NO_TIME] if clock else []
    return [one for one in found.assumed if not one.startswith(tuple(gone)) and NO_ACCURACY not in one]


def _facts(found: Acquisition, table: PositionTable, kept: np.ndarray, rows: np.ndarray, by: str) -> dict[str, str]:
    """Facts of the images, with the errors of the positions that are used. Of an image read alone no count is said: it
    may be one of a folder."""
    count = f"{len(kept)} of {len(found)} images, " if len(found) > 1 else ""
    errors = "not said"
    if table.sigma is not None:
        errors = f"{', '.join(span_shown(column, '.3g') for column in table.sigma[rows].T)} m ({AXES})"
    return {**found.facts, "position errors": errors, "positions": f"{table.form}, {count}by {by}"}


def _notes(found: Acquisition, table: PositionTable, kept: np.ndarray, rows: np.ndarray) -> list[str]:
    notes = [] if table.has_heights else [f"{os.path.basename(table.path)} has no heights: those of the images stay."]
    if table.sigma is None:
        notes.append(f"How well the positions are known is not said by {os.path.basename(table.path)}.")
    missing = [str(name) for k, name in enumerate(found.names) if k not in set(kept.tolist())]
    if missing:
        notes.append(
            f"{len(missing)} of {len(found)} images are not in {os.path.basename(table.path)} and are left out: "
            f"{_some(np.array(missing))}."
        )
    spare = len(np.asarray(table.position.lat)) - len(set(rows.tolist()))
    if spare and len(found) > 1:  # one image is of one row, and a folder may be read image by image
        notes.append(f"{spare} rows of {os.path.basename(table.path)} are of no image here.")
    return notes


def _some(names: np.ndarray) -> str:
    return ", ".join(names[:5].tolist()) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
