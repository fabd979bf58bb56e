"""Candidates that agree: found among others, told from chance, and from a second set as good."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
import scipy

from jaxgeo.register.affine import AffineCheck
from jaxgeo.register.blocks import Matches
from jaxgeo.register.chance import at_least, false_alarms, second_best
from jaxgeo.register.choice import AbstractChoice
from jaxgeo.register.clusters import Clusters, k_means
from jaxgeo.register.consensus import PoseConsensus, _distances, _posterior

CHOICES = [Clusters(), AffineCheck(), PoseConsensus()]
names = pytest.mark.parametrize("choice", CHOICES, ids=lambda choice: type(choice).__name__)
PEAKS, NOISE = 4, 0.2
COV = np.diag([20.0, 20.0, 0.5, 0.5, 0.5]) ** 2  # cells2


class Planted(NamedTuple):
    matches: Matches
    jacobian: np.ndarray
    right: np.ndarray  # the peak that is right, -1 for none
    error: np.ndarray


def planted(seed: int, share: float, side: int = 6) -> Planted:
    """Blocks on a square whose shifts are those of one error of the navigation, for a share of them; all else random.

    Errors are two shifts, a turn and two scales, in cells at the image's edge.
    """
    rng = np.random.default_rng(seed)
    axis = np.linspace(0.0, 1500.0, side)
    centre = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    n, (row, col) = len(centre), ((centre - 750.0) / 750.0).T
    zero, one = np.zeros(n), np.ones(n)
    jacobian = np.stack([np.stack([one, zero, -col, row, zero], 1), np.stack([zero, one, row, zero, col], 1)], axis=1)
    error = rng.multivariate_normal(np.zeros(5), COV)
    predicted = jacobian @ COV @ np.swapaxes(jacobian, 1, 2)
    k = np.sqrt(-2.0 * np.log(0.001))
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, (n, PEAKS)), k * np.sqrt(rng.random((n, PEAKS)))
    even = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    shift = np.einsum("nab,npb->npa", np.linalg.cholesky(predicted), even)
    good = rng.permutation(n)[: round(share * n)]
    right = np.full(n, -1)
    right[good] = rng.integers(0, PEAKS, len(good))
    shift[good, right[good]] = (jacobian @ error)[good] + NOISE * rng.standard_normal((len(good), 2))
    searched = np.rint(np.pi * k**2 * np.sqrt(np.linalg.det(predicted))).astype(int)
    score, cov = np.tile([0.5, 0.45, 0.4, 0.35], (n, 1)), np.tile(NOISE**2 * np.eye(2), (n, PEAKS, 1, 1))
    return Planted(Matches(centre, shift, score, cov, np.zeros(n, np.int8), searched), jacobian, right, error)


@pytest.mark.costly
@names
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_planted_set_is_found(choice: AbstractChoice, seed: int) -> None:
    matches, jacobian, right, error = planted(seed, 0.5)
    chosen = choice.choose(matches, jacobian, COV)
    is_wrong = chosen.is_chosen & (chosen.peak != right)
    assert np.count_nonzero(chosen.peak[right >= 0] == right[right >= 0]) >= 16
    assert np.count_nonzero(is_wrong) <= 1
    assert false_alarms(matches, chosen) < 1e-6
    second = second_best(choice, matches, chosen, jacobian, COV)
    assert not np.any(chosen.is_chosen & (second.peak == chosen.peak))
    assert false_alarms(matches, second) > 1e-2
    away = chosen.of(matches.shift) - jacobian @ error
    assert np.nanmax(np.abs(np.where(is_wrong[:, None], np.nan, away))) < 5.0 * NOISE
    again = choice.choose(matches, jacobian, COV)
    np.testing.assert_array_equal(again.peak, chosen.peak)


@pytest.mark.costly
@names
def test_candidates_that_lie_anywhere_are_chance(choice: AbstractChoice) -> None:
    draws = [planted(seed, 0.0) for seed in range(10)]
    alarms = [false_alarms(d.matches, choice.choose(d.matches, d.jacobian, COV)) for d in draws]
    assert np.count_nonzero(np.array(alarms) > 1e-2) >= 9
    assert min(alarms) > 1e-5


@names
def test_a_texture_that_repeats_itself_has_a_second_set(choice: AbstractChoice) -> None:
    matches, jacobian, right, _ = planted(4, 1.0)
    shift, rows = matches.shift.copy(), np.arange(len(right))
    shift[rows, (right + 1) % PEAKS] = shift[rows, right] + np.array([0.0, 12.0])
    periodic = Matches(matches.centre, shift, matches.score, matches.covariance, matches.outcome, matches.searched)
    chosen = choice.choose(periodic, jacobian, COV)
    second = second_best(choice, periodic, chosen, jacobian, COV)
    assert chosen.count >= 30
    assert second.count > 0.8 * chosen.count
    assert false_alarms(periodic, second) < 1e-6


@names
@pytest.mark.parametrize("n", [0, 1, 5])
def test_without_candidates_nothing_is_chosen(choice: AbstractChoice, n: int) -> None:
    nan = np.full((n, PEAKS), np.nan)
    matches = Matches(
        np.arange(2.0 * n).reshape(n, 2), np.full((n, PEAKS, 2), np.nan), nan, np.full((n, PEAKS, 2, 2), np.nan),
        np.full(n, 4, np.int8), np.zeros(n, int),
    )  # fmt: skip
    chosen = choice.choose(matches, np.zeros((n, 2, 5)), COV)
    assert chosen.peak.shape == (n,)
    assert chosen.count == 0
    assert false_alarms(matches, chosen) >= 1.0
    assert second_best(choice, matches, chosen, np.zeros((n, 2, 5)), COV).count == 0


def test_the_prior_refuses_what_the_navigation_cannot_do() -> None:
    """Most blocks agree on a turn forty times as large as the navigation's error: affine, but not this pose."""
    matches, jacobian, right, _ = planted(5, 0.4)
    turned = jacobian @ np.array([3.0, -4.0, 20.0, 0.0, 0.0])
    shift = matches.shift.copy()
    false = np.flatnonzero(right < 0)[:18]
    shift[false, 0] = turned[false]
    both = Matches(matches.centre, shift, matches.score, matches.covariance, matches.outcome, matches.searched)
    by_affine, by_pose = AffineCheck().choose(both), PoseConsensus().choose(both, jacobian, COV)
    assert np.count_nonzero(by_affine.peak[false] == 0) >= 17
    good = right >= 0
    assert np.count_nonzero(by_pose.peak[good] == right[good]) >= 13


