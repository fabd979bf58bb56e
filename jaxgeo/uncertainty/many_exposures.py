"""Accuracy of the fixes of many exposures, in blocks of bounded memory."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import as_float64, given_array, is_known
from jaxgeo._compile import ROWS, batch_filter_jit, maps_in_blocks
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._typing import Scalar
from jaxgeo.fix import Fix
from jaxgeo.sensor import Shot
from jaxgeo.status import have_fix
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Bracket
from jaxgeo.uncertainty.accuracy_record import Accuracy, batch_of
from jaxgeo.uncertainty.host_arrays import blocks_of, concatenate, take
from jaxgeo.uncertainty.linear import OverSlope, derivatives
from jaxgeo.uncertainty.linear_accuracy import LinearAccuracy, assess_fix, linear_radii, select_known
from jaxgeo.uncertainty.many_fixes import Assessed, Normality, Perturbed, assess_blocks, examine_block, size_of_blocks
from jaxgeo.uncertainty.map_cells import Request, check_block, check_level
from jaxgeo.uncertainty.method_selection import LEVEL, NO_FIX, Diagnostics, Method, diagnose
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, located_apart, nominal_fix_of, of_arrays
from jaxgeo.uncertainty.normality import is_normal_over
from jaxgeo.uncertainty.sampled import sample_where_needed
from jaxgeo.uncertainty.sampling import Sampling

NAMES = ("sensor", "shot", "uv", "terrain", "errors", "time", "atmosphere")
OWN_AXES = 5  # of which in_axes tells; times and atmospheres are batches by their shape

Axes = tuple[int | None, ...]


class Batch(NamedTuple):
    """Arguments for n exposures, checked and in float64, in the order of `NAMES`; those with axis 0 are batches."""

    given: tuple[Any, ...]
    axes: Axes

    @property
    def lanes(self) -> tuple[Any, ...]:
        """The batched arguments, None in place of shared ones."""
        return tuple(one if axis == 0 else None for one, axis in zip(self.given, self.axes, strict=True))

    @property
    def shared(self) -> tuple[Any, ...]:
        """The shared arguments, None in place of batches."""
        return tuple(None if axis == 0 else one for one, axis in zip(self.given, self.axes, strict=True))

    def at(self, index: int) -> tuple[Any, ...]:
        """The arguments of one exposure."""
        return _merge(take(self.lanes, index), self.shared, self.axes)

    def repeated(self, index: int, count: int) -> Batch:
        """`count` times one exposure."""
        return self._replace(given=_merge(take(self.lanes, np.full(count, index)), self.shared, self.axes))


def accuracy_of_exposures(given: tuple[Any, ...], in_axes: Axes, request: Request) -> Accuracy:
    """`accuracy` of n exposures, of arguments in the order of `NAMES`; traced ones are evaluated all at once."""
    batch, number = check_batch(given, in_axes, request.search)
    note = batch.given[NAMES.index("errors")].left_out
    if not is_known(batch.given):
        nominals, found = _assess_traced(batch, request)
        return _of_traced(nominals, found, linear_radii(found, request.probability), request.probability, note)
    if number == 1:
        nominals, found, radii = _assess_one(batch.at(0), request)
    else:
        size = size_of_blocks(number, request.block)
        lanes: Any = batch.lanes, _located(batch, number, request)
        parts = blocks_of(lanes, size, "estimating accuracy", request.sampling.progress)
        blocks = (_perturbed(own, met, batch, request.search) for own, met in parts)
        terrain_axis = batch.axes[NAMES.index("terrain")]
        nominals, found, radii = assess_blocks(blocks, number, terrain_axis, request.probability)

    def observation_at(index: int) -> tuple[ModelInputs, NominalFix, ErrorModel]:
        inputs, model = inputs_of(batch.at(index))
        return inputs, take(nominals, index), model

    probability, sampling = float(request.probability), request.sampling
    columns = sample_where_needed(found.method, radii, observation_at, request.search, sampling, probability)
    linear = (found.method, found.cov_enu, found.bias_enu, found.diagnostics)
    return batch_of(nominals.fix, probability, columns, *linear, int(sampling.count or 0), (number,), note)


def variances_by_axis(given: tuple[Any, ...], in_axes: Axes, index: int) -> np.ndarray:
    """Horizontal variance in m2 of one of n fixes by each axis of its errors (axes,), by linear propagation over the
    facet; NaN without a fix.

    Compiles nothing after `accuracy` of the same exposures: its programs assess the one, repeated, as a block of them.
    Axes share what they vary together in equal parts.
    """
    batch, number = check_batch(given, in_axes, FIRST_HIT)
    if number == 1:
        inputs, model = inputs_of(batch.at(0))
        found = diagnose(inputs, inputs.nominal_fix(FIRST_HIT), model).facet
        jacobian, cov = np.asarray(found.jacobian), np.asarray(found.cov_error)
    else:
        same = batch.repeated(index, min(number, ROWS))
        request = Request(check_level(LEVEL), Sampling(), FIRST_HIT, size_of_blocks(number, check_block(None)))
        lanes = take((same.lanes, _located(same, min(number, ROWS), request)), np.zeros(request.block, int))
        perturbed, terrain, _ = _perturbed(*lanes, same, FIRST_HIT)
        facet = examine_block(perturbed, terrain, same.axes[NAMES.index("terrain")]).facet
        size = batch.given[NAMES.index("errors")].size
        jacobian, cov = np.asarray(facet.jacobian)[0, :, :size], np.asarray(perturbed.shared.cov_error)[0, :size, :size]
    return np.sum(jacobian[:2] * (jacobian[:2] @ cov), axis=0)


def check_batch(given: tuple[Any, ...], in_axes: Axes, search: AbstractSearch) -> tuple[Batch, int]:
    """(the arguments in float64 with their axes, number of exposures); the first exposure is checked as alone."""
    sensor, shot, uv, terrain, errors, time, air = given
    model = errors if isinstance(errors, ErrorModel) else ErrorModel(_as_tuple(errors))
    pixels = jnp.asarray(as_float64(given_array(uv, "uv", "the pixels (column, row)"), "uv"))
    axes = in_axes if len(in_axes) != 3 else (*in_axes[:1] * 3, *in_axes[1:])
    if len(axes) != OWN_AXES or not all(axis in (0, None) for axis in axes):
        raise ValueError(
            f"in_axes must be 0 or None for each of {', '.join(NAMES[:OWN_AXES])}, or of observation, terrain, errors; "
            f"got {in_axes!r}."
        )
    axes = (*axes, *(0 if _has_axis(one) else None for one in (time, air)))
    batch = Batch((sensor, shot, pixels, terrain, model, time, air), axes)
    number = _length(batch)
    *scene, first_model, first_time, first_air = batch.at(0)
    given_first: Any = scene
    options: Any = {"time": first_time, "search": search, "atmosphere": first_air, "of_many": True}
    checked_model(first_model, ModelInputs.of(*given_first, **options))
    sensor, shot, model = as_float64(sensor, "sensor"), as_float64(shot, "shot"), as_float64(model, "errors")
    time = jnp.asarray(as_float64(0.0 if time is None else time, "time"))
    air = as_float64(air, "atmosphere")
    return Batch((sensor, shot, pixels, of_arrays(terrain), model, time, air), axes), number


def _as_tuple(errors: Any) -> tuple[Any, ...]:
    return tuple(errors) if isinstance(errors, tuple | list) else (errors,)


def _has_axis(tree: Any) -> bool:
    return any(np.ndim(leaf) for leaf in jax.tree.leaves(tree))


def _length(batch: Batch) -> int:
    """Number of exposures; raises `ValueError` for unequal batches."""
    lengths: dict[int, str] = {}
    for name, lanes in zip(NAMES, batch.lanes, strict=True):
        for leaf in jax.tree.leaves(lanes):
            if np.ndim(leaf) < 1:
                raise ValueError(f"{name} is a batch by in_axes, but holds a single number; stack n into one record.")
            lengths.setdefault(np.shape(leaf)[0], name)
    if len(lengths) != 1 or 0 in lengths:
        found = ", ".join(f"{name} {length}" for length, name in lengths.items()) or "no batch at all"
        raise ValueError(f"batches must have one length, 1 or more; got {found} (in_axes {batch.axes[:OWN_AXES]!r}).")
    return next(iter(lengths))


def _merge(own: tuple[Any, ...], shared: tuple[Any, ...], axes: Axes) -> tuple[Any, ...]:
    return tuple(a if axis == 0 else b for a, b, axis in zip(own, shared, axes, strict=True))


def inputs_of(given: tuple[Any, ...]) -> tuple[ModelInputs, ErrorModel]:
    """Forward-model inputs and error model of one exposure."""
    sensor, shot, uv, terrain, model, time, air = given
    return ModelInputs.of_checked(sensor, shot, time, uv, terrain, air), model


def _assess_one(given: tuple[Any, ...], request: Request) -> Assessed:
    """The same of one exposure, by the programs of a call of `accuracy` for it."""
    inputs, model = inputs_of(given)
    nominal = inputs.nominal_fix(request.search)
    if have_fix(nominal.fix.status):
        found = select_known(diagnose(inputs, nominal, model), nominal, request.probability)
    else:
        unknown: Any = np.full(len(Diagnostics._fields), np.nan)
        figures: Any = np.full((3, 3), np.nan), np.full(3, np.nan), Diagnostics(*unknown), np.ones(2)
        found = LinearAccuracy(jnp.asarray(NO_FIX), *figures)
    radii: Any = linear_radii(found, request.probability)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[None], Assessed(nominal, found, radii))


def _located(batch: Batch, number: int, request: Request) -> tuple[Fix, Bracket] | None:
    """Fixes of n exposures and where the search found the ground, by the programs of every `vmap` of `locate`.

    None where the fixes are better found by the program of the accuracy, as with a terrain for each.
    """
    if not isinstance(batch.given[NAMES.index("shot")], Shot) or not maps_in_blocks(batch.lanes):
        return None

    def one(own: tuple[Any, ...]) -> tuple[Fix, Bracket]:
        inputs, _ = inputs_of(_merge(own, batch.shared, batch.axes))
        return located_apart(inputs, inputs.uv, request.search)

    parts = blocks_of(batch.lanes, min(number, ROWS), "intersecting rays", request.sampling.progress)
    return concatenate([jax.vmap(one)(part) for part in parts], number)


def _perturbed(
    lanes: tuple[Any, ...], located: tuple[Fix, Bracket] | None, batch: Batch, search: AbstractSearch
) -> tuple[Perturbed, AbstractTerrain, Normality | None]:
    """A block of observations for `assess_blocks`."""
    number = NAMES.index("terrain")
    terrain = lanes[number] if batch.axes[number] == 0 else batch.shared[number]
    model = batch.given[NAMES.index("errors")]
    found = _derivatives_block(lanes, located, batch.shared, batch.axes, search)
    normality = None if model.is_normal else functools.partial(_normality_block, lanes, batch.shared, batch.axes)
    return found, terrain, normality


@batch_filter_jit
def _derivatives_block(
    lanes: tuple[Any, ...],
    located: tuple[Fix, Bracket] | None,
    shared: tuple[Any, ...],
    axes: Axes,
    search: AbstractSearch,
) -> Perturbed:
    """Nominal fixes and the derivatives by the errors; of those that are `located` already, without a search."""

    def one(own: tuple[Any, ...], met: tuple[Fix, Bracket] | None) -> Perturbed:
        inputs, model = inputs_of(_merge(own, shared, axes))
        nominal = inputs.nominal_fix(search) if met is None else nominal_fix_of(inputs, *met)
        return Perturbed(nominal, derivatives(inputs, nominal, model).shared)

    return jax.vmap(one)(lanes, located)


@batch_filter_jit
def _normality_block(
    lanes: tuple[Any, ...],
    shared: tuple[Any, ...],
    axes: Axes,
    nominals: NominalFix,
    facet: OverSlope,
    footprint: OverSlope,
) -> tuple[Any, Any]:
    def one(own: tuple[Any, ...], nominal: NominalFix, *over: OverSlope) -> tuple[Any, ...]:
        inputs, model = inputs_of(_merge(own, shared, axes))
        return tuple(is_normal_over(inputs, nominal, model, each) for each in over)

    return jax.vmap(one)(lanes, nominals, facet, footprint)


def _assess_traced(batch: Batch, request: Request) -> tuple[NominalFix, LinearAccuracy]:
    """Nominal fixes and their accuracy, as part of the caller's program."""

    def one(own: tuple[Any, ...]) -> tuple[NominalFix, LinearAccuracy]:
        inputs, model = inputs_of(_merge(own, batch.shared, batch.axes))
        nominal = inputs.nominal_fix(request.search)
        return nominal, assess_fix(inputs, nominal, model, request.probability)

    return jax.vmap(one)(batch.lanes)


def _of_traced(
    nominals: NominalFix, found: LinearAccuracy, radii: tuple[Any, ...], probability: Scalar, note: str | None
) -> Accuracy:
    """The record of traced fixes, without samples."""
    is_linear = (found.method == Method.facet) | (found.method == Method.footprint)
    cov = jnp.where(is_linear[:, None, None], found.cov_enu, jnp.nan)
    bias = jnp.where(is_linear[:, None], found.bias_enu, jnp.nan)
    level, unknown = jnp.broadcast_to(probability, is_linear.shape), jnp.full(is_linear.shape, jnp.nan)
    circular, linear, spherical = radii
    figures = (circular, linear, spherical, found.method, cov, bias, unknown)
    return Accuracy(nominals.fix, level, *figures, found.diagnostics, note=note)
