"""The error budget: shares add up, and every figure is what propagating the changed errors gives."""

from __future__ import annotations

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.uncertainty import ErrorModel, propagate
from jaxgeo.uncertainty._budget import ROUGHNESS, budget, sigma_names, sigmas_of, with_sigmas
from jaxgeo.uncertainty.slopes import Surface
from jaxgeo.uncertainty.sources import (
    TerrainField,
    TerrainHeight,
)
from tests.support import looks

UV, GROUND = looks.LEVEL_UV, looks.LEVEL
a_sensor, a_shot, some_errors = looks.level_sensor, looks.level_shot, looks.level_errors


def propagated(errors: ErrorModel, outer: float = 60.0):
    return propagate(a_sensor(), a_shot(outer), UV, GROUND, errors)


@pytest.fixture(scope="module")
def look():
    return propagated(some_errors())


@pytest.fixture(scope="module")
def rough(look):
    """A propagation over rough ground, with a field of errors and two sources of one kind, without a search."""
    gaussian, spherical = [jnp.array([3.0, 500.0])], [jnp.array([2.0, 2000.0])]
    field = TerrainField.of_variograms(gaussian=gaussian, spherical=spherical, nodes=5)
    places = jnp.stack([jnp.array([200.0, 0.0, 0.0]) * k for k in range(5)])
    model = ErrorModel(
        (eqx.tree_at(lambda f: f.place, field, places), TerrainHeight.from_metres(1.0), TerrainHeight.from_metres(0.0))
    )
    jacobian = jnp.asarray(np.random.default_rng(0).normal(size=(3, model.size)))
    surface = Surface(jnp.array([0.1, -0.2, 1.0]), jnp.asarray(0.5), jnp.asarray(2.0), jnp.asarray(1.0))
    direction = look.nominal.direction_enu
    along = direction / (surface.normal @ direction)
    cov_enu = jacobian @ model.covariance() @ jacobian.T + 4.0 * jnp.outer(along, along)
    after = (jacobian, model.covariance(), cov_enu, 0.5 * along, surface, model)
    return eqx.tree_at(lambda p: (p.jacobian, p.cov_error, p.cov_enu, p.bias_enu, p.surface, p.model), look, after)


@pytest.mark.parametrize("which", ["look", "rough"])
def test_shares_add_up_to_the_covariance(which, request):
    propagation = request.getfixturevalue(which)
    result = budget(propagation)
    cov = np.asarray(propagation.cov_enu)
    whole = cov[0, 0] + cov[1, 1], cov[2, 2]
    np.testing.assert_allclose(result.total, whole, rtol=1e-14)
    np.testing.assert_allclose(np.sum(list(result.shares().values()), axis=0), whole, rtol=1e-12)
    np.testing.assert_allclose(np.sum([source.variance for source in result.sources], axis=0), whole, rtol=1e-12)
    assert result.circular_error == pytest.approx(float(propagation.circular_error(0.9)), rel=1e-12)


def test_sources_are_the_sums_of_their_independent_sigmas(look, rough):
    for source in (*budget(look).sources, *budget(rough).sources):
        if not source.is_block:
            parts = np.sum([line.variance for line in source.sigmas], axis=0)
            np.testing.assert_allclose(parts, source.variance, rtol=1e-12)


def test_only_the_whole_of_a_block_has_a_share(look):
    block = next(source for source in budget(look).sources if source.is_block)
    assert [line.variance for line in block.sigmas] == [None] * 5
    assert [line.unit for line in block.sigmas] == ["m", "m", "m", "px", "px"]
    shares = budget(look).shares()
    assert block.label in shares
    assert not any(line.name in shares for line in block.sigmas)


