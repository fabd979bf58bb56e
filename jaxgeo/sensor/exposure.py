"""Exposure times of pixels and points for cameras that move during the exposure."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._numerics import implicit_root, newton_or_half, safe_sqrt, tree_where, value_and_slope
from jaxgeo._typing import Flag, Pixel, Scalar, StatusCode, Vector3
from jaxgeo.earth import Atmosphere
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.sensor._interpolation import Legs
from jaxgeo.sensor.platform import Shot
from jaxgeo.sensor.sensor import Sensor, Sight, made_safe
from jaxgeo.sensor.trajectory import Trajectory
from jaxgeo.status import Status, first_failure, seen_beside, status_where

FEWEST, MOST = 65, 257  # sample times at which the exposure is searched for a point: two per record
CANDIDATES = 3  # sign changes refined by Newton
AIR_SLACK = 0.05  # of the sample interval: bound of the error from evaluating refraction at one sample only
MARGIN = 0.1  # of the exposure: search margin at both ends, since points beside the image have a pixel too
STEPS = 40
CLOSE_ENOUGH = 1e-8  # of the exposure: last Newton step; the remaining error is of its square
SEEN = 1e-7  # of the exposure: tolerance of an exposure time, and of the trajectory's ends

Nodes = Float[Array, " nodes"]
Exposure = tuple[Scalar, Scalar]


class Scene(NamedTuple):
    """Inputs of a point's delay: `time` in s is the time of the image, `p_ecef` the point in m."""

    sensor: Sensor
    legs: Legs
    time: Scalar
    p_ecef: Vector3
    air: Atmosphere | None


class Crossing(NamedTuple):
    """Bracket of an exposure time, in s after the image's: ends, start value and sign of the delay at the low end."""

    low: Scalar
    high: Scalar
    start: Scalar
    sign: Scalar
    exists: Flag


def line_of_sight(
    sensor: Sensor, motion: Shot | Trajectory, time: Scalar, uv: Pixel
) -> tuple[Vector3, Vector3, StatusCode]:
    """`Sensor.ray_ecef` of a pixel; on a trajectory, from the pose at its exposure, `time_of(uv)` after `time` in s."""
    if isinstance(motion, Shot):
        return sensor.ray_ecef(motion, uv)
    valid, sensor, (motion, time), uv = made_safe(sensor, (motion, time), uv)
    later = sensor.camera.time_of(uv)
    covered = motion.covers(time, later)
    moment = tree_where(covered, (time, later), (motion.start, jnp.zeros_like(later)))
    sight = sensor.sight(motion.legs_about(*moment).station(*moment))
    origin, direction, status = sensor.ray_from(sight, uv, valid)
    return origin, direction, jnp.where(valid & ~covered, Status.outside_trajectory.code, status)


def image_of_point(
    sensor: Sensor, motion: Shot | Trajectory, time: Scalar, p_ecef: Vector3, air: Atmosphere | None
) -> tuple[Pixel, StatusCode, Vector3]:
    """(pixel, status, perspective centre in ECEF m) of a point in ECEF m at its exposure time.

    For a moving line-by-line camera the exposure time is solved for. A point may have none (`never_seen`), or several,
    where the motion turns the line back over ground already imaged; the result is the first on the image.
    """
    if isinstance(motion, Shot):
        return *sensor.project_ecef(motion, p_ecef, air), sensor.perspective_centre(motion)
    exposure = sensor.camera.exposure()
    valid, sensor, (motion, time, exposure), p_ecef = made_safe(sensor, (motion, time, exposure), p_ecef)
    scene = Scene(sensor, motion.legs(), time, p_ecef, air)
    if exposure is None:
        moment = jnp.zeros_like(time)
        unseen = status_where(motion.covers(time, moment), Status.hit, Status.outside_trajectory.code)
    else:
        moment, unseen = _moment(*jax.lax.stop_gradient((scene, exposure)))
        moment = implicit_root(_delay, moment, scene)
    sight = _sight(scene, moment)
    uv, _, status = _image(scene, sight, moment)
    status = status_where(~valid, Status.invalid_input, first_failure(unseen, status))
    has_image = seen_beside(status, uv) == Status.hit
    status = sensor.camera.cause(uv, status)
    return jnp.where(has_image, uv, jnp.nan), status, jnp.where(valid, sight.centre, jnp.nan)


def _moment(scene: Scene, exposure: Exposure) -> tuple[Scalar, StatusCode]:
    """Exposure time of the point, in s after the image's; without a crossing, some time and the reason as status."""
    (begin, end), times = exposure, scene.legs.times
    duration, before, after = end - begin, times[0] - scene.time, times[-1] - scene.time
    low = jnp.maximum(begin - MARGIN * duration, before - SEEN * duration)
    high = jnp.minimum(end + MARGIN * duration, after + SEEN * duration)
    overlaps = low < high
    low, high = tree_where(overlaps, (low, high), (before, after))
    nodes = low + (high - low) * jnp.linspace(0.0, 1.0, min(max(2 * times.shape[0], FEWEST), MOST))
    crossings, blind = _crossings(scene, nodes, SEEN * duration)
    moments = jax.vmap(lambda crossing: _newton(scene, crossing, duration))(crossings)
    _, delays, statuses = jax.vmap(lambda s: _image(scene, _sight(scene, s), s))(moments)
    found = crossings.exists & overlaps & (jnp.abs(delays) <= SEEN * duration)
    best = jnp.where(statuses == Status.hit, 3, jnp.where(statuses == Status.outside_image, 2, 1))
    k = jnp.argmax(jnp.where(found, best, 0))  # the first among equals
    reason = status_where(blind == Status.hit, Status.never_seen, blind)
    reason = status_where((before > begin) | (after < end), Status.outside_trajectory, reason)
    return moments[k], status_where(found[k], Status.hit, reason)


