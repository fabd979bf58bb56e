"""Robust alignment of a block with its control: a consensus similarity of up to seven parameters."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

TURN, SCALE = 0.5, 1.5  # rad and factor: largest rotation and scale change of a block's start
TRIED = 300  # triples sampled
WIDTH = 3.0  # of the cost function of a disagreement, in standard deviations
PARAMETER = 1.5  # cost reduction required per motion parameter
WORTH = 1e-3  # width of a triangle over its length, below which a triple is degenerate


@dataclass(frozen=True)
class Motion:
    """scale R x + shift about a centre: from start positions of the block to control positions."""

    scale: float
    R: np.ndarray
    shift: np.ndarray
    middle: np.ndarray
    parameters: int

    def __call__(self, place: np.ndarray) -> np.ndarray:
        return self.middle + self.shift + self.scale * (place - self.middle) @ self.R.T


def consensus(model: np.ndarray, given: np.ndarray, covariance: np.ndarray) -> tuple[Motion, np.ndarray]:
    """(motion, disagreements (m,) in standard deviations) between start positions (m, 3) and given ones, m at least 1.

    `covariance` (m, 3, 3) in m2 is that of the differences, infinite on the diagonal for unknown coordinates.
    Candidates are the identity, shifts by single points and similarities by triples; the one with the lowest robust
    cost is taken.
    """
    root = _whitening(covariance)
    whole = np.flatnonzero(np.all(np.isfinite(np.diagonal(covariance, axis1=1, axis2=2)), axis=1))
    middle = model.mean(axis=0)
    tried = [Motion(1.0, np.eye(3), np.zeros(3), middle, 0)]
    if len(whole) > 1:
        tried += [Motion(1.0, np.eye(3), given[i] - model[i], middle, 3) for i in whole]
    triples = list(combinations(whole.tolist(), 3))
    if len(triples) > TRIED:
        triples = [triples[i] for i in np.random.default_rng(0).choice(len(triples), TRIED, replace=False)]
    weight = 1.0 / np.trace(np.where(np.isfinite(covariance), covariance, 0.0), axis1=1, axis2=2)
    if len(whole) > 3:  # three points fit almost any similarity
        tried += [m for t in triples if (m := _similarity(model, given, weight, np.array(t))) is not None]
    costs = [_cost(motion, _off(motion, model, given, root)) for motion in tried]
    best, cost = tried[int(np.argmin(costs))], min(costs)
    agreeing = whole[_off(best, model, given, root)[whole] < 3.0 * WIDTH]
    if best.parameters == 7 and len(agreeing) > 3:
        refined = _similarity(model, given, weight, agreeing)
        if refined is not None and _cost(refined, _off(refined, model, given, root)) <= cost:
            best = refined
    return best, _off(best, model, given, root)


def _whitening(covariance: np.ndarray) -> np.ndarray:
    """W (m, 3, 3) with W' W the inverse covariance, zero for unknown coordinates."""
    known = np.isfinite(np.diagonal(covariance, axis1=1, axis2=2))
    both = known[:, :, None] & known[:, None, :]
    safe = np.where(both, covariance, np.eye(3))
    return np.linalg.inv(np.linalg.cholesky(safe)) * both


def _off(motion: Motion, model: np.ndarray, given: np.ndarray, root: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.einsum("mij,mj->mi", root, motion(model) - given), axis=1)


def _cost(motion: Motion, off: np.ndarray) -> float:
    return float(np.sum(np.log1p((off / WIDTH) ** 2)) + PARAMETER * motion.parameters)


def _similarity(model: np.ndarray, given: np.ndarray, weight: np.ndarray, rows: np.ndarray) -> Motion | None:
    """Least-squares similarity of some points (Umeyama 1991); None if it is implausible for a start, or the points
    are collinear."""
    w = weight[rows] / weight[rows].sum()
    middle, goal = w @ model[rows], w @ given[rows]
    a, b = model[rows] - middle, given[rows] - goal
    spread = np.linalg.svd(a, compute_uv=False)
    if spread[1] < WORTH * spread[0]:
        return None
    U, s, Vt = np.linalg.svd((b * w[:, None]).T @ a)
    sign = np.array([1.0, 1.0, np.linalg.det(U @ Vt)])
    R = (U * sign) @ Vt
    scale = float(np.sum(s * sign) / np.sum(w[:, None] * a * a))
    angle = np.arccos(np.clip(0.5 * (np.trace(R) - 1.0), -1.0, 1.0))
    if not (1.0 / SCALE < scale < SCALE and angle < TURN):
        return None
    return Motion(scale, R, goal - middle, middle, 7)
