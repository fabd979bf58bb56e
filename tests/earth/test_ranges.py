"""Where a line meets a surface of constant geodetic height."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.earth import WGS84, Ellipsoid, Geodetic, R_ecef_from_ned

N = 400
ELLIPSOIDS = {"wgs84": WGS84, "flattened": Ellipsoid(a=6378137.0, f=0.1)}


def line(ellipsoid, lat, off_nadir, azimuth, height):
    """Origin and direction in ECEF of a line of sight that leaves `height` at `off_nadir`."""
    place = Geodetic(lat=lat, lon=jnp.asarray(2.5), height=height)
    tilt = jnp.sin(off_nadir)
    look = jnp.stack([tilt * jnp.cos(azimuth), tilt * jnp.sin(azimuth), jnp.cos(off_nadir)])
    return ellipsoid.to_ecef(place), R_ecef_from_ned(place) @ look


def look_and_measure(ellipsoid):
    def one(lat, off_nadir, azimuth, origin_height, height):
        o, d = line(ellipsoid, lat, off_nadir, azimuth, origin_height)
        near, far, meets = ellipsoid.ranges_to_height(o, d, height)
        (up_near, h_near), (up_far, h_far) = (ellipsoid.normal_and_height(o + s * d) for s in (near, far))
        return near, far, meets, h_near - height, h_far - height, jnp.dot(up_near, d), jnp.dot(up_far, d)

    return jax.jit(jax.vmap(one))


LOOK = {name: look_and_measure(e) for name, e in ELLIPSOIDS.items()}


def sample(off_low, off_high, seed=0):
    rng = np.random.default_rng(seed)
    off = np.radians(rng.uniform(off_low, off_high, N))
    return rng.uniform(-np.pi / 2, np.pi / 2, N), off, rng.uniform(-np.pi, np.pi, N)


@pytest.mark.costly
@pytest.mark.parametrize("name", ELLIPSOIDS)
@pytest.mark.parametrize("low, high", [(0, 1e-9), (0, 5), (5, 79), (79, 85)], ids=["nadir", "steep", "oblique", "flat"])
def test_both_ends_lie_on_the_surface(name, low, high):
    lat, off, azimuth = sample(low, high)
    heights = np.random.default_rng(1).uniform(-400, 9000, N)
    near, far, meets, error_near, error_far, slope_near, slope_far = LOOK[name](
        lat, off, azimuth, np.full(N, 15e3), heights
    )
    assert np.all(meets)
    np.testing.assert_allclose(error_near, 0, rtol=0, atol=1e-8)  # m
    np.testing.assert_allclose(error_far, 0, rtol=0, atol=1e-8)
    assert np.all(np.asarray(slope_near) < 0)
    assert np.all(np.asarray(slope_far) > 0)
    assert np.all(np.asarray(near) > 0)
    assert np.all(np.asarray(far) > np.asarray(near))


def test_nadir_range_is_the_height_difference():
    near, *_ = LOOK["wgs84"](np.linspace(-1.5, 1.5, N), np.zeros(N), np.zeros(N), np.full(N, 15e3), np.full(N, 500.0))
    np.testing.assert_allclose(near, 14.5e3, rtol=0, atol=1e-8)


def test_looking_up_the_line_enters_behind_and_leaves_ahead():
    """From below the surface, and upward from inside a valley: near < 0 < far."""
    lat, off, azimuth = sample(1, 179, seed=2)
    near, far, meets, error_near, error_far, *_ = LOOK["wgs84"](
        lat, off, azimuth, np.full(N, 800.0), np.full(N, 3000.0)
    )
    assert np.all(meets)
    assert np.all(np.asarray(near) < 0)
    assert np.all(np.asarray(far) > 0)
    np.testing.assert_allclose(error_near, 0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(error_far, 0, rtol=0, atol=1e-8)


def test_straight_up_from_below_meets_the_surface_overhead():
    up = np.full(N, np.pi)
    _, far, *_ = LOOK["wgs84"](np.linspace(-1.5, 1.5, N), up, np.zeros(N), np.full(N, 800.0), np.full(N, 3000.0))
    np.testing.assert_allclose(far, 2200.0, rtol=0, atol=1e-8)


@jax.jit
@jax.vmap
def graze(lat, off, azimuth, depth):
    """Ranges, from a line's lowest point (found by bisection), to the surface `depth` m above that point."""
    o, d = line(WGS84, lat, off, azimuth, jnp.asarray(15e3))

    def halve(_, bracket):
        low, high = bracket
        middle = 0.5 * (low + high)
        falls = jnp.dot(WGS84.normal_and_height(o + middle * d)[0], d) < 0
        return jnp.where(falls, middle, low), jnp.where(falls, high, middle)

    lowest = jax.lax.fori_loop(0, 60, halve, (jnp.asarray(0.0), jnp.asarray(8e5)))[0]
    height = WGS84.normal_and_height(o + lowest * d)[1] + depth
    near, far, meets = WGS84.ranges_to_height(o, d, height)
    errors = [WGS84.normal_and_height(o + s * d)[1] - height for s in (near, far)]
    return near - lowest, far - lowest, meets, *errors


