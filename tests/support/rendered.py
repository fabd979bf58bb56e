"""Synthetic maps for rendering, and degradations of rendered images."""

from __future__ import annotations

import numpy as np
import scipy

from jaxgeo import Dem, Geodetic
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.studies.gu2017.scene import heights_on
from jaxgeo.terrain import TangentGrid
from support.fractal import fractal_posts


def noisy(image: np.ndarray, rng: np.random.Generator, sigma: float) -> np.ndarray:
    """The image with white noise of a standard deviation `sigma` times its own."""
    return image + sigma * np.std(image) * rng.normal(size=image.shape)


def blurred(image: np.ndarray, pixels: float) -> np.ndarray:
    """The image smoothed by a Gaussian of `pixels` px."""
    return scipy.ndimage.gaussian_filter(image, (0.0, pixels, pixels))


def shaded(image: np.ndarray, rng: np.random.Generator, depth: float) -> np.ndarray:
    """The image darkened by up to `depth` of the brightness, varying slowly, and by as much again towards the
    corners."""
    rows, cols = image.shape[1:]
    slow = fractal_posts(256, spacing=1.0, relief=1.0, exponent=5.0, seed=int(rng.integers(2**31)))
    slow = scipy.ndimage.zoom(slow, (rows / 256, cols / 256), order=1)
    down, across = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    return image * (1.0 - depth * slow)[None] * (1.0 - 0.5 * depth * (down**2 + across**2))[None]


def clouded(image: np.ndarray, rng: np.random.Generator, share: float) -> np.ndarray:
    """The image with bright, opaque patches over a share of it."""
    rows, cols = image.shape[1:]
    field = fractal_posts(256, spacing=1.0, relief=1.0, exponent=4.0, seed=int(rng.integers(2**31)))
    field = scipy.ndimage.zoom(field, (rows / 256, cols / 256), order=1)
    is_cloud = field >= np.quantile(field, 1.0 - share)
    low, high = np.quantile(image, [0.02, 0.98])
    bright = high + (high - low) * (1.0 + 0.2 * rng.normal(size=(rows, cols)))
    return np.where(is_cloud[None], scipy.ndimage.gaussian_filter(bright, 2.0)[None], image)


def spoilt(image: np.ndarray, seed: int) -> np.ndarray:
    """The image with other illumination, contrast and sharpness, and noise: another day and camera."""
    rng = np.random.default_rng(seed)
    image = blurred(shaded(image, rng, 0.35), 0.8)
    return noisy(0.7 * image + 0.2 * np.mean(image), rng, 0.1)


def textured(terrain: Dem, centre: Geodetic, shape: tuple[int, int], cell: float, seed: int = 0) -> Orthoimage:
    """A map of a terrain around a position: its shading, and fields and woods unrelated to it."""
    grid = TangentGrid.centred(centre, spacing=(cell, cell), shape=shape)
    down, across = np.gradient(heights_on(terrain, grid, shape), cell)
    sun = np.array([-0.5, 0.6, 0.6])  # east, north, up
    shade = (-across * sun[0] + down * sun[1] + sun[2]) / np.sqrt(1.0 + down**2 + across**2)
    size = max(shape) + max(shape) % 2
    fine = fractal_posts(size, spacing=cell, relief=1.0, exponent=2.2, seed=seed)[: shape[0], : shape[1]]
    plots = np.floor(12.0 * fractal_posts(size, spacing=cell, relief=1.0, exponent=3.4, seed=seed + 1)) * 7.0 % 5.0
    values = shade / np.std(shade) + 1.5 * fine / np.std(fine) + 0.5 * plots[: shape[0], : shape[1]]
    return Orthoimage.of(100.0 + 30.0 * (values - np.mean(values)) / np.std(values), grid)
