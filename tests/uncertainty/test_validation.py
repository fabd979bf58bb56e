"""Stated against actual errors: a true model is accepted, a wrong one is found out, and no point is lost."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.stats

import jaxgeo
from jaxgeo.io.acquisitions import for_each
from jaxgeo.uncertainty import (
    CheckPoints,
    Validation,
    joint_covariance,
    propagate,
    sources,
    validate,
)
from jaxgeo.uncertainty._validate import _compared, _rank_test, circular_radii
from jaxgeo.uncertainty.check_errors import CheckErrors, errors_at
from jaxgeo.uncertainty.distributions import StudentT
from jaxgeo.uncertainty.host_arrays import take
from tests.support.check_points import LEVEL, SIGMA_PX, block, hills, simulated, true_errors

SETS = 400
MADE = block(flights=2, images=3, pixels=2, seed=4)


@pytest.fixture(scope="module")
def points() -> CheckPoints:
    return simulated(true_errors(), 1, LEVEL, MADE)


@pytest.fixture(scope="module")
def found(points) -> CheckErrors:
    return errors_at(points, LEVEL, true_errors(), jaxgeo.FirstHit())


def with_errors(found: CheckErrors, error: np.ndarray) -> CheckErrors:
    """The same pixels with other errors (n, 3)."""
    return found._replace(seen=found.seen._replace(error_enu=error))


def normal(found: CheckErrors, count: int, seed: int) -> np.ndarray:
    """Errors (count, n, 3) of the covariance that the model states."""
    root = np.linalg.cholesky(found.covariance())
    return (np.random.default_rng(seed).standard_normal((count, len(root))) @ root.T).reshape(count, -1, 3)


@pytest.mark.costly
def test_simulated_points_by_the_exact_model(points) -> None:
    """The simulation, and the first compilation."""
    assert len(points) == 12
    assert len(set(points.images)) == 6


@pytest.mark.costly
def test_joint_covariance_is_that_of_joint_covariance(points, found) -> None:
    """The oracle is `joint_covariance`, of one observation at a time."""
    observation = points.observation
    each = []
    for number in range(4):
        motion, uv = take((observation.exposure.motion, observation.uv), number)
        one = jaxgeo.Observation(jaxgeo.Exposure(observation.exposure.sensor, motion), uv)
        each.append(propagate(one, LEVEL, _with_pixel()))
    whole = joint_covariance(each, shots=points.images[:4].tolist(), flights=points.flights[:4].tolist())
    R = np.zeros((12, 12))
    for number, one in enumerate(each):
        R[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] = np.asarray(one.nominal.R_ecef_from_enu)
    survey = np.diag(np.tile(points.sigma_enu[0] ** 2, 4))
    wanted = R.T @ np.asarray(whole.cov_ecef) @ R + survey
    np.testing.assert_allclose(found.covariance()[:12, :12], wanted, atol=1e-9)  # m2


def _with_pixel() -> jaxgeo.ErrorModel:
    pixel = sources.PixelMeasurement.from_pixels(column=SIGMA_PX, row=SIGMA_PX)
    return jaxgeo.ErrorModel((*true_errors().sources, pixel))


@pytest.mark.costly
def test_a_stated_pixel_error_and_a_source_of_it_are_the_same(points, found) -> None:
    other = errors_at(dataclasses.replace(points, sigma_px=None), LEVEL, _with_pixel(), jaxgeo.FirstHit())
    np.testing.assert_allclose(other.covariance(), found.covariance(), atol=1e-12)  # m2


@pytest.mark.costly
def test_pixels_of_one_point_share_its_survey(points, found) -> None:
    names = np.array(["a", "a", *map(str, range(2, 12))])
    same = jax.tree.map(lambda x: np.concatenate([x[:1], x[:1], x[2:]]), points.position)
    shared = errors_at(
        dataclasses.replace(points, position=same, points=names), LEVEL, true_errors(), jaxgeo.FirstHit()
    )
    apart = shared.covariance() - found.covariance()
    wanted = np.zeros((36, 36))
    wanted[:3, 3:6] = wanted[3:6, :3] = np.diag(points.sigma_enu[0] ** 2)
    np.testing.assert_allclose(apart, wanted, atol=1e-12)  # m2


@pytest.mark.costly
def test_a_true_model_has_uniform_p_values(found) -> None:
    """400 sets of errors of the stated covariance, seed 7."""
    errors = normal(found, SETS, 7)
    joint, root = found.covariance(), np.linalg.cholesky(found.covariance())
    nees = np.sum(np.linalg.solve(root, errors.reshape(SETS, -1).T) ** 2, axis=0)
    assert scipy.stats.kstest(nees, "chi2", args=(36,)).pvalue > 0.01
    some = [_compared(with_errors(found, one)) for one in errors[:40]]
    np.testing.assert_allclose([one.size.nees for one in some], nees[:40], rtol=1e-8)
    np.testing.assert_allclose([one.nees_each.sum() for one in some], _own(errors[:40], joint), rtol=1e-8)
    assert np.mean([one.is_consistent for one in some]) > 0.85


def _own(errors: np.ndarray, joint: np.ndarray) -> np.ndarray:
    blocks = np.stack([joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(errors.shape[1])])
    return np.einsum("sia,iab,sib->s", errors, np.linalg.inv(blocks), errors)


@pytest.mark.costly
@pytest.mark.parametrize("factor, words", [(2.0, "optimistic"), (0.5, "pessimistic")])
def test_sigmas_wrong_by_two_are_found_out(found, factor: float, words: str) -> None:
    """Power: of 20 sets of errors twice or half as large as stated, seed 3, all are refused."""
    for one in factor * normal(found, 20, 3):
        told = _compared(with_errors(found, one))
        assert "size" in told.rejected
        assert words in told.words
        assert told.size.least < factor < told.size.most or abs(told.size.factor / factor - 1.0) < 0.5


@pytest.mark.costly
def test_a_bias_and_a_trend_are_named(found) -> None:
    error = normal(found, 1, 5)[0]
    up = np.sqrt(np.diag(found.covariance())[2::3])
    told = _compared(with_errors(found, error + 5.0 * up[:, None] * np.array([0.0, 0.0, 1.0])))
    assert "bias up" in told.rejected
    assert "up +" in told.words
    distance = np.argsort(np.argsort(found.seen.slant_range))
    more = 100.0 * np.random.default_rng(6).standard_normal((12, 3)) * (0.05 + distance)[:, None]
    apart = with_errors(found, more)._replace(noise=1e4 * np.eye(36))  # m2: far more than what is shared
    trend = next(one for one in _compared(apart).dependence if one.name == "range")
    assert trend.correlation > 0.5
    assert trend.p < 0.05


def _spearman(one: np.ndarray, other: np.ndarray) -> float:
    test: Any = scipy.stats.spearmanr(one, other)
    return float(test.statistic)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_few_ranks_are_tested_by_all_their_orders(count: int) -> None:
    """The oracle is SciPy's permutation test, which goes through all of them."""
    random = np.random.default_rng(count)
    one, other = random.standard_normal((2, count))
    other[1] = other[0]  # a tie
    exact: Any = scipy.stats.permutation_test(
        (one,), lambda x: _spearman(x, other), permutation_type="pairings", n_resamples=1000
    )
    correlation, p = _rank_test(one, other)
    assert correlation == pytest.approx(exact.statistic)
    assert p == pytest.approx(np.mean(np.abs(exact.null_distribution) >= abs(exact.statistic) - 1e-9))
    assert _rank_test(np.arange(3.0), np.arange(3.0))[1] == pytest.approx(2.0 / 6.0)


