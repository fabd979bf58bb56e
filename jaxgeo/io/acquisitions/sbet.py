"""Smoothed trajectories of inertial navigation: SBET files of Applanix and others, and their files of errors."""

from __future__ import annotations

import os
import pathlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.io._csv import POSE_COLUMNS
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError, VerticalDatumError
from jaxgeo.io.navigation import WEEK
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.sensor import Pose, Shot, Trajectory
from jaxgeo.uncertainty.sources import Attitude, Position

# Numbers of a record, all float64, little-endian. Velocities are along the axes of the wander frame; what turns the
# body is not used: the file does not say whether against the Earth or the stars.
FIELDS = (
    "time", "lat", "lon", "height", "velocity_x", "velocity_y", "velocity_z", "roll", "pitch", "platform_heading",
    "wander", "acceleration_x", "acceleration_y", "acceleration_z", "rate_x", "rate_y", "rate_z",
)  # fmt: skip
ERROR_FIELDS = (
    "time", "north", "east", "down", "velocity_north", "velocity_east", "velocity_down", "roll", "pitch", "heading",
)  # fmt: skip
TURN = 2.0 * np.pi
ARC_MINUTE = np.pi / 10_800.0
_HEIGHTS = POSE_COLUMNS["height_m"][:2]
# Lowest and highest value of what is used, and its unit; a heading or a wander angle may have gone round twice.
LIMITS = {
    "lat": (-np.pi / 2, np.pi / 2, "rad"),
    "lon": (-TURN, TURN, "rad"),
    "height": (*_HEIGHTS, "m"),
    "velocity_x": (-2e4, 2e4, "m/s"),
    "velocity_y": (-2e4, 2e4, "m/s"),
    "velocity_z": (-2e4, 2e4, "m/s"),
    "roll": (-np.pi, np.pi, "rad"),
    "pitch": (-np.pi / 2, np.pi / 2, "rad"),
    "platform_heading": (-2.0 * TURN, 2.0 * TURN, "rad"),
    "wander": (-2.0 * TURN, 2.0 * TURN, "rad"),
}
LARGEST_ERRORS = {"m": 1e5, "arc minutes": 10_800.0}
NEW_WEEK = 60.0  # s of the end of a week that may be missing where a clock begins anew
GAP = 10.0  # times the median interval of a file of errors: a longer one is a gap
# How velocities are compared with the change of the positions: over so many seconds, at so many places; and by how much
# (m/s, and of the speed) they may differ. A frame mistaken for another differs by the speed, a wrong z by the climb.
COMPARED_OVER, COMPARED_AT = 0.2, 500
LARGEST_DIFFERENCE, LARGEST_SHARE = 0.1, 0.003

Fields = dict[str, np.ndarray]


@dataclass(frozen=True)
class SbetRecords:
    """n records of a trajectory, in their order: `number` of each in the file from 0, `times` in s, `poses`.

    Heights are above the ellipsoid, angles in rad. `velocity_ned` (n, 3) in m/s over the ground is None where the file
    has none or the caller does not want it, `position_sigma` north, east, down (n, 3) in m and `attitude_sigma`
    heading, pitch, roll (n, 3) in rad without a file of errors.
    """

    path: str
    number: np.ndarray
    times: np.ndarray
    poses: Pose
    velocity_ned: np.ndarray | None = None
    position_sigma: np.ndarray | None = None
    attitude_sigma: np.ndarray | None = None
    assumed: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    time_is_utc: bool = False

    def __len__(self) -> int:
        return len(self.times)

    @property
    def sources(self) -> tuple[Position | Attitude, ...]:
        """The stated errors of each record; none without a file of errors."""
        if self.position_sigma is None or self.attitude_sigma is None:
            return ()
        return _sources(self.position_sigma, self.attitude_sigma)

    def acquisition(self) -> Acquisition:
        """Each record as an exposure of no camera, named by its number in the file."""
        shots = Shot(self.poses, np.zeros((len(self), 0)), self.times)
        return Acquisition(
            path=self.path,
            form="SBET",
            names=self.number.astype(f"U{len(str(self.number[-1]))}"),
            sensor=None,
            shots=shots,
            sources=self.sources,
            assumed=self.assumed,
            facts=self.facts,
            time_is_utc=self.time_is_utc,
        )

    def trajectory(self, *, longest_gap: float | None = None) -> Trajectory:
        """The trajectory through the records, with their velocities.

        `longest_gap` in s between two records; ten median intervals if left out. Raises `TableError`, naming the
        record, for fewer than two, gaps, and turns too large to tell their direction.
        """
        if len(self) < 2:
            raise TableError(f"{self.path}: one record only; a trajectory needs two or more.")
        try:
            return Trajectory.from_knots(
                self.times, self.poses, velocity_ned=self.velocity_ned, longest_gap=longest_gap
            )
        except ValueError as error:
            words = re.sub(r"\bknot (\d+)", lambda knot: f"record {self.number[int(knot[1])]}", str(error))
            raise TableError(f"{self.path}: {words.replace('knots', 'records')}") from error

    def sources_at(self, times: Any) -> tuple[Position, Attitude]:
        """The stated errors at m times in s (m,), linearly between the records.

        Raises `ValueError` for times outside them, and without a file of errors.
        """
        if self.position_sigma is None or self.attitude_sigma is None:
            raise ValueError(f"{self.path}: it was read without errors=, its file of errors (smrmsg).")
        times = np.atleast_1d(np.asarray(times, np.float64))
        outside = ~((times >= self.times[0]) & (times <= self.times[-1]))
        if np.any(outside):
            raise ValueError(
                f"{self.path}: {times[outside][0]:.9g} s is outside its records, {self.times[0]:.9g} to "
                f"{self.times[-1]:.9g} s."
            )
        return _sources(*(_between(times, self.times, s) for s in (self.position_sigma, self.attitude_sigma)))


