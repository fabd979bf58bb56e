"""Which single cause would explain the errors that Li et al. (2023) found against a map, and how likely it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from jaxgeo.studies.li2023 import printed
from jaxgeo.uncertainty import presets, propagate

ANGLES = (
    "heading of the attitude",
    "pitch of the attitude",
    "roll of the attitude",
    "outer frame angle",
    "inner frame angle",
    "heading of the boresight",
    "pitch of the boresight",
    "roll of the boresight",
    "mounting of the outer frame",
    "mounting of the inner frame",
)
"""The axes of the errors of Table 1, in their order."""


@dataclass(frozen=True)
class Cause:
    """One quantity in error by the same amount at all three targets, in `unit`: what fits the actual errors best.

    `errors` in m at plain, hill and mountain with that amount; `left` is the root mean square of what remains of the
    actual ones. `sigma` is the standard deviation that the paper states, in `unit`, and `chance` that of an error as
    large or larger; None where it states none.
    """

    name: str
    unit: str
    amount: float
    errors: np.ndarray
    left: float
    sigma: float | None

    @property
    def sigmas(self) -> float | None:
        """The amount in standard deviations."""
        return None if self.sigma is None else self.amount / self.sigma

    @property
    def chance(self) -> float | None:
        """Of an error of that amount or more, to either side."""
        return None if self.sigmas is None else float(2.0 * stats.norm.sf(self.sigmas))


def causes() -> list[Cause]:
    """Every cause by itself, by least squares on the three errors: angles, heights, and the place of map or aircraft.

    Only magnitudes are printed, so each cause has one unknown, its magnitude. The errors are taken as horizontal, as
    against a map, over level ground at the heights of the printed targets.
    """
    model = presets.li_2023(terrain_height=printed.DEM_SIGMA)
    moved, sigmas = [], np.zeros(0)
    for row in printed.TERRAINS.values():
        ground = printed.level_ground(row.target[2])
        found = propagate(printed.sensor(), printed.shot_of(row), printed.UV, ground, model)
        moved.append(np.linalg.norm(np.asarray(found.jacobian)[:2], axis=0))
        sigmas = np.sqrt(np.diag(np.asarray(found.cov_error)))
    table = np.array(moved)
    found = [
        _cause(name, "°", table[:, k] * math.radians(1.0), math.degrees(sigmas[k])) for k, name in enumerate(ANGLES)
    ]
    found.append(_cause("height of the elevation model", "m", table[:, -1], float(sigmas[-1])))
    found.append(_cause("height of the aircraft", "m", table[:, -1], None))  # the same shift, the other way
    found.append(_cause("place of the map, the elevation model or the aircraft", "m", np.ones(3), None))
    return sorted(found, key=lambda one: one.left)


def _cause(name: str, unit: str, by_unit: np.ndarray, sigma: float | None) -> Cause:
    actual = np.array([row.actual for row in printed.TERRAINS.values()])
    amount = float(by_unit @ actual / (by_unit @ by_unit))
    errors = amount * by_unit
    return Cause(name, unit, amount, errors, float(np.sqrt(np.mean((actual - errors) ** 2))), sigma)
