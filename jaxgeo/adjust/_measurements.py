"""Validation of intersection inputs: shots, pixels and sensors of several images as batches."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgeo._arguments import check_latitude, checked_air
from jaxgeo._checks import as_array, as_float64, check_is, concrete, require_x64
from jaxgeo._record import Record
from jaxgeo.earth import Atmosphere
from jaxgeo.observation import Exposure
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.platform import Pose
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import Occasion
from jaxgeo.uncertainty.sources.height_raster import OF_TERRAIN


class Measured(Record):
    """Measurements of one point, in float64; all but errors and atmosphere have a leading axis of rays."""

    sensors: Sensor
    shots: Shot
    uvs: Float[Array, "rays 2"]
    use: Bool[Array, " rays"]
    sigma: Float[Array, "rays 2"] | None
    errors: ErrorModel | None
    occasions: Occasion
    air: Atmosphere | None


def checked_measurements(
    sensor: Any, shots: Any, uvs: Any, sigma: Any, errors: Any, use: Any, atmosphere: Any, shot_of: Any, flight_of: Any
) -> Measured:
    """Validated arguments of `forward_intersection`, with its errors."""
    require_x64()
    air = checked_air(atmosphere)
    pixels = jnp.asarray(as_float64(as_array(uvs, "uvs"), "uvs"))
    if pixels.ndim != 2 or pixels.shape[1] != 2:
        raise ValueError(
            f"uvs must hold a pixel (column, row) for each ray, of shape (rays, 2); got shape {pixels.shape}. For many "
            "points use jax.vmap."
        )
    rays = pixels.shape[0]
    if rays < 2:
        raise ValueError(f"an intersection needs at least two rays; got {rays}. For one ray on a terrain use locate.")
    stacked, sensors = _shots(shots, rays), _sensors(sensor, rays)
    used = _flags(use, rays)
    if sigma is None and errors is None:
        raise ValueError("give sigma, in px, or errors, an ErrorModel: without, nothing is known of the accuracy.")
    model = None
    if errors is not None:
        one, shot, pixel = jax.tree.map(lambda x: x[0], (sensors, stacked, pixels))
        model = checked_model(_without_terrain(errors), ModelInputs(Exposure(one, shot, 0.0, air), pixel))
    numbers = jnp.arange(rays).astype(jnp.float64)
    occasions = Occasion(
        numbers,
        numbers if shot_of is None else _numbers(shot_of, "shot_of", rays),
        jnp.zeros(rays) if flight_of is None else _numbers(flight_of, "flight_of", rays),
        jnp.asarray(stacked.time),
    )
    return Measured(sensors, stacked, pixels, used, _sigma(sigma, use, rays), model, occasions, air)


def _shots(shots: Any, rays: int) -> Shot:
    """A shot with a leading axis on every number."""
    if isinstance(shots, Trajectory):
        raise TypeError("shots must be a Shot of each image, not a Trajectory: jax.vmap(trajectory.at)(times).")
    if isinstance(shots, list | tuple):
        shots = _side_by_side(shots, Shot, "shots")
    check_is(shots, Shot, "shots", "Give one with a leading axis of rays, or a list.")
    given: Shot = as_float64(shots, "shots")
    check_latitude(given.pose.position, "shots.pose.position")
    readings = jnp.asarray(given.gimbal_readings)
    if readings.ndim == 1:
        readings = jnp.broadcast_to(readings[None, :], (rays, readings.shape[0]))
    if readings.ndim != 2 or readings.shape[0] != rays:
        raise ValueError(
            f"shots.gimbal_readings must have the shape ({rays}, axes), one row for each of uvs; got {readings.shape}."
        )

    def for_each(path: Any, value: Any) -> Array:
        value = jnp.asarray(value)
        if value.shape not in ((), (rays,)):
            name = "shots" + jax.tree_util.keystr(path)
            raise ValueError(f"{name} must have the shape ({rays},), one for each of uvs; got {value.shape}.")
        return jnp.broadcast_to(value, (rays,))

    pose, time = jax.tree_util.tree_map_with_path(for_each, (given.pose, given.time))
    assert isinstance(pose, Pose)
    return Shot(pose, readings, time)


def _sensors(sensor: Any, rays: int) -> Sensor:
    """A sensor with a leading axis on every number; a single sensor is repeated for all rays."""
    if isinstance(sensor, list | tuple):
        if len(sensor) != rays:
            raise ValueError(f"sensor must be one for all, or one for each of the {rays} rays; got {len(sensor)}.")
        sensor = _side_by_side(sensor, Sensor, "sensor")
    check_is(sensor, Sensor, "sensor")
    given: Sensor = as_float64(sensor, "sensor")
    if jnp.ndim(given.mount.lever_body) == 1:
        return jax.tree.map(lambda x: jnp.broadcast_to(x[None], (rays, *x.shape)), given)
    for path, leaf in jax.tree_util.tree_leaves_with_path(given):
        if jnp.ndim(leaf) < 1 or leaf.shape[0] != rays:
            name = "sensor" + jax.tree_util.keystr(path)
            raise ValueError(
                f"{name} must have a leading axis of {rays} rays, as all numbers of a batch of sensors; got shape "
                f"{jnp.shape(leaf)}. A list of sensors is put together as it should be."
            )
    return given


def _side_by_side(items: Any, kind: type, name: str) -> Any:
    """Records of one kind as a batch."""
    for number, item in enumerate(items):
        check_is(item, kind, f"{name}[{number}]")
    items = [as_float64(item, f"{name}[{number}]") for number, item in enumerate(items)]
    if not items:
        raise ValueError(f"{name} must not be empty.")
    if len({jax.tree.structure(item) for item in items}) > 1:
        raise ValueError(
            f"{name} must all be alike (kind of camera and lens, image size, gimbal, whether there is a deflection); "
            "those that differ have to be intersected as sensors of one kind."
        )
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *items)


def _flags(use: Any, rays: int) -> Bool[Array, " rays"]:
    if use is None:
        return jnp.ones(rays, bool)
    flags = jnp.asarray(use)
    if flags.shape != (rays,) or flags.dtype != bool:
        raise ValueError(f"use must be true or false for each of the {rays} rays; got {flags.dtype} {flags.shape}.")
    return flags


def _numbers(values: Any, name: str, rays: int) -> Float[Array, " rays"]:
    numbers: Any = jnp.asarray(as_float64(as_array(values, name), name))
    if numbers.shape != (rays,):
        raise ValueError(f"{name} must have a number for each of the {rays} rays; got shape {numbers.shape}.")
    return numbers


def _sigma(sigma: Any, use: Any, rays: int) -> Float[Array, "rays 2"] | None:
    """Standard deviations of column and row of each ray, px."""
    if sigma is None:
        return None
    given: Any = jnp.asarray(as_float64(as_array(sigma, "sigma"), "sigma"))
    if given.shape not in ((), (rays,), (rays, 2)):
        raise ValueError(f"sigma must be a number, one for each ray, or ({rays}, 2), in px; got shape {given.shape}.")
    known, used = concrete(sigma if jnp.ndim(sigma) == 0 else given), None if use is None else concrete(use)
    if known is not None and (known.ndim == 0 or use is None or used is not None):
        checked = known if known.ndim == 0 or used is None else known[used]
        wrong = ~((checked > 0.0) & (checked < math.inf))
        if wrong.any():
            raise ValueError(f"sigma must be positive and finite, in px; got {float(checked[wrong].reshape(-1)[0])!r}.")
    return jnp.broadcast_to(given[:, None] if given.ndim == 1 else given, (rays, 2))


def _without_terrain(errors: Any) -> Any:
    """Error sources without those of the terrain, which do not affect intersections."""
    sources = errors.sources if isinstance(errors, ErrorModel) else errors
    if not isinstance(sources, list | tuple):
        return errors
    kept = tuple(source for source in sources if not isinstance(source, OF_TERRAIN))
    if sources and not kept:
        raise ValueError("errors has only sources of the terrain, which no intersection depends on.")
    return kept
