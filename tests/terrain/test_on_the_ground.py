"""Rays that begin exactly on the ground: up they rise, down they meet it at once, whatever the rounding."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.scenes import SIZE, hit, small_dem

from jaxgeo import WGS84, ConstantHeight, Geodetic, Ray, Status

pytestmark = pytest.mark.costly

TERRAINS = {
    "level": ConstantHeight(jnp.asarray(600.0)),
    "posts": small_dem(600.0 + 50.0 * np.random.default_rng(0).uniform(size=(SIZE, SIZE))),
}
COUNT = 300


def hits(rays: Ray, terrain: Any) -> Any:
    """Fixes of many rays, by the program for eight."""
    each = [Ray(*one) for one in zip(np.asarray(rays.origin), np.asarray(rays.direction), strict=True)]
    parts = [hit(each[k : k + 8], terrain) for k in range(0, len(each), 8)]
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


@jax.jit
def places(terrain: Any, lat: Any, lon: Any, above: Any) -> tuple[Any, Any]:
    """(places so far above the ground, the normals of the ellipsoid there)."""

    def place(lat: Any, lon: Any) -> tuple[Any, Any]:
        height = terrain.height_at(Geodetic(lat=lat, lon=lon, height=jnp.zeros(())))
        p_ecef = WGS84.to_ecef(Geodetic(lat=lat, lon=lon, height=height + above))
        return p_ecef, WGS84.normal_and_height(p_ecef)[0]

    return jax.vmap(place)(lat, lon)


def begins(terrain: Any, above: float) -> tuple[np.ndarray, np.ndarray]:
    """Some places so far above the ground, and the normals of the ellipsoid there."""
    rng = np.random.default_rng(1)
    lat, lon = 47.0 + rng.uniform(-0.002, 0.002, COUNT), 11.0 + rng.uniform(-0.003, 0.003, COUNT)
    found = places(terrain, np.deg2rad(lat), np.deg2rad(lon), above)
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
    col = np.abs(np.arange(SIZE) - SIZE // 2)
    valley = small_dem(np.broadcast_to(600.0 + 10.0 * col, (SIZE, SIZE)))
    lat, lon = np.radians(47.0), np.radians(11.0) - 150.0 / (6.39e6 * np.cos(np.radians(47.0)))
    height = float(valley.height_at(Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.zeros(()))))
    origin = WGS84.to_ecef(Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.asarray(height)))
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    found = hit([Ray(origin, east)], valley)
    assert int(found.status[0]) == Status.hit
    assert float(found.slant_range[0]) == pytest.approx(300.0, abs=0.5)
