"""Geodetic position: latitude, longitude and ellipsoidal height."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import (
    as_float64,
    by_numpy_if_known,
    check_finite,
    check_is,
    check_range,
    concrete,
    is_known,
    require_x64,
)
from jaxgeo._record import Record
from jaxgeo._typing import ScalarField

LARGEST = {"lat": 0.5 * math.pi, "lon": 2.0 * math.pi}  # rad
STEP = 1e-3  # rad beyond its range that a number may lie, as of a difference quotient at a pole


class Geodetic(Record):
    """A point near the ellipsoid: latitude and longitude in rad, height above the ellipsoid in m.

    Raises `ValueError` for concrete latitudes beyond a pole and longitudes beyond +-2 pi; the usual cause is degrees.

    >>> summit = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=2450.0)
    >>> print(f"{summit.lat:.6f} rad, {summit.height} m")
    0.820305 rad, 2450.0 m
    >>> print(*np.round(summit.to_degrees(), 9))
    47.0 11.0 2450.0
    """

    _: KW_ONLY
    lat: ScalarField
    lon: ScalarField
    height: ScalarField

    def __check_init__(self) -> None:
        for name, largest in LARGEST.items():
            for leaf in jax.tree.leaves(getattr(self, name)):
                value = _farthest(leaf)
                if value is not None and abs(value) > largest + STEP:
                    raise ValueError(self._in_degrees(name, value))

    def _in_degrees(self, name: str, value: float) -> str:
        """Error message for a latitude or longitude beyond its range."""
        most = "pi/2 rad of the equator" if name == "lat" else "2 pi rad of Greenwich"
        given = [getattr(self, part) for part in ("lat", "lon", "height")]
        call = "Geodetic.from_degrees"
        if all(_farthest(one) is not None and np.ndim(one) == 0 for one in given):
            lat, lon, height = map(float, given)
            if abs(lat) <= 90.0 and abs(lon) <= 360.0:
                call = f"jaxgeo.Geodetic.from_degrees(lat={lat!r}, lon={lon!r}, height={height!r})"
        return f"{name} must lie within {most}; got {value:.9g}. Geodetic takes radians; {call} takes degrees."

    @classmethod
    def from_degrees(cls, *, lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> Geodetic:
        """Geodetic position from degrees and m; inputs may have batch axes.

        Raises `ValueError` for a latitude outside [-90, 90], a longitude outside [-360, 360] or a height that is not
        finite; `RuntimeError` with 64-bit floats off; `TypeError` for float32.
        """
        check_range(lat, "lat", "deg", -90.0, 90.0)
        check_range(lon, "lon", "deg", -360.0, 360.0)
        check_finite(height, "height", "m above the ellipsoid")
        given = as_float64((lat, lon, height), "Geodetic.from_degrees(lat, lon, height)")
        lat, lon, height = (jnp.stack(x) if isinstance(x, list | tuple) else x for x in given)
        lat, lon = by_numpy_if_known(lambda xp, lat, lon: (xp.deg2rad(lat), xp.deg2rad(lon)), lat, lon)
        return cls(lat=lat, lon=lon, height=height)

    def to_degrees(self) -> tuple[ScalarField, ScalarField, ScalarField]:
        """(lat, lon, height) in deg, deg, m."""
        require_x64()
        return jnp.rad2deg(self.lat), jnp.rad2deg(self.lon), self.height


def _farthest(value: Any) -> float | None:
    """The concrete number that is largest in size, with its sign; None for traced values and for other things."""
    if isinstance(value, float | int):
        return float(value)
    if not isinstance(value, np.generic | np.ndarray | jax.Array):
        return None
    if is_known(value) and isinstance(value, jax.Array) and not value.is_fully_addressable:
        return None
    known = concrete(value)
    if known is None or not known.size or known.dtype.kind not in "fiu":
        return None
    low, high = float(np.fmin.reduce(known, axis=None)), float(np.fmax.reduce(known, axis=None))
    return high if high >= -low else low


def check_position(position: Any, name: str) -> None:
    """Raise `TypeError` unless an argument is a position."""
    make = "Make one with jaxgeo.Geodetic.from_degrees(lat=, lon=, height=)."
    own = f"Give {name}.position." if isinstance(getattr(position, "position", None), Geodetic) else make
    check_is(position, Geodetic, name, own)


def checked_position(position: Any, name: str) -> Geodetic:
    """A position in float64; raises `TypeError` for anything else."""
    check_position(position, name)
    return as_float64(position, name)
