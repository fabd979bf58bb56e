"""Where the platform was, and how it lay, at any time between its navigation records."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._checks import as_array, as_float64, check_finite, concrete
from jaxgeo._numerics import product, tree_where, turned
from jaxgeo._typing import Flag, Index, Matrix3, Scalar, ScalarLike, Vector3, Vector3Field
from jaxgeo.earth import WGS84, R_ecef_from_ned
from jaxgeo.rotations import (
    R_from_rotation_vector,
    heading_pitch_roll_from_R,
    rotation_rate_from_body_rate,
    rotation_vector_from_R,
)
from jaxgeo.sensor.camera import Numbers
from jaxgeo.sensor.gimbal import Readings, ReadingsField
from jaxgeo.sensor.platform import Deflection, Pose, Shot, Station

GAP = 10.0  # times the median interval: a longer one is a gap, unless the caller says what is
LONG = 4096  # knots; of more, only those about a time are looked at
LARGEST_TURN = np.deg2rad(120.0)  # between neighbouring knots; beyond, nobody can tell which way the body turned


class Trajectory(eqx.Module):
    """Poses and gimbal readings at `times` (knots, in s), and between them.

    Make one with `Trajectory.from_knots`. Position is a cubic in ECEF between two knots, with the knots' velocities;
    attitude the same on the rotation group, as a rotation vector from the earlier knot, with the knots' body rates;
    gimbal readings cubics too. So all are continuous with their first derivatives, and of third order in the interval.
    Velocities (m/s, north-east-down over the ground) and body rates (rad/s about forward, right, down, against the
    Earth) that are not given are those of the parabola through three knots.
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
        """A trajectory through knots: `times` (n,) in s, `poses` with n entries each, and for a gimbal its readings.

        `gimbal_readings` are (n, axes) in rad, `velocity_ned` and `body_rates` are (n, 3). Raises `ValueError`, naming
        the knot, for times that do not increase, for a gap longer than `longest_gap` s (ten median intervals if left
        out), for a turn of more than 120 deg from one knot to the next, for arrays of other lengths, and for numbers
        that are not finite.
        """
        times = np.asarray(times) if isinstance(times, list | tuple) else times
        readings = np.zeros((*np.shape(times), 0)) if gimbal_readings is None else gimbal_readings
        given: Any = as_float64((times, poses, readings, velocity_ned, body_rates), "Trajectory.from_knots")
        times, poses, readings, velocity_ned, body_rates = given
        _check_lengths(times, poses, readings, velocity_ned, body_rates)
        for part, name, unit in (
            (times, "times", "s"),
            (jnp.stack(jax.tree.leaves(poses)), "poses", "rad and m"),
            (readings, "gimbal_readings", "rad"),
        ):
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
        """A shot in steady motion, from `before` to `after` s around its time: straight on, turning at constant rates.

        `velocity_ned` (3,) in m/s over the ground, `body_rates` (3,) in rad/s about forward, right and down, against
        the Earth, `gimbal_rates` (axes,) in rad/s. Raises `ValueError` as `from_knots`.
        """
        turning: Any = np.zeros(3) if body_rates is None else body_rates
        moving: Any = np.zeros(np.shape(shot.gimbal_readings)) if gimbal_rates is None else gimbal_rates
        vectors = [as_array(v, "velocity or rates") for v in (velocity_ned, turning, moving)]
        given: Any = as_float64((shot, *vectors, before, after), "Trajectory.steady")
        shot, velocity_ned, turning, moving, before, after = given
        for vector, name in ((velocity_ned, "velocity_ned"), (turning, "body_rates")):
            if vector.shape != (3,):
                raise ValueError(f"{name} must be one vector of shape (3,); got {vector.shape}.")
        R_ecef_from_level = R_ecef_from_ned(shot.pose.position)
        start, velocity = WGS84.to_ecef(shot.pose.position), R_ecef_from_level @ velocity_ned
        R_ecef_from_body = R_ecef_from_level @ shot.pose.R_ned_from_body

        def knot(later: Scalar) -> tuple[Pose, Readings, Vector3]:
            position = WGS84.to_geodetic(start + later * velocity)
            R_ned_from_ecef = R_ecef_from_ned(position).T
            R = R_ned_from_ecef @ R_ecef_from_body @ R_from_rotation_vector(later * turning)
            level = shot.pose.deflection
            R = R if level is None else level.R_ned_from_level.T @ R
            pose = Pose(position, *heading_pitch_roll_from_R(R), level)
            return pose, shot.gimbal_readings + later * moving, R_ned_from_ecef @ velocity

        offsets = jnp.stack([-before, after])
        poses, readings, velocities = jax.vmap(knot)(offsets)
        rates = jnp.stack([turning, turning])
        return cls.from_knots(shot.time + offsets, poses, readings, velocity_ned=velocities, body_rates=rates)

    def with_readings(self, gimbal_readings: Numbers) -> Trajectory:
        """The same flight with other gimbal readings, in rad: (knots, axes), or (axes,) held throughout."""
        readings: Any = as_float64(as_array(gimbal_readings, "gimbal_readings"), "gimbal_readings")
        if readings.ndim == 1:
            readings = jnp.broadcast_to(readings, (*self.times.shape, *readings.shape))
        _check_lengths(self.times, self.poses, readings)
        check_finite(readings, "gimbal_readings", "rad")
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
        """The shot at a time in s; before the first knot and after the last all of it is NaN but the time.

        `later` is added to the time without the loss of its digits (a second of the week leaves 6e-11 s).
        """
        time, later = as_float64((time, later), "time")
        inside = self.covers(time, later)
        pose, readings = self.state(*tree_where(inside, (time, later), (self.start, jnp.zeros_like(later))))
        unknown = jax.tree.map(lambda x: jnp.full_like(x, jnp.nan), (pose, readings))
        return Shot(*tree_where(inside, (pose, readings), unknown), time + later)

    def covers(self, time: Scalar, later: Scalar) -> Flag:
        """Whether a time, and a little later, lies between the first knot and the last."""
        return (later >= self.start - time) & (later <= self.end - time)

    def state(self, time: Scalar, later: Scalar) -> tuple[Pose, Readings]:
        """Pose and gimbal readings at a time; beyond the first knot and the last the motion goes on as a cubic."""
        near = self._near(time, later)
        p_ecef, R_ecef_from_body = near.motion(time, later)
        position, deflection = WGS84.to_geodetic(p_ecef), near.deflection(time, later)
        R_level_from_body = product(R_ecef_from_ned(position).T, R_ecef_from_body)
        if deflection is not None:
            R_level_from_body = product(deflection.R_ned_from_level.T, R_level_from_body)
        pose = Pose(position, *heading_pitch_roll_from_R(R_level_from_body), deflection)
        return pose, near.readings(time, later)

    def station(self, time: Scalar, later: Scalar) -> Station:
        """The same as `state`, seen from the Earth."""
        near = self._near(time, later)
        p_ecef, R_ecef_from_body = near.motion(time, later)
        level = Pose(WGS84.to_geodetic(p_ecef), deflection=near.deflection(time, later))
        R_ecef_from_level = product(R_ecef_from_ned(level.position), level.R_ned_from_level)
        return Station(p_ecef, R_ecef_from_body, R_ecef_from_level, near.readings(time, later))

    def velocity_ned_at(self, time: ScalarLike) -> Vector3:
        """Velocity over the ground at a time between the knots, m/s in north-east-down."""
        p_ecef, velocity = self._motion_and_change(time, 0)
        return R_ecef_from_ned(WGS84.to_geodetic(p_ecef)).T @ velocity

    def body_rates_at(self, time: ScalarLike) -> Vector3:
        """Rates of the body against the Earth at a time between the knots, rad/s about forward, right and down."""
        R, turn = self._motion_and_change(time, 1)
        spin = R.T @ turn
        return jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])

    def _motion_and_change(self, time: ScalarLike, part: int) -> tuple[Array, Array]:
        moment: Any = as_float64(time, "time")
        later, one = jnp.zeros_like(moment), jnp.ones_like(moment)
        return jax.jvp(lambda t: self._near(t, later).motion(t, later)[part], (moment,), (one,))

    def _near(self, time: Scalar, later: Scalar) -> _Neighbours:
        """The knots on which the motion at a time depends: two on each side, where there are as many.

        All of them, of a trajectory that is not long: what is made of each is then made once for a crowd of times.
        """
        times, moment = jax.lax.stop_gradient((self.times, time + later))
        knots = times.shape[0]
        before = jnp.clip(jnp.searchsorted(times, moment, side="right") - 1, 0, knots - 2)
        if knots <= LONG:
            return _Neighbours(self, before)
        first = jnp.clip(before - 1, 0, max(knots - 4, 0))
        which = first + jnp.arange(min(knots, 4))
        return _Neighbours(jax.tree.map(lambda x: jnp.asarray(x)[which], self), before - first)