def test_members_are_held_against_the_others_alone() -> None:
    """The short formula for a member's squared distance and area, against a fit without it."""
    matches, jacobian, right, _ = planted(6, 1.0, side=3)
    errors = PoseConsensus()._errors(matches, jacobian, COV)
    rows = np.arange(len(right))

    def fit(some: np.ndarray):
        chosen = (some, right[some])
        return _posterior(errors.weighed[chosen].sum(axis=0)[None], errors.right[chosen].sum(axis=0)[None])

    is_member = right[:, None] == np.arange(PEAKS)[None, :]
    with_all = _distances(errors, *fit(rows), is_member)
    for k in rows:
        without = _distances(errors, *fit(np.delete(rows, k)))
        for short, full in zip(with_all, without, strict=True):
            np.testing.assert_allclose(short[0, k, right[k]], full[0, k, right[k]], rtol=1e-8)


def test_pose_consensus_needs_the_navigation() -> None:
    matches, jacobian, _, _ = planted(0, 0.5)
    with pytest.raises(ValueError, match="needs jacobian"):
        PoseConsensus().choose(matches)
    with pytest.raises(ValueError, match=r"jacobian must be \(n, 2, axes\)"):
        PoseConsensus().choose(matches, jacobian[:4], COV)
    with pytest.raises(ValueError, match="finite"):
        PoseConsensus().choose(matches, np.nan * jacobian, COV)


def test_tail_of_unequal_chances() -> None:
    np.testing.assert_allclose(at_least(np.full(40, 0.03), 9), scipy.stats.binom.sf(8, 40, 0.03), rtol=1e-10)
    some = np.array([0.1, 0.5, 0.9])
    np.testing.assert_allclose(at_least(some, 3), np.prod(some), rtol=1e-12)
    np.testing.assert_allclose(at_least(some, 1), 1.0 - np.prod(1.0 - some), rtol=1e-12)
    assert (at_least(some, 0), at_least(some, 4)) == (1.0, 0.0)


def test_clusters_that_lie_apart_are_told_apart() -> None:
    rng = np.random.default_rng(0)
    truth = np.repeat([0, 1, 2], 20)
    points = np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 40.0]])[truth] + rng.standard_normal((60, 2))
    label = k_means(points, 3)
    assert all(len(np.unique(label[truth == k])) == 1 for k in range(3))
    assert len(np.unique(label)) == 3
