"""Looks of one sensor at a target over time, and the checks of their arrays."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from jaxgeo._arguments import check_latitude, checked_air
from jaxgeo._checks import as_array, as_float64, check_is, require_x64
from jaxgeo._record import Record
from jaxgeo.earth import Atmosphere
from jaxgeo.sensor import Sensor, Shot, Trajectory


class Looks(Record):
    """Looks of one sensor on one flight: the pixels `uvs` (looks, 2) = (column, row) of the target in its images.

    `shots` is a `Shot` with a leading axis (looks,), a list of shots, or a `Trajectory` with the `times` of the images
    in s (looks,). For shots `times` are optional: those of the shots by default. All sensors have one clock. Each look
    is an image of its own: errors `PerImage` are independent between looks, errors `PerFlight` are common to the
    looks of this record and independent of those of another record.

    `errors` are further error sources of this sensor alone, besides the errors that `track` gets for all sensors. With
    an `atmosphere`, lines of sight are refracted.
    """

    sensor: Sensor
    shots: Any
    uvs: Any
    times: Any = None
    errors: Any = None
    atmosphere: Atmosphere | None = None

    def __len__(self) -> int:
        return len(self.uvs)


def checked_looks(given: Any) -> tuple[Looks, ...]:
    """The looks of each sensor with arrays in float64, times in s and shots with a leading axis.

    Raises `TypeError` for anything but `Looks` or a list of them, `ValueError` for other shapes, missing times, and
    looks that are not in the order of time.
    """
    require_x64()
    several = tuple(given) if isinstance(given, list | tuple) else (given,)
    if not several:
        raise ValueError("track needs looks; got an empty list.")
    for number, one in enumerate(several):
        hint = "Looks(sensor, shots, uvs) holds those of one sensor."
        check_is(one, Looks, "looks" if one is given else f"looks[{number}]", hint)
    names = ["looks" if one is given else f"looks[{number}]" for number, one in enumerate(several)]
    return tuple(_checked(one, name) for one, name in zip(several, names, strict=True))


def _checked(looks: Looks, name: str) -> Looks:
    check_is(looks.sensor, Sensor, f"{name}.sensor")
    uvs: Any = _numbers(looks.uvs, f"{name}.uvs", "the pixel (column, row) of each look")
    if uvs.ndim != 2 or uvs.shape[1] != 2 or not uvs.shape[0]:
        raise ValueError(
            f"{name}.uvs must be the pixel (column, row) of each look, of shape (looks, 2); got shape {uvs.shape}."
        )
    count = uvs.shape[0]
    shots = _shots(looks.shots, count, name)
    times = _times(looks, shots, count, name)
    sensor = as_float64(looks.sensor, f"{name}.sensor")
    return Looks(sensor, shots, np.asarray(uvs), times, looks.errors, checked_air(looks.atmosphere))


def _numbers(given: Any, name: str, what: str) -> Any:
    """Numbers as a float64 array; raises `TypeError` for anything else."""
    try:
        found = as_float64(as_array(given, name), name)
    except TypeError as error:
        if "float64" in str(error):
            raise
        found = None
    if not hasattr(found, "ndim"):
        raise TypeError(f"{name} must be numbers, {what}; got {given!r}.")
    return found


def _shots(given: Any, count: int, name: str) -> Shot | Trajectory:
    """The trajectory, or the shots with a leading axis on every number."""
    if isinstance(given, list | tuple):
        if len(given) != count:
            raise ValueError(f"{name}.shots must be one for each of the {count} uvs; got {len(given)}.")
        for number, one in enumerate(given):
            check_is(one, Shot, f"{name}.shots[{number}]")
        given = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf, np.float64) for leaf in leaves]), *given)
    if isinstance(given, Trajectory):
        return as_float64(given, f"{name}.shots")
    if not isinstance(given, Shot):
        raise TypeError(
            f"{name}.shots must be a jaxgeo Shot with a leading axis, a list of shots, or a Trajectory; got "
            f"{type(given).__name__}."
        )
    check_latitude(given.pose.position, f"{name}.shots.pose.position")
    shots: Shot = as_float64(given, f"{name}.shots")
    readings = np.asarray(shots.gimbal_readings)
    if readings.ndim > 2 or (readings.ndim == 2 and readings.shape[0] != count):
        raise ValueError(f"{name}.shots.gimbal_readings must have the shape ({count}, axes); got {readings.shape}.")

    def for_each(path: Any, value: Any) -> np.ndarray:
        value = np.asarray(value)
        if value.shape not in ((), (count,)):
            words = f"{name}.shots{jax.tree_util.keystr(path)}"
            raise ValueError(f"{words} must have the shape ({count},), one for each of uvs; got {value.shape}.")
        return np.broadcast_to(value, (count,))

    pose, time = jax.tree_util.tree_map_with_path(for_each, (shots.pose, shots.time))
    return Shot(pose, np.broadcast_to(readings, (count, readings.shape[-1])), time)


def _times(looks: Looks, shots: Shot | Trajectory, count: int, name: str) -> np.ndarray:
    """Times of the looks in s; raises `ValueError` unless they are finite and do not decrease."""
    if looks.times is None and isinstance(shots, Trajectory):
        raise ValueError(f"{name}.times must give the time of each image on the trajectory, in s.")
    if looks.times is None:
        assert isinstance(shots, Shot)
        times = np.asarray(shots.time)
    else:
        times = np.asarray(_numbers(looks.times, f"{name}.times", "the time of each look in s"))
    if times.shape != (count,):
        raise ValueError(f"{name}.times must have the shape ({count},), one for each of uvs; got {times.shape}.")
    if not np.isfinite(times).all():
        number = int(np.argmin(np.isfinite(times)))
        raise ValueError(f"{name}: the time of look {number} must be finite, in s; got {times[number]}.")
    backward = np.diff(times) < 0.0
    if backward.any():
        number = int(np.argmax(backward)) + 1
        raise ValueError(
            f"{name} must be in the order of time: look {number} is at {times[number]:g} s, after look {number - 1} at "
            f"{times[number - 1]:g} s. Sort them by np.argsort(times)."
        )
    return times
