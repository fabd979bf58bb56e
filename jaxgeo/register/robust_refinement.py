"""Least-squares matching that leaves out what moves or changes within a block, such as the edges of shadows."""

from __future__ import annotations

from typing import TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Flag, Index, Scalar
from jaxgeo.register.refinement import (
    FURTHEST,
    Blocks,
    Cells,
    KnownWider,
    Refined,
    Smooth,
    Wider,
    all_known,
    inverse,
    is_found,
    means,
    offsets,
    one_or_more,
    over_channels,
    rows_of,
    smooth,
    spread,
    spread_of_channels,
)

STEPS = 24
CLOSE_ENOUGH = 1e-3  # cells: longest last step
ASIDE = 0.7  # cells: distance of other starts along rows and columns
CUT = 3.5  # robust standard deviations: cells near larger residuals (RMS of 3 x 3 cells) have no weight
NEAR = 5  # cells: side of the square of cells that are near one
LEAST_SHARE = 0.3  # of the known cells: fewer with any weight do not decide on a shift
LARGEST_STRAIN = 0.5  # cells at the rim of a block: standard deviation of its deformation
LEAST_SCALE = 1e-3  # standard deviations of the grey values: lower bound of that of the residuals
MEDIAN = 0.6745  # of the absolute value of a normal number
UNEVEN = 1.25  # see `spread_of_channels`: less than by least squares, as cells of large residuals have no weight

_State: TypeAlias = tuple[Float[Array, "2"], Cells, Scalar, Index]  # the shift, weights, last step, steps


def refine_robustly(T: Wider, known_T: KnownWider, S: Wider, known_S: KnownWider, start: Float[Array, "2"]) -> Refined:
    """The shift d with T(p) = gain S(p + d + A p) + offset for most cells p of a block, p from its centre.

    T and S are grey values, or several channels with one gain and an offset each.

    The small deformation A, of first order, is what orientations and planes of the ground that err leave between two
    patches; left in, it draws the shift to where the block has most texture.

    Cells near residuals that exceed those of most cells have less weight, or none (Tukey's biweight of the mean square
    of neighbouring residuals). An area that is lit in one image and in shadow in the other then has no influence on the
    shift of the texture under it, whereas by least squares the edge of the shadow draws all blocks on it the same way.
    Of `start` and eight places around it, the one with the least median residual is the first (Rousseeuw 1984). Not
    found if fewer than `LEAST_SHARE` of the cells have weight.
    """
    known = all_known(known_T) & all_known(known_S)
    mask = known.astype(float)
    S, T = one_or_more(S, known_S), one_or_more(T, known_T)
    fixed = smooth(T, jnp.zeros(2))

    def goes_on(state: _State) -> Flag:
        _, _, last, steps = state
        return (last > CLOSE_ENOUGH) & (steps < STEPS)

    def step(state: _State) -> _State:
        d, weight, _, steps = state
        change, _, residual, _ = _solved(fixed, smooth(S, d), weight, mask)
        new = jnp.clip(d + jnp.clip(change, -0.5, 0.5), -FURTHEST, FURTHEST)
        return new, _weights(residual, mask), jnp.max(jnp.abs(new - d)), steps + 1

    steps = ASIDE * jnp.stack(jnp.meshgrid(*2 * [jnp.array([0.0, -1.0, 1.0])], indexing="ij"), axis=-1).reshape(-1, 2)
    starts = jnp.clip(start[None] + steps, -FURTHEST, FURTHEST)
    scales = jax.lax.map(lambda d: _scale(_solved(fixed, smooth(S, d), mask, mask)[2], mask), starts)
    start = starts[jnp.argmin(scales)]
    first = _weights(_solved(fixed, smooth(S, start), mask, mask)[2], mask)
    d, weight, last, _ = jax.lax.while_loop(goes_on, step, (start, first, jnp.asarray(jnp.inf), jnp.asarray(0)))
    moved, count = smooth(S, d), jnp.sum(weight)
    _, by_residual, residual, inverted = _solved(fixed, moved, weight, mask)
    if S.ndim == 2:
        root = jnp.sqrt(weight)
        by_residual = by_residual / jnp.where(root > 0.0, root, 1.0).reshape(1, -1)
        covariance = spread(by_residual, root * residual, count)
    else:
        covariance = spread_of_channels(inverted, fixed, moved, weight, UNEVEN)
    enough = jnp.sum(weight > 0.0) >= LEAST_SHARE * jnp.sum(mask)
    return Refined(d, covariance, enough & is_found(d, last, CLOSE_ENOUGH, covariance, count))