@pytest.mark.costly
@pytest.mark.parametrize("error", [np.zeros(3), np.array([0.1, -0.2, 0.3])])
def test_errors_without_scatter_are_told_of_without_warnings(found, error: np.ndarray) -> None:
    one = _compared(with_errors(found, np.tile(error, (12, 1))))
    assert np.isnan([axis.t for axis in one.bias]).all()
    json.dumps(one.to_dict(), allow_nan=False)
    if not error.any():
        assert "against range, since it is the same for all" in one.words
    assert "slope, which is the same for all" in one.words


@pytest.mark.costly
def test_large_figures_are_in_full(found) -> None:
    words = _compared(with_errors(found, np.asarray(found.seen.error_enu) + 1000.0)).words
    assert "e+" not in words
    assert "east +1000 m" in words


@pytest.mark.costly
def test_shared_errors_count_for_fewer_points(found) -> None:
    one = _compared(found)
    across = [c for c in one.coverage if c.name.startswith("CE")]
    assert all(1.0 <= c.effective < 10.0 for c in across)  # 12 pixels in 6 images of 2 flights
    wide = scipy.stats.binomtest(across[0].inside, 12).proportion_ci(0.95)
    assert across[0].high - across[0].low > wide.high - wide.low
    apart = found._replace(noise=found.noise + 1e4 * np.eye(36))  # of which nothing is shared
    (first, *_) = _compared(apart).coverage
    exact = scipy.stats.binomtest(first.inside, 12).proportion_ci(0.95, method="exact")
    assert first.effective == 12.0
    np.testing.assert_allclose([first.low, first.high], [exact.low, exact.high], atol=1e-12)


