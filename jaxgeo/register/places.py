"""Ground positions and residuals of the blocks of a registration."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from jaxgeo._arguments import checked_air, checked_exposure
from jaxgeo._compile import batch_filter_jit
from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.fix import Fix
from jaxgeo.observation import Exposure
from jaxgeo.register.prediction import in_chunks
from jaxgeo.register.registration import Registration
from jaxgeo.status import Status
from jaxgeo.terrain import Bracket
from jaxgeo.uncertainty.model_inputs import ModelInputs, located_each, nominal_fix_of


class BlockPlaces(NamedTuple):
    """Blocks of the last pass: the pixels `uv` (n, 2) of their centres and the ground positions (n,) that these see
    from the registration's shot, NaN if none. `tie` (n,) is the index of a block's tie point, -1 for none;
    `residual` (n, 2) is the tie residual in m east and north on the ground, image position minus reference position
    corrected for the map shift; NaN without a tie or an update.
    """

    uv: Float[Any, "n 2"]
    ground: Geodetic
    tie: Int[Any, " n"]
    residual: Float[Any, "n 2"]

    @property
    def known(self) -> Bool[np.ndarray, " n"]:
        """Flags of blocks with a ground position."""
        return np.isfinite(np.asarray(self.ground.lat))


def places_of_blocks(
    registration: Registration, *, time: ArrayLike | None = None, atmosphere: Atmosphere | None = None
) -> BlockPlaces:
    """Ground positions of the blocks of the last pass, from the updated shot if there is one, else from the
    navigation's.

    `time` (of a trajectory) and `atmosphere` are as for `register_image`. Raises `ValueError` for a registration
    without a pass.
    """
    if not registration.passes:
        raise ValueError(f"no block was matched: {registration.outcome.name}: {registration.outcome.message}")
    last, update = registration.passes[-1], registration.update
    visible = np.asarray(last.shifts.visible)
    uv = np.where(visible[:, None], np.asarray(last.shifts.uv), np.nan)
    tied = np.asarray(last.chosen.is_chosen) & visible
    tie = np.full(len(uv), -1)
    tie[tied] = np.arange(np.count_nonzero(tied))
    residual = np.full((len(uv), 2), np.nan)
    if update is not None:
        residual[tied] = np.asarray(update.residuals)
        time, atmosphere = update.time, update.atmosphere
    sensor, motion, moment = checked_exposure(registration.sensor, registration.shot, time)
    inputs = ModelInputs(Exposure(sensor, motion, moment, checked_air(atmosphere)), terrain=registration.terrain)
    rows = np.concatenate([uv, residual], axis=1)
    lat, lon, height, on_ground = in_chunks(lambda rows: _on_ground(inputs, rows), rows)
    return BlockPlaces(uv, Geodetic(lat=lat, lon=lon, height=height), tie, on_ground)


def _on_ground(inputs: ModelInputs, rows: Float[Array, "n 4"]) -> tuple[Array, Array, Array, Array]:
    """(lat, lon, height of the ground, residual there) for rows of a pixel and its residual."""
    return _with_residuals(inputs, rows, *located_each(inputs, rows[:, :2]))


@batch_filter_jit
def _with_residuals(
    inputs: ModelInputs, rows: Float[Array, "n 4"], fixes: Fix, brackets: Bracket
) -> tuple[Array, Array, Array, Array]:
    def one(row: Float[Array, "4"], fix: Fix, bracket: Bracket) -> tuple[Array, Array, Array, Array]:
        found, here = jnp.asarray(fix.status) == Status.hit, fix.position
        uv = jnp.where(found, row[:2], 0.0)
        nominal = nominal_fix_of(dataclasses.replace(inputs, uv=uv), fix, bracket)
        by_pixel = jax.jacfwd(lambda uv: dataclasses.replace(inputs, uv=uv).linear_offset(nominal))(uv)
        lat, lon, height = (jnp.where(found, jnp.asarray(x), jnp.nan) for x in (here.lat, here.lon, here.height))
        return lat, lon, height, jnp.where(found, by_pixel[:2] @ row[2:], jnp.nan)

    return jax.vmap(one)(rows, fixes, brackets)