def _crossings(scene: Scene, nodes: Nodes, slack: Scalar) -> tuple[Crossing, StatusCode]:
    """The first sample intervals in which the delay changes sign, and the status if no sample is in front.

    Intervals with the point beside the image rank last. The delay is modelled as a cubic between samples, so that two
    sign changes within one interval are found too.
    """
    sights, rates = jax.vmap(lambda s: jax.jvp(lambda s: _sight(scene, s), (s,), (jnp.ones_like(s),)))(nodes)
    middle, step = scene, nodes[1] - nodes[0]
    if scene.air is not None:  # refraction hardly changes during the exposure: use that of the middle sample
        seeming = apparent_point(sights.centre[nodes.shape[0] // 2], scene.p_ecef, scene.air)
        middle, slack = scene._replace(p_ecef=seeming, air=None), AIR_SLACK * step

    def delay(time: Scalar, sight: Sight, rate: Sight) -> tuple[Scalar, Scalar, StatusCode]:
        def at(sight: Sight, time: Scalar) -> tuple[Scalar, StatusCode]:
            return _image(middle, sight, time)[1:]

        value, slope, status = jax.jvp(at, (sight, time), (rate, jnp.ones_like(time)), has_aux=True)
        return value, slope, status

    values, slopes, statuses = jax.vmap(delay)(nodes, sights, rates)
    place, crosses = jax.vmap(_first_change)(values[:-1], values[1:], step * slopes[:-1], step * slopes[1:])
    ahead, on_image = statuses != Status.behind_camera, statuses == Status.hit
    crosses &= ahead[:-1] | ahead[1:]  # the delay jumps where the point passes behind the camera
    k = _first_few(jnp.where(crosses, jnp.where(on_image[:-1] | on_image[1:], 0, 1), 2))
    share, reach = place[k].T
    sign = jnp.sign(jnp.where(values[k] == 0.0, -values[k + 1], values[k]))
    low, high = nodes[k] - slack, nodes[k] + reach * step + slack
    blind = jnp.where(jnp.any(ahead), Status.hit.code, statuses[nodes.shape[0] // 2])
    return Crossing(low, high, nodes[k] + share * step, sign, crosses[k]), blind


def _first_few(rank: Int[Array, " intervals"]) -> Int[Array, " few"]:
    """Sorted indices of the smallest ranks, the first among equals; takes half the time of a full sort."""
    places, count = jnp.arange(rank.shape[0]), rank.shape[0]
    key, found = rank * count + places, []
    for _ in range(CANDIDATES):
        found.append(jnp.argmin(key))
        key = jnp.where(places == found[-1], 3 * count, key)  # behind all others
    return jnp.sort(jnp.stack(found))


def _first_change(begin: Scalar, end: Scalar, slope: Scalar, last_slope: Scalar) -> tuple[Float[Array, "2"], Flag]:
    """((position, end) as shares of an interval, whether): the first sign change of a cubic within the interval."""
    changes = begin * end <= 0.0
    dips = (begin * slope < 0.0) & (begin * last_slope > 0.0)
    linear = 2.0 * (3.0 * (end - begin) - 2.0 * slope - last_slope)
    square = 3.0 * (slope + last_slope - 2.0 * (end - begin))
    root = safe_sqrt(linear * linear - 4.0 * square * slope)
    turn = -2.0 * slope / jnp.where(dips, linear + jnp.sign(last_slope - slope) * root, 1.0)  # zero slope
    rest = 1.0 - turn
    lowest = begin + turn * turn * (3.0 - 2.0 * turn) * (end - begin)
    lowest = lowest + turn * rest * (rest * slope - turn * last_slope)
    dips &= begin * lowest < 0.0
    reach, value = jnp.where(changes, 1.0, turn), jnp.where(changes, end, lowest)
    where = reach * begin / jnp.where(begin == value, 1.0, begin - value)
    return jnp.stack([where, reach]), changes | dips


def _newton(scene: Scene, crossing: Crossing, duration: Scalar) -> Scalar:
    """The root of the delay within a crossing."""
    slack = SEEN * duration

    def unfinished(state: tuple[Scalar, Scalar, Scalar, Flag, Scalar]) -> Flag:
        return ~state[3] & (state[4] < STEPS)

    def refine(state: tuple[Scalar, Scalar, Scalar, Flag, Scalar]) -> tuple[Scalar, Scalar, Scalar, Flag, Scalar]:
        low, high, moment, _, count = state
        value, slope = value_and_slope(lambda s: crossing.sign * _delay(s, scene), moment)
        low, high, following = newton_or_half(low, high, moment, value, slope, slack)
        return low, high, following, jnp.abs(following - moment) <= CLOSE_ENOUGH * duration, count + 1.0

    state = (crossing.low, crossing.high, crossing.start, ~crossing.exists, jnp.zeros_like(duration))
    return jax.lax.while_loop(unfinished, refine, state)[2]


def _delay(moment: Scalar, scene: Scene) -> Scalar:
    return _image(scene, _sight(scene, moment), moment)[1]


def _sight(scene: Scene, moment: Scalar) -> Sight:
    return scene.sensor.sight(scene.legs.station(scene.time, moment))


def _image(scene: Scene, sight: Sight, moment: Scalar) -> tuple[Pixel, Scalar, StatusCode]:
    return scene.sensor.camera.image_at(sight.to_camera(scene.p_ecef, scene.air), moment)
