"""Ground positions and residuals of the blocks of a registration."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from jaxgeo._compile import batch_filter_jit
from jaxgeo._locate import locate
from jaxgeo._record import Record
from jaxgeo.earth import Atmosphere, Geodetic, R_ecef_from_enu
from jaxgeo.fix import Fix
from jaxgeo.register.prediction import in_chunks
from jaxgeo.register.registration import Registration
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain


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
    scene = _Scene(registration.sensor, registration.shot, registration.terrain, time, atmosphere)
    lat, lon, height, on_ground = in_chunks(
        lambda rows: _on_ground(scene, rows), np.concatenate([uv, residual], axis=1)
    )
    return BlockPlaces(uv, Geodetic(lat=lat, lon=lon, height=height), tie, on_ground)


class _Scene(Record):
    """Forward-model inputs of the ground positions."""

    sensor: Sensor
    motion: Shot | Trajectory
    terrain: AbstractTerrain
    time: Any
    air: Atmosphere | None


@batch_filter_jit
def _on_ground(scene: _Scene, rows: Float[Array, "n 4"]) -> tuple[Array, Array, Array, Array]:
    """(lat, lon, height of the ground, residual there) for rows of a pixel and its residual."""

    def ground(pixel: Float[Array, "2"]) -> tuple[Array, Fix]:
        fix = locate(scene.sensor, scene.motion, pixel, scene.terrain, time=scene.time, atmosphere=scene.air)
        return fix.ecef, fix

    def one(row: Float[Array, "4"]) -> tuple[Array, Array, Array, Array]:
        is_pixel = jnp.isfinite(row[0])
        by_pixel, fix = jax.jacfwd(ground, has_aux=True)(jnp.where(is_pixel, row[:2], 0.0))
        found = is_pixel & (jnp.asarray(fix.status) == Status.hit)
        here = fix.position
        safe = Geodetic(lat=jnp.where(found, here.lat, 0.0), lon=jnp.where(found, here.lon, 0.0), height=jnp.zeros(()))
        aside = R_ecef_from_enu(safe)[:, :2].T @ by_pixel @ row[2:]
        lat, lon, height = (jnp.where(found, jnp.asarray(x), jnp.nan) for x in (here.lat, here.lon, here.height))
        return lat, lon, height, jnp.where(found, aside, jnp.nan)

    return jax.vmap(one)(rows)
