"""Search for the gimbal readings that point at a target: closed form, Newton steps, or an optimistix solver."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._checks import is_known
from jaxgeo._compile import quick_filter_jit
from jaxgeo._numerics import all_finite, matmul3, matvec
from jaxgeo._typing import Flag, Flags, Pixel, Scalar, StatusCode
from jaxgeo.earth import WGS84, Atmosphere, Geodetic
from jaxgeo.earth._horizon import hidden_by_earth
from jaxgeo.sensor._gimbal_inverse import FreeAxes, nearest_readings
from jaxgeo.sensor.gimbal import Readings
from jaxgeo.sensor.line_of_sight import Target
from jaxgeo.sensor.platform import Pose, Shot, Station
from jaxgeo.sensor.pointing_problem import (
    PointingProblem,
    angle_off,
    camera_direction,
    free_axes,
    least_squares,
    seen_and_slope,
    target_seen,
    with_derivative,
    with_free,
)
from jaxgeo.sensor.root_finder import FixedNewton, default_root_finder, find_root
from jaxgeo.sensor.sensor import Sensor
from jaxgeo.status import Status, first_failure, status_where

ROUNDS = 3  # the closed form ignores lever arms and atmosphere; each round leaves 1e-2 or 1e-6 of them
NEWTON_STEPS = 3
TOLERANCE = 1e-9  # rad: largest accepted pointing error; converged solutions have about 1e-15


class Aimed(NamedTuple):
    """Readings within the limits, their pointing error in rad, and the status."""

    readings: Readings
    miss: Scalar
    status: StatusCode


class SearchInputs(NamedTuple):
    """Inputs of the search for readings."""

    problem: PointingProblem
    start: Readings
    free: FreeAxes
    from_start: Flag


Found: TypeAlias = tuple[Readings, Flag]  # readings; whether the solver found the root, if there is one
Search: TypeAlias = Callable[[SearchInputs], Found]


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
    found = _aim_short(solver, *wanted)
    return _aim_long(solver, *wanted) if found.status == Status.outside_gimbal_range else found


@eqx.filter_jit
def _aim_whole(solver: Any, *wanted: Any) -> Aimed:
    return _aim(functools.partial(_best, solver), *wanted)


@quick_filter_jit
def _aim_short(solver: Any, *wanted: Any) -> Aimed:
    return _aim(lambda inputs: (_short_way(solver, inputs), jnp.asarray(True)), *wanted)


@quick_filter_jit
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
    sight, status = camera_direction(sensor, uv)
    problem = PointingProblem.of(sensor, Station.of(Shot(pose, start)), pose, target, sight, air)
    is_valid = all_finite((sensor.gimbal.sign, sensor.gimbal.gain, sensor.gimbal.offset, sensor.mount))
    is_valid &= all_finite((pose, target, start, air))
    frozen, frozen_start = jax.lax.stop_gradient((problem, start))
    free = free_axes(frozen, frozen_start)
    best, converged = search(SearchInputs(frozen, frozen_start, free, from_start))
    is_valid &= all_finite(best)  # the direction is undefined for a target at the perspective centre
    miss = angle_off(target_seen(frozen, best))
    reached = (miss < TOLERANCE) & all_finite(best)
    found = with_derivative(problem, start, free, jnp.where(reached, best, frozen_start))
    outcome = status_where(reached, Status.hit, Status.outside_gimbal_range.code)
    if isinstance(target, Geodetic):
        is_hidden = hidden_by_earth(WGS84.to_ecef(pose.position), WGS84.to_ecef(target))
        outcome = status_where(reached & is_hidden, Status.below_horizon, outcome)
    outcome = status_where(~converged, Status.not_converged, outcome)
    outcome = status_where(~is_valid, Status.invalid_input, first_failure(status, outcome))
    known = is_valid & converged & (status == Status.hit)
    readings = jnp.where(reached, found, jax.lax.stop_gradient(best))
    return Aimed(jnp.where(known, readings, jnp.nan), jnp.where(known, miss, jnp.nan), outcome)


def _best(solver: Any, inputs: SearchInputs) -> Found:
    """Readings from one closed-form evaluation (`_short_way`), enough for most; otherwise from `_long_way`."""
    quick = _short_way(solver, inputs)
    missed = angle_off(target_seen(inputs.problem, quick)) >= TOLERANCE
    numbers, rest = eqx.partition(solver, eqx.is_array)
    rescue = _only_if_missed(lambda inputs, numbers: _long_way(eqx.combine(numbers, rest), inputs))
    return rescue(missed, quick, inputs, numbers)


def _short_way(solver: Any, inputs: SearchInputs) -> Readings:
    start = _closed_form(inputs, 1, thorough=False)
    if isinstance(solver, FixedNewton):
        return _quick_newton(inputs.problem, start, inputs.free)
    return _root(solver, inputs, start)


def _long_way(solver: Any, inputs: SearchInputs) -> Found:
    """Nearest readings within the limits, or the solver's root; False if it misses a target within reach."""
    start = _closed_form(inputs, ROUNDS, thorough=True)
    nearest = _newton(inputs.problem, start, inputs.free)
    if isinstance(solver, FixedNewton):
        return nearest, jnp.asarray(True)
    root = _root(solver, inputs, start)
    hit, in_reach = (angle_off(target_seen(inputs.problem, x)) < TOLERANCE for x in (root, nearest))
    return jnp.where(hit, root, nearest), hit | ~in_reach


