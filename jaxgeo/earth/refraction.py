"""Atmospheric refraction of a line of sight: closed form for every ray, and a trace through shells as reference."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgeo._checks import as_float64
from jaxgeo._numerics import dot, safe_sqrt, value_and_slope
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField, ScalarLike, Vector3, Vector3Field
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84

LEVEL = 10.0  # m between sensor and point: below this pressure differences lose digits; use a two-term series
AIR_LAYERS = 3  # of the standard atmosphere: up to 32 km; 1 % of the air lies above
GUESSES = (0.0, 4000.0)  # m: linear first estimate of the bending between these heights, for the height of the bent ray
CORRECTIONS = 6  # each reduces the error by a factor of 1000
SHELLS = 4000
MEAN_RADIUS = 6_371_008.8  # m


class Bending(Record):
    """Deflection of a refracted ray below its initial direction, by range.

    Closed form: angle = K (tan z_s + tan z_g) / 2 with K = beta [(P_g - P_s) / (g (H - h)) - rho_s], from pressure and
    density at both ends (z_s, z_g: angles off the vertical at sensor and ground). It is written with (H - h) tan z = S
    sin z, so that it also holds for level and rising rays. `down` is perpendicular to the ray, towards nadir, of length
    sin z_s; `climb` is the upward component of the ray direction; `height` of the sensor above the ellipsoid and
    `radius` of the Earth there in m; `thinning` and `thinning_rate` are the first and second derivative of density by
    height at the sensor; `guess` and `guess_rate` are a linear estimate of the bending by height, through two points.
    """

    air: Atmosphere
    down: Vector3Field
    climb: ScalarField
    height: ScalarField
    radius: ScalarField
    pressure: ScalarField
    density: ScalarField
    thinning: ScalarField
    thinning_rate: ScalarField
    guess: ScalarField
    guess_rate: ScalarField

    @classmethod
    def of(cls, origin: Vector3, direction: Vector3, air: Atmosphere) -> Bending:
        """Bending of a ray from an ECEF point in m in a unit direction."""
        normal, height = WGS84.normal_and_height(origin)
        climb = dot(normal, direction)
        squared = 1.0 - WGS84.e2 * normal[2] ** 2
        radius = WGS84.b / squared  # Gaussian radius of curvature
        pressure, density = air.pressure_and_density(height, AIR_LAYERS)
        density_at = lambda h: air.pressure_and_density(h, AIR_LAYERS)[1]  # noqa: E731
        thinning, rate = value_and_slope(lambda h: value_and_slope(density_at, h)[1], height)
        down, zero = climb * direction - normal, jnp.zeros_like(height)
        bending = cls(air, down, climb, height, radius, pressure, density, thinning, rate, zero, zero)
        low, high = (bending._excess(zero + guess) for guess in GUESSES)
        return eqx.tree_at(lambda b: (b.guess, b.guess_rate), bending, (low, (high - low) / (GUESSES[1] - GUESSES[0])))

    def aimed(self, up: Vector3, direction: Vector3) -> Bending:
        """Bending of another ray from the same origin, given the local `up`; both unit vectors in ECEF."""
        climb = dot(up, direction)
        return eqx.tree_at(lambda b: (b.down, b.climb), self, (climb * direction - up, climb))

    def shift(self, distance: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Displacement in m (ECEF) of the point at `distance` m."""
        amount = self._amount(distance)
        x, y, z = self.down
        return amount * x, amount * y, amount * z

    def _amount(self, distance: Scalar) -> Scalar:
        """Displacement in m, divided by the sine of the angle off the vertical at the sensor."""
        r = self.radius + self.height
        gain = distance * (2.0 * r * self.climb + distance)
        height = self.height + gain / (jnp.sqrt(r * r + gain) + r)
        fall = dot(self.down, self.down)
        strength = distance * distance * self.air.refractivity
        lowered = height - strength * (self.guess + self.guess_rate * height) * fall
        mean_sine = 1.0 + 0.5 * (self.height - lowered) / self.radius
        return strength * self._excess(lowered) * mean_sine

    def _excess(self, height: Scalar) -> Scalar:
        """Mean excess of the density between `height` and the sensor over that at the sensor, kg/m3 per m of height."""
        above = self.height - height
        is_level = jnp.abs(above) < LEVEL
        apart = jnp.where(is_level, LEVEL, above)
        lower, _ = self.air.pressure_and_density(self.height - apart, AIR_LAYERS)
        mean = (lower - self.pressure) / self.air.between(self.height - apart, self.height)
        level = above * self.thinning_rate / 6.0 - 0.5 * self.thinning
        return jnp.where(is_level, level, (mean - self.density) / apart)


def apparent_point(origin: Vector3, p_ecef: Vector3, air: Atmosphere) -> Vector3:
    """Apparent ECEF position in m of a point seen from `origin`: on the initial ray direction, at the ray's range."""

    up, _ = WGS84.normal_and_height(origin)
    bending, seeming = Bending.of(origin, -up, air), p_ecef
    for _ in range(CORRECTIONS):
        line = seeming - origin
        distance = safe_sqrt(dot(line, line))
        direction = line / jnp.where(distance > 0.0, distance, 1.0)
        seeming = p_ecef - jnp.stack(bending.aimed(up, direction).shift(distance))
    return seeming


def traced_arc(
    air: Atmosphere, *, height: ScalarLike, ground: ScalarLike, zenith: ScalarLike, radius: float = MEAN_RADIUS
) -> Scalar:
    """Arc in m along the ground of a spherical Earth, from below a sensor to the ground point of its refracted ray.

    `height` and `ground` in m, `zenith` the apparent angle off nadir at the sensor in rad (small enough to hit the
    ground), `radius` in m. Traces `SHELLS` shells with constant n r sin z (Snell), as reference for `Bending`.
    """
    height, ground, zenith = as_float64((height, ground, zenith), "traced_arc")
    constant = air.refractive_index(height) * (radius + height) * jnp.sin(zenith)
    spare = air.refractive_index(ground) * (radius + ground) - constant
    return arc_between(air, spare, low=ground, high=height, radius=radius)


def arc_between(air: Atmosphere, spare: Scalar, *, low: Scalar, high: Scalar, radius: float) -> Scalar:
    """Arc in m, at the lower height, that a ray spans between two heights in m.

    n r sin z is constant along the ray and `spare` less than n r at `low` (0 for a ray that is level there). Shell
    thickness decreases quadratically towards `low`.
    """
    density = air.density(low)
    constant = air.refractive_index(low) * (radius + low) - spare
    edges = jnp.arange(SHELLS + 1) / SHELLS
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 / SHELLS
    aside = half * 0.6**0.5  # three Gauss-Legendre nodes per shell

    def turn(t: jax.Array) -> jax.Array:
        above = (high - low) * t * t
        n_less_one = air.refractivity * air.density(low + above)
        thinner = air.refractivity * (air.density(low + above) - density)
        more = spare + (1.0 + n_less_one) * above + thinner * (radius + low)  # n r minus its value for the ray
        return constant / jnp.sqrt(more * (2.0 * constant + more)) / (radius + low + above) * t

    parts = 5.0 * turn(middle - aside) + 8.0 * turn(middle) + 5.0 * turn(middle + aside)
    return (radius + low) * 2.0 * (high - low) * half * jnp.sum(parts) / 9.0
