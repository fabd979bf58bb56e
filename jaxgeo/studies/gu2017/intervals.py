"""Confidence intervals of a study's shares and means."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy  # submodules load on first use


def share(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a probability from `hits` of `of` trials (Clopper and Pearson 1934); 0 to 1 for no trials."""
    low = scipy.stats.beta.ppf(0.025, hits, of - hits + 1) if hits else 0.0
    high = scipy.stats.beta.ppf(0.975, hits + 1, of - hits) if hits < of else 1.0
    return float(low), float(high)


def mean(values: Sequence[float]) -> tuple[float, float]:
    """(mean, half of its 95 % interval by Student's t); the latter is infinite for a single value."""
    numbers = np.asarray(values, float)
    if len(numbers) < 2:
        return float(np.mean(numbers)), math.inf
    t = float(scipy.stats.t.ppf(0.975, len(numbers) - 1))
    return float(np.mean(numbers)), t * float(np.std(numbers, ddof=1)) / math.sqrt(len(numbers))


def rms(errors: np.ndarray) -> tuple[float, float]:
    """(root mean square, half of its 95 % interval from the spread of the squares)."""
    square, half = mean(list(np.asarray(errors, float) ** 2))
    usual = math.sqrt(square)
    return usual, half / (2.0 * usual) if usual > 0.0 else 0.0
