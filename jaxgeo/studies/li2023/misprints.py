"""Single-digit changes in Table 2 of Li et al. (2023) that bring a target closest to the printed one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jaxgeo.studies.li2023 import printed
from jaxgeo.studies.li2023.equations import A, B, ecef_as_printed, near_range, sight_as_printed

DIGITS = 4  # decimals, in all of Table 2
NEAR = 10.0  # m: offset of the plain's target with the printed values
QUANTITIES = ("lat", "lon", "outer", "inner")  # differ between the rows; the others would move all targets


@dataclass(frozen=True)
class Misprint:
    """A quantity of a row with one digit changed, and the distance (m) from the located to the printed target."""

    terrain: str
    quantity: str
    printed: float
    changed: float
    miss: float


def misses() -> dict[str, float]:
    """Distance (m) of each row's target from the printed one, with the printed values."""
    return {name: _miss(row) for name, row in printed.TERRAINS.items()}


def one_digit(name: str) -> list[Misprint]:
    """Every one-digit or sign change of a row's own quantities that gives a ground intersection, closest first."""
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
    """Distance in m from the point located at the printed height to the printed target; NaN without one."""
    origin, direction = ecef_as_printed(row.lat, row.lon, printed.ALTITUDE), sight_as_printed(row)
    axes = np.array([A, A, B]) + row.target[2]  # to 6 mm in height
    point = origin + near_range(origin / axes, direction / axes) * direction
    return float(np.linalg.norm(point - ecef_as_printed(*row.target)))
