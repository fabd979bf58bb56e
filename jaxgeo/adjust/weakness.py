"""Directions in which a block is not held, or hardly, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo.adjust.datum import MOTIONS
from jaxgeo.adjust.values import POSE

SHARE = 0.05  # of the largest part: smaller parts of a direction are not named
AXES = ("east", "north", "height")


@dataclass(frozen=True)
class Direction:
    """A combination of unknowns that can change together, and how little holds it.

    `words` say which; `strength` is the eigenvalue of the normal equations, scaled to ones on their diagonal: below
    1e-12 nothing holds it. `parts` are its largest parts by name, in shares of the largest.
    """

    words: str
    strength: float
    parts: dict[str, float]

    def __str__(self) -> str:
        return self.words


class DeficientBlock(ValueError):
    """The block does not hold some unknowns: `directions` say which."""

    def __init__(self, message: str, directions: list[Direction]) -> None:
        super().__init__(message)
        self.directions = directions


def described(strength: float, images: np.ndarray, shared: np.ndarray, points: np.ndarray, names: Any) -> Direction:
    """A direction in words, from its parts over their own standard deviations with all else known.

    `images` (n, columns), `shared` (s,), `points` (m, 3); `names` are those of the lens columns that images have of
    their own, and of what they share.
    """
    own, others = names
    parts: dict[str, float] = {}
    for axis, name in enumerate(AXES):
        parts[f"{name} of the points"] = _length(points[:, axis])
        parts[f"{name} of the perspective centres"] = _length(images[:, axis])
    parts["attitudes"] = _length(images[:, 3:POSE])
    parts |= {f"{name} of the cameras": _length(images[:, POSE + i]) for i, name in enumerate(own)}
    parts |= {f"{what} of {whose}": abs(float(x)) for (whose, what), x in zip(others, shared, strict=True)}
    largest = max(parts.values())
    named = {name: part / largest for name, part in parts.items() if part > SHARE * largest}
    named = dict(sorted(named.items(), key=lambda item: -item[1]))
    return Direction(" with ".join(list(named)[:4]), strength, named)


def _length(x: np.ndarray) -> float:
    return float(np.sqrt(np.sum(x * x)))


def datum_words(rows: np.ndarray) -> list[str]:
    """Each combination (7,) of motions that nothing holds, in words."""
    found = []
    for row in rows:
        part = np.abs(row) / np.max(np.abs(row))
        chosen = [MOTIONS[i] for i in np.argsort(-part) if part[i] > 0.3]
        found.append(" with ".join(chosen) + " of the whole block")
    return found
