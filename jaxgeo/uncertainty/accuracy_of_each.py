"""Accuracy of the fixes of many exposures: batched `accuracy`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import as_array, as_float64
from jaxgeo._record import Record
from jaxgeo._typing import IndexField, Matrix3Field, Numbers, Scalar, ScalarField, Vector3Field
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.locate import FIRST_HIT
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.accuracy import reason
from jaxgeo.uncertainty.assess import Judged, judged, linear_figures
from jaxgeo.uncertainty.draws import AbstractDraws, Random
from jaxgeo.uncertainty.map_cells import Request, requested, with_bar
from jaxgeo.uncertainty.method_selection import Diagnostics, Method
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sampled import CHUNK, Sampling, sampled_at

BLOCK = 128  # fixes evaluated at once
FEW = 16  # block size for few fixes; only the sizes 1, 16 and `block` are compiled, once each
SAMPLES = 20_000
RANDOM = Random()
NAMES = ("sensor", "shot", "uv", "terrain", "errors")


class AccuracyOfEach(Record):
    """Accuracy of n fixes: radii in m that contain the true point with `probability`; all arrays have length n.

    `circular`, `linear`, `spherical` as in `Accuracy`; `trust` is the method used (codes of `Method`). They are
    infinite where too many samples have no fix, and NaN where samples are needed but not drawn (`count` 0) or there is
    no fix: `trust` is then `NO_FIX` (-1), and `fix.status` gives the reason. `cov_enu` (n, 3, 3) in m² and `bias_enu`
    (n, 3) in m, east, north, up, are from linear propagation, NaN where it is not valid. `signs` are the diagnostics.
    """

    fix: Fix
    probability: float
    circular: ScalarField
    linear: ScalarField
    spherical: ScalarField
    trust: IndexField
    cov_enu: Matrix3Field
    bias_enu: Vector3Field
    signs: Diagnostics
    count: int

    def because(self, index: int) -> str | None:
        """Why the method of fix `index` was selected and no cheaper one, in words; None without a fix."""
        code = int(np.asarray(self.trust)[index])
        if code < 0:
            return None
        return reason(jax.tree.map(lambda sign: np.asarray(sign)[index], self.signs), Method(code))


def accuracy_of_each(
    sensor: Sensor,
    shot: Shot,
    uv: ArrayLike | Sequence[Any],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    in_axes: tuple[int | None, ...] = (None, 0, 0, None, None),
    probability: float = 0.9,
    count: int = SAMPLES,
    key: Any = None,
    draws: AbstractDraws = RANDOM,
    chunk: int = CHUNK,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    block: int = BLOCK,
    progress: bool = False,
) -> AccuracyOfEach:
    """`accuracy` of the fixes of many exposures, `block` at a time, which bounds the memory.

    `in_axes`, as for `jax.vmap`, is 0 for each of the five arguments that is a batch and None for one shared by all: by
    default n shots, each with its pixel in `uv` (n, 2). Where samples are needed, `count` are drawn for each fix, all
    with the same `key` (default `jax.random.key(0)`); with a `count` of 0 there are no figures there. An observation
    without a fix has a status and no figures. `progress` shows progress bars. For many pixels of one image see
    `accuracy_of_pixels`. Raises as `accuracy`, but not for a missing fix; `ValueError` for unequal batch lengths.
    """
    request = requested(probability, count, key, draws, chunk, search, block)
    pixels = jnp.asarray(as_float64(as_array(uv, "uv"), "uv"))
    world = _World((sensor, shot, pixels, terrain, _as_model(errors)), tuple(in_axes), search, atmosphere)
    number = _length(world)
    first, model = world.at(0)
    checked_model(model, first)  # raises for invalid arguments
    parts = _blocks(world.lanes, number, request.block, progress)
    answers = [_judged(part, world.shared, world.axes, search, atmosphere, request.probability) for part in parts]
    aims, told, figures = jax.tree.map(lambda *leaves: jnp.asarray(np.concatenate(leaves)[:number]), *answers)
    is_linear = np.isin(told.trust, [Method.facet, Method.footprint])
    circular, linear, spherical = _with_samples(figures, told.trust, aims, world, request, progress)
    return AccuracyOfEach(
        fix=aims.fix,
        probability=float(probability),
        circular=circular,
        linear=linear,
        spherical=spherical,
        trust=told.trust,
        cov_enu=jnp.asarray(np.where(is_linear[:, None, None], told.cov_enu, np.nan)),
        bias_enu=jnp.asarray(np.where(is_linear[:, None], told.bias_enu, np.nan)),
        signs=told.signs,
        count=request.count,
    )


class _World(NamedTuple):
    """Arguments for n exposures, in the order of `NAMES`, and which of them are batches."""

    given: tuple[Any, ...]
    axes: tuple[int | None, ...]
    search: AbstractSearch
    air: Atmosphere | None

    @property
    def lanes(self) -> tuple[Any, ...]:
        """The batched arguments, None in place of shared ones."""
        return tuple(one if axis == 0 else None for one, axis in zip(self.given, self.axes, strict=True))

    @property
    def shared(self) -> tuple[Any, ...]:
        """The shared arguments, None in place of batches."""
        return tuple(None if axis == 0 else one for one, axis in zip(self.given, self.axes, strict=True))

    def at(self, index: int) -> tuple[ModelInputs, ErrorModel]:
        """Forward-model inputs and error model of one exposure."""
        own = _lane(self.lanes, index)
        return _look(_whole(own, self.shared, self.axes), self.search, self.air)


def _as_model(errors: Any) -> ErrorModel:
    if isinstance(errors, ErrorModel):
        return errors
    return ErrorModel(tuple(errors) if isinstance(errors, tuple | list) else (errors,))


def _length(world: _World) -> int:
    """Number of exposures; raises `ValueError` for invalid `in_axes` or batches."""
    if len(world.axes) != len(NAMES) or not all(axis in (0, None) for axis in world.axes):
        raise ValueError(f"in_axes must be 0 or None for each of {', '.join(NAMES)}; got {world.axes!r}.")
    lengths: dict[int, str] = {}
    for name, lanes in zip(NAMES, world.lanes, strict=True):
        for leaf in jax.tree.leaves(lanes):
            if np.ndim(leaf) < 1:
                raise ValueError(f"{name} is a batch by in_axes, but holds a single number; stack n into one record.")
            lengths.setdefault(np.shape(leaf)[0], name)
    if len(lengths) != 1 or 0 in lengths:
        found = ", ".join(f"{name} {length}" for length, name in lengths.items()) or "no batch at all"
        raise ValueError(f"batches must have one length, 1 or more; got {found} (in_axes {world.axes!r}).")
    return next(iter(lengths))


def _lane(lanes: Any, index: int | np.ndarray) -> Any:
    """One or several entries of batches, indexed by NumPy so that a new batch length compiles nothing."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[index]), lanes)


