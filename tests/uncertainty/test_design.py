"""Inverse design: closed forms, the conditions of an optimum, and samples of what was designed."""

from __future__ import annotations

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.uncertainty import ErrorModel, Sampling, propagate
from jaxgeo.uncertainty._budget import sigmas_of, with_sigmas
from jaxgeo.uncertainty._design import InverseCost, Outcome, certified_design, design
from tests.support import looks

pytestmark = pytest.mark.costly

UV, GROUND = looks.LEVEL_UV, looks.LEVEL
a_sensor, a_shot, some_errors = looks.level_sensor, looks.level_shot, looks.level_errors

COUNT = 11  # sigmas
WEIGHTS = 1.0 + np.arange(COUNT) % 4


def propagated(errors: ErrorModel, outer: float = 60.0):
    return propagate(a_sensor(), a_shot(outer), UV, GROUND, errors)


@pytest.fixture(scope="module")
def look():
    return propagated(some_errors())


@pytest.fixture(scope="module")
def today(look) -> float:
    return float(look.circular_error(0.9))


@pytest.fixture(scope="module")
def along_a_line(look):
    """A propagation whose errors are independent and all push the fix along one line, sigma k by `slopes[k]` m."""
    slopes = jnp.asarray(np.random.default_rng(2).uniform(0.5, 2.0, COUNT)) / sigmas_of(look.model)
    jacobian = jnp.array([[0.6], [0.8], [0.0]]) * slopes[None, :]
    model = eqx.tree_at(lambda m: m.sources[2].correlation, look.model, jnp.eye(5))
    cov = jacobian @ model.covariance() @ jacobian.T
    return eqx.tree_at(lambda p: (p.jacobian, p.model, p.cov_enu), look, (jacobian, model, cov)), slopes


def test_a_design_meets_its_target_for_less_than_equal_scaling(look, today):
    result = design(look, target=0.4 * today, cost=InverseCost(WEIGHTS))
    assert result.outcome is Outcome.optimal
    assert result.circular_error == pytest.approx(0.4 * today, rel=1e-8)
    assert float(propagated(result.model).circular_error(0.9)) == pytest.approx(0.4 * today, rel=1e-8)
    assert result.equal_factor == pytest.approx(0.4, rel=1e-9)
    assert result.equal_cost == pytest.approx(np.sum(WEIGHTS) / 0.4, rel=1e-9)
    assert result.cost < 0.9 * result.equal_cost
    assert result.kkt_residual < 1e-6
    np.testing.assert_allclose(sigmas_of(result.model), result.sigmas)


def test_errors_along_a_line_have_a_closed_form(along_a_line):
    """Of sum w s0/s with sum (a s)^2 held, Lagrange gives s^3 as w s0/a^2."""
    propagation, slopes = along_a_line
    old, slopes = np.asarray(sigmas_of(propagation.model)), np.asarray(slopes)
    target = 0.5 * float(propagation.circular_error(0.9))
    result = design(propagation, target=target, cost=InverseCost(WEIGHTS))
    expected = (WEIGHTS * old / slopes**2) ** (1.0 / 3.0)
    expected *= 0.5 * np.sqrt(np.sum((slopes * old) ** 2) / np.sum((slopes * expected) ** 2))
    np.testing.assert_allclose(result.sigmas / expected, 1.0, atol=1e-5)
    assert result.cost == pytest.approx(np.sum(WEIGHTS * old / expected), rel=1e-9)
    assert result.multiplier == pytest.approx(result.cost / target, rel=1e-5)  # the cost goes as 1 / target


def test_the_multiplier_is_the_cost_of_a_metre(look, today):
    costs = [design(look, target=0.4 * today + step).cost for step in (-0.01, 0.01)]
    multiplier = design(look, target=0.4 * today).multiplier
    assert multiplier == pytest.approx((costs[0] - costs[1]) / 0.02, rel=1e-4)


def test_bounds_hold_and_are_named(look, today):
    low, high = np.full(COUNT, 0.4), np.full(COUNT, 0.8)
    low[0] = high[0] = 1.0
    result = design(look, target=0.5 * today, bounds=(low, high), cost=InverseCost(WEIGHTS))
    factors = result.sigmas / result.today
    assert result.outcome is Outcome.optimal
    assert np.all((factors >= low * (1.0 - 1e-9)) & (factors <= high * (1.0 + 1e-9)))
    assert result.at_lowest == tuple(n for n, f in zip(result.names[1:], factors[1:], strict=True) if f < 0.4 + 1e-6)
    assert result.at_highest == tuple(n for n, f in zip(result.names[1:], factors[1:], strict=True) if f > 0.8 - 1e-6)
    assert result.at_lowest
    assert result.at_highest
    assert result.cost <= result.equal_cost


def test_a_target_out_of_reach_says_how_near_it_comes(along_a_line):
    propagation, _ = along_a_line
    today = float(propagation.circular_error(0.9))
    result = design(propagation, target=0.4 * today, bounds=(0.5, 2.0))
    assert result.outcome is Outcome.infeasible
    assert result.circular_error == pytest.approx(0.5 * today, rel=1e-9)
    assert result.at_lowest == result.names
    assert np.isnan(result.equal_cost)


