"""Sobol indices: a function whose own are known, another program's, and the linear budget where the map is one."""

from __future__ import annotations

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from jaxgeo._intersection import FIRST_HIT
from jaxgeo.uncertainty import ErrorModel, Random, Sampling, Sobol, propagate
from jaxgeo.uncertainty._budget import budget, sigmas_of, with_sigmas
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sensitivity import (
    COMPONENTS,
    evaluate,
    groups_of,
    make_plan,
    offsets_of,
    sobol_estimate,
    sobol_indices,
)
from tests.support import looks

UV, GROUND = looks.LEVEL_UV, looks.LEVEL
a_sensor, a_shot = looks.level_sensor, looks.level_shot

ROWS = 512
A, B = 7.0, 0.1  # of Ishigami's function
CAUSED = {1: 0.5 * (1.0 + B * np.pi**4 / 5.0) ** 2, 2: A**2 / 8.0, 13: B**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)}
FIRST = np.array([CAUSED[1], CAUSED[2], 0.0]) / sum(CAUSED.values())
TOTAL = np.array([CAUSED[1] + CAUSED[13], CAUSED[2], CAUSED[13]]) / sum(CAUSED.values())


def some_errors(scale: float = 1.0) -> ErrorModel:
    errors = looks.level_errors()
    return with_sigmas(errors, scale * sigmas_of(errors))


def indices_at(outer: float, scale: float, **options):
    sampling = Sampling(count=ROWS, key=jax.random.key(3))
    return sobol_indices(a_sensor(), a_shot(outer), UV, GROUND, some_errors(scale), sampling=sampling, **options)


def ishigami(normals: np.ndarray) -> np.ndarray:
    x = np.pi * (2.0 * ndtr(normals) - 1.0)
    return (np.sin(x[..., 0]) + A * np.sin(x[..., 1]) ** 2 + B * x[..., 2] ** 4 * np.sin(x[..., 0]))[..., None]


@pytest.fixture(scope="module", params=[Random(), Sobol()], ids=["random", "sobol"])
def rows(request):
    """Ishigami's values at A, B and A with one column from B, and what is independent among the rows."""
    draws, count = request.param, 2048
    both = jax.jit(jax.vmap(lambda k: draws.standard_normal(jax.random.key(1), k, 6)))(jnp.arange(count))
    a, b = np.asarray(both[:, :3]), np.asarray(both[:, 3:])
    mixed = np.stack([np.where(np.arange(3)[None, :] == k, b, a) for k in range(3)])
    return *map(ishigami, (a, b, mixed)), np.arange(count) % 16 if isinstance(draws, Sobol) else None


def test_indices_of_a_function_whose_own_are_known(rows):
    *values, units = rows
    estimate = sobol_estimate(*values, units=units, confidence=0.999)
    assert np.all(np.abs(estimate.first[:, 0] - FIRST) < estimate.first_half[:, 0])
    assert np.all(np.abs(estimate.total[:, 0] - TOTAL) < estimate.total_half[:, 0])
    assert np.all(estimate.total_half < 0.15)
    assert estimate.variance[0] == pytest.approx(sum(CAUSED.values()), rel=0.05)


def test_estimates_are_those_of_another_program(rows):
    analyze = pytest.importorskip("SALib.analyze.sobol").analyze
    base, other, mixed, _ = rows
    in_turn = np.concatenate([base[None], mixed, other[None]])[..., 0].T.ravel()
    problem = {"num_vars": 3, "names": ["a", "b", "c"], "bounds": [[0.0, 1.0]] * 3}
    theirs = analyze(problem, in_turn, calc_second_order=False, num_resamples=500, seed=1)
    ours = sobol_estimate(base, other, mixed)
    # They take the mean of all evaluations off, we that of A and B.
    np.testing.assert_allclose(ours.first[:, 0], theirs["S1"], atol=2e-3)
    np.testing.assert_allclose(ours.total[:, 0], theirs["ST"], rtol=1e-10)
    np.testing.assert_allclose(ours.total_half[:, 0], theirs["ST_conf"], rtol=0.2)
    np.testing.assert_allclose(ours.first_half[:, 0], theirs["S1_conf"], rtol=0.2)


