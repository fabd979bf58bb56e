"""Lines of sight of looks with their derivatives by the errors, in one form for all sensors."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._locate import FIRST_HIT
from jaxgeo._numerics import dot, safe_norm, tree_where
from jaxgeo._typing import Matrix3, Scalar, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.fix import Fix
from jaxgeo.sensor import Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.host_arrays import concatenate, on_host, take
from jaxgeo.uncertainty.looks import Looks
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import FARTHER, ModelInputs, NominalFix

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
    shared = (looks.sensor, _trajectory(looks), terrain, looks.atmosphere)
    return _in_blocks(lambda own: _origins(own, shared), _own(looks))


def lines_of(
    looks: Looks, terrain: AbstractTerrain, model: ErrorModel, columns: np.ndarray, target: Vector3 | Any
) -> Lines:
    """Lines of sight of a sensor's looks, as NumPy arrays: at their fixes, or at the points `target` (n, 3) in ECEF m
    if given."""
    shared = (looks.sensor, _trajectory(looks), terrain, looks.atmosphere)
    return _in_blocks(lambda own: _lines(own, shared, model, jnp.asarray(columns)), (*_own(looks), target))


def _trajectory(looks: Looks) -> Trajectory | None:
    return looks.shots if isinstance(looks.shots, Trajectory) else None


def _own(looks: Looks) -> tuple[Any, Any, Any]:
    shots = None if isinstance(looks.shots, Trajectory) else looks.shots
    return shots, looks.times, looks.uvs


def _in_blocks(function: Any, own: Any) -> Any:
    """The function of items (n, ...) in blocks of few sizes; the last one is padded with the last item."""
    host = on_host(own)
    count = len(host[1])
    size = block_size(count)
    blocks = [np.minimum(np.arange(first, first + size), count - 1) for first in range(0, count, size)]
    return concatenate([function(take(host, index)) for index in blocks], count)


@batch_filter_jit
def _origins(own: Any, shared: Any) -> Origins:
    def one(own: Any) -> Origins:
        inputs, time = _inputs(own, shared)
        ray, status = inputs.sightline()
        return Origins(ray.origin, ray.direction, time, status)

    return jax.vmap(one)(own)


@batch_filter_jit
def _lines(own: Any, shared: Any, model: ErrorModel, columns: Float[Array, "axes z"]) -> Lines:
    def one(own: Any) -> Lines:
        *look, target = own
        inputs, time = _inputs(tuple(look), shared)
        if target is None:
            nominal = inputs.nominal_fix(FIRST_HIT)
            status = jnp.asarray(nominal.fix.status)
        else:
            nominal, status = _at_point(inputs, target)
        return _line_at(inputs, nominal, model, columns, time, status)

    return jax.vmap(one)(own)


def _inputs(own: Any, shared: Any) -> tuple[ModelInputs, Scalar]:
    """(forward-model inputs of a look, time of exposure in s)."""
    (shot, time, uv), (sensor, trajectory, terrain, air) = own, shared
    later = jnp.where(jnp.all(jnp.isfinite(uv)), sensor.camera.time_of(uv), 0.0)
    motion, moment = (shot, jnp.zeros(())) if trajectory is None else (trajectory, time)
    return ModelInputs.of_checked(sensor, motion, moment, uv, terrain, air), time + later


def _at_point(inputs: ModelInputs, target: Vector3) -> tuple[NominalFix, Any]:
    """(nominal fix at the point of a line of sight that is nearest to a target, without terrain; status)."""
    _, status = inputs.sightline()
    ray = inputs.ray().through(inputs.air)
    distance = dot(ray.direction, target - ray.origin)
    for _ in range(0 if inputs.air is None else SOLVED):
        distance = distance + dot(ray.heading_at(distance), target - ray.at(distance))
    ahead = distance > 0.0
    status = jnp.where((status == Status.hit) & ~ahead, Status.behind_camera.code, status)
    distance = jnp.where(ahead, distance, 1.0)
    p_ecef = ray.at(distance)
    position = WGS84.to_geodetic(p_ecef)
    unknown = jnp.full_like(distance, jnp.nan)
    fix = Fix(position, p_ecef, distance, unknown, unknown, unknown, status)
    R = R_ecef_from_enu(position)
    heading = ray.heading_at(distance)
    nominal = NominalFix(fix, p_ecef, distance, jnp.zeros(2, jnp.int32), R.T @ (heading / safe_norm(heading)), R)
    return nominal, status


def _line_at(
    inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, columns: Any, time: Scalar, status: Any
) -> Lines:
    """The line of sight near a nominal fix, with zeros for its derivatives if there is none."""
    usable = status == Status.hit
    ray = tree_where(usable, inputs.ray(), inputs.terrain.safe_ray()).through(inputs.air)
    bend = jax.jvp(ray.heading_at, (nominal.distance,), (jnp.ones_like(nominal.distance),))[1]
    swept = model.sweep(inputs, nominal)
    R: Matrix3 = nominal.R_ecef_from_enu
    shift, farther = (R @ part @ columns for part in (swept.line, swept.farther))
    found = Lines(
        time,
        nominal.p_ecef,
        ray.heading_at(nominal.distance),
        bend,
        nominal.distance,
        shift,
        (farther - shift) / FARTHER,
        swept.ground @ columns,
        status,
    )
    sound = usable & jnp.all(jnp.isfinite(shift)) & jnp.all(jnp.isfinite(farther)) & jnp.all(jnp.isfinite(found.ground))
    status = jnp.where(usable & ~sound, Status.invalid_input.code, status)
    numbers = jax.tree.map(lambda x: jnp.where(sound, x, jnp.zeros_like(x)), found._replace(time=time, status=status))
    return numbers._replace(time=time, status=status)