def test_radii_are_those_of_the_exact_metric() -> None:
    random = np.random.default_rng(2)
    roots = random.standard_normal((20, 2, 2)) * random.uniform(0.001, 1.0, (20, 1, 2))
    cov = roots @ roots.transpose(0, 2, 1)
    wanted = np.stack([np.asarray(jaxgeo.circular_error(cov, p)) for p in (0.5, 0.9, 0.95)], axis=1)
    np.testing.assert_allclose(circular_radii(cov), wanted, rtol=1e-5)


def test_points_without_a_fix_are_named_and_counted(points) -> None:
    away = np.array(points.observation.uv)
    shots = points.observation.exposure.motion
    pitch = np.array(shots.pose.pitch)
    pitch[0] = 2.0  # looks at the sky
    shots = eqx.tree_at(lambda s: s.pose.pitch, shots, pitch)
    sensor = points.observation.exposure.sensor
    lost = dataclasses.replace(points, observation=jaxgeo.Observation(jaxgeo.Exposure(sensor, shots), away))
    told = validate(lost, LEVEL, true_errors())
    assert len(told.index) == 11
    assert "Not tested, rises_away: 0." in told.words
    assert "11 of 12 pixels have a fix" in told.words
    row = told.to_dict()["points"][0]
    assert (row["status"], row["nees"], row["error_up_m"]) == ("rises_away", None, None)


def test_errors_that_are_not_normal_are_noted(points) -> None:
    heavy = sources.Attitude.from_degrees(heading=0.03, pitch=0.01, roll=0.01, distribution=StudentT(4.0))
    told = validate(points, LEVEL, jaxgeo.ErrorModel((heavy, *true_errors().sources[1:])))
    assert "not normal" in told.words
    without = sources.Attitude.from_degrees(heading=0.03, pitch=0.01, roll=0.01, distribution=StudentT(1.5))
    with pytest.raises(ValueError, match=r"attitude: .* has no finite variance"):
        validate(points, LEVEL, jaxgeo.ErrorModel((without,)))


