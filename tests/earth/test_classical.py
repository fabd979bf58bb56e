"""The papers' ways about the Earth: as good as they are, and no better."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pyproj
import pytest

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.earth.classical import (
    GaussKruegerSeries,
    meridian_arc,
    range_to_inflated_ellipsoid,
    range_to_scaled_ellipsoid,
    to_geodetic_simultaneous,
    to_geodetic_successive,
)

ARCSEC = np.radians(1 / 3600)


# Gauss-Krueger of Li et al. (2020)


@pytest.mark.parametrize(
    "from_meridian, at_least, at_most",
    [(0.0, 0.0, 1e-8), (1.5, 1e-7, 1.1e-6), (3.0, 1e-5, 1e-4), (6.0, 1e-3, 0.012), (10.0, 0.1, 0.41)],
)
def test_gauss_krueger_series_against_proj(from_meridian, at_least, at_most):
    """Largest error in m over all latitudes; the lower bound shows where the series ends."""
    proj = pyproj.Proj("+proj=tmerc +lon_0=111 +x_0=500000 +ellps=WGS84 +algo=poder_engsager")
    lat, lon = np.linspace(-90, 90, 361), np.full(361, 111.0 + from_meridian)
    found = np.stack(
        jax.jit(jax.vmap(GaussKruegerSeries(lon0=np.radians(111.0)).forward))(np.radians(lat), np.radians(lon))
    )
    worst = np.abs(found - np.stack(proj(lon, lat))).max()
    assert at_least <= worst <= at_most


def test_gauss_krueger_series_does_not_see_the_date_line():
    series = GaussKruegerSeries(lon0=np.radians(179.0))
    expected, _ = series.forward(0.7, np.radians(181.0))
    found, _ = series.forward(0.7, np.radians(-179.0))
    assert float(found) == pytest.approx(float(expected), abs=1e-8)


@pytest.mark.parametrize("lat_deg", [0.0, 1.0, 29.0, 45.0, 60.0, 90.0, -45.0])
def test_meridian_arc_is_the_integral_of_the_meridian_radius(lat_deg):
    lat = np.radians(lat_deg)
    with mpmath.workdps(30):
        e2 = mpmath.mpf(WGS84.f) * (2 - mpmath.mpf(WGS84.f))
        arc = mpmath.quad(lambda t: WGS84.a * (1 - e2) / (1 - e2 * mpmath.sin(t) ** 2) ** mpmath.mpf("1.5"), [0, lat])
    assert float(meridian_arc(lat)) == pytest.approx(float(arc), abs=1e-8)  # m


def test_the_misprint_in_the_arc_would_be_five_micrometres():
    """Li et al. (2020), Eq 12: 6936933 for 693693 in the last term of A1."""
    excess = (6936933 - 693693) / 1048576 * WGS84.e2**6 * WGS84.a * (1 - WGS84.e2) * np.pi / 2
    assert excess == pytest.approx(5.3e-6, rel=0.01)


# Inflated ellipsoids of Li et al. (2023), Eq 5


def looking(lat, azimuth, off_nadir, origin_height):
    place = Geodetic(lat=lat, lon=jnp.asarray(1.55), height=origin_height)
    tilt = jnp.sin(off_nadir)
    look = jnp.stack([tilt * jnp.cos(azimuth), tilt * jnp.sin(azimuth), jnp.cos(off_nadir)])
    return WGS84.to_ecef(place), R_ecef_from_ned(place) @ look


@jax.jit
@jax.vmap
def height_errors(lat, azimuth, off_nadir, origin_height, height):
    """Height reached minus height asked for: the scaled, inflated and exact surface; and the latitude there."""
    o, d = looking(lat, azimuth, off_nadir, origin_height)
    errors = []
    for meet in (range_to_scaled_ellipsoid, range_to_inflated_ellipsoid):
        s, _ = meet(WGS84, o, d, height)
        errors.append(WGS84.normal_and_height(o + s * d)[1] - height)
    s, _ = WGS84.range_to_height(o, d, height)
    reached = WGS84.to_geodetic(o + s * d)
    return jnp.stack([*errors, reached.height - height, reached.lat])


def errors_of(lat_deg, height, n=200):
    rng = np.random.default_rng(0)
    azimuth, off_nadir = rng.uniform(-np.pi, np.pi, n), np.radians(rng.uniform(0, 79, n))
    out = height_errors(np.full(n, np.radians(lat_deg)), azimuth, off_nadir, np.full(n, 15409.0), np.full(n, height))
    return np.asarray(out).T


@pytest.mark.parametrize("lat_deg, height", [(28.97, 3850.0), (28.97, 3935.7), (28.97, 5289.9)])
def test_at_the_papers_targets_the_printed_ellipsoid_is_metres_low(lat_deg, height):
    scaled, inflated, exact, _ = errors_of(lat_deg, height)
    assert np.all(scaled < -2.9)
    assert np.all(scaled > -4.5)
    assert np.all(np.abs(inflated) < 6e-3)
    assert np.all(np.abs(inflated) > 3e-3)
    np.testing.assert_allclose(exact, 0, rtol=0, atol=1e-8)


@pytest.mark.parametrize("height", [-400.0, 1000.0, 3824.0])
@pytest.mark.parametrize("lat_deg", [-80.0, 10.0, 29.0, 45.0, 88.0])
def test_height_errors_follow_their_formulas(lat_deg, height):
    """-h f sin(lat)^2 as printed, -h f^2 sin(2 lat)^2 / 8 with the right polar axis, to first order."""
    scaled, inflated, exact, lat = errors_of(lat_deg, height)
    f = WGS84.f
    np.testing.assert_allclose(scaled, -height * f * np.sin(lat) ** 2, rtol=0, atol=0.01 * abs(height) * f)
    np.testing.assert_allclose(inflated, -height * f**2 * np.sin(2 * lat) ** 2 / 8, rtol=0, atol=2e-4)
    np.testing.assert_allclose(exact, 0, rtol=0, atol=1e-8)


@pytest.mark.parametrize("meet", [range_to_scaled_ellipsoid, range_to_inflated_ellipsoid])
def test_a_miss_is_said_and_not_numbered(meet):
    o, d = looking(0.5, 0.3, jnp.asarray([1.0, 1.8, np.pi])[1], jnp.asarray(9000.0))
    s, ahead = meet(WGS84, o, d, 0.0)
    assert not bool(ahead)
    assert np.isnan(float(s))
    s, ahead = meet(WGS84, o, -d, 20e3)  # from inside: the near side lies behind
    assert not bool(ahead)


# Iterated latitude and height of Li et al. (2023), Eqs 7-9, and Li et al. (2020), Eq 8


def worst_errors(method, iterations):
    """Largest error of latitude in arcsec and of height in m, from the equator to 89.99 degrees and 0 to 15.4 km."""
    lat, height = np.meshgrid(np.radians(np.append(np.linspace(-89, 89, 120), 89.99)), [0.0, 1000.0, 3824.0, 15409.0])
    g = Geodetic(lat=lat.ravel(), lon=np.full(lat.size, 1.5), height=height.ravel())
    p = jax.vmap(WGS84.to_ecef)(g)
    found = jax.jit(jax.vmap(lambda q: method(WGS84, q, iterations=iterations)))(p)
    return np.abs(found.lat - g.lat).max() / ARCSEC, np.abs(found.height - g.height).max()


@pytest.mark.parametrize(
    "method, iterations, arcsec, metres",
    [
        (to_geodetic_successive, 2, 2.1e-5, 0.49),
        (to_geodetic_successive, 3, 1.3e-7, 3.3e-3),
        (to_geodetic_successive, 4, 7.8e-10, 2.4e-5),
        (to_geodetic_simultaneous, 4, 8.2e-3, 0.49),
        (to_geodetic_simultaneous, 6, 4.8e-5, 3.3e-3),
        (to_geodetic_simultaneous, 7, 1.5e-7, 8e-3),
        (to_geodetic_simultaneous, 8, 3e-7, 2.4e-5),
    ],
)
def test_iterations_leave_what_the_docstrings_say(method, iterations, arcsec, metres):
    lat, height = worst_errors(method, iterations)
    assert arcsec / 2 < lat < arcsec * 1.1
    assert metres / 2 < height < metres * 1.1


def test_the_claim_of_four_iterations():
    """1e-5 arcsec and 1 mm (Li et al. 2023) hold with the newest values in every line, not with the printed indices."""
    lat, height = worst_errors(to_geodetic_successive, 4)
    assert (lat < 1e-5, height < 1e-3) == (True, True)
    lat, height = worst_errors(to_geodetic_simultaneous, 4)
    assert (lat < 1e-5, height < 1e-3) == (False, False)


@pytest.mark.parametrize("method", [to_geodetic_simultaneous, to_geodetic_successive])
@pytest.mark.parametrize("lon", [0.0, 1.0, 2.5, -2.5, -0.1])
def test_longitude_is_right_in_every_quadrant(method, lon):
    """Eq 9 with arctan(Y / X) and its quadrants."""
    p = WGS84.to_ecef(Geodetic(lat=0.5, lon=lon, height=100.0))
    assert float(method(WGS84, p).lon) == pytest.approx(lon, abs=1e-15)
