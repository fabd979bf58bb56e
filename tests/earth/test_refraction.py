"""The bent ray: the trace through shells against published figures, the closed form against the trace, and its laws."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import WGS84, Atmosphere, ConstantHeight, Ellipsoid, Geodetic, Ray, intersect
from jaxgeo.earth.refraction import Bending, apparent_point, traced_arc

RADIUS = 6_371_008.8
SPHERE = Ellipsoid(a=RADIUS, f=0.0)
AIR = Atmosphere()

# Height of the sensor and of the ground in m, slant range in m or angle off nadir in deg, shift of the hit in m.
SHIFTS = [
    (15e3, 0.0, 26e3, 5.99),
    (15e3, 0.0, 40e3, 24.87),
    (15e3, 0.0, 60e3, 88.62),
    (15e3, 0.0, 74.0, 68.46),
    (15e3, 0.0, 79.0, 226.9),
    (15e3, 4e3, 79.0, 103.1),
    (9e3, 0.0, 60e3, 204.7),
]


def zenith_and_arc(height: float, ground: float, given: float) -> tuple[float, float]:
    """Angle off nadir in rad, and the arc in m to where the straight ray meets the sphere of the ground."""
    r, g = RADIUS + height, RADIUS + ground
    zenith = np.deg2rad(given) if given < 90.0 else np.arccos((r * r + given**2 - g * g) / (2.0 * r * given))
    return zenith, (np.arcsin(r * np.sin(zenith) / g) - zenith) * g


@pytest.mark.parametrize("height, ground, given, shift", SHIFTS)
def test_the_trace_through_shells_gives_the_published_shifts(height, ground, given, shift):
    zenith, straight = zenith_and_arc(height, ground, given)
    arc = traced_arc(AIR, height=height, ground=ground, zenith=zenith)
    assert straight - float(arc) == pytest.approx(shift, rel=0, abs=0.1)


@pytest.mark.parametrize("offset, change", [(-20.0, 7.03), (20.0, -6.46)])
def test_colder_air_bends_more(offset, change):
    zenith, _ = zenith_and_arc(15e3, 0.0, 60e3)
    arcs = [traced_arc(a, height=15e3, ground=0.0, zenith=zenith) for a in (AIR, Atmosphere(temperature_offset=offset))]
    assert float(arcs[0] - arcs[1]) == pytest.approx(change, rel=0, abs=0.02)


def test_schmids_table():
    """Schmid (1974): 27.68 arc seconds from 15 km to sea level for a depression of 35 degrees."""
    zenith = np.deg2rad(55.0)
    arc = float(traced_arc(AIR, height=15e3, ground=0.0, zenith=zenith)) / RADIUS
    chord = np.arctan2(RADIUS * np.sin(arc), RADIUS + 15e3 - RADIUS * np.cos(arc))
    assert np.rad2deg(zenith - chord) * 3600.0 == pytest.approx(27.68, rel=0, abs=0.25)


def level_ray(height: float, zenith: float) -> Ray:
    """Over the equator of the sphere, to the north."""
    return Ray(jnp.array([RADIUS + height, 0.0, 0.0]), jnp.array([-np.cos(zenith), 0.0, np.sin(zenith)]))


@pytest.mark.costly
@pytest.mark.parametrize("height, ground, given, shift", SHIFTS)
def test_the_closed_form_follows_the_trace(height, ground, given, shift):
    """Within 0.6 %: over the ellipsoid and over the sphere, whose heights here differ from the air's by nothing."""
    zenith, straight = zenith_and_arc(height, ground, given)
    traced = straight - float(traced_arc(AIR, height=height, ground=ground, zenith=zenith))
    origin = WGS84.to_ecef(Geodetic(lat=0.7, lon=0.2, height=height))
    up, _ = WGS84.normal_and_height(origin)
    east = jnp.array([-np.sin(0.2), np.cos(0.2), 0.0])
    direction = -np.cos(zenith) * up + np.sin(zenith) * east
    fixes = [intersect(Ray(origin, direction), ConstantHeight(ground), atmosphere=air) for air in (None, AIR)]
    bent = float(jnp.linalg.norm(fixes[0].ecef - fixes[1].ecef))
    assert bent == pytest.approx(traced, rel=6e-3)


