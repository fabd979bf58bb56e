"""First hit of a ray with ground of bounded slope: every step is proven to pass no ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from jaxgeo._numerics import dot, safe_sqrt
from jaxgeo._typing import Flag, Index, Scalar, StatusCode
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.ray import Ray
from jaxgeo.status import Status, status_where
from jaxgeo.terrain.interface import Bracket
from jaxgeo.terrain.search.reach import FLOOR_MARGIN, ON_GROUND, reach_between

if TYPE_CHECKING:
    from jaxgeo.terrain.height_function import HeightFunction

RESOLUTION = 1e-3  # m along the ray: two crossings closer together may be missed
LONGEST = 10_000.0  # m: a longer step could turn the ray against the ground's normal by more than `TURN`
TURN = 2e-3  # rad
PLACES = 1024  # samples of a ray if no slope is known
MOST = 100_000  # steps
ROUNDING = 1e-6  # m of height
LEAST_RADIUS = 6.33e6  # m: of curvature of the ellipsoid
ON_THE_WAY = -1  # in place of a status


class Place(NamedTuple):
    """A point of a ray: range in m, clearance and height of the ground in m, and bounds over the next `LONGEST` m: of
    the speed of its foot over the ellipsoid, and of the ray's fall, m per m."""

    distance: Scalar
    clearance: Scalar
    ground: Scalar
    speed: Scalar
    fall: Scalar


class March(NamedTuple):
    """State: the last point known to be clear, the point ahead that ended the march, the longest next step, and the
    result (a `Status`, or `ON_THE_WAY`)."""

    free: Place
    ahead: Place
    longest: Scalar
    news: StatusCode
    count: Index


def safe_march(ray: Ray, terrain: HeightFunction) -> Bracket:
    """The first crossing of a ray and a `HeightFunction`; without derivatives.

    Height along a ray is convex, so it falls fastest at first, and the ground rises by at most its slope times the path
    of the ray's foot: a step of clearance / (fall + slope * speed) is clear. Steps are at least `RESOLUTION` long.
    Without a slope the steps are equal and not proven clear.
    A height outside its bounds, or a change of more than its slope allows, is `invalid_input`.
    """
    low, high = terrain.bounds()
    start, end, exists, sinks = reach_between(ray, low, high)
    end = jnp.where(exists, end, start)
    first = _place(ray, terrain, start)
    buried = (start == 0.0) & (first.clearance < -ON_GROUND)
    news = jnp.full((), ON_THE_WAY, jnp.int8)
    news = status_where(jnp.isnan(first.ground), Status.hits_void, news)
    news = status_where(~_within(first.ground, low, high), Status.invalid_input, news)
    news = status_where(buried, Status.camera_below_terrain, news)
    news = status_where(~exists, Status.rises_away, news)

    def is_on_the_way(march: March) -> Flag:
        return (march.news == ON_THE_WAY) & (march.count < MOST)

    def go_on(march: March) -> March:
        ahead = _place(ray, terrain, jnp.minimum(march.free.distance + _step(march, terrain, start, end), end))
        at_end = status_where(sinks, Status.invalid_input, Status.rises_away.code)  # ground below its lower bound
        news = jnp.where(ahead.distance >= end, at_end, march.news)
        news = status_where(ahead.clearance <= 0.0, Status.hit, news)
        news = status_where(~_is_true(march.free, ahead, terrain), Status.invalid_input, news)
        step, unknown = ahead.distance - march.free.distance, jnp.isnan(ahead.ground)
        may_halve = unknown & (step > RESOLUTION)
        news = jnp.where(unknown, jnp.where(may_halve, march.news, Status.hits_void.code), news)
        moves = (news == ON_THE_WAY) & ~unknown
        free = jax.tree.map(lambda old, new: jnp.where(moves, new, old), march.free, ahead)
        longest = jnp.where(may_halve, 0.5 * step, 2.0 * march.longest)
        return March(free, ahead, longest, news, march.count + 1)

    march = March(first, first, jnp.full_like(start, LONGEST), news, jnp.asarray(0))
    march = jax.lax.while_loop(is_on_the_way, go_on, march)
    return _as_bracket(march)


def _as_bracket(march: March) -> Bracket:
    news = jnp.where(march.news == ON_THE_WAY, Status.not_converged.code, march.news)
    is_hit, is_void = news == Status.hit, news == Status.hits_void
    lower, upper = march.free, march.ahead
    fall = jnp.where(is_hit, lower.clearance - upper.clearance, 1.0)
    share = jnp.where(is_hit & (fall > 0.0), lower.clearance / jnp.where(fall > 0.0, fall, 1.0), 0.0)
    near = lower.distance + (upper.distance - lower.distance) * share
    known = lambda x: jnp.where(is_hit | is_void, x, 0.0)  # noqa: E731
    cell = jnp.stack([is_hit.astype(jnp.int32), jnp.zeros((), jnp.int32)])
    return Bracket(known(lower.distance), known(upper.distance), known(near), cell, news)


def _place(ray: Ray, terrain: HeightFunction, distance: Scalar) -> Place:
    p_ecef, heading = ray.at(distance), ray.heading_at(distance)
    position = WGS84.to_geodetic(p_ecef)
    up, height = WGS84.normal_and_height(p_ecef)
    ground = terrain.height_at(position)
    climb = dot(up, heading)
    level = safe_sqrt(dot(heading, heading) - climb * climb)
    speed = jnp.minimum(level + TURN, 1.0 + TURN) * LEAST_RADIUS / (LEAST_RADIUS + _least(terrain))
    return Place(distance, height - ground, ground, speed, jnp.maximum(-climb, 0.0))


def _least(terrain: HeightFunction) -> Scalar:
    """The lowest height in m on a ray's path, if negative: below the ellipsoid, feet move faster than the ray."""
    return jnp.minimum(terrain.bounds()[0] - FLOOR_MARGIN, 0.0)


def _step(march: March, terrain: HeightFunction, start: Scalar, end: Scalar) -> Scalar:
    if terrain.lipschitz is None:
        step = (end - start) / PLACES
    else:
        loss = march.free.fall + terrain.lipschitz * march.free.speed
        step = march.free.clearance / jnp.maximum(loss, 1e-12)
    return jnp.maximum(jnp.minimum(jnp.minimum(step, LONGEST), march.longest), RESOLUTION)


def _is_true(here: Place, there: Place, terrain: HeightFunction) -> Flag:
    """Whether the ground respects its bounds between two points; unknown ground does."""
    kept = _within(there.ground, *terrain.bounds())
    if terrain.lipschitz is None:
        return kept
    most = terrain.lipschitz * here.speed * (there.distance - here.distance) + ROUNDING
    return kept & ~(jnp.abs(there.ground - here.ground) > most)


def _within(ground: Scalar, low: Scalar, high: Scalar) -> Flag:
    return ~((ground < low - ROUNDING) | (ground > high + ROUNDING))