def test_sums_of_outputs_weigh_their_indices_by_variance(rows):
    base, other, mixed, _ = (np.concatenate([x, 3.0 * x**2], axis=-1) if x is not None else x for x in rows)
    estimate = sobol_estimate(base, other, mixed, sums=np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
    weights = estimate.variance[:2] / estimate.variance[2]
    np.testing.assert_allclose(estimate.first[:, :2] @ weights, estimate.first[:, 2], rtol=1e-12)
    np.testing.assert_allclose(estimate.total[:, :2] @ weights, estimate.total[:, 2], rtol=1e-12)


def test_what_does_not_vary_has_no_indices():
    still, moving = np.zeros((8, 1)), np.arange(8.0)[:, None]
    estimate = sobol_estimate(still, still, still[None])
    assert np.isnan(estimate.first).all()
    assert np.isnan(estimate.total_half).all()
    assert np.isnan(sobol_estimate(moving[:1], moving[:1], moving[None, :1]).first).all()


@pytest.mark.slow
def test_where_the_map_is_linear_indices_are_the_shares_of_the_budget():
    indices = indices_at(60.0, 0.01, by_axis=True, confidence=0.999)
    shares = budget(propagate(a_sensor(), a_shot(), UV, GROUND, some_errors())).shares()
    whole = np.sum(list(shares.values()), axis=0)
    assert indices.left_out == 0.0
    assert set(indices.groups) == {name.removesuffix(": height") for name in shares}
    for name, (across, up) in shares.items():
        index = indices.of(name.removesuffix(": height"))
        assert index.first_low < across / whole[0] < index.first_high
        assert index.total_low < across / whole[0] < index.total_high
        height = indices.of(name.removesuffix(": height"), "up")
        assert height.total_low <= up / whole[1] + 1e-6
        assert height.total_high >= up / whole[1] - 1e-6


@pytest.mark.costly
def test_a_look_gives_the_indices_of_another_program():
    analyze = pytest.importorskip("SALib.analyze.sobol").analyze
    draw = pytest.importorskip("SALib.sample.sobol").sample
    indices = indices_at(76.0, 4.0)  # so far off, and with such errors, that sources act together
    look = ModelInputs.of(a_sensor(), a_shot(76.0), UV, GROUND)
    plan = make_plan(look, look.nominal_fix(FIRST_HIT), some_errors(4.0))
    names, members = groups_of(plan.model, False)
    groups = [names[int(np.argmax(members[:, axis]))] for axis in range(plan.model.size)]
    problem = {
        "num_vars": plan.model.size,
        "names": list(plan.model.axes),
        "groups": groups,
        "bounds": [[0.0, 1.0]] * plan.model.size,
    }
    normals = ndtri(np.clip(draw(problem, ROWS, calc_second_order=False, seed=5), 1e-12, 1.0 - 1e-12))
    parts = [offsets_of(plan, jnp.asarray(part), FIRST_HIT) for part in normals.reshape(-1, ROWS, plan.model.size)]
    assert all(np.all(found) for _, found in parts)
    misses = np.concatenate([np.asarray(miss) for miss, _ in parts])
    for component, values in zip(COMPONENTS, misses.T, strict=False):
        theirs = analyze(problem, values, calc_second_order=False, num_resamples=200, seed=5)
        for k, name in enumerate(names):
            ours = indices.of(name, component)
            assert abs(ours.first - theirs["S1"][k]) < ours.first_high - ours.first + theirs["S1_conf"][k]
            assert abs(ours.total - theirs["ST"][k]) < ours.total_high - ours.total + theirs["ST_conf"][k]


@pytest.mark.costly
def test_rows_without_a_fix_are_left_out_and_said():
    indices = indices_at(84.0, 60.0)
    assert 0.1 < indices.left_out < 0.9
    assert indices.warning is not None
    assert indices.warning in str(indices)
    assert indices.to_dict()["warning"] == indices.warning
    assert np.all(np.isfinite(indices.estimate.total))
    assert indices_at(60.0, 1.0).warning is None


def test_rows_do_not_hang_on_the_size_of_chunks():
    def push(z):
        return z[:, :3] + z[:, 3:], z[:, 0] < 1.0

    members = np.eye(6, dtype=bool)[:2]
    whole, parts = (evaluate(push, Random(), jax.random.key(0), members, 50, size) for size in (50, 20))
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(one, other)
    misses, _ = whole
    np.testing.assert_array_equal(misses[2, :, 1:], misses[0, :, 1:])
    assert not np.any(misses[2, :, 0] == misses[0, :, 0])


@pytest.mark.costly
def test_table_and_dict_name_every_group():
    indices = indices_at(60.0, 1.0)
    assert all(group in str(indices) for group in indices.groups)
    plain = json.loads(json.dumps(indices.to_dict()))
    assert plain["indices"]["attitude"]["east"]["total"] == indices.of("attitude", "east").total
    assert indices.variance["horizontal"] == pytest.approx(indices.variance["east"] + indices.variance["north"])


@pytest.mark.parametrize(
    "options, words",
    [
        ({"count": 1}, "count must be a whole number of samples, 2 or more"),
        ({"chunk": 0}, "1 or more"),
        ({"resamples": 1}, "at least 2"),
        ({"confidence": 95.0}, "0.95"),
        ({"draws": Sobol(scrambles=4)}, "16 scrambles or more"),
        ({"half_width": 0.1}, "half_width and devices are options of sample"),
    ],
)
def test_mistakes_are_named(options, words):
    own = {name: options.pop(name) for name in ("resamples", "confidence") if name in options}
    sampling = Sampling(**{"count": ROWS, **options})
    with pytest.raises(ValueError, match=words):
        sobol_indices(a_sensor(), a_shot(), UV, GROUND, some_errors(), sampling=sampling, **own)


@pytest.mark.costly
def test_names_that_are_none_are_refused():
    with pytest.raises(ValueError, match="group must be one of attitude"):
        indices_at(60.0, 1.0).of("weather")
    with pytest.raises(ValueError, match="rises_away"):
        indices_at(120.0, 1.0)
