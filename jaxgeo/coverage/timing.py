"""Exposure timing for a target overlap with the image before."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # loads its submodules on demand
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._arguments import check_terrain, checked_air, checked_exposure
from jaxgeo._checks import check_finite, check_is
from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._numerics import larger, matvec, safe_norm, smaller
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Scalar, ScalarField
from jaxgeo.coverage._checks import checked_overlap, checked_positive
from jaxgeo.coverage._overlap import (
    STATIONS,
    GroundEdges,
    Overlap,
    axis_along,
    check_along,
    check_stations,
    edges_on_map,
    flight_direction,
    ground_edges,
    shared,
)
from jaxgeo.coverage._too_short import no_ground, refuse_too_short, too_few
from jaxgeo.coverage.exposure import Along, MovingExposure, local_projection, near_length, on_map
from jaxgeo.earth import WGS84, Atmosphere, R_ecef_from_ned, TransverseMercator
from jaxgeo.sensor import Sensor, Trajectory
from jaxgeo.terrain import AbstractTerrain, ConstantHeight

INTERVAL = 0.05  # s between the nodes of the velocity-height integral
HALVINGS = 40  # bisection steps in an interval, for the time at which the integral reaches its mark
LOOKED_THROUGH = 24  # sample times at which the overlap is evaluated, to bracket the first that reaches the target
ROUNDS = 6  # refinements of that bracket: to 1e-8 of the wait
FARTHEST = 4.0  # longest wait searched, in waits over level ground
MOST = 10_000  # images of one plan
FEWEST = 64  # padded number of images of a computation, at least
STANDING = 1e-3  # m between two platforms: below it, the direction of flight is that of the velocity


class Plan(Record):
    """Exposure times of a flight, s, and the overlap of each image (but the first) with the one before.

    `overlaps` has a leading axis of one less than `times`.
    """

    trajectory: Trajectory
    times: Float[Array, " images"]
    overlaps: Overlap


class Course(Record):
    """Inputs of exposure timing: sensor, trajectory, terrain, and the image axis along the flight."""

    sensor: Sensor
    trajectory: Trajectory
    terrain: AbstractTerrain
    air: Atmosphere | None
    along: Along = eqx.field(static=True)

    @property
    def first(self) -> Scalar:
        """Time of the first complete image, s: rows may be exposed before the time of the image."""
        exposure = self.sensor.camera.exposure()
        return self.trajectory.start - (0.0 if exposure is None else smaller(exposure[0], 0.0))

    @property
    def last(self) -> Scalar:
        """Time of the last complete image, s."""
        exposure = self.sensor.camera.exposure()
        return self.trajectory.end - (0.0 if exposure is None else larger(exposure[1], 0.0))

    def over(self, terrain: AbstractTerrain) -> Course:
        """The same course over other ground."""
        return Course(self.sensor, self.trajectory, terrain, self.air, self.along)


class AbstractTiming(Record):
    """Base class of timings: the times of images after a first one."""

    def check(self, course: Course, along: Along | None, start: float) -> None:
        """Raise `ValueError` for an impossible plan, before compiling; `along` is None while it is unknown."""

    @abc.abstractmethod
    def times(self, course: Course, start: float, most: int) -> np.ndarray:
        """Times in s of the images from `start`, included, to the end of the trajectory, `most` at most."""


class FixedPeriod(AbstractTiming):
    """An image every `period` s."""

    period: ScalarField

    def check(self, course: Course, along: Along | None, start: float) -> None:
        if len(self.times(course, start, 2)) < 2:
            raise too_few(float(course.last), start)

    def times(self, course: Course, start: float, most: int) -> np.ndarray:
        period = float(checked_positive(self.period, "period", "s"))
        count = math.floor((float(course.last) - start) / period * (1.0 + 1e-12)) + 1
        return start + period * np.arange(min(count, most))


class VelocityHeight(AbstractTiming):
    """Timing by the time integral of speed over height of Li et al. (2020), Eq 36, for any camera.

    The next image is due when the integral of V / L has grown by 1 - overlap: V is the speed of the near end's ground
    point, L the length of the image there along the flight. Over level ground, and for a narrow field, L is
    2 tan(omega/2) H / cos(theta), and this is Eq 36. The ground is the terrain seen or, with a `height` in m above the
    ellipsoid, level ground of that height. The integral is computed once for the flight, at nodes `INTERVAL` s apart;
    an image time is where it reaches its mark, not the next record.
    """

    overlap: ScalarField
    height: ScalarField | None = None

    def check(self, course: Course, along: Along | None, start: float) -> None:
        goal = 1.0 - float(checked_overlap(self.overlap))
        over = course if self.height is None else course.over(ConstantHeight(self.height))
        refuse_too_short(over, along, start, goal)

    def times(self, course: Course, start: float, most: int) -> np.ndarray:
        goal = 1.0 - float(checked_overlap(self.overlap))
        nodes, total, rate = (np.asarray(x) for x in self.integral(course, start))
        marks = goal * np.arange(1, min(math.floor(total[-1] / goal * (1.0 + 1e-12)) + 1, most))
        if not marks.size:
            return np.array([start])
        marks = np.minimum(marks, total[-1])
        between = np.clip(np.searchsorted(total, marks), 1, len(nodes) - 1)
        low, high, grown = nodes[between - 1], nodes[between], scipy.interpolate.CubicHermiteSpline(nodes, total, rate)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            short = grown(middle) < marks
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return np.concatenate([[start], high])

    def integral(self, course: Course, start: float) -> tuple[Float[Array, " nodes"], ...]:
        """(times in s, the integral of V / L from the start to them by Simpson's rule, V / L) up to the last image."""
        end = max(float(course.last), start)
        legs = max(2 * math.ceil((end - start) / (2.0 * INTERVAL)), 8)
        nodes = jnp.linspace(start, end, 2 * legs + 1)
        rate = _rates(course if self.height is None else course.over(ConstantHeight(self.height)), nodes)
        if not np.all(np.isfinite(rate)):
            lost = float(nodes[int(np.argmin(np.isfinite(rate)))])
            raise no_ground(lost)
        growth = (nodes[2] - nodes[0]) / 6.0 * (rate[:-2:2] + 4.0 * rate[1:-1:2] + rate[2::2])
        return nodes[::2], jnp.concatenate([jnp.zeros(1), jnp.cumsum(growth)]), rate[::2]


class GroundShared(AbstractTiming):
    """Timing by the overlap on the ground that both images see: the first time at which it falls to the target.

    `place` selects where the overlap counts: at the "near" end, at the "far" end, or its "least" along the whole edge.
    The search covers four times the wait of `VelocityHeight`, and refines the interval in which the overlap first falls
    to the target; at a jump, where a ridge starts to hide ground, it returns the time before. If the overlap is unknown
    because an image sees no ground, the next image is timed as by `VelocityHeight`.
    """

    overlap: ScalarField
    place: Literal["near", "far", "least"] = eqx.field(static=True, default="near")
    stations: int = eqx.field(static=True, default=STATIONS)

    def check(self, course: Course, along: Along | None, start: float) -> None:
        check_stations(self.stations)
        if self.place not in ("near", "far", "least"):
            raise ValueError(f'place must be "near", "far" or "least"; got {self.place!r}.')
        VelocityHeight(self.overlap).check(course, along, start)

    def times(
        self, course: Course, start: float, most: int, progress: Callable[[float, float], object] | None = None
    ) -> np.ndarray:
        goal = 1.0 - checked_overlap(self.overlap)
        nodes, total, _ = VelocityHeight(self.overlap).integral(course, start)
        times, end = [start], float(nodes[-1])
        while len(times) < most:
            following = float(_first_due(self, course, jnp.asarray(times[-1]), nodes, total, goal))
            if not math.isfinite(following):
                break
            if not following > times[-1]:
                raise ValueError(f"no time after {times[-1]:.9g} s gives an overlap that large: it would stand still.")
            times.append(following)
            if progress is not None:
                progress(min(following, end) - start, end - start)
        return np.array(times)


@quick_filter_jit
def _first_due(timing: GroundShared, course: Course, time: Scalar, nodes: Array, total: Array, goal: Scalar) -> Scalar:
    """Time of the image after one at `time`; infinite if the trajectory ends before."""
    longest = course.last - time
    done = jnp.interp(time, nodes, total)
    level = jnp.interp(done + goal, total, nodes) - time  # the end of the flight if the integral stays below its mark

    def spare(waits: Float[Array, " waits"]) -> Float[Array, " waits"]:
        moments = jnp.concatenate([time[None], time + waits])
        ground = images_at(course, moments, timing.stations)
        first, later = (jax.tree.map(lambda x, part=part: x[part], ground) for part in (0, slice(1, None)))
        found = jax.vmap(lambda one: pair(course, time, first, one, timing.stations))(later)
        return getattr(found, timing.place) - timing.overlap

    def closer(_: Any, state: tuple[Array, Flag, Flag]) -> tuple[Array, Flag, Flag]:
        bracket, _, was_seen = state
        waits = bracket[0] + (bracket[1] - bracket[0]) * jnp.linspace(0.0, 1.0, LOOKED_THROUGH + 1)[1:]
        left = spare(waits)
        is_short = ~(left > 0.0)  # also where the overlap is unknown
        at = jnp.argmax(is_short)
        narrowed = jnp.stack([jnp.where(at > 0, waits[at - 1], bracket[0]), waits[at]])
        exists = jnp.any(is_short)
        return jnp.where(exists, narrowed, bracket), exists, was_seen & (~exists | jnp.isfinite(left[at]))

    bracket = jnp.stack([jnp.zeros(()), jnp.minimum(FARTHEST * level, longest)])
    (before, after), exists, is_seen = jax.lax.fori_loop(
        0, ROUNDS, closer, (bracket, jnp.asarray(True), jnp.asarray(True))
    )
    wait = jnp.where(before > 0.0, before, after)
    by_level = jnp.where(done + goal <= total[-1], level, jnp.inf)
    wait = jnp.where(is_seen, jnp.where(exists, wait, jnp.inf), by_level)
    return jnp.where(longest > 0.0, time + wait, jnp.inf)


def plan(
    sensor: Sensor,
    trajectory: Trajectory,
    terrain: AbstractTerrain,
    timing: AbstractTiming,
    *,
    start: ArrayLike | None = None,
    along: Along | None = None,
    most: int = MOST,
    stations: int = STATIONS,
    atmosphere: Atmosphere | None = None,
    progress: Callable[[float, float], object] | None = None,
) -> Plan:
    """All images of a flight from `start` in s (by default the first complete one), and their overlaps.

    The gimbal follows the trajectory's readings. `along` names the image axis along the flight; by default it is
    determined at the start. Ends with the trajectory, or after `most` images. `progress` is called with the time
    planned and the length of the flight, in s, after each image that is searched for (`GroundShared`). Not traceable:
    the number of images depends on the values. Raises `ValueError` if fewer than two images fit, for a start outside
    the trajectory, and as `axis_along`.
    """
    check_terrain(terrain, FIRST_HIT)
    check_is(timing, AbstractTiming, "timing", "FixedPeriod, VelocityHeight or GroundShared.")
    given: Any = checked_exposure(sensor, trajectory, start)
    sensor, trajectory, time = given
    check_is(trajectory, Trajectory, "trajectory", "Of one Shot, Trajectory.steady.")
    check_stations(stations)
    check_along(along)
    if most < 2:
        raise ValueError(f"most must be at least 2 images; got {most}.")
    course = Course(sensor, trajectory, terrain, checked_air(atmosphere), "rows" if along is None else along)
    span = [float(course.first), float(course.last)]
    time = jnp.asarray(span[0]) if start is None else time
    check_finite(time, "start", "s")
    if not span[0] <= float(time) <= span[1]:
        raise ValueError(
            f"start must lie on the trajectory, {span[0]:.9g} to {span[1]:.9g} s; got {float(time):.9g} s. (Within, a "
            "whole image is exposed.)"
        )
    timing.check(course, along, float(time))
    if along is None:
        along = _axis_at(sensor, trajectory, time, terrain)
        course = Course(sensor, trajectory, terrain, course.air, along)
    reports: dict[str, Any] = {"progress": progress} if isinstance(timing, GroundShared) else {}
    times = timing.times(course, float(time), most, **reports)
    if len(times) < 2:
        raise too_few(span[1], float(times[0]))
    return Plan(trajectory, jnp.asarray(times), _overlaps_of(course, times, stations))


def _overlaps_of(course: Course, times: np.ndarray, stations: int) -> Overlap:
    """`overlaps_at`, with the last time repeated up to a power of two, so that plans share compiled programs."""
    count = max(FEWEST, 1 << (len(times) - 1).bit_length())
    filled = times[np.minimum(np.arange(count), len(times) - 1)]
    return jax.tree.map(lambda x: x[: len(times) - 1], overlaps_at(course, jnp.asarray(filled), stations))


@quick_filter_jit
def overlaps_at(course: Course, times: Float[Array, " images"], stations: int = STATIONS) -> Overlap:
    """Overlaps of consecutive images at the given times; the leading axis is one less than that of the times."""
    ground = images_at(course, times, stations)
    before, after = (jax.tree.map(lambda x, part=part: x[part], ground) for part in (slice(None, -1), slice(1, None)))

    def one(time: Scalar, before: GroundEdges, after: GroundEdges) -> Overlap:
        return pair(course, time, before, after, stations)

    return jax.vmap(one)(times[:-1], before, after)


def images_at(course: Course, times: Float[Array, " images"], stations: int) -> GroundEdges:
    """The edges of images at times."""

    def one(time: Scalar) -> GroundEdges:
        image = MovingExposure(course.trajectory, time)
        return ground_edges(course.sensor, image, course.terrain, course.along, stations, course.air)

    return jax.vmap(one)(times)


def pair(course: Course, time: Scalar, before: GroundEdges, after: GroundEdges, stations: int) -> Overlap:
    """Overlap of two images, the first taken at `time`, along the line between their platforms."""
    position = course.trajectory.at(time).pose.position
    projection = TransverseMercator.gauss_krueger(position.lon)
    way = on_map(projection, after.platform) - on_map(projection, before.platform)
    moved = safe_norm(way)
    north, east, _ = course.trajectory.velocity_ned_at(time)
    convergence, _ = projection.convergence_and_scale(position.lat, position.lon)
    bearing = jnp.arctan2(east, jnp.where((north == 0.0) & (east == 0.0), 1.0, north)) - convergence
    ahead = jnp.stack([jnp.sin(bearing), jnp.cos(bearing)])
    direction = jnp.where(moved > STANDING, way / jnp.where(moved > STANDING, moved, 1.0), ahead)
    first, second = (edges_on_map(one, direction, projection) for one in (before, after))
    return shared(first, second, direction, stations)


@quick_filter_jit
def _rates(course: Course, times: Float[Array, " times"]) -> Float[Array, " times"]:
    """Speed of the near end's ground point over the image's length along the flight there, at times, 1/s."""

    def rate(time: Scalar) -> Scalar:
        shot = course.trajectory.at(time)
        north, east, _ = course.trajectory.velocity_ned_at(time)
        speed = jnp.hypot(north, east)
        still = speed == 0.0
        level = jnp.stack([jnp.where(still, 1.0, north), east, jnp.zeros(())]) / jnp.where(still, 1.0, speed)
        ahead = matvec(R_ecef_from_ned(shot.pose.position), level)
        length, height = near_length(course.sensor, shot, course.terrain, course.along, ahead, course.air)
        # The ground point moves as fast as the platform's foot: slower than the platform by the ratio of the radii.
        position = shot.pose.position
        radius = WGS84.radius_in_azimuth(position.lat, jnp.arctan2(level[1], level[0]))
        return speed * (radius + height) / (radius + position.height) / length

    return jax.vmap(rate)(times)


def _axis_at(sensor: Sensor, trajectory: Trajectory, time: Scalar, terrain: AbstractTerrain) -> Along:
    later = jnp.where(time < trajectory.end, trajectory.end, trajectory.start)
    image, other = (MovingExposure(trajectory, moment) for moment in (time, 0.5 * (time + later)))
    projection = local_projection(image)
    return axis_along(sensor, image, flight_direction(image, other, projection), terrain, projection)
