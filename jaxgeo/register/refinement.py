"""Least-squares matching: subpixel shift of a block, with its covariance."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Flag, Index, Scalar
from jaxgeo.register.correlation import Known, channels, standardised

TAPS = 5  # cells on either side used for smoothing
WIDTH = 1.0  # cells: standard deviation of the Gaussian that smooths both images and interpolates one
FURTHEST = 1.2  # cells from the whole shift, at most
STEPS = 8
CLOSE_ENOUGH = 2e-3  # cells: longest last step
FEWEST = 64  # common cells, at least
# Of channels (see `spread_of_channels`), as measured on simulated pairs with noise, an unlike response and a layer that
# one image does not see (tests/register/test_orientation_matching.py).
UNEVEN = 1.7

Cells = Float[Array, "rows cols"]
Blocks = Float[Array, "*channels rows cols"]
Wider = Float[Array, "*channels wide_rows wide_cols"]
KnownWider = Bool[Array, "wide_rows wide_cols"]
Weights = Float[Array, " taps"]


_State: TypeAlias = tuple[Float[Array, "2"], Scalar, Index]  # the shift, the length of the last step, steps


class Refined(NamedTuple):
    """`shift` (2,) in cells from the whole shift, its `covariance` (2, 2) in cells2, and whether it converged."""

    shift: Float[Array, "*batch 2"]
    covariance: Float[Array, "*batch 2 2"]
    found: Bool[Array, "*batch"]


class Smooth(NamedTuple):
    value: Blocks
    down: Blocks
    across: Blocks


def refine(T: Wider, known_T: KnownWider, S: Wider, known_S: KnownWider, start: Float[Array, "2"]) -> Refined:
    """The shift d with T(p) = gain S(p + d) + offset, for p in a block with a margin of `TAPS` cells on every side.

    T and S are grey values, or several channels with one gain and an offset each.

    Both images are smoothed by a Gaussian of one cell, at whole cells or between them. The smoothed images are nearly
    band-limited, so that interpolation has no bias between cells (cubic interpolation of unsmoothed images attracts
    noisy ones to half cells). The equations are those of least-squares matching (Foerstner 1982), but multiplied with
    the gradients of T instead of those of the interpolated S: the noise of the two is independent and biases neither
    the shift nor the normal matrix. Cells are used if all cells within their smoothing kernel are known.

    The covariance of the estimate uses residuals with their empirical autocorrelation: the product of their power
    spectrum and that of the weights that map residuals to a shift.
    """
    known = all_known(known_T) & all_known(known_S)
    mask = known.astype(float)
    S, T = one_or_more(S, known_S), one_or_more(T, known_T)
    fixed = smooth(T, jnp.zeros(2))

    def goes_on(state: _State) -> Flag:
        _, last, steps = state
        return (last > CLOSE_ENOUGH) & (steps < STEPS)

    def step(state: _State) -> _State:
        d, _, steps = state
        normal, Z, residual = _equations(fixed, smooth(S, d), mask)
        change = (inverse(normal) @ (Z @ residual.reshape(-1)))[:2]
        new = jnp.clip(d + jnp.clip(change, -0.5, 0.5), -FURTHEST, FURTHEST)
        return new, jnp.max(jnp.abs(new - d)), steps + 1

    d, last, _ = jax.lax.while_loop(goes_on, step, (start, jnp.asarray(jnp.inf), jnp.asarray(0)))
    moved, count = smooth(S, d), jnp.sum(mask)
    normal, Z, residual = _equations(fixed, moved, mask)
    if S.ndim == 2:
        covariance = spread(inverse(normal)[:2] @ Z, residual, count)
    else:
        covariance = spread_of_channels(inverse(normal)[:2, :2], fixed, moved, mask, UNEVEN)
    return Refined(d, covariance, is_found(d, last, CLOSE_ENOUGH, covariance, count))


@batch_filter_jit
def refine_all(
    T: Float[Array, "n *channels wide_rows wide_cols"],
    known_T: Bool[Array, "n wide_rows wide_cols"],
    S: Float[Array, "n *channels wide_rows wide_cols"],
    known_S: Bool[Array, "n wide_rows wide_cols"],
    start: Float[Array, "n 2"],
) -> Refined:
    """`refine` of several candidates, sequentially, so that the data of one stays in the processor's cache."""
    return jax.lax.map(lambda one: refine(*one), (T, known_T, S, known_S, start))


