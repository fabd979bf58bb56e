"""A ridge before a plain, cut into tiles in several ways, rays over it, and a reference march in NumPy alone."""

from __future__ import annotations

import pathlib

import jax
import numpy as np
import rasterio
from rasterio.transform import Affine

from jaxgeo import Dem, Fix, Ray
from jaxgeo.io import read_dem
from jaxgeo.io.locate_on_disk import _hits
from jaxgeo.io.sightlines import padded_rays
from support.fractal import ecef, fractal_posts, normal_and_height
from support.rasters import write

SIZE, TILES = 201, 10  # posts on a side, tiles on a side
STEP = 1.0 / 1200.0  # deg between posts, about 90 m
WEST, NORTH = 5.0, 45.0  # of the first post


def corner(row: int, col: int) -> Affine:
    """GDAL's transform of a raster whose first post is (row, col) of the mosaic."""
    return Affine(STEP, 0, WEST + (col - 0.5) * STEP, 0, -STEP, NORTH - (row - 0.5) * STEP)


def cut(folder: pathlib.Path, posts: np.ndarray, *, shared: bool, leave_out: tuple[int, ...] = (), **options) -> None:
    """Write posts as 10 x 10 tiles that share their border posts, or whose pixels are adjacent."""
    folder.mkdir(exist_ok=True)
    rows = np.linspace(0, posts.shape[0] - (1 if shared else 0), TILES + 1).astype(int)
    cols = np.linspace(0, posts.shape[1] - (1 if shared else 0), TILES + 1).astype(int)
    for i in range(TILES):
        for j in range(TILES):
            if i * TILES + j in leave_out:
                continue
            part = posts[rows[i] : rows[i + 1] + shared, cols[j] : cols[j + 1] + shared]
            write(folder / f"n{i}e{j}.tif", part, affine=corner(rows[i], cols[j]), point=shared, **options)


def write_vrt(path: pathlib.Path, tiles: list[pathlib.Path], shape: tuple[int, int], *, shift: float = 0.0) -> None:
    """A VRT as written by gdalbuildvrt."""
    sources = []
    for tile in tiles:
        with rasterio.open(tile) as data:
            (rows, cols), t = data.shape, data.transform
        x, y = (t.c - WEST) / STEP + 0.5 + shift, (NORTH - t.f) / STEP + 0.5
        rects = f'<SrcRect xOff="0" yOff="0" xSize="{cols}" ySize="{rows}"/>'
        rects += f'<DstRect xOff="{x:.9g}" yOff="{y:.9g}" xSize="{cols}" ySize="{rows}"/>'
        name = f'<SourceFilename relativeToVRT="1">{tile.relative_to(path.parent)}</SourceFilename>'
        sources.append(f"<SimpleSource>{name}<SourceBand>1</SourceBand>{rects}</SimpleSource>")
    transform = ", ".join(str(number) for number in corner(0, 0).to_gdal())
    path.write_text(
        f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}"><SRS>EPSG:4326</SRS>'
        f'<GeoTransform>{transform}</GeoTransform><VRTRasterBand dataType="Float64" band="1">'
        f"<NoDataValue>-32768</NoDataValue>{''.join(sources)}</VRTRasterBand></VRTDataset>"
    )


def ridge_before_plain() -> np.ndarray:
    """Rough hills, a plain behind them, and a steep ridge in the first column of tiles."""
    posts = fractal_posts(SIZE, spacing=90.0, relief=500.0, exponent=3.2, seed=6)
    posts[:, 60:] = 0.02 * posts[:, 60:] + 100.0
    posts[:, 9:12] += 900.0
    posts[::40, 140:] += 400.0  # spurs along the borders between tiles
    return posts