def _blocks(lanes: Any, count: int, most: int, progress: bool) -> Iterator[Any]:
    """Batches in blocks of one of a few sizes; the last block is padded with the last entry."""
    host = jax.tree.map(np.asarray, lanes)
    size = next((size for size in (1, FEW) if count <= size < most), most)
    starts = range(0, count, size)
    for start in with_bar(starts, len(starts), "estimating accuracy", progress):
        yield _lane(host, np.minimum(np.arange(start, start + size), count - 1))


def _whole(own: tuple[Any, ...], shared: tuple[Any, ...], axes: tuple[int | None, ...]) -> tuple[Any, ...]:
    return tuple(a if axis == 0 else b for a, b, axis in zip(own, shared, axes, strict=True))


def _look(given: tuple[Any, ...], search: AbstractSearch, air: Atmosphere | None) -> tuple[ModelInputs, ErrorModel]:
    *scene, model = given
    look = ModelInputs.of(*scene, search=search, atmosphere=air)
    return look, as_float64(model, "errors")


@eqx.filter_jit
def _judged(
    lanes: tuple[Any, ...],
    shared: tuple[Any, ...],
    axes: tuple[int | None, ...],
    search: AbstractSearch,
    air: Atmosphere | None,
    probability: Scalar,
) -> tuple[NominalFix, Judged, tuple[Numbers, Numbers, Numbers]]:
    def one(own: tuple[Any, ...]) -> tuple[NominalFix, Judged]:
        look, model = _look(_whole(own, shared, axes), search, air)
        aim = look.nominal_fix(search)
        return aim, judged(look, aim, model)

    if jax.tree.leaves(lanes)[0].shape[0] == 1:  # without vmap: traced in half the time
        aims, told = jax.tree.map(lambda leaf: leaf[None], one(jax.tree.map(lambda leaf: leaf[0], lanes)))
    else:
        aims, told = jax.vmap(one)(lanes)
    return aims, told, linear_figures(told, probability)


def _with_samples(
    figures: tuple[Numbers, ...], trust: IndexField, aims: NominalFix, world: _World, request: Request, progress: bool
) -> list[Numbers]:
    """The radii, from samples where these are needed."""
    index = np.flatnonzero(np.asarray(trust) == Method.samples)
    radii = [np.array(radius) for radius in figures]
    if not request.count or not index.size:
        return [jnp.asarray(radius) for radius in radii]
    sampling = Sampling(request.key, request.count, request.draws, chunk=request.chunk)
    level = float(request.probability)
    for number in with_bar(index.tolist(), index.size, "sampling", progress):
        look, model = world.at(number)
        drawn = sampled_at(look, model, request.search, sampling, _lane(aims, number))
        doors = (drawn.circular_error, drawn.linear_error, drawn.spherical_error)
        for radius, door in zip(radii, doors, strict=True):
            radius[number] = door(level).value
    return [jnp.asarray(radius) for radius in radii]
