"""Which change of one printed digit of Table 2 of Li et al. (2023) brings a target nearest to the printed one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jaxgeo.studies.li2023 import printed
from jaxgeo.studies.li2023.equations import A, B, ecef_as_printed, near_range, sight_as_printed

DIGITS = 4  # behind the point, in all of Table 2
NEAR = 10.0  # m: the plain's target lies so far off as it is printed
QUANTITIES = ("lat", "lon", "outer", "inner")  # that differ between the rows; the others would move all targets


@dataclass(frozen=True)
class Misprint:
    """A quantity of a row with one digit changed, and how far from the printed target (m) it then comes down."""

    terrain: str
    quantity: str
    printed: float
    changed: float
    miss: float


def misses() -> dict[str, float]:
    """How far (m) each row's target lies off the printed one, as it is printed."""
    return {name: _miss(row) for name, row in printed.TERRAINS.items()}


def one_digit(name: str) -> list[Misprint]:
    """Each change of one digit, or the sign, of what stands in one row alone that meets the ground, nearest first."""
    row = printed.TERRAINS[name]
    found = []
    for quantity in QUANTITIES:
        value = getattr(row, quantity)
        for changed in _changed(value):
            miss = _miss(row._replace(**{quantity: changed}))
            found.append(Misprint(name, quantity, value, changed, miss))
    return sorted((one for one in found if np.isfinite(one.miss)), key=lambda one: one.miss)


def _changed(value: float) -> Iterator[float]:
    text = f"{value:.{DIGITS}f}"
    for place, old in enumerate(text):
        if old.isdigit():
            for new in "0123456789":
                if new != old:
                    yield float(text[:place] + new + text[place + 1 :])
    yield -value


def _miss(row: printed.Terrain) -> float:
    """Distance in m between the point met at the printed height and the printed target; NaN for none."""
    origin, direction = ecef_as_printed(row.lat, row.lon, printed.ALTITUDE), sight_as_printed(row)
    axes = np.array([A, A, B]) + row.target[2]  # to 6 mm in height
    point = origin + near_range(origin / axes, direction / axes) * direction
    return float(np.linalg.norm(point - ecef_as_printed(*row.target)))
