"""Rays that begin exactly on the ground: up they rise, down they meet it at once, whatever the rounding."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import WGS84, ConstantHeight, Dem, Geodetic, Ray, Status, intersect
from jaxgeo.terrain import TangentGrid

MIDDLE = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
GRID = TangentGrid.centred(MIDDLE, spacing=(30.0, 30.0), shape=(41, 41))
TERRAINS = {
    "level": ConstantHeight(600.0),
    "posts": Dem.from_array(600.0 + 50.0 * np.random.default_rng(0).uniform(size=(41, 41)), GRID),
}
COUNT = 300
hits = jax.jit(jax.vmap(intersect, in_axes=(0, None)))


def begins(terrain: Any, above: float) -> tuple[np.ndarray, np.ndarray]:
    """(places so far above the ground, the normals of the ellipsoid there)."""
    rng = np.random.default_rng(1)
    lat, lon = 47.0 + rng.uniform(-0.003, 0.003, COUNT), 11.0 + rng.uniform(-0.004, 0.004, COUNT)

    @jax.jit
    @jax.vmap
    def place(lat: Any, lon: Any) -> tuple[Any, Any]:
        height = terrain.height_at(Geodetic(lat=lat, lon=lon, height=jnp.zeros(())))
        p_ecef = WGS84.to_ecef(Geodetic(lat=lat, lon=lon, height=height + above))
        return p_ecef, WGS84.normal_and_height(p_ecef)[0]

    found = place(jnp.deg2rad(lat), jnp.deg2rad(lon))
    return np.asarray(found[0]), np.asarray(found[1])


@pytest.mark.parametrize("name", TERRAINS)
def test_up_rays_rise_and_down_rays_meet_the_ground_at_zero(name: str) -> None:
    terrain = TERRAINS[name]
    origin, up = begins(terrain, 0.0)
    rising, falling = hits(Ray(origin, up), terrain), hits(Ray(origin, -up), terrain)
    assert set(np.asarray(rising.status).tolist()) == {Status.rises_away}
    assert set(np.asarray(falling.status).tolist()) == {Status.hit}
    np.testing.assert_allclose(falling.slant_range, 0.0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(falling.ecef, origin, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", TERRAINS)
def test_a_millimetre_is_told_from_the_ground(name: str) -> None:
    terrain = TERRAINS[name]
    below, up = begins(terrain, -1e-3)
    assert set(np.asarray(hits(Ray(below, up), terrain).status).tolist()) == {Status.camera_below_terrain}
    above, up = begins(terrain, 1e-3)
    found = hits(Ray(above, -up), terrain)
    assert set(np.asarray(found.status).tolist()) == {Status.hit}
    np.testing.assert_allclose(found.slant_range, 1e-3, rtol=0, atol=1e-8)


def test_from_a_valley_the_opposite_slope_is_met() -> None:
    """Level along a valley's side, from the ground on: the hill beyond hides nothing of the way to it."""
    col = np.abs(np.arange(41.0) - 20.0)
    valley = Dem.from_array(np.broadcast_to(600.0 + 10.0 * col, (41, 41)), GRID)
    lat, lon = np.radians(47.0), np.radians(11.0) - 300.0 / (6.39e6 * np.cos(np.radians(47.0)))
    height = float(valley.height_at(Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.zeros(()))))
    origin = WGS84.to_ecef(Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.asarray(height)))
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    found = intersect(Ray(origin, east), valley)
    assert int(found.status) == Status.hit
    assert float(found.slant_range) == pytest.approx(600.0, abs=1.0)
