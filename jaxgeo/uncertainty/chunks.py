"""Chunked Monte Carlo sampling on all devices.

A chunk is drawn by two programs of one size for every count: the perturbed lines of sight, which depend on the error
model, and their fixes, which do not. Each goes through as many blocks of lines as the chunk needs. Block k holds the
samples from k times its size on, whatever part is drawn: rounding depends on a sample's place and neighbours in its
block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, Int8

from jaxgeo._accelerator import by_device
from jaxgeo._compile import batch_filter_jit, long_run_filter_jit, quick_filter_jit
from jaxgeo._typing import Flags, Index, Vector3
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import AbstractSearch, FirstHit
from jaxgeo.uncertainty.batched_rays import (
    BLOCK,
    STAGE,
    TRIALS,
    PerturbedLines,
    Stages,
    block_size,
    common_ground,
    has_own_field,
    offsets_of_lines,
    perturbed_lines,
    places_of_ground,
    search_of_lines,
)
from jaxgeo.uncertainty.draws import LEADING, AbstractDraws, Sobol, first_key
from jaxgeo.uncertainty.model import ErrorModel, Root
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.replicated import Replicated, large_on_all, mesh_of, whole
from jaxgeo.uncertainty.rotation import Rotation, Trial, rotation_of

FEW, MANY = 5 * BLOCK, 37 * BLOCK  # samples of one call on one device, at most; eight calls are a million
MOST_POINTS = 64  # axes of an error vector: of more, coordinates of Sobol points are no better than independent ones
LONG_RUN = 4 * FEW  # samples per device from which programs are compiled for speed

HostIndex: TypeAlias = Int[Array | np.ndarray, ""]

_PAIRS = [(i, j) for i in range(4) for j in range(i, 4)]
_PLACES = np.array([[_PAIRS.index((min(i, j), max(i, j))) for j in range(4)] for i in range(4)])


class LinePlan(NamedTuple):
    """What the lines of sight of a sampling come from; for `places` see `places_of_ground`. `seeds` are those of the
    key."""

    inputs: ModelInputs
    model: ErrorModel
    roots: tuple[Root, ...]
    rotation: Rotation | None
    draws: AbstractDraws
    seeds: Any
    places: Any


class FixPlan(NamedTuple):
    """What their fixes come from, the same for all error models; `common` is the ground that no error perturbs."""

    nominal: NominalFix
    search: AbstractSearch
    common: Any


class Plan(NamedTuple):
    """Inputs of a sampling, common to all chunks; `sent_lines` and `sent_fixes` are those that the programs take."""

    lines: LinePlan
    fixes: FixPlan
    sent_lines: LinePlan | Replicated
    sent_fixes: FixPlan | Replicated


class Size(NamedTuple):
    """Size of the programs: samples of one call on one device, the devices, whether the usual emitter compiles them,
    which is quicker to run, and the samples of a block."""

    capacity: int
    devices: tuple[Any, ...]
    is_long_run: bool
    block: int = BLOCK

    @property
    def step(self) -> int:
        """Lines of sight that are formed together; a block is a whole number of them."""
        return STAGE if self.block == BLOCK else self.block

    @classmethod
    def of(cls, count: int, chunk: int, devices: tuple[Any, ...]) -> Size:
        """The size for chunks of at most `chunk` of `count` samples; one for many counts."""
        is_long_run = count > LONG_RUN * len(devices) or by_device(False, True, devices)
        block = block_size(devices)
        blocks = lambda samples: -(-samples // (len(devices) * block))  # noqa: E731
        most = max((MANY if is_long_run else FEW) // block, 1)
        return cls(block * max(min(blocks(chunk), most), 1), devices, is_long_run, block)


class Part(NamedTuple):
    """Part of a sampling: the first sample, the number of samples, and how many blocks of them a device draws at most;
    the last devices draw those that are left."""

    first: HostIndex
    count: HostIndex
    share: HostIndex

    @classmethod
    def of(cls, first: int, count: int, size: Size) -> Part:
        """A part divided among the devices."""
        return cls(*map(np.asarray, (first, count, blocks_per_device(first, count, size))))


def blocks_per_device(first: int, count: int, size: Size) -> int:
    """Number of blocks of a part that each device draws at most."""
    return -(-_blocks_of(first, count, size.block) // len(size.devices))


def _blocks_of(first: Any, count: Any, block: int) -> Any:
    """Number of blocks of a part."""
    return -(-(first + count) // block) - first // block


class Drawn(NamedTuple):
    """One chunk: per device, sums over samples with a fix of the products of (east, north, up, 1), in m about the
    centre; per sample, the radii in m for CE, LE and SE, the status and, if requested, the error.
    """

    moments: Float[Array, "devices 4 4"]
    radii: tuple[Float[Array, " samples"], ...]
    statuses: Int8[Array, " samples"]
    errors: Float[Array, "samples 3"] | None

    def of_samples(self, first: int, count: int, size: Size) -> Drawn:
        """The chunk on the host: only the samples of the part, without the padding of each device's share."""
        devices, skipped = len(size.devices), first % size.block
        of_each = tuple(self)[1:]
        if devices == 1 and by_device(False, True, size.devices):  # the rest of a large block stays there
            least = 1 << (skipped + count - 1).bit_length()  # few sizes, each a program
            of_each = jax.tree.map(lambda x: x[:least], of_each)
        moments, *rest = jax.device_get((self.moments, *of_each))
        share = size.block * blocks_per_device(first, count, size)

        def own(x: np.ndarray) -> np.ndarray:
            of_devices = x.reshape(devices, -1, *x.shape[1:])[:, :share]
            return of_devices.reshape(-1, *x.shape[1:])[skipped : skipped + count]

        return Drawn(moments, *jax.tree.map(own, rest))