def _root(solver: Any, inputs: SearchInputs, start: Readings) -> Readings:
    """Readings found by an optimistix solver from a start."""

    def residual(angles: Float[Array, " free"], given: Any) -> Pixel:
        problem, start, free = given
        return target_seen(problem, with_free(start, free, angles), for_search=True)[:2]

    problem, free = inputs.problem, inputs.free
    limits = problem.sensor.gimbal.limits[free]
    return with_free(start, free, find_root(residual, solver, start[free], limits, (problem, start, free)))


def _only_if_missed(long_way: Callable[[SearchInputs, Any], Found]) -> Callable[..., Found]:
    """Apply `long_way` to items whose quick readings miss; a batch runs it only if at least one item misses."""

    def chosen(missed: Flag, quick: Readings, inputs: SearchInputs, numbers: Any) -> Found:
        long, converged = long_way(inputs, numbers)
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


def _closed_form(inputs: SearchInputs, rounds: int, *, thorough: bool) -> Readings:
    """Closed-form readings of the free axes, iterated with the camera position and apparent target direction."""
    problem, start = inputs.problem, inputs.start
    gimbal, mount = problem.sensor.gimbal, problem.sensor.mount
    if gimbal.reference == "level":
        R_ecef_from_base = problem.station.R_ecef_from_level
    else:
        R_ecef_from_base = matmul3(problem.station.R_ecef_from_body, mount.R_body_from_base)
    sight_head = matvec(mount.R_head_from_camera, problem.axes[2])

    def once_more(_: Any, readings: Readings) -> Readings:
        wanted = matvec(R_ecef_from_base.T, problem.direction_from(problem.view(readings).centre))
        return nearest_readings(gimbal, start, inputs.free, sight_head, wanted, inputs.from_start, thorough=thorough)

    return once_more(0, start) if rounds == 1 else jax.lax.fori_loop(0, rounds, once_more, start)


def _quick_newton(problem: PointingProblem, start: Readings, free: FreeAxes) -> Readings:
    """Two Newton steps on the exact model and one with the second Jacobian, then clipped to the limits."""
    seen, J = seen_and_slope(problem, start, free, for_search=True)
    readings = with_free(start, free, start[free] - least_squares(J, seen))
    seen, J = seen_and_slope(problem, readings, free, for_search=True)
    readings = with_free(readings, free, readings[free] - least_squares(J, seen))
    readings = with_free(readings, free, readings[free] - least_squares(J, target_seen(problem, readings)[:2]))
    limits = problem.sensor.gimbal.limits
    return jnp.clip(readings, limits[:, 0], limits[:, 1])


def _newton(problem: PointingProblem, start: Readings, free: FreeAxes) -> Readings:
    """A few Newton steps on the exact model within the limits; a step is accepted only if it reduces the error."""
    low, high = problem.sensor.gimbal.limits[:, 0], problem.sensor.gimbal.limits[:, 1]

    def step(_: Any, state: tuple[Readings, Scalar]) -> tuple[Readings, Scalar]:
        readings, miss = state
        seen, J = seen_and_slope(problem, readings, free, for_search=True)
        trial = jnp.clip(readings.at[free].add(-least_squares(J, seen)), low, high)
        trial_miss = angle_off(target_seen(problem, trial))
        better = trial_miss < miss
        return jnp.where(better, trial, readings), jnp.where(better, trial_miss, miss)

    return jax.lax.fori_loop(0, NEWTON_STEPS, step, (start, angle_off(target_seen(problem, start))))[0]


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
