"""On a smooth Earth every method gives the same, and what others computed for such a case comes out."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, Ellipsoid, Pose, Shot
from jaxgeo.earth import WGS84
from jaxgeo.uncertainty import ErrorModel, Random, Sobol, propagate, sample, second_order, sigma_points, sources

pytestmark = pytest.mark.costly

RADIUS = 6_371_008.8  # m
HEIGHT, SLANT_RANGE = 15_000.0, 60_000.0
OFF_NADIR = math.acos(((RADIUS + HEIGHT) ** 2 + SLANT_RANGE**2 - RADIUS**2) / (2.0 * (RADIUS + HEIGHT) * SLANT_RANGE))
UV = (400.0, 300.0)


@pytest.fixture(scope="module")
def scene():
    """A camera over the equator of a sphere, whose line of sight lies 75.262 deg off nadir to the north."""
    camera = jaxgeo.FrameCamera.from_pixels(focal_px=20_000.0, width=801, height=601)
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.forward())
    position = WGS84.to_geodetic(jnp.array([RADIUS + HEIGHT, 0.0, 0.0]))
    shot = Shot(Pose(position, 0.0, OFF_NADIR - 0.5 * math.pi, 0.0))
    model = ErrorModel(
        (
            sources.Position.from_ned(north=1.0, east=1.0, down=1.5),
            sources.CameraMounting(jnp.array([0.0, 60e-6, 60e-6])),
            sources.Attitude(jnp.array([100e-6, 0.0, 0.0])),
            sources.TerrainHeight.from_metres(5.0),
            sources.TimeTag.from_seconds(0.0025, velocity_ned=(0.0, 100.0, 0.0)),
        )
    )
    return sensor, shot, UV, ConstantHeight(0.0, Ellipsoid(RADIUS, 0.0)), model


@pytest.fixture(scope="module")
def linear(scene):
    return propagate(*scene)


def test_published_figures(linear) -> None:
    """The figures were computed for a line of sight that keeps its direction in space when the platform is displaced;
    here it keeps that against the level there, which turns by as much as the Earth is round: 5e-5 of the figures."""
    assert math.degrees(OFF_NADIR) == pytest.approx(75.262, abs=1e-3)
    assert float(linear.circular_error(0.5)) == pytest.approx(18.6279, abs=2.5e-3)
    assert float(linear.circular_error(0.9)) == pytest.approx(42.2238, abs=2.5e-3)


def test_published_derivatives(linear) -> None:
    """Along the look by elevation S / cos i, across it S, by height tan i; the incidence i is 75.784 deg."""
    axes = {name: np.asarray(column) for name, column in zip(linear.model.axes, linear.jacobian.T, strict=True)}
    assert abs(axes["camera mounting: right"][1]) == pytest.approx(244_314.0, abs=5.0)
    assert abs(axes["camera mounting: down"][0]) == pytest.approx(SLANT_RANGE, abs=1.0)
    assert abs(axes["terrain height: height"][1]) == pytest.approx(3.947, abs=1e-3)


@pytest.mark.parametrize("method", [pytest.param(second_order, marks=pytest.mark.slow), sigma_points])
def test_middle_ways_agree(scene, linear, method) -> None:
    moments = method(*scene)
    for probability in (0.5, 0.9):
        expected = float(linear.circular_error(probability))
        assert float(moments.circular_error(probability)) == pytest.approx(expected, rel=1e-3)


@pytest.fixture(scope="module")
def drawn(scene):
    """Sixteen scrambles of Sobol points."""
    return sample(*scene, key=jax.random.key(3), count=2**16, draws=Sobol(), chunk=2**14)


@pytest.fixture(scope="module")
def plain(scene):
    """As many plain draws."""
    return sample(*scene, key=jax.random.key(3), count=2**16, draws=Random(), chunk=2**14)


@pytest.mark.slow
def test_samples_agree(linear, drawn) -> None:
    for probability in (0.5, 0.9):
        assert drawn.circular_error(probability).value == pytest.approx(
            float(linear.circular_error(probability)), rel=1e-3
        )
    np.testing.assert_allclose(drawn.cov_enu, linear.cov_enu, atol=2e-3 * np.abs(linear.cov_enu).max())
    assert drawn.found == drawn.count == 2**16


def test_turned_sobol_points_are_ten_times_as_good(linear, drawn) -> None:
    """The variance of CE50 from 2^10 points, against as many plain draws of the normal error of the fix."""
    truth = float(linear.circular_error(0.5))
    normal = np.random.default_rng(3).multivariate_normal(np.zeros(2), np.asarray(linear.cov_enu)[:2, :2], 2**14)
    squared = []
    for radii in (drawn.radii["CE"][: 2**14], np.hypot(*normal.T)):
        each = [np.median(radii[number::16]) for number in range(16)]
        squared.append(np.mean((np.array(each) - truth) ** 2))
    assert squared[0] * 10.0 < squared[1]


@pytest.mark.parametrize("draws", ["drawn", pytest.param("plain", marks=pytest.mark.slow)])
def test_intervals_hold_the_truth(linear, draws: str, request: pytest.FixtureRequest) -> None:
    result = request.getfixturevalue(draws)
    for probability in (0.5, 0.9):
        quantile = result.circular_error(probability)
        slack = quantile.high - quantile.low  # twice as wide on either side: this test is not to fail by chance
        truth = float(linear.circular_error(probability))
        assert quantile.low - slack <= truth <= quantile.high + slack
