"""From a bracket to the exact range, with derivatives."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxgeo._numerics import value_and_slope, with_implicit_derivative
from jaxgeo._typing import Flag, Scalar
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.interface import AbstractTerrain, Bracket

SLACK = 1e-6  # m: the bracket comes from a track that is true to less
STEPS = 60


def polish(ray: Ray, terrain: AbstractTerrain, bracket: Bracket) -> Scalar:
    """Range in m to the crossing within `bracket`, on its frozen cell, exact in value and in its first two derivatives.

    Newton on the exact map, kept inside the bracket by bisection; it never picks another cell. The derivatives are
    those of the implicit function: they reach the ray, the grid and the four posts of the cell.
    """

    def clearance(distance: Scalar) -> Scalar:
        return terrain.clearance(ray.at(distance), bracket.cell)

    frozen_ray, frozen_terrain = jax.lax.stop_gradient((ray, terrain))

    def frozen_clearance(distance: Scalar) -> Scalar:
        return frozen_terrain.clearance(frozen_ray.at(distance), bracket.cell)

    root = _newton_in_bracket(frozen_clearance, bracket.lower - SLACK, bracket.upper + SLACK)
    return with_implicit_derivative(clearance, root)


def _newton_in_bracket(clearance, lower: Scalar, upper: Scalar) -> Scalar:
    """The root of a decreasing crossing: positive clearance at `lower`, negative at `upper`."""

    def unfinished(state: tuple[Scalar, Scalar, Scalar, Scalar, jax.Array]) -> Flag:
        _, _, root, step, count = state
        return (step > 1e-10 + 2e-16 * jnp.abs(root)) & (count < STEPS)

    def refine(
        state: tuple[Scalar, Scalar, Scalar, Scalar, jax.Array],
    ) -> tuple[Scalar, Scalar, Scalar, Scalar, jax.Array]:
        low, high, root, _, count = state
        value, slope = value_and_slope(clearance, root)
        low = jnp.where(value > 0.0, root, low)
        high = jnp.where(value > 0.0, high, root)
        newton = root - value / jnp.where(slope < 0.0, slope, -1.0)
        stays = (slope < 0.0) & (newton >= low) & (newton <= high)
        following = jnp.where(stays, newton, 0.5 * (low + high))
        return low, high, following, jnp.abs(following - root), count + 1

    start = 0.5 * (lower + upper)
    state = (lower, upper, start, jnp.full_like(start, jnp.inf), jnp.asarray(0))
    return jax.lax.while_loop(unfinished, refine, state)[2]