def read_sbet(
    path: str | os.PathLike[str],
    *,
    errors: str | os.PathLike[str] | None = None,
    between: tuple[float, float] | None = None,
    every: float | None = None,
    velocities: bool = True,
    height_datum: str | float = "ellipsoid",
    clock_zero: float | None = None,
) -> SbetRecords:
    """The records of an SBET file (smoothed best estimate of trajectory): 17 little-endian float64 each, no header.

    The true heading is the platform heading less the wander angle: the x axis of the wander frame lies that angle
    left of north, y to its right, z down. Velocities, that are along these axes, are turned to north-east-down, and
    compared with the change of the positions. Longitudes and headings come in [-pi, pi]. The file is mapped, not read
    into memory: of a long one, take a part.

    - `errors`: the file of errors that belongs to it (smrmsg: 10 float64 a record; position in m, roll, pitch and
      heading in arc minutes), linearly between its records.
    - `between`: first and last time in s, by the file's clock: with the record before and the one after.
    - `every`: the least time in s from one record to the next; the others are left out, but for the last.
    - `velocities`: False leaves them out; a trajectory then goes by the positions alone.
    - `height_datum`: what heights are measured from: the format says the ellipsoid, but a program may have been told
      to write others; as in scene files.
    - `clock_zero`: when the file's clock was at zero, in s since 1970 in UTC, which is added to all times: for seconds
      of week w of GPS, 315964800 + 604800 w, less the leap seconds (18 since 2017).

    A clock that begins anew with the week of GPS is carried on. Raises `TableError`, naming the record, for a file of
    another length, values that are out of range or of another unit or byte order, times that do not increase, `between`
    that the file does not cover, velocities that are not those of the positions, and errors that are zero, negative or
    do not cover the records; `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    path = os.fspath(path)
    records = _mapped(path, "SBET", FIELDS)
    _check_kind(path, records)
    clock, carried_on = _clock(path, records)
    first, last = _part(path, clock, between)
    picked = _thinned(path, clock, first, last, every)
    numbers = _numbers(path, records, picked)
    velocity, remark = None, "Velocities of the file are left out, as asked."
    if velocities:
        velocity, remark = _velocity(path, records[first:last], clock[first:last], numbers)
    heading = _wrapped(numbers["platform_heading"] - numbers["wander"])
    lat, lon = numbers["lat"], _wrapped(numbers["lon"])
    height = _heights(path, lat, lon, numbers["height"], height_datum)
    position_sigma, attitude_sigma = (None, None) if errors is None else _errors_at(errors, path, clock[picked])
    return SbetRecords(
        path=path,
        number=picked,
        times=clock[picked] + (0.0 if clock_zero is None else clock_zero),
        poses=Pose(Geodetic(lat=lat, lon=lon, height=height), heading, numbers["pitch"], numbers["roll"]),
        velocity_ned=velocity,
        position_sigma=position_sigma,
        attitude_sigma=attitude_sigma,
        assumed=_assumed(errors is not None, clock_zero, carried_on, remark),
        facts=_facts(clock, picked),
        time_is_utc=clock_zero is not None,
    )


def _mapped(path: str, what: str, fields: tuple[str, ...]) -> np.ndarray:
    """The records of a file (n, fields), that stay on disk."""
    width = 8 * len(fields)
    try:
        if pathlib.Path(path).is_dir():
            raise TableError(f"{path}: this is a folder; give the {what} file in it.")
        size = pathlib.Path(path).stat().st_size
        if size and not size % width:
            return np.memmap(path, "<f8", "r").reshape(-1, len(fields))
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such {what} file.") from None
    except OSError as error:
        raise TableError(f"{path}: the {what} file cannot be read: {error}.") from error
    if not size:
        raise TableError(f"{path}: the file is empty.")
    others = {"an SBET file": 8 * len(FIELDS), "a file of its errors, smrmsg": 8 * len(ERROR_FIELDS)}
    other = next((name for name, other in others.items() if other != width and not size % other), None)
    why = f"is it {other}?" if other else "the file is cut off, or no such file; copy or export it again."
    raise TableError(
        f"{path}: {size} bytes are {size // width} records of {what} ({width} bytes each) and {size % width} bytes "
        f"more; {why}"
    )


def _check_kind(path: str, records: np.ndarray) -> None:
    """Raises `TableError` for a first record that is none of an SBET, saying what it is as far as that shows."""
    first = np.array(records[0])
    if _plausible(first):
        return
    if _plausible(first.byteswap()):
        raise TableError(
            f"{path}: its numbers are big-endian, but those of an SBET are little-endian; write them anew: "
            f"numpy.fromfile(path, '>f8').astype('<f8').tofile(other)."
        )
    degrees = first.copy()
    degrees[[1, 2, 7, 8, 9, 10]] *= np.pi / 180.0
    if _plausible(degrees) and abs(first[1]) > np.pi / 2:
        raise TableError(
            f"{path}, record 0: latitude {first[1]:.9g} and longitude {first[2]:.9g} look like degrees; angles of an "
            f"SBET are in rad. Export it again."
        )


def _plausible(record: np.ndarray) -> bool:
    with np.errstate(invalid="ignore"):
        used = all(low <= record[FIELDS.index(name)] <= high for name, (low, high, _) in LIMITS.items())
        # a float64 read in the wrong byte order is often as good as zero: no place, and no rest, is
        tiny = np.any((record != 0.0) & (np.abs(record) < 1e-100))
        return bool(used and not tiny and np.isfinite(record[0]))


def _clock(path: str, records: np.ndarray) -> tuple[np.ndarray, bool]:
    """The times of all records in s, and whether a new week was carried on."""
    times = np.array(records[:, 0])
    known = np.isfinite(times) & (np.abs(times) <= 1e11)
    if not np.all(known):
        number = int(np.argmin(known))
        raise TableError(f"{path}, record {number}: time is {times[number]:.9g} s; the file is damaged, or none.")
    steps = np.diff(times)
    back = np.flatnonzero(steps <= 0.0)
    carried_on = len(back) == 1 and bool(0.0 < steps[back[0]] + WEEK <= NEW_WEEK)
    if carried_on:
        times[back[0] + 1 :] += WEEK
    elif len(back):
        number = int(back[0]) + 1
        how = "time stands still" if steps[back[0]] == 0.0 else "time running backwards"
        raise TableError(
            f"{path}, records {number - 1} and {number}: {how}, from {times[number - 1]:.9g} s to "
            f"{times[number]:.9g} s; sort the records and drop those that are there twice."
        )
    return times, carried_on


def _part(path: str, clock: np.ndarray, between: tuple[float, float] | None) -> tuple[int, int]:
    """The first record, and the one after the last."""
    if between is None:
        return 0, len(clock)
    start, end = (float(time) for time in between)
    if not start <= end:
        raise ValueError(f"{path}: between must be first and last time in s; got {start:.9g} and {end:.9g}.")
    if start < clock[0] or end > clock[-1]:
        raise TableError(
            f"{path}: it covers {clock[0]:.9g} to {clock[-1]:.9g} s, but between={start:.9g} to {end:.9g} s is asked "
            f"for. Are both by one clock? Those of an SBET are seconds of the GPS week, or of UTC."
        )
    first = int(np.searchsorted(clock, start, side="right")) - 1
    return max(first, 0), int(np.searchsorted(clock, end, side="left")) + 1


def _thinned(path: str, clock: np.ndarray, first: int, last: int, every: float | None) -> np.ndarray:
    """The numbers of the records to be taken."""
    numbers = np.arange(first, last)
    if every is None:
        return numbers
    if not every > 0.0:
        raise ValueError(f"{path}: every must be above 0 s; got {every:.9g}.")
    slot = np.floor((clock[first:last] - clock[first]) / every + 1e-6)  # of times that are some us off their beat
    kept = np.diff(slot, prepend=-1.0) > 0.0
    kept[-1] = True
    return numbers[kept]


def _numbers(path: str, records: np.ndarray, picked: np.ndarray) -> Fields:
    """The fields in use of some records, in range."""
    rows = np.asarray(records[picked])
    numbers = {name: np.array(rows[:, FIELDS.index(name)], np.float64) for name in LIMITS}
    for name, (low, high, unit) in LIMITS.items():
        fine = (numbers[name] >= low) & (numbers[name] <= high)  # NaN is not
        if not np.all(fine):
            row = int(np.argmin(fine))
            raise TableError(
                f"{path}, record {picked[row]}: {name} is {numbers[name][row]:.9g}, outside [{low:.6g}, {high:.6g}] "
                f"{unit}; the file is damaged, or no SBET."
            )
    return numbers


def _velocity(
    path: str, records: np.ndarray, clock: np.ndarray, numbers: Fields
) -> tuple[np.ndarray | None, str | None]:
    """(velocities of the picked records in north-east-down, None): held against the positions of all about them.

    None and a remark where all are zero though the positions move.
    """
    pairs = _pairs(clock)
    told = _ned(numbers)
    if pairs is None:
        return told, "Velocities could not be compared with positions: there is one record."
    before, after = (_numbers(path, records, pair) for pair in pairs)
    moved = _displacement(before, after) / (clock[pairs[1]] - clock[pairs[0]])[:, None]
    speed = float(np.median(np.linalg.norm(moved, axis=-1)))
    allowed = LARGEST_DIFFERENCE + LARGEST_SHARE * speed

    def difference(frame: Callable[[Fields], np.ndarray]) -> float:
        return float(np.median(np.linalg.norm(0.5 * (frame(before) + frame(after)) - moved, axis=-1)))

    if difference(_ned) <= allowed:
        return told, None
    if not np.any(told) and not np.any(_ned(before)):
        return None, "Velocities are zero throughout though the positions move; they are taken as unknown."
    fitting = [words for words, frame in OTHER_FRAMES.items() if difference(frame) <= allowed]
    guess = f" They fit if taken as {fitting[0]}." if fitting else ""
    raise TableError(
        f"{path}: velocities turned from the wander frame differ by {difference(_ned):.3g} m/s from the change of the "
        f"positions, at {speed:.3g} m/s (medians).{guess} Export the file as the format has it; velocities=False reads "
        f"it without them, but if the wander angle is the reason, headings are wrong too."
    )


def _pairs(clock: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Places in a list of times, and those some time later."""
    if len(clock) < 2:
        return None
    step = max(1, min(len(clock) - 1, round(COMPARED_OVER / float(np.median(np.diff(clock))))))
    start = np.unique(np.linspace(0, len(clock) - 1 - step, COMPARED_AT).astype(int))
    return start, start + step


