"""Rotation matrices and vectors. All are active and right-handed: `R_b_from_a @ v_a = v_b`."""

from __future__ import annotations

from typing import Any, TypeAlias

import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import by_numpy_if_known
from jaxgeo._compile import one_program
from jaxgeo._elementary import sine_and_cosine
from jaxgeo._numerics import cross, matmul3, matrix, safe_norm, safe_sqrt
from jaxgeo._typing import Matrix3, Scalar, Vector3

Components: TypeAlias = tuple[Scalar, Scalar, Scalar]


def Rx(angle: Scalar) -> Matrix3:
    """Rotation by `angle` rad about the first axis."""
    c, s, zero, one = _parts(angle)
    return matrix([[one, zero, zero], [zero, c, -s], [zero, s, c]])


def Ry(angle: Scalar) -> Matrix3:
    """Rotation by `angle` rad about the second axis."""
    c, s, zero, one = _parts(angle)
    return matrix([[c, zero, s], [zero, one, zero], [-s, zero, c]])


def Rz(angle: Scalar) -> Matrix3:
    """Rotation by `angle` rad about the third axis."""
    c, s, zero, one = _parts(angle)
    return matrix([[c, -s, zero], [s, c, zero], [zero, zero, one]])


def about_x(angle: Scalar, v: Components) -> Components:
    """`Rx(angle)` times a vector, by components: for a batch, building the matrices takes longer than using them."""
    return turned_x(*sine_and_cosine(angle), v)


def about_y(angle: Scalar, v: Components) -> Components:
    """`Ry(angle)` times a vector (see `about_x`)."""
    return turned_y(*sine_and_cosine(angle), v)


def turned_x(s: Scalar, c: Scalar, v: Components) -> Components:
    """`about_x` from the sine and cosine of the angle."""
    return v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]


def turned_y(s: Scalar, c: Scalar, v: Components) -> Components:
    """`about_y` from the sine and cosine of the angle."""
    return c * v[0] + s * v[2], v[1], c * v[2] - s * v[0]


def turned_z(s: Scalar, c: Scalar, v: Components) -> Components:
    """`Rz` times a vector, from the sine and cosine of the angle (see `about_x`)."""
    return c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]


def R_from_heading_pitch_roll(heading: Scalar, pitch: Scalar, roll: Scalar) -> Matrix3:
    """`Rz(heading) Ry(pitch) Rx(roll)`; for the angles of a body (forward, right, down) this is `R_ned_from_body`."""
    return by_numpy_if_known(_product_of_turns, heading, pitch, roll)


def _product_of_turns(xp: Any, heading: Any, pitch: Any, roll: Any) -> Any:
    angles = xp.stack([heading, pitch, roll])
    (sh, sp, sr), (ch, cp, cr) = (np.sin(angles), np.cos(angles)) if xp is np else sine_and_cosine(angles)
    forward, right, down = [ch, sh], [-sh, ch], [ch * sp, sh * sp]
    rows = [
        *([cp * a, cr * b + sr * c, cr * c - sr * b] for a, b, c in zip(forward, right, down, strict=True)),
        [-sp, cp * sr, cp * cr],
    ]
    return np.array(rows) if xp is np else matrix(rows)


@one_program
def heading_pitch_roll_from_R(R: Matrix3) -> tuple[Scalar, Scalar, Scalar]:
    """Heading in (-pi, pi], pitch in [-pi/2, pi/2] and roll in (-pi, pi] rad of `Rz(heading) Ry(pitch) Rx(roll)`.

    At a pitch of exactly +-pi/2 (gimbal lock) heading and roll rotate about one axis; roll is then set to zero.
    """
    horizontal = safe_norm(R[:2, 0])
    locked = horizontal < 1e-15
    pitch = jnp.arctan2(-R[2, 0], horizontal)
    heading = jnp.arctan2(jnp.where(locked, -R[0, 1], R[1, 0]), jnp.where(locked, R[1, 1], R[0, 0]))
    # Not atan2(R[2, 1], R[2, 2]): near gimbal lock its noise would be independent of that of the heading.
    levelled = matmul3(Rz(-heading), R)
    roll = jnp.arctan2(-levelled[1, 2], levelled[1, 1])
    return heading, pitch, jnp.where(locked, 0.0, roll)