@pytest.mark.parametrize("depth", [1e-6, 1e-3, 1.0, 100.0, 5000.0, 60e3, 70e3])
def test_tangent_within_metres_is_met_on_both_sides(depth):
    near, far, meets, error_near, error_far = graze(*sample(86.5, 89.0, seed=3), np.full(N, depth))
    half = np.sqrt(2 * 6.371e6 * depth)
    assert np.all(meets)
    np.testing.assert_allclose(-np.asarray(near) / half, 1.0, rtol=0, atol=0.02)
    np.testing.assert_allclose(np.asarray(far) / half, 1.0, rtol=0, atol=0.02)
    np.testing.assert_allclose(error_near, 0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(error_far, 0, rtol=0, atol=1e-8)


@pytest.mark.parametrize("depth", [-1e-6, -1.0, -1e3, -1e5, -3e6])
def test_a_miss_gives_the_closest_approach(depth):
    near, far, meets, *_ = graze(*sample(86.5, 89.0, seed=4), np.full(N, depth))
    assert not np.any(meets)
    np.testing.assert_allclose(near, 0, rtol=0, atol=1e-3)  # m of range
    np.testing.assert_allclose(far, 0, rtol=0, atol=1e-3)


def test_range_to_height_looks_ahead_only():
    place = Geodetic(lat=jnp.asarray(0.8), lon=jnp.asarray(0.1), height=jnp.asarray(2000.0))
    o, (north, _, down) = WGS84.to_ecef(place), R_ecef_from_ned(place).T
    directions, heights = jnp.stack([down, -down, down, north]), jnp.array([500.0, 500.0, 3000.0, 500.0])
    ranges, ahead = jax.jit(jax.vmap(lambda d, h: WGS84.range_to_height(o, d, h)))(directions, heights)
    assert ahead.tolist() == [True, False, False, False]
    assert float(ranges[0]) == pytest.approx(1500.0, abs=1e-8)
    assert np.all(np.isnan(ranges[1:]))


def near_range(x):
    """Range in 10 km as a function of latitude, off-nadir angle, azimuth (rad), origin height and height (10 km)."""
    o, d = line(WGS84, x[0], x[1], x[2], x[3] * 1e4)
    return WGS84.ranges_to_height(o, d, x[4] * 1e4)[0] / 1e4


VALUE = jax.jit(jax.vmap(near_range))


@jax.jit
@jax.vmap
def hessian_and_gradient(x):
    def twice(y):
        g = jax.grad(near_range)(y)
        return g, g

    return jax.jacfwd(twice, has_aux=True)(x)


@pytest.mark.costly
@pytest.mark.parametrize("off_nadir", [0.3, 1.2, 1.45])
def test_derivatives_of_the_range_equal_central_differences(off_nadir):
    x = np.array([0.6, off_nadir, 0.7, 0.9, 0.03])

    def differences(f, step):
        plus, minus = (np.asarray(f(x + sign * step * np.eye(5))) for sign in (1, -1))
        return (plus - minus) / (2 * step)

    hessian, gradient = (leaf[0] for leaf in hessian_and_gradient(np.broadcast_to(x, (5, 5))))
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-9, atol=1e-12)
    by_step = differences(VALUE, 1e-5)
    np.testing.assert_allclose(gradient, by_step, rtol=1e-6, atol=3e-7)  # a value's last digit over the step
    curvature = differences(lambda y: hessian_and_gradient(y)[1], 1e-4)
    np.testing.assert_allclose(hessian, curvature.T, rtol=1e-4, atol=1e-7)


@pytest.mark.costly
def test_derivatives_of_a_batch_with_misses_are_finite():
    """Straight down, tangent within the surface, above the horizon, straight up, and from the surface itself."""
    x = np.array([[0.5, off_nadir, 0.3, 0.9, 0.0] for off_nadir in (0.0, 1.5176, 1.6, np.pi, 1.0)])
    x[4, 4] = 0.9
    for derivative in hessian_and_gradient(x):
        assert np.all(np.isfinite(derivative))
    assert np.all(hessian_and_gradient(x)[1][2] == 0.0)  # a miss moves nothing
