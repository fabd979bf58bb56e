"""Candidate selection by k-means clustering of the shifts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxgeo.register.blocks import Matches
from jaxgeo.register.choice import AbstractChoice, Chosen, distances_to, nearest_within, none_chosen

ROUNDS = 50


class Clusters(AbstractChoice):
    """K-means on the shifts of all candidates, after Gu and Qiao (2017), section 2.2 and Fig. 2.

    Assumes one common shift of the whole rectified image. The paper states neither the number of clusters nor how the
    correct one is selected. Here each number in `clusters` is tried, and the cluster is taken that has the member with
    the most other blocks within `tolerance` cells. The mean of these blocks, refined until stable, is the shift. The
    start is deterministic: the candidate nearest to the mean, then repeatedly the one farthest from all starts so far.
    """

    tolerance: float = 3.0
    clusters: tuple[int, ...] = (2, 3, 4, 6, 8, 12)

    def choose(self, matches: Matches, jacobian: Any = None, cov_error: Any = None) -> Chosen:
        """See `AbstractChoice`; jacobian and covariance are not used."""
        block, peak = np.nonzero(matches.is_candidate)
        if len(block) < 2:
            return none_chosen(matches, len(block), 1)
        shifts = np.asarray(matches.shift)[block, peak]
        best: tuple[int, float, Any] = (0, 0.0, None)
        for count in self.clusters:
            label = k_means(shifts, min(count, len(shifts)))
            for k in np.unique(label):
                chosen, squared = self._settled(
                    matches, _densest(shifts[label == k], block[label == k], self.tolerance)
                )
                agreeing = int(np.count_nonzero(chosen >= 0))
                best = max(best, (agreeing, -float(np.sum(squared)), chosen), key=lambda one: one[:2])
        if best[0] < 2:
            return none_chosen(matches, len(block), 1)
        area = np.full(len(matches.outcome), math.pi * self.tolerance**2)
        return Chosen(best[2], area, len(block), 1)

    def _settled(self, matches: Matches, shift: Float[np.ndarray, "2"]) -> tuple[np.ndarray, np.ndarray]:
        """(candidates within the tolerance of a shift that equals their mean, their squared distances)."""
        n, before = len(matches.outcome), np.zeros(0)
        rows = np.arange(n)
        chosen, squared = nearest_within(distances_to(matches, np.broadcast_to(shift, (n, 2))), self.tolerance**2)
        for _ in range(ROUNDS):
            if np.array_equal(before, chosen) or not np.any(chosen >= 0):
                break
            before, mine = chosen, chosen >= 0
            shift = np.mean(np.asarray(matches.shift)[rows[mine], chosen[mine]], axis=0)
            chosen, squared = nearest_within(distances_to(matches, np.broadcast_to(shift, (n, 2))), self.tolerance**2)
        return chosen, squared


def k_means(points: Float[np.ndarray, "m 2"], clusters: int) -> Int[np.ndarray, " m"]:
    """Cluster number of each point (Lloyd 1982), with a deterministic start."""
    first = int(np.argmin(np.sum((points - np.median(points, axis=0)) ** 2, axis=1)))
    centres = [points[first]]
    for _ in range(clusters - 1):
        away = np.min([np.sum((points - centre) ** 2, axis=1) for centre in centres], axis=0)
        centres.append(points[int(np.argmax(away))])
    middle, label = np.array(centres), np.full(len(points), -1)
    for _ in range(ROUNDS):
        new = np.argmin(np.sum((points[:, None, :] - middle[None, :, :]) ** 2, axis=2), axis=1)
        if np.array_equal(new, label):
            break
        label = new
        for k in np.unique(label):
            middle[k] = np.mean(points[label == k], axis=0)
    return label


def _densest(shifts: Float[np.ndarray, "m 2"], block: Int[np.ndarray, " m"], tolerance: float) -> np.ndarray:
    """The shift with the most blocks within the tolerance."""
    near = np.sum((shifts[:, None, :] - shifts[None, :, :]) ** 2, axis=2) <= tolerance**2
    counts = [len(np.unique(block[row])) for row in near]
    return shifts[int(np.argmax(counts))]
