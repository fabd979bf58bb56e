"""Gimbal readings that point at a ground point: input checks and error messages."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxgeo._checks import as_array, as_float64, check_finite, check_is, concrete
from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.sensor.aiming import TOLERANCE, Aimed, Target, aim, aim_along
from jaxgeo.sensor.camera import Numbers
from jaxgeo.sensor.gimbal import Gimbal, Readings
from jaxgeo.sensor.platform import Pose
from jaxgeo.sensor.sensor import Sensor
from jaxgeo.sensor.trajectory import Trajectory
from jaxgeo.status import Status


def readings_towards(
    sensor: Sensor,
    pose: Pose,
    point: Geodetic,
    uv: Numbers | None,
    readings: Numbers | None,
    air: Atmosphere | None,
) -> Readings:
    """Gimbal readings that put the optical axis, or pixel `uv`, on `point`. See `Sensor.looking_at`."""
    check_axes(sensor.gimbal)
    check_is(pose, Pose, "pose", "Of a Shot or a Trajectory, shot.pose or trajectory.at(time).pose.")
    check_is(point, Geodetic, "point")
    check_air(air)
    uv, readings = as_array(uv, "uv"), as_array(readings, "readings")
    given: Any = as_float64((sensor, pose, point, uv, readings, air), "looking_at")
    _check_given(given[1:])
    found = aim(*given)
    _raise_unless_reached(given, found)
    return _reached(found)


def steered(
    sensor: Sensor,
    trajectory: Trajectory,
    points: Geodetic,
    uv: Numbers | None,
    readings: Numbers | None,
    air: Atmosphere | None,
) -> Trajectory:
    """Trajectory with readings that point at `points` knot by knot. See `Sensor.steered`."""
    check_axes(sensor.gimbal)
    check_is(trajectory, Trajectory, "trajectory")
    check_is(points, Geodetic, "points")
    check_air(air)
    uv, readings = as_array(uv, "uv"), as_array(readings, "readings")
    given: Any = as_float64((sensor, trajectory, points, uv, readings, air), "steered")
    sensor, trajectory, points, uv, start, air = given
    _check_given((trajectory.poses, points, uv, start, air))
    points = for_each_knot(trajectory, points, "points")
    found = aim_along(sensor, trajectory.poses, points, uv, start, air)
    readings = jax.vmap(_reached)(found)
    lost = concrete(jnp.any(jnp.isnan(readings), axis=1))
    if lost is not None and np.any(lost):
        knot = int(np.argmax(lost))
        pose, point, aimed = jax.tree.map(lambda x: x[knot], (trajectory.poses, points, found))
        _raise_unless_reached((sensor, pose, point, uv, start, air), aimed, f"At knot {knot}: ")
    return trajectory.with_readings(readings)


def for_each_knot(trajectory: Trajectory, target: Target, name: str) -> Any:
    """Broadcast a target to every knot of a trajectory; it is given once for all knots, or once per knot."""
    knots = trajectory.times.shape[0]
    items = {"lat": 0, "lon": 0, "height": 0} if isinstance(target, Geodetic) else {"ned": 1}
    for field, rank in items.items():
        shape = jnp.shape(getattr(target, field))
        if shape[: len(shape) - rank] not in ((), (knots,)):
            raise ValueError(f"{name} must be one position, or one for each of the {knots} knots; got shape {shape}.")

    def spread(x: Array, rank: int) -> Array:
        return jnp.broadcast_to(x, (knots, *x.shape[x.ndim - rank :]))

    return type(target)(**{field: spread(getattr(target, field), rank) for field, rank in items.items()})


def _reached(found: Aimed) -> Readings:
    return jnp.where(found.status == Status.hit, found.readings, jnp.nan)


def check_axes(gimbal: Gimbal) -> None:
    """Raise `ValueError` for a gimbal without axes."""
    if not gimbal.axes:
        raise ValueError(
            "This sensor's gimbal has no axes, so it cannot look at a point: turn the platform, e.g. Pose.looking_at."
        )


def check_air(air: Any) -> None:
    """Raise `TypeError` unless `air` is an atmosphere or None."""
    if air is not None:
        check_is(air, Atmosphere, "atmosphere", "Leave it out for no refraction.")


def _check_given(given: Any) -> None:
    for leaf in jax.tree.leaves(given):
        check_finite(leaf, "What looking_at is given (pose, point, uv, readings, atmosphere)", "rad, m, pixels or SI")


def _raise_unless_reached(given: Any, found: Aimed, where: str = "") -> None:
    status = concrete(found.status)
    if status is None or status == Status.hit:
        return
    code, gimbal = Status(int(status)), given[0].gimbal
    if code != Status.outside_gimbal_range:
        raise ValueError(f"{where}Pixel uv cannot be put on the point. {code.message}")
    raise ValueError(f"{where}{out_of_range(gimbal, found, _without_limits(given))}")


def _without_limits(given: Any) -> Aimed:
    """The solution without gimbal limits."""
    wide = jnp.tile(jnp.array([-4.0, 4.0]) * jnp.pi, (len(given[0].gimbal.axes), 1))
    wide = wide / jnp.abs(given[0].gimbal.gain)[:, None] + given[0].gimbal.offset[:, None]
    return aim(eqx.tree_at(lambda sensor: sensor.gimbal.limits, given[0], wide), *given[1:])


def out_of_range(gimbal: Gimbal, found: Aimed, free: Aimed) -> str:
    """Error message for an unreachable target, from the solutions within limits (`found`) and without (`free`)."""
    missed = math.degrees(float(found.miss))
    nearest = f"nearest within them it comes at {_named(gimbal, found.readings)} deg, {missed:.4g} deg off"
    if float(free.miss) >= TOLERANCE:
        return (
            f"The gimbal cannot look at the point: the best it finds, {_named(gimbal, found.readings)} deg, misses it "
            f"by {missed:.4g} deg. Check the pose and which axes there are, or give `readings` to start from."
        )
    limits = np.asarray(gimbal.limits)
    bounds = ", ".join(
        f"{n} {math.degrees(low):.4g}..{math.degrees(high):.4g}"
        for n, (low, high) in zip(gimbal.names, limits, strict=True)
    )
    return (
        f"The gimbal would have to go to {_named(gimbal, free.readings)} deg to look at the point, outside its limits, "
        f"{bounds} deg; {nearest}. Turn the platform, or choose another point."
    )


def _named(gimbal: Gimbal, readings: Readings) -> str:
    values = np.asarray(readings).tolist()
    return ", ".join(f"{n} {math.degrees(r):.4f}" for n, r in zip(gimbal.names, values, strict=True))
