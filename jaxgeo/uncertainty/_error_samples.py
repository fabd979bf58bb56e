"""Monte Carlo samples as a pure function of their numbers: for `jit`, `vmap` and `jax.export`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int, Int8

from jaxgeo._checks import concrete
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import Record
from jaxgeo._typing import StatusCode
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status, counts_as_fix
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.batched_rays import (
    block_size,
    common_ground,
    offsets_of_lines,
    perturbed_lines,
    places_of_ground,
)
from jaxgeo.uncertainty.chunks import error_stages, leading_of
from jaxgeo.uncertainty.draws import AbstractDraws, Random, Sobol
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.rotation import Trial, rotation_of
from jaxgeo.uncertainty.sampling import check_key, checked_draws


class ErrorSamples(Record):
    """Errors of sampled fixes in east, north, up at the nominal fix, m (..., 3), NaN without a fix, and statuses."""

    errors_enu: Float[Array, "... 3"]
    status: Int8[Array, "..."]


@accepts_observation
def error_samples(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    key: Any,
    indices: ArrayLike,
    *,
    draws: AbstractDraws | None = None,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
) -> ErrorSamples:
    """The samples with these numbers (...) that `sample` draws of the same arguments with `key` and `draws`, up to
    rounding (1e-8 m): a pure function. Unlike those of `sample` they are independent by default: `Random()`.

    It works under `jit`, `vmap` over any argument, and `jax.export`, also for a symbolic number of indices; call it
    inside of `jit`, with the terrain as an argument. Blocks of 3392 samples are computed at a time. Without a nominal
    fix, all samples have its status and NaN. Differentiate `propagate` instead. `sample` adds counts, moments,
    quantiles and bounded memory on the host.

    Raises as `sample` for invalid arguments, and `TypeError` for indices that are not integers.

    >>> sensor = jaxgeo.Sensor(jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000))
    >>> shot = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0))
    >>> errors = jaxgeo.uncertainty.sources.Position.from_ned(north=1.0, east=1.0, down=2.0)
    >>> scene = sensor, shot, (1999.5, 1499.5), jaxgeo.ConstantHeight(600.0), errors
    >>> import jax
    >>> found = jax.jit(jaxgeo.uncertainty.error_samples)(*scene, jax.random.key(0), np.arange(4))
    >>> same = {"key": jax.random.key(0), "draws": jaxgeo.uncertainty.Random()}
    >>> drawn = jaxgeo.sample(*scene, **same, count=4, keep=True)
    >>> print(np.max(np.abs(found.errors_enu - drawn.errors_enu)) < 1e-8)
    True
    """
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    model = checked_model(errors, inputs, moments=0)
    check_key(key)
    draws = checked_draws(Random() if draws is None else draws)
    numbers = _checked_numbers(indices, draws.most)
    errors_enu, status = _errors_of(inputs, model, search, draws, key, numbers.reshape(-1))
    return ErrorSamples(errors_enu.reshape(*numbers.shape, 3), status.reshape(numbers.shape))


def _checked_numbers(indices: ArrayLike, most: int) -> Int[Array, "..."]:
    """The numbers of samples as 64-bit integers; raises for concrete ones that are not from 0 to `most` - 1."""
    numbers = jnp.asarray(indices)
    if not jnp.issubdtype(numbers.dtype, jnp.integer):
        raise TypeError(f"indices must be the whole numbers of samples, from 0 on; got {numbers.dtype}.")
    known = concrete(numbers)
    if known is not None and known.size and not 0 <= int(known.min()) <= int(known.max()) < most:
        raise ValueError(f"indices must be from 0 to {most - 1}; got {known.min()} to {known.max()}.")
    return numbers.astype(jnp.int64)


def _errors_of(
    inputs: ModelInputs,
    model: ErrorModel,
    search: AbstractSearch,
    draws: AbstractDraws,
    key: Any,
    numbers: Int[Array, " samples"],
) -> tuple[Float[Array, "samples 3"], Int8[Array, " samples"]]:
    nominal = inputs.nominal_fix(search)
    model = model.at(inputs, nominal)
    places = places_of_ground(model, inputs)
    roots = model.roots()
    rotation = None
    if isinstance(draws, Sobol):
        trial = Trial.of(draws, model.size, leading_of(model))
        error_of = (lambda normal: model.draw(roots, normal),)
        lines = perturbed_lines(model, inputs, places, error_of, jnp.asarray(trial.normal))
        rotation = rotation_of(trial, lines, inputs, nominal, places, jnp)
    stages = error_stages(draws, key, model, roots, rotation)

    def of_block(numbers: Int[Array, " block"]) -> tuple[Any, Any]:
        lines = perturbed_lines(model, inputs, places, stages, numbers)
        offset, status = offsets_of_lines(nominal, search, lines, common_ground(inputs, places))
        status = jnp.where((numbers >= 0) & (numbers < draws.most), status, Status.invalid_input.code)
        return jnp.where(counts_as_fix(status)[:, None], offset, jnp.nan), status

    return _without_nominal(nominal, *_in_whole_blocks(of_block, numbers))


def _without_nominal(nominal: NominalFix, errors: Any, status: Any) -> tuple[Any, Any]:
    """Samples with the status of the nominal fix if there is none."""
    code: StatusCode = jnp.asarray(nominal.fix.status)
    exists = counts_as_fix(code)
    return jnp.where(exists, errors, jnp.nan), jnp.where(exists, status, code)


def _in_whole_blocks(function: Any, numbers: Int[Array, " samples"]) -> Any:
    """`function` of blocks of one size, so that only the number of blocks depends on that of the samples."""
    count, block = numbers.shape[0], block_size()
    if isinstance(count, int) and count <= block:
        return function(numbers) if count else jax.tree.map(lambda x: x[:0], function(jnp.zeros(1, numbers.dtype)))
    blocks = -(-count // block)
    padded = jnp.concatenate([numbers, jnp.zeros(blocks * block - count, numbers.dtype)])
    found = jax.lax.map(function, padded.reshape(blocks, block))
    return jax.tree.map(lambda x: x.reshape(blocks * block, *x.shape[2:])[:count], found)
