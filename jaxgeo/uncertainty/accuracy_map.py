"""Accuracy maps over the ground of an image or an area seen from a pose, in blocks of bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxgeo._arguments import check_latitude, check_terrain, checked_air, checked_exposure
from jaxgeo._checks import as_array, as_float64, check_is
from jaxgeo._record import Record
from jaxgeo._typing import IndexField, PixelField, ScalarField, StatusField
from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.locate import FIRST_HIT
from jaxgeo.observation import Exposure, accepts_exposure, accepts_observation
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.status import Status, count_statuses, counts_as_fix
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Dem
from jaxgeo.uncertainty.assess import NO_FIX
from jaxgeo.uncertainty.draws import AbstractDraws, Random
from jaxgeo.uncertainty.map_cells import (
    Cell,
    MapContext,
    Request,
    aimed,
    chosen,
    in_parts,
    joined,
    judged_at,
    middles_of_cells,
    on_image,
    placed,
    requested,
    spread,
    with_samples,
)
from jaxgeo.uncertainty.method_selection import Diagnostics, Method
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, of_arrays
from jaxgeo.uncertainty.sampled import CHUNK

BLOCK = 128  # cells evaluated at once: about 100 MB
SAMPLES = 2000  # per cell: figures good to about 3 %
RANDOM = Random()


class AccuracyMap(Record):
    """Accuracy of the fixes of many cells (ground points or pixels); all arrays have the shape of the request.

    `circular`, `linear` and `spherical` are radii in m that contain the true point with `probability`; `trust` is the
    method used (codes of `Method`). They are infinite where too many samples have no fix, and NaN where samples are
    needed but not drawn (`count` 0) or there is no fix. Without a fix `trust` is `NO_FIX` (-1) and `status` (int8)
    gives the reason: `outside_image`, `hidden_by_terrain`, `hits_void` or `leaves_terrain` for unknown ground, or what
    the line of sight meets first. `position` is the ground point in rad and m, `uv` (..., 2) its pixel in px; `failed`
    is the share of samples without a fix, NaN if none were drawn. `signs` are the diagnostics that selected the method.
    From a pose, `readings` (..., axes) in rad put the optical axis on each cell; they are NaN, and the status
    `invalid_input`, where `is_out_of_reach`.
    """

    position: Geodetic
    uv: PixelField
    status: StatusField
    trust: IndexField
    circular: ScalarField
    linear: ScalarField
    spherical: ScalarField
    failed: ScalarField
    signs: Diagnostics
    probability: float
    count: int
    readings: Any = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of every array, without the last axis of `uv` and `readings`."""
        return jnp.shape(self.status)

    @property
    def has_fix(self) -> Any:
        """Whether each cell has a fix."""
        return jnp.asarray(self.trust) != NO_FIX

    @property
    def is_out_of_reach(self) -> Any:
        """Whether each cell is outside the gimbal limits; only from a pose."""
        if self.readings is None:
            return jnp.zeros(self.shape, bool)
        is_known = jnp.isfinite(jnp.asarray(self.position.height))
        return is_known & jnp.any(jnp.isnan(self.readings), axis=-1)

    def meaning(self, status: Status) -> str:
        """Message of a status of a cell of this map."""
        if status is Status.invalid_input and bool(jnp.any(self.is_out_of_reach)):
            return "The gimbal cannot look there within its limits."
        return status.message

    def __str__(self) -> str:
        percent, places = f"{100.0 * self.probability:g}", int(jnp.size(self.status))
        known = self.circular[jnp.isfinite(self.linear) | jnp.isinf(self.linear)]
        lines = [f"{int(jnp.sum(self.has_fix))} of {places} places have a fix."]
        if known.size:
            low, high = (float(jnp.quantile(known, share, method="higher")) for share in (0.5, 0.9))
            lines[0] += f" CE{percent} up to {low:.3g} m in half of those with figures, {high:.3g} m in nine tenths."
        for one in Method:
            here = self.trust == one
            drawn = f", {self.count} each" if self.count else ", not drawn"
            words = one.words + (drawn if one is Method.samples else "")
            lines.append(f"  {int(jnp.sum(here)):8d}  {words}")
        for status, number in count_statuses(self.status[~self.has_fix]).items():
            lines.append(f"  {number:8d}  {status.name}: {self.meaning(status)}")
        return "\n".join(lines)


