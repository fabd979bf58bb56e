"""Equations of looks: the target's distance across the line of sight, linearised at a state, and the ground there."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import dot, safe_norm
from jaxgeo._typing import Flag, Flags, Matrix3, Scalar, Vector3
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.look_lines import Lines
from jaxgeo.uncertainty.target_motion import AbstractTarget

LEAST_REACH = 0.01  # m: least distance over which the slope of the ground is taken
SURFACE_STEPS, STEPS_NEARBY = 3, 2  # to the ground at a place in the level axes, and near one that is on it


class World(NamedTuple):
    """What all looks share: terrain (None if the target is free in height), frame of the track, fading times in s."""

    terrain: AbstractTerrain | None
    origin: Vector3
    R_ecef_from_track: Matrix3
    durations: Float[Array, " fading"]


class About(NamedTuple):
    """What a look is linearised about: a `state` (unknowns,), and the standard deviation of its position in m."""

    state: Any
    reach: Any


class Measured(NamedTuple):
    """A look linearised at a state: `b` (2,), `H` (2, unknowns) and `G` (2, z) of 0 = b + H dx + G z; and derivatives
    of the target's place, `T` (3, unknowns) and `up` (3,) by a rise of the ground; range in m.
    """

    b: Any
    H: Any
    G: Any
    T: Any
    up: Any
    distance: Any


def measured_at(line: Lines, about: About, world: World, target: AbstractTarget) -> Measured:
    """A look linearised at a state."""
    place, _ = place_at(line, about.state, world, target)
    T, up = jnp.eye(3), jnp.zeros(3)
    if target.on_terrain:
        assert world.terrain is not None
        T, up = _surface_slope(place, about.reach, world.terrain, world), jnp.array([0.0, 0.0, 1.0])
    if target.is_moving:
        T = jnp.concatenate([T, line.time * T], axis=1)
    ahead = dot(line.heading, place - line.point)
    foot = line.point + line.heading * ahead + 0.5 * line.bend * ahead**2
    across = _across(line.heading + line.bend * ahead)
    G = across @ (jnp.outer(up, line.ground) - line.shift - line.slope * ahead)
    return Measured(across @ (place - foot), across @ T, G, T, up, line.distance + ahead)


def place_at(line: Lines, x: Any, world: World, target: AbstractTarget) -> tuple[Vector3, Flag]:
    """(place of the target at a look in the frame, m; whether the ground is known there)."""
    axes = target.axes
    place = x[:axes] + line.time * x[axes:] if target.is_moving else x
    if not target.on_terrain:
        return place, jnp.asarray(True)
    assert world.terrain is not None
    return on_surface(place, line.point[2], world.terrain, world)


def on_surface(
    horizontal: Any, start: Scalar, terrain: AbstractTerrain, world: World, steps: int = SURFACE_STEPS
) -> tuple[Vector3, Flag]:
    """(point of the ground in the frame, over a place in its level axes; whether the ground is known there)."""

    def nearer(_: Any, before: tuple[Vector3, Flag]) -> tuple[Vector3, Flag]:
        place, _ = before
        above, is_known = terrain.ground_above(world.origin + world.R_ecef_from_track @ place)
        return place.at[2].add(above), is_known

    place = jnp.concatenate([horizontal, start[None]])
    return jax.lax.fori_loop(0, steps, nearer, (place, jnp.asarray(True)))


def _surface_slope(place: Vector3, reach: Scalar, terrain: AbstractTerrain, world: World) -> Float[Array, "3 2"]:
    """Derivative of a point of the ground by its level coordinates, over as much ground as the position may err.

    The difference over the standard deviation on either side: the slope that matters for the estimate (statistical
    linearisation), and a continuous one. The derivative of a bilinear surface jumps at each row of posts. Beside the
    edge of the terrain or a void it is the difference on the known side, or over the least distance.
    """
    sides = jnp.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])

    def slope_over(reach: Scalar) -> tuple[Float[Array, "2"], Flags]:
        around, known = jax.vmap(
            lambda side: on_surface(place[:2] + reach * side, place[2], terrain, world, STEPS_NEARBY)
        )(sides)
        up = (around[:, 2] - place[2]) / reach
        ahead, behind = known[::2], known[1::2]
        one_side = jnp.where(ahead, up[::2], jnp.where(behind, -up[1::2], 0.0))
        return jnp.where(ahead & behind, 0.5 * (up[::2] - up[1::2]), one_side), ahead | behind

    slopes, known = jax.vmap(slope_over)(jnp.stack([jnp.maximum(reach, LEAST_REACH), jnp.asarray(LEAST_REACH)]))
    return jnp.concatenate([jnp.eye(2), jnp.where(known[0], slopes[0], slopes[1])[None]])


def _across(heading: Vector3) -> Float[Array, "2 3"]:
    """Unit vectors across a line of sight: to the right, level, and upwards; for a plumb line two level ones."""
    d = heading / safe_norm(heading)
    level = jnp.stack([d[1], -d[0], jnp.zeros(())])
    plumb = dot(level, level) < 1e-12
    level = jnp.where(plumb, jnp.array([1.0, 0.0, 0.0]), level)
    right = level / safe_norm(level)
    return jnp.stack([right, jnp.cross(right, d)])
