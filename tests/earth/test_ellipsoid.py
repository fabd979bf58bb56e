"""Geodetic and ECEF coordinates: against PROJ, against high precision, round trips, derivatives, poles."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pyproj
import pytest

from jaxgeo.earth import GRS80, WGS84, Ellipsoid, Geodetic, R_ecef_from_ned

SPHERE = Ellipsoid(a=6371008.8, f=0.0)
FLAT = Ellipsoid(a=6378137.0, f=0.3)
ELLIPSOIDS = {"wgs84": WGS84, "grs80": GRS80, "sphere": SPHERE, "flattened": FLAT}
TO_ECEF = {name: jax.jit(jax.vmap(e.to_ecef)) for name, e in ELLIPSOIDS.items()}
TO_GEODETIC = {name: jax.jit(jax.vmap(e.to_geodetic)) for name, e in ELLIPSOIDS.items()}
SPECIAL_LAT = np.array([0.0, 90.0, -90.0, 1e-12, 89.9999999, -89.9999999, 45.0, 0.0])
SPECIAL_LON = np.array([0.0, 0.0, 0.0, 180.0, -180.0, 179.9999999, 90.0, -90.0])
N = 300


def sample(low: float, high: float, seed: int = 0) -> Geodetic:
    """Positions all over the Earth with heights from `low` to `high` m, poles, equator and date line among them."""
    rng = np.random.default_rng(seed)
    lat, lon = np.degrees(np.arcsin(rng.uniform(-1, 1, N))), rng.uniform(-180, 180, N)
    lat[: SPECIAL_LAT.size], lon[: SPECIAL_LON.size] = SPECIAL_LAT, SPECIAL_LON
    return Geodetic.from_degrees(lat=lat, lon=lon, height=rng.uniform(low, high, N))


def wrapped(angle):
    return np.angle(np.exp(1j * np.asarray(angle)))


@pytest.fixture(scope="module")
def proj():
    return pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)


def test_ecef_agrees_with_proj_anywhere(proj):
    g = sample(-10e3, 1e6)
    lat, lon, height = (np.asarray(x) for x in g.to_degrees())
    expected = np.stack(proj.transform(lon, lat, height), axis=1)
    np.testing.assert_allclose(TO_ECEF["wgs84"](g), expected, rtol=0, atol=1e-6)  # m; about 4e-9 measured


def test_geodetic_agrees_with_proj_near_the_ground(proj):
    """To 20 km: higher up PROJ itself is wrong by millimetres."""
    p = np.asarray(TO_ECEF["wgs84"](sample(-10e3, 20e3)))
    lon, lat, height = proj.transform(*p.T, direction="INVERSE")
    g = TO_GEODETIC["wgs84"](p)
    np.testing.assert_allclose(6.4e6 * np.abs(np.asarray(g.lat) - np.radians(lat)), 0, rtol=0, atol=1e-5)
    east = wrapped(np.asarray(g.lon) - np.radians(lon)) * np.cos(np.asarray(g.lat))
    np.testing.assert_allclose(6.4e6 * east, 0, rtol=0, atol=1e-5)
    np.testing.assert_allclose(g.height, height, rtol=0, atol=1e-5)


def exact_geodetic(ellipsoid, p, lat, height):
    """Latitude and height of an ECEF point to 30 digits, by Newton from a nearby value."""
    a, f = mpmath.mpf(ellipsoid.a), mpmath.mpf(ellipsoid.f)
    e2 = f * (2 - f)
    across, z = mpmath.hypot(mpmath.mpf(float(p[0])), mpmath.mpf(float(p[1]))), mpmath.mpf(float(p[2]))
    for _ in range(3):
        s, c = mpmath.sin(lat), mpmath.cos(lat)
        N = a / mpmath.sqrt(1 - e2 * s**2)
        M = N * (1 - e2) / (1 - e2 * s**2)
        d_across, d_z = across - (N + height) * c, z - (N * (1 - e2) + height) * s
        lat, height = lat + (c * d_z - s * d_across) / (M + height), height + c * d_across + s * d_z
    return lat, height


@pytest.mark.parametrize("low, high", [(-10e3, 20e3), (20e3, 1e6)])
@pytest.mark.parametrize("name", ["wgs84", "sphere", "flattened"])
def test_geodetic_agrees_with_high_precision(name, low, high):
    g = sample(low, high, seed=1)
    p = np.asarray(TO_ECEF[name](g))
    found = TO_GEODETIC[name](p)
    with mpmath.workdps(40):
        for i in range(N):
            lat, height = exact_geodetic(ELLIPSOIDS[name], p[i], float(g.lat[i]), float(g.height[i]))
            if abs(float(found.lat[i])) < 1.5707963:  # within 0.2 m of a pole the height is tested, the latitude below
                assert abs(float(found.lat[i]) - lat) < 1e-14 + np.spacing(abs(float(lat)))
            assert abs(float(found.height[i]) - height) < 1e-8  # m


@pytest.mark.parametrize("name", ELLIPSOIDS)
def test_round_trip_through_ecef(name):
    g = sample(-10e3, 1e6, seed=2)
    p = TO_ECEF[name](g)
    back = TO_GEODETIC[name](p)
    radius = np.asarray(jnp.linalg.norm(p, axis=1))
    east = wrapped(back.lon - g.lon) * np.cos(np.asarray(g.lat)) * radius
    np.testing.assert_allclose(east, 0, rtol=0, atol=1e-8)  # m
    np.testing.assert_allclose((np.asarray(back.lat) - np.asarray(g.lat)) * radius, 0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(back.height, g.height, rtol=0, atol=1e-8)
    np.testing.assert_allclose(TO_ECEF[name](back), p, rtol=0, atol=1e-8)


def test_poles_equator_and_date_line_exactly():
    b = WGS84.b
    north = WGS84.to_geodetic(jnp.array([0.0, 0.0, b + 100.0]))
    assert (float(north.lat), float(north.lon)) == (np.pi / 2, 0.0)
    assert float(north.height) == pytest.approx(100.0, abs=1e-8)
    south = WGS84.to_geodetic(jnp.array([0.0, 0.0, -b]))
    assert float(south.lat) == -np.pi / 2
    date_line = WGS84.to_geodetic(jnp.array([-WGS84.a - 5.0, 0.0, 0.0]))
    assert (float(date_line.lat), float(date_line.lon)) == (0.0, np.pi)
    assert float(date_line.height) == pytest.approx(5.0, abs=1e-8)
    for side in (1.0, -1.0):
        beside = WGS84.to_geodetic(jnp.array([-6378137.0, side * 1e-3, 0.0]))
        assert float(beside.lon) == pytest.approx(side * np.pi, abs=1e-9)


def test_on_a_sphere_height_is_the_distance_from_it():
    p = np.random.default_rng(3).normal(size=(N, 3)) * 7e6
    g = TO_GEODETIC["sphere"](p)
    np.testing.assert_allclose(g.height, np.linalg.norm(p, axis=1) - SPHERE.a, rtol=0, atol=1e-8)
    np.testing.assert_allclose(g.lat, np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1])), rtol=0, atol=1e-15)


@jax.jit
@jax.vmap
def geodetic_jacobian_in_ned(g: Geodetic):
    """d(lat, lon, height) / d(north, east, down) at a position."""
    columns = jax.jacfwd(WGS84.to_geodetic)(WGS84.to_ecef(g))
    return jnp.stack([columns.lat, columns.lon, columns.height]) @ R_ecef_from_ned(g)


def test_first_derivatives_are_the_radii_of_curvature():
    g = sample(-10e3, 1e6, seed=4)
    J = np.asarray(geodetic_jacobian_in_ned(g))
    inner = np.abs(np.asarray(g.lat)) < np.radians(89.99)
    M, across = jax.vmap(WGS84.meridian_radius)(g.lat), jax.vmap(WGS84.prime_vertical_radius)(g.lat)
    assert np.all(np.isfinite(J))
    np.testing.assert_allclose((J[:, 0, 0] * (M + g.height))[inner], 1.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose((J[:, 1, 1] * (across + g.height) * jnp.cos(g.lat))[inner], 1.0, rtol=0, atol=1e-10)
    np.testing.assert_allclose(J[:, 2, 2], -1.0, rtol=0, atol=1e-15)
    mixed = J[inner] * np.array([6.4e6, 6.4e6, 1.0])[:, None]
    mixed[:, 1] *= np.cos(np.asarray(g.lat))[inner, None]
    np.testing.assert_allclose(mixed[:, ~np.eye(3, dtype=bool)], 0, rtol=0, atol=1e-9)


@pytest.mark.costly
@pytest.mark.parametrize("ellipsoid", [WGS84, SPHERE, FLAT], ids=["wgs84", "sphere", "flattened"])
def test_derivatives_equal_central_differences(ellipsoid):
    """First derivatives of normal and height, and second ones, one kilometre above ground all over the globe."""

    def f(p):
        normal, height = ellipsoid.normal_and_height(p)
        return jnp.append(normal * 6.4e6, height)

    J, H = jax.jit(jax.vmap(jax.jacfwd(f))), jax.jit(jax.vmap(jax.jacfwd(jax.jacrev(f))))
    F = jax.jit(jax.vmap(f))
    p = np.asarray(jax.vmap(ellipsoid.to_ecef)(sample(1e3, 1e3, seed=5)))
    first, second = np.asarray(J(p)), np.asarray(H(p)) * 6.4e6
    for axis in range(3):
        step = np.eye(3)[axis] * 1e3
        np.testing.assert_allclose(first[:, :, axis], (F(p + step) - F(p - step)) / 2e3, rtol=0, atol=1e-6)
        differences = (np.asarray(J(p + step)) - np.asarray(J(p - step))) / 2e3 * 6.4e6
        np.testing.assert_allclose(second[..., axis], differences, rtol=0, atol=2e-5)


def test_normal_and_height_are_smooth_at_a_pole():
    """Value, first and second derivative do not jump between the pole and points up to 1 mm beside it."""
    beside = np.array([[0.0, 0.0], [1e-3, 0.0], [0.0, -1e-3], [1e-9, 1e-9]])
    p = jnp.asarray(np.column_stack([beside, np.full(4, WGS84.b + 250.0)]))

    def in_radii(q):
        normal, height = WGS84.normal_and_height(q * WGS84.a)
        return jnp.append(normal, height / WGS84.a)

    for f in (in_radii, jax.jacfwd(in_radii), jax.jacfwd(jax.jacrev(in_radii))):
        values = np.asarray(jax.jit(jax.vmap(f))(p / WGS84.a))
        np.testing.assert_allclose(values, np.broadcast_to(values[0], values.shape), rtol=0, atol=1e-9)
    slope = jax.jacfwd(lambda q: WGS84.normal_and_height(q)[0])(p[0])
    polar_radius = WGS84.a**2 / WGS84.b + 250.0
    np.testing.assert_allclose(slope, np.diag([1.0, 1.0, 0.0]) / polar_radius, rtol=0, atol=1e-21)


def test_every_derivative_of_geodetic_is_finite():
    r = 6.4e6
    places = jnp.array([[0, 0, r], [0, 0, -r], [r, 0, 0], [-r, 0.0, 0], [-r, -0.0, 0], [1e-8, 0, r]])
    f = WGS84.to_geodetic
    for derivative in (jax.jacrev(f), jax.jacfwd(jax.jacfwd(f))):
        for leaf in jax.tree.leaves(jax.jit(jax.vmap(derivative))(places)):
            assert np.all(np.isfinite(leaf))


def test_radius_in_azimuth_lies_between_the_principal_ones():
    lat = jnp.asarray(0.7)
    M, across = WGS84.meridian_radius(lat), WGS84.prime_vertical_radius(lat)
    assert float(WGS84.radius_in_azimuth(lat, jnp.asarray(0.0))) == pytest.approx(float(M), rel=1e-15)
    assert float(WGS84.radius_in_azimuth(lat, jnp.asarray(np.pi / 2))) == pytest.approx(float(across), rel=1e-15)
    harmonic = 2.0 / (1.0 / M + 1.0 / across)
    assert float(WGS84.radius_in_azimuth(lat, jnp.asarray(np.pi / 4))) == pytest.approx(float(harmonic), rel=1e-14)