@accepts_exposure
def accuracy_map(
    sensor: Sensor,
    shot: Shot | Trajectory | Pose,
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    ground: Geodetic | None = None,
    *,
    step: int = 1,
    probability: float = 0.9,
    count: int = SAMPLES,
    key: Any = None,
    draws: AbstractDraws = RANDOM,
    chunk: int = CHUNK,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    block: int = BLOCK,
    progress: bool = False,
) -> AccuracyMap:
    """Accuracy of the fix of each ground point: in an image, or with the gimbal pointed at it from a pose.

    With a `shot` (or a trajectory and the `time` of the image) each cell has the `accuracy` of its pixel; with a `Pose`
    instead, that of the optical axis pointed at it as by `sensor.point_shot`. Cells that are not visible have a status
    and no figures; a pixel whose fix is more than 0.1 m from the cell gives `hidden_by_terrain`. `ground` holds
    latitudes and longitudes in rad, of one shape; heights are those of the terrain. The default is the centre of every
    `step`-th cell of a `Dem`, (rows, cols). Where samples are needed, `count` are drawn, all with the same `key`
    (default `jax.random.key(0)`), so that neighbours differ only by their ground; with a `count` of 0 there are no
    figures there. `block` cells are evaluated and `chunk` samples drawn at a time, which bounds the memory and does not
    change the results. `progress` shows progress bars. Raises as `accuracy`, but not for a missing fix.
    """
    how: Any = {"probability": probability, "count": count, "key": key, "draws": draws, "chunk": chunk, "time": time}
    how |= {"search": search, "atmosphere": atmosphere, "block": block, "progress": progress}
    world, model, request = checked_map(sensor, shot, terrain, errors, **how)
    ground = _cells(terrain, step) if ground is None else ground
    check_is(ground, Geodetic, "ground", "Make one with Geodetic.from_degrees(lat=, lon=, height=0.0).")
    check_latitude(ground, "ground")
    lat, lon = jnp.broadcast_arrays(*as_float64((ground.lat, ground.lon), "ground"))
    if not lat.size:
        raise ValueError(f"ground must hold positions; got shape {lat.shape}.")
    parts = in_parts((lat.reshape(-1), lon.reshape(-1)), 8 * request.block, "where it is seen", progress)
    places = joined([placed(*part, world) for part in parts], lat.size)
    return _mapped(places, lat.shape, request, world, model, progress)


def checked_map(
    sensor: Any,
    shot: Any,
    terrain: Any,
    errors: Any,
    *,
    probability: Any = 0.9,
    count: Any = SAMPLES,
    key: Any = None,
    draws: Any = RANDOM,
    chunk: Any = CHUNK,
    time: Any = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Any = None,
    block: Any = BLOCK,
    progress: bool = False,
) -> tuple[MapContext, ErrorModel, Request]:
    """Checked arguments of `accuracy_map`, except its ground points; compiles nothing. Raises as `accuracy_map`."""
    del progress
    world, model = _world(sensor, shot, terrain, errors, time, search, atmosphere)
    return world, model, requested(probability, count, key, draws, chunk, search, block)


