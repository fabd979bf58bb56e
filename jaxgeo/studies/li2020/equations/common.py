"""Claims that compare printed formulas with functions of this package, and their inputs.

Angles in rad, lengths in m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxgeo.earth import WGS84
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.li2020 import printed

PAPER = "Li 2020"
EXACT = 1e-9  # relative, for identical formulas
A, B = WGS84.a, WGS84.b
E2 = WGS84.e2

HEIGHTS, THETAS, OMEGAS = (8143.0, 3000.0), (math.radians(74.0), math.radians(50.0)), (math.radians(0.88), 0.1)
LOOKS = list(zip(THETAS, OMEGAS, strict=True))
SCENES = list(zip(HEIGHTS, THETAS, OMEGAS, strict=True))
TURNS = (math.radians(1.0), -math.radians(0.6))
REQUIRED = (0.15, 0.6)
ATTITUDES = ((2.776, 0.0634, 0.0377), (0.5, -0.1, 0.2))  # heading, pitch, roll
ANGLES = ((-math.radians(74.0), -0.02), (0.4, -0.3))  # theta, phi
PLACES = ((0.6085, 1.9113, 8143.0), (-0.9, -2.5, 300.0), (0.2, -0.7, 0.0))  # lat, lon, height
MERIDIAN = math.radians(printed.CENTRAL_MERIDIAN)
MAP_PLACES = ((0.6085, MERIDIAN - 0.026), (1.2, MERIDIAN + 0.02))  # lat, lon, to 1.5 deg
ROUNDS = 4  # of Eq 8
SPEED, SWING, PERIOD = 172.0, 8.6, 20.0  # m/s, m/s and s, of the flight of Eqs 32, 35
FLOWN = (3.0, 5.3)  # s, from and to


def claim(
    number: int | str,
    statement: str,
    wanted: Any,
    obtained: Any,
    function: str,
    *,
    unit: str = "",
    tolerance: float | Sequence[float] | None = None,
    cause: str = "",
    right: Any = None,
    independent: Any = None,
    reason: str = "",
    digits: str = ".5g",
) -> Claim:
    """A claim with numbers, or arrays of them, from the printed formula and from the function at the same inputs.

    A misprint has a `cause`, and the values of the corrected formula (`right`), which must equal those of the function
    and, if given, the `independent` ones.
    """
    shown, found = (_listed(values) for values in (wanted, obtained))
    bounds = _bounds(found, tolerance)
    explanation = None
    if right is not None:
        others = [] if independent is None else [_listed(independent)]
        expected = [value for values in (found, *others) for value in values]
        times = 1 + len(others)
        explanation = Explanation(cause, _listed(right) * times, expected, bounds * times)
    return Claim(
        PAPER,
        number if isinstance(number, str) else f"Eq. {number}",
        statement,
        shown,
        found,
        bounds,
        unit,
        f"jaxgeo.{function}",
        explanation,
        reason,
        digits,
    )


def _listed(values: Any) -> list[float]:
    return [float(value) for value in np.asarray(values, float).ravel()]


def _bounds(values: list[float], tolerance: float | Sequence[float] | None) -> list[float]:
    """One tolerance for each value: as given, or relative to the value."""
    if tolerance is None:
        return [EXACT * max(abs(value), 1e-3) for value in values]
    return [tolerance] * len(values) if isinstance(tolerance, (int, float)) else list(tolerance)


def C_camera_from_aircraft(theta: float, phi: float) -> np.ndarray:
    """Eq 3 as printed: a product of two matrices."""
    inner = np.array([[math.cos(phi), 0.0, -math.sin(phi)], [0.0, 1.0, 0.0], [math.sin(phi), 0.0, math.cos(phi)]])
    outer = np.array(
        [[1.0, 0.0, 0.0], [0.0, math.cos(theta), math.sin(theta)], [0.0, -math.sin(theta), math.cos(theta)]]
    )
    return inner @ outer


def C_aircraft_from_ned(heading: float, pitch: float, roll: float) -> np.ndarray:
    """Eq 4 as printed: by roll alpha, pitch beta and heading lambda."""
    (ca, sa), (cb, sb), (cl, sl) = ((math.cos(x), math.sin(x)) for x in (roll, pitch, heading))
    by_roll = np.array([[1.0, 0.0, 0.0], [0.0, ca, sa], [0.0, -sa, ca]])
    by_pitch = np.array([[cb, 0.0, -sb], [0.0, 1.0, 0.0], [sb, 0.0, cb]])
    by_heading = np.array([[cl, sl, 0.0], [-sl, cl, 0.0], [0.0, 0.0, 1.0]])
    return by_roll @ by_pitch @ by_heading
