"""Cells of an accuracy map: viewing pixel, fix and accuracy of each, in blocks of one size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from numbers import Integral
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Int8

from jaxgeo._checks import check_countable, check_is
from jaxgeo._numerics import all_finite, safe_norm, tree_where
from jaxgeo._typing import Scalar, StatusCode
from jaxgeo.earth import WGS84, Atmosphere, Geodetic
from jaxgeo.locate import project
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory, point_shot
from jaxgeo.status import Status, counts_as_fix, first_failure, status_where
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Dem
from jaxgeo.uncertainty.assess import NO_FIX, Judged, judged, linear_figures
from jaxgeo.uncertainty.draws import MORE, AbstractDraws
from jaxgeo.uncertainty.method_selection import Diagnostics, Method
from jaxgeo.uncertainty.metrics.exact import check_probability
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sampled import Sampling, sampled_at

T = TypeVar("T")
SAME_GROUND = 0.1  # m: largest distance between a cell and the fix of its pixel
_linear_figures = jax.jit(linear_figures)


class MapContext(NamedTuple):
    """Data common to all cells; `motion` is a pose if the gimbal is pointed at each cell."""

    sensor: Sensor
    motion: Shot | Trajectory | Pose
    time: Scalar | None
    terrain: AbstractTerrain
    air: Atmosphere | None

    def look(self, place: Cell, search: AbstractSearch) -> ModelInputs:
        """Forward-model inputs of a cell."""
        motion = Shot(self.motion, place.readings) if isinstance(self.motion, Pose) else self.motion
        options: dict[str, Any] = {"time": self.time, "search": search, "atmosphere": self.air}
        return ModelInputs.of(self.sensor, motion, place.uv, self.terrain, **options)


class Cell(NamedTuple):
    """A pixel with the status of its view; optionally the ground point to observe and the gimbal readings."""

    uv: Float[Array, "... 2"]
    status: Int8[Array, "..."]
    ground: Geodetic | None = None
    readings: Float[Array, "... axes"] | None = None


class Request(NamedTuple):
    """Requested accuracy and sampling options, common to all cells."""

    probability: Scalar
    count: int
    key: Any
    draws: AbstractDraws
    chunk: int
    search: AbstractSearch
    block: int


class CellAccuracy(NamedTuple):
    """Selected method per cell; CE, LE and SE in m and the share of samples without a fix; diagnostics."""

    trust: Int[Array, " places"]
    figures: tuple[Float[Array, " places"], ...]
    signs: Diagnostics


def requested(
    probability: Any, count: Any, key: Any, draws: Any, chunk: Any, search: AbstractSearch, block: Any
) -> Request:
    """Validated `Request`."""
    level = check_probability(probability)
    if jnp.ndim(level) != 0:
        raise ValueError(f"probability must be one number; got shape {jnp.shape(level)}.")
    for value, name, least in ((count, "count", 0), (chunk, "chunk", 1), (block, "block", 1)):
        if not isinstance(value, Integral) or value < least:
            raise ValueError(f"{name} must be a whole number, {least} or more; got {value!r}.")
    check_countable(int(count), f"{count} samples", MORE)
    check_is(draws, AbstractDraws, "draws")
    key = jax.random.key(0) if key is None else key
    return Request(level, int(count), key, draws, int(chunk), search, int(block))


@eqx.filter_jit
def placed(lat: Float[Array, " places"], lon: Float[Array, " places"], world: MapContext) -> Cell:
    """Cells at ground points, with the pixels that view them if nothing occludes them."""
    return jax.vmap(_placed, in_axes=(0, 0, None))(lat, lon, world)


@eqx.filter_jit
def on_image(uv: Float[Array, "places 2"], sensor: Sensor) -> Cell:
    """Cells of given pixels; pixels outside the image or the lens field have that status."""
    return Cell(uv, jax.vmap(sensor.camera.ray)(uv)[1])


@eqx.filter_jit
def aimed(places: Cell, world: MapContext, search: AbstractSearch) -> tuple[NominalFix, Int8[Array, " places"]]:
    """Nominal fixes of the cells' pixels, and the status of each cell."""

    def one(place: Cell) -> tuple[NominalFix, StatusCode]:
        aim = world.look(place, search).nominal_fix(search)
        status = jnp.asarray(aim.fix.status)
        if place.ground is not None:
            off = safe_norm(jnp.where(aim.fix.found, aim.fix.ecef - WGS84.to_ecef(place.ground), 0.0))
            is_other = counts_as_fix(status) & (off > SAME_GROUND)
            status = status_where(is_other, Status.hidden_by_terrain, status)
        return aim, first_failure(place.status, status)

    return jax.vmap(one)(places)


def judged_at(
    places: Cell, aims: NominalFix, met: Int8[Array, " places"], world: MapContext, model: ErrorModel, request: Request
) -> CellAccuracy:
    """Accuracy of cells without samples; `met` is the status of each cell."""
    one = _judged(places, aims, met, world, model, request.search)
    return CellAccuracy(
        one.trust, (*_linear_figures(one, request.probability), jnp.full(met.shape, jnp.nan)), one.signs
    )


