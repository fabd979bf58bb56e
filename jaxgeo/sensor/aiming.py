"""Gimbal readings that point a line of sight at a target, with derivatives."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64, check_range, is_known
from jaxgeo._numerics import all_finite, matmul3, matvec, safe_norm
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Flags, Matrix3, Pixel, Scalar, StatusCode, Vector3, Vector3Field
from jaxgeo.earth import WGS84, Atmosphere, Geodetic, R_ecef_from_ned
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.sensor._gimbal_inverse import FreeAxes, nearest_readings
from jaxgeo.sensor._newton import determinant, solve_2d
from jaxgeo.sensor.gimbal import Readings
from jaxgeo.sensor.platform import Pose, Shot, Station
from jaxgeo.sensor.root_finder import FixedNewton, compiled_quickly, default_root_finder, find_root
from jaxgeo.sensor.sensor import Sensor, Sight
from jaxgeo.status import Status, first_failure, seen_beside, status_where


class LineOfSight(Record):
    """A line of sight: `ned`, a vector of any length in north-east-down at the position of the pose."""

    ned: Vector3Field

    @classmethod
    def from_degrees(cls, *, azimuth: ArrayLike, depression: ArrayLike) -> LineOfSight:
        """From the true azimuth and the angle below the horizontal, deg; shapes may carry a batch axis.

        Raises `ValueError` for an azimuth beyond +-360 deg and a depression beyond +-90 deg.
        """
        check_range(azimuth, "azimuth", "deg", -360.0, 360.0)
        check_range(depression, "depression", "deg", -90.0, 90.0)
        given: Any = as_float64((azimuth, depression), "LineOfSight.from_degrees")
        azimuth, depression = (jnp.deg2rad(angle) for angle in given)
        level = jnp.cos(depression)
        return cls(jnp.stack([level * jnp.cos(azimuth), level * jnp.sin(azimuth), jnp.sin(depression)], axis=-1))

    def to_degrees(self) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """(true azimuth in [0, 360), depression) in deg."""
        ned: Any = as_float64(self.ned, "line of sight")
        north, east, down = ned[..., 0], ned[..., 1], ned[..., 2]
        depression = jnp.rad2deg(jnp.arctan2(down, jnp.hypot(north, east)))
        return jnp.mod(jnp.rad2deg(jnp.arctan2(east, north)), 360.0), depression


Target: TypeAlias = Geodetic | LineOfSight

ROUNDS = 3  # the closed form ignores lever arms and atmosphere; each round leaves 1e-2 or 1e-6 of them
NEWTON_STEPS = 3
TOLERANCE = 1e-9  # rad: largest accepted pointing error; converged solutions have about 1e-15
SINGULAR = 1e-7  # relative determinant below which the axes count as parallel: minimum-norm step


class World(NamedTuple):
    """Pointing problem: sensor and station, a line of sight in the camera, and a target.

    The target is a point in ECEF m or, if that is None, a direction in ECEF. The rows of `axes` are two axes across the
    line of sight and the line of sight itself, in the camera frame. The readings of `station` are not used.
    """

    sensor: Sensor
    station: Station
    p_ecef: Vector3 | None
    direction: Vector3 | None
    axes: Matrix3
    air: Atmosphere | None

    @classmethod
    def of(cls, sensor: Sensor, station: Station, pose: Pose, target: Target, sight: Vector3, air: Any) -> World:
        """From a pose, a target and the line of sight in the camera."""
        down = jnp.cross(sight, jnp.array([1.0, 0.0, 0.0]))
        down = down / safe_norm(down)
        axes = jnp.stack([jnp.cross(down, sight), down, sight])
        if isinstance(target, Geodetic):
            return cls(sensor, station, WGS84.to_ecef(target), None, axes, air)
        largest = jnp.max(jnp.abs(target.ned))
        direction = matvec(R_ecef_from_ned(pose.position), target.ned / jnp.where(largest > 0.0, largest, 1.0))
        return cls(sensor, station, None, direction / safe_norm(direction), axes, air)

    def view(self, readings: Readings) -> Sight:
        """Position and orientation of the camera at given readings."""
        return self.sensor.sight(self.station._replace(gimbal_readings=readings))

    def direction_from(self, centre: Vector3, *, for_search: bool = False) -> Vector3:
        """Unit vector in ECEF to the target, or to its apparent position through the atmosphere.

        `for_search` omits the derivative of refraction by the perspective centre: 1e-4 rad times lever arm over
        distance, negligible for Newton steps; this halves the program to compile.
        """
        if self.p_ecef is None:
            return jnp.asarray(self.direction)
        origin = jax.lax.stop_gradient(centre) if for_search else centre
        seeming = self.p_ecef if self.air is None else apparent_point(origin, self.p_ecef, self.air)
        return (seeming - centre) / safe_norm(seeming - centre)


class Aimed(NamedTuple):
    """Readings within the limits, their pointing error in rad, and the status."""

    readings: Readings
    miss: Scalar
    status: StatusCode


class Way(NamedTuple):
    """Inputs of the search for readings."""

    world: World
    start: Readings
    free: FreeAxes
    from_start: Flag


Found: TypeAlias = tuple[Readings, Flag]  # readings; whether the solver found the root, if there is one
Search: TypeAlias = Callable[[Way], Found]


def aim(
    sensor: Sensor,
    pose: Pose,
    target: Target,
    uv: Pixel | None,
    given: Readings | None,
    air: Atmosphere | None,
    solver: Any = None,
) -> Aimed:
    """Readings that point the axis, or pixel `uv`, at a target or, within the limits, nearest to it.

    First the closed form for the direction to the target, iterated because the perspective centre and refraction
    depend on the readings; then a root of the exact model by `solver`. The default is `optimistix.Newton` for a single
    pointing of concrete values, which compiles the search for the nearest readings only if a target is out of reach,
    and `FixedNewton` inside `jit` and `vmap`. Derivatives are those of the implicit function for every solver; nearest
    readings that miss the target have none.
    """
    start = sensor.gimbal.neutral_readings() if given is None else given
    wanted = (sensor, pose, target, uv, start, jnp.asarray(given is not None), air)
    if solver is None:
        solver = default_root_finder() if is_known(wanted) else FixedNewton()
    if isinstance(solver, FixedNewton) or not is_known((wanted, solver)):
        return _aim_whole(solver, *wanted)
    found = compiled_quickly(_aim_short)(solver, *wanted)
    return compiled_quickly(_aim_long)(solver, *wanted) if found.status == Status.outside_gimbal_range else found


@eqx.filter_jit
def _aim_whole(solver: Any, *wanted: Any) -> Aimed:
    return _aim(functools.partial(_best, solver), *wanted)


def _aim_short(solver: Any, *wanted: Any) -> Aimed:
    return _aim(lambda way: (_short_way(solver, way), jnp.asarray(True)), *wanted)


def _aim_long(solver: Any, *wanted: Any) -> Aimed:
    return _aim(functools.partial(_long_way, solver), *wanted)


def _aim(
    search: Search,
    sensor: Sensor,
    pose: Pose,
    target: Target,
    uv: Pixel | None,
    start: Readings,
    from_start: Flag,
    air: Atmosphere | None,
) -> Aimed:
    sensor.gimbal.angles(start)  # raises for a wrong number of readings
    sight, status = _line_of_sight(sensor, uv)
    world = World.of(sensor, Station.of(Shot(pose, start)), pose, target, sight, air)
    is_valid = all_finite((sensor.gimbal.sign, sensor.gimbal.gain, sensor.gimbal.offset, sensor.mount))
    is_valid &= all_finite((pose, target, start, air))
    frozen, frozen_start = jax.lax.stop_gradient((world, start))
    free = _free_axes(frozen, frozen_start)
    best, converged = search(Way(frozen, frozen_start, free, from_start))
    is_valid &= all_finite(best)  # the direction is undefined for a target at the perspective centre
    miss = _angle_off(_target_seen(frozen, best))
    reached = (miss < TOLERANCE) & all_finite(best)
    found = _with_derivative(world, start, free, jnp.where(reached, best, frozen_start))
    outcome = status_where(reached, Status.hit, Status.outside_gimbal_range.code)
    outcome = status_where(~converged, Status.not_converged, outcome)
    outcome = status_where(~is_valid, Status.invalid_input, first_failure(status, outcome))
    known = is_valid & converged & (status == Status.hit)
    readings = jnp.where(reached, found, jax.lax.stop_gradient(best))
    return Aimed(jnp.where(known, readings, jnp.nan), jnp.where(known, miss, jnp.nan), outcome)


def _best(solver: Any, way: Way) -> Found:
    """Readings from one closed-form evaluation (`_short_way`), enough for most; otherwise from `_long_way`."""
    quick = _short_way(solver, way)
    missed = _angle_off(_target_seen(way.world, quick)) >= TOLERANCE
    numbers, rest = eqx.partition(solver, eqx.is_array)
    rescue = _only_if_missed(lambda way, numbers: _long_way(eqx.combine(numbers, rest), way))
    return rescue(missed, quick, way, numbers)


def _short_way(solver: Any, way: Way) -> Readings:
    start = _closed_form(way, 1, thorough=False)
    if isinstance(solver, FixedNewton):
        return _quick_newton(way.world, start, way.free)
    return _root(solver, way, start)


def _long_way(solver: Any, way: Way) -> Found:
    """Nearest readings within the limits, or the solver's root; False if it misses a target within reach."""
    start = _closed_form(way, ROUNDS, thorough=True)
    nearest = _newton(way.world, start, way.free)
    if isinstance(solver, FixedNewton):
        return nearest, jnp.asarray(True)
    root = _root(solver, way, start)
    hit, in_reach = (_angle_off(_target_seen(way.world, x)) < TOLERANCE for x in (root, nearest))
    return jnp.where(hit, root, nearest), hit | ~in_reach


