"""Spatial correlation test of tie residuals (Moran's I)."""

from __future__ import annotations

import numpy as np
import scipy  # submodules load lazily
from jaxtyping import Float

NEIGHBOURS = 4
FEWEST = 12  # ties: with fewer the test is undefined
LARGEST = 3.0  # standard deviations at which residuals are clipped


def morans_i_zscore(residuals: Float[np.ndarray, "n 2"], places: Float[np.ndarray, "n 2"]) -> float:
    """Moran's I of standardised residuals against their nearest neighbours, as a z-score.

    Moran (1950), "Notes on continuous stochastic phenomena": I of both components together, with its mean and variance
    for independent normal values after Cliff and Ord (1981), "Spatial processes". NaN for fewer than `FEWEST` ties.
    """
    count = len(residuals)
    if count < FEWEST:
        return float("nan")
    nearest = scipy.spatial.KDTree(places).query(places, NEIGHBOURS + 1)[1][:, 1:]
    weights = np.zeros((count, count))
    weights[np.arange(count)[:, None], nearest] = 1.0
    np.fill_diagonal(weights, 0.0)  # for coincident positions
    values = np.clip(residuals, -LARGEST, LARGEST)
    values = values - values.mean(axis=0)
    total = weights.sum()
    squared = np.maximum(np.sum(values**2, axis=0), 1e-300)
    likeness = float(np.mean(count / total * np.einsum("ik,ij,jk->k", values, weights, values) / squared))
    both = 0.5 * np.sum((weights + weights.T) ** 2)
    sums = np.sum((weights.sum(axis=0) + weights.sum(axis=1)) ** 2)
    mean = -1.0 / (count - 1)
    variance = (count**2 * both - count * sums + 3.0 * total**2) / ((count**2 - 1.0) * total**2) - mean**2
    return float((likeness - mean) / np.sqrt(0.5 * variance))
