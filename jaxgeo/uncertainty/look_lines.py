"""Lines of sight of looks with their derivatives by the errors, in one form for all sensors."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._numerics import all_finite, dot
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.sensor import Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.host_arrays import concatenate, on_host, take
from jaxgeo.uncertainty.looks import Looks
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import FARTHER, ModelInputs, Tangents

SIZES = (16, 128, 1024)  # looks of a block: a program serves all numbers of looks up to its size, or blocks of the last
SOLVED = 3  # steps to the foot of a point on a refracted ray


class Lines(NamedTuple):
    """Lines of sight of n looks (leading axis), near the target.

    `time` of exposure in s; `point` on the line in ECEF m, at `distance` m; `heading` and `bend` the first and second
    derivative of the line by the distance. `shift` (3, z) and `slope` (3, z) are the derivative of the point, ECEF m,
    by the numbers z of `SharedErrors`, and its change per m of distance; `ground` (z,) that of the ground's height, m.
    `status` is an int8 `Status`.
    """

    time: Any
    point: Any
    heading: Any
    bend: Any
    distance: Any
    shift: Any
    slope: Any
    ground: Any
    status: Any


class Origins(NamedTuple):
    """Straight lines of sight: `origin` in ECEF m, unit `direction`, `time` of exposure in s, `status`."""

    origin: Any
    direction: Any
    time: Any
    status: Any


def block_size(count: int) -> int:
    """Looks of a block of `count`."""
    return next((size for size in SIZES if count <= size), SIZES[-1])


def origins_of(looks: Looks, terrain: AbstractTerrain) -> Origins:
    """Straight lines of sight of a sensor's looks, as NumPy arrays."""
    shared = shared_arrays(looks, terrain)
    return in_blocks(lambda own: _origins(own, shared), own_arrays(looks))


def fixes_of(looks: Looks, terrain: AbstractTerrain) -> tuple[np.ndarray, np.ndarray]:
    """(fixes of a sensor's looks on the terrain, ECEF m (n, 3), zeros where there is none; their statuses)."""
    shared = shared_arrays(looks, terrain)
    return in_blocks(lambda own: _fixes(own, shared), own_arrays(looks))


def lines_of(
    looks: Looks, terrain: AbstractTerrain, model: ErrorModel, columns: np.ndarray, places: np.ndarray
) -> Lines:
    """Lines of sight of a sensor's looks near places of the target (n, 3) in ECEF m, as NumPy arrays."""
    shared = shared_arrays(looks, terrain)
    own = (*own_arrays(looks), places)
    return in_blocks(lambda own: _lines(own, shared, model, jnp.asarray(columns)), own)


def shared_arrays(looks: Looks, terrain: AbstractTerrain) -> tuple[Any, ...]:
    """What the looks of a sensor share: sensor, trajectory if there is one, terrain, atmosphere."""
    trajectory = looks.shots if isinstance(looks.shots, Trajectory) else None
    return looks.sensor, trajectory, terrain, looks.atmosphere


def own_arrays(looks: Looks) -> tuple[Any, Any, Any]:
    """Shots if there is no trajectory, times and pixels (leading axis)."""
    shots = None if isinstance(looks.shots, Trajectory) else looks.shots
    return shots, looks.times, looks.uvs


def in_blocks(function: Any, own: Any) -> Any:
    """The function of items (n, ...) in blocks of few sizes; the last one is padded with the last item."""
    host = on_host(own)
    count = len(host[1])
    size = block_size(count)
    blocks = [np.minimum(np.arange(first, first + size), count - 1) for first in range(0, count, size)]
    return concatenate([function(take(host, index)) for index in blocks], count)


@batch_filter_jit
def _origins(own: Any, shared: Any) -> Origins:
    def one(own: Any) -> Origins:
        inputs, time = inputs_of_look(own, shared)
        ray, status = inputs.nominal_sightline()
        return Origins(ray.origin, ray.direction, time, status)

    return jax.vmap(one)(own)