def _equations(
    fixed: Smooth, moved: Smooth, mask: Cells
) -> tuple[Float[Array, "unknowns unknowns"], Float[Array, "unknowns values"], Blocks]:
    """(Z'X, Z, residuals) of shift, gain and offsets at a shift, with the optimal gain there."""
    count, weight = jnp.maximum(jnp.sum(mask), 1.0), over_channels(mask, fixed.value)
    mean_T, mean_S = (means(weight * x, count) for x in (fixed.value, moved.value))
    centred_T, centred_S = weight * (fixed.value - mean_T), weight * (moved.value - mean_S)
    power = jnp.sum(centred_S**2)
    gain = jnp.sum(centred_T * centred_S) / jnp.where(power > 0.0, power, 1.0)
    others = [centred_S, *offsets(mask, like=centred_S)]
    Z = rows_of(weight * fixed.down, weight * fixed.across, *others)
    X = rows_of(gain * weight * moved.down, gain * weight * moved.across, *others)
    return Z @ X.T, Z, centred_T - gain * centred_S


def one_or_more(values: Wider, known: KnownWider) -> Float[Array, "*one_or_more wide_rows wide_cols"]:
    """Standardised values, without an axis for a single channel: programs of two axes run in two thirds of the time."""
    several = standardised(channels(values), known)
    return several[0] if len(several) == 1 else several


def over_channels(cells: Cells, values: Blocks) -> Float[Array, "*one rows cols"]:
    """`cells` with an axis for the channels of `values`, if these have one."""
    return cells if values.ndim == 2 else cells[None]


def means(values: Blocks, count: Scalar) -> Float[Array, "*channels 1 1"]:
    """Sums of the channels over a count."""
    return jnp.sum(values, axis=(-2, -1), keepdims=True) / count


def offsets(weight: Cells, like: Blocks) -> list[Blocks]:
    """Derivatives of the values of the channels by an offset of each."""
    if like.ndim == 2:
        return [weight]
    return list(jnp.eye(len(like))[:, :, None, None] * weight[None, None])


def rows_of(*derivatives: Blocks) -> Float[Array, "unknowns values"]:
    """Derivatives of all values by each unknown, a row each."""
    return jnp.stack(derivatives).reshape(len(derivatives), -1)


def is_found(
    d: Float[Array, "2"], last: Scalar, close_enough: float, covariance: Float[Array, "2 2"], count: Scalar
) -> Flag:
    """Whether a refinement has converged near its start, from enough cells."""
    is_number = jnp.all(jnp.isfinite(d)) & jnp.all(jnp.isfinite(covariance))
    return is_number & (last <= close_enough) & jnp.all(jnp.abs(d) < FURTHEST) & (count >= FEWEST)


def spread(weights: Float[Array, "2 values"], residual: Blocks, count: Scalar) -> Float[Array, "2 2"]:
    """Covariance of weights @ residuals, for stationary residuals with their empirical auto- and cross-covariances:
    the mean square of that product over all displacements of the residuals against the weights."""
    rows, cols = residual.shape[-2:]
    R = jnp.fft.fft2(residual.reshape(-1, rows, cols))
    Y = jnp.fft.fft2(weights.reshape(2, *R.shape))
    both = jnp.sum(jnp.conj(Y) * R[None], axis=1).reshape(2, -1) / jnp.sqrt(jnp.maximum(count - 4.0, 1.0))
    return jnp.real(both @ jnp.conj(both).T) / (rows * cols)


