"""Rough hills as one formula: in JAX, as a user writes it, and in NumPy, with bounds derived by hand."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import Dem, Geodetic
from jaxgeo.earth import WGS84
from jaxgeo.terrain import HeightFunction, TangentGrid

LAT, LON = np.deg2rad(47.0), np.deg2rad(11.0)
BASE = 300.0  # m
LEAST_RADIUS = 6.33e6  # m
WAVES = 7


class Hills(eqx.Module):
    """A sum of waves around a position: amplitudes in m, wave numbers per rad of latitude and longitude, phases in
    rad."""

    amplitude: jax.Array
    by_lat: jax.Array
    by_lon: jax.Array
    phase: jax.Array

    def __call__(self, position: Geodetic):
        north, east = position.lat - LAT, position.lon - LON
        waves = self.amplitude * jnp.sin(self.by_lat * north + self.by_lon * east + self.phase)
        return BASE + jnp.sum(waves)


def hills(seed: int = 0, longest: float = 3000.0, slope: float = 0.35) -> Hills:
    """Waves from `longest` m down to a hundredth of it, with a total slope of at most `slope` m per m."""
    rng = np.random.default_rng(seed)
    length = longest * np.geomspace(1.0, 0.01, WAVES)
    heading = rng.uniform(0.0, 2.0 * np.pi, WAVES)
    number = 2.0 * np.pi / length  # per m
    amplitude = slope / WAVES / number
    by_lat, by_lon = number * np.cos(heading) * LEAST_RADIUS, number * np.sin(heading) * LEAST_RADIUS * np.cos(LAT)
    return Hills(*(jnp.asarray(x) for x in (amplitude, by_lat, by_lon, rng.uniform(0.0, 2.0 * np.pi, WAVES))))


def steepest(shape: Hills, *, farthest: float = 0.02) -> float:
    """Upper bound of the slope, m per m, within `farthest` rad of latitude: each wave at its steepest."""
    metres_by_lon = LEAST_RADIUS * np.cos(LAT + farthest)
    return float(np.sum(np.abs(shape.amplitude) * np.hypot(shape.by_lat / LEAST_RADIUS, shape.by_lon / metres_by_lon)))


def terrain(shape: Hills, *, with_slope: bool = True) -> HeightFunction:
    """The hills as a jaxgeo terrain."""
    most = float(np.sum(np.abs(shape.amplitude)))
    return HeightFunction(shape, BASE - most, BASE + most, lipschitz=steepest(shape) if with_slope else None)


def heights(shape: Hills, lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    """Heights in m at latitudes and longitudes in rad, in NumPy."""
    a, m, n, phase = (np.asarray(x) for x in (shape.amplitude, shape.by_lat, shape.by_lon, shape.phase))
    return BASE + np.sum(a * np.sin(m * (lat - LAT)[..., None] + n * (lon - LON)[..., None] + phase), axis=-1)


def geodetic(p_ecef: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(latitude, longitude in rad, height in m) of points (n, 3), by an independent fixed-point iteration."""
    a, e2 = 6378137.0, (2.0 - 1.0 / 298.257223563) / 298.257223563
    x, y, z = p_ecef.T
    level = np.hypot(x, y)
    lat = np.arctan2(z, level * (1.0 - e2))
    for _ in range(8):
        normal = a / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + e2 * normal * np.sin(lat), level)
    normal = a / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
    return lat, np.arctan2(y, x), level * np.cos(lat) + z * np.sin(lat) - a**2 / normal


def first_below(shape: Hills, origin: np.ndarray, direction: np.ndarray, end: float, step: float) -> float:
    """The range in m of the first sample, `step` m apart, at which a ray is below the hills; infinite if none is."""
    distance = np.arange(0.0, end, step)
    lat, lon, height = geodetic(origin + distance[:, None] * direction)
    below = height <= heights(shape, lat, lon)
    return float(distance[np.argmax(below)]) if below.any() else np.inf


def sampled_dem(shape: Hills, spacing: float, size: int) -> Dem:
    """The hills at the posts of a grid around their centre."""
    middle = Geodetic(lat=jnp.asarray(LAT), lon=jnp.asarray(LON), height=jnp.zeros(()))
    grid = TangentGrid.centred(middle, spacing=(spacing, spacing), shape=(size, size))
    row, col = np.meshgrid(np.arange(float(size)), np.arange(float(size)), indexing="ij")
    rowcol = jnp.asarray(np.stack([row.reshape(-1), col.reshape(-1)], axis=1))
    normal = np.asarray(jax.jit(jax.vmap(grid.normal))(rowcol))
    lat, lon = np.arctan2(normal[:, 2], np.hypot(normal[:, 0], normal[:, 1])), np.arctan2(normal[:, 1], normal[:, 0])
    return Dem.from_array(heights(shape, lat, lon).reshape(size, size), grid)


def rays_over(count: int, seed: int, height: float = 800.0) -> tuple[np.ndarray, np.ndarray]:
    """(origins, directions) (count, 3) of rays from near the centre, half of them close to the horizon."""
    rng = np.random.default_rng(seed)
    place = WGS84.to_ecef(Geodetic(lat=jnp.asarray(LAT), lon=jnp.asarray(LON), height=jnp.asarray(height)))
    east = np.array([-np.sin(LON), np.cos(LON), 0.0])
    up = np.array([np.cos(LAT) * np.cos(LON), np.cos(LAT) * np.sin(LON), np.sin(LAT)])
    north = np.cross(up, east)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
    down = np.deg2rad(np.where(np.arange(count) % 2 == 0, rng.uniform(2.0, 9.0, count), rng.uniform(9.0, 80.0, count)))
    level = np.sin(azimuth)[:, None] * east + np.cos(azimuth)[:, None] * north
    directions = np.cos(down)[:, None] * level - np.sin(down)[:, None] * up
    aside = rng.uniform(-500.0, 500.0, (count, 2))
    return np.asarray(place) + aside[:, :1] * east + aside[:, 1:] * north, directions
