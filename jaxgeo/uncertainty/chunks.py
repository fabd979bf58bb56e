"""Chunked Monte Carlo sampling on all devices."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, Int8

from jaxgeo._compile import quick_filter_jit
from jaxgeo._typing import Flags, Vector3
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import AbstractSearch
from jaxgeo.uncertainty.batched_rays import FixOffsets, fix_offsets, in_parts, with_beam
from jaxgeo.uncertainty.draws import AbstractDraws, Sobol
from jaxgeo.uncertainty.model import ErrorModel, Root
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix

_PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]
_PLACES = np.array([[_PAIRS.index((min(i, j), max(i, j))) for j in range(4)] for i in range(4)])


class Plan(NamedTuple):
    """Inputs of a sampling, common to all chunks."""

    inputs: ModelInputs
    nominal: NominalFix
    model: ErrorModel
    roots: tuple[Root, ...]
    turn: Float[Array, "axes axes"] | None
    draws: AbstractDraws
    search: AbstractSearch
    key: Any


def make_plan(
    inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, draws: AbstractDraws, search: AbstractSearch, key: Any
) -> Plan:
    """Sampling plan of an observation; its terrain bypasses the compiled function, which would return a copy."""
    model, roots, turn, search = _prepare(inputs, nominal, model, draws, search)
    return Plan(inputs, nominal, model, roots, turn, draws, search, key)


@quick_filter_jit
def _prepare(
    inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, draws: AbstractDraws, search: AbstractSearch
) -> tuple[ErrorModel, tuple[Root, ...], Float[Array, "axes axes"] | None, AbstractSearch]:
    """(model at the observation, its roots, rotation for Sobol points, search with a beam)."""
    model = model.at(inputs, nominal)
    turn = None
    if isinstance(draws, Sobol):
        turn = _rotation_leading_first(model.sweep(inputs, nominal).facet @ model.factor())
    return model, model.roots(), turn, with_beam(search, model, inputs, nominal)


def _rotation_leading_first(swept: Float[Array, "3 axes"]) -> Float[Array, "axes axes"]:
    """Rotation of standard normal vectors after which the leading components displace the fix most."""
    sound = jnp.all(jnp.isfinite(swept))
    _, _, directions = jnp.linalg.svd(jnp.where(sound, swept, 0.0), full_matrices=True)
    return jnp.where(sound, directions.T, jnp.eye(swept.shape[1]))


def _offsets(plan: Plan, numbers: Int[Array, " samples"]) -> FixOffsets:
    """Fix offsets in m and statuses of the samples with these numbers."""

    *others, last = plan.draws.stages(plan.key, plan.model.size)

    def error_of(numbers: Any) -> Float[Array, " axes"]:
        normal = last(numbers)
        if plan.turn is not None:
            normal = jnp.sum(plan.turn * normal[None, :], axis=1)  # rounding of a matrix product depends on the batch
        return plan.model.draw(plan.roots, normal)

    return fix_offsets(plan.model, plan.inputs, plan.nominal, plan.search, (*others, error_of), numbers)


class Drawn(NamedTuple):
    """One chunk: per device, sums over samples with a fix of the products of (east, north, up, 1), in m about the
    centre; per sample, the radii in m for CE, LE and SE, the status and, if requested, the error.
    """

    moments: Float[Array, "devices 4 4"]
    radii: tuple[Float[Array, " samples"], ...]
    statuses: Int8[Array, " samples"]
    errors: Float[Array, "samples 3"] | None


@eqx.filter_jit
def draw_chunk(
    plan: Plan,
    part: tuple[Int[Array, ""], Int[Array, ""]],
    centre: Vector3,
    size: int,
    devices: tuple[Any, ...],
    keep: bool,
) -> Drawn:
    """The chunk `part` = (first sample, number of samples), split over the devices and padded to `size` samples."""
    drawn = partial(_draw, keep)
    if len(devices) == 1:
        return drawn(plan, part, centre, jnp.arange(size))
    everywhere, in_turn = PartitionSpec(), PartitionSpec("samples")
    spread = jax.shard_map(
        drawn,
        mesh=_mesh(devices),
        in_specs=(everywhere, everywhere, everywhere, in_turn),
        out_specs=in_turn,
        check_vma=False,
    )
    return spread(plan, part, centre, jnp.arange(size))


def _draw(
    keep: bool,
    plan: Plan,
    part: tuple[Int[Array, ""], Int[Array, ""]],
    centre: Vector3,
    places: Int[Array, " samples"],
) -> Drawn:
    """Samples of a chunk at the indices `places`, drawn on one device. Devices do not wait for each other's sums."""
    first, count = part

    def some(places: Int[Array, " part"], is_own: Flags) -> tuple[Any, Any]:
        offset, status = _offsets(plan, first + places)
        found = counts_as_fix(status)
        error = offset - centre[None, :]
        across, up = error[:, 0] ** 2 + error[:, 1] ** 2, error[:, 2]
        radii = (jnp.sqrt(across), jnp.abs(up), jnp.sqrt(across + up**2))
        radii = tuple(jnp.where(found, radius, jnp.inf) for radius in radii)
        errors = jnp.where(found[:, None], error, jnp.nan) if keep else None
        counts = found & is_own & (places < count)
        return (radii, status, errors), _moments(error, counts)

    (radii, statuses, errors), moments = in_parts(some, places)
    return Drawn(moments.sum(axis=0)[None, :, :], radii, statuses, errors)


def _moments(error: Float[Array, "part 3"], counts: Flags) -> Float[Array, "4 4"]:
    """Sums of the products of (east, north, up, 1) over the counted samples, in one pass over the part."""
    known = [jnp.where(counts, x, 0.0) for x in (*error.T, jnp.ones(error.shape[0]))]
    products = [known[i] * known[j] for i, j in _PAIRS]
    sums = jax.lax.reduce(
        products, [0.0] * len(products), lambda a, b: [x + y for x, y in zip(a, b, strict=True)], (0,)
    )
    return jnp.stack(sums)[_PLACES]


def _mesh(devices: tuple[Any, ...]) -> Mesh:
    return Mesh(np.array(devices), ("samples",))


def one_ahead(
    plan: Plan, parts: Iterator[tuple[int, int, int]], centre: Vector3, devices: tuple[Any, ...], keep: bool
) -> Iterator[tuple[int, int, Drawn]]:
    """(first sample, number of samples, drawn samples) chunk by chunk; the next chunk is drawn in the meantime."""
    # copied to the devices once, not per chunk: the terrain may be large
    arrays, rest = eqx.partition((plan, centre), eqx.is_array)
    plan, centre = eqx.combine(jax.device_put(arrays, NamedSharding(_mesh(devices), PartitionSpec())), rest)
    waiting = None
    for first, size, padded in parts:
        part = jnp.asarray(first), jnp.asarray(size)
        drawn = draw_chunk(plan, part, centre, padded, devices, keep)
        if waiting is not None:
            yield waiting
        waiting = first, size, drawn
    if waiting is not None:
        yield waiting


def chunks(count: int, chunk: int, devices: int, unit: int, progress: bool) -> Iterator[tuple[int, int, int]]:
    """(first sample, number of samples, padded number); the last is a multiple of the device and scramble counts."""
    unit = int(np.lcm(devices, unit))
    size = -(-min(chunk, count) // unit) * unit
    parts = [(first, min(size, count - first), size) for first in range(0, count, size)]
    if not progress:
        yield from parts
        return
    from rich.progress import track  # optional, imported only if used

    yield from track(parts, description="sampling")
