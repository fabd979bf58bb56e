"""Radii of a few known covariances in NumPy, without a program to compile: the integrals of `_ball`, by principal axes.

Agrees with `_radius` to about 1e-12 of the radius (1e-10 for a sphere).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Any

import numpy as np
import scipy  # submodules load lazily, when first used

from jaxgeo._compile import is_direct
from jaxgeo.uncertainty.metrics._ball import FAR, FARTHEST, MID_NODES, OUTER_NODES
from jaxgeo.uncertainty.metrics._radius import CLOSE, HIGHEST, MOST_STEPS, ROUNDING

MOST = 64  # radii; more are computed by a program
AROUND, STEP_MOST = 4096, 6.0  # points of a circle, and of them at least in the least standard deviation


def host_radii(cov: Any, probability: Any, mean: Any) -> np.ndarray | None:
    """Radii about the origin that contain N(mean, cov) with a probability; leading axes broadcast.

    NaN for an invalid covariance or probability. None if the arguments are traced, for more than `MOST` radii, and for
    a mean so far away that the integral needs other axes.
    """
    if not is_direct():
        return None
    cov, probability, mean = (np.asarray(x, np.float64) for x in (cov, probability, mean))
    d = mean.shape[-1]
    batch = np.broadcast_shapes(cov.shape[:-2], probability.shape, mean.shape[:-1])
    if math.prod(batch) > MOST:
        return None
    items = zip(
        np.broadcast_to(cov, (*batch, d, d)).reshape(-1, d, d),
        np.broadcast_to(probability, batch).reshape(-1),
        np.broadcast_to(mean, (*batch, d)).reshape(-1, d),
        strict=True,
    )
    radii = [_radius(*item) for item in items]
    return None if None in radii else np.array(radii, np.float64).reshape(batch)


def host_slopes(cov: Any, radius: Any, mean: Any) -> np.ndarray | None:
    """Derivative (2, 2) of a circular error `radius` of N(mean, cov) by its covariance.

    The derivative of a normal density by its covariance is half of its second derivatives by place (the heat equation),
    so that, by Gauss's theorem, that of the probability within a circle is an integral around it. Zero for a zero
    covariance. None if the arguments are traced, and where the density varies too quickly along the circle for
    `AROUND` points.
    """
    if not is_direct():
        return None
    cov, mean, radius = np.asarray(cov, np.float64), np.asarray(mean, np.float64), float(radius)
    if not cov.any():
        return np.zeros((2, 2))
    variances = np.linalg.eigvalsh(cov)
    if not (math.isfinite(radius) and variances[0] > (STEP_MOST * radius * 2.0 * math.pi / AROUND) ** 2):
        return None
    turn = np.arange(AROUND) * (2.0 * math.pi / AROUND)
    out = np.stack([np.cos(turn), np.sin(turn)])
    place = radius * out - mean[:, None]
    pull = np.linalg.solve(cov, place)
    square = np.sum(place * pull, axis=0)
    density = np.exp(-0.5 * (square - square.min()))
    slopes = 0.5 * (out * density) @ pull.T / density.sum()
    return 0.5 * (slopes + slopes.T)


def _radius(cov: np.ndarray, probability: float, mean: np.ndarray) -> float | None:
    """One radius in m; None if the mean is far away."""
    if not (0.0 < probability <= HIGHEST and np.all(np.isfinite(cov)) and np.all(np.isfinite(mean))):
        return math.nan
    close = ROUNDING * np.max(np.abs(cov))
    variances, axes = np.linalg.eigh(cov)
    if np.any(np.abs(cov - cov.T) > close) or variances[0] < -close:
        return math.nan
    size = math.sqrt(max(float(np.trace(cov)), 0.0))
    if size == 0.0:
        return float(np.linalg.norm(mean))
    sigma = np.sqrt(np.maximum(variances[::-1], 0.0)) / size
    mean = axes.T[::-1] @ mean / size
    if np.linalg.norm(mean) * sigma[-1] > FAR * sigma[0] ** 2:
        return None
    return size * _unit_radius(sigma, mean, float(probability))


def _unit_radius(sigma: np.ndarray, mean: np.ndarray, probability: float) -> float:
    """Radius for variances of sum 1, by secants between bounds (see `_radius._bounds`), in logarithms."""
    d, goal = len(mean), _log_odds(probability)
    tail = -math.log1p(-probability)
    farthest = float(np.linalg.norm(mean)) + math.sqrt(d + 2.0 * math.sqrt(d * tail) + 2.0 * tail)
    low, high = math.log(0.45 * math.sqrt(2.0 * math.pi / d) * probability), math.log(farthest)

    def excess(x: float) -> float:
        return _log_odds(float(_in_ball(np.asarray(math.exp(x)), list(mean), list(sigma)))) - goal

    x = min(max(math.log(_guess(sigma, mean, probability)), low), high)
    value, slope = excess(x), float(d)
    for number in range(MOST_STEPS):
        low, high = (x, high) if value < 0.0 else (low, x)
        is_far = abs(value) > 1.0 and number % 2 == 1  # a thin covariance beside the origin: slopes say little
        following = math.nan if is_far or not slope > 0.0 else x - value / slope
        if not low - CLOSE <= following <= high + CLOSE:
            following = 0.5 * (low + high)
        step, before = following - x, value
        if abs(step) <= CLOSE or abs(value) <= 1e-16 / (probability * (1.0 - probability)):  # their rounding
            break
        x, value = following, excess(following)
        slope = (value - before) / step
    return math.exp(x)


def _guess(sigma: np.ndarray, mean: np.ndarray, probability: float) -> float:
    """As `_radius._guess`."""
    first = 1.0 + float(mean @ mean)
    share = float(2.0 * np.sum(sigma**4) + 4.0 * np.sum((mean * sigma) ** 2)) / (9.0 * first**2)
    root = max(1.0 - share + NormalDist().inv_cdf(probability) * math.sqrt(share), 1e-3)
    return math.sqrt(first * root**3)


def _log_odds(p: float) -> float:
    return math.log(max(p, 1e-300)) - math.log(max(1.0 - p, 1e-17))


def _in_ball(radius: np.ndarray, mean: Sequence[Any], sigma: Sequence[float]) -> np.ndarray:
    """Probability of a ball about the origin; outer axes by quadrature over chords, the first in closed form."""
    *inner, middle = mean
    if not inner:
        scale, side = sigma[0] * math.sqrt(2.0), np.where(middle < 0.0, -1.0, 1.0)
        near, far = ((side * middle + to_end) / scale for to_end in (-radius, radius))
        return np.asarray(0.5 * (scipy.special.erfc(near) - scipy.special.erfc(far)))
    angle, share = _rule(len(inner))
    chord, weight = _chords(radius[..., None], middle, sigma[-1], angle)
    return np.asarray(np.sum(share * weight * _in_ball(chord, inner, sigma[:-1]), axis=-1))


@functools.cache
def _rule(inner: int) -> tuple[np.ndarray, Any]:
    """Angles of the chords that leave `inner` axes, and their weights."""
    if inner == 1:
        return np.pi * (np.arange(MID_NODES) + 0.5) / MID_NODES, np.pi / MID_NODES
    nodes, weights = np.polynomial.legendre.leggauss(OUTER_NODES)
    return 0.5 * np.pi * (nodes + 1.0), 0.5 * np.pi * weights


def _chords(radius: np.ndarray, mean: float, sigma: float, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The last two of `_ball._chords`."""
    low, to_low = _end(radius + mean, sigma)
    high, to_high = _end(radius - mean, sigma)
    width = np.maximum(high + low, 0.0)
    below_high, above_low = width * np.sin(angle / 2.0) ** 2, width * np.cos(angle / 2.0) ** 2
    u = high - below_high
    chord = np.sqrt(np.maximum((to_high + sigma * below_high) * (to_low + sigma * above_low), 0.0))
    return chord, np.exp(-0.5 * u**2) / math.sqrt(2.0 * math.pi) * width / 2.0 * np.sin(angle)


def _end(room: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """As `_ball._end`."""
    all_fits = room > FARTHEST * sigma
    fits = np.clip(room / sigma, -FARTHEST, FARTHEST) if sigma > 0.0 else np.where(all_fits, FARTHEST, -FARTHEST)
    return fits, np.where(all_fits, room - FARTHEST * sigma, 0.0)
