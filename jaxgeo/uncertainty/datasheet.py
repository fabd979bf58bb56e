"""Words of data sheets as standard deviations and distributions: limits, "2 sigma", CEP, CE90, LE90, SEP, RMS, DRMS.

Each function returns a `Stated` value, which the constructors of error sources take in place of a standard deviation,
in their unit. Words that can be read in several ways need an argument that says which; without it `ValueError` lists
the readings.

>>> from jaxgeo.uncertainty import datasheet, sources
>>> encoder = datasheet.plus_minus(0.1, kind="uniform")
>>> print(f"{encoder.sigma:.4f} {encoder.distribution.words}")
0.0577 uniform
>>> gimbal = sources.GimbalAngles.from_degrees(outer=encoder, inner=datasheet.plus_minus(0.1, kind="normal", sigmas=2))
>>> across, up = datasheet.circular_error(1.5, probability=0.5), datasheet.linear_error(3.0, probability=0.9)
>>> position = sources.Position.from_ned(north=across, east=across, down=up)
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy  # submodules load lazily

from jaxgeo.uncertainty.distributions import AbstractDistribution, Arcsine, Triangular, Uniform

__all__ = ["Stated", "circular_error", "linear_error", "plus_minus", "rms", "spherical_error"]

LEAST = 1e-6  # smaller factors and probabilities are mistakes
LIMITS = {"uniform": (3.0, Uniform), "triangular": (6.0, Triangular), "arcsine": (2.0, Arcsine)}


class Stated(NamedTuple):
    """Standard deviation of an axis, in the unit of the given value, and its distribution; None is normal."""

    sigma: float
    distribution: AbstractDistribution | None = None


def plus_minus(half_width: Any, *, kind: str | None = None, sigmas: Any = None, coverage: Any = None) -> Stated:
    """An accuracy or tolerance "± a": a is `half_width`, in any unit.

    `kind` is "uniform" (limits, all values between them are equally likely), "triangular", "arcsine" (limits of an
    oscillation) or "normal"; the latter needs the number of `sigmas` that a is (1, 2, 3), or the `coverage` of the
    interval, such as 0.95. Raises `ValueError` if it is not said which, with all readings, and for a negative or
    infinite half-width.
    """
    a = _number(half_width, "half_width")
    if kind in LIMITS:
        if sigmas is not None or coverage is not None:
            raise ValueError(f'kind="{kind}" has limits: sigmas and coverage go with kind="normal".')
        square, shape = LIMITS[kind]
        return Stated(a / math.sqrt(square), shape())
    if kind not in (None, "normal"):
        raise ValueError(f"kind must be {', '.join(LIMITS)} or normal; got {kind!r}.")
    if kind is None or (sigmas is None) == (coverage is None):
        readings = [f'kind="{name}": sigma {a / math.sqrt(square):.4g}' for name, (square, _) in LIMITS.items()]
        readings += [f'kind="normal", sigmas={k}: sigma {a / k:.4g}' for k in (1, 2, 3)]
        readings += [f'kind="normal", coverage=0.95: sigma {a / _normal_radius(0.95):.4g}']
        raise ValueError(f"±{a:g} can be read in several ways; say which: {'; '.join(readings)}.")
    if coverage is not None:
        return Stated(a / _normal_radius(_probability(coverage, "coverage")))
    times = _number(sigmas, "sigmas")
    if times < LEAST:
        raise ValueError(f"sigmas must be positive, such as 2 for an accuracy of 2 sigma; got {sigmas!r}.")
    return Stated(a / times)


def circular_error(radius: Any, *, probability: Any = None) -> Stated:
    """Circular error of a horizontal position (CEP: `probability` 0.5, CE90: 0.9), as sigma of each of its two axes.

    The errors of both axes are taken as normal, independent and equal: sigma = r / (-2 ln(1 - p))^(1/2). Raises
    `ValueError` without a probability, outside (0, 1), and for a negative or infinite radius.
    """
    r = _number(radius, "radius")
    if probability is None:
        raise _unsaid(f"A circular error of {r:g}", "CEP", r, _circle_radius)
    return Stated(r / _circle_radius(_probability(probability)))


def linear_error(half_height: Any, *, probability: Any = None) -> Stated:
    """Linear error of a height (LE90: `probability` 0.9), as its sigma: normal, ± `half_height` holds with that
    probability. Raises as `circular_error`.
    """
    r = _number(half_height, "half_height")
    if probability is None:
        raise _unsaid(f"A linear error of {r:g}", "LEP", r, _normal_radius)
    return Stated(r / _normal_radius(_probability(probability)))


def spherical_error(radius: Any, *, probability: Any = None) -> Stated:
    """Spherical error of a position (SEP: `probability` 0.5, SE90: 0.9), as sigma of each of its three axes: normal,
    independent and equal. Raises as `circular_error`.
    """
    r = _number(radius, "radius")
    if probability is None:
        raise _unsaid(f"A spherical error of {r:g}", "SEP", r, _ball_radius)
    return Stated(r / _ball_radius(_probability(probability)))


def rms(value: Any, *, axes: int | None = None, times: Any = 1.0) -> Stated:
    """Root mean square error without bias, as sigma of each axis: of one axis (`axes` 1: sigma itself), of a horizontal
    distance (2: DRMS) or of a distance in space (3: MRSE), of equal axes.

    `times` is 2 for 2DRMS. Raises `ValueError` if it is not said of how many axes, with all readings, and for a
    negative or infinite value.
    """
    a = _number(value, "value")
    factor = _number(times, "times")
    if factor < LEAST:
        raise ValueError(f"times must be positive, such as 2 for 2DRMS; got {times!r}.")
    if axes is None:
        readings = "; ".join(f"axes={n}: sigma {a / factor / math.sqrt(n):.4g} of each axis" for n in (1, 2, 3))
        raise ValueError(
            f"An RMS of {a:g} can be that of one axis, of a distance in the plane or in space: {readings}."
        )
    if axes not in (1, 2, 3):
        raise ValueError(f"axes must be 1, 2 or 3; got {axes!r}.")
    return Stated(a / factor / math.sqrt(axes))


def _unsaid(what: str, median: str, radius: float, radius_of: Any) -> ValueError:
    names = ((0.5, median), (0.683, "68.3 %"), (0.9, "90 %"), (0.95, "95 %"))
    readings = "; ".join(f"probability={p:g} ({name}): sigma {radius / radius_of(p):.4g}" for p, name in names)
    return ValueError(f"{what} holds with some probability; say which: {readings}.")


def _normal_radius(probability: float) -> float:
    return float(scipy.special.ndtri(0.5 + 0.5 * probability))


def _circle_radius(probability: float) -> float:
    return math.sqrt(-2.0 * math.log1p(-probability))


def _ball_radius(probability: float) -> float:
    return math.sqrt(2.0 * float(scipy.special.gammaincinv(1.5, probability)))


def _number(value: Any, name: str) -> float:
    if not isinstance(value, int | float | np.integer | np.floating) or isinstance(value, bool):
        raise TypeError(f"{name} must be a number, without a unit; got {value!r}.")
    if not 0.0 <= value < math.inf:
        raise ValueError(f"{name} must be a finite number of at least 0; got {value!r}.")
    return float(value)


def _probability(value: Any, name: str = "probability") -> float:
    if not isinstance(value, int | float | np.floating) or not LEAST <= value <= 1.0 - LEAST:
        raise ValueError(f"{name} must lie between 0 and 1, such as 0.9; got {value!r}.")
    return float(value)
