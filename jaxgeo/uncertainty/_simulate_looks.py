"""Simulation of looks at a target: pixels as they are measured with drawn errors."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import as_array, as_float64, check_is
from jaxgeo._compile import batch_filter_jit
from jaxgeo._record import Record
from jaxgeo._typing import Vector3Field
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.earth.geodetic import check_position
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.terrain import AbstractTerrain, ConstantHeight
from jaxgeo.uncertainty._track import AT_REST, checked_errors
from jaxgeo.uncertainty.host_arrays import take
from jaxgeo.uncertainty.look_equations import World, on_surface
from jaxgeo.uncertainty.look_lines import in_blocks, inputs_of_look, own_arrays, shared_arrays
from jaxgeo.uncertainty.looks import Looks, checked_looks
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import of_arrays
from jaxgeo.uncertainty.sampling import check_key
from jaxgeo.uncertainty.target_motion import AbstractTarget

ROUNDS = 3  # of the exposure time of the pixel


class SimulatedLooks(Record):
    """Simulated looks for `track`, and the truth: `p_ecef` (n, 3), m, of the target at each, in the order of time, and
    its `velocity_enu` in m/s.

    A target outside of the image, or behind the camera, has a pixel there or NaN.
    """

    looks: tuple[Looks, ...]
    p_ecef: Vector3Field
    velocity_enu: Vector3Field


def simulate_looks(
    looks: Looks | Sequence[Looks] | Any,
    terrain: AbstractTerrain | None,
    errors: ErrorModel | Any,
    key: Any,
    *,
    position: Geodetic,
    velocity_enu: Any = (0.0, 0.0, 0.0),
    target: AbstractTarget | Any = AT_REST,
) -> SimulatedLooks:
    """The looks with pixels as they are measured of a target, with errors drawn from the error model.

    `looks`, `terrain`, `errors` and `target` are those of `jaxgeo.uncertainty.track`; the orientations of the looks are
    those that are stated, their pixels are replaced. The target is at `position` at the first look and moves with
    `velocity_enu` in m/s; its height is ignored on the terrain. The true orientations and the true ground are the
    stated ones perturbed by errors, as in `sample`, but with one draw for all looks that share an error. `key` is a
    `jax.random.key`. Errors that are not normal are drawn as normal ones of their variance. Raises as `track`.

    >>> from jaxgeo.uncertainty import Looks, simulate_looks, sources
    >>> import jax
    >>> sensor = jaxgeo.Sensor(jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000))
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=1600.0)
    >>> looks = Looks(sensor, [jaxgeo.Shot(pose)] * 2, np.zeros((2, 2)))
    >>> place = jaxgeo.Geodetic.from_degrees(lat=47.001, lon=11.0, height=0.0)
    >>> errors = sources.PixelMeasurement.from_pixels(column=1.0, row=1.0)
    >>> made = simulate_looks(looks, jaxgeo.ConstantHeight(600.0), errors, jax.random.key(0), position=place)
    >>> print(np.round(made.looks[0].uvs, 1))
    [[1999.4 1088.3]
     [1998.9 1088. ]]
    """
    several = checked_looks(looks)
    check_is(target, AbstractTarget, "target", "AtRest() and ConstantVelocity() are targets.")
    check_position(position, "position")
    check_key(key)
    velocity = np.asarray(as_float64(as_array(velocity_enu, "velocity_enu"), "velocity_enu"))
    if velocity.shape != (3,) or (not target.is_moving and np.any(velocity)):
        raise ValueError(f"velocity_enu must be three numbers in m/s, zero for a target at rest; got {velocity}.")
    shared = checked_errors(several, terrain, errors, target)
    times = np.concatenate([np.asarray(one.times) for one in several])
    order = np.argsort(times, kind="stable")
    numbers = np.empty((len(times), sum(shared.counts)))
    numbers[order] = _numbers(shared.counts, shared.durations, times[order], key)
    each = np.split(numbers, np.cumsum([len(one) for one in several])[:-1])

    ground = of_arrays(terrain if terrain is not None and target.on_terrain else ConstantHeight(0.0))
    origin: Any = as_float64(position, "position")
    p_ecef = WGS84.to_ecef(origin)
    world = World(ground, p_ecef, R_ecef_from_enu(origin), jnp.asarray(shared.durations))
    start = jnp.asarray([times.min(), *velocity])
    made, places = [], []
    for one, model, columns, z in zip(several, shared.models, shared.columns, each, strict=True):
        own = (*own_arrays(one), z @ columns.T)
        shared_by_looks = shared_arrays(one, ground)
        see = functools.partial(_seen, shared=shared_by_looks, world=world, start=start, model=model, target=target)
        uvs, place = in_blocks(see, own)
        made.append(Looks(one.sensor, one.shots, uvs, one.times, one.errors, one.atmosphere))
        places.append(place)
    return SimulatedLooks(tuple(made), take(np.concatenate(places), order), jnp.asarray(velocity))


def _numbers(counts: tuple[int, int, int], durations: np.ndarray, times: np.ndarray, key: Any) -> np.ndarray:
    """Independent standard normal numbers z of looks in the order of time (n, z)."""
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).reshape(-1))
    fresh, constant, _ = counts
    drawn = rng.standard_normal((len(times), sum(counts)))
    drawn[:, fresh : fresh + constant] = drawn[0, fresh : fresh + constant]
    for k in range(1, len(times)):
        since = (times[k] - times[k - 1]) / durations
        new = np.sqrt(-np.expm1(-2.0 * since)) * drawn[k, fresh + constant :]
        drawn[k, fresh + constant :] = np.exp(-since) * drawn[k - 1, fresh + constant :] + new
    return drawn


@batch_filter_jit
def _seen(own: Any, shared: Any, world: World, start: Any, model: ErrorModel, target: AbstractTarget) -> Any:
    """(measured pixels; true positions in ECEF m) of a block of looks."""

    def one(own: Any) -> Any:
        *look, error = own
        inputs, _ = inputs_of_look(tuple(look), shared)
        moved = model.moved(inputs, error)
        uv = jnp.asarray(inputs.uv)
        off = moved.uv - uv
        uv = jnp.where(jnp.isfinite(uv), uv, 0.0)
        p_ecef = world.origin
        for _ in range(ROUNDS):
            since = look[1] + inputs.sensor.camera.time_of(uv) - start[0]
            place = since * start[1:]
            if target.on_terrain:
                place, _ = on_surface(place[:2], jnp.zeros(()), moved.terrain, world)
            p_ecef = world.origin + world.R_ecef_from_track @ place
            uv, _, _ = image_of_point(moved.sensor, moved.motion, jnp.asarray(moved.time), p_ecef, moved.air)
            uv = uv - off
        return uv, p_ecef

    return jax.vmap(one)(own)
