"""Radii without samples: those of linear propagation, in proportion to what the terrain profile makes of them."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.uncertainty import accuracy, propagate
from jaxgeo.uncertainty.linear_accuracy import STEPS, _factor, over_profile
from jaxgeo.uncertainty.method_selection import AGREEMENT
from tests.support import looks

RADII = tuple(map(jnp.asarray, (10.0, 3.0, 10.4)))


@pytest.mark.parametrize("off", [0.0, STEPS, -STEPS])
def test_figures_that_are_the_same_within_the_steps_change_nothing(off: float) -> None:
    assert _factor(jnp.asarray(10.0 * np.exp(off)), jnp.asarray(10.0), AGREEMENT) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("ratio", [1.06, 0.93, 1.003])
def test_others_are_divided(ratio: float) -> None:
    found = _factor(jnp.asarray(10.0 * ratio), jnp.asarray(10.0), AGREEMENT)
    assert abs(np.log(found / ratio)) == pytest.approx(STEPS, rel=1e-9)


@pytest.mark.parametrize("profile", [0.0, np.inf, np.nan, 1e-3, 1e3])
def test_a_profile_that_says_nothing_changes_no_more_than_the_agreement(profile: float) -> None:
    found = _factor(jnp.asarray(profile), jnp.asarray(10.0), AGREEMENT)
    assert abs(np.log(found)) <= AGREEMENT * (1.0 + 1e-12)


@pytest.mark.parametrize("xp", [np, jnp], ids=["NumPy", "JAX"])
@pytest.mark.parametrize("factors", [(1.0, 1.0), (1.06, 0.9), (0.92, 1.1)])
def test_the_spherical_error_follows_both(factors: tuple[float, float], xp: Any) -> None:
    circular, linear, spherical = over_profile(xp, tuple(map(xp.asarray, RADII)), xp.asarray(factors))
    np.testing.assert_allclose((circular, linear), (10.0 * factors[0], 3.0 * factors[1]), rtol=1e-15)
    beyond = 10.4**2 - 10.0**2  # what the height adds to the square
    np.testing.assert_allclose(spherical**2, circular**2 + beyond * factors[1] ** 2, rtol=1e-12)


def test_derivatives_are_those_of_linear_propagation_times_the_factors() -> None:
    def scaled(sigma: jax.Array) -> jax.Array:
        return jnp.stack(over_profile(jnp, tuple(one * sigma for one in RADII), jnp.asarray([1.06, 0.9])))

    found, slope = jax.jvp(scaled, (jnp.asarray(1.0),), (jnp.asarray(1.0),))
    np.testing.assert_allclose(slope, found, rtol=1e-12)  # in proportion to sigma


@pytest.mark.costly
@pytest.mark.parametrize("probability", [0.05, 0.5, 0.9, 0.99])
def test_on_level_ground_they_are_those_of_linear_propagation(probability: float) -> None:
    scene = (looks.level_sensor(), looks.level_shot(), looks.LEVEL_UV, looks.LEVEL, looks.level_errors())
    found, linear = accuracy(*scene, probability=probability), propagate(*scene)
    errors_of = (linear.circular_error, linear.linear_error, linear.spherical_error)
    expected = [float(error_of(probability)) for error_of in errors_of]
    np.testing.assert_allclose((found.circular, found.linear, found.spherical), expected, rtol=1e-12)