def _root(solver: Any, way: Way, start: Readings) -> Readings:
    """Readings found by an optimistix solver from a start."""

    def residual(angles: Float[Array, " free"], given: Any) -> Pixel:
        world, start, free = given
        return _target_seen(world, _put(start, free, angles), for_search=True)[:2]

    limits = way.world.sensor.gimbal.limits[way.free]
    return _put(start, way.free, find_root(residual, solver, start[way.free], limits, (way.world, start, way.free)))


def _only_if_missed(long_way: Callable[[Way, Any], Found]) -> Callable[..., Found]:
    """Apply `long_way` to items whose quick readings miss; a batch runs it only if at least one item misses."""

    def chosen(missed: Flag, quick: Readings, way: Way, numbers: Any) -> Found:
        long, converged = long_way(way, numbers)
        return jnp.where(missed, long, quick), converged | ~missed

    def short(missed: Flags, quick: Array, *_: Any) -> tuple[Array, Flags]:
        return quick, jnp.ones_like(missed)

    @jax.custom_batching.custom_vmap
    def one(missed: Flag, *given: Any) -> Found:
        return jax.lax.cond(missed, chosen, short, missed, *given)

    @jax.custom_batching.custom_vmap
    def batch(missed: Flags, *given: Any) -> tuple[Float[Array, "n axes"], Flags]:
        return jax.lax.cond(jnp.any(missed), jax.vmap(chosen), short, missed, *given)

    @one.def_vmap
    def _(size: int, is_batched: Any, *given: Any) -> Any:
        return batch(*_spread(size, is_batched, given)), (True, True)

    @batch.def_vmap
    def _(size: int, is_batched: Any, *given: Any) -> Any:
        """Flatten nested batches; otherwise `cond` becomes a select and runs both branches."""
        batches = _spread(size, is_batched, given)
        found = batch(*jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batches))
        return jax.tree.map(lambda x: x.reshape(*batches[0].shape, *x.shape[1:]), found), (True, True)

    return one


