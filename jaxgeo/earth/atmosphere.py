"""Atmosphere model: temperature, pressure and density by height."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64, check_finite, check_range
from jaxgeo._numerics import larger, smaller, within
from jaxgeo._record import Record
from jaxgeo._typing import ScalarField, ScalarLike

R_GEOPOTENTIAL = 6_356_766.0  # m, the Earth's radius in the standard's geopotential height
G0 = 9.80665  # m/s2
R_AIR = 8314.32 / 28.9644  # J/(kg K), dry air
SEA_LEVEL_PRESSURE = 101_325.0  # Pa
SEA_LEVEL_TEMPERATURE = 288.15  # K
REFRACTIVITY = 2.7789e-4 / 1.2250  # m3/kg: (n - 1) / density, visible light
# Geopotential height of each layer's base in m, and its temperature gradient in K/m.
LAYERS = ((0.0, -6.5e-3), (11e3, 0.0), (20e3, 1e-3), (32e3, 2.8e-3), (47e3, 0.0), (51e3, -2.8e-3), (71e3, -2e-3))
TOP = 84_852.0  # m, geopotential: top of the standard's layers
COLDEST = 100.0  # K: lower limit of a shifted atmosphere, which avoids a division by zero

Heights = Float[Array, "..."]


class Atmosphere(Record):
    """Dry air at rest: the US Standard Atmosphere 1976, optionally shifted to a measurement.

    `temperature_offset` in K is added at every height. `sea_level_pressure` in Pa applies at sea level, `sea_level` m
    above the ellipsoid (the geoid undulation: air follows the geoid, heights here the ellipsoid). `refractivity` in
    m3/kg is (n - 1) / density and depends on the wavelength. All may be traced and differentiated. Humidity is ignored:
    at 20 g/m3 it changes n - 1 of visible light by less than 0.5 %.

    >>> air = jaxgeo.Atmosphere.measured(pressure=95_000.0, temperature=298.15, height=560.0)
    >>> print(f"{air.temperature_offset:+.2f} K, and {air.sea_level_pressure / 100:.1f} hPa at sea level")
    +13.64 K, and 1012.6 hPa at sea level
    """

    temperature_offset: ScalarField = 0.0
    sea_level_pressure: ScalarField = SEA_LEVEL_PRESSURE
    sea_level: ScalarField = 0.0
    refractivity: ScalarField = REFRACTIVITY

    @classmethod
    def measured(
        cls, *, pressure: ScalarLike, temperature: ScalarLike, height: ScalarLike, sea_level: ScalarLike = 0.0
    ) -> Atmosphere:
        """Standard atmosphere shifted to a `pressure` in Pa and a `temperature` in K measured at a `height` in m.

        `height` and `sea_level` (the geoid undulation) are above the ellipsoid. Raises `ValueError` for a pressure
        outside [10 000, 120 000] Pa, a temperature outside [150, 350] K, or a height outside [-1000, 15 000] m.
        """
        check_range(pressure, "pressure", "Pa (1013.25 hPa are 101325 Pa)", 10_000.0, 120_000.0)
        check_range(temperature, "temperature", "K (15 degrees Celsius are 288.15 K)", 150.0, 350.0)
        check_range(height, "height", "m above the ellipsoid", -1000.0, 15_000.0)
        check_finite(sea_level, "sea_level", "m above the ellipsoid")
        pressure, temperature, height, sea_level = as_float64(
            (pressure, temperature, height, sea_level), "Atmosphere.measured"
        )
        offset = temperature - cls(sea_level=sea_level).temperature(height)
        shifted = cls(temperature_offset=offset, sea_level_pressure=1.0, sea_level=sea_level)
        return cls(offset, pressure / shifted.pressure(height), sea_level)

    def temperature(self, height: Heights) -> Heights:
        """Temperature in K at a height in m above the ellipsoid."""
        return _temperature_and_log_pressure(self._geopotential(height), self.temperature_offset)[0]

    def pressure(self, height: Heights) -> Heights:
        """Pressure in Pa at a height in m above the ellipsoid."""
        return self.pressure_and_density(height)[0]

    def density(self, height: Heights) -> Heights:
        """Density in kg/m3 at a height in m above the ellipsoid."""
        return self.pressure_and_density(height)[1]

    def pressure_and_density(self, height: Heights, layers: int = len(LAYERS)) -> tuple[Heights, Heights]:
        """Pressure in Pa and density in kg/m3 at a height in m above the ellipsoid.

        With fewer `layers` the last of them extends to the top: three suffice below 32 km, at half the cost.
        """
        temperature, log_pressure = _temperature_and_log_pressure(
            self._geopotential(height), self.temperature_offset, layers
        )
        pressure = self.sea_level_pressure * jnp.exp(log_pressure)
        return pressure, pressure / (R_AIR * temperature)

    def refractive_index(self, height: Heights) -> Heights:
        """Refractive index at a height in m above the ellipsoid."""
        return 1.0 + self.refractivity * self.density(height)

    def between(self, height: Heights, other: Heights) -> Heights:
        """Geopotential difference in m2/s2 from `height` up to `other`, m above the ellipsoid; without cancellation."""
        low, high = R_GEOPOTENTIAL + height - self.sea_level, R_GEOPOTENTIAL + other - self.sea_level
        return G0 * R_GEOPOTENTIAL * (other - height) * (R_GEOPOTENTIAL / (low * high))

    def _geopotential(self, height: Heights) -> Heights:
        above_sea = height - self.sea_level
        return R_GEOPOTENTIAL * above_sea / (R_GEOPOTENTIAL + above_sea)


def _temperature_and_log_pressure(
    z: Heights, offset: ScalarField, layers: int = len(LAYERS)
) -> tuple[Heights, Heights]:
    """Temperature in K, and log(pressure / sea-level pressure), at a geopotential height in m."""
    z = smaller(z, TOP)
    temperature = jnp.asarray(SEA_LEVEL_TEMPERATURE + offset)
    log_pressure = jnp.zeros_like(z)
    ends = [base for base, _ in LAYERS[1:layers]] + [TOP]
    for number, ((base, lapse), end) in enumerate(zip(LAYERS[:layers], ends, strict=True)):
        depth = smaller(z, end) - base if number == 0 else within(z - base, 0.0, end - base)
        above = larger(temperature + lapse * depth, COLDEST)
        fall = jnp.log(above / temperature) / lapse if lapse else depth / temperature
        log_pressure = log_pressure - G0 / R_AIR * fall
        temperature = above
    return temperature, log_pressure
