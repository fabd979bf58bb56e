"""Transverse Mercator: against PROJ, against its own derivatives, across the date line, at the poles."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pyproj
import pytest

from jaxgeo.earth import GRS80, WGS84, Ellipsoid, TransverseMercator, _krueger

N = 400
CLARKE = Ellipsoid(a=6378249.145, f=1 / 293.465)  # Cape datum, South Africa
PROJECTIONS = {
    "utm32n": (TransverseMercator.utm(32), "+proj=utm +zone=32 +ellps=WGS84", 9.0),
    "utm60s": (TransverseMercator.utm(60, north=False), "+proj=utm +zone=60 +south +ellps=WGS84", 177.0),
    "utm1n-grs80": (TransverseMercator.utm(1, ellipsoid=GRS80), "+proj=utm +zone=1 +ellps=GRS80", -177.0),
    "gauss-krueger-111": (
        TransverseMercator.gauss_krueger(np.radians(111.0)),
        "+proj=tmerc +lon_0=111 +x_0=500000 +ellps=WGS84",
        111.0,
    ),
    "custom": (
        TransverseMercator(
            lon0=np.radians(-2.0),
            lat0=np.radians(49.0),
            k0=0.9996012717,
            false_easting=400_000.0,
            false_northing=-100_000.0,
            ellipsoid=CLARKE,
        ),
        "+proj=tmerc +lat_0=49 +lon_0=-2 +k=0.9996012717 +x_0=400000 +y_0=-100000 +a=6378249.145 +rf=293.465",
        -2.0,
    ),
}


@jax.jit
def forward(projection, lat, lon):
    return jax.vmap(projection.forward)(lat, lon)


@jax.jit
def inverse(projection, easting, northing):
    return jax.vmap(projection.inverse)(easting, northing)


@jax.jit
def convergence_and_scale(projection, lat, lon):
    return jax.vmap(projection.convergence_and_scale)(lat, lon)


@jax.jit
def by_normals(projection, normal):
    return jax.vmap(projection.forward_from_normal)(normal)


@jax.jit
def inverse_normals(projection, easting, northing):
    return jax.vmap(projection.inverse_normal)(easting, northing)


def normal_of(lat, lon):
    return jnp.stack([jnp.cos(lat) * jnp.cos(lon), jnp.cos(lat) * jnp.sin(lon), jnp.sin(lat)])


def sample(lon0_deg, width_deg, seed=0, latitude=90.0):
    """Latitudes and longitudes in rad up to `width_deg` from a meridian, poles, equator and meridian among them."""
    rng = np.random.default_rng(seed)
    lat, dlon = rng.uniform(-latitude, latitude, N), rng.uniform(-width_deg, width_deg, N)
    lat[:6] = np.array([0.0, 0.0, latitude, -latitude, 45.0, 0.0])
    dlon[:6] = [0.0, width_deg, width_deg, -width_deg, 0.0, -width_deg]
    return np.radians(lat), np.radians(lon0_deg + dlon)


def proj_of(text):
    return pyproj.Proj(text + " +algo=poder_engsager")


NAMES = [pytest.param(name, marks=() if name == "utm1n-grs80" else pytest.mark.costly) for name in PROJECTIONS]


@pytest.mark.parametrize("width", [10.0, 30.0])
@pytest.mark.parametrize("name", NAMES)
def test_both_ways_agree_with_proj(name, width):
    projection, text, lon0 = PROJECTIONS[name]
    proj = proj_of(text)
    lat, lon = sample(lon0, width)
    expected = np.stack(proj(lon, lat, radians=True))
    np.testing.assert_allclose(np.stack(forward(projection, lat, lon)), expected, rtol=0, atol=1e-7)  # m; must: 1e-6
    back = np.stack(inverse(projection, *expected))
    lon_p, lat_p = proj(*expected, inverse=True, radians=True)
    east = np.angle(np.exp(1j * (back[1] - lon_p))) * np.cos(lat)
    np.testing.assert_allclose(6.4e6 * (back[0] - lat_p), 0, rtol=0, atol=1e-7)
    np.testing.assert_allclose(6.4e6 * east, 0, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_convergence_and_scale_agree_with_proj(name):
    """PROJ differentiates numerically: it is good to 1e-9 deg and 1e-10 of scale, less within a degree of a pole."""
    projection, text, lon0 = PROJECTIONS[name]
    lat, lon = sample(lon0, 10.0, latitude=89.0)
    factors = proj_of(text).get_factors(lon, lat, radians=True)
    convergence, scale = convergence_and_scale(projection, lat, lon)
    np.testing.assert_allclose(np.degrees(convergence), factors.meridian_convergence, rtol=0, atol=1e-8)
    np.testing.assert_allclose(scale, factors.meridional_scale, rtol=0, atol=1e-9)
    np.testing.assert_allclose(scale, factors.parallel_scale, rtol=0, atol=1e-9)


@jax.jit
def ground_jacobian(projection, lat, lon):
    """d(easting, northing) / d(north, east) on the ellipsoid."""

    def one(lat, lon):
        J = jax.jacfwd(lambda x: jnp.stack(projection.forward(x[0], x[1])))(jnp.stack([lat, lon]))
        east = projection.ellipsoid.prime_vertical_radius(lat) * jnp.cos(lat)
        return J / jnp.stack([projection.ellipsoid.meridian_radius(lat), east])[None]

    return jax.vmap(one)(lat, lon)


@pytest.mark.parametrize("name", NAMES)
def test_convergence_and_scale_are_the_derivative_of_the_map(name):
    """The Jacobian by ground metres is the scale times a rotation by the convergence: the map is conformal."""
    projection, _, lon0 = PROJECTIONS[name]
    lat, lon = sample(lon0, 30.0, seed=1, latitude=89.0)
    convergence, scale = (np.asarray(x) for x in convergence_and_scale(projection, lat, lon))
    s, c = scale * np.sin(convergence), scale * np.cos(convergence)
    expected = np.moveaxis(np.array([[-s, c], [c, s]]), 2, 0)
    np.testing.assert_allclose(ground_jacobian(projection, lat, lon), expected, rtol=0, atol=1e-12)


def test_convergence_is_the_azimuth_of_grid_north():
    """North and east of the central meridian grid north lies clockwise of true north; on it there is none."""
    utm = TransverseMercator.utm(32)
    lat, lon = np.radians([50.0, 50.0, -50.0, 50.0]), np.radians([10.0, 8.0, 10.0, 9.0])
    convergence, scale = (np.asarray(x) for x in convergence_and_scale(utm, lat, lon))
    assert convergence[0] == pytest.approx(np.radians(1.0) * np.sin(np.radians(50.0)), rel=1e-3)
    assert convergence[1] == pytest.approx(-convergence[0], rel=1e-12)
    assert convergence[2] == pytest.approx(-convergence[0], rel=1e-12)
    assert convergence[3] == 0.0
    assert scale[3] == pytest.approx(0.9996, abs=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_round_trips_and_the_form_by_normals(name):
    projection, _, lon0 = PROJECTIONS[name]
    lat, lon = sample(lon0, 40.0, seed=2)
    normal = np.asarray(normal_of(lat, lon)).T
    en = np.stack(forward(projection, lat, lon))
    by_normal = np.stack(by_normals(projection, normal))
    np.testing.assert_allclose(by_normal, en, rtol=0, atol=2e-8)  # m
    back = inverse_normals(projection, *en)
    np.testing.assert_allclose(back, normal, rtol=0, atol=2e-15)
    back_lat, back_lon = inverse(projection, *en)
    np.testing.assert_allclose(back_lat, lat, rtol=0, atol=2e-15)
    np.testing.assert_allclose(np.angle(np.exp(1j * (back_lon - lon))) * np.cos(lat), 0, rtol=0, atol=2e-15)
    assert np.all(np.abs(back_lon) <= np.pi)


def test_nothing_happens_at_the_date_line():
    """Longitudes on both sides, and whole turns away, are one place; map positions come back in [-pi, pi]."""
    utm = TransverseMercator.utm(60)
    lon = np.radians(np.array([179.9999, 180.0, -180.0, -179.9999, 540.0, -179.0, 181.0]))
    e, n = (np.asarray(x) for x in forward(utm, np.full(lon.size, 0.8), lon))
    step = e[1] - e[0]
    np.testing.assert_allclose(e[[2, 4]], e[1], rtol=0, atol=1e-8)
    assert e[3] - e[1] == pytest.approx(step, rel=1e-4)
    assert e[6] == pytest.approx(e[5], abs=1e-8)
    _, back = inverse(utm, e, n)
    assert float(back[3]) == pytest.approx(np.radians(-179.9999), abs=1e-14)
    assert float(back[0]) == pytest.approx(np.radians(179.9999), abs=1e-14)


def test_known_place():
    """The south-west corner of tile 32 UPU of the military grid (EPSG:32632), from PROJ 9."""
    lat, lon = TransverseMercator.utm(32).inverse(600_000.0, 5_300_000.0)
    expected = pyproj.Transformer.from_crs(32632, 4326, always_xy=True).transform(600_000.0, 5_300_000.0)
    np.testing.assert_allclose(np.degrees([lon, lat]), expected, rtol=0, atol=1e-13)


def test_on_a_sphere_it_is_the_closed_formula():
    lat, lon = sample(20.0, 60.0, seed=7)
    dlon = lon - np.radians(20.0)
    sphere = TransverseMercator(lon0=np.radians(20.0), ellipsoid=Ellipsoid(a=6371008.8, f=0.0))
    e, n = forward(sphere, lat, lon)
    np.testing.assert_allclose(e, 6371008.8 * np.arctanh(np.cos(lat) * np.sin(dlon)), rtol=0, atol=1e-8)
    northing = 6371008.8 * np.arctan2(np.sin(lat), np.cos(lat) * np.cos(dlon))
    np.testing.assert_allclose(n, northing, rtol=0, atol=1e-8)
    back_lat, back_lon = inverse(sphere, e, n)
    np.testing.assert_allclose(back_lat, lat, rtol=0, atol=2e-15)
    np.testing.assert_allclose((back_lon - lon) * np.cos(lat), 0, rtol=0, atol=2e-15)


CUSTOM = PROJECTIONS["custom"][0]
# (lat, dlon): the poles, the central meridian, the equator, the far meridian, and a point outside the map.
SPECIAL = [(np.pi / 2, 1.0), (-np.pi / 2, 0.3), (0, 0), (0.7, 0), (0, 0.1), (0.3, np.pi), (0, np.pi / 2), (1e-9, 1e-9)]


def all_maps(x):
    """Every map of the projection at (lat, dlon), in units of the Earth's radius and of its position (rad)."""
    lat, lon = x[0], x[1] + CUSTOM.lon0
    there = jnp.stack(CUSTOM.forward_from_normal(normal_of(lat, lon))) / 6.4e6
    convergence_and_scale = jnp.stack(CUSTOM.convergence_and_scale(lat, lon))
    back = CUSTOM.inverse_normal(x[1] * 6.4e6, x[0] * 6.4e6)
    lat_lon = jnp.stack(CUSTOM.inverse(x[1] * 6.4e6, x[0] * 6.4e6))
    return jnp.concatenate([there, back, convergence_and_scale, lat_lon])


