"""Errors of measurements beyond their stated standard deviations, from residuals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

MEDIAN = 1.054  # median of the larger of two normal numbers
STEPS = 60  # halvings
FEWEST = 8  # measurements whose median says something
# 2.33 times 1 / (2 f), the standard deviation of the median times the root of their number; f = 0.649 is the density of
# the larger of two normal numbers at its median.
BY_CHANCE = 1.8


def excess_of(residuals: np.ndarray, sigma: np.ndarray, freedom: int) -> float:
    """The standard deviation that, added in quadrature to `sigma`, explains `residuals`; zero if `sigma` does so alone.

    Both have one shape and unit; `freedom` is the redundancy of the adjustment. The squares of the residuals in
    standard deviations then sum up to `freedom` less two, so that 1 / (freedom - 2) of the sum is the mean of the
    posterior of their variance (inverse chi-square): the fewer there are, the larger the result. An added variance, and
    not a factor: errors of lenses and of terrain do not depend on how well a point is measured.
    """
    expected = max(freedom - 2, 1)
    return _root(lambda excess: float(np.sum(residuals**2 / (sigma**2 + excess**2))) - expected, residuals)


def by_median(largest: np.ndarray, sigma: np.ndarray) -> float:
    """As `excess_of`, but robust: by the median of the larger residual of each measurement."""
    return _root(lambda excess: float(np.median(largest / np.hypot(sigma, excess))) - MEDIAN, largest)


def of_few(largest: np.ndarray, sigma: np.ndarray) -> float:
    """As `by_median`, for few measurements: zero unless the median is larger than it is by chance in one of a hundred
    cases, and for fewer than eight."""
    count = len(largest)
    if count < FEWEST or np.median(largest / sigma) <= MEDIAN + BY_CHANCE / np.sqrt(count):
        return 0.0
    return by_median(largest, sigma)


def _root(too_large: Callable[[float], float], residuals: np.ndarray) -> float:
    """Where a falling function is zero, in 0 to what is too much; 0 if it is negative there."""
    if not residuals.size or too_large(0.0) <= 0.0:
        return 0.0
    low, high = 0.0, float(np.max(np.abs(residuals))) * np.sqrt(residuals.size)
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if too_large(middle) > 0.0 else (low, middle)
    return high
