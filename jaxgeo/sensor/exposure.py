"""Exposure times of pixels and points for cameras that move during the exposure."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._numerics import implicit_root, newton_or_half, safe_sqrt, tree_where, value_and_slope
from jaxgeo._typing import Flag, Pixel, Scalar, StatusCode, Vector3
from jaxgeo.earth import Atmosphere
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.sensor.delay import Scene, delay_at, image_at, sight_at
from jaxgeo.sensor.platform import Shot
from jaxgeo.sensor.sensor import Sensor, Sight, made_safe
from jaxgeo.sensor.steady_exposure import STRETCHES, search_missed, steady_moment
from jaxgeo.sensor.trajectory import Trajectory
from jaxgeo.status import Status, first_failure, seen_beside, status_where

FEWEST, MOST = 65, 257  # sample times at which the exposure is searched for a point: two per record
MOST_SHARED = 16_385  # of those that tell for all points of an image how steady the motion is
CANDIDATES = 3  # sign changes refined by Newton
AIR_SLACK = 0.05  # of the sample interval: bound of the error from evaluating refraction at one sample only
MARGIN = 0.1  # of the exposure: search margin at both ends, since points beside the image have a pixel too
STEPS = 40
CLOSE_ENOUGH = 1e-8  # of the exposure: last Newton step; the remaining error is of its square
SEEN = 1e-7  # of the exposure: tolerance of an exposure time, and of the trajectory's ends

Nodes = Float[Array, " nodes"]
Exposure = tuple[Scalar, Scalar]


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
        moment = implicit_root(delay_at, moment, scene)
    sight = sight_at(scene, moment)
    uv, _, status = image_at(scene, sight, moment)
    status = status_where(~valid, Status.invalid_input, first_failure(unseen, status))
    has_image = seen_beside(status, uv) == Status.hit
    status = sensor.camera.cause(uv, status)
    return jnp.where(has_image, uv, jnp.nan), status, jnp.where(valid, sight.centre, jnp.nan)


class Search(NamedTuple):
    """Where the exposure of a point is searched for: `begin` and `end` of the exposure and `before` and `after` of the
    trajectory, all in s after the image's time, and the sample times `nodes`, with the sights there and their rates."""

    begin: Scalar
    end: Scalar
    before: Scalar
    after: Scalar
    overlaps: Flag
    nodes: Nodes
    sights: Sight
    rates: Sight

    @classmethod
    def of(cls, scene: Scene, exposure: Exposure, most: int = MOST) -> Search:
        """With at most so many nodes."""
        (begin, end), times = exposure, scene.legs.times
        duration, before, after = end - begin, times[0] - scene.time, times[-1] - scene.time
        low = jnp.maximum(begin - MARGIN * duration, before - SEEN * duration)
        high = jnp.minimum(end + MARGIN * duration, after + SEEN * duration)
        overlaps = low < high
        low, high = tree_where(overlaps, (low, high), (before, after))
        count = STRETCHES * -(-(min(max(2 * times.shape[0], FEWEST), most) - 1) // STRETCHES) + 1
        nodes = low + (high - low) * jnp.linspace(0.0, 1.0, count)
        sights, rates = jax.vmap(lambda s: jax.jvp(lambda s: sight_at(scene, s), (s,), (jnp.ones_like(s),)))(nodes)
        return cls(begin, end, before, after, overlaps, nodes, sights, rates)

    @property
    def duration(self) -> Scalar:
        """Of the exposure, s."""
        return self.end - self.begin

    def reason(self, blind: StatusCode) -> StatusCode:
        """The status of a point without an exposure time; `blind` is not `hit` if it is behind the camera."""
        reason = status_where(blind == Status.hit, Status.never_seen, blind)
        is_beyond = (self.before > self.begin) | (self.after < self.end)
        return status_where(is_beyond, Status.outside_trajectory, reason)


@jax.custom_batching.custom_vmap
def _moment(scene: Scene, exposure: Exposure) -> tuple[Scalar, StatusCode]:
    """Exposure time of the point, in s after the image's; without a crossing, some time and the reason as status."""
    return _sampled_moment(scene, Search.of(scene, exposure))


@_moment.def_vmap
def _(size: int, is_batched: Any, scene: Scene, exposure: Exposure) -> tuple[Any, Any]:
    """Many points of one image: those whose delay is proven to rise or fall steadily need few samples.

    Nothing is proven of a motion with more records than half of `MOST_SHARED`, nor of images in motions of their own.
    """
    axes = jax.tree.map(lambda own: 0 if own else None, is_batched)
    is_own = any(jax.tree.leaves((is_batched[0]._replace(p_ecef=False), is_batched[1])))
    records = scene.legs.times.shape[-1]
    if is_own or 2 * records > MOST_SHARED:
        one = lambda scene, exposure: _sampled_moment(scene, Search.of(scene, exposure))  # noqa: E731
        return jax.vmap(one, in_axes=axes)(scene, exposure), (True, True)
    search, there = Search.of(scene, exposure), scene._replace(p_ecef=None)
    whole = search if 2 * records <= MOST else Search.of(scene, exposure, MOST_SHARED)

    def quick(place: Vector3) -> tuple[tuple[Scalar, StatusCode], Flag]:
        here = there._replace(p_ecef=place)
        moment, is_seen, is_proven = steady_moment(here, whole.nodes, whole.sights, whole.rates)
        is_seen, is_proven = is_seen & search.overlaps, is_proven & search.overlaps
        return (moment, status_where(is_seen, Status.hit, search.reason(Status.hit.code))), is_proven

    def sampled(place: Vector3) -> tuple[Scalar, StatusCode]:
        return _sampled_moment(there._replace(p_ecef=place), search)

    found, is_proven = jax.vmap(quick)(scene.p_ecef)
    return search_missed(sampled, scene.p_ecef, ~is_proven, found), (True, True)


def _sampled_moment(scene: Scene, search: Search) -> tuple[Scalar, StatusCode]:
    """As `_moment`, from samples of the delay that find several crossings too."""
    duration = search.duration
    crossings, blind = _crossings(scene, search, SEEN * duration)
    moments = jax.vmap(lambda crossing: _newton(scene, crossing, duration))(crossings)
    _, delays, statuses = jax.vmap(lambda s: image_at(scene, sight_at(scene, s), s))(moments)
    found = crossings.exists & search.overlaps & (jnp.abs(delays) <= SEEN * duration)
    best = jnp.where(statuses == Status.hit, 3, jnp.where(statuses == Status.outside_image, 2, 1))
    k = jnp.argmax(jnp.where(found, best, 0))  # the first among equals
    return moments[k], status_where(found[k], Status.hit, search.reason(blind))


def _crossings(scene: Scene, search: Search, slack: Scalar) -> tuple[Crossing, StatusCode]:
    """The first sample intervals in which the delay changes sign, and the status if no sample is in front.

    Intervals with the point beside the image rank last. The delay is modelled as a cubic between samples, so that two
    sign changes within one interval are found too.
    """
    nodes, sights, rates = search.nodes, search.sights, search.rates
    middle, step = scene, nodes[1] - nodes[0]
    if scene.air is not None:  # refraction hardly changes during the exposure: use that of the middle sample
        seeming = apparent_point(sights.centre[nodes.shape[0] // 2], scene.p_ecef, scene.air)
        middle, slack = scene._replace(p_ecef=seeming, air=None), AIR_SLACK * step

    def delay(time: Scalar, sight: Sight, rate: Sight) -> tuple[Scalar, Scalar, StatusCode]:
        def at(sight: Sight, time: Scalar) -> tuple[Scalar, StatusCode]:
            return image_at(middle, sight, time)[1:]

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
        value, slope = value_and_slope(lambda s: crossing.sign * delay_at(s, scene), moment)
        low, high, following = newton_or_half(low, high, moment, value, slope, slack)
        return low, high, following, jnp.abs(following - moment) <= CLOSE_ENOUGH * duration, count + 1.0

    state = (crossing.low, crossing.high, crossing.start, ~crossing.exists, jnp.zeros_like(duration))
    return jax.lax.while_loop(unfinished, refine, state)[2]