class _Neighbours(NamedTuple):
    """A trajectory, whole or a few knots of it, and which of its knots is the one before the time."""

    knots: Trajectory
    before: Index

    def motion(self, time: Scalar, later: Scalar) -> tuple[Vector3, Matrix3]:
        """Position in ECEF m, and R_ecef_from_body."""
        times, velocity_ned, rates = self.knots.times, self.knots.velocity_ned, self.knots.body_rates
        p_ecef, R_ecef_from_ned_, R_ecef_from_body = _orientations(self.knots.poses)
        steps, turns = p_ecef[1:] - p_ecef[:-1], _turns(R_ecef_from_body)
        given = None if velocity_ned is None else jax.vmap(turned)(R_ecef_from_ned_, velocity_ned)
        velocities = _slopes(times, steps) if given is None else given
        rates = _slopes(times, turns) if rates is None else jnp.asarray(rates)
        k, share, duration = self.before, *self._share(time, later)
        # from the earlier knot on, for the last digits of an ECEF coordinate
        position = p_ecef[k] + _hermite(share, steps[k], duration * velocities[k], duration * velocities[k + 1])
        at_end = rotation_rate_from_body_rate(turns[k], rates[k + 1])
        rotation = _hermite(share, turns[k], duration * rates[k], duration * at_end)
        return position, product(R_ecef_from_body[k], R_from_rotation_vector(rotation))

    def readings(self, time: Scalar, later: Scalar) -> Readings:
        """Gimbal readings, rad."""
        k, share, duration = self.before, *self._share(time, later)
        readings = jnp.asarray(self.knots.gimbal_readings)
        steps = readings[1:] - readings[:-1]
        slopes = _slopes(self.knots.times, steps)
        return readings[k] + _hermite(share, steps[k], duration * slopes[k], duration * slopes[k + 1])

    def deflection(self, time: Scalar, later: Scalar) -> Deflection | None:
        """Deflection of the vertical, by straight lines between the knots."""
        k, share, _ = self.before, *self._share(time, later)
        return jax.tree.map(lambda x: x[k] + share * (x[k + 1] - x[k]), self.knots.poses.deflection)

    def _share(self, time: Scalar, later: Scalar) -> tuple[Scalar, Scalar]:
        """The share of the interval behind the earlier knot that has passed, and its duration in s."""
        start, end = self.knots.times[self.before], self.knots.times[self.before + 1]
        return ((time - start) + later) / (end - start), end - start