@jax.jit
def true_and_seeming_again(origin, direction, distance):
    true = Ray(origin, direction).through(AIR).at(distance)
    return true, apparent_point(origin, true, AIR)


@pytest.mark.parametrize("elevation_deg", [-90.0, -60.0, -5.0, -0.1, 0.0, 0.1, 5.0, 90.0])
def test_seeming_and_true_point_belong_to_each_other(elevation_deg):
    origin = WGS84.to_ecef(Geodetic(lat=-0.4, lon=1.2, height=3000.0))
    up, _ = WGS84.normal_and_height(origin)
    level = jnp.array([-np.sin(1.2), np.cos(1.2), 0.0])
    elevation = np.deg2rad(elevation_deg)
    direction = np.cos(elevation) * level + np.sin(elevation) * up
    for distance in (1.0, 2500.0, 40_000.0):
        if elevation_deg < -10.0 and distance > 3000.0:
            continue  # deep in the ground
        seeming = origin + distance * direction
        true, again = true_and_seeming_again(origin, direction, distance)
        np.testing.assert_allclose(again, seeming, rtol=0, atol=5e-9)
        assert float(jnp.dot(true - seeming, up)) <= 1e-9


def test_a_level_ray_is_curved_as_the_air_thins():
    """Its curvature is that of the index of refraction: a point falls by half of it times the range squared."""
    ray = Ray(jnp.array([WGS84.a + 2000.0, 0.0, 0.0]), jnp.array([0.0, 1.0, 0.0])).through(AIR)
    thinning = float(jax.grad(AIR.refractive_index)(jnp.asarray(2000.0)))
    fall = WGS84.a + 2000.0 - float(ray.at(jnp.asarray(3000.0))[0])
    assert fall == pytest.approx(-0.5 * thinning * 3000.0**2, rel=1e-4)


def test_the_bending_is_smooth_where_the_formula_changes():
    """Through the height of the sensor and 10 m on either side of it, where pressure differences lose their digits."""
    origin = jnp.array([WGS84.a + 2000.0, 0.0, 0.0])

    @jax.jit
    def amount(climb):
        direction = jnp.stack([climb, jnp.sqrt(1.0 - climb**2), 0.0])
        return jnp.linalg.norm(jnp.stack(Bending.of(origin, direction, AIR).shift(jnp.asarray(4000.0))))

    amounts = [float(amount(climb)) for climb in np.linspace(-12.0, 12.0, 97) / 4000.0]
    second = np.diff(amounts, 2)
    assert np.max(np.abs(second)) < 5e-7  # m


@pytest.mark.slow
def test_derivatives_by_pressure_and_temperature_equal_differences():
    ray = level_ray(12e3, np.deg2rad(74.0))

    def hit(x):
        air = Atmosphere(temperature_offset=x[0], sea_level_pressure=x[1])
        return intersect(ray, ConstantHeight(300.0), atmosphere=air).ecef

    x, steps = jnp.array([3.0, 1e5]), np.array([0.5, 100.0])
    J = jax.jit(jax.jacfwd(hit))(x)
    np.testing.assert_allclose(jax.jit(jax.jacrev(hit))(x), J, rtol=0, atol=1e-9)
    run = jax.jit(hit)
    for k, step in enumerate(steps):
        move = np.eye(2)[k] * step
        near, far = run(x + move) - run(x - move), run(x + 2 * move) - run(x - 2 * move)
        np.testing.assert_allclose(J[:, k] * step, (8 * near - far) / 12, rtol=0, atol=1e-6)
    assert np.linalg.norm(J[:, 1]) > 5e-5  # m per Pa
