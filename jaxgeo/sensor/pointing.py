"""Shots and trajectories whose gimbal points at the ground, with input checks and error messages."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxgeo._checks import as_array, as_float64, check_finite, check_is, concrete
from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.earth.geodetic import check_position
from jaxgeo.sensor.aiming import TOLERANCE, Aimed, aim, aim_along
from jaxgeo.sensor.camera import Numbers
from jaxgeo.sensor.gimbal import Gimbal, Readings
from jaxgeo.sensor.line_of_sight import Target
from jaxgeo.sensor.platform import Pose, Shot
from jaxgeo.sensor.sensor import Sensor
from jaxgeo.sensor.trajectory import Trajectory
from jaxgeo.status import Status


def point_shot(
    sensor: Sensor,
    pose: Pose,
    point: Geodetic,
    *,
    uv: Numbers | None = None,
    readings: Numbers | None = None,
    time: ArrayLike = 0.0,
    atmosphere: Atmosphere | None = None,
) -> Shot:
    """Shot at `pose` whose gimbal readings put the optical axis (or pixel `uv`, or a sweep's middle) on `point`.

    Includes lever arms, boresight, gains, distortion and, if given, the atmosphere. `readings` are the start of the
    search, by default zero axis angles clipped to the limits. With more than two axes, those that move the line of
    sight least at the start (the roll of a drone's gimbal) keep their start readings.
    Raises `ValueError` if the gimbal cannot reach the point within its limits, in words and degrees, or if the Earth
    hides it; for traced input the readings are NaN instead. `coverage.point_gimbal` sets a status instead, and
    considers terrain.

    >>> from jaxgeo.sensor import point_shot
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> shot = point_shot(sensor, pose, jaxgeo.Geodetic.from_degrees(lat=47.001, lon=11.001, height=600.0))
    >>> yaw, pitch, roll = np.rad2deg(shot.gimbal_readings)
    >>> print(f"yaw {yaw:.2f} deg, pitch {pitch:.2f} deg")
    yaw 34.38 deg, pitch -41.70 deg
    """
    check_axes(sensor.gimbal)
    check_is(pose, Pose, "pose", "Of a Shot or a Trajectory, shot.pose or trajectory.at(time).pose.")
    check_position(point, "point")
    check_air(atmosphere)
    uv, readings = as_array(uv, "uv"), as_array(readings, "readings")
    given: Any = as_float64((sensor, pose, point, uv, readings, atmosphere), "point_shot")
    _check_given("point_shot", given[1:])
    found = aim(*given)
    _raise_unless_reached(given, found)
    return Shot(pose, _reached(found), time)


def point_trajectory(
    sensor: Sensor,
    trajectory: Trajectory,
    points: Geodetic,
    *,
    uv: Numbers | None = None,
    readings: Numbers | None = None,
    atmosphere: Atmosphere | None = None,
) -> Trajectory:
    """Trajectory with gimbal readings that keep the optical axis (or `uv`) on `points`.

    `points` hold one position per knot (a scan path over the ground), or a single one to stare at.
    `readings` are the start of the search at the first knot; each later knot starts from the one before, so that
    axes do not jump. Raises `ValueError` as `point_shot`, naming the knot.
    """
    check_axes(sensor.gimbal)
    check_is(trajectory, Trajectory, "trajectory")
    check_position(points, "points")
    check_air(atmosphere)
    uv, readings = as_array(uv, "uv"), as_array(readings, "readings")
    given: Any = as_float64((sensor, trajectory, points, uv, readings, atmosphere), "point_trajectory")
    sensor, trajectory, points, uv, start, air = given
    _check_given("point_trajectory", (trajectory.poses, points, uv, start, air))
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
            "This sensor's gimbal has no axes, so it cannot point: turn the platform, e.g. Pose.looking_at."
        )


def check_air(air: Any) -> None:
    """Raise `TypeError` unless `air` is an atmosphere or None."""
    if air is not None:
        check_is(air, Atmosphere, "atmosphere", "Leave it out for no refraction.")


def _check_given(function: str, given: Any) -> None:
    for leaf in jax.tree.leaves(given):
        check_finite(leaf, f"The input of {function} (pose, point, uv, readings, atmosphere)", "rad, m, pixels or SI")


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