def _ned(numbers: Fields, sign: float = 1.0) -> np.ndarray:
    """Velocities in north-east-down (n, 3): the x axis of the wander frame lies the wander angle left of north."""
    sin, cos = np.sin(sign * numbers["wander"]), np.cos(numbers["wander"])
    x, y, z = (numbers[f"velocity_{axis}"] for axis in "xyz")
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)


def _along_ned(numbers: Fields) -> np.ndarray:
    return np.stack([numbers[f"velocity_{axis}"] for axis in "xyz"], axis=-1)


UPWARDS = np.array([1.0, 1.0, -1.0])
OTHER_FRAMES: dict[str, Callable[[Fields], np.ndarray]] = {
    "z upwards": lambda numbers: _ned(numbers) * UPWARDS,
    "north, east and down, not turned by the wander angle": _along_ned,
    "north, east and up, not turned by the wander angle": lambda numbers: _along_ned(numbers) * UPWARDS,
    "east, north and up": lambda numbers: _along_ned(numbers)[:, [1, 0, 2]] * UPWARDS,
    "turned by the wander angle the other way": lambda numbers: _ned(numbers, -1.0),
}


def _displacement(before: Fields, after: Fields) -> np.ndarray:
    """From one place to a near one, north-east-down in m (n, 3)."""
    lat, height = (0.5 * (before[name] + after[name]) for name in ("lat", "height"))
    w2 = 1.0 - WGS84.e2 * np.sin(lat) ** 2
    meridian, vertical = WGS84.a * (1.0 - WGS84.e2) / w2**1.5, WGS84.a / np.sqrt(w2)
    north = (meridian + height) * (after["lat"] - before["lat"])
    east = (vertical + height) * np.cos(lat) * _wrapped(after["lon"] - before["lon"])
    return np.stack([north, east, before["height"] - after["height"]], axis=-1)


