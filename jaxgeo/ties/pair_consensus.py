"""Consensus of the matches of two images within the covariance of their navigation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

GATE = 4.0  # standard deviations of the navigation: matches that lie further off are wrong
OUTLIER = 4.0  # standard deviations of a measurement
EXCESSES = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)  # px: standard deviations tried in addition to those stated
SAMPLES = (4, 5)  # matches of a hypothesis; the visible part of a relative pose has five unknowns
HYPOTHESES = 300  # of each size
FREEDOM = 5
REFINED = 5  # of the best hypotheses
ROUNDS = 4
SETTLED = 3  # of the standard deviations tried: if all matches agree by no more, no hypotheses are needed


def agreement(off: np.ndarray, by_pose: np.ndarray, covariance: np.ndarray, px: np.ndarray) -> np.ndarray | None:
    """Flags (m,) of the matches of a pair of images that agree on one error of both poses; None if these are too few.

    `off` (m,) are distances from coplanarity in standard deviations of the measurements, `by_pose` (m, 12) their
    derivatives, `covariance` (12, 12) that of the errors, and `px` (m,) the number of these standard deviations in a
    pixel. Errors of the poses are hypotheses from a few matches each, with the navigation as prior. The one of largest
    likelihood is chosen, and with it a standard deviation in addition to those stated: half of the matches have normal
    errors, half lie anywhere in the gate of the navigation (Torr and Zisserman 2000, MLESAC).
    """
    values, vectors = np.linalg.eigh(covariance)
    A = by_pose @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    reach = GATE * np.sqrt(np.sum(A**2, axis=1) + 1.0 + (EXCESSES[SETTLED] * px) ** 2)
    gated = np.flatnonzero(np.abs(off) <= reach)
    if len(gated) <= FREEDOM:
        return None
    pair = _Pair.of(off[gated], A[gated], px[gated], reach[gated])
    of_all = [pair.refined(np.ones(len(gated), bool), level) for level in range(len(EXCESSES))]
    best = max(of_all, key=lambda one: one.score)
    if best.level > SETTLED or not np.all(best.agrees):
        best = max((best, *pair.by_hypotheses()), key=lambda one: one.score)
    agrees = np.zeros(len(off), bool)
    agrees[gated] = best.agrees
    return agrees if np.sum(agrees) > FREEDOM else None


class _Fit(NamedTuple):
    agrees: np.ndarray
    score: float
    level: int


@dataclass(frozen=True)
class _Pair:
    """Distances (m,) and derivatives (m, 12) by errors of unit covariance; the standard deviations tried (e, m), and
    the gain (e, m) in log likelihood of a match without residual over one that lies anywhere within `reach` (m,)."""

    off: np.ndarray
    A: np.ndarray
    sigma: np.ndarray
    gain: np.ndarray
    reach: np.ndarray

    @classmethod
    def of(cls, off: np.ndarray, A: np.ndarray, px: np.ndarray, reach: np.ndarray) -> _Pair:
        sigma = np.hypot(1.0, np.array(EXCESSES)[:, None] * px)
        return cls(off, A, sigma, np.log(np.maximum(2.0 * reach / (np.sqrt(2.0 * np.pi) * sigma), 1.0)), reach)

    def by_hypotheses(self) -> list[_Fit]:
        """Fits from the best hypotheses for each standard deviation."""
        rng = np.random.default_rng(len(self.off))
        z = np.concatenate([self._hypotheses(size, rng) for size in SAMPLES])
        residual, fits = np.abs(self.off - z @ self.A.T), []
        for level in range(len(EXCESSES)):
            scores = self._scores(z, residual, level)
            for one in np.argpartition(-scores, REFINED)[:REFINED]:
                fits.append(self.refined(residual[one] <= OUTLIER * self.sigma[level], level))
        return fits

    def _hypotheses(self, size: int, rng: np.random.Generator) -> np.ndarray:
        """Errors (h, 12) that explain some of the matches each."""
        rows = np.argsort(rng.random((HYPOTHESES, len(self.off))), axis=1)[:, :size]
        A, noise = self.A[rows], self.sigma[2][rows]
        normal = A @ np.swapaxes(A, 1, 2) + np.eye(size) * noise[:, :, None] ** 2
        return np.einsum("hkz,hk->hz", A, np.linalg.solve(normal, self.off[rows][:, :, None])[:, :, 0])

    def refined(self, agrees: np.ndarray, level: int) -> _Fit:
        """The best fit to the matches that agree, from those that do at first."""
        best = None
        for _ in range(ROUNDS):
            weight = agrees / self.sigma[level] ** 2
            normal = np.eye(self.A.shape[1]) + (self.A.T * weight) @ self.A
            z = np.linalg.solve(normal, self.A.T @ (weight * self.off))
            residual, before = np.abs(self.off - self.A @ z), agrees
            score = float(self._scores(z, residual, level))
            agrees = residual <= OUTLIER * self.sigma[level]
            if best is None or score > best.score:
                best = _Fit(agrees, score, level)
            if np.array_equal(agrees, before):
                break
        assert best is not None
        return best

    def _scores(self, z: np.ndarray, residual: np.ndarray, level: int) -> np.ndarray:
        """Log posterior densities of errors (*h, 12) by their residuals (*h, m) with one of the standard deviations."""
        gains = np.maximum(self.gain[level] - 0.5 * (residual / self.sigma[level]) ** 2, 0.0)
        return np.asarray(np.sum(gains, axis=-1) - 0.5 * np.sum(z**2, axis=-1))
