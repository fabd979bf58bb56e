"""Synthetic terrain with a given RMS slope, and oblique rays over it."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import batch_filter_jit
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain import Dem, TangentGrid
from jaxgeo.terrain.grid import surface_point

CENTRE = Geodetic(lat=math.radians(29.4), lon=math.radians(88.9), height=0.0)  # flights of Li et al. (2023)
ALTITUDE = 15_409.0  # m, their aircraft


class Scene(Record):
    """A terrain and a batch of rays over it, with their parameters: RMS slope and depression in rad."""

    name: str = eqx.field(static=True)
    dem: Dem
    rays: Ray
    rms_slope: float = eqx.field(static=True)
    depression: float = eqx.field(static=True)


def fractal_posts(size: int, *, spacing: float, rms_slope: float, exponent: float = 3.39, seed: int = 1) -> np.ndarray:
    """Posts (size, size) in m from 0 up: a Gaussian field of power spectrum f**-exponent, scaled to `rms_slope` in rad.

    The RMS slope is the arctangent of the root of the mean squared gradient by central differences. The field is
    periodic. An exponent of 3.39 is that of rough mountains (a fractal dimension of 2.3).
    """
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    frequency[0, 0] = np.inf
    field = np.fft.irfft2(spectrum * frequency ** (-0.5 * exponent), s=(size, size))
    return (field - field.min()) * (math.tan(rms_slope) / math.tan(rms_slope_of(field, spacing)))


def rms_slope_of(posts: np.ndarray, spacing: float) -> float:
    """Arctangent, in rad, of the root of the mean squared gradient of posts `spacing` m apart."""
    rows, cols = np.gradient(posts, spacing)
    return float(np.arctan(np.sqrt(np.mean(rows**2 + cols**2))))


def tangent_dem(posts: np.ndarray, spacing: float, centre: Geodetic = CENTRE) -> Dem:
    """A DEM with posts `spacing` m apart, rows going south and columns east, centred at `centre`."""
    return Dem.from_array(posts, TangentGrid.centred(centre, spacing=(spacing, spacing), shape=posts.shape))


def make_scene(
    name: str,
    *,
    rms_slope: float,
    depression: float,
    rays: int,
    size: int = 1501,
    spacing: float = 30.0,
    exponent: float = 3.39,
    seed: int = 1,
    margin: float = 0.4,
) -> Scene:
    """Fractal terrain and `rays` over it, drawn independently of the ground, like pixels of a camera.

    Each passes through a point of the level surface at the mean height, drawn uniformly over the grid except `margin`
    of its side at each edge, with a uniform azimuth, at `depression` in rad there, from the altitude of Li et al.
    (2023), or 1000 m above the highest ground where that is higher.
    """
    posts = fractal_posts(size, spacing=spacing, rms_slope=rms_slope, exponent=exponent, seed=seed)
    dem = tangent_dem(posts, spacing)
    rng = np.random.default_rng([seed, 7])
    rowcol = rng.uniform(margin * (size - 1), (1.0 - margin) * (size - 1), (rays, 2))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, rays)
    altitude = max(ALTITUDE, float(posts.max()) + 1000.0)
    mean, depression = float(posts.mean()), float(depression)
    made = _rays_through(dem, rowcol, azimuth, mean, depression, altitude)
    return Scene(name, dem, made, float(rms_slope), depression)


def _ray_through(
    dem: Dem, rowcol: jax.Array, azimuth: Scalar, height: Scalar, depression: Scalar, altitude: Scalar
) -> Ray:
    """The ray from `altitude` m with `depression` and `azimuth` in rad through (row, col) at `height` m."""
    normal = dem.grid.normal(rowcol)
    p_ecef: Vector3 = surface_point(normal) + height * normal
    R_ecef_from_level = R_ecef_from_enu(WGS84.to_geodetic(p_ecef))
    level = jnp.cos(depression)
    along = jnp.stack([level * jnp.sin(azimuth), level * jnp.cos(azimuth), -jnp.sin(depression)])
    direction = R_ecef_from_level @ along
    _, far, _ = WGS84.ranges_to_height(p_ecef, -direction, altitude)
    return Ray(p_ecef - far * direction, direction)


_many_through = batch_filter_jit(jax.vmap(_ray_through, (None, 0, 0, None, None, None)))


def _rays_through(dem: Dem, rowcol: np.ndarray, azimuth: np.ndarray, *numbers: float) -> Ray:
    """Rays through (n, 2) places at azimuths (n,) in rad; `numbers` are height, depression and altitude."""
    return _many_through(dem, jnp.asarray(rowcol), jnp.asarray(azimuth), *(jnp.asarray(float(x)) for x in numbers))


def profile_dem(heights: np.ndarray, spacing: float, *, width: int = 5) -> Dem:
    """A DEM that is constant across the view: heights in m `spacing` m apart along it, `width` posts across."""
    return tangent_dem(np.repeat(np.asarray(heights, float)[:, None], width, axis=1), spacing)


def profile_ray(dem: Dem, ahead: float, height: float, *, depression: float, altitude: float) -> Ray:
    """A ray along a `profile_dem`: from `altitude` m through the point `ahead` m beyond the centre at `height` m."""
    spacing = dem.grid.cell_size()[0]
    middle = 0.5 * (np.asarray(dem.extent) - 1.0)
    rowcol = middle + np.array([ahead / spacing, 0.0])
    rays = _rays_through(dem, rowcol[None], np.array([np.pi]), height, depression, altitude)
    return jax.tree.map(lambda x: x[0], rays)


@batch_filter_jit
def profile_under(ray: Ray, dem: Dem, distance: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Heights in m of a ray and of the ground below it at ranges (n,) in m; outside the grid, of its edge."""

    def heights(distance: Scalar) -> tuple[Scalar, Scalar]:
        rowcol, height = dem.over(ray.at(distance))
        inside = jnp.clip(rowcol, 0.0, (jnp.asarray(dem.extent) - 1).astype(jnp.float64))
        return height, dem.surface(inside, dem.cell_of(inside))

    return jax.vmap(heights)(distance)
