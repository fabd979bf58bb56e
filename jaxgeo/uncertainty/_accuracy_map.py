"""Accuracy maps over the ground of an image or an area seen from a pose, in blocks of bounded memory."""

from __future__ import annotations

import dataclasses
from numbers import Integral
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._arguments import check_latitude, check_terrain, checked_air, checked_exposure
from jaxgeo._checks import as_float64, check_is
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import Record
from jaxgeo._typing import PixelField
from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.earth.geodetic import check_position
from jaxgeo.observation import Exposure, accepts_exposure
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Dem
from jaxgeo.uncertainty.accuracy_record import Accuracy, OldNames, batch_of, summary
from jaxgeo.uncertainty.host_arrays import block_size, blocks_of, concatenate, on_host, scatter, take
from jaxgeo.uncertainty.many_fixes import assess_blocks, size_of_blocks
from jaxgeo.uncertainty.map_cells import (
    Cell,
    MapContext,
    Request,
    cell_centres,
    check_block,
    check_level,
    fixes_of_cells,
    locate_cells,
    perturbed_cells,
    project_cells,
    select,
)
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, of_arrays
from jaxgeo.uncertainty.sampled import sample_where_needed
from jaxgeo.uncertainty.sampling import Sampling, accepts_sampling_options, resolve_sampling

SAMPLES = 2000  # per cell: figures good to about 3 %
SAMPLING = Sampling()


def _of_accuracy(name: str, words: str) -> property:
    """Property of a map that is a field of its accuracy."""
    return property(lambda found: getattr(found.accuracy, name), doc=words)


class AccuracyMap(OldNames, Record):
    """Accuracy of the fixes of many cells; all arrays have the shape of the request.

    `accuracy` holds the figures, whose names are attributes of the map too. `position` is the ground point in rad
    and m, `uv` (..., 2) its pixel in px. Without a fix the `status` gives the reason: `outside_image`,
    `hidden_by_terrain`, `hits_void` or `leaves_terrain` for unknown ground, or what the line of sight meets first. From
    a pose, `readings` (..., axes) in rad put the optical axis on each cell; they are NaN, and the status
    `invalid_input`, where `is_out_of_reach`. `AccuracyMap(found, found.fix.position, uv)` is the map of pixels.
    """

    accuracy: Accuracy
    position: Geodetic
    uv: PixelField
    readings: Any = None

    circular = _of_accuracy("circular", "Radius in m of the horizontal circle.")
    linear = _of_accuracy("linear", "Half-height in m of the vertical interval.")
    spherical = _of_accuracy("spherical", "Radius in m of the sphere.")
    method = _of_accuracy("method", "Codes of `Method`, `NO_FIX` (-1) without a fix.")
    failed = _of_accuracy("failed", "Share of samples without a fix, NaN if none were drawn.")
    diagnostics = _of_accuracy("diagnostics", "Diagnostics that selected the method.")
    count = _of_accuracy("count", "Number of samples drawn where they are needed.")
    has_fix = _of_accuracy("has_fix", "Whether each cell has a fix.")
    shape = _of_accuracy("shape", "Shape of every array, without the last axis of `uv` and `readings`.")

    @property
    def status(self) -> Any:
        """Status of each cell, an int8 `Status`."""
        return self.accuracy.fix.status

    @property
    def probability(self) -> float:
        """Probability that the radii contain the true point."""
        return self.accuracy.level()

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
        return summary(self.accuracy, "places", self.meaning)


