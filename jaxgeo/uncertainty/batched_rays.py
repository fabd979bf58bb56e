"""Batched line-of-sight perturbation: sampled errors, lines of sight and ground intersections, in blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Int8

from jaxgeo._typing import Flags, Scalar, StatusCode, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Dem, FirstHit
from jaxgeo.terrain.search.beam import Beam, Spread
from jaxgeo.uncertainty.draws import Random
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, Sightline
from jaxgeo.uncertainty.sources.base import Error

BLOCK = 2048  # lines of sight per block; intermediate results fit into the cache of a core
LANES = 64  # block sizes are multiples of this, so that the search needs no padding
PART = 4096  # lines of sight searched together, which bounds the memory
TRIALS = 1024
WIDER = 1.5  # factor on the largest trial deviation: about four sigmas, so that hardly any draw lies outside
LEAST = Spread(1e-3, 1e-9, 1e-3)  # m, rad, m: margin for rounding if there is no spread

Stages: TypeAlias = Sequence[Callable[[Any], Any]]
FixOffsets: TypeAlias = tuple[Float[Array, "samples 3"], Int8[Array, " samples"]]


def fix_offsets(
    model: ErrorModel, inputs: ModelInputs, nominal: NominalFix, search: AbstractSearch, stages: Stages, each: Array
) -> FixOffsets:
    """Fix offsets in m, and statuses, for a batch of errors that `stages` compute in order from `each` (leading axis).

    The whole batch passes through each stage, then all lines of sight are formed, then all are intersected. Otherwise
    the compiler would recompute an error at each use, and with it the chain of rotations.
    """
    lines, own, common = _lines(model, inputs, stages, each)

    def offset(line: Sightline, own: Any) -> tuple[Vector3, StatusCode]:
        terrain, air = eqx.combine(own, common)
        return nominal.offset_of(line, terrain, air, search)

    return jax.vmap(offset)(lines, own)


def in_parts(function: Callable[[Array, Flags], tuple[Any, Any]], each: Array) -> tuple[Any, Any]:
    """A function applied to a batch (leading axis) in parts of one size, in sequence, which bounds the memory.

    It takes a part and a flag per item that is false for padding. It returns results per item, which are concatenated,
    and results per part, which are stacked along a leading axis.
    """
    parts, count = _blocks(each, PART)
    is_own = jnp.arange(parts.shape[0] * parts.shape[1]).reshape(parts.shape[:2]) < count
    of_each, of_part = jax.lax.map(lambda part: function(*part), (parts, is_own))
    return _concatenate(of_each, count), of_part


def with_beam(search: AbstractSearch, model: ErrorModel, inputs: ModelInputs, nominal: NominalFix) -> AbstractSearch:
    """The search, given the range from which the lines of sight of this model can be near the ground.

    Their spread is estimated from `TRIALS` draws; a line outside that spread is searched without this information.
    """
    if not isinstance(search, FirstHit) or not isinstance(inputs.terrain, Dem) or inputs.air is not None:
        return search
    roots, key = model.roots(), jax.random.key(0)

    def error_of(number: Int[Array, ""]) -> Error:
        return model.draw(roots, Random().standard_normal(key, number, model.size))

    lines, own, common = _lines(model, inputs, (error_of,), jnp.arange(TRIALS))
    ray, _ = inputs.sightline()
    farthest = lambda all_, middle: jnp.max(jnp.linalg.norm(all_ - middle[None, :], axis=1))  # noqa: E731
    rises = jax.vmap(lambda _, own: _rise(eqx.combine(own, common)[0]))(lines.status, own)
    spread = Spread(farthest(lines.ray.origin, ray.origin), farthest(lines.ray.direction, ray.direction), rises.max())
    spread = Spread(*(WIDER * jnp.maximum(part, 0.0) + least for part, least in zip(spread, LEAST, strict=True)))
    return FirstHit(Beam.about(ray, nominal.distance, inputs.terrain, spread))


def _lines(model: ErrorModel, inputs: ModelInputs, stages: Stages, each: Array) -> tuple[Sightline, Any, Any]:
    """(lines of sight, perturbed parts of terrain and atmosphere per line, parts common to all)."""
    given = {id(leaf) for leaf in jax.tree.leaves(_ground(inputs))}
    example = _ground(model.moved(inputs, jnp.zeros(model.size)))
    is_moved = jax.tree.map(lambda leaf: id(leaf) not in given, example)

    def line(error: Error) -> tuple[Sightline, Any]:
        moved = model.moved(inputs, error)
        return moved.sightline(), eqx.filter(_ground(moved), is_moved)

    lines, own = _in_turn((*stages, line), each)
    return lines, own, eqx.filter(example, is_moved, inverse=True)


def _rise(terrain: Dem) -> Scalar:
    """Height in m by which a field raises the ground."""
    return jnp.asarray(0.0 if terrain.rise is None else terrain.rise)


def _ground(inputs: ModelInputs) -> tuple[AbstractTerrain, Atmosphere | None]:
    """Terrain and atmosphere of an observation."""
    return inputs.terrain, inputs.air


def _in_turn(stages: Stages, each: Array) -> Any:
    """Results of `stages` applied in order to a batch (leading axis), in blocks; in between, the batch axis is last."""
    blocks, count = _blocks(each, BLOCK)
    *others, last = stages
    axis = 0
    for stage in others:
        blocks = jax.lax.map(jax.vmap(stage, in_axes=axis, out_axes=-1), blocks)
        axis = -1
    return _concatenate(jax.lax.map(jax.vmap(last, in_axes=axis), blocks), count)


def _blocks(each: Array, largest: int) -> tuple[Array, int]:
    """The batch in blocks of one size, the last one padded, and the number of items."""
    count, shape = each.shape[0], each.shape[1:]
    blocks = max(-(-count // largest), 1)
    size = -(-count // blocks)
    size = min(largest, LANES * -(-size // LANES))
    filled = jnp.concatenate([each, jnp.broadcast_to(each[-1:], (blocks * size - count, *shape))])
    return filled.reshape(blocks, size, *shape), count


def _concatenate(blocks: Any, count: int) -> Any:
    """The first `count` items of blocks, concatenated."""
    return jax.tree.map(lambda x: x.reshape(x.shape[0] * x.shape[1], *x.shape[2:])[:count], blocks)