def omega_phi_kappa_from_R(R: np.ndarray) -> np.ndarray:
    """Omega, phi and kappa (n, 3) in rad of rotations (n, 3, 3), `Rx(omega) Ry(phi) Rz(kappa)`; by NumPy.

    Phi lies in [-pi/2, pi/2]. At its limits omega and kappa rotate about one axis; kappa is then set to zero. Near them
    both are uncertain, and together right: kappa is what is left after omega is taken out.
    """
    cos_phi = np.hypot(R[:, 0, 0], R[:, 0, 1])
    locked = cos_phi < 1e-12
    omega = np.where(locked, np.arctan2(R[:, 2, 1], R[:, 1, 1]), np.arctan2(-R[:, 1, 2], R[:, 2, 2]))
    ahead, along = (np.cos(omega) * R[:, 1, k] + np.sin(omega) * R[:, 2, k] for k in (0, 1))
    kappa = np.where(locked, 0.0, np.arctan2(ahead, along))
    return np.stack([omega, np.arctan2(R[:, 0, 2], cos_phi), kappa], axis=-1)


@one_program
def R_from_rotation_vector(rotation: Vector3) -> Matrix3:
    """Rotation about `rotation` by its length in rad (Rodrigues formula), smooth at zero."""
    x, y, z = rotation
    zero = jnp.zeros_like(x)
    K = matrix([[zero, -z, y], [z, zero, -x], [-y, x, zero]])
    squared = jnp.sum(rotation**2)
    small = squared < 1e-8
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    sinc = jnp.where(small, 1.0 - squared / 6.0 + squared**2 / 120.0, jnp.sin(angle) / angle)
    half = jnp.where(small, 0.5 - squared / 24.0 + squared**2 / 720.0, 2.0 * (jnp.sin(0.5 * angle) / angle) ** 2)
    return jnp.eye(3) + sinc * K + half * matmul3(K, K)


@one_program
def rotation_vector_from_R(R: Matrix3) -> Vector3:
    """Rotation vector in rad of a rotation below 180 degrees, smooth at zero; inverse of `R_from_rotation_vector`.

    Uses the real part of the quaternion, which must not vanish: precision is lost close to 180 degrees.
    """
    real = 0.5 * safe_sqrt(1.0 + R[0, 0] + R[1, 1] + R[2, 2])
    axis = jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    axis = 0.25 * axis / jnp.where(real > 0.0, real, 1.0)
    squared = jnp.sum(axis * axis)
    small = squared < 1e-8
    sine = jnp.sqrt(jnp.where(small, 1.0, squared))
    exact = 2.0 * jnp.arctan2(sine, real) / sine
    return axis * jnp.where(small, 2.0 + squared / 3.0 + 3.0 * squared**2 / 20.0, exact)


@one_program
def rotation_rate_from_body_rate(rotation: Vector3, rate: Vector3) -> Vector3:
    """Time derivative in rad/s of a rotation vector (rad) for a body rate in rad/s (rotated axes).

    Inverse right Jacobian of the rotation group, for rotations well below 360 degrees.
    """
    squared = jnp.sum(rotation * rotation)
    small = squared < 1e-4
    angle = jnp.sqrt(jnp.where(small, 1.0, squared))
    exact = 1.0 / angle**2 - (1.0 + jnp.cos(angle)) / (2.0 * angle * jnp.sin(angle))
    weight = jnp.where(small, 1.0 / 12.0 + squared / 720.0 + squared**2 / 30240.0, exact)
    turned = jnp.stack(cross(rotation, rate))
    return rate + 0.5 * turned + weight * jnp.stack(cross(rotation, turned))


def _parts(angle: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    angle = jnp.asarray(angle)
    return jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
