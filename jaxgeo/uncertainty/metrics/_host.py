"""Radii of known covariances in NumPy, without a program to compile: the integrals of `_ball`, by principal axes.

Agrees with `_radius` to about 1e-12 of the radius (1e-10 for a sphere), and takes no more time on a CPU.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import scipy  # submodules load lazily, when first used

from jaxgeo._compile import is_direct
from jaxgeo.uncertainty.metrics._ball import FAR, FARTHEST, MID_NODES, OUTER_NODES
from jaxgeo.uncertainty.metrics._radius import CLOSE, HIGHEST, MOST_STEPS, ROUNDING

MOST = 1024  # radii; more that a caller asks for are computed by a program
AT_ONCE = {1: 4096, 2: 512, 3: 8}  # radii: their quadratures fit a core's cache
AROUND, STEP_MOST = 4096, 6.0  # points of a circle, and of them at least in the least standard deviation


def host_radii(cov: Any, probability: Any, mean: Any, most: float = MOST) -> np.ndarray | None:
    """Radii about the origin that contain N(mean, cov) with a probability; leading axes broadcast.

    NaN for an invalid covariance or probability. None if the arguments are traced, for more than `most` radii, and for
    a mean so far away that the integral needs other axes.
    """
    if not is_direct():
        return None
    cov, probability, mean = (np.asarray(x, np.float64) for x in (cov, probability, mean))
    d = mean.shape[-1]
    batch = np.broadcast_shapes(cov.shape[:-2], probability.shape, mean.shape[:-1])
    if math.prod(batch) > most:
        return None
    given = (cov, (d, d)), (probability, ()), (mean, (d,))
    whole = [np.broadcast_to(x, (*batch, *own)).reshape(-1, *own) for x, own in given]
    radii = np.zeros(math.prod(batch))
    for first in range(0, len(radii), AT_ONCE[d]):
        part = slice(first, first + AT_ONCE[d])
        found = _radii(*(x[part] for x in whole))
        if found is None:
            return None
        radii[part] = found
    return radii.reshape(batch)


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


def _radii(cov: np.ndarray, probability: np.ndarray, mean: np.ndarray) -> np.ndarray | None:
    """Radii in m of items (leading axis); None if a mean is far away."""
    is_valid = (probability > 0.0) & (probability <= HIGHEST)
    is_valid &= np.all(np.isfinite(cov), axis=(1, 2)) & np.all(np.isfinite(mean), axis=1)
    cov, mean = np.where(is_valid[:, None, None], cov, 0.0), np.where(is_valid[:, None], mean, 0.0)
    close = ROUNDING * np.max(np.abs(cov), axis=(1, 2))
    variances, axes = np.linalg.eigh(cov)
    is_even = np.all(np.abs(cov - np.swapaxes(cov, 1, 2)) <= close[:, None, None], axis=(1, 2))
    is_valid &= is_even & (variances[:, 0] >= -close)
    size = np.sqrt(np.maximum(np.trace(cov, axis1=1, axis2=2), 0.0))
    index = np.flatnonzero(is_valid & (size > 0.0))
    scale = size[index, None]
    sigma = np.sqrt(np.maximum(variances[index, ::-1], 0.0)) / scale
    along = np.sum(axes[index] * mean[index, :, None], axis=1)[:, ::-1] / scale
    if np.any(np.linalg.norm(along, axis=1) * sigma[:, -1] > FAR * sigma[:, 0] ** 2):
        return None
    radii = np.where(is_valid, np.linalg.norm(mean, axis=1), np.nan)
    radii[index] = size[index] * _unit_radii(sigma, along, probability[index])
    return radii


def _unit_radii(sigma: np.ndarray, mean: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Radii for variances of sum 1, by secants between bounds (see `_radius._bounds`), in logarithms."""
    count, d = mean.shape
    goal, tail = _log_odds(probability), -np.log1p(-probability)
    farthest = np.linalg.norm(mean, axis=1) + np.sqrt(d + 2.0 * np.sqrt(d * tail) + 2.0 * tail)
    low, high = np.log(0.45 * math.sqrt(2.0 * math.pi / d) * probability), np.log(farthest)
    rounding = 1e-16 / (probability * (1.0 - probability))

    def excess(x: np.ndarray, items: np.ndarray) -> np.ndarray:
        return _log_odds(_in_ball(np.exp(x), mean[items], sigma[items])) - goal[items]

    radii, left = np.empty(count), np.arange(count)
    x = np.clip(np.log(_guess(sigma, mean, probability)), low, high)
    value, slope = excess(x, left), np.full(count, float(d))
    for number in range(MOST_STEPS):
        low, high = np.where(value < 0.0, x, low), np.where(value < 0.0, high, x)
        is_far = (np.abs(value) > 1.0) & (number % 2 == 1)  # a thin covariance beside the origin: slopes say little
        is_sloped = ~is_far & (slope > 0.0)
        following = x - value / np.where(is_sloped, slope, 1.0)
        is_good = is_sloped & (following >= low - CLOSE) & (following <= high + CLOSE)
        following = np.where(is_good, following, 0.5 * (low + high))
        goes_on = (np.abs(following - x) > CLOSE) & (np.abs(value) > rounding[left])
        radii[left[~goes_on]] = x[~goes_on]
        left = left[goes_on]
        if not left.size:
            break
        before, here, x = value[goes_on], x[goes_on], following[goes_on]
        low, high = low[goes_on], high[goes_on]
        value = excess(x, left)
        slope = (value - before) / (x - here)
    else:
        radii[left] = x
    return np.exp(radii)