@accepts_sampling_options
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
    sampling: Sampling | None = SAMPLING,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    block: int | None = None,
) -> AccuracyMap:
    """Accuracy of the fix of each ground point: in an image, or with the gimbal pointed at it from a pose.

    With a `shot` (or a trajectory and the `time` of the image) each cell has the `accuracy` of its pixel; with a `Pose`
    instead, that of the optical axis pointed at it as by `sensor.point_shot`. Cells that are not visible have a status
    and no figures; a pixel whose fix is more than 0.1 m from the cell gives `hidden_by_terrain`. `ground` holds
    latitudes and longitudes in rad, of one shape; heights are those of the terrain. The default is the centre of every
    `step`-th cell of a `Dem`, (rows, cols). Where samples are needed, 2000 are drawn, or as many as `sampling` says,
    all with the same key, so that neighbours differ only by their ground; with `sampling=None`, or a `count` of 0,
    there are no figures there. `block` cells (by default 128, on an accelerator 1024) are evaluated at a time, which
    bounds the memory and does not change the results. Raises as `accuracy`, but not for a missing fix.
    """
    how: Any = {"probability": probability, "sampling": sampling, "time": time, "search": search}
    how |= {"atmosphere": atmosphere, "block": block}
    context, model, request = checked_map(sensor, shot, terrain, errors, **how)
    ground = _cells(terrain, step) if ground is None else ground
    check_position(ground, "ground")
    check_latitude(ground, "ground")
    lat, lon = np.broadcast_arrays(*on_host(as_float64((ground.lat, ground.lon), "ground")))
    if not lat.size:
        raise ValueError(f"ground must hold positions; got shape {lat.shape}.")
    cells = projected(lat.reshape(-1), lon.reshape(-1), context, request)
    found = accuracy_of_cells(cells, lat.shape, request, context, model)
    shaped: Any = jax.tree.map(
        lambda leaf: jnp.asarray(leaf.reshape(lat.shape + leaf.shape[1:])), (cells.ground, cells.uv, cells.readings)
    )
    return AccuracyMap(found, *shaped)


def projected(lat: np.ndarray, lon: np.ndarray, context: MapContext, request: Request) -> Cell:
    """Cells at ground points (n,) in rad, as NumPy arrays, with the pixels that view them if nothing occludes them."""
    size = block_size(lat.size, 8 * request.block)
    flat: Any = lat, lon
    parts = blocks_of(flat, size, "projecting cells", request.sampling.progress)
    return concatenate([project_cells(part[0], part[1], context) for part in parts], lat.size)


def checked_map(
    sensor: Any,
    shot: Any,
    terrain: Any,
    errors: Any,
    *,
    probability: Any = 0.9,
    sampling: Any = SAMPLING,
    time: Any = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Any = None,
    block: Any = None,
) -> tuple[MapContext, ErrorModel, Request]:
    """Checked arguments of `accuracy_map`, except its ground points; compiles nothing. Raises as `accuracy_map`."""
    context, model = check_context(sensor, shot, terrain, errors, time, search, atmosphere)
    options = resolve_sampling(sampling, SAMPLES, least=0)
    return context, model, Request(check_level(probability), options, search, check_block(block))


def accuracy_of_cells(
    cells: Cell, shape: tuple[int, ...], request: Request, context: MapContext, model: ErrorModel
) -> Accuracy:
    """Accuracy of cells (n,): fixes of those on the image, then figures of those with a fix, by samples if needed."""
    cells, count, progress = on_host(cells), len(cells.uv), request.sampling.progress
    status: Any = np.array(cells.status)
    index, some = select(cells, status == Status.hit)
    met: Any = some, fixes_of_cells(some, context, request.search, progress)
    parts = blocks_of(met, block_size(len(some.uv), request.block), "checking fixes", progress)
    located = [locate_cells(part, found, context, request.search) for part, found in parts]
    fixes: Any = concatenate(located, index.size)
    nominals, status[index], has_fix = fixes
    own = np.asarray(status[index] != Status.hidden_by_terrain)
    fix = scatter(jax.tree.map(lambda leaf: leaf[own], nominals.fix), index[own], count)
    fix = dataclasses.replace(fix, status=status)
    within, seen = select((some, nominals), has_fix) if index.size else (index, (some, located[0][0]))
    size = size_of_blocks(len(seen[0].uv), request.block)
    blocks = blocks_of(seen, size, "estimating accuracy", progress)
    perturbed = (perturbed_cells(some, nominals, context, model) for some, nominals in blocks)
    _, found, radii = assess_blocks(perturbed, within.size, None, request.probability)

    def observation_at(number: int) -> tuple[ModelInputs, NominalFix, ErrorModel]:
        cell, nominal = take(seen, number)
        return context.inputs(cell), nominal, model

    probability, sampling = float(request.probability), request.sampling
    columns = sample_where_needed(found.method, radii, observation_at, request.search, sampling, probability)
    found, columns = scatter((found, columns), index[within], count)
    linear = (found.method, found.cov_enu, found.bias_enu, found.diagnostics)
    return batch_of(fix, probability, columns, *linear, int(sampling.count or 0), shape, model.left_out)


def check_context(
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
    rows, cols = (jnp.arange(0, int(posts) - 1, int(step)) for posts in np.asarray(terrain.extent))
    return cell_centres(terrain, rows, cols)
