"""Reports of registrations: the heights of ties are those with which the update has them imaged."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import Geodetic, locate, project
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.io.registration_report import tie_heights
from jaxgeo.register.orientation_update import Update, update_orientation
from jaxgeo.register.tie_errors import TieErrors
from jaxgeo.register.ties import TiePoints
from jaxgeo.uncertainty import ErrorModel, sources
from tests.support import looks

pytestmark = pytest.mark.slow

SENSOR, SHOT, DEM = looks.sensor(), looks.shot(), looks.dem()
MODEL = ErrorModel((sources.Position.from_ned(north=5.0, east=5.0, down=5.0), sources.TerrainHeight.from_metres(4.0)))


def wrong_ties(*, on_planes: bool) -> TiePoints:
    """Of places that pixels see, metres away from there: on the terrain, or on planes that are not on it."""
    random = np.random.default_rng(5)
    uv = random.uniform((500.0, 300.0), (1100.0, 900.0), (8, 2))
    seen = jax.vmap(lambda pixel: locate(SENSOR, SHOT, pixel, DEM))(uv)
    assert bool(jnp.all(seen.ok))
    away = np.array([9.0, -6.0]) + random.normal(0.0, 2.0, (8, 2))  # m east, north
    frames = jax.vmap(R_ecef_from_enu)(seen.position)
    there = jax.vmap(WGS84.to_geodetic)(seen.ecef + jnp.einsum("tij,tj->ti", frames[:, :, :2], away))
    covariance = jnp.broadcast_to(jnp.eye(2), (8, 2, 2))
    if not on_planes:
        return TiePoints(uv, there, covariance)
    ground = Geodetic(lat=there.lat, lon=there.lon, height=jnp.asarray(there.height) + random.normal(0.0, 3.0, 8))
    return TiePoints(uv, ground, covariance, rise=random.normal(0.0, 0.2, (8, 2)))


def seen_places(found: Update, ground: Geodetic, heights: Any) -> np.ndarray:
    """Pixels of the places in these heights, the map's shift taken off level."""

    def pixel(lat: Any, lon: Any, height: Any) -> Any:
        shown = Geodetic(lat=lat, lon=lon, height=height)
        p_ecef = WGS84.to_ecef(shown) - R_ecef_from_enu(shown)[:, :2] @ found.shift
        return project(found.sensor, found.shot, WGS84.to_geodetic(p_ecef)).uv

    return np.asarray(jax.vmap(pixel)(ground.lat, ground.lon, jnp.asarray(heights)))


# px, of 0.15 m: on the terrain a tie is put along its own vertical, not along that of the place the map shows
@pytest.mark.parametrize("on_planes, atol", [(True, 1e-6), (False, 1e-4)])
def test_ties_in_their_heights_have_the_residuals_of_the_update(on_planes: bool, atol: float) -> None:
    ties = wrong_ties(on_planes=on_planes)
    found = update_orientation(SENSOR, SHOT, ties, DEM, MODEL, TieErrors(registration=1.0, terrain=1.0, shift=10.0))
    assert bool(found.ok)
    assert float(jnp.linalg.norm(found.shift)) > 1.0  # m
    assert abs(float(found.error[3])) > 0.1  # m: the terrain's height
    heights = tie_heights(ties, found)
    assert np.max(np.abs(heights - np.asarray(ties.ground.height))) > 0.5  # m
    off = np.asarray(ties.uv) - seen_places(found, ties.ground, heights) - np.asarray(found.residuals)
    np.testing.assert_allclose(off, 0.0, rtol=0, atol=atol)
    np.testing.assert_array_equal(tie_heights(ties, None), np.asarray(ties.ground.height))
