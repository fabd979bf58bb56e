"""Masked normalised cross-correlation at all whole shifts, by FFT."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import scipy  # submodules load lazily
from jaxtyping import Array, Bool, Complex, Float

from jaxgeo._typing import Scalar

EVEN = 1e-4  # of the variance of the whole: blocks or windows that vary less where both are known have no texture

Block = Float[Array, "*channels rows cols"]
Known = Bool[Array, "rows cols"]
Window = Float[Array, "*channels more_rows more_cols"]
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
    """Normalised correlation at every whole shift, over the cells known in both, of grey values or of several channels.

    That of channels is the sum of their covariances by the root of the product of the sums of their variances.

    `least_overlap` is the share of the block's known cells that must be known in the window too. Uses six FFT
    correlations, as in Padfield (2012), "Masked object registration in the Fourier domain". Means are subtracted first;
    values of unknown cells have no influence. The score is undefined where the variance of either over the common cells
    is under 1e-4 of that of the whole. `area` is the sum of the products of the two autocorrelations, `chance` the
    square root of `area` over the number of common cells: Bartlett's (1935) formula for the correlation of two
    independent stationary series. For channels, the sum runs over the products of all pairs of them.
    """
    block, window = channels(block), channels(window)
    shape = tuple(scipy.fft.next_fast_len(int(side), real=True) for side in known_window.shape)
    down, across = (large - small + 1 for large, small in zip(known_window.shape, known.shape, strict=True))
    T, S = standardised(block, known), standardised(window, known_window)
    parts_T = [jnp.fft.rfft2(x, shape) for x in (known[None].astype(float), T, T**2)]
    parts_S = [jnp.fft.rfft2(x, shape) for x in (known_window[None].astype(float), S, S**2)]

    def summed(of_T: int, of_S: int) -> Float[Array, "channels shifts_down shifts_across"]:
        return jnp.fft.irfft2(jnp.conj(parts_T[of_T]) * parts_S[of_S], shape)[:, :down, :across]

    cells = jnp.round(summed(0, 0))[0]
    count, n = jnp.maximum(cells, 1.0), jnp.sum(known)
    mean_T, mean_S = summed(1, 0) / count[None], summed(0, 1) / count[None]
    var_T = jnp.sum(summed(2, 0) / count[None] - mean_T**2, axis=0)
    var_S = jnp.sum(summed(0, 2) / count[None] - mean_S**2, axis=0)
    both = jnp.sum(summed(1, 1) / count[None] - mean_T * mean_S, axis=0)
    overlaps = (cells >= least_overlap * n) & (cells >= 2.0)
    varies = overlaps & (var_T > EVEN) & (var_S > EVEN)
    product = jnp.where(varies, var_T * var_S, 1.0)
    score = jnp.clip(both / jnp.sqrt(product), -1.0, 1.0)
    common = jnp.sum(jnp.where(overlaps, cells, 0.0)) / jnp.maximum(jnp.sum(overlaps), 1)
    area = _likeness(parts_T[1], parts_S[1], shape[1])
    return Surface(jnp.where(varies, score, jnp.nan), overlaps, jnp.sqrt(area / jnp.maximum(common, 1.0)), area)


def channels(values: Window) -> Float[Array, "channels more_rows more_cols"]:
    """`values` (rows, cols) or (channels, rows, cols) as the latter."""
    return values.reshape(-1, *values.shape[-2:])


def standardised(
    values: Float[Array, "channels more_rows more_cols"], known: KnownWindow
) -> Float[Array, "channels more_rows more_cols"]:
    """Channels less their means, divided by the standard deviation of all; zero where unknown or constant."""
    count = jnp.maximum(jnp.sum(known), 1)
    values = jnp.where(known[None], values, 0.0)
    values = jnp.where(known[None], values - jnp.sum(values, axis=(1, 2), keepdims=True) / count, 0.0)
    deviation = jnp.sqrt(jnp.sum(values**2) / count)
    return values / jnp.where(deviation > 0.0, deviation, 1.0)


def _likeness(T: Complex[Array, "channels f g"], S: Complex[Array, "channels f g"], columns: int) -> Scalar:
    """Sum over all lags of the product of two autocorrelations, from half spectra (Parseval)."""
    rows, last = T.shape[1], T.shape[2] - 1
    is_single = (jnp.arange(last + 1) == 0) | ((jnp.arange(last + 1) == last) & (columns % 2 == 0))
    twice = jnp.where(is_single, 1.0, 2.0)[None, :]
    power_T, power_S = (jnp.sum(twice[None] * jnp.abs(x) ** 2) for x in (T, S))
    both = jnp.sum(twice * jnp.abs(jnp.sum(jnp.conj(T) * S, axis=0)) ** 2)
    frequencies = rows * columns
    return jnp.where(both > 0.0, frequencies * both / jnp.where(both > 0.0, power_T * power_S, 1.0), 1.0)


correlations = jax.jit(jax.vmap(correlation, in_axes=(0, 0, 0, 0, None)))
