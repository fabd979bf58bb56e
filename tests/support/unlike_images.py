"""Pairs of images of one scene by unlike sensors: an unlike response, and detail that one of them does not see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxgeo.adjust import ImagePoints
from jaxgeo.ties.views import project_planes
from support.drone_strip import Strip, views_of
from support.misleading_scenes import seen, texture

SIDE = 256  # cells of a pair
SHIFT = np.array([2.3, -1.4])


def spectrum(seed: int) -> np.ndarray:
    """Spectrum of a random texture without an edge, of standard deviation one."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.fftfreq(SIDE)[None, :])
    values = np.fft.fft2(rng.standard_normal((SIDE, SIDE))) / np.maximum(frequency, 1.0 / SIDE)
    values *= np.exp(-0.5 * (2.0 * np.pi * 0.7 * frequency) ** 2)
    values[0, 0] = 0.0
    return values / np.std(np.fft.ifft2(values).real)


def moved(values: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The texture moved by (rows, cols), exactly."""
    row, col = np.fft.fftfreq(SIDE)[:, None], np.fft.fftfreq(SIDE)[None, :]
    return np.fft.ifft2(values * np.exp(-2j * np.pi * (row * shift[0] + col * shift[1]))).real


def same(values: np.ndarray) -> np.ndarray:
    return values


def inverted(values: np.ndarray) -> np.ndarray:
    """Bright is dark."""
    return -values


def folded(values: np.ndarray) -> np.ndarray:
    """Dark to bright below a grey value, bright to dark above it, with a gamma of 0.7."""
    share = (values - values.min()) / np.ptp(values)
    return -(np.abs(share - 0.45) ** 0.7)


def pair(
    seed: int, response: Callable[[np.ndarray], np.ndarray], layer: float, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """An image, and one moved by `SHIFT` as another sensor sees it: with its response, a `layer` of other texture, and
    `noise` in both, in standard deviations of the image."""
    rng, scene = np.random.default_rng(seed + 999), spectrum(seed)
    other = response(moved(scene, SHIFT))
    other = (other - other.mean()) / np.std(other) + layer * moved(spectrum(seed + 5000), np.zeros(2))
    noises = noise * rng.standard_normal((2, SIDE, SIDE))
    return moved(scene, np.zeros(2)) + noises[0], other + noises[1]


def two_sensors(here: Strip, seed: int = 0) -> list[np.ndarray]:
    """Images of a strip by two sensors in turn: the second one's response is folded, and it sees a layer of its own of
    0.3 of the texture."""
    first = texture(100 * seed)
    other = folded(first)
    other = 100.0 + 50.0 * (other - other.mean()) / np.std(other) + 0.3 * (texture(100 * seed + 50) - 100.0)
    return [seen(here, other if k % 2 else first, k)[0] for k in range(len(here.true) - 1)]


def off_true_rays(here: Strip, observed: ImagePoints) -> tuple[np.ndarray, np.ndarray]:
    """(distances (n, 2) in px of measurements from the ground that the first image of a point shows, by the true poses;
    their variances (n, 2) in px2 as stated)."""
    true = views_of(here.names, here.true)
    off, variance = [], []
    level = float(np.asarray(true.frame.from_geodetic(here.true[0].pose.position))[2]) - 150.0
    for point in np.unique(observed.point):
        rows = np.flatnonzero(observed.point == point)
        image = [here.names.index(name) for name in observed.image[rows]]
        uv, sigma = observed.uv[rows], observed.sigma[rows]
        camera = true.cameras["1"]
        ray = np.append((uv[0] - np.asarray(camera.principal_px)) / np.asarray(camera.focal_px), 1.0)
        ray = true.R_frame_from_camera[image[0]] @ ray
        place = true.centre[image[0]] + ray * (level - true.centre[image[0], 2]) / ray[2]
        axes = np.array([[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]])
        for k in range(1, len(rows)):
            pose = true.centre[image[k]], true.R_frame_from_camera[image[k]]
            found = project_planes(camera, *pose, place[None], axes, [1, 1])
            off.append(found.nodes[0, 1, 1] - uv[k])
            variance.append(sigma[0] ** 2 + sigma[k] ** 2)
    return np.array(off), np.array(variance)


def of(here: Strip, images: list[np.ndarray], seed: int = 0, noise: float = 0.05) -> Strip:
    """The strip with noisy images of a scene; the last of the strip is not on it."""
    rng = np.random.default_rng(seed + 7)
    return replace(
        here, images=[*(one + noise * np.std(one) * rng.normal(size=one.shape) for one in images), here.images[-1]]
    )
