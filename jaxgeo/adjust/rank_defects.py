"""Rank-defect diagnosis: (nearly) unconstrained directions of a block, as text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily
from jaxtyping import Array, Float

from jaxgeo._compile import sized_filter_jit
from jaxgeo._record import portable
from jaxgeo.adjust.arrays import Problem
from jaxgeo.adjust.banded import Factor, Tridiagonal, factored
from jaxgeo.adjust.datum import MOTIONS
from jaxgeo.adjust.equations import Equations
from jaxgeo.adjust.posterior import Datum, held
from jaxgeo.adjust.problem import Prepared
from jaxgeo.adjust.reduction import back_substituted, eliminated, undamped
from jaxgeo.adjust.solve import Solution
from jaxgeo.adjust.values import POSE
from jaxgeo.adjust.weak_datum import Weak, share_left, with_holds

SHARE = 0.05  # of the largest component: smaller components of a direction are not named
MOST = 5  # components named
COMMON = 0.95  # share of a change that one motion of the whole must explain to be named as such
SHIFT = 1e-10  # of the diagonal
AXES = ("east", "north", "height")


Pair: TypeAlias = tuple[np.ndarray, np.ndarray]  # for points and for perspective centres


@dataclass(frozen=True)
class Direction:
    """A combination of unknowns that is (nearly) unconstrained.

    `words` describe it; `strength` is the eigenvalue of the normal equations scaled to a unit diagonal: below 1e-12 it
    is unconstrained. `parts` are its largest components by name, relative to the largest.
    """

    words: str
    strength: float
    parts: dict[str, float]

    def __str__(self) -> str:
        return self.words


@portable
class DeficientBlock(ValueError):
    """Unconstrained unknowns in a block; `directions` describe them."""

    def __init__(self, message: str, directions: list[Direction]) -> None:
        super().__init__(message)
        self.directions = directions


def scaled_at(
    problem: Problem, equations: Equations, datum: Datum | None, weak: Weak | None = None
) -> tuple[Tridiagonal, tuple[Float[Array, "slabs m"], Float[Array, " s"]]]:
    """The undamped reduced normal equations scaled to a unit diagonal, and the scales; with a `weak`ly constrained
    datum, with its motions constrained at some images."""
    matrix = undamped(problem, equations)[1]
    if weak is not None:
        matrix, datum = with_holds(problem, matrix, weak.motions, datum is not None), None
    return _scaled(problem, matrix, datum)


@sized_filter_jit
def _scaled(problem: Problem, matrix: Tridiagonal, datum: Datum | None) -> Any:
    if datum is not None:
        matrix = held(problem, matrix, datum)
    scale = tuple(1.0 / jnp.sqrt(x) for x in matrix.own)
    return matrix.scaled(*scale), scale


@sized_filter_jit
def _shifted(matrix: Tridiagonal) -> Factor:
    """Factor of a scaled system with a small diagonal shift, which makes singular systems regular."""
    diagonal = matrix.diagonal + SHIFT * jnp.eye(matrix.diagonal.shape[1])[None]
    corner = matrix.corner + SHIFT * jnp.eye(matrix.corner.shape[0])
    return factored(Tridiagonal(diagonal, matrix.below, matrix.border, corner))


@sized_filter_jit
def _solved(factor: Factor, column: Float[Array, " N"]) -> Float[Array, " N"]:
    slabs, m, _ = factor.own.shape
    images, shared = column[: slabs * m].reshape(slabs, m, 1), column[slabs * m :][:, None]
    return jnp.concatenate([x.ravel() for x in factor.solve(images, shared)])


def _least(matrix: Tridiagonal, most: int) -> tuple[np.ndarray, np.ndarray]:
    """(smallest eigenvalues (k,) of a scaled system, eigenvectors (k, N) slab by slab)."""
    slabs, m, s = matrix.border.shape
    few = min(most, slabs * m + s)
    if slabs == 1:
        own, border, corner = (np.asarray(x) for x in (matrix.diagonal[0], matrix.border[0], matrix.corner))
        whole = np.block([[own, border], [border.T, corner]]) if s else own
        found = scipy.linalg.eigh(whole, subset_by_index=[0, few - 1])
    else:  # Lanczos on the inverse
        factor, size = _shifted(matrix), slabs * m + s
        inverse = scipy.sparse.linalg.LinearOperator(
            (size, size), matvec=lambda x: np.asarray(_solved(factor, jnp.asarray(x.ravel()))), dtype=np.float64
        )
        values, vectors = scipy.sparse.linalg.eigsh(inverse, few, which="LM", v0=np.ones(size))
        order = np.argsort(-values)
        found = 1.0 / values[order] - SHIFT, vectors[:, order]
    return found[0], found[1].T


@sized_filter_jit
def _points_along(problem: Problem, equations: Equations, images: Any, shared: Any) -> Any:
    """Changes of the points for a change of the reduced unknowns (3, rows), m."""
    points = eliminated(problem, equations, 0.0)
    points = eqx.tree_at(lambda p: p.forward, points, jnp.zeros_like(points.forward))
    return back_substituted(problem, points, images, shared) * problem.free_point.T


def weakest_directions(
    ready: Prepared, solution: Solution, most: int, datum: Datum | None = None, weak: Weak | None = None
) -> list[Direction]:
    """The combinations of unknowns least constrained by the normal equations and a `datum`, the weakest first.

    With a `weak`ly constrained datum, its motions are rated by their marginal relative to their own weight.
    """
    problem, equations = ready.problem, solution.equations
    matrix, (scale, scale_shared) = scaled_at(problem, equations, datum, weak)
    strengths, vectors = _least(matrix, most)
    found = []
    for strength, vector in zip(strengths, vectors, strict=True):
        change, shared = jnp.asarray(vector[: scale.size]).reshape(scale.shape) * scale, vector[scale.size :]
        of_images = problem.layout.band.of_images(change)
        points = np.asarray(_points_along(problem, equations, of_images, jnp.asarray(shared) * scale_shared))
        own = np.abs(shared) / np.max(np.abs(vector))
        found.append(_described(ready, solution, float(strength), (np.asarray(of_images), own, points)))
    if weak is not None:
        for strength, vector in zip(*share_left(weak), strict=True):
            parts = weak.apart.images, weak.apart.shared / scale_shared[None], weak.apart.points
            images, shared, points = (np.asarray(jnp.tensordot(vector, part, 1)) for part in parts)
            largest = np.max(np.abs(shared), initial=0.0)
            own = np.abs(shared) / (largest if largest > 0.0 else 1.0)
            found.append(_described(ready, solution, float(strength), (images, own, points)))
    return sorted(found, key=lambda direction: direction.strength)[:most]


def _described(
    ready: Prepared, solution: Solution, strength: float, change: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> Direction:
    """A direction from its changes of images (n, c) and shared parameters (s,), relative to the largest scaled
    change, and of points (3, rows)."""
    problem, names, equations, own = ready.problem, ready.names, solution.equations, ready.order.row_of_point
    images, shared, points = change
    weights = np.sqrt(np.diagonal(np.asarray(equations.images), axis1=-2, axis2=-1))
    of_points = np.sqrt(np.diagonal(np.asarray(equations.points), axis1=0, axis2=1))[own]
    places = np.asarray(solution.values.points)[own], np.asarray(solution.values.centre)
    points = points.T[own]
    # # Shared parameters in units of their marginal weights; being few, they would otherwise be too small.
    shared = shared * max(_length(points * of_points), 1e-300)
    sizes = _Sizes(points * of_points, images * weights, shared)
    parts = sizes.of_parameters(names.lens if problem.own_lens else (), names.columns(problem))
    return _named(strength, sizes.of_motions((points, images[:, :3]), places) | parts)


@dataclass(frozen=True)
class _Sizes:
    """Components of a direction over their conditional standard deviations: points (m, 3), images (n, columns), and
    shared parameters (s,)."""

    points: np.ndarray
    images: np.ndarray
    shared: np.ndarray

    def of_parameters(self, own: tuple[str, ...], shared: list[tuple[str, str]]) -> dict[str, float]:
        """By name; the same parameter of several cameras, mounts or strips is merged."""
        parts = {f"{name} of the cameras": _length(self.images[:, POSE + i]) for i, name in enumerate(own)}
        together: dict[tuple[str, str], list[tuple[str, float]]] = {}
        for (whose, what), size in zip(shared, self.shared, strict=True):
            together.setdefault((what, whose.split()[0]), []).append((whose, float(size)))
        for (what, kind), each in together.items():
            largest = max(size for _, size in each)
            taking = [whose for whose, size in each if size > 0.3 * largest]
            whose = taking[0] if len(taking) == 1 else f"{len(taking)} {kind}s"
            parts[f"{what} of {whose}"] = float(np.sqrt(sum(size**2 for _, size in each)))
        return parts

    def of_motions(
        self, changes: tuple[np.ndarray, np.ndarray], places: tuple[np.ndarray, np.ndarray]
    ) -> dict[str, float]:
        """Of points and perspective centres: as a motion of the whole where it fits, else axis by axis."""
        together = _motion(np.concatenate(changes), np.concatenate(places))
        sizes = {"points": _length(self.points), "centres": _length(self.images[:, :3])}
        turns = {"attitudes": _length(self.images[:, 3:POSE])}
        if together and min(sizes.values()) > 0.0:
            return {f"{together} of the whole block": max(*sizes.values(), *turns.values())}
        parts = {}
        whole = (
            ("points", self.points, changes[0], places[0]),
            ("perspective centres", self.images, changes[1], places[1]),
        )
        for name, size, change, place in whole:
            motion = _motion(change, place)
            if motion:
                parts[f"{motion} of all {name}"] = _length(size[:, :3])
            else:
                parts |= {f"{axis} of {name}": _length(size[:, i]) for i, axis in enumerate(AXES)}
        return parts | turns


def _motion(change: np.ndarray, place: np.ndarray) -> str:
    """Name of the common motion that a change (k, 3) of positions (k, 3) represents; empty if none."""
    offsets = place - place.mean(axis=0)
    size = np.sqrt(np.mean(np.sum(offsets**2, axis=1)))
    columns = [np.broadcast_to(axis, offsets.shape) for axis in np.eye(3)]
    columns += [np.cross(axis[None], offsets) / size for axis in np.eye(3)] + [offsets / size]
    A, total = np.stack([column.ravel() for column in columns], axis=1), np.sum(change**2)
    found = np.linalg.lstsq(A, change.ravel(), rcond=None)[0]
    if total == 0.0 or np.sum((A @ found - change.ravel()) ** 2) > (1.0 - COMMON) * total:
        return ""
    parts = np.abs(found) * np.linalg.norm(A, axis=0)
    return " and ".join(MOTIONS[i] for i in np.argsort(-parts) if parts[i] > 0.3 * parts.max())


def _named(strength: float, parts: dict[str, float]) -> Direction:
    largest = max(parts.values())
    named = {name: part / largest for name, part in parts.items() if part > SHARE * largest}
    named = dict(sorted(named.items(), key=lambda item: -item[1]))
    return Direction(" with ".join(list(named)[:MOST]), strength, named)


def _length(x: np.ndarray) -> float:
    return float(np.sqrt(np.sum(x * x)))


def datum_words(rows: np.ndarray) -> list[str]:
    """Names of the unconstrained motions, from their combinations (d, 7)."""
    if len(rows) == len(MOTIONS):
        return ["position, orientation and scale of the whole block"]
    reduced = _echelon(rows)
    found = []
    for row in reduced:
        part = np.abs(row) / np.max(np.abs(row))
        chosen = [MOTIONS[i] for i in np.argsort(-part, kind="stable") if part[i] > 0.1]
        found.append(" with ".join(chosen) + " of the whole block")
    return found


def _echelon(rows: np.ndarray) -> np.ndarray:
    """The same combinations with as few motions in each as possible (reduced row echelon form)."""
    rows = rows / np.abs(rows).max(axis=1, keepdims=True)
    for i in range(len(rows)):
        row, column = np.unravel_index(np.argmax(np.abs(rows[i:])), rows[i:].shape)
        rows[[i, i + row]] = rows[[i + row, i]]
        rows[i] /= rows[i, column]
        for other in range(len(rows)):
            if other != i:
                rows[other] = rows[other] - rows[other, column] * rows[i]
    return np.where(np.abs(rows) > 1e-6, rows, 0.0)
