"""Continuous trajectory: position and attitude of the platform interpolated between navigation records."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._checks import as_array, as_float64, check_finite, check_is, concrete
from jaxgeo._numerics import matmul3, matvec, tree_where
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Scalar, ScalarLike, Vector3, Vector3Field
from jaxgeo.earth import WGS84, R_ecef_from_ned
from jaxgeo.rotations import R_from_rotation_vector, heading_pitch_roll_from_R
from jaxgeo.sensor._interpolation import Legs, knot_before, turn_angles
from jaxgeo.sensor.camera import Numbers
from jaxgeo.sensor.gimbal import Readings, ReadingsField
from jaxgeo.sensor.platform import Pose, Shot

GAP = 10.0  # median intervals; a longer interval is a gap, unless the caller sets the limit
LONG = 4096  # knots; longer trajectories are interpolated from the knots about each time only
STEADY_LEGS = 8
LARGEST_TURN = np.deg2rad(120.0)  # between neighbouring knots; beyond it the direction of rotation is ambiguous


class Trajectory(Record):
    """Poses and gimbal readings at `times` (knots, in s), interpolated between them.

    Make one with `Trajectory.from_knots`. Position is a cubic in ECEF between knots, with the velocities at the knots;
    attitude likewise, as a rotation vector from the earlier knot, with the body rates at the knots; gimbal readings are
    cubics too. All have continuous first derivatives and are third-order accurate in the interval.
    Missing velocities (m/s, north-east-down over the ground) and body rates (rad/s about forward, right, down, relative
    to the Earth) come from the parabola through three knots.
    """

    times: Float[Array, "... knots"]
    poses: Pose
    gimbal_readings: ReadingsField
    velocity_ned: Vector3Field | None = None
    body_rates: Vector3Field | None = None

    @classmethod
    def from_knots(
        cls,
        times: Numbers,
        poses: Pose,
        gimbal_readings: ReadingsField | None = None,
        *,
        velocity_ned: Vector3Field | None = None,
        body_rates: Vector3Field | None = None,
        longest_gap: float | None = None,
    ) -> Trajectory:
        """Trajectory through knots: `times` (n,) in s, `poses` with n entries each, and readings if there is a gimbal.

        `gimbal_readings` are (n, axes) in rad, `velocity_ned` and `body_rates` are (n, 3). A scalar in `poses` applies
        to all knots. Raises `ValueError`, naming the knot, for times that do not increase, a gap longer than
        `longest_gap` s (default: ten median intervals), a rotation of more than 120 deg between knots (also by the
        given rates), gimbal readings that jump by more than 180 deg (unwrap a yaw that passes from 180 to -180 with
        `numpy.unwrap`), arrays of other lengths, and numbers that are not finite.

        >>> times = np.array([0.0, 1.0, 2.0])
        >>> poses = jaxgeo.Pose.from_degrees(
        ...     lat=47.0 + 5e-4 * times, lon=11.0, height=1300.0 + 2.0 * times, heading=np.array([359.0, 0.0, 1.0])
        ... )
        >>> flight = jaxgeo.Trajectory.from_knots(times, poses)
        >>> between = flight.at(0.5).pose
        >>> print(f"{np.rad2deg(between.heading) % 360:.3f} deg, {between.position.height:.2f} m")
        359.500 deg, 1301.00 m
        """
        check_is(poses, Pose, "poses", "One Pose, whose fields hold an entry for each knot.")
        readings = np.zeros((*np.shape(times), 0)) if gimbal_readings is None else gimbal_readings
        named = {"times": times, "readings": readings, "velocity_ned": velocity_ned, "body_rates": body_rates}
        parts = [as_array(part, name) for name, part in named.items()]
        given: Any = as_float64((poses, *parts), "Trajectory.from_knots")
        poses, times, readings, velocity_ned, body_rates = given
        poses = jax.tree.map(lambda x: jnp.broadcast_to(x, times.shape) if jnp.ndim(x) == 0 else x, poses)
        _check_lengths(times, poses, readings, velocity_ned, body_rates)
        for part, name, unit in (
            (times, "times", "s"),
            (jnp.stack(jax.tree.leaves(poses)), "poses", "rad and m"),
            (readings, "gimbal_readings", "rad"),
            (velocity_ned, "velocity_ned", "m/s"),
            (body_rates, "body_rates", "rad/s"),
        ):
            if part is not None:
                check_finite(part, name, unit)
        trajectory = cls(times, poses, readings, velocity_ned, body_rates)
        _check_times(times, longest_gap)
        _check_turns(trajectory)
        return trajectory

    @classmethod
    def steady(
        cls,
        shot: Shot,
        *,
        velocity_ned: Numbers,
        body_rates: Numbers | None = None,
        gimbal_rates: Numbers | None = None,
        before: ScalarLike = 1.0,
        after: ScalarLike = 1.0,
    ) -> Trajectory:
        """A shot in uniform motion, from `before` to `after` s around its time: constant velocity and rotation rates.

        `velocity_ned` (3,) in m/s over the ground, `body_rates` (3,) in rad/s about forward, right and down, relative
        to the Earth, `gimbal_rates` (axes,) in rad/s. Raises `ValueError` as `from_knots`; also for a rotation beyond
        960 deg.
        """
        check_is(shot, Shot, "shot", "Of a Trajectory, trajectory.at(time) is one.")
        turning: Any = np.zeros(3) if body_rates is None else body_rates
        moving: Any = np.zeros(np.shape(shot.gimbal_readings)) if gimbal_rates is None else gimbal_rates
        vectors = [as_array(v, "velocity or rates") for v in (velocity_ned, turning, moving)]
        given: Any = as_float64((shot, *vectors, before, after), "Trajectory.steady")
        shot, velocity_ned, turning, moving, before, after = given
        for vector, name, unit, shape in (
            (velocity_ned, "velocity_ned", "m/s", (3,)),
            (turning, "body_rates", "rad/s", (3,)),
            (moving, "gimbal_rates", "rad/s", shot.gimbal_readings.shape),
        ):
            check_finite(vector, name, unit)
            if vector.shape != shape:
                raise ValueError(f"{name} must have the shape {shape}, in {unit}; got {vector.shape}.")
        known = concrete(jnp.asarray(before + after))
        if known is not None and not known > 0.0:
            raise ValueError(f"before and after must make more than 0 s together; got {float(known):.9g} s.")
        offsets = -before + (before + after) * jnp.linspace(0.0, 1.0, STEADY_LEGS + 1)
        poses, readings, velocities = _straight_on(shot, velocity_ned, turning, moving, offsets)
        rates = jnp.broadcast_to(turning, (STEADY_LEGS + 1, 3))
        return cls.from_knots(shot.time + offsets, poses, readings, velocity_ned=velocities, body_rates=rates)

    def with_readings(self, gimbal_readings: Numbers) -> Trajectory:
        """The same trajectory with other gimbal readings, in rad: (knots, axes), or (axes,) for all knots."""
        readings: Any = as_float64(as_array(gimbal_readings, "gimbal_readings"), "gimbal_readings")
        if readings.ndim == 1:
            readings = jnp.broadcast_to(readings, (*self.times.shape, *readings.shape))
        _check_lengths(self.times, self.poses, readings)
        check_finite(readings, "gimbal_readings", "rad")
        _check_readings(readings)
        return Trajectory(self.times, self.poses, readings, self.velocity_ned, self.body_rates)

    @property
    def start(self) -> Scalar:
        """Time of the first knot, s."""
        return self.times[0]

    @property
    def end(self) -> Scalar:
        """Time of the last knot, s."""
        return self.times[-1]

    def at(self, time: ScalarLike, later: ScalarLike = 0.0) -> Shot:
        """The shot at a time in s; outside the knots everything but the time is NaN.

        `later` is added to the time without losing digits (a second of the week has a resolution of 6e-11 s).
        """
        return _shot(self, *as_float64((time, later), "time"))

    def covers(self, time: Scalar, later: Scalar) -> Flag:
        """Whether `time + later` is between the first knot and the last."""
        return (later >= self.start - time) & (later <= self.end - time)

    def legs(self) -> Legs:
        """The cubic segments between knots."""
        return Legs.of(self.times, self.poses, jnp.asarray(self.gimbal_readings), self.velocity_ned, self.body_rates)

    def legs_about(self, time: Scalar, later: Scalar) -> Legs:
        """The segments that determine the motion at a time; for a trajectory that is not long, all segments.

        All segments are computed once for a batch of times; those of a long trajectory, anew for each time.
        """
        return self.legs() if self.times.shape[0] <= LONG else self.about(time, later, 4).legs()

    def about(self, time: Scalar, later: Scalar, knots: int) -> Trajectory:
        """The `knots` (4 or more) knots about a time that determine the motion there; all, if there are fewer."""
        there = self.times.shape[0]
        if there <= knots:
            return self
        first = jnp.clip(knot_before(self.times, time, later) - (knots // 2 - 1), 0, there - knots)
        return jax.tree.map(lambda x: jnp.asarray(x)[first + jnp.arange(knots)], self)

    def velocity_ned_at(self, time: ScalarLike) -> Vector3:
        """Velocity over the ground at a time, m/s in north-east-down; NaN outside the knots."""
        (p_ecef, _), (velocity, _) = _motion_and_change(self, as_float64(time, "time"))
        return R_ecef_from_ned(WGS84.to_geodetic(p_ecef)).T @ velocity

    def body_rates_at(self, time: ScalarLike) -> Vector3:
        """Body rates relative to the Earth at a time, rad/s about forward, right and down; NaN outside the knots."""
        (_, R), (_, turn) = _motion_and_change(self, as_float64(time, "time"))
        spin = R.T @ turn
        return jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])


@jax.jit
def _straight_on(
    shot: Shot, velocity_ned: Vector3, turning: Vector3, moving: Readings, offsets: Array
) -> tuple[Pose, Array, Array]:
    """Poses, gimbal readings and velocities (NED) at times after a shot, in uniform motion."""
    R_ecef_from_ned_ = R_ecef_from_ned(shot.pose.position)
    start, velocity = WGS84.to_ecef(shot.pose.position), matvec(R_ecef_from_ned_, velocity_ned)
    R_ecef_from_body = matmul3(R_ecef_from_ned_, shot.pose.R_ned_from_body)
    deflection, R_ned_from_level = shot.pose.deflection, shot.pose.R_ned_from_level

    def at(later: Scalar) -> tuple[Pose, Readings, Vector3]:
        position = WGS84.to_geodetic(start + later * velocity)
        R_ned_from_ecef = R_ecef_from_ned(position).T
        R = matmul3(R_ned_from_ecef, matmul3(R_ecef_from_body, R_from_rotation_vector(later * turning)))
        heading, pitch, roll = heading_pitch_roll_from_R(matmul3(R_ned_from_level.T, R))
        pose = Pose(position, heading, pitch, roll, deflection)
        return pose, shot.gimbal_readings + later * moving, matvec(R_ned_from_ecef, velocity)

    return jax.vmap(at)(offsets)


@jax.jit
def _shot(trajectory: Trajectory, time: Scalar, later: Scalar) -> Shot:
    inside = trajectory.covers(time, later)
    moment = tree_where(inside, (time, later), (trajectory.start, jnp.zeros_like(later)))
    legs = trajectory.legs_about(*moment)
    station, deflection = legs.station(*moment), legs.deflection_at(*moment)
    R_level_from_body = matmul3(station.R_ecef_from_level.T, station.R_ecef_from_body)
    position = WGS84.to_geodetic(station.p_ecef)
    heading, pitch, roll = heading_pitch_roll_from_R(R_level_from_body)
    known = Pose(position, heading, pitch, roll, deflection), station.gimbal_readings
    unknown = jax.tree.map(lambda x: jnp.full_like(x, jnp.nan), known)
    return Shot(*tree_where(inside, known, unknown), time + later)


@jax.jit
def _motion_and_change(trajectory: Trajectory, time: Scalar) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """(position in ECEF m, R_ecef_from_body) and their time derivatives."""
    legs, later, one = trajectory.legs(), jnp.zeros_like(time), jnp.ones_like(time)
    inside = trajectory.covers(time, later)
    moment = jnp.where(inside, time, trajectory.start)
    motion, change = jax.jvp(lambda t: legs.motion(t, later), (moment,), (one,))
    return motion, jax.tree.map(lambda x: jnp.where(inside, x, jnp.nan), change)


def _check_readings(readings: Array) -> None:
    known = concrete(readings)
    jumps = None if known is None else np.abs(np.diff(known, axis=0))
    if jumps is not None and np.any(jumps > np.pi):
        knot, axis = np.argwhere(jumps > np.pi)[0]
        raise ValueError(
            f"gimbal_readings of axis {axis} jump by {np.rad2deg(jumps[knot, axis]):.1f} deg up to knot {knot + 1} "
            "and would be interpolated the long way round. Are they in rad? If they wrap at 180 deg, numpy.unwrap them."
        )


def _check_lengths(times: Array, poses: Pose, readings: Array, *vectors: Array | None) -> None:
    if times.ndim != 1 or times.size < 2:
        raise ValueError(f"times must be a list of at least two knots, in s; got shape {times.shape}.")
    knots = times.size
    wrong = [leaf.shape for leaf in jax.tree.leaves(poses) if leaf.shape != (knots,)]
    if wrong:
        raise ValueError(f"poses must hold {knots} entries each, one for each of the times; got shape {wrong[0]}.")
    if readings.ndim != 2 or readings.shape[0] != knots:
        raise ValueError(f"gimbal_readings must have the shape ({knots}, axes), in rad; got {readings.shape}.")
    for vector, name in zip(vectors, ("velocity_ned", "body_rates"), strict=False):
        if vector is not None and vector.shape != (knots, 3):
            raise ValueError(f"{name} must have the shape ({knots}, 3); got {vector.shape}.")


def _check_times(times: Array, longest_gap: float | None) -> None:
    known = concrete(times)
    if known is None:
        return
    intervals = np.diff(known)
    if np.any(intervals <= 0.0):
        knot = int(np.argmax(intervals <= 0.0)) + 1
        raise ValueError(
            f"times must increase, but knot {knot} is at {known[knot]:.9g} s, after one at {known[knot - 1]:.9g} s. "
            "Sort the records and drop those that are there twice."
        )
    longest = GAP * float(np.median(intervals)) if longest_gap is None else longest_gap
    if np.any(intervals > longest):
        knot = int(np.argmax(intervals > longest)) + 1
        raise ValueError(
            f"there is a gap of {intervals[knot - 1]:.6g} s before knot {knot} ({known[knot]:.9g} s), and longest_gap "
            f"is {longest:.6g} s. Make one trajectory of what is before and one of what is behind, or allow the gap."
        )


def _check_turns(trajectory: Trajectory) -> None:
    _check_readings(trajectory.gimbal_readings)
    turns, times = concrete(turn_angles(trajectory.poses)), concrete(trajectory.times)
    rates = None if trajectory.body_rates is None else concrete(trajectory.body_rates)
    if rates is not None and times is not None:
        speed = np.linalg.norm(rates, axis=1)
        by_rates = 0.5 * (speed[1:] + speed[:-1]) * np.diff(times)
        turns = by_rates if turns is None else np.maximum(turns, by_rates)
    if turns is not None and np.any(turns > LARGEST_TURN):
        knot = int(np.argmax(turns > LARGEST_TURN)) + 1
        raise ValueError(
            f"the body turns by {np.rad2deg(turns[knot - 1]):.1f} deg up to knot {knot}; beyond "
            f"{np.rad2deg(LARGEST_TURN):.0f} deg between two knots nobody can tell which way. Are the angles in rad?"
        )
