"""Velocities along the axes of a wander frame, turned to north-east-down and held against the positions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from jaxgeo.earth import WGS84
from jaxgeo.io.acquisitions._applanix import Fields, numbers_of, wrapped
from jaxgeo.io.errors import TableError

# How velocities are compared with the change of the positions: over so many seconds, at so many places; and by how much
# (m/s, and of the speed) they may differ. A frame mistaken for another differs by the speed, a wrong z by the climb.
COMPARED_OVER, COMPARED_AT = 0.2, 500
LARGEST_DIFFERENCE, LARGEST_SHARE = 0.1, 0.003


def velocity_of(
    path: str, records: np.ndarray, clock: np.ndarray, numbers: Fields
) -> tuple[np.ndarray | None, str | None]:
    """(velocities of the picked records in north-east-down, None): held against the positions of all about them.

    None and a remark where all are zero though the positions move.
    """
    pairs = _pairs(clock)
    told = _ned(numbers)
    if pairs is None:
        return told, "Velocities could not be compared with positions: there is one record."
    before, after = (numbers_of(path, records, pair) for pair in pairs)
    moved = _displacement(before, after) / (clock[pairs[1]] - clock[pairs[0]])[:, None]
    speed = float(np.median(np.linalg.norm(moved, axis=-1)))
    allowed = LARGEST_DIFFERENCE + LARGEST_SHARE * speed

    def difference(frame: Callable[[Fields], np.ndarray]) -> float:
        return float(np.median(np.linalg.norm(0.5 * (frame(before) + frame(after)) - moved, axis=-1)))

    if difference(_ned) <= allowed:
        return told, None
    if not np.any(told) and not np.any(_ned(before)):
        return None, "Velocities are zero throughout though the positions move; they are taken as unknown."
    fitting = [words for words, frame in OTHER_FRAMES.items() if difference(frame) <= allowed]
    guess = f" They fit if taken as {fitting[0]}." if fitting else ""
    raise TableError(
        f"{path}: velocities turned from the wander frame differ by {difference(_ned):.3g} m/s from the change of the "
        f"positions, at {speed:.3g} m/s (medians).{guess} Export the file as the format has it; velocities=False reads "
        f"it without them, but if the wander angle is the reason, headings are wrong too."
    )


def _pairs(clock: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Places in a list of times, and those some time later."""
    if len(clock) < 2:
        return None
    step = max(1, min(len(clock) - 1, round(COMPARED_OVER / float(np.median(np.diff(clock))))))
    start = np.unique(np.linspace(0, len(clock) - 1 - step, COMPARED_AT).astype(int))
    return start, start + step


def _ned(numbers: Fields, sign: float = 1.0) -> np.ndarray:
    """Velocities in north-east-down (n, 3): the x axis of the wander frame lies the wander angle left of north."""
    sin, cos = np.sin(sign * numbers["wander"]), np.cos(numbers["wander"])
    x, y, z = (numbers[f"velocity_{axis}"] for axis in "xyz")
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)


def _along_ned(numbers: Fields) -> np.ndarray:
    return np.stack([numbers[f"velocity_{axis}"] for axis in "xyz"], axis=-1)


UPWARDS = np.array([1.0, 1.0, -1.0])
OTHER_FRAMES: dict[str, Callable[[Fields], np.ndarray]] = {
    "z upwards": lambda numbers: _ned(numbers) * UPWARDS,
    "north, east and down, not turned by the wander angle": _along_ned,
    "north, east and up, not turned by the wander angle": lambda numbers: _along_ned(numbers) * UPWARDS,
    "east, north and up": lambda numbers: _along_ned(numbers)[:, [1, 0, 2]] * UPWARDS,
    "turned by the wander angle the other way": lambda numbers: _ned(numbers, -1.0),
}


def _displacement(before: Fields, after: Fields) -> np.ndarray:
    """From one place to a near one, north-east-down in m (n, 3)."""
    lat, height = (0.5 * (before[name] + after[name]) for name in ("lat", "height"))
    w2 = 1.0 - WGS84.e2 * np.sin(lat) ** 2
    meridian, vertical = WGS84.a * (1.0 - WGS84.e2) / w2**1.5, WGS84.a / np.sqrt(w2)
    north = (meridian + height) * (after["lat"] - before["lat"])
    east = (vertical + height) * np.cos(lat) * wrapped(after["lon"] - before["lon"])
    return np.stack([north, east, before["height"] - after["height"]], axis=-1)
