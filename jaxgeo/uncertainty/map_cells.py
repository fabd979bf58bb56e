"""Cells of an accuracy map: viewing pixel, fix and accuracy of each, in blocks of one size."""

from __future__ import annotations

import functools
from numbers import Integral
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int8

from jaxgeo._accelerator import by_device
from jaxgeo._compile import ROWS, batch_filter_jit, maps_in_blocks
from jaxgeo._locate import project
from jaxgeo._numerics import all_finite, safe_norm, tree_where
from jaxgeo._typing import Flag, Scalar, StatusCode
from jaxgeo.earth import WGS84, Atmosphere, Geodetic
from jaxgeo.fix import Fix
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory, point_shot
from jaxgeo.status import Status, counts_as_fix, first_failure, status_where
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Bracket, Dem
from jaxgeo.uncertainty.host_arrays import blocks_of, concatenate
from jaxgeo.uncertainty.linear import OverSlope, Shared, derivatives
from jaxgeo.uncertainty.many_fixes import Normality, Perturbed
from jaxgeo.uncertainty.metrics.exact import check_probability
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, located_apart, nominal_fix_of
from jaxgeo.uncertainty.normality import is_normal_over
from jaxgeo.uncertainty.sampling import Sampling

BLOCK = 128  # fixes evaluated at once: about 100 MB
BLOCK_ACCELERATOR = 1024  # the same on an accelerator: 0.5 GB
SAME_GROUND = 0.1  # m: largest distance between a cell and the fix of its pixel


class MapContext(NamedTuple):
    """Checked data common to all cells; `motion` is a pose if the gimbal is pointed at each cell."""

    sensor: Sensor
    motion: Shot | Trajectory | Pose
    time: Scalar
    terrain: AbstractTerrain
    air: Atmosphere | None

    def inputs(self, cell: Cell) -> ModelInputs:
        """Forward-model inputs of a cell."""
        motion = Shot(self.motion, cell.readings) if isinstance(self.motion, Pose) else self.motion
        return ModelInputs.of_checked(self.sensor, motion, self.time, cell.uv, self.terrain, self.air)


class Cell(NamedTuple):
    """A pixel with the status of its view; optionally the ground point to observe and the gimbal readings."""

    uv: Float[Array, "... 2"]
    status: Int8[Array, "..."]
    ground: Geodetic | None = None
    readings: Float[Array, "... axes"] | None = None


class Request(NamedTuple):
    """Checked options of an accuracy of many fixes."""

    probability: Scalar
    sampling: Sampling
    search: AbstractSearch
    block: int


def check_level(probability: Any) -> Scalar:
    """One probability in float64; raises `ValueError` for several, or outside (0, 1)."""
    level = jnp.asarray(check_probability(probability))
    if jnp.ndim(level) != 0:
        raise ValueError(f"probability must be one number; got shape {jnp.shape(level)}.")
    return level


def check_block(block: Any) -> int:
    """The number of fixes evaluated at once, by default that of the device; raises `ValueError` unless it is 1 or
    more."""
    block = by_device(BLOCK, BLOCK_ACCELERATOR) if block is None else block
    if not isinstance(block, Integral) or block < 1:
        raise ValueError(f"block must be a whole number, 1 or more; got {block!r}.")
    return int(block)


@batch_filter_jit
def project_cells(lat: Float[Array, " cells"], lon: Float[Array, " cells"], context: MapContext) -> Cell:
    """Cells at ground points, with the pixels that view them if nothing occludes them."""
    return jax.vmap(_project_cell, in_axes=(0, 0, None))(lat, lon, context)


@eqx.filter_jit
def cells_of_pixels(uv: Float[Array, "cells 2"], sensor: Sensor) -> Cell:
    """Cells of given pixels; pixels outside the image or the lens field have that status."""
    return Cell(uv, jax.vmap(sensor.camera.ray)(uv)[1])


def fixes_of_cells(cells: Cell, context: MapContext, search: AbstractSearch, progress: bool) -> Any:
    """Fixes of the cells' pixels and where the search found the ground, by the programs of every `vmap` of `locate`.

    None where one program finds them better together with the rest.
    """
    if isinstance(context.motion, Trajectory) or not maps_in_blocks(cells):
        return None

    def one(cell: Cell) -> tuple[Fix, Bracket]:
        inputs = context.inputs(cell)
        return located_apart(inputs, inputs.uv, search)

    count = len(cells.uv)
    parts = blocks_of(cells, min(count, ROWS), "intersecting rays", progress)
    return concatenate([jax.vmap(one)(part) for part in parts], count)