def make_plan(
    inputs: ModelInputs,
    nominal: NominalFix,
    model: ErrorModel,
    draws: AbstractDraws,
    search: AbstractSearch,
    key: Any,
    size: Size,
) -> tuple[Plan, Size]:
    """(sampling plan of an observation, its size); the search knows the spread of the lines of sight."""
    model, roots, places = _evaluated(inputs, nominal, model)
    rotation = Rotation.none(model.size) if isinstance(draws, Sobol) else None
    if has_own_field(places):  # the older emitter does not finish
        size = size._replace(is_long_run=True)
    seeds = lambda key: draws.seeds(key, model.size, leading_of(model))  # noqa: E731
    lines = LinePlan(inputs, model, roots, rotation, draws, seeds(key), places)
    fixes = FixPlan(nominal, search, common_ground(inputs, places))
    there = (lines, fixes)
    if not _is_default(size.devices):  # once, not per chunk: the terrain may be large
        there = large_on_all(there, size.devices)
    of_trial = _sent(there[0]._replace(seeds=seeds(first_key())), size)
    trial = draw_lines(of_trial, Part.of(0, TRIALS, size), size, TRIALS)
    if by_device(True, len(size.devices) > 1 or isinstance(draws, Sobol), size.devices):  # else it stays there
        trial = jax.tree.map(lambda x: np.asarray(_first_of(x, TRIALS, size)), trial)
    found = search_of_lines(search, inputs, nominal, trial)
    if size.is_long_run and isinstance(found, FirstHit) and found.beam is not None:
        found = FirstHit(
            found.beam, native=False
        )  # compiled for speed, JAX is quicker where rays share most of the way
    if isinstance(draws, Sobol):
        rotation = rotation_of(Trial.of(draws, model.size, leading_of(model)), trial, inputs, nominal, places, np)
    lines, fixes = lines._replace(rotation=rotation), fixes._replace(search=found)
    sent_lines = _sent(there[0]._replace(rotation=rotation), size)
    return Plan(lines, fixes, sent_lines, _sent(there[1]._replace(search=found), size)), size


def _is_default(devices: tuple[Any, ...]) -> bool:
    """Whether these are the one device on which arrays are made."""
    return devices == tuple(jax.local_devices()[:1])


def _sent(tree: Any, size: Size) -> Any:
    """A tree as the programs take it."""
    return tree if _is_default(size.devices) else Replicated.of(tree, size.devices)


def _first_of(array: Array, count: int, size: Size) -> Any:
    """The first `count` items of an array that is spread over the devices; they are all on the first one."""
    own = array if len(size.devices) == 1 else array.addressable_shards[0].data
    return np.asarray(own)[:count] if by_device(True, False, size.devices) else own[:count]


