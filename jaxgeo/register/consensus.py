"""Candidate selection by consensus under the navigation's error model."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxgeo.register.blocks import Matches
from jaxgeo.register.choice import AbstractChoice, Chosen, nearest_within, none_chosen

ROUNDS = 40
CHUNK = 64
FITTED = 2


class _Errors(NamedTuple):
    """Linear model of the shifts by navigation errors z ~ N(0, I)."""

    H: Float[np.ndarray, "n 2 z"]  # derivatives of the block shifts by z
    shift: Float[np.ndarray, "n peaks 2"]  # zero for missing candidates
    cov: Float[np.ndarray, "n peaks 2 2"]
    is_candidate: np.ndarray
    weighed: Float[np.ndarray, "n peaks z z"]  # H' cov^-1 H
    right: Float[np.ndarray, "n peaks z"]  # H' cov^-1 shift
    offer: Float[np.ndarray, " n"]  # log of the searched cells per candidate


class _Seen(NamedTuple):
    """Candidates under several hypotheses: squared distances in standard deviations, and acceptance area per unit of
    it."""

    squared: Float[np.ndarray, "k n peaks"]
    area: Float[np.ndarray, "k n peaks"]


class PoseConsensus(AbstractChoice):
    """Selects candidates whose shifts fit one error vector e of the navigation, under its prior: s = G e + noise.

    Hypotheses are the conditional Gaussians given single candidates, or pairs from two blocks: all pairs up to `pairs`,
    else `pairs` random ones by `seed`. A block agrees if it has a candidate within the gate: the `probability` ellipse
    of the hypothesis' remaining uncertainty, the match covariance and `tolerance` cells (standard deviation on both
    axes) for unmodelled effects. Hypotheses are ranked by the likelihood ratio of their candidates against uniform
    candidates in the searched area; the `refitted` best are refitted to all agreeing blocks until the set is stable.
    The largest set wins, then the smallest sum of squared distances.
    """

    tolerance: float = 1.0
    probability: float = 0.99
    pairs: int = 2000
    refitted: int = 20
    seed: int = 0

    def choose(self, matches: Matches, jacobian: Any = None, cov_error: Any = None) -> Chosen:
        """See `AbstractChoice`. Raises `ValueError` without jacobian and covariance, or for shapes that do not fit."""
        errors = self._errors(matches, jacobian, cov_error)
        sets = self._hypotheses(errors)
        if not len(sets):
            return none_chosen(matches, 0, FITTED)
        worth = np.concatenate([self._worth(errors, sets[k : k + CHUNK]) for k in range(0, len(sets), CHUNK)])
        order = np.argsort(-worth, kind="stable")[: self.refitted]
        settled = [self._settled(errors, sets[k]) for k in order]
        count, _, peak, area = max(settled, key=lambda one: one[:2])
        if count < 2:
            return none_chosen(matches, len(sets), FITTED)
        return Chosen(peak, area, len(sets), FITTED)

    @property
    def gate(self) -> float:
        """Largest squared distance of an agreeing candidate: chi-square with two degrees of freedom."""
        return -2.0 * math.log1p(-self.probability)

    def _errors(self, matches: Matches, jacobian: Any, cov_error: Any) -> _Errors:
        n, peaks = matches.is_candidate.shape
        if jacobian is None or cov_error is None:
            raise ValueError("PoseConsensus needs jacobian (n, 2, axes) and cov_error (axes, axes) of the navigation.")
        jacobian, cov_error = np.asarray(jacobian, float), np.asarray(cov_error, float)
        axes = len(cov_error)
        if cov_error.shape != (axes, axes) or jacobian.shape != (n, 2, axes):
            raise ValueError(
                f"jacobian must be (n, 2, axes) for {n} blocks, and cov_error (axes, axes); got {jacobian.shape} and "
                f"{cov_error.shape}."
            )
        used = np.any(matches.is_candidate, axis=1)
        if not (np.all(np.isfinite(jacobian[used])) and np.all(np.isfinite(cov_error))):
            raise ValueError("jacobian and cov_error must be finite for every block that has a candidate.")
        values, vectors = np.linalg.eigh(cov_error)
        kept = np.flatnonzero(values > 1e-14 * np.max(values, initial=0.0))
        H = np.where(used[:, None, None], jacobian, 0.0) @ (vectors[:, kept] * np.sqrt(values[kept]))
        ok = matches.is_candidate
        shift = np.where(ok[..., None], matches.shift, 0.0)
        cov = np.where(ok[..., None, None], matches.covariance, 0.0) + self.tolerance**2 * np.eye(2)
        spread = np.linalg.solve(cov, np.broadcast_to(H[:, None], (n, peaks, *H.shape[1:])))
        weighed = np.einsum("naz,npay->npzy", H, spread)
        right = np.einsum("npaz,npa->npz", spread, shift)
        offer = np.log(np.maximum(matches.searched, 1) / np.maximum(np.sum(ok, axis=1), 1))
        return _Errors(H, shift, cov, ok, weighed, right, offer)

    def _hypotheses(self, errors: _Errors) -> Int[np.ndarray, "k 2 2"]:
        """Pairs of (block, peak); a single candidate is paired with itself."""
        all_of_them = np.argwhere(errors.is_candidate)
        first, second = np.triu_indices(len(all_of_them), 1)
        if len(first) > 100 * self.pairs:  # enough to sample from
            rng = np.random.default_rng(self.seed)
            first, second = rng.integers(len(all_of_them), size=(2, 2 * self.pairs))
        apart = np.flatnonzero(all_of_them[first, 0] != all_of_them[second, 0])
        if len(apart) > self.pairs:
            apart = np.random.default_rng(self.seed).choice(apart, self.pairs, replace=False)
        pairs = np.stack([all_of_them[first[apart]], all_of_them[second[apart]]], axis=1)
        return np.concatenate([np.stack([all_of_them, all_of_them], axis=1), pairs])

    def _worth(self, errors: _Errors, sets: Int[np.ndarray, "k 2 2"]) -> Float[np.ndarray, " k"]:
        """Log-likelihood ratio of the candidates within the gate against uniform candidates, for several hypotheses."""
        block, peak = sets[..., 0], sets[..., 1]
        counts = np.where(np.all(sets[:, 0] == sets[:, 1], axis=1), 0.5, 1.0)[:, None]  # each single once
        weighed = np.sum(errors.weighed[block, peak] * counts[..., None, None], axis=1)
        right = np.sum(errors.right[block, peak] * counts[..., None], axis=1)
        mean, cov = _posterior(weighed, right)
        distances = _distances(errors, mean, cov)
        gain = -0.5 * distances.squared - np.log(2.0 * distances.area) + errors.offer[None, :, None]
        gain = np.where(distances.squared <= self.gate, gain, 0.0)
        return np.sum(np.max(gain, axis=2, initial=0.0), axis=1) - 0.5 * np.sum(mean**2, axis=1)

    def _settled(self, errors: _Errors, pair: Int[np.ndarray, "2 2"]) -> tuple[int, float, Any, Any]:
        """(number of agreeing blocks, negative cost, their peaks, gate areas) once the set is stable.

        Each candidate is tested against the prediction from the other blocks and the prior; including its own influence
        would always confirm a single candidate. In the second half of the rounds, blocks can only leave the set, so
        that the iteration terminates.
        """
        n, peaks = errors.is_candidate.shape
        chosen, squared, mean, area = np.full(n, -1), np.zeros(n), np.zeros(0), np.zeros(n)
        chosen[pair[:, 0]] = pair[:, 1]
        for round_ in range(ROUNDS):
            if round_ > 0 and np.count_nonzero(chosen >= 0) < FITTED:
                return 0, 0.0, np.full(n, -1), area
            before, is_member = chosen, chosen[:, None] == np.arange(peaks)[None, :]
            mean, cov = _posterior(
                np.sum(errors.weighed[is_member], axis=0)[None], np.sum(errors.right[is_member], axis=0)[None]
            )
            distances = _distances(errors, mean, cov, is_member)
            chosen, squared = nearest_within(distances.squared[0], self.gate)
            chosen = np.where((before < 0) & (round_ >= ROUNDS // 2), -1, chosen)
            area = self.gate * distances.area[0][np.arange(n), np.maximum(chosen, 0)]
            if np.array_equal(before, chosen):
                break
        cost = float(np.sum(squared) + np.sum(mean**2))
        return int(np.count_nonzero(chosen >= 0)), -cost, chosen, area


def _posterior(
    weighed: Float[np.ndarray, "k z z"], right: Float[np.ndarray, "k z"]
) -> tuple[Float[np.ndarray, "k z"], Float[np.ndarray, "k z z"]]:
    """Mean and covariance of the errors given N(0, I) and shift observations."""
    cov = np.linalg.inv(np.eye(weighed.shape[-1]) + weighed)
    return np.einsum("kzy,ky->kz", cov, right), cov


def _distances(
    errors: _Errors, mean: Float[np.ndarray, "k z"], cov: Float[np.ndarray, "k z z"], is_member: Any = None
) -> _Seen:
    """All candidates as predicted by several hypotheses; members of the fit as predicted without them.

    For members, (R - H P H')^-1 replaces (R + H P H')^-1 in the squared distance, and R (R - H P H')^-1 R replaces R +
    H P H' as the covariance.
    """
    H, R = errors.H, errors.cov
    away = errors.shift[None] - np.einsum("naz,kz->kna", H, mean)[:, :, None, :]
    predicted = np.einsum("knaz,nbz->knab", np.einsum("naz,kzy->knay", H, cov), H)
    sign = np.where(is_member, -1.0, 1.0) if is_member is not None else np.ones(R.shape[:2])
    total = sign[None, ..., None, None] * predicted[:, :, None] + R[None]
    a, b, c = total[..., 0, 0], total[..., 0, 1], total[..., 1, 1]
    det = np.maximum(a * c - b**2, 1e-12 * a * c)
    squared = (c * away[..., 0] ** 2 - 2.0 * b * away[..., 0] * away[..., 1] + a * away[..., 1] ** 2) / det
    root = np.where(sign[None] < 0.0, np.linalg.det(R)[None] / np.sqrt(det), np.sqrt(det))
    return _Seen(np.where(errors.is_candidate[None], squared, np.inf), math.pi * root)