def _spread(size: int, is_batched: Any, given: Any) -> Any:
    """Broadcast the unbatched leaves to the batch."""

    def spread(leaf: Any, own: bool) -> Array:
        return leaf if own else jnp.broadcast_to(jnp.asarray(leaf), (size, *jnp.shape(leaf)))

    return jax.tree.map(spread, given, tuple(is_batched))


def _closed_form(way: Way, rounds: int, *, thorough: bool) -> Readings:
    """Closed-form readings of the free axes, iterated with the camera position and apparent target direction."""
    world, start = way.world, way.start
    gimbal, mount = world.sensor.gimbal, world.sensor.mount
    if gimbal.reference == "level":
        R_ecef_from_base = world.station.R_ecef_from_level
    else:
        R_ecef_from_base = matmul3(world.station.R_ecef_from_body, mount.R_body_from_base)
    sight_head = matvec(mount.R_head_from_camera, world.axes[2])

    def once_more(_: Any, readings: Readings) -> Readings:
        wanted = matvec(R_ecef_from_base.T, world.direction_from(world.view(readings).centre))
        return nearest_readings(gimbal, start, way.free, sight_head, wanted, way.from_start, thorough=thorough)

    return once_more(0, start) if rounds == 1 else jax.lax.fori_loop(0, rounds, once_more, start)