@quick_filter_jit
def _evaluated(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> tuple[ErrorModel, tuple[Root, ...], Any]:
    """(model at the observation, its roots, places of the ground's leaves)."""
    model = model.at(inputs, nominal)
    return model, model.roots(), places_of_ground(model, inputs)


def leading_of(model: ErrorModel) -> int:
    """How many numbers of a sample come from Sobol points: all where rotated ones do not tell the error alone."""
    return LEADING if model.is_normal or model.size > MOST_POINTS else model.size


def error_stages(draws: AbstractDraws, key: Any, model: ErrorModel, roots: tuple[Root, ...], rotation: Any) -> Stages:
    """Functions that, applied in order to the number of a sample, give its error vector."""
    *others, last = draws.sample_stages(key, model.size, leading_of(model))
    if rotation is not None:
        return *others, last, lambda normal: model.draw(roots, rotation.of(normal))
    return *others, lambda numbers: model.draw(roots, last(numbers))


def draw_lines(plan: LinePlan | Replicated, part: Part, size: Size, enough: int | None = None) -> PerturbedLines:
    """Perturbed lines of sight of the blocks of a part, or on each device the first `enough`."""
    steps = int(part.share) * (size.block // size.step) if enough is None else -(-enough // size.step)
    return (_draw_lines_long if size.is_long_run else _draw_lines_short)(plan, part, np.asarray(steps), size)


def draw_chunk(
    plan: FixPlan | Replicated, lines: PerturbedLines, part: Part, centre: Vector3, size: Size, keep: bool
) -> Drawn:
    """The chunk of a part from its perturbed lines of sight. Devices do not wait for each other's sums.

    Only the program of long runs has a variant without the errors of samples: that of short ones always returns them,
    so that one program serves both.
    """
    if size.is_long_run:
        return _draw_chunk_long(plan, lines, part, centre, size, keep)
    drawn = _draw_chunk_short(plan, lines, part, centre, size, True)
    return drawn if keep else drawn._replace(errors=None)


def fixes_of_points(
    plan: Plan, points: Float[Array, "points axes"], size: Size
) -> tuple[np.ndarray, np.ndarray] | None:
    """(offsets in m from the nominal fix, statuses) of the fixes of points z, with error vectors L z of the `factor` L.

    The fixes are found by the program of the samples, so that nothing large is compiled. None if the points are more
    than a block of samples.
    """
    count = len(points)
    if count > size.block:
        return None
    room = size.capacity * len(size.devices) - count
    lines = jax.tree.map(np.asarray, _lines_of_points(plan.lines, points))
    lines = jax.tree.map(lambda x: np.concatenate([x, np.broadcast_to(x[:1], (room, *x.shape[1:]))]), lines)
    if len(size.devices) > 1:
        lines = jax.device_put(lines, NamedSharding(mesh_of(size.devices), PartitionSpec("samples")))
    part = Part.of(0, count, size)
    drawn = draw_chunk(plan.sent_fixes, jax.tree.map(jnp.asarray, lines), part, jnp.zeros(3), size, True)
    drawn = drawn.of_samples(0, count, size)
    return np.nan_to_num(np.asarray(drawn.errors)), np.asarray(drawn.statuses)


@quick_filter_jit
def _lines_of_points(plan: LinePlan, points: Float[Array, "points axes"]) -> PerturbedLines:
    model = plan.model
    if model.is_normal:
        stages = (lambda point: model.draw(plan.roots, point),)
    else:
        factor = model.factor()
        stages = (lambda point: jnp.sum(factor * point[None, :], axis=1),)
    return perturbed_lines(model, plan.inputs, plan.places, stages, points)


def _draw_lines(plan: Any, part: Part, steps: HostIndex, size: Size) -> PerturbedLines:
    plan = whole(plan)

    def drawn(device: Int[Array, "1"], arrays: LinePlan, part: Part, steps: HostIndex) -> PerturbedLines:
        full = arrays._replace(places=plan.places)  # numbers, which would be arrays on each device
        first = _first_of_device(device[0], part, size.block)
        own = jnp.minimum(steps, _blocks_of_device(device[0], part, size.block) * (size.block // size.step))
        return _by_blocks(_lines_of_step, own, (size.step, size.capacity), first, full)[0]

    return _on_each(drawn, size.devices, (jnp.arange(len(size.devices)),), plan._replace(places=None), part, steps)


def _draw_chunk(plan: Any, lines: PerturbedLines, part: Part, centre: Vector3, size: Size, keep: bool) -> Drawn:
    plan = whole(plan)

    def drawn(device: Int[Array, "1"], lines: PerturbedLines, plan: FixPlan, part: Part, centre: Vector3) -> Drawn:
        args = _first_of_device(device[0], part, size.block), lines, plan, part, centre, keep
        blocks, sizes = _blocks_of_device(device[0], part, size.block), (size.block, size.capacity)
        (radii, statuses, errors), moments = _by_blocks(_fixes_of_block, blocks, sizes, *args)
        return Drawn(moments[None, :, :], radii, statuses, errors)

    return _on_each(drawn, size.devices, (jnp.arange(len(size.devices)), lines), plan, part, centre)


_draw_lines_short, _draw_lines_long = batch_filter_jit(_draw_lines), long_run_filter_jit(_draw_lines)
_draw_chunk_short, _draw_chunk_long = batch_filter_jit(_draw_chunk), long_run_filter_jit(_draw_chunk)


@eqx.filter_jit
def _lines_of_step(number: Index, step: int, first: Index, plan: LinePlan) -> tuple[PerturbedLines, tuple[()]]:
    stages = error_stages(plan.draws, plan.seeds, plan.model, plan.roots, plan.rotation)
    samples = first + number * step + jnp.arange(step)
    return perturbed_lines(plan.model, plan.inputs, plan.places, stages, samples), ()


@eqx.filter_jit
def _fixes_of_block(
    number: Index,
    block: int,
    first: Index,
    lines: PerturbedLines,
    plan: FixPlan,
    part: Part,
    centre: Vector3,
    keep: bool,
) -> tuple[Any, Float[Array, "4 4"]]:
    here = jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, number * block, block), lines)
    offset, status = offsets_of_lines(plan.nominal, plan.search, here, plan.common)
    found = counts_as_fix(status)
    error = offset - centre[None, :]
    across, up = error[:, 0] ** 2 + error[:, 1] ** 2, error[:, 2]
    radii = (jnp.sqrt(across), jnp.abs(up), jnp.sqrt(across + up**2))
    radii = tuple(jnp.where(found, radius, jnp.inf) for radius in radii)
    errors = jnp.where(found[:, None], error, jnp.nan) if keep else None
    place = first + number * block + jnp.arange(block) - part.first
    counts = found & (place >= 0) & (place < part.count)
    return (radii, status, errors), _moments(error, counts)


def _first_of_device(device: Index, part: Part, block: int) -> Index:
    """Number of the first sample of a device's share; blocks begin at multiples of their size."""
    return (jnp.asarray(part.first) // block + device * part.share) * block


def _blocks_of_device(device: Index, part: Part, block: int) -> Index:
    """Number of blocks that a device draws."""
    left = _blocks_of(jnp.asarray(part.first), part.count, block) - device * part.share
    return jnp.clip(left, 0, part.share)


def _by_blocks(function: Any, blocks: HostIndex, size: tuple[int, int], *args: Any) -> tuple[Any, Any]:
    """`function(number, block, *args)` of some blocks: results per item, and the sums of the results per block.

    `size` is that of a block, and the items for which there is room.
    """
    block, capacity = size
    zeros = lambda x, *size: jnp.zeros((*size, *x.shape[len(size) :]), x.dtype)  # noqa: E731
    each, total = eqx.filter_eval_shape(function, jnp.asarray(0), block, *args)
    start = jax.tree.map(lambda x: zeros(x, capacity), each), jax.tree.map(zeros, total)

    def add(number: Index, state: tuple[Any, Any]) -> tuple[Any, Any]:
        here, more = function(number, block, *args)
        put = lambda all_, some: jax.lax.dynamic_update_slice_in_dim(all_, some, number * block, 0)  # noqa: E731
        return jax.tree.map(put, state[0], here), jax.tree.map(jnp.add, state[1], more)

    return jax.lax.fori_loop(0, blocks, add, start)


def _on_each(function: Callable[..., Any], devices: tuple[Any, ...], spread: tuple[Any, ...], *common: Any) -> Any:
    """`function` on each device, of its part of `spread` (leading axis) and of what is common to all."""
    if len(devices) == 1:
        return function(*spread, *common)
    everywhere, in_turn = PartitionSpec(), PartitionSpec("samples")
    specs = (in_turn,) * len(spread) + (everywhere,) * len(common)
    every = jax.shard_map(function, mesh=mesh_of(devices), in_specs=specs, out_specs=in_turn, check_vma=False)
    return every(*spread, *common)


def _moments(error: Float[Array, "part 3"], counts: Flags) -> Float[Array, "4 4"]:
    """Sums of the products of (east, north, up, 1) over the counted samples, in one pass over the part."""
    known = [jnp.where(counts, x, 0.0) for x in (*error.T, jnp.ones(error.shape[0]))]
    products = [known[i] * known[j] for i, j in _PAIRS]
    sums = jax.lax.reduce(
        products, [0.0] * len(products), lambda a, b: [x + y for x, y in zip(a, b, strict=True)], (0,)
    )
    return jnp.stack(sums)[_PLACES]


def one_ahead(
    plan: Plan, parts: Iterator[tuple[int, int]], centre: Vector3, size: Size, keep: bool
) -> Iterator[tuple[int, int, Drawn]]:
    """(first sample, number of samples, drawn samples) chunk by chunk; the next chunk is drawn in the meantime."""
    waiting = None
    for first, count in parts:
        part = Part.of(first, count, size)
        drawn = draw_chunk(plan.sent_fixes, draw_lines(plan.sent_lines, part, size), part, centre, size, keep)
        if waiting is not None:
            yield waiting
        waiting = first, count, drawn
    if waiting is not None:
        yield waiting


def chunks(first: int, count: int, size: Size, progress: bool) -> Iterator[tuple[int, int]]:
    """(first sample, number of samples) of the chunks of a part; they end at the end of a block, which no two draw."""
    most = size.capacity * len(size.devices)
    parts, end = [], first + count
    while first < end:
        last = min(first // size.block * size.block + most, end)
        parts.append((first, last - first))
        first = last
    if not progress:
        yield from parts
        return
    from rich.progress import track  # optional, imported only if used

    yield from track(parts, description="sampling")
