"""Least-squares matching that leaves out what moves or changes within a block, such as the edges of shadows."""

from __future__ import annotations

from typing import TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Flag, Index, Scalar
from jaxgeo.register.correlation import Block, standardised
from jaxgeo.register.refinement import (
    FURTHEST,
    KnownWider,
    Refined,
    Smooth,
    Wider,
    all_known,
    inverse,
    is_found,
    smooth,
    spread,
)

STEPS = 24
CLOSE_ENOUGH = 1e-3  # cells: longest last step
CUT = 3.0  # robust standard deviations of the residuals: cells that differ by as much have a quarter of the weight
LEAST_SCALE = 1e-3  # standard deviations of the grey values: lower bound of that of the residuals
MEDIAN = 0.6745  # of the absolute value of a normal number

_State: TypeAlias = tuple[Float[Array, "2"], Block, Scalar, Index]  # the shift, weights, last step, steps


def refine_robustly(T: Wider, known_T: KnownWider, S: Wider, known_S: KnownWider, start: Float[Array, "2"]) -> Refined:
    """The shift d with T(p) = gain S(p + d) + offset for most cells p of a block, as `refine` has it for all.

    Cells whose residuals exceed those of the others are weighted down: (1 + (r / (`CUT` s))^2)^-2, after Geman and
    McClure (1987), with s from the median residual. An area that is lit in one image and in shadow in the other then
    has no influence on the shift of the texture under it, whereas by least squares the edge of the shadow draws all
    blocks on it the same way.
    """
    known = all_known(known_T) & all_known(known_S)
    mask = known.astype(float)
    S = standardised(S, known_S)
    fixed = smooth(standardised(T, known_T), jnp.zeros(2))

    def goes_on(state: _State) -> Flag:
        _, _, last, steps = state
        return (last > CLOSE_ENOUGH) & (steps < STEPS)

    def step(state: _State) -> _State:
        d, weight, _, steps = state
        normal, Z, residual = _equations(fixed, smooth(S, d), weight)
        change = (inverse(normal) @ (Z @ residual.reshape(-1)))[:2]
        new = jnp.clip(d + jnp.clip(change, -0.5, 0.5), -FURTHEST, FURTHEST)
        return new, _weights(residual, mask), jnp.max(jnp.abs(new - d)), steps + 1

    first = _weights(_equations(fixed, smooth(S, start), mask)[2], mask)
    d, weight, last, _ = jax.lax.while_loop(goes_on, step, (start, first, jnp.asarray(jnp.inf), jnp.asarray(0)))
    normal, Z, residual = _equations(fixed, smooth(S, d), weight)
    root, count = jnp.sqrt(weight), jnp.sum(weight)
    by_residual = (inverse(normal)[:2] @ Z) / jnp.where(root > 0.0, root, 1.0).reshape(-1)
    covariance = spread(by_residual, root * residual, count)
    return Refined(d, covariance, is_found(d, last, CLOSE_ENOUGH, covariance, count))


@batch_filter_jit
def refine_all_robustly(
    T: Float[Array, "n wide_rows wide_cols"],
    known_T: Bool[Array, "n wide_rows wide_cols"],
    S: Float[Array, "n wide_rows wide_cols"],
    known_S: Bool[Array, "n wide_rows wide_cols"],
    start: Float[Array, "n 2"],
) -> Refined:
    """`refine_robustly` of several candidates, sequentially."""
    return jax.lax.map(lambda one: refine_robustly(*one), (T, known_T, S, known_S, start))


def _weights(residual: Block, mask: Block) -> Block:
    some = jnp.where(mask > 0.0, jnp.abs(residual), jnp.nan)[::2, ::2]  # neighbours are smoothed alike
    scale = jnp.maximum(jnp.nan_to_num(jnp.nanmedian(some)) / MEDIAN, LEAST_SCALE)
    return mask / (1.0 + (residual / (CUT * scale)) ** 2) ** 2


def _equations(
    fixed: Smooth, moved: Smooth, weight: Block
) -> tuple[Float[Array, "4 4"], Float[Array, "4 cells"], Block]:
    """(Z'WX, Z'W, residuals) of shift, gain and offset at a shift, with the optimal weighted gain there."""
    count = jnp.maximum(jnp.sum(weight), 1e-6)
    mean_T, mean_S = (jnp.sum(weight * x) / count for x in (fixed.value, moved.value))
    centred_T, centred_S = fixed.value - mean_T, moved.value - mean_S
    power = jnp.sum(weight * centred_S**2)
    gain = jnp.sum(weight * centred_T * centred_S) / jnp.where(power > 0.0, power, 1.0)
    Z = jnp.stack([fixed.down, fixed.across, centred_S, jnp.ones_like(centred_S)]) * weight
    X = jnp.stack([gain * moved.down, gain * moved.across, centred_S, jnp.ones_like(centred_S)])
    return Z.reshape(4, -1) @ X.reshape(4, -1).T, Z.reshape(4, -1), centred_T - gain * centred_S
