"""Single causes that could explain the errors of Li et al. (2023) against a map, and their probability."""

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
DRAWS = 100_000


@dataclass(frozen=True)
class Cause:
    """One quantity with the same error at all three targets, in `unit`: the least-squares fit to the actual errors.

    `errors` in m at plain, hill and mountain with that amount; `left` is the root mean square of the remaining errors,
    and `left_chance` the probability that the other errors of Table 1, drawn anew for each target, leave as much or
    more. `sigma` is the standard deviation that the paper states, in `unit`, and `chance` the probability of an error
    at least as large; None where the paper states no sigma.
    """

    name: str
    unit: str
    amount: float
    errors: np.ndarray
    left: float
    left_chance: float
    sigma: float | None

    @property
    def sigmas(self) -> float | None:
        """The amount in standard deviations."""
        return None if self.sigma is None else self.amount / self.sigma

    @property
    def chance(self) -> float | None:
        """Two-sided probability of an error at least as large."""
        return None if self.sigmas is None else float(2.0 * stats.norm.sf(self.sigmas))


def causes() -> list[Cause]:
    """Each cause alone, by least squares on the three errors: angles, heights, and horizontal position of map or
    aircraft.

    Only magnitudes are printed, so each cause has one unknown, its magnitude. The errors are taken as horizontal, as
    against a map, over level ground at the heights of the printed targets.
    """
    model = presets.li_2023(terrain_height=printed.DEM_SIGMA)
    jacobians, sigmas = [], np.zeros(0)
    for row in printed.TERRAINS.values():
        ground = printed.level_ground(row.target[2])
        found = propagate(printed.sensor(), printed.shot_of(row), printed.UV, ground, model)
        jacobians.append(np.asarray(found.jacobian)[:2])
        sigmas = np.sqrt(np.diag(np.asarray(found.cov_error)))
    errors = sigmas * np.random.default_rng(0).normal(size=(DRAWS, len(jacobians), len(sigmas)))
    parts = np.stack(jacobians)[None] * errors[:, :, None, :]  # draws, targets, east and north, axes of the errors
    table, whole = np.linalg.norm(jacobians, axis=1), parts.sum(axis=-1)

    def cause(name: str, unit: str, by_unit: np.ndarray, axis: int | None = None, scale: float = 1.0) -> Cause:
        actual = np.array([row.actual for row in printed.TERRAINS.values()])
        amount = float(by_unit @ actual / (by_unit @ by_unit))
        left = float(np.sqrt(np.mean((actual - amount * by_unit) ** 2)))
        others = whole if axis is None else whole - parts[..., axis]
        rms = np.sqrt(np.mean(np.sum(others**2, axis=2), axis=1))
        sigma = None if axis is None else float(scale * sigmas[axis])
        return Cause(name, unit, amount, amount * by_unit, left, float(np.mean(rms >= left)), sigma)

    found = [cause(name, "°", table[:, k] * math.radians(1.0), k, math.degrees(1.0)) for k, name in enumerate(ANGLES)]
    last = table.shape[1] - 1
    found.append(cause("height of the elevation model", "m", table[:, last], last))
    found.append(cause("height of the aircraft", "m", table[:, last]))  # the same shift with opposite sign
    found.append(cause("place of the map, the elevation model or the aircraft", "m", np.ones(3)))
    return sorted(found, key=lambda one: one.left)