def spread_of_channels(
    inverted: Float[Array, "2 2"], fixed: Smooth, moved: Smooth, weight: Cells, uneven: float
) -> Float[Array, "2 2"]:
    """`spread` of a shift between channels that are noisy in both images, as those of orientations are.

    `inverted` is the inverse normal matrix of the shift, with the gain by least squares. That gain is too small by the
    noise of S, and residuals by it keep a part of the signal. Here the gain is the root of the ratio of the powers, and
    the gradient the mean of those of T and S. Where signal and noise have the same spectrum, the variance is then that
    of the shift whichever image has the noise: the products of the noise of T, of the noise of S, and of both.

    `uneven` is the ratio of the variance to that of evenly distributed noise: the noise of orientations is largest
    where they change most, which the residuals of one block do not show.
    """
    count, weight = jnp.maximum(jnp.sum(weight), 1e-6), over_channels(weight, fixed.value)
    root = jnp.sqrt(weight)
    T, S = (root * (x - means(weight * x, count)) for x in (fixed.value, moved.value))
    power_T, power_S, both = jnp.sum(T**2), jnp.sum(S**2), jnp.sum(T * S)
    ratio = power_T / jnp.where(power_S > 0.0, power_S, 1.0)
    gain = jnp.sqrt(jnp.where(ratio > 0.0, ratio, 1.0))
    slopes = (0.5 * root * (t + gain * s) for t, s in ((fixed.down, moved.down), (fixed.across, moved.across)))
    share = both / jnp.where(power_S > 0.0, power_S, 1.0) / gain  # of the gain by least squares in this one
    return uneven * spread(share * inverted @ rows_of(*slopes), T - gain * S, count)


def inverse(normal: Float[Array, "m m"]) -> Float[Array, "m m"]:
    """Inverse by diagonal scaling; NaN if singular."""
    size = jnp.sqrt(jnp.abs(jnp.diagonal(normal)))
    scale = 1.0 / jnp.where(size > 0.0, size, 1.0)
    return jnp.linalg.inv(normal * scale[:, None] * scale[None, :]) * scale[:, None] * scale[None, :]


def smooth(values: Wider, d: Float[Array, "2"]) -> Smooth:
    """Smoothed values and their derivatives (by row, by col) at the block's cells shifted by `d`."""
    (down, slope_down), (across, slope_across) = _gaussian(d[0]), _gaussian(d[1])
    rows = _weighted(values, down, -2)
    return Smooth(
        _weighted(rows, across, -1),
        _weighted(_weighted(values, slope_down, -2), across, -1),
        _weighted(rows, slope_across, -1),
    )


def _gaussian(d: Scalar) -> tuple[Weights, Weights]:
    """Weights of the neighbouring cells, with sum one, and their derivatives by the position."""
    away = d - jnp.arange(-TAPS, TAPS + 1)
    bell = jnp.exp(-0.5 * (away / WIDTH) ** 2)
    total, slope = jnp.sum(bell), -away / WIDTH**2 * bell
    return bell / total, slope / total - bell * jnp.sum(slope) / total**2


def _weighted(values: Float[Array, "*channels r c"], weights: Weights, axis: int) -> Float[Array, "*channels r2 c2"]:
    """Weighted sum over neighbours along one axis, without padding."""
    length = values.shape[axis] - 2 * TAPS
    parts = [jax.lax.slice_in_dim(values, k, k + length, axis=axis) for k in range(2 * TAPS + 1)]
    return sum((weights[k] * part for k, part in enumerate(parts[1:], 1)), weights[0] * parts[0])


def all_known(known: KnownWider) -> Known:
    """Flags of the block's cells whose smoothing kernel is known."""
    ones = jnp.ones(2 * TAPS + 1)
    return _weighted(_weighted(known.astype(float), ones, -2), ones, -1) > ones.size**2 - 0.5