def _quick_newton(world: World, start: Readings, free: FreeAxes) -> Readings:
    """Two Newton steps on the exact model and one with the second Jacobian, then clipped to the limits."""
    seen, J = _seen_and_slope(world, start, free, for_search=True)
    readings = _put(start, free, start[free] - _least_squares(J, seen))
    seen, J = _seen_and_slope(world, readings, free, for_search=True)
    readings = _put(readings, free, readings[free] - _least_squares(J, seen))
    readings = _put(readings, free, readings[free] - _least_squares(J, _target_seen(world, readings)[:2]))
    limits = world.sensor.gimbal.limits
    return jnp.clip(readings, limits[:, 0], limits[:, 1])


def _newton(world: World, start: Readings, free: FreeAxes) -> Readings:
    """A few Newton steps on the exact model within the limits; a step is accepted only if it reduces the error."""
    low, high = world.sensor.gimbal.limits[:, 0], world.sensor.gimbal.limits[:, 1]

    def step(_: Any, state: tuple[Readings, Scalar]) -> tuple[Readings, Scalar]:
        readings, miss = state
        seen, J = _seen_and_slope(world, readings, free, for_search=True)
        trial = jnp.clip(readings.at[free].add(-_least_squares(J, seen)), low, high)
        trial_miss = _angle_off(_target_seen(world, trial))
        better = trial_miss < miss
        return jnp.where(better, trial, readings), jnp.where(better, trial_miss, miss)

    return jax.lax.fori_loop(0, NEWTON_STEPS, step, (start, _angle_off(_target_seen(world, start))))[0]


def _line_of_sight(sensor: Sensor, uv: Pixel | None) -> tuple[Vector3, StatusCode]:
    """Direction in the camera frame to point at the target; the pixel may lie outside the image."""
    axis = sensor.camera.axis()
    if uv is None:
        return axis, Status.hit.code
    direction, status = sensor.camera.ray(uv)
    status = seen_beside(status, direction)
    return jnp.where(status == Status.hit, direction, axis), status


def _target_seen(world: World, readings: Readings, *, for_search: bool = False) -> Vector3:
    """Unit vector to the target: two components across the line of sight, then the one along it."""
    view = world.view(readings)
    direction = world.direction_from(view.centre, for_search=for_search)
    return matvec(world.axes, matvec(view.R_ecef_from_camera.T, direction))