def _heights(path: str, lat: np.ndarray, lon: np.ndarray, height: np.ndarray, datum: str | float) -> np.ndarray:
    try:
        return ellipsoidal_heights(np.rad2deg(lon), np.rad2deg(lat), height, datum)
    except VerticalDatumError as error:  # there it is an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except ValueError as error:  # the datum's grid does not reach
        raise TableError(f"{path}: {error}") from error


def _errors_at(path: str | os.PathLike[str], of: str, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(position north, east, down in m (n, 3), heading, pitch, roll in rad (n, 3)) of a file of errors at times."""
    path = os.fspath(path)
    records = _mapped(path, "smrmsg", ERROR_FIELDS)
    clock, _ = _clock(path, records)
    interval = float(np.median(np.diff(clock))) if len(clock) > 1 else 0.0
    if times[0] < clock[0] - interval or times[-1] > clock[-1] + interval:  # it may begin on the next full second
        raise TableError(
            f"{path}: it covers {clock[0]:.9g} to {clock[-1]:.9g} s, but the records of {of} that are read "
            f"{times[0]:.9g} to {times[-1]:.9g} s. Do the two files belong together?"
        )
    first = max(int(np.searchsorted(clock, times[0], side="right")) - 1, 0)
    last = min(int(np.searchsorted(clock, times[-1], side="left")) + 1, len(clock))
    gaps = np.diff(clock[first:last]) > GAP * interval
    if np.any(gaps):
        number = first + int(np.argmax(gaps))
        raise TableError(
            f"{path}, records {number} and {number + 1}: nothing from {clock[number]:.9g} to {clock[number + 1]:.9g} "
            f"s; read the parts before and after with between=."
        )
    values: dict[str, np.ndarray] = {}
    for name in ("north", "east", "down", "heading", "pitch", "roll"):
        unit = "m" if name in ("north", "east", "down") else "arc minutes"
        column = np.array(records[first:last, ERROR_FIELDS.index(name)])
        fine = (column > 0.0) & (column <= LARGEST_ERRORS[unit])
        if not np.all(fine):
            row = int(np.argmin(fine))
            raise TableError(
                f"{path}, record {first + row}: the error of {name} is {column[row]:.9g} {unit}; expected a standard "
                f"deviation above 0, up to {LARGEST_ERRORS[unit]:g}. Is it the smrmsg file?"
            )
        values[name] = np.interp(times, clock[first:last], column)
    position = np.stack([values[name] for name in ("north", "east", "down")], axis=-1)
    attitude = np.stack([values[name] for name in ("heading", "pitch", "roll")], axis=-1)
    return position, attitude * ARC_MINUTE


def _sources(position: np.ndarray, attitude: np.ndarray) -> tuple[Position, Attitude]:
    """The errors of n records from their standard deviations, (n, 3) each."""
    made = jax.vmap(Position)(position), jax.vmap(Attitude)(attitude)
    return jax.tree.map(np.asarray, made)


def _between(times: np.ndarray, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(times, knots, column) for column in values.T], axis=-1)


def _assumed(errors: bool, clock_zero: float | None, carried_on: bool, remark: str | None) -> tuple[str, ...]:
    said = [
        "Positions are of WGS 84: the file does not name its datum (NAD83, for one, lies up to 2 m off).",
        "Position and attitude are those of one body: the file does not name the point that its program reduced it to.",
        "Attitude is against the ellipsoid's normal, without deflection of the vertical.",
    ]
    if clock_zero is None:
        said.append("Times are by the clock of the file, which it does not name: seconds of the GPS week, or of UTC.")
    if carried_on:
        said.append("The clock began anew with the week: what is after counts on beyond 604800 s.")
    if errors:
        said.append("Errors of one record are independent of the next's: the file states none of their correlations.")
    else:
        said.append("How large errors are is not in the file; its smrmsg says so.")
    return (*said, *([remark] if remark else ()))


def _facts(clock: np.ndarray, picked: np.ndarray) -> dict[str, str]:
    facts = {"records": f"{len(clock)}", "from": f"{clock[0]:.3f} s", "to": f"{clock[-1]:.3f} s"}
    if len(clock) > 1:
        facts["rate"] = f"{1.0 / float(np.median(np.diff(clock))):.4g} Hz"
    if len(picked) < len(clock):
        facts["read"] = f"{len(picked)} records, {clock[picked[0]]:.3f} to {clock[picked[-1]]:.3f} s"
    return facts


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """An angle in rad brought into [-pi, pi]."""
    return angle - TURN * np.round(angle / TURN)
