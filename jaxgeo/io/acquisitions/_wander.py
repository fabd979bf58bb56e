"""SBET velocities: wander frame to north-east-down, verified against the positions."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxgeo.earth import WGS84
from jaxgeo.io.acquisitions._applanix import Fields, numbers_of, wrapped
from jaxgeo.io.errors import TableError

# Velocities are compared with position differences over this interval in s, at this number of points, with these
# tolerances (m/s, and share of the speed). A wrong horizontal axis differs by the speed, a wrong z by the climb rate.
COMPARED_OVER, COMPARED_AT = 0.2, 500
LARGEST_DIFFERENCE, LARGEST_SHARE = 0.1, 0.003


class Velocities(NamedTuple):
    """Velocities (n, 3) in m/s north-east-down, None if unknown; a fact about them and a remark, each may be None."""

    ned: np.ndarray | None
    fact: str | None
    remark: str | None


def velocity_of(path: str, records: np.ndarray, clock: np.ndarray, numbers: Fields) -> Velocities:
    """Velocities of the picked records, in the frame that matches the position differences of all `records`.

    That is Applanix's frame, or the one with y right and z down, if only that one matches. Velocities that are all
    zero while the positions move are unknown. Raises `TableError` if neither frame matches, naming one that does.
    """
    applanix, right_down = FRAMES
    pairs = _pairs(clock)
    if pairs is None:
        words = f"Velocities could not be compared with positions (one record): taken {applanix}."
        return Velocities(FRAMES[applanix](numbers), None, words)
    before, after = (numbers_of(path, records, pair) for pair in pairs)
    moved = _displacement(before, after) / (clock[pairs[1]] - clock[pairs[0]])[:, None]
    speed = float(np.median(np.linalg.norm(moved, axis=-1)))
    allowed = LARGEST_DIFFERENCE + LARGEST_SHARE * speed

    def difference(frame: Callable[[Fields], np.ndarray]) -> float:
        return float(np.median(np.linalg.norm(0.5 * (frame(before) + frame(after)) - moved, axis=-1)))

    found = {words: difference(frame) for words, frame in FRAMES.items()}
    best = min(found, key=lambda words: found[words])
    if found[best] > allowed:
        if not any(np.any(one[f"velocity_{axis}"]) for one in (numbers, before) for axis in "xyz"):
            words = "Velocities are zero throughout though the positions move; they are taken as unknown."
            return Velocities(None, None, words)
        fitting = [words for words, frame in OTHER_FRAMES.items() if difference(frame) <= allowed]
        guess = f" They fit if taken as {fitting[0]}." if fitting else ""
        raise TableError(
            f"{path}: velocities turned from the wander frame differ by {found[applanix]:.3g} m/s from the change of "
            f"the positions, at {speed:.3g} m/s (medians).{guess} Export the file as the format has it, or read it "
            f"without velocities: velocities=False; but if the wander angle is the reason, headings are wrong too."
        )
    fact = f"taken {best}; {found[best]:.2g} m/s from the change of the positions (median)"
    if best == applanix or found[applanix] <= allowed:
        return Velocities(FRAMES[best](numbers), fact, None)
    remark = (
        f"Velocities are taken {right_down}: so they fit the positions; {applanix} they differ from them by "
        f"{found[applanix]:.3g} m/s (median)."
    )
    return Velocities(FRAMES[best](numbers), fact, remark)


def _pairs(clock: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Indices of times, and of later times to compare with."""
    if len(clock) < 2:
        return None
    step = max(1, min(len(clock) - 1, round(COMPARED_OVER / float(np.median(np.diff(clock))))))
    start = np.unique(np.linspace(0, len(clock) - 1 - step, COMPARED_AT).astype(int))
    return start, start + step


def _xyz(numbers: Fields) -> tuple[np.ndarray, ...]:
    return tuple(numbers[f"velocity_{axis}"] for axis in "xyz")


def _west_up(numbers: Fields, sign: float = 1.0) -> np.ndarray:
    """Velocities in north-east-down (n, 3), for x the wander angle left of north, y left of x, and z up."""
    sin, cos = np.sin(sign * numbers["wander"]), np.cos(numbers["wander"])
    x, y, z = _xyz(numbers)
    return np.stack([cos * x - sin * y, -sin * x - cos * y, -z], axis=-1)


def _right_down(numbers: Fields) -> np.ndarray:
    """Velocities in north-east-down (n, 3), for x the wander angle left of north, y right of x, and z down."""
    sin, cos = np.sin(numbers["wander"]), np.cos(numbers["wander"])
    x, y, z = _xyz(numbers)
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)


def _along_ned(numbers: Fields) -> np.ndarray:
    return np.stack(_xyz(numbers), axis=-1)


UPWARDS = np.array([1.0, 1.0, -1.0])
FRAMES: dict[str, Callable[[Fields], np.ndarray]] = {
    "along x north, y west and z up of the wander frame, as Applanix writes them": _west_up,
    "along x north, y east and z down of the wander frame": _right_down,
}
OTHER_FRAMES: dict[str, Callable[[Fields], np.ndarray]] = {
    "x north, y west and z down of the wander frame": lambda numbers: _west_up(numbers) * UPWARDS,
    "x north, y east and z up of the wander frame": lambda numbers: _right_down(numbers) * UPWARDS,
    "north, east and down, not turned by the wander angle": _along_ned,
    "north, east and up, not turned by the wander angle": lambda numbers: _along_ned(numbers) * UPWARDS,
    "east, north and up": lambda numbers: _along_ned(numbers)[:, [1, 0, 2]] * UPWARDS,
    "turned by the wander angle the other way": lambda numbers: _west_up(numbers, -1.0),
}


def _displacement(before: Fields, after: Fields) -> np.ndarray:
    """Displacement between nearby positions, north-east-down in m (n, 3)."""
    lat, height = (0.5 * (before[name] + after[name]) for name in ("lat", "height"))
    w2 = 1.0 - WGS84.e2 * np.sin(lat) ** 2
    meridian, vertical = WGS84.a * (1.0 - WGS84.e2) / w2**1.5, WGS84.a / np.sqrt(w2)
    north = (meridian + height) * (after["lat"] - before["lat"])
    east = (vertical + height) * np.cos(lat) * wrapped(after["lon"] - before["lon"])
    return np.stack([north, east, before["height"] - after["height"]], axis=-1)
