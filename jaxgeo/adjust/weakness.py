"""Directions in which a block is not held, or hardly, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy  # loads its parts when they are asked for

from jaxgeo.adjust.datum import MOTIONS
from jaxgeo.adjust.equations import Equations, Problem
from jaxgeo.adjust.problem import Prepared
from jaxgeo.adjust.reduction import Reduced, back_substituted, eliminate, eliminated, gather, reduced
from jaxgeo.adjust.solve import Solution
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


def reduced_at(problem: Problem, equations: Equations) -> Reduced:
    """The reduced normal equations, not damped."""
    none = jnp.zeros(())
    return _reduced(problem, equations, gather(problem, eliminate(problem, equations, none)), none)


@eqx.filter_jit
def _reduced(problem: Problem, equations: Equations, rows: Any, damping: Any) -> Reduced:
    return reduced(problem, equations, rows, damping)


@eqx.filter_jit
def _points_along(problem: Any, equations: Any, vector: Any) -> Any:
    """How points follow a change of the reduced unknowns, over their own standard deviations (3, rows)."""
    points = eliminated(problem, equations, 0.0)
    points = eqx.tree_at(lambda p: p.forward, points, jnp.zeros_like(points.forward))
    images = vector[: problem.n * problem.of_image].reshape(problem.n, problem.of_image)
    along = back_substituted(problem, points, images, vector[problem.n * problem.of_image :])
    return along * jnp.sqrt(jnp.diagonal(equations.points, axis1=0, axis2=1).T) * problem.free_point.T


def weakest(ready: Prepared, solution: Solution, most: int) -> list[Direction]:
    """The combinations of unknowns that the normal equations hold least, the weakest first."""
    problem, names = ready.problem, ready.names
    system = np.asarray(reduced_at(problem, solution.equations).matrix)
    scale = 1.0 / np.sqrt(np.diagonal(system))
    scaled = system * scale[:, None] * scale[None, :]
    few = min(most, len(scaled))
    strengths, vectors = scipy.linalg.eigh(scaled, subset_by_index=[0, few - 1])
    diagonals = [
        np.diagonal(np.asarray(x), axis1=-2, axis2=-1) for x in (solution.equations.images, solution.equations.shared)
    ]
    weights = np.sqrt(np.concatenate([x.ravel() for x in diagonals]))
    own = names.lens if problem.own_lens else ()
    found = []
    for strength, vector in zip(strengths, vectors.T, strict=True):
        change = scale * vector
        points = np.asarray(_points_along(problem, solution.equations, jnp.asarray(change))).T[ready.order.row_of_point]
        parts, N = change * weights, problem.n * problem.of_image
        images = parts[:N].reshape(problem.n, problem.of_image)
        found.append(described(float(strength), images, parts[N:], points, (own, names.columns(problem))))
    return found


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
