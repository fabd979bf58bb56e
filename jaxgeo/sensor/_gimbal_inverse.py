"""Closed-form inverse of a gimbal: readings within the limits whose line of sight is nearest to a direction."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._numerics import cross, dot, matmul3, matvec, safe_norm, safe_sqrt
from jaxgeo._typing import Flag, Matrix3, Numbers, Scalar, Vector3
from jaxgeo.rotations import Rx, Ry, Rz
from jaxgeo.sensor.gimbal import Gimbal, Readings

FreeAxes = Int[Array, " free"]

SINGULAR = 1e-9  # rad between a line and an axis; below it, rotation about the axis does not move the line
EXACT = 1e-9  # rad; pointing errors below this count as equal
LIMIT_SLACK = 1e-12  # turns; rounding tolerance for a reading on its limit
OVER_HEAD = 10.0  # cost (rad2 per rad) of inner-axis rotation beyond a right angle, added to the rotation in rad2

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_ROTATIONS = {"x": Rx, "y": Ry, "z": Rz}


class TwoAxes(NamedTuple):
    """Solve Exp(outer a) Exp(inner b) sight = wanted for the angles a and b; all vectors are unit vectors."""

    outer: Vector3
    inner: Vector3
    sight: Vector3
    wanted: Vector3


def nearest_readings(
    gimbal: Gimbal,
    start: Readings,
    free: FreeAxes,
    sight_head: Vector3,
    wanted_base: Vector3,
    from_start: Flag,
    *,
    thorough: bool = True,
) -> Readings:
    """Readings within the limits that turn `sight_head` nearest to `wanted_base`; only `free` axes (one or two) turn.

    There are usually two solutions. The one with the least rotation from `start` is returned or, unless `from_start`,
    the one with the least rotation from zero angles whose inner axis does not go beyond a right angle. An axis parallel
    to the line of sight stays at the start. Two axes: Paden-Kahan subproblem 2; without a root, or without one within
    the limits, the best boundary case: one or both axes at a limit, or both rotation cones in one plane. Boundary cases
    are skipped unless `thorough`.
    """
    axes, held = _two_axes(gimbal, start, free, sight_head, wanted_base)
    outer, inner = _candidates(axes, held, _limit_angles(gimbal, free), thorough)
    if free.shape[0] == 1:
        inner = jnp.zeros_like(inner)
    angles = jnp.stack([outer, inner], axis=1)[:, : free.shape[0]]

    def judged(angles: Float[Array, " free"]) -> tuple[Readings, Scalar]:
        readings, angles = _within_limits(gimbal, start, free, angles)
        outer, inner = (angles[0], jnp.zeros(())) if free.shape[0] == 1 else (angles[0], angles[1])
        miss = _angle(about(axes.outer, outer, about(axes.inner, inner, axes.sight)), axes.wanted)
        turned_by = jnp.sum((angles - jnp.where(from_start, gimbal.angles(start)[free], 0.0)) ** 2)
        over_head = OVER_HEAD * jnp.maximum(jnp.abs(angles[-1]) - 0.5 * jnp.pi, 0.0)
        over_head = jnp.where(from_start, 0.0, over_head)
        return readings, jnp.maximum(miss, EXACT) + 0.1 * EXACT * (turned_by + over_head)

    readings, costs = jax.vmap(judged)(angles)
    return readings[jnp.argmin(costs)]


def about(axis: Vector3, angle: Scalar, v: Vector3) -> Vector3:
    """`v` rotated about a unit axis by an angle in rad (Rodrigues)."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return c * v + s * jnp.stack(cross(axis, v)) + (dot(axis, v) * (1.0 - c)) * axis


def turn_between(axis: Vector3, v: Vector3, w: Vector3, otherwise: Scalar) -> Scalar:
    """Angle in (-pi, pi] about `axis` that turns `v` nearest to `w`; `otherwise` if either is parallel to the axis."""
    sine = dot(axis, jnp.stack(cross(v, w)))
    cosine = dot(v, w) - dot(axis, v) * dot(axis, w)
    along = jnp.minimum(_aside(axis, v), _aside(axis, w)) < SINGULAR
    return jnp.where(along, otherwise, jnp.arctan2(jnp.where(along, 0.0, sine), jnp.where(along, 1.0, cosine)))


