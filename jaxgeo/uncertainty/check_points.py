"""Surveyed check points and their pixels, for the comparison of stated with actual errors."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxgeo._checks import check_is, require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.observation import Observation
from jaxgeo.sensor import Shot


@dataclasses.dataclass(frozen=True)
class CheckPoints:
    """n measured pixels of surveyed points; a point may be measured in several images.

    - `observation`: its pixels `uv` (n, 2) and its shots (or the times of a trajectory) have a leading axis of n; the
      sensor has one too, or is the same for all.
    - `position` (n,): surveyed position of the point of each pixel.
    - `sigma_enu`: standard deviations of the survey in m, east, north, up: a number, (3,) or (n, 3).
    - `sigma_px`: standard deviation of the measured pixel along columns and rows: a number, (2,) or (n, 2); None if the
      error model has a `PixelMeasurement`.
    - `points` (n,): names. Pixels of one name are of one point, whose survey error they share. Default: all different.
    - `images` and `flights` (n,): names or numbers, for errors that are common to an image or a flight. Default: every
      pixel in an image of its own, all in one flight.

    Raises `ValueError` for other shapes, no points, sigmas that are not positive, and a position that is not finite.
    """

    observation: Observation
    position: Geodetic
    sigma_enu: Any
    sigma_px: Any = None
    points: Any = None
    images: Any = None
    flights: Any = None

    def __post_init__(self) -> None:
        require_x64()
        check_is(self.observation, Observation, "observation", "Its pixels have a leading axis.")
        check_is(self.position, Geodetic, "position")
        uv = np.shape(self.observation.uv)
        if len(uv) != 2 or uv[1] != 2 or uv[0] < 1:
            raise ValueError(f"observation.uv must be pixels of shape (n, 2) with n from 1 on; got shape {uv}.")
        count = uv[0]
        place = np.stack(np.broadcast_arrays(*(np.asarray(x, np.float64) for x in self._place())))
        if place.shape != (3, count):
            raise ValueError(f"position must hold a point for each of the {count} pixels; got shape {place.shape[1:]}.")
        names = self._names("points", count, np.array([f"{k}" for k in range(count)]))
        lost = ~np.isfinite(place).all(axis=0)
        if lost.any():
            raise ValueError(f"position of point {names[np.argmax(lost)]} is not finite; leave the point out.")
        set_ = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        set_("points", names)
        set_("images", self._names("images", count, np.arange(count)))
        set_("flights", self._names("flights", count, np.zeros(count, int)))
        set_("sigma_enu", _sigmas(self.sigma_enu, "sigma_enu", "m", names, 3))
        if self.sigma_px is not None:
            set_("sigma_px", _sigmas(self.sigma_px, "sigma_px", "pixels", names, 2))
        self._check_one_place(place)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(point, image, flight) of each pixel as integers, equal for equal names."""
        found = [np.unique(names, return_inverse=True)[1] for names in (self.points, self.images, self.flights)]
        return found[0], found[1], found[2]

    @property
    def times(self) -> np.ndarray:
        """Time of each exposure in s."""
        motion, time = self.observation.exposure.motion, self.observation.exposure.time
        given = motion.time if isinstance(motion, Shot) else 0.0 if time is None else time
        return np.broadcast_to(np.asarray(given, np.float64), (len(self),))

    def _place(self) -> tuple[Any, Any, Any]:
        return self.position.lat, self.position.lon, self.position.height

    def _names(self, name: str, count: int, default: np.ndarray) -> np.ndarray:
        given = getattr(self, name)
        if given is None:
            return default
        names = np.asarray(given)
        if names.shape != (count,):
            raise ValueError(f"{name} must name each of the {count} pixels; got shape {names.shape}.")
        return names

    def _check_one_place(self, place: np.ndarray) -> None:
        """Raise `ValueError` if pixels of one name have several positions."""
        _, first, each = np.unique(self.points, return_index=True, return_inverse=True)
        apart = np.any(place != place[:, first[each]], axis=0)
        if apart.any():
            raise ValueError(f"point {self.points[np.argmax(apart)]} has two positions; name them differently.")


def _sigmas(given: Any, name: str, unit: str, points: np.ndarray, axes: int) -> np.ndarray:
    values = np.asarray(given, np.float64)
    if values.shape not in ((), (axes,), (len(points), axes)):
        raise ValueError(
            f"{name} must be a number, ({axes},) or ({len(points)}, {axes}) in {unit}; got {values.shape}."
        )
    values = np.broadcast_to(values, (len(points), axes))
    wrong = ~(np.isfinite(values) & (values > 0.0))
    if wrong.any():
        row, axis = np.argwhere(wrong)[0]
        raise ValueError(
            f"{name} of point {points[row]} must be positive and finite, in {unit}; got {values[row, axis]:g}. A "
            "measurement without any error has no test."
        )
    return values
