"""Sigmas from check points: the intervals hold the truth, and what cannot be told apart is named."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
import scipy.optimize

import jaxgeo
from jaxgeo._blas_threads import one_thread
from jaxgeo.status import Status
from jaxgeo.uncertainty import Calibration, CheckPoints, calibrate_errors, sources
from jaxgeo.uncertainty._calibrate import _calibrate
from jaxgeo.uncertainty._reml import Likelihood
from jaxgeo.uncertainty.check_errors import CheckErrors, errors_at
from tests.support.check_points import LEVEL, block, hills, simulated, true_errors

MADE = block(flights=3, images=6, pixels=2, seed=4)
HALF = true_errors(0.5)


@pytest.fixture(scope="module")
def points() -> CheckPoints:
    return simulated(true_errors(), 1, LEVEL, MADE)


@pytest.fixture(scope="module")
def found(points) -> CheckErrors:
    return errors_at(points, LEVEL, HALF, jaxgeo.FirstHit())


def calibrated(found: CheckErrors, **options) -> Calibration:
    usual = {"each_axis": False, "remove_mean": True, "hold": (), "confidence": 0.95}
    return _calibrate(found, HALF, **(usual | options))


def with_errors(found: CheckErrors, error: np.ndarray) -> CheckErrors:
    return found._replace(seen=found.seen._replace(error_enu=error))


def drawn(found: CheckErrors, count: int, seed: int, factor: float = 2.0) -> np.ndarray:
    """Errors of sources `factor` times as large as stated, and of survey and pixels as stated."""
    cov = factor**2 * sum(part.covariance for part in found.parts()) + found.noise
    root = np.linalg.cholesky(cov)
    return (np.random.default_rng(seed).standard_normal((count, len(root))) @ root.T).reshape(count, -1, 3)


def test_simulated_points_by_the_exact_model(points) -> None:
    """The simulation, and the first compilation."""
    assert len(points) == 36


@pytest.mark.costly
def test_roots_of_the_parts(found) -> None:
    for part, ranks in zip(found.parts(), (3 * 18, 3 * 18, 3 * 3), strict=True):  # 18 images of 3 flights
        root = part.root()
        assert root.shape == (108, ranks)
        np.testing.assert_allclose(root @ root.T, part.covariance, atol=1e-12)  # m2


@pytest.fixture
def likelihood():
    """(likelihood, errors, covariance of the noise, roots of two parts), LAPACK on one thread."""
    with one_thread():
        yield a_likelihood()


def a_likelihood() -> tuple[Likelihood, np.ndarray, np.ndarray, list[np.ndarray]]:
    random = np.random.default_rng(1)
    roots = [random.standard_normal((14, 6)), random.standard_normal((14, 3))]
    noise = np.diag(random.uniform(0.5, 1.0, 14))
    y = roots[0] @ random.standard_normal(6) + 2.0 * roots[1] @ random.standard_normal(3)
    return Likelihood.of(y, noise, roots), y, noise, roots


def test_the_likelihood_is_that_of_the_normal_distribution(likelihood) -> None:
    found, y, noise, roots = likelihood

    def direct(x: np.ndarray) -> float:
        cov = noise + sum(np.exp(2.0 * s) * root @ root.T for s, root in zip(x, roots, strict=True))
        return float(0.5 * np.linalg.slogdet(cov)[1] + 0.5 * y @ np.linalg.solve(cov, y))

    a, b = np.array([0.3, -0.4]), np.array([-1.0, 0.7])
    assert found.at(a).misfit - found.at(b).misfit == pytest.approx(direct(a) - direct(b), abs=1e-7)
    slope = scipy.optimize.approx_fprime(a, direct, 1e-6)
    np.testing.assert_allclose(found.at(a).gradient, slope, atol=1e-4)


def test_the_information_is_the_mean_curvature(likelihood) -> None:
    """Over errors of the covariance itself, the mean of the squared gradient (Fisher 1925)."""
    found, _, noise, roots = likelihood
    x = np.array([0.2, -0.3])
    cov = noise + sum(np.exp(2.0 * s) * root @ root.T for s, root in zip(x, roots, strict=True))
    draws = np.linalg.cholesky(cov) @ np.random.default_rng(0).standard_normal((14, 400))
    slopes = np.array([Likelihood.of(y, noise, roots).at(x).gradient for y in draws.T])
    np.testing.assert_allclose(slopes.T @ slopes / 400, found.at(x).information, rtol=0.3, atol=0.3)


def test_the_minimum_is_that_of_another_search(likelihood) -> None:
    found = likelihood[0]
    best = found.best(0.0)
    other = scipy.optimize.minimize(lambda x: found.at(x).misfit, np.zeros(2), method="Nelder-Mead", tol=1e-9)
    np.testing.assert_allclose(best.x, other.x, atol=1e-3)
    low, high = found.limits(best, 0, 1.96)
    for limit in (low, high):
        fixed = np.array([np.log(limit), best.x[1]])
        at = found.minimum(fixed, np.array([False, True])).misfit
        assert 2.0 * (at - best.misfit) == pytest.approx(1.96**2, abs=0.02)


def test_a_scale_at_zero_rises_where_another_one_is_lowered() -> None:
    """The oracle is a search of the dense likelihood over a grid of the other scale."""
    random = np.random.default_rng(18)
    first = random.standard_normal((16, 8))
    second = first + 0.7 * random.standard_normal((16, 8))
    y = 0.7 * first @ random.standard_normal(8) + 0.1 * second @ random.standard_normal(8)
    y += 0.5 * random.standard_normal(16)
    grid = np.concatenate([[-20.0], np.linspace(-4.0, 1.0, 120)])

    def misfit(x: float) -> float:
        cov = 0.25 * np.eye(16) + np.exp(2.0 * x) * first @ first.T
        covs = cov + np.exp(2.0 * grid)[:, None, None] * (second @ second.T)
        fits = np.linalg.solve(covs, np.broadcast_to(y[:, None], (len(grid), 16, 1)))[..., 0] @ y
        return float(0.5 * np.min(np.linalg.slogdet(covs)[1] + fits))

    found = Likelihood.of(y, 0.25 * np.eye(16), [first, second])
    best = found.best(0.0)
    assert np.exp(best.x[1]) < 1e-6
    for limit in found.limits(best, 0, 1.96):
        assert 2.0 * (misfit(np.log(limit)) - misfit(best.x[0])) == pytest.approx(1.96**2, abs=0.03)


def test_intervals_hold_the_true_sigmas(found) -> None:
    """4 sets of errors twice as large as stated, seed 11; more in a slow test."""
    held = []
    for error in drawn(found, 4, 11):
        each = calibrated(with_errors(found, error)).components
        held += [one.least <= 2.0 <= one.most for one in each]
    assert np.mean(held) > 0.8


def test_a_calibrated_model_has_the_calibrated_sigmas(points, found) -> None:
    one = calibrate_errors(points, LEVEL, HALF)
    assert [c.label for c in one.components] == ["attitude", "position", "boresight"]
    for source, before, part in zip(one.errors.sources, HALF.sources, one.components, strict=True):
        np.testing.assert_allclose(source.sigma, part.scale * np.asarray(before.sigma), rtol=1e-12)
        assert part.least < part.scale < part.most
        assert 0.0 < part.standard_error < 1.0
    assert one.errors.sources[0].sharing == HALF.sources[0].sharing
    assert one.contrasts == 3 * 36 - 3
    assert one.p < 0.01
    assert "does not fit" in one.words
    assert "mean error east" in one.words
    assert one.to_dict()["components"][1]["unit"] == "m"


@pytest.mark.parametrize("times", [1.0, 30.0])
def test_errors_far_larger_than_stated_are_doubtful(found, times: float) -> None:
    """Not those that are twice as large."""
    one = calibrated(with_errors(found, times * drawn(found, 1, 5)[0]))
    large = [c.label for c in one.components if c.least > 3.0]
    assert bool(large) == (times > 1.0)
    assert [c["label"] for c in one.to_dict()["components"] if c["doubtful"]] == large
    assert ("Doubtful: " + " and ".join(large) in one.words) if large else ("Doubtful" not in one.words)


def test_axes_apart(found) -> None:
    one = calibrated(with_errors(found, drawn(found, 1, 5)[0]), each_axis=True)
    assert [c.label for c in one.components[:3]] == ["attitude heading", "attitude pitch", "attitude roll"]
    sigma = np.asarray(one.errors.sources[0].sigma)
    np.testing.assert_allclose(sigma, [c.sigma[0] for c in one.components[:3]], rtol=1e-12)


def test_a_boresight_of_one_flight_is_not_separable(found) -> None:
    """It is a constant of the data: removed as a fixed effect, named, its sigma as stated."""
    once = found._replace(points=dataclasses.replace(found.points, flights=np.zeros(36, int)))
    one = calibrated(with_errors(once, drawn(once, 1, 2)[0]))
    assert any(group[0] == "boresight" and "attitude" in group for group in one.not_separable)
    assert "boresight is not separable from" in one.words
    boresight = one.components[2]
    assert boresight.held is not None
    assert boresight.scale == 1.0
    assert {effect.label for effect in one.fixed_effects} >= {"boresight heading", "boresight pitch"}
    assert one.components[0].held is None


@pytest.mark.costly
def test_sources_that_do_the_same_are_not_separable(points) -> None:
    """Two attitudes, one of each image and one by time that fades between images: the information tells nothing."""
    twice = sources.Attitude.from_degrees(heading=0.015, pitch=0.005, roll=0.005)
    found = errors_at(points, LEVEL, (*HALF.sources, twice), jaxgeo.FirstHit())
    one = _calibrate(found, (*HALF.sources, twice), False, True, (sources.Boresight, sources.Position), 0.95)
    assert ("attitude", "attitude") in one.not_separable
    assert one.components[1].held == "held as asked"


def test_a_source_that_is_not_there_is_zero(found) -> None:
    """Errors of attitude and survey only: the position comes out at zero, with a limit above."""
    parts = found.parts()
    root = np.linalg.cholesky(4.0 * parts[0].covariance + 0.2 * found.noise)
    error = (root @ np.random.default_rng(4).standard_normal(len(root))).reshape(-1, 3)
    position = calibrated(with_errors(found, error)).components[1]
    assert position.scale == 0.0
    assert position.least == 0.0
    assert 0.0 < position.most < 1.5
    assert "at zero" in position.words


def test_errors_far_beyond_all_factors_are_refused(found) -> None:
    with pytest.raises(ValueError, match="more than 8103 times as large as stated for attitude"):
        calibrated(with_errors(found, 1e5 * np.asarray(found.seen.error_enu)))


@pytest.mark.parametrize(
    "hold, kind, words",
    [
        (sources.Attitude, TypeError, "hold must be classes of error sources"),
        (True, TypeError, "got True"),
        ("Attitude", TypeError, "got 'Attitude'"),
        (("Attitude",), TypeError, "got 'Attitude'"),
        ((true_errors().sources[0],), TypeError, "hold must be classes"),
        ((sources.Geoid,), ValueError, "the error model has no Geoid"),
    ],
)
def test_what_cannot_be_held_is_refused(points, found, hold, kind: type[Exception], words: str) -> None:
    calibrate = functools.partial(calibrated, found) if kind is ValueError else _calibrate_points(points)
    with pytest.raises(kind, match=words):
        calibrate(hold=hold)


def _calibrate_points(points):
    return functools.partial(calibrate_errors, points, LEVEL, HALF)


def test_points_without_a_fix_are_named(found) -> None:
    status = np.array(found.seen.status)
    status[3] = Status.leaves_terrain
    keep = np.flatnonzero(status == Status.hit)
    rows = (3 * keep[:, None] + np.arange(3)).reshape(-1)
    lost = found._replace(seen=found.seen._replace(status=status), index=keep, noise=found.noise[np.ix_(rows, rows)])
    one = calibrated(lost)
    assert one.without_fix == ("3 (leaves_terrain)",)
    assert "Left out, without a fix: 3 (leaves_terrain)." in one.words
    assert one.pixels == 35


def test_mistakes(points, found) -> None:
    with pytest.raises(ValueError, match=r"confidence must be between 0 and 1; got 95\.0"):
        calibrate_errors(points, LEVEL, HALF, confidence=95.0)
    with pytest.raises(ValueError, match="no source to calibrate: attitude: held as asked; position: held as asked"):
        calibrated(found, hold=(sources.Attitude, sources.Position, sources.Boresight))
    few = found._replace(index=found.index[:4], noise=found.noise[:12, :12])
    with pytest.raises(ValueError, match=r"calibrate_errors has \d independent errors for \d factors"):
        calibrated(few, each_axis=True)


@pytest.mark.slow
def test_intervals_over_sets_through_the_exact_model() -> None:
    """60 sets of 3 flights over hills, seeds 0 and on (200 in benchmarks/error_models.py)."""
    terrain, made = hills(), block()
    held = []
    for seed in range(60):
        one = calibrate_errors(simulated(true_errors(), seed, terrain, made), terrain, HALF)
        held.append([part.least <= 2.0 <= part.most for part in one.components])
    assert np.all(np.mean(held, axis=0) > 0.87)
    assert np.mean(held) > 0.91