def frame(row: np.ndarray, col: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """lat, lon, east, north, up at positions on the mosaic."""
    lat, lon = np.radians(NORTH - row * STEP), np.radians(WEST + col * STEP)
    up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    east = np.stack([-np.sin(lon), np.cos(lon), np.zeros_like(lon)], axis=-1)
    return lat, lon, east, np.cross(up, east), up


def rays_to(row, col, height, azimuth, zenith, distance) -> Ray:
    """Rays to points at (row, col) and height; azimuth of travel and angle off nadir in rad, from `distance` m away."""
    row, col = np.broadcast_arrays(np.asarray(row, float), np.asarray(col, float))
    lat, lon, east, north, up = frame(row, col)
    azimuth, zenith = (np.broadcast_to(angle, row.shape)[:, None] for angle in (azimuth, zenith))
    along = np.sin(azimuth) * east + np.cos(azimuth) * north
    direction = np.sin(zenith) * along - np.cos(zenith) * up
    target = ecef(lat, lon, np.broadcast_to(height, row.shape))
    return Ray(target - np.broadcast_to(distance, row.shape)[:, None] * direction, direction)


def joined(*rays: Ray) -> Ray:
    return Ray(np.concatenate([r.origin for r in rays]), np.concatenate([r.direction for r in rays]))


def mixed_rays() -> Ray:
    """250 rays: over the ridge to the plain, along borders and across corners of tiles, from beside, up, from below."""
    rng = np.random.default_rng(11)
    over_ridge = rays_to(
        rng.uniform(5, 195, 80), rng.uniform(20, 120, 80), rng.uniform(0.0, 600.0, 80), rng.uniform(1.2, 1.9, 80),
        np.radians(rng.uniform(60, 85, 80)), rng.uniform(3e3, 1.5e4, 80),
    )  # fmt: skip
    lines = 20.0 * rng.integers(1, 9, 40)
    along = rays_to(lines[:20], rng.uniform(30, 170, 20), 150.0, 0.5 * np.pi, np.radians(80.0), 6000.0)
    corners = rays_to(lines[20:], 20.0 * rng.integers(2, 9, 20), 150.0, 0.25 * np.pi, np.radians(75.0), 5000.0)
    anywhere = rays_to(
        rng.uniform(-20, 220, 100), rng.uniform(-20, 220, 100), rng.uniform(-300, 1500, 100),
        rng.uniform(0, 6.3, 100), np.radians(rng.uniform(0, 95, 100)), rng.uniform(50.0, 3e4, 100),
    )  # fmt: skip
    upward = rays_to(
        rng.uniform(0, 200, 20), rng.uniform(0, 200, 20), rng.uniform(300, 1300, 20), rng.uniform(0, 6.3, 20),
        np.radians(rng.uniform(90, 120, 20)), rng.uniform(50.0, 3e3, 20),
    )  # fmt: skip
    under = rays_to(rng.uniform(20, 180, 10), -3.0, -50.0, 0.5 * np.pi, np.radians(85.0), 1000.0)
    return joined(over_ridge, along, corners, anywhere, upward, under)


def first_crossing(posts: np.ndarray, rays: Ray, end: float = 12_000.0, step: float = 4.0) -> np.ndarray:
    """Ranges in m and the smallest clearance in m before: a march in NumPy over the array, independent of jaxgeo."""
    found = []
    for origin, direction in zip(rays.origin, rays.direction, strict=True):

        def clearance(s: np.ndarray, origin=origin, direction=direction) -> np.ndarray:
            normal, height = normal_and_height(origin + s[:, None] * direction)
            lat, lon = np.arctan2(normal[:, 2], np.hypot(normal[:, 0], normal[:, 1])), np.arctan2(*normal[:, 1::-1].T)
            row, col = (NORTH - np.degrees(lat)) / STEP, (np.degrees(lon) - WEST) / STEP
            inside = (row >= 0) & (row <= SIZE - 1) & (col >= 0) & (col <= SIZE - 1)
            i, j = (np.clip(np.floor(v), 0, SIZE - 2).astype(int) for v in (row, col))
            u, v, z = row - i, col - j, posts
            low = z[i, j] * (1 - v) + z[i, j + 1] * v
            high = z[i + 1, j] * (1 - v) + z[i + 1, j + 1] * v
            return np.where(inside, height - low * (1 - u) - high * u, np.inf)

        s = np.arange(0.0, end, step)
        value = clearance(s)
        crossed = np.flatnonzero((value[:-1] > 0.0) & (value[1:] <= 0.0))
        if not crossed.size:
            found.append((np.nan, value.min()))
            continue
        k = crossed[0]
        low, high = s[k], s[k + 1]
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if clearance(np.array([middle]))[0] > 0.0 else (low, middle)
        found.append((high, value[: max(k - 3, 1)].min()))
    return np.array(found)


def answers(rays: Ray, dem: Dem) -> Fix:
    """Fixes over one terrain in memory, by the program that `intersect_files` uses too."""
    fix = _hits(padded_rays(rays), dem)
    return jax.tree.map(lambda x: np.asarray(x)[: len(rays.origin)], fix)


def whole(path: pathlib.Path, **options) -> Dem:
    """A file as one terrain, padded to the size of the windows, so that nothing new is compiled."""
    return read_dem(path, vertical_datum="ellipsoid", bounds=(-180, -90, 180, 90), **options)


def same(found: Fix, expected: Fix) -> None:
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_allclose(found.slant_range, expected.slant_range, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.ecef, expected.ecef, rtol=0, atol=1e-7)
