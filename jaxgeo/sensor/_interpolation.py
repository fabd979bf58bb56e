"""Cubic interpolation between navigation records: one segment per interval, computed once."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxgeo._numerics import matmul3, matvec
from jaxgeo._typing import Index, Matrix3, Scalar, Vector3
from jaxgeo.earth import WGS84, R_ecef_from_ned
from jaxgeo.rotations import R_from_rotation_vector, rotation_rate_from_body_rate, rotation_vector_from_R
from jaxgeo.sensor.platform import Deflection, Pose, Station


class Legs(NamedTuple):
    """Values at n knots (`times` in s) and differences between neighbouring knots (n - 1).

    Positions (ECEF m), position differences and velocities (m/s); R_ecef_from_body, rotation vectors between knots and
    rates (rad/s, body axes); gimbal readings, their differences and slopes (rad, rad/s); deflections.
    """

    times: Array
    p_ecef: Array
    steps: Array
    velocities: Array
    R_ecef_from_body: Array
    turns: Array
    rates: Array
    gimbal_readings: Array
    reading_steps: Array
    reading_slopes: Array
    deflection: Deflection | None

    @classmethod
    def of(
        cls, times: Array, poses: Pose, readings: Array, velocity_ned: Array | None, body_rates: Array | None
    ) -> Legs:
        """Segments through knots; missing velocities and rates come from parabolas through three knots."""
        p_ecef, R_ecef_from_ned_, R_ecef_from_body = _orientations(poses)
        steps, turns = p_ecef[1:] - p_ecef[:-1], _turns(R_ecef_from_body)
        reading_steps = readings[1:] - readings[:-1]
        given = None if velocity_ned is None else jax.vmap(matvec)(R_ecef_from_ned_, velocity_ned)
        return cls(
            times,
            p_ecef,
            steps,
            _slopes(times, steps) if given is None else given,
            R_ecef_from_body,
            turns,
            _slopes(times, turns) if body_rates is None else body_rates,
            readings,
            reading_steps,
            _slopes(times, reading_steps),
            poses.deflection,
        )

    def motion(self, time: Scalar, later: Scalar) -> tuple[Vector3, Matrix3]:
        """Position in ECEF m and R_ecef_from_body at `time + later`, both in s."""
        k, share, duration = self._place(time, later)
        velocities, rates, turn = self.velocities, self.rates, self.turns[k]
        # relative to the earlier knot, to keep the last digits of an ECEF coordinate
        away = _hermite(share, self.steps[k], duration * velocities[k], duration * velocities[k + 1])
        at_end = rotation_rate_from_body_rate(turn, rates[k + 1])
        rotation = _hermite(share, turn, duration * rates[k], duration * at_end)
        return self.p_ecef[k] + away, matmul3(self.R_ecef_from_body[k], R_from_rotation_vector(rotation))

    def station(self, time: Scalar, later: Scalar) -> Station:
        """Station at `time + later`, both in s."""
        k, share, duration = self._place(time, later)
        p_ecef, R_ecef_from_body = self.motion(time, later)
        begin, end = duration * self.reading_slopes[k], duration * self.reading_slopes[k + 1]
        readings = self.gimbal_readings[k] + _hermite(share, self.reading_steps[k], begin, end)
        R_ecef_from_level = R_ecef_from_ned(WGS84.to_geodetic(p_ecef))
        deflection = self.deflection_at(time, later)
        if deflection is not None:
            R_ecef_from_level = matmul3(R_ecef_from_level, deflection.R_ned_from_level)
        return Station(p_ecef, R_ecef_from_body, R_ecef_from_level, readings)

    def deflection_at(self, time: Scalar, later: Scalar) -> Deflection | None:
        """Deflection of the vertical, interpolated linearly between the knots."""
        k, share, _ = self._place(time, later)
        return jax.tree.map(lambda x: x[k] + share * (x[k + 1] - x[k]), self.deflection)

    def _place(self, time: Scalar, later: Scalar) -> tuple[Index, Scalar, Scalar]:
        """Index of the knot before a time, elapsed share of the segment after it, and its duration in s."""
        k = knot_before(self.times, time, later)
        duration = _not_zero(self.times[k + 1] - self.times[k])
        return k, ((time - self.times[k]) + later) / duration, duration


def knot_before(times: Array, time: Scalar, later: Scalar) -> Index:
    """Index of the last knot not after a time, clipped to [0, n - 2]."""
    times, moment = jax.lax.stop_gradient((times, time + later))
    return jnp.clip(jnp.searchsorted(times, moment, side="right") - 1, 0, times.shape[0] - 2)


@jax.jit
def turn_angles(poses: Pose) -> Array:
    """Angles in rad between the orientations of neighbouring poses."""
    _, _, R_ecef_from_body = _orientations(poses)
    return jnp.linalg.norm(_turns(R_ecef_from_body), axis=1)


def _orientations(poses: Pose) -> tuple[Array, Array, Array]:
    """ECEF positions (n, 3), R_ecef_from_ned and R_ecef_from_body (n, 3, 3) of poses."""

    def one(pose: Pose) -> tuple[Vector3, Matrix3, Matrix3]:
        R = R_ecef_from_ned(pose.position)
        return WGS84.to_ecef(pose.position), R, matmul3(R, pose.R_ned_from_body)

    return jax.vmap(one)(poses)


def _turns(R_ecef_from_body: Array) -> Array:
    """Rotation vectors (n - 1, 3) from each orientation to the next; each is the same in the body axes of both."""
    return jax.vmap(lambda a, b: rotation_vector_from_R(matmul3(a.T, b)))(R_ecef_from_body[:-1], R_ecef_from_body[1:])


def _slopes(times: Array, steps: Array) -> Array:
    """Derivatives (n, ...) at knots from parabolas through neighbouring knots, given the differences between knots."""
    knots = times.shape[0]
    durations = times[1:] - times[:-1]
    speeds = steps / _not_zero(durations)[:, None]
    if knots == 2:
        return jnp.concatenate([speeds, speeds])
    first = np.clip(np.arange(knots) - 1, 0, knots - 3)
    a, b, c = (times[first + k] for k in range(3))
    weight = (2.0 * times - a - b) / _not_zero(c - a)
    return speeds[first] + weight[:, None] * (speeds[first + 1] - speeds[first])


def _not_zero(durations: Array) -> Array:
    """Durations, with zero replaced by one; only traced values can have two records at one time."""
    return jnp.where(durations == 0.0, 1.0, durations)


def _hermite(share: Scalar, change: Array, begin: Array, end: Array) -> Array:
    """Cubic from 0 to `change` for `share` from 0 to 1, with the end derivatives `begin` and `end`."""
    rest = 1.0 - share
    return share * (share * (3.0 - 2.0 * share) * change + rest * (rest * begin - share * end))
