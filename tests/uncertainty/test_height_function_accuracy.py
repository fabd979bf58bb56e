"""Accuracy over ground that is one function: as samples say, the method by how rough it is."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Geodetic, Pose, Shot
from jaxgeo.terrain import HeightFunction
from jaxgeo.uncertainty import (
    ErrorModel,
    Footprint,
    Method,
    Sampling,
    accuracy,
    accuracy_map,
    compare,
    propagate,
    sample,
    sources,
)
from tests.support.hills import BASE, LAT, LON, hills, terrain
from tests.uncertainty.test_accuracy_map import SENSOR as TURNING
from tests.uncertainty.test_verdict import SENSOR, UV

pytestmark = pytest.mark.slow


def model(sigma_deg: float) -> ErrorModel:
    return ErrorModel(
        (
            sources.Attitude.from_degrees(heading=sigma_deg, pitch=sigma_deg, roll=sigma_deg),
            sources.Position.from_ned(north=2.0, east=2.0, down=3.0),
            sources.TerrainHeight.from_metres(3.0),
        )
    )


def shot(depression_deg: float) -> Shot:
    """From 2 km above the hills."""
    return Shot(Pose.from_degrees(lat=47.001, lon=11.0, height=2300.0, heading=30.0, pitch=-depression_deg))


# seed, longest wave in m, steepest slope; depression and sigma of angles in deg; the method
SCENES = {
    "gentle": ((7, 6000.0, 0.02), 15.0, 0.1, Method.facet),
    "long waves, steep look": ((5, 6000.0, 0.35), 50.0, 0.3, Method.facet),
    "long waves, flat look": ((5, 6000.0, 0.35), 8.0, 0.02, Method.footprint),
    "fine waves": ((6, 300.0, 0.35), 8.0, 0.1, Method.footprint),
    "finest waves": ((6, 300.0, 0.35), 8.0, 0.3, Method.footprint),
    "ridges that hide": ((8, 1500.0, 1.0), 8.0, 0.02, Method.samples),
}


@pytest.mark.parametrize("scene", SCENES)
def test_the_verdict_agrees_with_samples(scene: str) -> None:
    (seed, longest, slope), depression, sigma, expected = SCENES[scene]
    ground = terrain(hills(seed=seed, longest=longest, slope=slope))
    given = (SENSOR, shot(depression), UV, ground, model(sigma))
    result = accuracy(*given, sampling=Sampling(count=4096))
    assert Method(int(result.method)) is expected, str(result)
    drawn = sample(*given, key=jax.random.key(9), count=4096)
    for door, figure in (("circular_error", result.circular), ("linear_error", result.linear)):
        truth = getattr(drawn, door)(0.9)
        assert 0.93 * truth.low <= figure <= 1.07 * truth.high, (str(result), truth)


def inclined(position: Geodetic):
    """A plane, but for the Earth's curvature: it rises by a tenth to the north."""
    return BASE + 6.37e5 * (position.lat - LAT)


def test_a_plane_is_told_as_one_and_every_method_holds() -> None:
    ground = HeightFunction(inclined, -2000.0, 3000.0, lipschitz=0.11)
    given = (SENSOR, shot(30.0), UV, ground, model(0.05))
    result = accuracy(*given)
    assert Method(int(result.method)) is Method.facet
    assert "nearly planar" in result.because
    footprint = float(propagate(*given, slope=Footprint()).circular_error(0.9))
    assert footprint == pytest.approx(result.circular, rel=1e-3)
    compared = compare(*given, sampling=Sampling(count=4096, key=jax.random.key(0)), digits=1)
    assert {"linear, facet", "linear, footprint", "sigma points"} <= set(compared.valid), str(compared)
    assert compared.jumped == compared.failed == 0.0


def test_sure_level_ground_needs_no_samples() -> None:
    """Its linear error is none, but for the Earth's curvature."""
    ground = HeightFunction(lambda position: 300.0 + 0.0 * position.lat, 300.0, 300.0, lipschitz=0.0)
    result = accuracy(
        SENSOR, shot(20.0), UV, ground, (sources.Attitude.from_degrees(heading=0.1, pitch=0.1, roll=0.1),)
    )
    assert Method(int(result.method)) is Method.facet, str(result)
    assert result.linear < 0.01


def test_a_map_has_the_heights_of_the_function() -> None:
    ground = terrain(hills(seed=7, longest=6000.0, slope=0.02))
    lat, lon = LAT + np.array([4e-4, 5e-4, np.nan]), LON + np.array([1e-4, 2e-4, 0.0])
    places = Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.zeros(3))
    wide = Pose.from_degrees(lat=47.001, lon=11.0, height=2300.0)
    found = accuracy_map(TURNING, wide, ground, model(0.02), places, sampling=None)
    heights = jax.vmap(ground.height_at)(jax.tree.map(lambda x: x[:2], places))
    np.testing.assert_allclose(found.position.height[:2], heights, rtol=0, atol=1e-9)
    assert np.asarray(found.has_fix).tolist() == [True, True, False]
