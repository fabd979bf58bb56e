"""The air against the published standard atmosphere, and its laws."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Atmosphere
from jaxgeo._compile import quick_options
from jaxgeo.earth.atmosphere import G0, R_AIR, R_GEOPOTENTIAL

# US Standard Atmosphere 1976, table I (geometric height): m, K, Pa, kg/m3.
PUBLISHED = [
    (0.0, 288.150, 1.01325e5, 1.2250),
    (5000.0, 255.676, 5.4048e4, 7.3643e-1),
    (11000.0, 216.774, 2.2699e4, 3.6480e-1),
    (15000.0, 216.650, 1.2111e4, 1.9476e-1),
    (25000.0, 221.552, 2.5492e3, 4.0084e-2),
    (40000.0, 250.350, 2.8714e2, 3.9957e-3),
    (60000.0, 247.021, 2.1958e1, 3.0968e-4),
    (80000.0, 198.639, 1.0524, 1.8458e-5),
]


@pytest.mark.parametrize("height, temperature, pressure, density", PUBLISHED)
def test_the_published_table_is_met_to_its_last_digit(height, temperature, pressure, density):
    air = Atmosphere()
    assert float(air.temperature(jnp.asarray(height))) == pytest.approx(temperature, rel=0, abs=2e-3)
    assert float(air.pressure(jnp.asarray(height))) == pytest.approx(pressure, rel=1e-4)
    assert float(air.density(jnp.asarray(height))) == pytest.approx(density, rel=1e-4)


def test_the_air_is_at_rest_at_every_height_whatever_its_temperature():
    """dP = -rho d(geopotential), also below sea level and with an offset; the geopotential from its own difference."""
    air = Atmosphere(temperature_offset=jnp.asarray(-12.0), sea_level_pressure=jnp.asarray(9.9e4), sea_level=48.0)
    heights = jnp.array([-400.0, 30.0, 3000.0, 10_900.0, 15_000.0, 25_000.0, 45_000.0])
    fall = jax.vmap(jax.grad(air.pressure))(heights)
    g = G0 * (R_GEOPOTENTIAL / (R_GEOPOTENTIAL + heights - 48.0)) ** 2
    np.testing.assert_allclose(-fall / (air.density(heights) * g), 1.0, rtol=0, atol=1e-12)
    step = 1.0
    np.testing.assert_allclose(air.between(heights, heights + step) / step, g, rtol=0, atol=2e-6)
    np.testing.assert_allclose(
        air.pressure(heights), air.density(heights) * R_AIR * air.temperature(heights), rtol=1e-14, atol=0
    )


def test_what_was_measured_is_there():
    air = Atmosphere.measured(pressure=93_210.0, temperature=291.4, height=812.0, sea_level=47.0)
    assert float(air.pressure(jnp.asarray(812.0))) == pytest.approx(93_210.0, rel=0, abs=1e-9)
    assert float(air.temperature(jnp.asarray(812.0))) == pytest.approx(291.4, rel=0, abs=1e-12)


@pytest.mark.parametrize(
    "wrong, words",
    [
        ({"pressure": 1013.25}, "hPa"),
        ({"temperature": 15.0}, "Celsius"),
        ({"height": 1e6}, "above the ellipsoid"),
        ({"pressure": float("nan")}, "finite"),
    ],
)
def test_measurements_in_other_units_are_refused(wrong, words):
    right = {"pressure": 101_325.0, "temperature": 288.15, "height": 0.0}
    with pytest.raises(ValueError, match=words):
        Atmosphere.measured(**(right | wrong))


def test_derivatives_hold_however_a_program_is_compiled():
    """Where the compiler computes a height twice, once with a fused multiply-add, its two results may differ."""
    shares = (jnp.arange(4000) + 0.5) / 4000

    def densities(top):
        return Atmosphere().density(jnp.where(top > 0.0, top, 1.0) * shares**2)

    tops = jnp.array([5000.0])
    slopes = jax.jit(jax.vmap(jax.jacfwd(densities)), compiler_options=quick_options())(tops)[0]
    by_height = jax.vmap(jax.grad(Atmosphere().density))(5000.0 * shares**2)
    np.testing.assert_allclose(slopes, by_height * shares**2, rtol=1e-9)
