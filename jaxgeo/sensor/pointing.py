"""Which gimbal readings look at a point."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from jaxgeo._checks import as_array, as_float64, check_finite, check_is, concrete
from jaxgeo._numerics import all_finite, safe_norm
from jaxgeo._typing import Flag, Pixel, Scalar, StatusCode, Vector3
from jaxgeo.earth import WGS84, Atmosphere, Geodetic
from jaxgeo.sensor._newton import solve_2d
from jaxgeo.sensor.camera import Numbers
from jaxgeo.sensor.gimbal import Gimbal, Readings
from jaxgeo.sensor.platform import Pose, Shot
from jaxgeo.sensor.sensor import Sensor
from jaxgeo.sensor.trajectory import Trajectory
from jaxgeo.status import Status, status_where

FreeAxes = Int[Array, " free"]
FreeAngles = Float[Array, " free"]
Seen = Callable[[Readings], Vector3]
World = tuple[
    Sensor, Pose, Geodetic, Vector3, Atmosphere | None
]  # and, before the air, the line of sight in the camera

STARTS = 19  # starting angles for each of the two axes that search: odd, so that zero is one; 20 deg apart at most
MAX_STEPS = 60
TOLERANCE = 1e-9  # rad by which an accepted answer may miss; those that converge miss by some 1e-15


def readings_towards(
    sensor: Sensor,
    pose: Pose,
    point: Geodetic,
    uv: Numbers | None,
    readings: Numbers | None,
    air: Atmosphere | None,
) -> Readings:
    """Gimbal readings that put the optical axis, or pixel `uv`, on `point`. See `Sensor.looking_at`."""
    _check_axes(sensor.gimbal)
    check_is(pose, Pose, "pose", "Of a Shot or a Trajectory, shot.pose or trajectory.at(time).pose.")
    check_is(point, Geodetic, "point")
    _check_air(air)
    uv, readings = as_array(uv, "uv"), as_array(readings, "readings")
    given: Any = as_float64((sensor, pose, point, uv, readings, air), "looking_at")
    _check_given(given[1:])
    found = _search(*given)
    _raise_unless_reached(sensor.gimbal, found)
    return _reached(found)


def steered(
    sensor: Sensor,
    trajectory: Trajectory,
    points: Geodetic,
    uv: Numbers | None,
    readings: Numbers | None,
    air: Atmosphere | None,
) -> Trajectory:
    """The trajectory with readings that look at `points` knot by knot. See `Sensor.steered`."""
    _check_axes(sensor.gimbal)
    check_is(trajectory, Trajectory, "trajectory")
    check_is(points, Geodetic, "points")
    _check_air(air)
    uv, readings = as_array(uv, "uv"), as_array(readings, "readings")
    given: Any = as_float64((sensor, trajectory, points, uv, readings, air), "steered")
    sensor, trajectory, points, uv, start, air = given
    _check_given((trajectory.poses, points, uv, start, air))
    knots = trajectory.times.shape
    wrong = [leaf.shape for leaf in jax.tree.leaves(points) if leaf.shape not in ((), knots)]
    if wrong:
        raise ValueError(f"points must be one position, or one for each of the {knots[0]} knots; got shape {wrong[0]}.")
    points = jax.tree.map(lambda x: jnp.broadcast_to(x, knots), points)
    found = _steer(sensor, trajectory.poses, points, uv, start, air)
    readings = jax.vmap(_reached)(found)
    lost = concrete(jnp.any(jnp.isnan(readings), axis=1))
    if lost is not None and np.any(lost):
        knot = int(np.argmax(lost))
        _raise_unless_reached(sensor.gimbal, jax.tree.map(lambda x: x[knot], found), f"At knot {knot}: ")
    return trajectory.with_readings(readings)


@eqx.filter_jit
def _steer(
    sensor: Sensor,
    poses: Pose,
    points: Geodetic,
    uv: Pixel | None,
    given: Readings | None,
    air: Atmosphere | None,
) -> Aimed:
    """`_search` for every knot, each from the one before."""
    pose, point = jax.tree.map(lambda x: x[0], (poses, points))
    first = _search(sensor, pose, point, uv, given, air)

    def following(before: Readings, knot: tuple[Pose, Geodetic]) -> tuple[Readings, Aimed]:
        aimed = _search(sensor, *knot, uv, jax.lax.stop_gradient(before), air)
        usable = (aimed.miss < TOLERANCE) & all_finite(aimed.readings)
        return jnp.where(usable, aimed.readings, before), aimed

    return jax.lax.scan(following, first.readings, (poses, points))[1]


class Aimed(NamedTuple):
    """Readings, the angle in rad by which they miss, whether they are within limits, and the status of the pixel."""

    readings: Readings
    miss: Scalar
    inside: Flag
    status: StatusCode


def _reached(found: Aimed) -> Readings:
    reached = (found.miss < TOLERANCE) & found.inside & (found.status == Status.hit)
    return jnp.where(reached, found.readings, jnp.nan)


@eqx.filter_jit
def _search(
    sensor: Sensor,
    pose: Pose,
    point: Geodetic,
    uv: Pixel | None,
    given: Readings | None,
    air: Atmosphere | None,
) -> Aimed:
    start = sensor.gimbal.neutral_readings() if given is None else given
    sensor.gimbal.angles(start)  # refuses a wrong number of readings
    sight, status = _line_of_sight(sensor, uv)
    world = (sensor, pose, point, sight, air)
    frozen, frozen_start = jax.lax.stop_gradient((world, start))

    def seen(readings: Readings) -> Vector3:
        return _point_seen(frozen, readings)

    free = _free_axes(sensor, pose, sight, frozen_start)
    if given is None:
        frozen_start = _best_start(seen, frozen[0].gimbal, frozen_start, free)
    best = _gauss_newton(seen, frozen_start, free)
    miss = _angle_off(seen(best))
    reached = (miss < TOLERANCE) & all_finite(best)
    root = jnp.where(reached, best, frozen_start)
    found = _with_derivative(world, start, free, jax.lax.stop_gradient(root))
    return Aimed(jnp.where(reached, found, best), miss, sensor.gimbal.inside_limits(best), status)


def _line_of_sight(sensor: Sensor, uv: Pixel | None) -> tuple[Vector3, StatusCode]:
    """Direction in the camera frame to bring onto the point; a pixel outside the image will do too."""
    axis = sensor.camera.axis()
    if uv is None:
        return axis, Status.hit.code
    direction, status = sensor.camera.ray(uv)
    status = status_where(status == Status.outside_image, Status.hit, status)
    return jnp.where(status == Status.hit, direction, axis), status


def _point_seen(world: World, readings: Readings) -> Vector3:
    """Unit vector to the point: two components across the line of sight, then the one along it."""
    sensor, pose, point, sight, air = world
    p_camera = sensor.sight(Shot(pose, readings)).to_camera(WGS84.to_ecef(point), air)
    down = jnp.cross(sight, jnp.array([1.0, 0.0, 0.0]))
    down = down / safe_norm(down)
    axes = jnp.stack([jnp.cross(down, sight), down, sight])
    return axes @ (p_camera / safe_norm(p_camera))


def _angle_off(seen: Vector3) -> Scalar:
    return jnp.arctan2(safe_norm(seen[:2]), seen[2])


def _free_axes(sensor: Sensor, pose: Pose, sight: Vector3, start: Readings) -> FreeAxes:
    """The (at most) two axes that turn the line of sight most at the start, from base to head; others are held."""
    sensor, pose, sight = jax.lax.stop_gradient((sensor, pose, sight))
    turns = jax.jacfwd(lambda readings: sensor.R_ned_from_camera(Shot(pose, readings)) @ sight)(start)
    per_angle = jnp.sum((turns @ jnp.diag(1.0 / sensor.gimbal.gain)) ** 2, axis=0)
    return jnp.sort(jnp.argsort(-per_angle)[:2])


def _best_start(seen: Seen, gimbal: Gimbal, start: Readings, free: FreeAxes) -> Readings:
    """The best of a coarse grid within the limits; of equals, the least turned, and not over head by the inner axis."""
    half_turn = jnp.pi / jnp.abs(gimbal.gain)
    low = jnp.maximum(gimbal.limits[:, 0], gimbal.offset - half_turn)[free]
    high = jnp.minimum(gimbal.limits[:, 1], gimbal.offset + half_turn)[free]
    fractions = jnp.meshgrid(*[jnp.linspace(0.0, 1.0, STARTS)] * free.shape[0], indexing="ij")

    def candidate(fraction: FreeAngles) -> tuple[Readings, Scalar]:
        readings = start.at[free].set(low + fraction * (high - low))
        turned = gimbal.angles(readings)[free]
        over_head = jnp.maximum(jnp.abs(turned[-1]) - jnp.pi / 2.0, 0.0)
        return readings, -seen(readings)[2] + 1e-6 * jnp.sum(turned**2) + 10.0 * over_head

    candidates, costs = jax.vmap(candidate)(jnp.stack([f.ravel() for f in fractions], axis=1))
    return candidates[jnp.argmin(costs)]


def _gauss_newton(seen: Seen, start: Readings, free: FreeAxes) -> Readings:
    """Damped least squares over the free axes on the two components across the line of sight."""

    def moved(change: FreeAngles) -> Vector3:
        return seen(start.at[free].add(change))

    def body(state):
        change, miss, damping, count = state
        J = jax.jacfwd(lambda c: moved(c)[:2])(change)
        trial = change - _least_squares(J, moved(change)[:2], damping)
        trial_miss = _angle_off(moved(trial))
        better = trial_miss < miss
        damping = jnp.where(better, 1e-3 * damping, jnp.maximum(10.0 * damping, 1e-10))
        return jnp.where(better, trial, change), jnp.where(better, trial_miss, miss), damping, count + 1

    def unfinished(state) -> Flag:
        _, miss, damping, count = state
        return (miss > 1e-15) & (damping < 1e8) & (count < MAX_STEPS)

    stay = jnp.zeros(free.shape[0])
    state = (stay, _angle_off(moved(stay)), jnp.asarray(1e-6), jnp.asarray(0))
    return start.at[free].add(jax.lax.while_loop(unfinished, body, state)[0])


@jax.custom_jvp
def _with_derivative(world: World, held: Readings, free: FreeAxes, root: Readings) -> Readings:
    """Readings with `root` on the free axes and `held` on the others, with the derivatives of the implicit function."""
    return held.at[free].set(root[free])


@_with_derivative.defjvp
def _(primals, tangents):
    """d root = -J^-1 (d seen by all else), J by the free axes. Reused within itself, for second derivatives."""
    world, held, free, root = primals
    d_world, d_held, _, _ = tangents
    found = _with_derivative(world, held, free, root)
    _, d_seen = jax.jvp(lambda w, h: _point_seen(w, h.at[free].set(found[free]))[:2], (world, held), (d_world, d_held))
    J = jax.jacfwd(lambda angles: _point_seen(world, found.at[free].set(angles))[:2])(found[free])
    return found, d_held.at[free].set(-_least_squares(J, d_seen))


def _least_squares(J: Float[Array, "2 free"], value: Float[Array, "2"], damping: ArrayLike = 0.0) -> FreeAngles:
    """`x` that makes `J x` nearest to `value`, for one or two unknowns; exact for two without damping."""
    if J.shape[1] == 1:
        return (J.T @ value) / (jnp.sum(J**2) + damping)
    if isinstance(damping, float) and damping == 0.0:
        return solve_2d(J, value)
    return solve_2d(J.T @ J + damping * jnp.eye(2), J.T @ value)


def _check_axes(gimbal: Gimbal) -> None:
    if not gimbal.axes:
        raise ValueError(
            "This sensor's gimbal has no axes, so it cannot look at a point: turn the platform, e.g. Pose.looking_at."
        )


def _check_air(air: Any) -> None:
    if air is not None:
        check_is(air, Atmosphere, "atmosphere", "Leave it out for no refraction.")


def _check_given(given: Any) -> None:
    for leaf in jax.tree.leaves(given):
        check_finite(leaf, "What looking_at is given (pose, point, uv, readings, atmosphere)", "rad, m, pixels or SI")


def _raise_unless_reached(gimbal: Gimbal, found: Aimed, where: str = "") -> None:
    values = [concrete(x) for x in (*found, gimbal.limits)]
    if any(value is None for value in values):
        return
    readings, missed, within, code, limits = (value.tolist() for value in values)  # pyright: ignore
    if code != Status.hit:
        raise ValueError(f"{where}Pixel uv cannot be put on the point. {Status(code).message}")
    named = ", ".join(f"{n} {math.degrees(r):.4f}" for n, r in zip(gimbal.names, readings, strict=True))
    if not missed < TOLERANCE:
        raise ValueError(
            f"{where}The gimbal cannot look at the point: the best it finds, {named} deg, misses it by "
            f"{math.degrees(missed):.4g} deg. Check the limits and the pose, or give `readings` to start from."
        )
    if not within:
        bounds = ", ".join(
            f"{n} {math.degrees(low):.4g}..{math.degrees(high):.4g}"
            for n, (low, high) in zip(gimbal.names, limits, strict=True)
        )
        raise ValueError(
            f"{where}The gimbal would have to go to {named} deg to look at the point, outside its limits, "
            f"{bounds} deg. "
            f"Turn the platform, choose another point, or give `readings` to start from."
        )