def refused(given: CheckPoints, **changes: Any) -> CheckPoints:
    return dataclasses.replace(given, **changes)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"sigma_enu": 0.0}, r"sigma_enu of point 0 must be positive and finite, in m; got 0\."),
        ({"sigma_enu": (0.1, 0.1, -1.0)}, r"sigma_enu of point 0 must be positive .* got -1\."),
        ({"sigma_px": np.nan}, r"sigma_px of point 0 must be positive and finite, in pixels; got nan\."),
        ({"sigma_enu": (1.0, 2.0)}, r"sigma_enu must be a number, \(3,\) or \(12, 3\) in m; got \(2,\)\."),
        ({"images": ["a"]}, r"images must name each of the 12 pixels; got shape \(1,\)\."),
        ({"points": ["a"] * 12}, r"point a has two positions; name them differently\."),
    ],
)
def test_mistakes_in_points(points, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        refused(points, **changes)


def test_a_position_that_is_not_finite(points) -> None:
    place = eqx.tree_at(lambda p: p.height, points.position, np.full(12, np.nan))
    with pytest.raises(ValueError, match=r"position of point 0 is not finite; leave the point out\."):
        refused(points, position=place)


def test_mistakes_in_the_model(points) -> None:
    with pytest.raises(ValueError, match="measuring error of the pixels is stated twice"):
        validate(points, LEVEL, _with_pixel())
    with pytest.raises(ValueError, match="measuring error of the pixels is not stated"):
        validate(refused(points, sigma_px=None), LEVEL, true_errors())
    negative = eqx.tree_at(lambda m: m.sources[0].sigma, true_errors(), jnp.array([0.1, -0.1, 0.1]))
    with pytest.raises(ValueError, match=r"attitude: sigma of pitch must not be negative"):
        validate(points, LEVEL, negative)


def test_too_few_points(points) -> None:
    exposure = points.observation.exposure
    motion, uv, place = take((exposure.motion, points.observation.uv, points.position), np.arange(2))
    few = CheckPoints(
        jaxgeo.Observation(jaxgeo.Exposure(exposure.sensor, motion), uv), place, sigma_enu=0.1, sigma_px=1.0
    )
    with pytest.raises(ValueError, match=r"validate needs 3 or more pixels with a fix.* there are only 2 pixels"):
        validate(few, LEVEL, true_errors())


@pytest.mark.slow
def test_sets_through_the_exact_model_over_hills() -> None:
    """80 sets of 3 flights, seeds 100 and on: uniform p-values of a true model, power against sigmas of half."""
    terrain, made = hills(), block()
    found: list[Validation] = []
    for seed in range(80):
        points = simulated(true_errors(), 100 + seed, terrain, made)
        found.append(validate(points, terrain, true_errors()))
        if seed < 10:
            assert "size" in validate(points, terrain, true_errors(0.5)).rejected
    for name in found[0].tests:
        assert scipy.stats.kstest([one.tests[name] for one in found], "uniform").pvalue > 0.001, name
    for number, one in enumerate(found[0].coverage):
        shares = np.array([each.coverage[number].share for each in found])
        error = shares.std() / np.sqrt(len(shares))
        assert abs(shares.mean() - one.level) < 4.0 * error + 1e-3, one.name
    assert np.mean([one.is_consistent for one in found]) > 0.88


@pytest.mark.slow
def test_terrain_errors_that_fade_with_distance(points) -> None:
    """The oracle is `joint_covariance`, of one observation at a time."""
    terrain = hills()
    field = sources.TerrainField.of_variograms(gaussian=[(2.0, 400.0)], nodes=5)
    model = jaxgeo.ErrorModel((field, _with_pixel().sources[-1]))
    found = errors_at(dataclasses.replace(points, sigma_px=None), terrain, model, jaxgeo.FirstHit())
    each = []
    for number in range(3):
        motion, uv = take((points.observation.exposure.motion, points.observation.uv), number)
        one = jaxgeo.Observation(jaxgeo.Exposure(points.observation.exposure.sensor, motion), uv)
        each.append(propagate(one, terrain, model))
    whole = joint_covariance(each)
    R = scipy.linalg.block_diag(*[np.asarray(one.nominal.R_ecef_from_enu) for one in each])
    survey = np.diag(np.tile(points.sigma_enu[0] ** 2, 3))
    np.testing.assert_allclose(
        found.covariance()[:9, :9], R.T @ np.asarray(whole.cov_ecef) @ R + survey, atol=1e-9
    )  # m2


def test_sigmas_of_each_image(points) -> None:
    one = sources.Position.from_ned(north=0.1, east=0.1, down=0.1)
    each = for_each(one, 12)
    scale = np.linspace(1.0, 5.0, 12)
    each = eqx.tree_at(lambda source: source.sigma, each, np.asarray(each.sigma) * scale[:, None])
    (alike,), (own,) = (errors_at(points, LEVEL, (model,), jaxgeo.FirstHit()).parts() for model in (one, each))
    wide = np.repeat(scale, 3)
    np.testing.assert_allclose(own.covariance, wide[:, None] * alike.covariance * wide[None, :], atol=1e-12)  # m2
