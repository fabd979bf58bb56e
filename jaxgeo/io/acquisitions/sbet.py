"""SBET files (smoothed inertial trajectories) of Applanix and others, and their error files."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io.acquisitions._applanix import FIELDS, LIMITS, clock_of, mapped, numbers_of, wrapped
from jaxgeo.io.acquisitions._smrmsg import errors_at
from jaxgeo.io.acquisitions._wander import Velocities, velocity_of
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.sensor import Pose, Shot, Trajectory
from jaxgeo.uncertainty.sources import Attitude, Position


@dataclass(frozen=True)
class SbetRecords:
    """n records of a trajectory, in their order: `number` of each in the file from 0, `times` in s, `poses`.

    Heights are above the ellipsoid, angles in rad. `velocity_ned` (n, 3) in m/s over the ground is None if missing or
    not requested. `position_sigma` north, east, down (n, 3) in m and `attitude_sigma` heading, pitch, roll (n, 3) in
    rad are None without an error file.
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
        """The stated errors of each record; none without an error file."""
        if self.position_sigma is None or self.attitude_sigma is None:
            return ()
        return _sources(self.position_sigma, self.attitude_sigma)

    def acquisition(self) -> Acquisition:
        """Each record as an exposure without a camera, named by its number in the file."""
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

        `longest_gap` in s between two records; by default ten median intervals. Raises `TableError`, naming the
        record, for fewer than two records, gaps, and rotations too large to be unambiguous.
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
        """The stated errors at m times in s (m,), linearly interpolated between records.

        Raises `ValueError` for times outside the records, and without an error file.
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
    """Read an SBET file (smoothed best estimate of trajectory): records of 17 little-endian float64, no header.

    The true heading is the platform heading minus the wander angle w: the x axis of the wander frame is rotated by w
    to the left of north. Its y axis is left of x (west), z is up, as Applanix writes velocities:
    north = x cos w - y sin w, east = -x sin w - y cos w, down = -z. Velocities are compared with position differences;
    other programs write y to the right and z down, which is used if only that matches, and noted in `assumed`.
    Longitudes and headings are in [-pi, pi]. The file is memory-mapped: of a long one, read a part.

    - `errors`: its error file (smrmsg: 10 float64 per record; position in m, roll, pitch and
      heading in arc minutes), linearly interpolated.
    - `between`: first and last time in s, by the file's clock, including the record before and the one after.
    - `every`: the minimum interval in s between records; others are left out, except the last.
    - `velocities`: False leaves them out; a trajectory then uses the positions alone.
    - `height_datum`: datum of the heights: the format specifies the ellipsoid, but programs can be configured
      otherwise; as in scene files.
    - `clock_zero`: the zero of the file's clock, in s since 1970 in UTC, which is added to all times: for seconds
      of GPS week w, 315964800 + 604800 w minus the leap seconds (18 since 2017).

    A clock that restarts with the GPS week is unwrapped. Raises `TableError`, naming the record, for a file of
    another length, values that are out of range or of another unit or byte order, times that do not increase, `between`
    outside the file, velocities that contradict the positions, and errors that are zero, negative or
    do not cover the records; `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    path = os.fspath(path)
    records = mapped(path, "SBET", FIELDS)
    _check_kind(path, records)
    clock, carried_on = clock_of(path, records)
    first, last = _part(path, clock, between)
    picked = _thinned(path, clock, first, last, every)
    numbers = numbers_of(path, records, picked)
    velocity = Velocities(None, None, "Velocities of the file are left out, as asked.")
    if velocities:
        velocity = velocity_of(path, records[first:last], clock[first:last], numbers)
    heading = wrapped(numbers["platform_heading"] - numbers["wander"])
    lat, lon = numbers["lat"], wrapped(numbers["lon"])
    height = _heights(path, lat, lon, numbers["height"], height_datum)
    position_sigma, attitude_sigma = (None, None) if errors is None else errors_at(errors, path, clock[picked])
    return SbetRecords(
        path=path,
        number=picked,
        times=clock[picked] + (0.0 if clock_zero is None else clock_zero),
        poses=Pose(Geodetic(lat=lat, lon=lon, height=height), heading, numbers["pitch"], numbers["roll"]),
        velocity_ned=velocity.ned,
        position_sigma=position_sigma,
        attitude_sigma=attitude_sigma,
        assumed=_assumed(errors is not None, clock_zero, carried_on, velocity.remark),
        facts=_facts(clock, picked, velocity.fact),
        time_is_utc=clock_zero is not None,
    )


def _check_kind(path: str, records: np.ndarray) -> None:
    """Raises `TableError` if the first record is not of an SBET, naming the likely content."""
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
        # float64 in the wrong byte order are often nearly zero; real values are exactly zero or far larger
        tiny = np.any((record != 0.0) & (np.abs(record) < 1e-100))
        return bool(used and not tiny and np.isfinite(record[0]))


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
    """The numbers of the selected records."""
    numbers = np.arange(first, last)
    if every is None:
        return numbers
    if not every > 0.0:
        raise ValueError(f"{path}: every must be above 0 s; got {every:.9g}.")
    slot = np.floor((clock[first:last] - clock[first]) / every + 1e-6)  # tolerates times that are some us off
    kept = np.diff(slot, prepend=-1.0) > 0.0
    kept[-1] = True
    return numbers[kept]


def _heights(path: str, lat: np.ndarray, lon: np.ndarray, height: np.ndarray, datum: str | float) -> np.ndarray:
    try:
        return ellipsoidal_heights(np.rad2deg(lon), np.rad2deg(lat), height, datum)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error


def _sources(position: np.ndarray, attitude: np.ndarray) -> tuple[Position, Attitude]:
    """The error sources of n records from their standard deviations, (n, 3) each."""
    made = jax.vmap(Position)(position), jax.vmap(Attitude)(attitude)
    return jax.tree.map(np.asarray, made)


def _between(times: np.ndarray, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(times, knots, column) for column in values.T], axis=-1)


def _assumed(errors: bool, clock_zero: float | None, carried_on: bool, remark: str | None) -> tuple[str, ...]:
    said = [
        "Positions are of WGS 84: the file does not name its datum (NAD83, for one, lies up to 2 m off).",
        "Position and attitude are those of one body: the file does not name the point that its program reduced it to.",
        "Attitude is relative to the ellipsoid normal (deflection of the vertical ignored).",
    ]
    if clock_zero is None:
        said.append("Times are by the clock of the file, which it does not name: seconds of the GPS week, or of UTC.")
    if carried_on:
        said.append("The clock began anew with the week: what is after counts on beyond 604800 s.")
    if errors:
        said.append("Errors of one record are independent of the next's: the file states none of their correlations.")
    else:
        said.append("No accuracies in the file; its smrmsg has them.")
    return (*said, *([remark] if remark else ()))


def _facts(clock: np.ndarray, picked: np.ndarray, velocities: str | None) -> dict[str, str]:
    facts = {"records": f"{len(clock)}", "from": f"{clock[0]:.3f} s", "to": f"{clock[-1]:.3f} s"}
    if len(clock) > 1:
        facts["rate"] = f"{1.0 / float(np.median(np.diff(clock))):.4g} Hz"
    if len(picked) < len(clock):
        facts["read"] = f"{len(picked)} records, {clock[picked[0]]:.3f} to {clock[picked[-1]]:.3f} s"
    if velocities is not None:
        facts["velocities"] = velocities
    return facts
