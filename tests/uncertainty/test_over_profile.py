"""Radii without samples: those of linear propagation, in proportion to what the terrain profile makes of them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.uncertainty import Method, accuracy, propagate
from jaxgeo.uncertainty.linear_accuracy import STEPS, over_profile
from jaxgeo.uncertainty.method_selection import AGREEMENT, AGREEMENT_UP, Diagnostics
from tests.support import looks

RADII = tuple(map(jnp.asarray, (10.0, 3.0, 10.4)))
FACET, FOOTPRINT = (jnp.asarray(int(one)) for one in (Method.facet, Method.footprint))


def told(profile: float = 10.0, profile_up: float = 3.0, facet: float = 10.0, footprint: float = 10.0) -> Diagnostics:
    figures = {"facet": facet, "footprint": footprint, "profile": profile}
    figures |= {"facet_up": 3.0, "footprint_up": 3.0, "profile_up": profile_up}
    rest = dict.fromkeys(Diagnostics._fields, 0.0)
    return Diagnostics(**{name: jnp.asarray(value) for name, value in (rest | figures).items()})


@pytest.mark.parametrize("off", [0.0, STEPS, -STEPS])
def test_figures_that_are_the_same_within_the_steps_change_nothing(off: float) -> None:
    same = told(10.0 * np.exp(off), 3.0 * np.exp(off))
    np.testing.assert_allclose(over_profile(RADII, same, FACET), RADII, rtol=1e-15)


@pytest.mark.parametrize("profile, profile_up", [(10.6, 3.0), (9.3, 3.3), (10.0, 2.7)])
def test_at_90_percent_they_are_those_over_the_profile(profile: float, profile_up: float) -> None:
    circular, linear, spherical = over_profile(RADII, told(profile, profile_up), FACET)
    np.testing.assert_allclose(np.log((circular / profile, linear / profile_up)), 0.0, atol=STEPS * (1.0 + 1e-12))
    beyond = 10.4**2 - 10.0**2  # what the height adds to the square
    np.testing.assert_allclose(spherical**2, circular**2 + beyond * (linear / 3.0) ** 2, rtol=1e-12)


def test_the_plane_is_that_of_the_method() -> None:
    diagnostics = told(profile=10.5, facet=10.5, footprint=10.0)
    assert over_profile(RADII, diagnostics, FACET)[0] == RADII[0]
    np.testing.assert_allclose(over_profile(RADII, diagnostics, FOOTPRINT)[0], 10.5, rtol=1.1 * STEPS)


@pytest.mark.parametrize("profile", [0.0, np.inf, np.nan, 1e-3, 1e3])
def test_a_profile_that_says_nothing_changes_no_more_than_the_agreement(profile: float) -> None:
    circular, linear, spherical = over_profile(RADII, told(profile, profile), FACET)
    assert abs(np.log(circular / RADII[0])) <= AGREEMENT * (1.0 + 1e-12)
    assert abs(np.log(linear / RADII[1])) <= AGREEMENT_UP * (1.0 + 1e-12)
    assert circular <= spherical


def test_derivatives_are_those_of_linear_propagation_times_the_ratio() -> None:
    def scaled(sigma: jax.Array) -> jax.Array:
        own = told(10.6 * sigma, 3.2 * sigma)
        return jnp.stack(over_profile(tuple(one * sigma for one in RADII), own, FACET))

    found, slope = jax.jvp(scaled, (jnp.asarray(1.0),), (jnp.asarray(1.0),))
    np.testing.assert_allclose(slope, found, rtol=1e-12)  # in proportion to sigma, at a constant ratio


def test_on_level_ground_they_are_those_of_linear_propagation() -> None:
    scene = (looks.level_sensor(), looks.level_shot(), looks.LEVEL_UV, looks.LEVEL, looks.level_errors())
    found, linear = accuracy(*scene), propagate(*scene)
    errors = (linear.circular_error(0.9), linear.linear_error(0.9), linear.spherical_error(0.9))
    np.testing.assert_allclose((found.circular, found.linear, found.spherical), errors, rtol=1e-12)
