"""Masked normalised cross-correlation at all whole shifts, by FFT."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import scipy  # submodules load lazily
from jaxtyping import Array, Bool, Float

from jaxgeo._typing import Scalar

EVEN = 1e-4  # of the variance of the whole: blocks or windows that vary less where both are known have no texture

Block = Float[Array, "rows cols"]
Known = Bool[Array, "rows cols"]
Window = Float[Array, "more_rows more_cols"]
KnownWindow = Bool[Array, "more_rows more_cols"]


class Surface(NamedTuple):
    """Correlation of a block with a window that is larger by the same number of cells on both sides of each axis.

    Entry [i, j] is for the block's first cell on cell (i, j) of the window. `score` is NaN where it is undefined,
    `overlaps` flags shifts with enough cells known in both. `chance` is the standard deviation of the score of an
    unrelated block and window with the same autocorrelations; `area`, in cells, is the area over which such scores are
    correlated.
    """

    score: Float[Array, "shifts_down shifts_across"]
    overlaps: Bool[Array, "shifts_down shifts_across"]
    chance: Scalar
    area: Scalar


def correlation(
    block: Block, known: Known, window: Window, known_window: KnownWindow, least_overlap: Scalar
) -> Surface:
    """Normalised correlation at every whole shift, over the cells known in both.

    `least_overlap` is the share of the block's known cells that must be known in the window too. Uses six FFT
    correlations, as in Padfield (2012), "Masked object registration in the Fourier domain". Means are subtracted first;
    values of unknown cells have no influence. The score is undefined where the variance of either over the common cells
    is under 1e-4 of that of the whole. `area` is the sum of the products of the two autocorrelations, `chance` the
    square root of `area` over the number of common cells: Bartlett's (1935) formula for the correlation of two
    independent stationary series.
    """
    shape = tuple(scipy.fft.next_fast_len(int(side), real=True) for side in window.shape)
    down, across = (large - small + 1 for large, small in zip(window.shape, block.shape, strict=True))
    T, S = standardised(block, known), standardised(window, known_window)
    parts_T = [jnp.fft.rfft2(x, shape) for x in (known.astype(float), T, T**2)]
    parts_S = [jnp.fft.rfft2(x, shape) for x in (known_window.astype(float), S, S**2)]

    def summed(of_T: int, of_S: int) -> Float[Array, "shifts_down shifts_across"]:
        return jnp.fft.irfft2(jnp.conj(parts_T[of_T]) * parts_S[of_S], shape)[:down, :across]

    cells = jnp.round(summed(0, 0))
    count, n = jnp.maximum(cells, 1.0), jnp.sum(known)
    mean_T, mean_S = summed(1, 0) / count, summed(0, 1) / count
    var_T, var_S = summed(2, 0) / count - mean_T**2, summed(0, 2) / count - mean_S**2
    overlaps = (cells >= least_overlap * n) & (cells >= 2.0)
    varies = overlaps & (var_T > EVEN) & (var_S > EVEN)
    product = jnp.where(varies, var_T * var_S, 1.0)
    score = jnp.clip((summed(1, 1) / count - mean_T * mean_S) / jnp.sqrt(product), -1.0, 1.0)
    common = jnp.sum(jnp.where(overlaps, cells, 0.0)) / jnp.maximum(jnp.sum(overlaps), 1)
    area = _likeness(jnp.abs(parts_T[1]), jnp.abs(parts_S[1]), shape[1])
    return Surface(jnp.where(varies, score, jnp.nan), overlaps, jnp.sqrt(area / jnp.maximum(common, 1.0)), area)


def standardised(values: Window, known: KnownWindow) -> Window:
    """`values` less their mean, divided by their standard deviation; zero where unknown or constant."""
    count = jnp.maximum(jnp.sum(known), 1)
    values = jnp.where(known, values, 0.0)
    values = jnp.where(known, values - jnp.sum(values) / count, 0.0)
    deviation = jnp.sqrt(jnp.sum(values**2) / count)
    return values / jnp.where(deviation > 0.0, deviation, 1.0)


def _likeness(T: Float[Array, "f g"], S: Float[Array, "f g"], columns: int) -> Scalar:
    """Sum over all lags of the product of two autocorrelations, from the moduli of half spectra (Parseval)."""
    last = T.shape[1] - 1
    is_single = (jnp.arange(T.shape[1]) == 0) | ((jnp.arange(T.shape[1]) == last) & (columns % 2 == 0))
    twice = jnp.where(is_single, 1.0, 2.0)[None, :]
    power_T, power_S, both = (jnp.sum(twice * x) for x in (T**2, S**2, (T * S) ** 2))
    frequencies = T.shape[0] * columns
    return jnp.where(both > 0.0, frequencies * both / jnp.where(both > 0.0, power_T * power_S, 1.0), 1.0)


correlations = jax.jit(jax.vmap(correlation, in_axes=(0, 0, 0, 0, None)))