def test_slopes_are_central_differences_of_the_propagated_error(look):
    errors, today = some_errors(), np.asarray(sigmas_of(some_errors()))
    lines = [line for source in budget(look, 0.5).sources for line in source.sigmas]
    for k, line in enumerate(lines):
        step = 1e-4 * today * (np.arange(len(today)) == k)
        ahead, behind = (
            float(propagated(with_sigmas(errors, jnp.asarray(today + s))).circular_error(0.5)) for s in (step, -step)
        )
        assert line.slope * today[k] == pytest.approx((ahead - behind) / 2e-4, abs=1e-6)  # m


def test_error_without_a_sigma_is_propagated_without_it(look):
    errors, today = some_errors(), np.asarray(sigmas_of(some_errors()))
    result = budget(look)
    lines = [line for source in result.sources for line in source.sigmas]
    for k in (0, 6, 10):
        left = propagated(with_sigmas(errors, jnp.asarray(np.where(np.arange(len(today)) == k, 0.0, today))))
        assert lines[k].without == pytest.approx(float(left.circular_error(0.9)), abs=1e-9)  # m
    left = propagated(with_sigmas(errors, jnp.asarray(np.where(np.arange(len(today)) < 3, 0.0, today))))
    assert result.sources[0].without == pytest.approx(float(left.circular_error(0.9)), abs=1e-9)


def test_rough_ground_and_what_has_no_sigma_are_shown_too(rough):
    result = budget(rough)
    assert result.sources[-1].label == ROUGHNESS
    assert result.sources[-1].sigmas == ()
    gone = next(line for source in result.sources for line in source.sigmas if line.sigma == 0.0)
    assert gone.variance == (0.0, 0.0)
    assert gone.slope == 0.0
    assert gone.without == pytest.approx(result.circular_error, rel=1e-12)


def test_sources_of_one_kind_keep_apart(rough):
    assert sigma_names(rough.model) == (
        "terrain field: gaussian 0",
        "terrain field: spherical 1",
        "terrain height: height",
        "terrain height (2): height",
    )
    assert len(budget(rough).shares()) == 5


def test_table_is_sorted_and_reads_in_degrees(look):
    result = budget(look)
    lines = str(result).splitlines()
    percents = [float(part.split(" %")[0].split()[-1]) for part in lines if "%" in part]
    assert percents == sorted(percents, reverse=True)
    assert sum(percents) == pytest.approx(100.0, abs=0.05)
    heading = next(line for line in lines if line.startswith("attitude: heading"))
    assert "0.05 deg" in heading
    slope = next(line.slope for source in result.sources for line in source.sigmas if line.name == "attitude: heading")
    assert f"{np.deg2rad(slope):.4g} m/deg" in heading
    assert f"CE90 {result.circular_error:.3f} m" in lines[-1]


def test_dict_is_plain(look):
    plain = json.loads(json.dumps(budget(look).to_dict()))
    assert plain["sources"][0]["sigmas"][0]["sigma"] == pytest.approx(0.05)
    assert plain["sources"][0]["sigmas"][0]["unit"] == "deg"
    assert plain["status"] == "hit"


def test_with_sigmas_reaches_into_blocks():
    errors = some_errors()
    doubled = with_sigmas(errors, 2.0 * sigmas_of(errors))
    np.testing.assert_allclose(doubled.covariance(), 4.0 * errors.covariance(), rtol=1e-15)
    np.testing.assert_array_equal(doubled.sources[2].parts[1].sigma, [8.0, 4.0])


@pytest.mark.costly
def test_mistakes_are_named(look):
    with pytest.raises(ValueError, match="rises_away: The ray"):
        budget(propagated(some_errors(), outer=120.0))
    with pytest.raises(ValueError, match="one observation"):
        budget(jax.tree.map(lambda x: jnp.stack([x, x]), look))
    with pytest.raises(TypeError, match="Propagation"):
        budget(some_errors())
    with pytest.raises(ValueError, match="Write 90 %"):
        budget(look, 90.0)
    with pytest.raises(TypeError, match="outside jit"):
        jax.jit(lambda p: budget(p).circular_error)(look)