def _candidates(
    axes: TwoAxes, held: Float[Array, "2"], limits: Float[Array, "2 2"], thorough: bool
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Candidate (outer, inner) axis angles before limits: both axes free, one axis at a limit, both at limits."""
    meetings = [*_roots(axes), *(_in_one_plane(axes) if thorough else ())]
    to, from_wanted = (jnp.stack(places) for places in zip(*meetings, strict=True))
    if thorough:
        ends = [about(axes.inner, limits[1, end], axes.sight) for end in (0, 1)]
        from_wanted = jnp.concatenate([from_wanted, jnp.stack(ends)])
        ends = [about(axes.outer, -limits[0, end], axes.wanted) for end in (0, 1)]
        to = jnp.concatenate([to, jnp.stack(ends)])
    turns = jax.vmap(turn_between, (None, 0, None, None)), jax.vmap(turn_between, (None, None, 0, None))
    outer = turns[0](axes.outer, from_wanted, axes.wanted, held[0])
    inner = turns[1](axes.inner, axes.sight, to, held[1])
    if not thorough:
        return outer, inner
    free = len(meetings)
    corners = jnp.repeat(limits[0], 2), jnp.tile(limits[1], 2)
    return (
        jnp.concatenate([outer[:free], limits[0], outer[free:], corners[0]]),
        jnp.concatenate([inner[:free], inner[free:], limits[1], corners[1]]),
    )


def _roots(axes: TwoAxes) -> list[tuple[Vector3, Vector3]]:
    """Intersections of the sight's rotation cone (inner axis) and the wanted direction's cone (outer axis)."""
    m = dot(axes.outer, axes.inner)
    spread = 1.0 - m * m
    spread = jnp.where(spread < SINGULAR, 1.0, spread)
    by_outer, by_inner = dot(axes.outer, axes.wanted), dot(axes.inner, axes.sight)
    a, b = (by_outer - m * by_inner) / spread, (by_inner - m * by_outer) / spread
    aside = safe_sqrt((1.0 - a * a - b * b - 2.0 * a * b * m) / spread)
    normal = jnp.stack(cross(axes.outer, axes.inner))
    in_plane = a * axes.outer + b * axes.inner
    return [(place, place) for place in (in_plane + aside * normal, in_plane - aside * normal)]


def _in_one_plane(axes: TwoAxes) -> list[tuple[Vector3, Vector3]]:
    """Cone points in the plane of the two axes: the nearest approach if the cones do not intersect."""

    def in_plane(axis: Vector3, other: Vector3, v: Vector3, side: float) -> Vector3:
        across = other - dot(axis, other) * axis
        across = across / jnp.maximum(safe_norm(across), SINGULAR)
        return dot(axis, v) * axis + side * _aside(axis, v) * across

    of_sight = [in_plane(axes.inner, axes.outer, axes.sight, side) for side in (1.0, -1.0)]
    of_wanted = [in_plane(axes.outer, axes.inner, axes.wanted, side) for side in (1.0, -1.0)]
    return [(to, from_wanted) for to in of_sight for from_wanted in of_wanted]


def _two_axes(
    gimbal: Gimbal, start: Readings, free: FreeAxes, sight_head: Vector3, wanted_base: Vector3
) -> tuple[TwoAxes, Float[Array, "2"]]:
    """The free axes with the held axes folded into the vectors, and their start angles (dummy for a second axis)."""
    angles = gimbal.angles(start)
    first, last = free[0], free[-1]
    before, between, after = jnp.eye(3), jnp.eye(3), jnp.eye(3)
    for k, (axis, angle) in enumerate(zip(gimbal.axes, angles, strict=True)):
        R = _ROTATIONS[axis](angle)
        before = matmul3(before, _if(k < first, R))
        between = matmul3(between, _if((k > first) & (k < last), R))
        after = matmul3(after, _if(k > last, R))
    named = jnp.array([_AXES[axis] for axis in gimbal.axes])
    outer = named[first]
    if free.shape[0] == 1:
        stand_in = jnp.roll(outer, 1)
        axes = TwoAxes(outer, stand_in, matvec(after, sight_head), matvec(before.T, wanted_base))
        return axes, jnp.stack([angles[first], jnp.zeros(())])
    inner, sight = matvec(between, named[last]), matvec(between, matvec(after, sight_head))
    return TwoAxes(outer, inner, sight, matvec(before.T, wanted_base)), angles[free]


def _limit_angles(gimbal: Gimbal, free: FreeAxes) -> Float[Array, "2 2"]:
    """Axis angles of the free axes at their limits (a dummy for a missing axis), finite."""
    factor = (gimbal.sign * gimbal.gain)[free]
    whole = 4.0 * jnp.pi
    limits = jnp.clip(factor[:, None] * (gimbal.limits - gimbal.offset[:, None])[free], -whole, whole)
    return limits if free.shape[0] == 2 else jnp.concatenate([limits, jnp.zeros((1, 2))])


def _within_limits(
    gimbal: Gimbal, start: Readings, free: FreeAxes, angles: Float[Array, " free"]
) -> tuple[Readings, Float[Array, " free"]]:
    """Readings of free angles, by whole turns nearest to the start, clipped to the limits; and their angles."""
    factor, offset = (gimbal.sign * gimbal.gain)[free], gimbal.offset[free]
    low, high = gimbal.limits[free, 0], gimbal.limits[free, 1]
    period = 2.0 * jnp.pi / jnp.abs(factor)
    reading = offset + angles / factor
    fewest = jnp.ceil((low - reading) / period - LIMIT_SLACK)
    most = jnp.floor((high - reading) / period + LIMIT_SLACK)
    nearest = jnp.round((start[free] - reading) / period)
    turns = jnp.where(fewest <= most, jnp.clip(nearest, fewest, most), nearest)
    reading = jnp.clip(reading + turns * period, low, high)
    return start.at[free].set(reading), factor * (reading - offset)


def _if(condition: Flag, R: Matrix3) -> Matrix3:
    return jnp.where(condition, R, jnp.eye(3))


def _aside(axis: Vector3, v: Vector3) -> Scalar:
    """Distance of a vector's end from an axis."""
    return safe_norm(jnp.stack(cross(axis, v)))


def _angle(v: Vector3, w: Vector3) -> Numbers:
    return jnp.arctan2(safe_norm(jnp.stack(cross(v, w))), dot(v, w))