def with_samples(
    answers: CellAccuracy,
    places: Cell,
    aims: NominalFix,
    world: MapContext,
    model: ErrorModel,
    request: Request,
    progress: bool,
) -> CellAccuracy:
    """The accuracy of cells, with sampled figures where the method requires them."""
    index = jnp.flatnonzero(answers.trust == Method.samples)
    if not request.count or not index.size:
        return answers
    sampling = Sampling(request.key, request.count, request.draws, chunk=request.chunk)
    level, rows = float(request.probability), []
    for number in with_bar(index.tolist(), index.size, "sampling", progress):
        place, aim = taken((places, aims), jnp.asarray(number))
        drawn = sampled_at(world.look(place, request.search), model, request.search, sampling, aim)
        doors = (drawn.circular_error, drawn.linear_error, drawn.spherical_error)
        rows.append([*(door(level).value for door in doors), 1.0 - drawn.found / drawn.count])
    filled = (old.at[index].set(new) for old, new in zip(answers.figures, jnp.asarray(rows).T, strict=True))
    return answers._replace(figures=tuple(filled))


@eqx.filter_jit
def middles_of_cells(dem: Dem, rows: Int[Array, " rows"], cols: Int[Array, " cols"]) -> Geodetic:
    """Positions (rows, cols) of cell centres, at height zero."""
    rowcol = jnp.stack(jnp.meshgrid(rows + 0.5, cols + 0.5, indexing="ij"), axis=-1)
    x, y, z = jnp.moveaxis(jax.vmap(jax.vmap(dem.grid.normal))(rowcol), -1, 0)
    return Geodetic(lat=jnp.arctan2(z, jnp.sqrt(x * x + y * y)), lon=jnp.arctan2(y, x), height=jnp.zeros_like(z))


def in_parts(lanes: T, size: int, words: str, progress: bool) -> Iterator[T]:
    """Lanes (n, ...) in parts of one size, at most the next power of two above n; the last lane pads the last part."""
    count = jax.tree.leaves(lanes)[0].shape[0]
    size = min(size, 1 << (count - 1).bit_length())
    numbers = (jnp.minimum(first + jnp.arange(size), count - 1) for first in range(0, count, size))
    for part in with_bar(numbers, -(-count // size), words, progress):
        yield taken(lanes, part)


@eqx.filter_jit
def joined(parts: Sequence[T], count: int) -> T:
    """Parts concatenated, without padding."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[:count], *parts)


def chosen(lanes: T, here: Bool[Array, " lanes"]) -> tuple[Int[Array, " some"], T]:
    """Indices and values of the lanes where `here` is true; if none, the first lane with an out-of-range index."""
    index = jnp.flatnonzero(here)
    if not index.size:
        return jnp.full(1, here.size), taken(lanes, jnp.zeros(1, int))
    return index, taken(lanes, index)


@eqx.filter_jit
def spread(values: T, index: Int[Array, " some"], count: int) -> T:
    """Values of some of `count` cells scattered to all of them; NaN elsewhere, -1 for integers."""

    def among(leaf: Array) -> Array:
        blank = jnp.nan if jnp.issubdtype(leaf.dtype, jnp.floating) else -1
        return jnp.full((count, *leaf.shape[1:]), blank, leaf.dtype).at[index].set(leaf)

    return jax.tree.map(among, values)


def with_bar(items: Iterable[Any], count: int, words: str, progress: bool) -> Iterable[Any]:
    """The items, with a progress bar if requested."""
    if not progress:
        return items
    from rich.progress import track  # optional, imported only if used

    return track(items, description=words, total=count)


@eqx.filter_jit
def _judged(
    places: Cell, aims: NominalFix, met: Array, world: MapContext, model: ErrorModel, search: AbstractSearch
) -> Judged:
    one = jax.vmap(lambda place, aim: judged(world.look(place, search), aim, model))(places, aims)
    return one._replace(trust=jnp.where(counts_as_fix(met), one.trust, NO_FIX))


def _placed(lat: Scalar, lon: Scalar, world: MapContext) -> Cell:
    ground, unknown = ground_at(lat, lon, world.terrain)
    stand_in = tree_where(unknown == Status.hit, ground, Geodetic(lat=ground.lat, lon=ground.lon, height=0.0))
    if not isinstance(world.motion, Pose):
        seen = project(world.sensor, world.motion, stand_in, time=world.time, atmosphere=world.air)
        return Cell(jnp.asarray(seen.uv), first_failure(unknown, jnp.asarray(seen.status)), ground)
    readings = point_shot(world.sensor, world.motion, stand_in, atmosphere=world.air).gimbal_readings
    uv, status = world.sensor.camera.project(world.sensor.camera.axis())
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


@eqx.filter_jit
def taken(lanes: Any, numbers: Int[Array, "..."]) -> Any:
    return jax.tree.map(lambda leaf: leaf[numbers], lanes)
