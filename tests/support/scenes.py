"""Small synthetic terrains and rays over them, all of one shape so that every test shares one compilation."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import Dem, FirstHit, Geodetic, Ray, intersect
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.terrain import TangentGrid

SIZE = 17  # posts on a side
SPACING = 30.0  # m


def small_dem(posts: np.ndarray, *, lat: float = 47.0, lon: float = 11.0, **options) -> Dem:
    """A terrain of 17 x 17 posts, 30 m apart, centred at a point."""
    centre = Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
    return Dem.from_array(posts, TangentGrid.centred(centre, spacing=(SPACING, SPACING), shape=posts.shape), **options)


def flat(height: float = 100.0) -> np.ndarray:
    """Level posts."""
    return np.full((SIZE, SIZE), height)


def rough(seed: int = 0, relief: float = 60.0) -> np.ndarray:
    """Random posts, smoothed once, at least 100 m high."""
    z = np.random.default_rng(seed).uniform(0.0, relief, (SIZE, SIZE))
    z[1:-1, 1:-1] = 0.25 * (z[:-2, 1:-1] + z[2:, 1:-1] + z[1:-1, :-2] + z[1:-1, 2:])
    return 100.0 + z


def local_ray(
    east: float,
    north: float,
    height: float,
    *,
    azimuth: float = 0.0,
    elevation: float = -90.0,
    lat: float = 47.0,
    lon: float = 11.0,
) -> Ray:
    """A ray from a point given in m east and north of the terrain's centre; azimuth and elevation there in degrees."""
    centre = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    R = np.asarray(R_ecef_from_enu(centre))
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    direction = R @ np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])
    origin = np.asarray(WGS84.to_ecef(centre)) + R @ np.array([east, north, 0.0])
    return Ray(jnp.asarray(origin), jnp.asarray(direction))


def stack(rays: list[Ray], count: int = 8) -> Ray:
    """Rays as one batch of fixed size; the last is repeated."""
    rays = [*rays, *[rays[-1]] * (count - len(rays))]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *rays)


@eqx.filter_jit
def _hit(rays: Ray, dem: Dem, search):
    return jax.vmap(lambda ray: intersect(ray, dem, search=search))(rays)


def hit(rays: list[Ray], dem: Dem, search=None):
    """Fixes of up to eight rays, compiled once for each search."""
    fix = _hit(stack(rays), dem, FirstHit() if search is None else search)
    return jax.tree.map(lambda x: np.asarray(x)[: len(rays)], fix)