def _seen_and_slope(
    world: World, readings: Readings, free: FreeAxes, *, for_search: bool = False
) -> tuple[Pixel, Float[Array, "2 free"]]:
    """The two components across the line of sight, and their derivatives by the free axes."""

    def across(angles: Float[Array, " free"]) -> tuple[Pixel, Pixel]:
        seen = _target_seen(world, _put(readings, free, angles), for_search=for_search)[:2]
        return seen, seen

    J, seen = jax.jacfwd(across, has_aux=True)(readings[free])
    return seen, J


def _angle_off(seen: Vector3) -> Scalar:
    return jnp.arctan2(safe_norm(seen[:2]), seen[2])


def _free_axes(world: World, start: Readings) -> FreeAxes:
    """The (at most) two axes that turn the line of sight most at the start, from base to head; others are fixed."""
    gimbal = world.sensor.gimbal
    if len(gimbal.axes) <= 2:
        return jnp.arange(len(gimbal.axes))
    turns = jax.jacfwd(lambda readings: matvec(world.view(readings).R_ecef_from_camera, world.axes[2]))(start)
    per_angle = jnp.sum((turns @ jnp.diag(1.0 / gimbal.gain)) ** 2, axis=0)
    return jnp.sort(jnp.argsort(-per_angle)[:2])


@jax.custom_jvp
def _with_derivative(world: World, held: Readings, free: FreeAxes, root: Readings) -> Readings:
    """Readings with `root` on the free axes and `held` on the others; derivatives by the implicit function."""
    return _put(held, free, root[free])


@_with_derivative.defjvp
def _(primals, tangents):
    """d root = -J^-1 (d seen by all other inputs), J by the free axes; recursive, for second derivatives."""
    world, held, free, root = primals
    d_world, d_held, _, _ = tangents
    found = _with_derivative(world, held, free, root)
    _, d_seen = jax.jvp(lambda w, h: _target_seen(w, _put(h, free, found[free]))[:2], (world, held), (d_world, d_held))
    _, J = _seen_and_slope(world, found, free)
    return found, _put(d_held, free, -_least_squares(J, d_seen))


def _put(readings: Readings, free: FreeAxes, values: Float[Array, " free"]) -> Readings:
    """Readings with other values on the free axes."""
    return readings.at[free].set(values, unique_indices=True)  # otherwise reverse mode cannot transpose it


def _least_squares(J: Float[Array, "2 free"], value: Pixel) -> Float[Array, " free"]:
    """Least-squares solution `x` of `J x = value` for one or two unknowns; minimum norm if J is singular.

    J is singular if the line of sight is parallel to an axis.
    """
    if J.shape[1] == 1:
        return (J.T @ value) / jnp.maximum(jnp.sum(J**2), SINGULAR**2)
    size = jnp.sum(J**2)
    singular = jnp.abs(determinant(J)) < SINGULAR * size
    shortest = solve_2d(J.T @ J + SINGULAR**2 * size * jnp.eye(2), J.T @ value)
    return jnp.where(singular, shortest, solve_2d(jnp.where(singular, jnp.eye(2), J), value))


@eqx.filter_jit
def aim_along(
    sensor: Sensor,
    poses: Pose,
    targets: Target,
    uv: Pixel | None,
    given: Readings | None,
    air: Atmosphere | None,
    solver: Any = None,
) -> Aimed:
    """`aim` for every knot, each started from the one before so that axes do not jump; default `FixedNewton`."""
    search = functools.partial(_best, FixedNewton() if solver is None else solver)
    start = sensor.gimbal.neutral_readings() if given is None else given

    def following(before: tuple[Readings, Flag], knot: tuple[Pose, Target]) -> tuple[tuple[Readings, Flag], Aimed]:
        readings, from_start = before
        aimed = _aim(search, sensor, *knot, uv, readings, from_start, air)
        usable = (aimed.miss < TOLERANCE) & all_finite(aimed.readings)
        readings = jnp.where(usable, jax.lax.stop_gradient(aimed.readings), readings)
        return (readings, from_start | usable), aimed

    first = jax.lax.stop_gradient(start), jnp.asarray(given is not None)
    return jax.lax.scan(following, first, (poses, targets))[1]