@batch_filter_jit
def _fixes(own: Any, shared: Any) -> tuple[Any, Any]:
    """Fixes one after the other: a search of single rays compiles in a third of the time of one of batches."""

    def one(own: Any) -> tuple[Any, Any]:
        inputs, _ = inputs_of_look(own, shared)
        fix = inputs.ground(FIRST_HIT)
        return jnp.where(fix.found, jnp.asarray(fix.ecef), 0.0), jnp.asarray(fix.status)

    return jax.lax.map(one, own)


@batch_filter_jit
def _lines(own: Any, shared: Any, model: ErrorModel, columns: Float[Array, "axes z"]) -> Lines:
    def one(own: Any) -> Lines:
        *look, place = own
        inputs, time = inputs_of_look(tuple(look), shared)
        return _line_at(inputs, place, model, columns, time)

    return jax.vmap(one)(own)


def inputs_of_look(own: Any, shared: Any) -> tuple[ModelInputs, Scalar]:
    """(forward-model inputs of a look, time of exposure in s)."""
    (shot, time, uv), (sensor, trajectory, terrain, air) = own, shared
    later = jnp.where(jnp.all(jnp.isfinite(uv)), sensor.camera.time_of(uv), 0.0)
    motion, moment = (shot, jnp.zeros(())) if trajectory is None else (trajectory, time)
    return ModelInputs.of_checked(sensor, motion, moment, uv, terrain, air), time + later


def _line_at(inputs: ModelInputs, place: Vector3, model: ErrorModel, columns: Any, time: Scalar) -> Lines:
    """The line of sight near a place of the target; zeros if there is none."""
    _, status = inputs.nominal_sightline()
    ray = inputs.ray().through(inputs.air)
    distance = dot(ray.direction, place - ray.origin)
    for _ in range(0 if inputs.air is None else SOLVED):
        distance = distance + dot(ray.heading_at(distance), place - ray.at(distance))
    ahead = distance > 0.0
    status = jnp.where((status == Status.hit) & ~ahead, Status.behind_camera.code, status)
    distance = jnp.where(ahead, distance, 1.0)
    heading, bend = ray.direction, jnp.zeros(3)
    if inputs.air is not None:
        heading, bend = jax.jvp(ray.heading_at, (distance,), (jnp.ones_like(distance),))

    tangents = _tangents(inputs, ray.at(distance), model)
    near, far = (_moved_point(inputs, tangents, distance + further) for further in (0.0, FARTHER))
    shift, farther, ground = near @ columns, far @ columns, tangents.ground @ columns
    usable = status == Status.hit
    sound = usable & all_finite((ray.at(distance), shift, farther, ground))
    status = jnp.where(usable & ~sound, Status.invalid_input.code, status)
    numbers = (ray.at(distance), heading, bend, distance, shift, (farther - shift) / FARTHER, ground)
    return Lines(time, *(jnp.where(sound, x, jnp.zeros_like(x)) for x in numbers), status=status)


def _tangents(inputs: ModelInputs, p_ecef: Vector3, model: ErrorModel) -> Tangents:
    """Derivatives by the errors of the line of sight, the air, and the height of the ground at a point."""

    def reached(error: Float[Array, " axes"]) -> Tangents:
        moved = model.moved(inputs, error)
        return Tangents(moved.ray(), jax.tree.map(jnp.asarray, moved.air), moved.terrain.ground_above(p_ecef)[0])

    return jax.jacfwd(reached)(jnp.zeros(model.size))


def _moved_point(inputs: ModelInputs, tangents: Tangents, distance: Scalar) -> Float[Array, "3 axes"]:
    """Derivative by the errors of the point at a distance along the line of sight, ECEF m."""
    ray = inputs.ray()
    if inputs.air is None:
        return tangents.ray.origin + distance * tangents.ray.direction
    air = jax.tree.map(jnp.asarray, inputs.air)
    at = lambda ray, air: ray.through(air).at(distance)  # noqa: E731
    along = lambda one: jax.jvp(at, (ray, air), (one.ray, one.air))[1]  # noqa: E731
    return jax.vmap(along, in_axes=-1, out_axes=-1)(tangents)