def _guess(sigma: np.ndarray, mean: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """As `_radius._guess`."""
    first = 1.0 + np.sum(mean**2, axis=1)
    share = (2.0 * np.sum(sigma**4, axis=1) + 4.0 * np.sum((mean * sigma) ** 2, axis=1)) / (9.0 * first**2)
    root = np.maximum(1.0 - share + scipy.special.ndtri(probability) * np.sqrt(share), 1e-3)
    return np.sqrt(first * root**3)


def _log_odds(p: np.ndarray) -> np.ndarray:
    return np.log(np.maximum(p, 1e-300)) - np.log(np.maximum(1.0 - p, 1e-17))


def _in_ball(radius: np.ndarray, mean: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Probability of balls about the origin, of items (leading axis of all); outer axes by quadrature over chords, the
    first in closed form."""
    over = (slice(None), *[None] * (radius.ndim - 1))
    middle, spread = mean[:, -1][over], sigma[:, -1][over]
    if mean.shape[1] == 1:
        scale, side = spread * math.sqrt(2.0), np.where(middle < 0.0, -1.0, 1.0)
        near, far = ((side * middle + to_end) / scale for to_end in (-radius, radius))
        return 0.5 * (scipy.special.erfc(near) - scipy.special.erfc(far))
    angle, share = _rule(mean.shape[1] - 1)
    chord, weight = _chords(radius[..., None], middle[..., None], spread[..., None], angle)
    return np.sum(share * weight * _in_ball(chord, mean[:, :-1], sigma[:, :-1]), axis=-1)


@functools.cache
def _rule(inner: int) -> tuple[np.ndarray, Any]:
    """Angles of the chords that leave `inner` axes, and their weights."""
    if inner == 1:
        return np.pi * (np.arange(MID_NODES) + 0.5) / MID_NODES, np.pi / MID_NODES
    nodes, weights = np.polynomial.legendre.leggauss(OUTER_NODES)
    return 0.5 * np.pi * (nodes + 1.0), 0.5 * np.pi * weights


def _chords(
    radius: np.ndarray, mean: np.ndarray, sigma: np.ndarray, angle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The last two of `_ball._chords`."""
    low, to_low = _end(radius + mean, sigma)
    high, to_high = _end(radius - mean, sigma)
    width = np.maximum(high + low, 0.0)
    below_high, above_low = width * np.sin(angle / 2.0) ** 2, width * np.cos(angle / 2.0) ** 2
    u = high - below_high
    chord = np.sqrt(np.maximum((to_high + sigma * below_high) * (to_low + sigma * above_low), 0.0))
    return chord, np.exp(-0.5 * u**2) / math.sqrt(2.0 * math.pi) * width / 2.0 * np.sin(angle)


def _end(room: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `_ball._end`."""
    all_fits, is_wide = room > FARTHEST * sigma, sigma > 0.0
    fits = np.clip(room / np.where(is_wide, sigma, 1.0), -FARTHEST, FARTHEST)
    fits = np.where(is_wide, fits, np.where(all_fits, FARTHEST, -FARTHEST))
    return fits, np.where(all_fits, room - FARTHEST * sigma, 0.0)
