"""Shifts of blocks of which a part changed between two images."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from jaxgeo.register.refinement import TAPS, refine_all
from jaxgeo.register.robust_refinement import refine_all_robustly

pytestmark = pytest.mark.costly

SIDE = 32 + 2 * TAPS
BLOCKS = 8
SHIFT = np.array([0.3, -0.2])
MOVED = 1.5  # cells: of the shadow, in both directions


def blocks(noise: float, shadow: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Blocks of a random texture, and the same moved by `SHIFT` under a dark stripe that moved by `MOVED`."""
    rng = np.random.default_rng(1)
    first, second = [], []
    rows, cols = np.indices((3 * SIDE, 3 * SIDE)).astype(float)
    for _ in range(BLOCKS):
        world = scipy.ndimage.gaussian_filter(rng.normal(size=rows.shape), 1.5)
        world = 100.0 + 30.0 * world / np.std(world)
        moved = scipy.ndimage.map_coordinates(world, [rows - SHIFT[0], cols - SHIFT[1]], order=5, mode="nearest")
        away = 0.8 * (rows + cols) - rng.uniform(2.3, 2.5) * SIDE
        pair = []
        for values, offset in ((world, 0.0), (moved, 1.6 * MOVED)):
            dark = 1.0 - shadow * (np.abs(away - offset) < 8.0)
            seen = (values * dark)[SIDE : 2 * SIDE, SIDE : 2 * SIDE]
            pair.append(seen + noise * rng.normal(size=seen.shape))
        first.append(pair[0])
        second.append(pair[1])
    return first, second


def found(refinement, noise: float, shadow: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 2) of the shifts, and their covariances (n, 2, 2)."""
    T, S = (jnp.asarray(np.stack(one)) for one in blocks(noise, shadow))
    known = jnp.ones(T.shape, bool)
    done = refinement(T, known, S, known, jnp.asarray(np.tile(SHIFT + 0.1, (BLOCKS, 1))))
    assert np.all(np.asarray(done.found))
    return np.asarray(done.shift) - SHIFT, np.asarray(done.covariance)


def test_a_moving_shadow_moves_no_shift() -> None:
    """By least squares it draws all blocks on it along, by more than ten times what is left here."""
    by_all, by_most = (found(one, 2.0, 0.4)[0].mean(axis=0) for one in (refine_all, refine_all_robustly))
    assert np.linalg.norm(by_most) < 0.1 * np.linalg.norm(by_all)


def test_errors_are_as_predicted_where_nothing_changed() -> None:
    errors, covariance = found(refine_all_robustly, 6.0, 0.0)
    squared = np.einsum("na,nab,nb->n", errors, np.linalg.inv(covariance), errors)
    low, high = scipy.stats.chi2.ppf([1e-4, 1.0 - 1e-4], 2 * BLOCKS)
    assert low < np.sum(squared) < high
