"""Batched line-of-sight perturbation: sampled errors, lines of sight and ground intersections, in blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int8

from jaxgeo._accelerator import by_device
from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import has_point, touched_by_each
from jaxgeo._numerics import matvec
from jaxgeo._typing import Scalar, StatusCode, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Dem, FirstHit
from jaxgeo.terrain.search.beam import Beam, Spread
from jaxgeo.terrain.search.ground import Ground
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, Sightline
from jaxgeo.uncertainty.sources.base import Error

BLOCK = 3392  # lines of sight formed and searched together: a multiple of 64, so that the search needs no padding
STAGE = BLOCK // 2  # lines of sight per step of forming them; intermediate results fit into the cache of a core
BLOCK_ACCELERATOR = 2**20  # the same on an accelerator, in one step
TRIALS = 1024
WIDER = 1.5  # factor on the largest trial deviation: about four sigmas, so that hardly any draw lies outside
LEAST = Spread(1e-3, 1e-9, 1e-3)  # m, rad, m: margin for rounding if there is no spread

Stages: TypeAlias = Sequence[Callable[[Any], Any]]
FixOffsets: TypeAlias = tuple[Float[Array, "samples 3"], Int8[Array, " samples"]]


class PerturbedLines(NamedTuple):
    """Perturbed lines of sight (leading axis), each with the perturbed leaves of its terrain and atmosphere (None for
    the others) and the height in m by which a field raises its ground."""

    sight: Sightline
    own: Any
    rise: Float[Array, " lines"]


def block_size(devices: Sequence[Any] = ()) -> int:
    """Lines of sight formed and searched together, on given devices or on the default one."""
    return by_device(BLOCK, BLOCK_ACCELERATOR, devices)


def perturbed_lines(model: ErrorModel, inputs: ModelInputs, places: Any, stages: Stages, each: Array) -> PerturbedLines:
    """The lines of sight of a batch of errors that `stages` compute in order from `each` (leading axis).

    `places` are the `places_of_ground`. The whole batch passes through each stage, and then all lines of sight are
    formed. Otherwise the compiler would recompute an error at each use, and with it the chain of rotations.
    """

    def line(error: Error) -> PerturbedLines:
        moved = model.moved(inputs, error)
        ground = _ground(moved)
        own = jax.tree.map(lambda leaf, place: leaf if place < 0 else None, ground, places)
        return PerturbedLines(moved.sightline(), own, _rise(ground[0]))

    return _in_turn((*stages, line), each)


def places_of_ground(model: ErrorModel, inputs: ModelInputs) -> Any:
    """For each leaf of the perturbed terrain and atmosphere, its number among the leaves of those of `inputs`, or -1 if
    the errors perturb it."""
    places: Any = None

    def moved(inputs: ModelInputs) -> Any:
        nonlocal places
        at = {id(leaf): place for place, leaf in enumerate(jax.tree.leaves(_ground(inputs)))}
        ground = _ground(model.moved(inputs, jnp.zeros(model.size)))
        places = jax.tree.map(lambda leaf: at.get(id(leaf), -1), ground)
        return ()

    eqx.filter_eval_shape(moved, inputs)
    return places


def common_ground(inputs: ModelInputs, places: Any) -> Any:
    """Terrain and atmosphere with None for the leaves that the errors perturb."""
    given = jax.tree.leaves(_ground(inputs))
    return jax.tree.map(lambda place: None if place < 0 else given[place], places)


def has_own_field(places: Any) -> bool:
    """Whether every line of sight has a height field of its own, by the `places_of_ground`."""
    field = getattr(places[0], "field", None)
    return any(place < 0 for place in jax.tree.leaves(field)) and len(jax.tree.leaves(field)) > 1


def offsets_of_lines(nominal: NominalFix, search: AbstractSearch, lines: PerturbedLines, common: Any) -> FixOffsets:
    """Offsets in m from the nominal fix, and statuses, of the fixes of perturbed lines of sight."""
    terrain, air = eqx.combine(lines.own, common)
    if isinstance(search, FirstHit) and isinstance(terrain, Dem) and air is None:
        ground = Ground(lines.own[0], common[0])
        p_ecef, status = touched_by_each(lines.sight.ray, lines.sight.status, ground, search)
        offset = jnp.where(jax.vmap(has_point)(status)[:, None], p_ecef - nominal.p_ecef[None, :], 0.0)
        return jax.vmap(matvec, in_axes=(None, 0))(nominal.R_ecef_from_enu.T, offset), status

    def offset_of(line: Sightline, own: Any) -> tuple[Vector3, StatusCode]:
        terrain, air = eqx.combine(own, common)
        return nominal.offset_of(line, terrain, air, search)

    return jax.vmap(offset_of)(lines.sight, lines.own)


def search_of_lines(search: AbstractSearch, inputs: ModelInputs, nominal: NominalFix, trial: PerturbedLines) -> Any:
    """The search, given the range from which lines of sight that spread as the `trial` can be near the ground.

    A line outside that spread is searched without this information.
    """
    if not isinstance(search, FirstHit) or not isinstance(inputs.terrain, Dem) or inputs.air is not None:
        return search
    return FirstHit(_beam(inputs, nominal.distance, trial), search.native)


@quick_filter_jit
def _beam(inputs: ModelInputs, distance: Scalar, trial: PerturbedLines) -> Beam:
    ray, _ = inputs.sightline()
    trial = jax.tree.map(lambda x: x[:TRIALS], trial)
    farthest = lambda all_, middle: jnp.max(jnp.linalg.norm(all_ - middle[None, :], axis=1))  # noqa: E731
    lines = trial.sight.ray
    spread = Spread(farthest(lines.origin, ray.origin), farthest(lines.direction, ray.direction), trial.rise.max())
    spread = Spread(*(WIDER * jnp.maximum(part, 0.0) + least for part, least in zip(spread, LEAST, strict=True)))
    return Beam.about(ray, distance, inputs.terrain, spread)


def _rise(terrain: AbstractTerrain) -> Scalar:
    """Height in m by which a field raises the ground."""
    return jnp.asarray(0.0 if not isinstance(terrain, Dem) or terrain.rise is None else terrain.rise)


def _ground(inputs: ModelInputs) -> tuple[AbstractTerrain, Atmosphere | None]:
    """Terrain and atmosphere of an observation."""
    return inputs.terrain, inputs.air


def in_blocks(function: Callable[[Any], Any], each: Array, most: int) -> Any:
    """A function of a batch (leading axis) in blocks of one size of at most `most`, in sequence."""
    return _joined(jax.lax.map(function, _blocks(each, most)), each.shape[0])


def _in_turn(stages: Stages, each: Array) -> Any:
    """Results of `stages` applied in order to a batch (leading axis), in steps; in between, the batch axis is last."""
    blocks = _blocks(each, by_device(STAGE, BLOCK_ACCELERATOR))
    *others, last = stages
    axis = 0
    for stage in others:
        blocks = jax.lax.map(jax.vmap(stage, in_axes=axis, out_axes=-1), blocks)
        axis = -1
    return _joined(jax.lax.map(jax.vmap(last, in_axes=axis), blocks), each.shape[0])


def _blocks(each: Array, most: int) -> Array:
    """The batch in blocks of one size, the last one padded."""
    count = each.shape[0]
    blocks = max(-(-count // most), 1)
    size = -(-count // blocks)
    filled = jnp.concatenate([each, jnp.broadcast_to(each[-1:], (blocks * size - count, *each.shape[1:]))])
    return filled.reshape(blocks, size, *each.shape[1:])


def _joined(blocks: Any, count: int) -> Any:
    """The first `count` items of blocks."""
    return jax.tree.map(lambda x: x.reshape(x.shape[0] * x.shape[1], *x.shape[2:])[:count], blocks)