def jacobian_and_maps(x):
    J, maps = jax.jacrev(lambda x: (all_maps(x),) * 2, has_aux=True)(x)
    return J, (J, maps)


HESSIAN_JACOBIAN_AND_MAPS = jax.jit(jax.vmap(jax.jacfwd(jacobian_and_maps, has_aux=True)))


@pytest.mark.costly
def test_derivatives_are_finite_to_second_order_and_equal_differences():
    x = np.random.default_rng(6).uniform(-0.6, 0.6, (48, 2))
    x[: len(SPECIAL)] = SPECIAL
    second, (first, _) = HESSIAN_JACOBIAN_AND_MAPS(x)
    assert np.all(np.isfinite(first))
    assert np.all(np.isfinite(second))
    x, regular = x[len(SPECIAL) :], slice(len(SPECIAL), None)
    for axis in range(2):
        step = np.zeros((48, 2))
        step[:, axis] = 1e-5
        at = np.concatenate([x, x[: len(SPECIAL)]])
        (_, ahead), (_, behind) = (HESSIAN_JACOBIAN_AND_MAPS(at + way * step) for way in (1, -1))
        slopes = (ahead[1] - behind[1]) / 2e-5
        np.testing.assert_allclose(first[regular, :, axis], slopes[: len(x)], rtol=0, atol=1e-8)
        curvatures = (ahead[0] - behind[0]) / 2e-5
        np.testing.assert_allclose(second[regular, ..., axis], curvatures[: len(x)], rtol=1e-8, atol=1e-8)


