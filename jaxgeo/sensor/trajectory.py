"""Where the platform was, and how it lay, at any time between its navigation records."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64, check_finite, concrete
from jaxgeo._numerics import tree_where
from jaxgeo._typing import Index, Matrix3, Scalar, ScalarField, Vector3, Vector3Field
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.rotations import (
    R_from_rotation_vector,
    heading_pitch_roll_from_R,
    rotation_rate_from_body_rate,
    rotation_vector_from_R,
)
from jaxgeo.sensor.camera import Numbers
from jaxgeo.sensor.gimbal import ReadingsField
from jaxgeo.sensor.platform import Pose, Shot

GAP = 10.0  # times the median interval: a longer one is a gap, unless the caller says what is
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

    @property
    def start(self) -> Scalar:
        """Time of the first knot, s."""
        return self.times[0]

    @property
    def end(self) -> Scalar:
        """Time of the last knot, s."""
        return self.times[-1]

    def at(self, time: ScalarField) -> Shot:
        """The shot at a time in s; before the first knot and after the last all of it is NaN but the time."""
        time = as_float64(time, "time")
        within = (time >= self.start) & (time <= self.end)
        safe = jnp.clip(jnp.where(jnp.isfinite(time), time, self.start), self.start, self.end)
        p_ecef, R_ecef_from_body = self._motion(safe)
        position = WGS84.to_geodetic(p_ecef)
        pose = Pose(position, *heading_pitch_roll_from_R(R_ecef_from_ned(position).T @ R_ecef_from_body))
        readings = self._readings(safe)
        unknown = jax.tree.map(lambda x: jnp.full_like(x, jnp.nan), (pose, readings))
        return Shot(*tree_where(within, (pose, readings), unknown), time)

    def velocity_ned_at(self, time: ScalarField) -> Vector3:
        """Velocity over the ground at a time between the knots, m/s in north-east-down."""
        time = as_float64(time, "time")
        p_ecef, velocity = jax.jvp(lambda t: self._motion(t)[0], (time,), (jnp.ones_like(time),))
        return R_ecef_from_ned(WGS84.to_geodetic(p_ecef)).T @ velocity

    def body_rates_at(self, time: ScalarField) -> Vector3:
        """Rates of the body against the Earth at a time between the knots, rad/s about forward, right and down."""
        time = as_float64(time, "time")
        R, turn = jax.jvp(lambda t: self._motion(t)[1], (time,), (jnp.ones_like(time),))
        spin = R.T @ turn
        return jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])

    def _motion(self, time: Scalar) -> tuple[Vector3, Matrix3]:
        """Position in ECEF m, and R_ecef_from_body."""
        first, share, duration = self._place(time)
        begin, end = self._p_ecef(first), self._p_ecef(first + 1)
        # from the earlier knot on, for the last digits of an ECEF coordinate
        p_ecef = begin + _hermite(
            share, end - begin, duration * self._velocity(first), duration * self._velocity(first + 1)
        )
        turn = self._turn(first)
        last_rate = rotation_rate_from_body_rate(turn, self._rates(first + 1))
        rotation = _hermite(share, turn, duration * self._rates(first), duration * last_rate)
        return p_ecef, self._R_ecef_from_body(first) @ R_from_rotation_vector(rotation)

    def _readings(self, time: Scalar) -> Float[Array, " axes"]:
        first, share, duration = self._place(time)
        readings = jnp.asarray(self.gimbal_readings)
        step = lambda k: readings[k + 1] - readings[k]  # noqa: E731
        begin, end = self._slope(first, step), self._slope(first + 1, step)
        return readings[first] + _hermite(share, step(first), duration * begin, duration * end)

    def _place(self, time: Scalar) -> tuple[Index, Scalar, Scalar]:
        """The knot before a time, the share of the interval behind it that has passed, and its duration in s."""
        first = self._interval(time)
        duration = self.times[first + 1] - self.times[first]
        return first, (time - self.times[first]) / duration, duration

    def _interval(self, time: Scalar) -> Index:
        after = jnp.searchsorted(jax.lax.stop_gradient(self.times), jax.lax.stop_gradient(time), side="right")
        return jnp.clip(after - 1, 0, self.times.shape[0] - 2)

    def _p_ecef(self, knot: Index) -> Vector3:
        return WGS84.to_ecef(self._position(knot))

    def _position(self, knot: Index) -> Geodetic:
        return jax.tree.map(lambda x: x[knot], self.poses.position)

    def _R_ecef_from_body(self, knot: Index) -> Matrix3:
        pose = jax.tree.map(lambda x: x[knot], self.poses)
        return R_ecef_from_ned(pose.position) @ pose.R_ned_from_body

    def _turn(self, knot: Index) -> Vector3:
        """Rotation vector from a knot to the next, the same in the body axes of both."""
        return rotation_vector_from_R(self._R_ecef_from_body(knot).T @ self._R_ecef_from_body(knot + 1))

    def _velocity(self, knot: Index) -> Vector3:
        if self.velocity_ned is not None:
            return R_ecef_from_ned(self._position(knot)) @ jnp.asarray(self.velocity_ned)[knot]
        return self._slope(knot, lambda k: self._p_ecef(k + 1) - self._p_ecef(k))

    def _rates(self, knot: Index) -> Vector3:
        if self.body_rates is not None:
            return jnp.asarray(self.body_rates)[knot]
        return self._slope(knot, self._turn)

    def _slope(self, knot: Index, step: Callable[[Index], Array]) -> Array:
        """Derivative at a knot of the parabola through it and its neighbours; `step(k)` leads from knot k to k + 1."""
        knots = self.times.shape[0]
        if knots == 2:
            return step(jnp.zeros_like(knot)) / (self.times[1] - self.times[0])
        first = jnp.clip(knot - 1, 0, knots - 3)
        a, b, c = (self.times[first + k] for k in range(3))
        before, after = step(first) / (b - a), step(first + 1) / (c - b)
        return before + (after - before) / (c - a) * (2.0 * self.times[knot] - a - b)


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
    for vector, name in zip(vectors, ("velocity_ned", "body_rates"), strict=True):
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
    knots = jnp.arange(trajectory.times.shape[0] - 1)
    turns = concrete(jnp.linalg.norm(jax.vmap(trajectory._turn)(knots), axis=1))
    if turns is not None and np.any(turns > LARGEST_TURN):
        knot = int(np.argmax(turns > LARGEST_TURN)) + 1
        raise ValueError(
            f"the body turns by {np.rad2deg(turns[knot - 1]):.1f} deg up to knot {knot}; beyond "
            f"{np.rad2deg(LARGEST_TURN):.0f} deg between two knots nobody can tell which way. Are the angles in rad?"
        )
