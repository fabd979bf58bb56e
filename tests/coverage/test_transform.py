"""Overlap by transforming coordinates: steps and lengths on a map, against lengths on the ground and each other."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo._locate import locate
from jaxgeo.coverage import transform
from jaxgeo.coverage.geometry import overlap_change_by_heading
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.earth.classical import GaussKruegerSeries
from jaxgeo.earth.projection import TransverseMercator
from jaxgeo.sensor import Pose, Shot
from jaxgeo.sensor.conventions import li_2020_sensor
from jaxgeo.terrain import ConstantHeight

MERIDIAN = math.radians(111.0)
MAP = TransverseMercator.gauss_krueger(MERIDIAN)
MAPS = {"Krueger": MAP, "Li 2020": GaussKruegerSeries(lon0=MERIDIAN)}
PLACE = Geodetic.from_degrees(lat=34.86, lon=109.51, height=400.0)
ROWS = 3072


def beside(east: float, north: float) -> Geodetic:
    """A point some metres from the place, in its tangent plane."""
    offset = R_ecef_from_enu(PLACE) @ jnp.array([east, north, 0.0])
    return WGS84.to_geodetic(WGS84.to_ecef(PLACE) + offset)


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("east, north", [(300.0, 0.0), (0.0, -380.0), (-120.0, 250.0)])
def test_steps_are_the_maps(name, east, north) -> None:
    """Turned by the convergence of meridians, and stretched by the map's scale from the ellipsoid."""
    step = np.asarray(transform.step_on_map(MAPS[name], PLACE, beside(east, north)))
    convergence, scale = (float(x) for x in MAP.convergence_and_scale(PLACE.lat, PLACE.lon))
    down = scale * WGS84.a / (WGS84.a + 400.0)
    length, bearing = math.hypot(east, north), math.atan2(east, north) - convergence
    np.testing.assert_allclose(np.hypot(*step), down * length, rtol=3e-5)  # curvature differs with the azimuth
    assert math.remainder(math.atan2(*step) - bearing, math.tau) == pytest.approx(0.0, abs=3e-5)
    found = float(transform.bearing_on_map(MAPS[name], PLACE, beside(east, north)))
    assert math.remainder(found - bearing, math.tau) == pytest.approx(0.0, abs=3e-5)


def test_both_maps_agree() -> None:
    steps = [np.asarray(transform.step_on_map(one, PLACE, beside(-120.0, 250.0))) for one in MAPS.values()]
    np.testing.assert_allclose(*steps, rtol=0, atol=1e-6)  # m


def test_projected_and_euclidean_steps() -> None:
    """Along its own bearing a step is its length, across it nothing, backwards negative."""
    there = beside(-120.0, 250.0)
    bearing = transform.bearing_on_map(MAP, PLACE, there)
    euclidean = float(transform.euclidean_step(MAP, PLACE, there))
    for turn, factor in ((0.0, 1.0), (0.5 * math.pi, 0.0), (math.pi, -1.0), (math.pi / 3.0, 0.5)):
        along = transform.projected_step(MAP, PLACE, there, bearing=bearing + turn)
        assert float(along) == pytest.approx(factor * euclidean, abs=1e-6)
    for one in (
        transform.overlap_along(MAP, PLACE, there, bearing=bearing, length=2.0 * euclidean),
        transform.overlap_of_eq_16(MAP, PLACE, there, length=2.0 * euclidean),
    ):
        assert float(one) == pytest.approx(0.5, abs=1e-12)


def test_a_point_that_was_not_found_stays_unknown() -> None:
    nowhere = Geodetic(lat=jnp.array(math.nan), lon=jnp.array(math.nan), height=jnp.array(math.nan))
    assert np.isnan(transform.overlap_along(MAP, PLACE, nowhere, bearing=0.3, length=450.0))
    assert np.isnan(transform.overlap_of_eq_16(MAP, PLACE, nowhere, length=450.0))
    assert np.isnan(transform.frame_length_on_map(MAP, nowhere, PLACE))


