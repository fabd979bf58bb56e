"""Last step of matching: least squares by most cells of a patch, without those that changed between two images."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxgeo.register.refinement import TAPS
from jaxgeo.register.robust_refinement import refine_all_robustly
from jaxgeo.ties.patches import Patches

BATCH = 8  # points per call: one size, so that other counts need no compilation
# Of the distance between the shifts by all cells and by most: what changed has at most that much influence left, as
# measured on moving shadows (benchmarks/tie_scenes.py).
LEFT = 0.15
AWAY = 1.5  # cells: shifts by all cells and by most that lie further apart are of different places


def sharpened(
    here: Patches, there: Patches, shift: np.ndarray, points: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(shifts (m, 2) in cells, covariances (m, 2, 2) in cells2, whether they converged) of some `points` (m,).

    `shift` (n, 2) are those by least squares over all cells. What changes between two images in the same way
    everywhere, as shadows do, shifts these alike, so that neither residuals of an adjustment nor agreement of a pair
    show it. See `refine_robustly`.
    """
    if not len(points):
        return np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0, bool)
    side = size + 2 * TAPS
    start = shift[points]
    moved = np.rint(start)
    parts = (here.of(points).cut(np.zeros_like(moved), side), there.of(points).cut(moved, side))
    found = [np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0, bool)]
    for first in range(0, len(points), BATCH):
        rows = np.minimum(np.arange(first, first + BATCH), len(points) - 1)
        T, S = (_windows(one.of(rows)) for one in parts)
        done = refine_all_robustly(*T, *S, jnp.asarray((start - moved)[rows]))
        new = (np.asarray(x)[: len(points) - first] for x in (done.shift, done.covariance, done.found))
        found = [np.concatenate(pair) for pair in zip(found, new, strict=True)]
    by_most, covariance, converged = found[0] + moved, found[1], found[2]
    change = by_most - start
    covariance = covariance + LEFT**2 * change[:, :, None] * change[:, None, :]
    return by_most, covariance, converged & (np.linalg.norm(change, axis=1) < AWAY)


def _windows(patches: Patches) -> tuple[Any, Any]:
    """Values (n, ..., rows, cols) and known cells (n, rows, cols)."""
    grey, known = patches.apart()
    return jnp.asarray(np.moveaxis(grey, -3, 0).astype(float)), jnp.asarray(known)
