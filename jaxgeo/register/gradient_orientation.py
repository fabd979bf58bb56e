"""Orientation of gradients as two channels, for images of unlike sensors, bands or seasons."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy  # submodules load lazily
from jaxtyping import Bool, Float

MEASURES = ("grey", "orientation")  # what is compared: grey values, or `orientation_channels`
WIDTH = 1.0  # cells: standard deviation of the Gaussian whose derivatives are the gradient
TAPS = 3  # cells on either side of the Gaussian and its derivative
AROUND = 15  # cells: side of the square over which the typical gradient is taken
LEAST = 0.1  # of the gradient of the whole patch: lower bound of the typical one, so that flat areas are not amplified


def orientation_channels(
    image: Any, known: Any
) -> tuple[Float[np.ndarray, "2 *patches rows cols"], Bool[np.ndarray, "*patches rows cols"]]:
    """(two channels of the orientation of the gradient modulo pi, their known cells) of one image or several patches.

    `image` and `known` are (..., rows, cols); each of the patches is taken by itself. The channels are
    w cos(2 theta) and w sin(2 theta): theta is the direction of the gradient g, and twice the angle is equal for
    opposite gradients, so that an edge counts alike whichever side is the brighter one. The weight is
    w = |g|^2 / (|g|^2 + L^2), with the root mean square L of the gradient over the known cells of 15 x 15 around: it
    rises with the gradient and ends at one, so that contrast has little influence. An unlike response of two sensors
    to the same ground, monotonous or not, then changes the channels far less than the grey values.

    The doubled angle is that of Granlund (1978), "In search of a general picture processing operator". Of the channels
    of oriented gradients |g| |cos(theta - theta_k)| of Ye et al. (2019), "Fast and robust matching for multimodal
    remote sensing image registration", it is the first harmonic in theta: most of what depends on the orientation.
    Cells within 3 cells of an unknown one or of the edge are unknown. Raises `ValueError` for shapes that do not fit.
    """
    image, known = np.asarray(image, np.float64), np.asarray(known, bool)
    if image.ndim < 2 or image.shape != known.shape:
        raise ValueError(f"image and known must be (..., rows, cols) and alike; got {image.shape} and {known.shape}.")
    values = np.where(known, image, 0.0)
    bell, slope = _kernels()
    down, across = (_filtered(values, first, second) for first, second in ((slope, bell), (bell, slope)))
    inside = _filtered(known.astype(float), np.ones_like(bell), np.ones_like(bell)) > bell.size**2 - 0.5
    squared = np.where(inside, down**2 + across**2, 0.0)
    total, count = (np.sum(x, axis=(-2, -1), keepdims=True) for x in (squared, inside))
    typical = _mean_around(squared, inside) + LEAST**2 * total / np.maximum(count, 1)
    weight = np.where(inside, 1.0, 0.0) / np.where(inside & (typical > 0.0), squared + typical, 1.0)
    return np.stack([(down**2 - across**2) * weight, 2.0 * down * across * weight]), inside


def check_measure(measure: str) -> None:
    """Raises `ValueError` for another measure."""
    if measure not in MEASURES:
        raise ValueError(f"measure must be one of {', '.join(MEASURES)}; got {measure!r}.")


def _kernels() -> tuple[np.ndarray, np.ndarray]:
    """Gaussian with sum one, and its derivative."""
    steps = np.arange(-TAPS, TAPS + 1)
    bell = np.exp(-0.5 * (steps / WIDTH) ** 2)
    bell /= np.sum(bell)
    slope = steps * bell
    return bell, slope / np.sum(slope * steps)


def _filtered(values: np.ndarray, by_row: np.ndarray, by_col: np.ndarray) -> np.ndarray:
    for weights, axis in ((by_row, -2), (by_col, -1)):
        values = scipy.ndimage.correlate1d(values, weights, axis=axis, mode="constant")
    return values


def _mean_around(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Mean over the known cells of a square around each cell."""
    ones = np.ones(AROUND)
    count = _filtered(inside.astype(float), ones, ones)
    return np.where(inside, _filtered(values, ones, ones) / np.maximum(count, 1.0), 0.0)