def test_errors_that_cancel_are_not_all_best_at_their_lowest(look):
    """Of 1 m and s, correlated by -0.9 and added, the sum is least for s = 0.9 m: its variance is 0.19 m2."""
    old = sigmas_of(look.model)
    pushed = jnp.zeros(COUNT).at[5].set(2.0).at[6].set(0.5) / old
    correlation = jnp.eye(5).at[0, 1].set(-0.9).at[1, 0].set(-0.9)
    model = eqx.tree_at(lambda m: m.sources[2].correlation, look.model, correlation)
    propagation = eqx.tree_at(lambda p: (p.jacobian, p.model), look, (jnp.zeros((3, COUNT)).at[0].set(pushed), model))
    closest = design(propagation, target=1e-3, bounds=(0.5, 10.0))
    assert closest.outcome is Outcome.infeasible
    assert closest.circular_error == pytest.approx(1.6448536269514722 * np.sqrt(0.19), rel=1e-6)
    assert closest.sigmas[6] / closest.today[6] == pytest.approx(1.8, abs=1e-3)
    assert design(propagation, target=0.75, bounds=(0.5, 10.0)).outcome is Outcome.optimal


def test_a_target_met_by_the_highest_is_slack(look, today):
    result = design(look, target=3.0 * today, bounds=(0.5, 2.0))
    assert result.outcome is Outcome.slack
    assert result.at_highest == result.names
    assert result.circular_error == pytest.approx(2.0 * today, rel=1e-9)
    assert result.cost == pytest.approx(0.5 * COUNT)


def test_any_cost_may_be_given(look, today):
    own = design(look, target=0.4 * today, cost=lambda sigma, old: jnp.sum(jnp.asarray(WEIGHTS) * old / sigma))
    ready = design(look, target=0.4 * today, cost=InverseCost(WEIGHTS))
    np.testing.assert_allclose(own.sigmas / ready.sigmas, 1.0, atol=1e-6)
    squared = design(look, target=0.4 * today, cost=lambda sigma, old: jnp.sum((old / sigma) ** 2))
    assert squared.outcome is Outcome.optimal
    assert squared.cost < squared.equal_cost


def test_what_is_exact_today_stays_so_and_costs_nothing():
    old = sigmas_of(some_errors()).at[0].set(0.0)
    propagation = propagated(with_sigmas(some_errors(), old))
    result = design(propagation, target=0.5 * float(propagation.circular_error(0.9)))
    assert result.outcome is Outcome.optimal
    assert result.sigmas[0] == 0.0
    assert result.equal_cost == pytest.approx(2.0 * (COUNT - 1))


@pytest.mark.slow
def test_samples_certify_a_design(look, today):
    result = design(look, target=0.5 * today, cost=InverseCost(WEIGHTS))
    certificate = result.certify(a_sensor(), a_shot(), UV, GROUND, sampling=Sampling(count=4096, key=jax.random.key(0)))
    assert certificate.holds
    assert certificate.sampled.share == 1.0
    assert certificate.target == pytest.approx(0.5 * today)
    assert not certificate._replace(target=0.9 * certificate.sampled.low).holds
    assert certificate._replace(target=certificate.sampled.high).is_proven


@pytest.mark.slow
def test_what_samples_show_is_designed_again(look, today):
    """A propagation that says three quarters of how far the fix errs needs sigmas of three quarters."""
    optimistic = eqx.tree_at(lambda p: p.jacobian, look, 0.75 * look.jacobian)
    options = {"target": 0.5 * today, "cost": InverseCost(WEIGHTS)}
    place, key = (a_sensor(), a_shot(), UV, GROUND), jax.random.key(0)
    assert not design(optimistic, **options).certify(*place, sampling=Sampling(count=4096, key=key)).holds
    result, certificate = certified_design(optimistic, *place, sampling=Sampling(count=4096, key=key), **options)
    assert certificate.holds
    assert result.circular_error == pytest.approx(0.5 * today)
    assert result.ratio == pytest.approx(1.0 / 0.75, rel=0.05)
    np.testing.assert_allclose(result.sigmas / design(look, **options).sigmas, 1.0, atol=0.05)


def test_dict_is_plain(look, today):
    plain = json.loads(json.dumps(design(look, target=0.4 * today).to_dict()))
    assert plain["outcome"] == "optimal"
    assert len(plain["sigmas"]) == COUNT
    assert plain["sigmas"][0]["unit"] == "rad"


@pytest.mark.parametrize(
    "options, words",
    [
        ({"target": 0.0}, "target must be a positive"),
        ({"target": float("nan")}, "target must be a positive"),
        ({"target": 5.0, "probability": 1.0}, "between 0 and 1"),
        ({"target": 5.0, "ratio": 0.0}, "ratio must be"),
        ({"target": 5.0, "bounds": (2.0, 0.5)}, "in order"),
        ({"target": 5.0, "bounds": (0.0, 2.0)}, "positive multiples"),
        ({"target": 5.0, "bounds": (0.5, 1.0, 2.0)}, "must be two"),
        ({"target": 5.0, "bounds": (np.ones(3), 2.0)}, "one number or 11"),
        ({"target": 5.0, "cost": InverseCost(np.ones(3))}, "one number or 11"),
        ({"target": 5.0, "cost": InverseCost([1.0, -2.0] * 5 + [1.0])}, "must not be negative"),
        ({"target": 5.0, "cost": lambda sigma, old: -jnp.sum(old / sigma)}, "at least 0"),
    ],
)
def test_mistakes_are_named(look, options, words):
    with pytest.raises(ValueError, match=words):
        design(look, **options)


def test_a_look_without_a_fix_is_refused():
    with pytest.raises(ValueError, match="rises_away"):
        design(propagated(some_errors(), outer=120.0), target=5.0)
