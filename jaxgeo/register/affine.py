"""Candidate selection by one affine transformation that fits most blocks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxgeo.register.blocks import Matches
from jaxgeo.register.choice import AbstractChoice, Chosen, distances_to, nearest_within, none_chosen

ROUNDS = 20
FITTED = 3
CHUNK = 256
FLATTEST = 0.05  # of the squared longest side: triangles with less than half of this area are ill-conditioned


class AffineCheck(AbstractChoice):
    """Selects the best-supported affine transformation and, for each block, the candidate that fits it.

    After Cannata, Shah, Blask and Van Workum (2000), "Autonomous video registration using sensor model parameter
    adjustments". They do not describe the search. Here `samples` random triples of blocks with one peak each are drawn
    (half of them from the best peaks only; reproducible by `seed`). Each triple defines a transformation; a block
    agrees if it has a peak within `tolerance` cells. The `refitted` best transformations are refitted to all agreeing
    blocks until the set is stable. Fewer than four blocks never agree, since any three fit exactly.
    """

    tolerance: float = 2.0
    samples: int = 4000
    refitted: int = 10
    seed: int = 0

    def choose(self, matches: Matches, jacobian: Any = None, cov_error: Any = None) -> Chosen:
        """See `AbstractChoice`; jacobian and covariance are not used."""
        has_any = np.flatnonzero(matches.is_candidate.any(axis=1))
        if len(has_any) <= FITTED:
            return none_chosen(matches, self.samples, FITTED)
        triples, peaks = self._drawn(matches, has_any)
        design, shift = _design(matches), np.asarray(matches.shift)
        transforms = np.linalg.solve(design[triples], shift[triples, peaks])
        limit, ranked = self.tolerance**2, []
        for k in range(0, len(transforms), CHUNK):
            chosen, squared = nearest_within(distances_to(matches, design @ transforms[k : k + CHUNK]), limit)
            ranked += list(zip(np.sum(chosen >= 0, axis=1), -np.sum(squared, axis=1), strict=True))
        order = sorted(range(len(ranked)), key=lambda k: ranked[k], reverse=True)[: self.refitted]
        settled = [self._settled(matches, design, transforms[k]) for k in order]
        count, _, peak = max(settled, key=lambda one: one[:2], default=(0, 0.0, None))
        if count <= FITTED:
            return none_chosen(matches, self.samples, FITTED)
        return Chosen(peak, np.full(len(design), math.pi * limit), self.samples, FITTED)

    def _drawn(self, matches: Matches, blocks: Int[np.ndarray, " b"]) -> tuple[np.ndarray, np.ndarray]:
        """(triples (samples, 3) of blocks, one peak of each) without ill-conditioned triangles."""
        rng = np.random.default_rng(self.seed)
        triples = blocks[np.argsort(rng.random((self.samples, len(blocks))), axis=1)[:, :FITTED]]
        counts = np.sum(matches.is_candidate, axis=1)[triples]
        nth = np.floor(rng.random(triples.shape) * counts).astype(int)
        nth[: self.samples // 2] = 0
        peaks = np.argsort(~matches.is_candidate, axis=1, kind="stable")[triples, nth]
        corners = np.asarray(matches.centre)[triples]
        sides = corners - np.roll(corners, 1, axis=1)
        twice = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        is_wide = twice > FLATTEST * np.max(np.sum(sides**2, axis=2), axis=1)
        return triples[is_wide], peaks[is_wide]

    def _settled(
        self, matches: Matches, design: Float[np.ndarray, "n 3"], transform: Float[np.ndarray, "3 2"]
    ) -> tuple[int, float, Any]:
        """(number of agreeing blocks, negative sum of squared distances, their peaks) once the agreeing set is
        stable."""
        limit, before = self.tolerance**2, None
        chosen, squared = nearest_within(distances_to(matches, design @ transform), limit)
        for _ in range(ROUNDS):
            mine = np.flatnonzero(chosen >= 0)
            if len(mine) <= FITTED or (before is not None and np.array_equal(before, chosen)):
                break
            before = chosen
            transform = np.linalg.lstsq(design[mine], np.asarray(matches.shift)[mine, chosen[mine]], rcond=None)[0]
            chosen, squared = nearest_within(distances_to(matches, design @ transform), limit)
        return int(np.count_nonzero(chosen >= 0)), -float(np.sum(squared)), chosen


def _design(matches: Matches) -> Float[np.ndarray, "n 3"]:
    """Rows (1, row, col) of each block, row and col normalised."""
    centre = np.asarray(matches.centre)
    away = centre - np.mean(centre, axis=0)
    return np.concatenate([np.ones((len(away), 1)), away / max(float(np.max(np.abs(away))), 1.0)], axis=1)