@accepts_observation
def accuracy_of_pixels(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[Any],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    probability: float = 0.9,
    count: int = SAMPLES,
    key: Any = None,
    draws: AbstractDraws = RANDOM,
    chunk: int = CHUNK,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    block: int = BLOCK,
    progress: bool = False,
) -> AccuracyMap:
    """Accuracy of the fixes of many pixels `uv` (..., 2) = (column, row) of one image.

    Each pixel has its `accuracy` figures, and its fix as `position`; a pixel outside the image has neither. Other
    arguments and exceptions as for `accuracy_map`.
    """
    if isinstance(shot, Pose):
        raise TypeError("shot must be a Shot, or a Trajectory: from a Pose alone a pixel sees nothing yet.")
    world, model = _world(sensor, shot, terrain, errors, time, search, atmosphere)
    request = requested(probability, count, key, draws, chunk, search, block)
    pixels = jnp.asarray(as_float64(as_array(uv, "uv"), "uv"))
    if pixels.shape[-1:] != (2,) or not pixels.size:
        raise ValueError(f"uv must be pixels (column, row) of shape (..., 2); got shape {pixels.shape}.")
    places = on_image(pixels.reshape(-1, 2), world.sensor)
    return _mapped(places, pixels.shape[:-1], request, world, model, progress)


def _mapped(
    places: Cell, shape: tuple[int, ...], request: Request, world: MapContext, model: ErrorModel, progress: bool
) -> AccuracyMap:
    """Map of cells (n,): fixes of those on the image, then accuracy of those with a fix, by samples if needed."""
    count = places.uv.shape[0]
    index, some = chosen(places, jnp.asarray(places.status) == Status.hit)
    parts = in_parts(some, request.block, "intersecting rays", progress)
    aims, met = joined([aimed(part, world, request.search) for part in parts], some.uv.shape[0])
    status = jnp.asarray(places.status).at[index].set(met)
    position = spread(aims.fix.position, index, count) if places.ground is None else places.ground
    within, (some, aims, met) = chosen((some, aims, met), counts_as_fix(met))
    parts = in_parts((some, aims, met), request.block, "estimating accuracy", progress)
    answers = joined([judged_at(*part, world, model, request) for part in parts], some.uv.shape[0])
    answers = with_samples(answers, some, aims, world, model, request, progress)
    trust, figures, signs = spread(answers, index.at[within].get(mode="fill", fill_value=count), count)
    shaped = lambda tree: jax.tree.map(lambda leaf: leaf.reshape(shape + leaf.shape[1:]), tree)  # noqa: E731
    of_all: Any = shaped((position, places.uv, status, trust, *figures, signs))
    last: dict[str, Any] = {"probability": float(request.probability), "count": request.count}
    return AccuracyMap(*of_all, **last, readings=shaped(places.readings))


def _world(
    sensor: Any, shot: Any, terrain: Any, errors: Any, time: Any, search: Any, atmosphere: Any
) -> tuple[MapContext, ErrorModel]:
    """Checked data common to all cells, in float64, and the error model."""
    check_is(sensor, Sensor, "sensor")
    if isinstance(shot, Pose) and not sensor.gimbal.axes:
        raise ValueError("From a Pose the gimbal is turned to each place, but this sensor's has no axes: give a Shot.")
    given = Shot(shot, sensor.gimbal.neutral_readings()) if isinstance(shot, Pose) else shot
    check_terrain(terrain, search)
    sensor, motion, moment = checked_exposure(sensor, given, time)
    some = ModelInputs(Exposure(sensor, motion, moment, checked_air(atmosphere)), terrain=of_arrays(terrain))
    moment = moment if isinstance(motion, Trajectory) else None
    model = checked_model(errors, some)
    motion = motion.pose if isinstance(shot, Pose) and isinstance(motion, Shot) else motion
    return MapContext(sensor, motion, moment, some.terrain, some.air), model


def _cells(terrain: Any, step: Any) -> Geodetic:
    """Centres of every `step`-th cell of a `Dem`."""
    if not isinstance(terrain, Dem):
        raise ValueError(
            f"ground must be named: a {type(terrain).__name__} has no cells. Make positions with "
            "Geodetic.from_degrees(lat=, lon=, height=0.0)."
        )
    if not isinstance(step, Integral) or step < 1:
        raise ValueError(f"step must be a whole number of cells, 1 or more; got {step!r}.")
    rows, cols = (jnp.arange(0, int(posts) - 1, int(step)) for posts in jnp.asarray(terrain.extent))
    return middles_of_cells(terrain, rows, cols)
