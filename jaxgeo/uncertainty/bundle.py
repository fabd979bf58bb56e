"""Many draws of one look at once: their lines of sight are made in blocks, and come down together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Int8

from jaxgeo._typing import Scalar, StatusCode, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Dem, FirstHit
from jaxgeo.terrain.search.beam import Beam, Spread
from jaxgeo.uncertainty.draws import Random
from jaxgeo.uncertainty.look import Aim, Look, Sightline
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sources.base import Error

BLOCK = 1024  # lines of sight: what they are made of stays in a core's cache
PART = 4096  # of them that are searched together, which bounds the memory
TRIALS = 256
WIDER = 1.25  # than the trials' farthest: some four sigmas, so that hardly any draw lies outside
LEAST = Spread(1e-3, 1e-9, 1e-3)  # m, rad, m: for rounding, where nothing spreads

Misses = tuple[Float[Array, "samples 3"], Int8[Array, " samples"]]


def misses(
    model: ErrorModel,
    look: Look,
    aim: Aim,
    search: AbstractSearch,
    error_of: Callable[[Any], Error],
    each: Array,
) -> Misses:
    """`ErrorModel.miss` in m, and statuses, of the errors that `error_of` makes of each of many (leading axis).

    All errors are drawn, then all lines of sight made, then all searched for their ground: left to itself, the compiler
    would have an error drawn again wherever it is looked at, and the chain of rotations gone through again.
    """

    def some(each: Array) -> Misses:
        lines, own, common = _lines(model, look, error_of, each)

        def miss(line: Sightline, own: Any) -> tuple[Vector3, StatusCode]:
            terrain, air = eqx.combine(own, common)
            return aim.missed_by(line, terrain, air, search)

        return jax.vmap(miss)(lines, own)

    return _in_blocks(some, each, PART)


def with_beam(search: AbstractSearch, model: ErrorModel, look: Look, aim: Aim) -> AbstractSearch:
    """The search, told where on their way the lines of sight of this model begin to be near the ground.

    How far they spread is seen from some trial draws; one that lies farther off is searched as if nothing were known.
    """
    if not isinstance(search, FirstHit) or not isinstance(look.terrain, Dem) or look.air is not None:
        return search
    roots, key = model.roots(), jax.random.key(0)

    def error_of(number: Int[Array, ""]) -> Error:
        return model.drawn(roots, Random().standard_normal(key, number, model.size))

    lines, own, common = _lines(model, look, error_of, jnp.arange(TRIALS))
    ray, _ = look.sightline()
    farthest = lambda all_, middle: jnp.max(jnp.linalg.norm(all_ - middle[None, :], axis=1))  # noqa: E731
    rises = jax.vmap(lambda _, own: _rise(eqx.combine(own, common)[0]))(lines.status, own)
    spread = Spread(farthest(lines.ray.origin, ray.origin), farthest(lines.ray.direction, ray.direction), rises.max())
    spread = Spread(*(WIDER * jnp.maximum(part, 0.0) + least for part, least in zip(spread, LEAST, strict=True)))
    return FirstHit(Beam.about(ray, aim.distance, look.terrain, spread))


def _lines(model: ErrorModel, look: Look, error_of: Callable[[Any], Error], each: Array) -> tuple[Sightline, Any, Any]:
    """(lines of sight, what the errors move of the ground that each comes down on, what all have in common)."""
    given = {id(leaf) for leaf in jax.tree.leaves(_ground(look))}
    example = _ground(model.moved(look, jnp.zeros(model.size)))
    is_moved = jax.tree.map(lambda leaf: id(leaf) not in given, example)

    def line(error: Error) -> tuple[Sightline, Any]:
        moved = model.moved(look, error)
        return moved.sightline(), eqx.filter(_ground(moved), is_moved)

    errors = _in_blocks(jax.vmap(error_of), each, BLOCK)
    lines, own = _in_blocks(jax.vmap(line), errors, BLOCK)
    return lines, own, eqx.filter(example, is_moved, inverse=True)


def _rise(terrain: Dem) -> Scalar:
    """How far in m a field raises the ground."""
    return jnp.asarray(0.0 if terrain.rise is None else terrain.rise)


def _ground(look: Look) -> tuple[AbstractTerrain, Atmosphere | None]:
    """What a line of sight comes down on, and through what."""
    return look.terrain, look.air


def _in_blocks(function: Callable[[Any], Any], each: Array, largest: int) -> Any:
    """A function of many (leading axis), in blocks of one size, one after the other."""
    count, shape = each.shape[0], each.shape[1:]
    blocks = max(-(-count // largest), 1)
    size = -(-count // blocks)
    filled = jnp.concatenate([each, jnp.broadcast_to(each[-1:], (blocks * size - count, *shape))])
    answers = jax.lax.map(function, filled.reshape(blocks, size, *shape))
    return jax.tree.map(lambda x: x.reshape(blocks * size, *x.shape[2:])[:count], answers)
