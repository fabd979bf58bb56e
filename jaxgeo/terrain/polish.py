"""Refinement of a bracket to the exact range, with derivatives."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxgeo._numerics import implicit_root, newton_or_half, value_and_slope
from jaxgeo._typing import Flag, Scalar
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.interface import AbstractTerrain, Bracket

SLACK = 1e-6  # m: bound of the track's error, from which the bracket comes
CLOSE_ENOUGH = 1e-4  # m: last step; the remaining error is its square over the radius of a hill
ROUNDING = 2e-9  # m of clearance: resolution of an ECEF position
STEPS = 60


def polish(ray: Ray, terrain: AbstractTerrain, bracket: Bracket) -> Scalar:
    """Range in m to the crossing within `bracket`, on its fixed cell, exact in value and in all derivatives.

    Newton on the exact map, kept inside the bracket by bisection; it never changes the cell. Derivatives follow from
    the implicit function theorem: they reach the ray, the grid and the four posts of the cell.
    """
    world = (ray, terrain, bracket.cell)
    frozen = jax.lax.stop_gradient(world)
    lower, upper = bracket.lower - SLACK, bracket.upper + SLACK
    root = _newton_in_bracket(lambda s: _clearance(s, frozen), lower, upper, bracket.near)
    return implicit_root(_clearance, jax.lax.stop_gradient(root), world)


def _clearance(distance: Scalar, world: tuple[Ray, AbstractTerrain, jax.Array]) -> Scalar:
    ray, terrain, cell = world
    return terrain.clearance(ray.at(distance), cell)


def _newton_in_bracket(clearance: Callable[[Scalar], Scalar], lower: Scalar, upper: Scalar, near: Scalar) -> Scalar:
    """The root of a decreasing clearance: positive at `lower`, negative at `upper`; starts at `near`."""

    def unfinished(state: tuple[Scalar, Scalar, Scalar, Flag, jax.Array]) -> Flag:
        _, _, _, is_exact, count = state
        return ~is_exact & (count < STEPS)

    def refine(
        state: tuple[Scalar, Scalar, Scalar, Flag, jax.Array],
    ) -> tuple[Scalar, Scalar, Scalar, Flag, jax.Array]:
        low, high, root, _, count = state
        value, slope = value_and_slope(clearance, root)
        low, high, following = newton_or_half(low, high, root, value, slope, SLACK)
        is_there = jnp.abs(value) <= ROUNDING
        is_near = jnp.abs(following - root) <= CLOSE_ENOUGH
        return low, high, jnp.where(is_there & ~is_near, root, following), is_there | is_near, count + 1

    state = (lower, upper, near, jnp.isnan(near), jnp.asarray(0))
    return jax.lax.while_loop(unfinished, refine, state)[2]