def _orientations(poses: Pose) -> tuple[Array, Array, Array]:
    """ECEF positions (n, 3), R_ecef_from_ned and R_ecef_from_body (n, 3, 3) of poses."""

    def one(pose: Pose) -> tuple[Vector3, Matrix3, Matrix3]:
        R = R_ecef_from_ned(pose.position)
        return WGS84.to_ecef(pose.position), R, product(R, pose.R_ned_from_body)

    return jax.vmap(one)(poses)


def _turns(R_ecef_from_body: Array) -> Array:
    """Rotation vectors (n - 1, 3) from each orientation to the next, the same in the body axes of both."""
    return jax.vmap(lambda a, b: rotation_vector_from_R(product(a.T, b)))(R_ecef_from_body[:-1], R_ecef_from_body[1:])


def _slopes(times: Array, steps: Array) -> Array:
    """Derivatives (n, ...) at knots of the parabolas through them and their neighbours, from the steps between them."""
    knots = times.shape[0]
    durations = times[1:] - times[:-1]
    speeds = steps / durations[:, None]
    if knots == 2:
        return jnp.concatenate([speeds, speeds])
    first = np.clip(np.arange(knots) - 1, 0, knots - 3)
    a, b, c = (times[first + k] for k in range(3))
    weight = (2.0 * times - a - b) / (c - a)
    return speeds[first] + weight[:, None] * (speeds[first + 1] - speeds[first])


def _hermite(share: Scalar, change: Array, begin: Array, end: Array) -> Array:
    """A cubic from 0 to `change` while `share` goes from 0 to 1, with the derivatives `begin` and `end`."""
    rest = 1.0 - share
    return share * (share * (3.0 - 2.0 * share) * change + rest * (rest * begin - share * end))


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
    _, _, R_ecef_from_body = _orientations(trajectory.poses)
    turns = concrete(jnp.linalg.norm(_turns(R_ecef_from_body), axis=1))
    if turns is not None and np.any(turns > LARGEST_TURN):
        knot = int(np.argmax(turns > LARGEST_TURN)) + 1
        raise ValueError(
            f"the body turns by {np.rad2deg(turns[knot - 1]):.1f} deg up to knot {knot}; beyond "
            f"{np.rad2deg(LARGEST_TURN):.0f} deg between two knots nobody can tell which way. Are the angles in rad?"
        )
