"""How far one sees: plane geometry without air, the curvature of a level ray with it, and the bent ray itself."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import WGS84, Atmosphere, ConstantHeight, Ray, Status, intersect
from jaxgeo.earth import horizon, sight_range
from jaxgeo.earth.refraction import MEAN_RADIUS as R

AIR = Atmosphere()


@pytest.mark.parametrize("height, ground", [(2.0, 0.0), (300.0, 0.0), (9000.0, 500.0), (20e3, -100.0)])
def test_without_air_it_is_plane_geometry(height, ground):
    seen = horizon(height, ground=ground)
    dip = np.arccos((R + ground) / (R + height))
    assert float(seen.dip) == pytest.approx(dip, rel=0, abs=1e-9)
    assert float(seen.distance) == pytest.approx((R + ground) * dip, rel=0, abs=1e-3)


def test_close_to_the_ground_the_air_straightens_the_earth_by_the_curvature_of_its_rays():
    k = -R * float(jax.grad(AIR.refractive_index)(jnp.asarray(10.0)))
    assert 0.1 < k < 0.25
    seen = horizon(20.0, atmosphere=AIR)
    assert float(seen.dip) == pytest.approx(np.sqrt(2.0 * 20.0 * (1.0 - k) / R), rel=2e-4)
    assert float(seen.distance) == pytest.approx(np.sqrt(2.0 * 20.0 * R / (1.0 - k)), rel=2e-4)


@pytest.mark.costly
@pytest.mark.parametrize("height", [3000.0, 10_000.0])
def test_bent_rays_end_at_the_horizon(height):
    """Those a little steeper than it come down, those a little less steep do not."""
    origin = jnp.array([WGS84.a + height, 0.0, 0.0])
    dip = float(horizon(height, atmosphere=AIR, radius=WGS84.a).dip)

    def status(depression):
        ray = Ray(origin, jnp.array([-jnp.sin(depression), jnp.cos(depression), 0.0]))
        return int(intersect(ray, ConstantHeight(0.0), atmosphere=AIR).status)

    assert status(1.01 * dip) == Status.hit
    assert status(0.99 * dip) == Status.rises_away


def test_an_eye_on_the_ground_sees_none_of_it_and_both_horizons_add_up():
    assert float(horizon(0.0, atmosphere=AIR).distance) == 0.0
    alone = [float(horizon(h, atmosphere=AIR).distance) for h in (10e3, 800.0)]
    assert float(sight_range(10e3, 800.0, atmosphere=AIR)) == pytest.approx(sum(alone), rel=0, abs=1e-6)
    with pytest.raises(ValueError, match="below the ground at 200 m"):
        horizon(100.0, ground=200.0)


@pytest.mark.costly
def test_derivatives_equal_differences():
    def run(height):
        seen = horizon(height, atmosphere=AIR)
        return (jnp.stack([seen.distance, 1e6 * seen.dip]),) * 2

    J, values = jax.jit(jax.vmap(jax.jacfwd(run, has_aux=True)))(5000.0 + 10.0 * jnp.arange(-2.0, 3.0))
    difference = (8 * (values[3] - values[1]) - (values[4] - values[0])) / 12
    np.testing.assert_allclose(J[2] * 10.0, difference, rtol=0, atol=1e-5)