def test_derivatives_reach_the_projection_itself():
    """A false easting moves the map by as much; the scale stretches it about the false origin."""
    projection = TransverseMercator(lon0=jnp.asarray(0.1), k0=jnp.asarray(0.9996), false_easting=jnp.asarray(5e5))
    e, gradient = jax.jit(jax.value_and_grad(lambda p: p.forward(0.8, 0.12)[0]))(projection)
    assert float(gradient.false_easting) == 1.0
    assert float(gradient.k0) == pytest.approx((float(e) - 5e5) / 0.9996, rel=1e-12)


@pytest.mark.parametrize("ellipsoid", [WGS84, CLARKE], ids=["wgs84", "clarke"])
def test_coefficients_equal_their_defining_integrals(ellipsoid):
    """Fourier coefficients of rectifying minus conformal latitude: ALPHA over the conformal one, BETA the other."""
    K = 40
    with mpmath.workdps(50):
        f = mpmath.mpf(ellipsoid.f)
        e2 = f * (2 - f)
        e = mpmath.sqrt(e2)
        lats = [mpmath.pi * k / K for k in range(K)]
        slopes = [(1 - e2) / (1 - e2 * mpmath.sin(t) ** 2) ** mpmath.mpf("1.5") for t in lats]
        mean = sum(slopes) / K
        waves = [
            2 * sum(d * mpmath.cos(2 * j * t) for d, t in zip(slopes, lats, strict=True)) / K for j in range(1, 20)
        ]
        mu = [t + sum(w / mean / (2 * j) * mpmath.sin(2 * j * t) for j, w in enumerate(waves, 1)) for t in lats]
        chi, d_chi = [], []
        for t in lats:
            s, sigma = mpmath.sin(t), e * mpmath.atanh(e * mpmath.sin(t))
            stretch = mpmath.cosh(sigma) - s * mpmath.sinh(sigma)
            sin_chi, cos_chi = (s * mpmath.cosh(sigma) - mpmath.sinh(sigma)) / stretch, mpmath.cos(t) / stretch
            chi.append(t + mpmath.asin(sin_chi * mpmath.cos(t) - cos_chi * s))
            d_chi.append((1 - e2) / (1 - e2 * s**2) / stretch)
        for table, base, slope in (
            (_krueger.ALPHA, chi, d_chi),
            (_krueger.BETA, mu, [d / mean for d in slopes]),
        ):
            for j, found in enumerate(_krueger._coefficients(table, ellipsoid.n), 1):
                terms = [(m - c) * mpmath.sin(2 * j * b) * d for m, c, b, d in zip(mu, chi, base, slope, strict=True)]
                exact = 2 * sum(terms) / K
                assert abs(found / exact - 1) < 1e-14 + 100 * ellipsoid.n ** (9 - j)
        assert _krueger.rectifying_radius(ellipsoid) == pytest.approx(float(mean) * ellipsoid.a, rel=2e-16)


@pytest.mark.parametrize("zone", [0, 61, -5])
def test_an_unknown_utm_zone_is_refused(zone):
    with pytest.raises(ValueError, match=r"zone must lie in \[1, 60\].*got"):
        TransverseMercator.utm(zone)