@batch_filter_jit
def locate_cells(
    cells: Cell, met: tuple[Fix, Bracket] | None, context: MapContext, search: AbstractSearch
) -> tuple[NominalFix, Int8[Array, " cells"], Bool[Array, " cells"]]:
    """Nominal fixes of the cells' pixels, the status of each cell, and whether it has a fix; `met` if already found."""

    def one(cell: Cell, met: tuple[Fix, Bracket] | None) -> tuple[NominalFix, StatusCode, Flag]:
        inputs = context.inputs(cell)
        nominal = inputs.nominal_fix(search) if met is None else nominal_fix_of(inputs, *met)
        status = jnp.asarray(nominal.fix.status)
        if cell.ground is not None:
            off = safe_norm(jnp.where(nominal.fix.found, nominal.fix.ecef - WGS84.to_ecef(cell.ground), 0.0))
            is_other = counts_as_fix(status) & (off > SAME_GROUND)
            status = status_where(is_other, Status.hidden_by_terrain, status)
        status = first_failure(cell.status, status)
        return nominal, status, counts_as_fix(status)

    return jax.vmap(one)(cells, met)


def perturbed_cells(
    cells: Cell, nominals: NominalFix, context: MapContext, model: ErrorModel
) -> tuple[Perturbed, AbstractTerrain, Normality | None]:
    """A block of cells for `assess_blocks`."""
    normality = None if model.is_normal else functools.partial(_normality_of_cells, cells, context, model)
    return Perturbed(nominals, _derivatives_of_cells(cells, nominals, context, model)), context.terrain, normality


@batch_filter_jit
def _derivatives_of_cells(cells: Cell, nominals: NominalFix, context: MapContext, model: ErrorModel) -> Shared:
    return jax.vmap(lambda cell, nominal: derivatives(context.inputs(cell), nominal, model).shared)(cells, nominals)


@batch_filter_jit
def _normality_of_cells(
    cells: Cell,
    context: MapContext,
    model: ErrorModel,
    nominals: NominalFix,
    facet: OverSlope,
    footprint: OverSlope,
) -> tuple[Any, Any]:
    def one(cell: Cell, nominal: NominalFix, *over: OverSlope) -> tuple[Any, ...]:
        return tuple(is_normal_over(context.inputs(cell), nominal, model, each) for each in over)

    return jax.vmap(one)(cells, nominals, facet, footprint)


@eqx.filter_jit
def cell_centres(dem: Dem, rows: Int[Array, " rows"], cols: Int[Array, " cols"]) -> Geodetic:
    """Positions (rows, cols) of cell centres, at height zero."""
    rowcol = jnp.stack(jnp.meshgrid(rows + 0.5, cols + 0.5, indexing="ij"), axis=-1)
    x, y, z = jnp.moveaxis(jax.vmap(jax.vmap(dem.grid.normal))(rowcol), -1, 0)
    return Geodetic(lat=jnp.arctan2(z, jnp.sqrt(x * x + y * y)), lon=jnp.arctan2(y, x), height=jnp.zeros_like(z))


def select(tree: Any, here: np.ndarray) -> tuple[np.ndarray, Any]:
    """(indices where `here` is true, the entries there as NumPy arrays); if there are none, the first entry."""
    index = np.flatnonzero(here)
    rows = index if index.size else np.zeros(1, int)
    return index, jax.tree.map(lambda leaf: np.asarray(leaf)[rows], tree)


def _project_cell(lat: Scalar, lon: Scalar, context: MapContext) -> Cell:
    ground, unknown = ground_at(lat, lon, context.terrain)
    stand_in = tree_where(unknown == Status.hit, ground, Geodetic(lat=ground.lat, lon=ground.lon, height=0.0))
    if not isinstance(context.motion, Pose):
        time = context.time if isinstance(context.motion, Trajectory) else None
        seen = project(context.sensor, context.motion, stand_in, time=time, atmosphere=context.air)
        return Cell(jnp.asarray(seen.uv), first_failure(unknown, jnp.asarray(seen.status)), ground)
    readings = point_shot(context.sensor, context.motion, stand_in, atmosphere=context.air).gimbal_readings
    uv, status = context.sensor.camera.project(context.sensor.camera.axis())
    reached = status_where(all_finite(readings), Status.hit, Status.invalid_input.code)
    return Cell(uv, first_failure(unknown, reached, status), ground, readings)


def ground_at(lat: Scalar, lon: Scalar, terrain: AbstractTerrain) -> tuple[Geodetic, StatusCode]:
    """Terrain point at a latitude and longitude, with a status; the height is NaN where unknown."""
    is_place = jnp.isfinite(lat) & jnp.isfinite(lon)
    level = Geodetic(lat=jnp.where(is_place, lat, 0.0), lon=jnp.where(is_place, lon, 0.0), height=jnp.zeros_like(lat))
    if isinstance(terrain, Dem):
        height = terrain.height_at(level)
        inside = terrain.contains(terrain.rowcol_at(level))
        status = status_where(inside, Status.hits_void, Status.leaves_terrain.code)
        status = status_where(jnp.isfinite(height), Status.hit, status)
    else:
        height = terrain.height_at(level)
        status = status_where(jnp.isfinite(height), Status.hit, Status.hits_void.code)
    status = jnp.where(is_place, status, Status.invalid_input.code)
    height = jnp.where(status == Status.hit, height, jnp.nan)
    return Geodetic(lat=level.lat, lon=level.lon, height=height), status