@batch_filter_jit
def refine_all_robustly(
    T: Float[Array, "n *channels wide_rows wide_cols"],
    known_T: Bool[Array, "n wide_rows wide_cols"],
    S: Float[Array, "n *channels wide_rows wide_cols"],
    known_S: Bool[Array, "n wide_rows wide_cols"],
    start: Float[Array, "n 2"],
) -> Refined:
    """`refine_robustly` of several candidates, sequentially."""
    return jax.lax.map(lambda one: refine_robustly(*one), (T, known_T, S, known_S, start))


def _scale(residual: Blocks, mask: Cells) -> Scalar:
    """Standard deviation of most residuals."""
    some = jnp.where(over_channels(mask, residual) > 0.0, jnp.abs(residual), jnp.nan)[
        ..., ::2, ::2
    ]  # neighbours are smoothed alike
    return jnp.maximum(jnp.nan_to_num(jnp.nanmedian(some), nan=jnp.inf) / MEDIAN, LEAST_SCALE)


def _weights(residual: Blocks, mask: Cells) -> Cells:
    square = residual**2 if residual.ndim == 2 else jnp.mean(residual**2, axis=0)
    squares = jax.lax.reduce_window(mask * square, 0.0, jax.lax.add, (3, 3), (1, 1), "SAME") / 9.0
    near = jax.lax.reduce_window(squares, 0.0, jax.lax.max, (NEAR, NEAR), (1, 1), "SAME")
    return mask * jnp.maximum(1.0 - near / (CUT * _scale(residual, mask)) ** 2, 0.0) ** 2


def _solved(
    fixed: Smooth, moved: Smooth, weight: Cells, mask: Cells
) -> tuple[Float[Array, "2"], Float[Array, "2 values"], Blocks, Float[Array, "2 2"]]:
    """(change of the shift, its derivatives by the residuals, residuals with the optimal deformation and gain, inverse
    of the shift's normal matrix)."""
    count, by_cell = jnp.maximum(jnp.sum(weight), 1e-6), over_channels(weight, fixed.value)
    mean_T, mean_S = (means(by_cell * x, count) for x in (fixed.value, moved.value))
    centred_T, centred_S = fixed.value - mean_T, moved.value - mean_S
    power = jnp.sum(by_cell * centred_S**2)
    gain = jnp.sum(by_cell * centred_T * centred_S) / jnp.where(power > 0.0, power, 1.0)
    rows, cols = jnp.meshgrid(*(jnp.linspace(-1.0, 1.0, side) for side in weight.shape), indexing="ij")
    places = [over_channels(place, fixed.value) for place in (rows, cols)]
    of_channels = offsets(jnp.ones_like(weight), like=centred_S)

    def columns(seen: Smooth, times: Scalar | float) -> Float[Array, "unknowns values"]:
        slopes = [times * seen.down, times * seen.across]
        strained = [slope * place for slope in slopes for place in places]
        return rows_of(*slopes, *strained, centred_S, *of_channels)

    X, residual = columns(moved, gain), centred_T - gain * centred_S
    Z = columns(fixed, 1.0) * jnp.broadcast_to(by_cell, centred_S.shape).reshape(1, -1)
    prior = (_scale(residual, mask) / LARGEST_STRAIN) ** 2
    inverted = inverse(Z @ X.T + jnp.diag(jnp.zeros(len(X)).at[2:6].set(prior)))
    by_residual = inverted @ Z
    found = by_residual @ residual.reshape(-1)
    residual = residual - (found[2:6] @ X[2:6]).reshape(residual.shape)
    return found[:2], by_residual[:2], residual, inverted[:2, :2]
