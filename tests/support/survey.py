"""A survey made up for tests: tiles of a DEM on disk, and frames over them that look in all directions."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Sequence

import jax
import numpy as np
import pyproj
import rasterio

from jaxgeo import Exposure, FrameCamera, Gimbal, Mount, Observation, Pose, Sensor, Shot
from jaxgeo.io import ObservationBatch, Observations
from jaxgeo.uncertainty.sources import Attitude, Position, TerrainHeight

EAST, NORTH, STEP = 600_000.0, 5_300_000.0, 30.0  # m, of the north-west corner and of the posts, UTM 32
CRS = "EPSG:32632"


def height_at(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Height in m of synthetic hills."""
    x, y = east - EAST, NORTH - north
    return 600.0 + 250.0 * np.sin(y / 1700.0) * np.cos(x / 2300.0) + 60.0 * np.sin(y / 311.0 + x / 417.0)


def ridge_at(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Height in m of a plain with a ridge of 1700 m, from north to south, 8.4 km from the corner."""
    return 600.0 + 1700.0 * np.exp(-0.5 * ((east - EAST - 8400.0) / 300.0) ** 2) + 0.0 * north


def write_tiles(
    folder: pathlib.Path,
    down: int = 5,
    across: int = 8,
    posts: int = 100,
    height_at: Callable[[np.ndarray, np.ndarray], np.ndarray] = height_at,
) -> list[pathlib.Path]:
    """`down` x `across` tiles of `posts` x `posts`, heights above the ellipsoid."""
    paths = []
    for i in range(down):
        for j in range(across):
            west, top = EAST + j * posts * STEP, NORTH - i * posts * STEP
            east, north = west + (np.arange(posts) + 0.5) * STEP, top - (np.arange(posts) + 0.5) * STEP
            paths.append(folder / f"tile_{i}_{j}.tif")
            profile = {"height": posts, "width": posts, "count": 1, "dtype": "float64", "crs": CRS}
            with rasterio.open(
                paths[-1], "w", transform=rasterio.Affine(STEP, 0.0, west, 0.0, -STEP, top), **profile
            ) as file:
                file.write(height_at(east[None, :], north[:, None]), 1)
    return paths


def survey(
    count: int, size: Sequence[float], *, sigma: float = 1.0, seed: int = 0, off_nadir: float = 30.0
) -> Observations:
    """`count` frames over an area of `size` = (down, across) in m, `off_nadir` deg in all directions."""
    random = np.random.default_rng(seed)
    down, across = size
    east, north = EAST + random.uniform(0.0, across, count), NORTH - random.uniform(0.0, down, count)
    lon, lat = pyproj.Transformer.from_crs(CRS, "EPSG:4326", always_xy=True).transform(east, north)
    height, heading = 2500.0 + random.uniform(0.0, 500.0, count), random.uniform(0.0, 360.0, count)
    each = [
        Shot(Pose.from_degrees(lat=a, lon=b, height=c, heading=d, pitch=off_nadir, roll=0.0))
        for a, b, c, d in zip(lat, lon, height, heading, strict=True)
    ]
    shots = jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *each)
    camera = FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    sensor = Sensor(camera, Gimbal.fixed(), Mount.nadir())
    uv = np.tile([1999.5, 1499.5], (count, 1))
    sources = (
        Position.from_ned(north=sigma, east=sigma, down=sigma),
        Attitude.from_degrees(heading=0.1, pitch=0.05, roll=0.05),
        TerrainHeight.from_metres(1.0),
    )
    batch = ObservationBatch(Observation(Exposure(sensor, shots), uv), sources, np.arange(count), is_one_camera=True)
    return Observations((batch,), [{"name": f"frame {k}", "u": 1999.5, "v": 1499.5} for k in range(count)])