@pytest.mark.costly
def test_derivatives_stay_finite_where_nothing_moves() -> None:
    def measures(lat: jax.Array, lon: jax.Array) -> jax.Array:
        there = Geodetic(lat=lat, lon=lon, height=PLACE.height)
        return jnp.stack(
            [
                transform.euclidean_step(MAP, PLACE, there),
                transform.bearing_on_map(MAP, PLACE, there),
                transform.projected_step(MAP, PLACE, there, bearing=0.3),
                transform.frame_length_on_map(MAP, PLACE, there),
            ]
        )

    for differentiate in (jax.jacfwd, jax.jacrev):
        slopes = jax.jit(differentiate(measures, argnums=(0, 1)))(jnp.asarray(PLACE.lat), jnp.asarray(PLACE.lon))
        assert np.all(np.isfinite(slopes))
        np.testing.assert_array_equal(np.asarray(slopes)[:, [0, 1, 3]], 0.0)


CHANGES = np.radians([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.3, 0.3 - 1e-4, 0.3 + 1e-4])


def overlaps(heading_change: jax.Array) -> jax.Array:
    """Overlaps (projected, of Eq 16) after the nose has turned, for the paper's camera 74 deg off nadir."""
    sensor = li_2020_sensor(
        focal_length=0.5 * ROWS * 9e-6 / math.tan(math.radians(0.44)),
        pixel_pitch=9e-6,
        along_flight=ROWS,
        across_flight=4096,
        mirror=False,
    )

    def seen(lat: jax.Array, change: jax.Array, row: jax.Array) -> Geodetic:
        pose = Pose(Geodetic(lat=lat, lon=math.radians(109.51), height=8143.0), math.pi + change)
        shot = Shot(pose, jnp.array([math.radians(74.0), 0.0]))
        return locate(sensor, shot, (2047.5, row), ConstantHeight(0.0)).position

    still, middle = jnp.zeros(()), 0.5 * (ROWS - 1)
    lats = jnp.deg2rad(jnp.array([34.86, 34.86, 34.86, 34.8565, 34.8565]))
    turns = jnp.stack([still, still, still, still, heading_change])
    points = jax.vmap(seen)(lats, turns, jnp.array([ROWS - 0.5, -0.5, middle, middle, middle]))
    rear, front, first, planned, second = (jax.tree.map(lambda leaf, k=k: leaf[k], points) for k in range(5))
    length = transform.frame_length_on_map(MAP, rear, front)
    bearing = transform.bearing_on_map(MAP, first, planned)
    projected = transform.overlap_along(MAP, first, second, bearing=bearing, length=length)
    return jnp.stack([projected, transform.overlap_of_eq_16(MAP, first, second, length=length)])


@pytest.fixture(scope="module")
def turned() -> tuple[np.ndarray, np.ndarray]:
    """Both overlaps at each of `CHANGES`, and their derivatives by the change."""

    def value_and_slope(change: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(overlaps, (change,), (jnp.ones_like(change),))

    values, slopes = jax.jit(jax.vmap(value_and_slope))(CHANGES)
    return np.asarray(values), np.asarray(slopes)


@pytest.mark.slow
def test_the_euclidean_step_folds(turned) -> None:
    """Turning back by 0.8 and 1 deg the projected overlap goes on as Eq 18 has it; that of Eq 16 turns round."""
    projected, euclidean = turned[0][:6].T
    formula = overlap_change_by_heading(
        heading_change=CHANGES[:6], off_nadir=math.radians(74.0), field_of_view=math.radians(0.88)
    )
    np.testing.assert_allclose(projected - projected[0], formula, rtol=0, atol=1e-5)
    np.testing.assert_allclose(euclidean[:3], projected[:3], rtol=0, atol=1e-4)
    assert np.all(np.diff(projected) > 0.2)
    assert euclidean[-1] < euclidean[-2] < 1.0 < projected[-2]


@pytest.mark.costly
def test_overlaps_differentiate_through_the_fix(turned) -> None:
    values, slopes = turned
    np.testing.assert_allclose(slopes[6], (values[8] - values[7]) / (CHANGES[8] - CHANGES[7]), rtol=1e-6)


def test_refusals() -> None:
    with pytest.raises(ValueError, match=r"length must be above 0 m; got 0.0"):
        transform.overlap_of_eq_16(MAP, PLACE, PLACE, length=0.0)
