"""Closed-form attitude compensation by gimbal angles: LOS_ned = R_ned_from_body Rx(theta) Ry(phi) [0, 0, 1].

Li et al. (2020), "Effect and compensation of overlap influenced by flight parameter of oblique aerial camera", Eqs
23-26. theta is -(angle off nadir) of a right-looking camera, phi the inner angle, both in rad. The drive of a mirror
turns by half of phi (`Gimbal.mirror_two_axis`). Scalar functions; use `jax.vmap` for batches.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxgeo._checks import as_float64
from jaxgeo._numerics import matvec, safe_norm
from jaxgeo._typing import Matrix3, Scalar, ScalarLike, Vector3
from jaxgeo.rotations import about_x, about_y


class Angles(NamedTuple):
    """Outer angle `theta` and inner angle `phi` in rad, or changes of them."""

    theta: Scalar
    phi: Scalar


def line_of_sight_ned(R_ned_from_body: Matrix3, theta: ScalarLike, phi: ScalarLike) -> Vector3:
    """Unit line of sight in north-east-down (Eq 23)."""
    R_ned_from_body, theta, phi = as_float64((R_ned_from_body, theta, phi), "(R_ned_from_body, theta, phi)")
    zero, one = jnp.zeros(()), jnp.ones(())
    return matvec(R_ned_from_body, jnp.stack(about_x(theta, about_y(phi, (zero, zero, one)))))


def line_of_sight_head(R_ned_from_body: Matrix3, theta: ScalarLike, phi: ScalarLike, sight_ned: Vector3) -> Vector3:
    """A direction in north-east-down, in the axes of a head at (theta, phi) (Eq 24)."""
    R_ned_from_body, theta, phi, sight_ned = as_float64(
        (R_ned_from_body, theta, phi, sight_ned), "(R_ned_from_body, theta, phi, sight_ned)"
    )
    x, y, z = matvec(R_ned_from_body.T, sight_ned)
    return jnp.stack(about_y(-phi, about_x(-theta, (x, y, z))))


def angles_towards(R_ned_from_body: Matrix3, sight_ned: Vector3) -> Angles:
    """Angles that point the line of sight along a direction in north-east-down of any length; exact.

    With b the direction in the body, theta = atan2(-b_y, b_z) and phi = asin(b_x / |b|), computed as an arctangent.
    Along the body's x axis theta is undetermined: it is 0, without a gradient.
    """
    R_ned_from_body, sight_ned = as_float64((R_ned_from_body, sight_ned), "(R_ned_from_body, sight_ned)")
    x, y, z = matvec(R_ned_from_body.T, sight_ned)
    along = (y == 0.0) & (z == 0.0)
    theta = jnp.arctan2(jnp.where(along, 0.0, -y), jnp.where(along, 1.0, z))
    return Angles(theta, jnp.arctan2(x, safe_norm(jnp.stack([y, z]))))


def exact_compensation(R_ned_from_body: Matrix3, theta: ScalarLike, phi: ScalarLike, sight_ned: Vector3) -> Angles:
    """Changes of the angles that turn the line of sight from (theta, phi) to a direction in north-east-down."""
    theta, phi = as_float64((theta, phi), "(theta, phi)")
    new = angles_towards(R_ned_from_body, sight_ned)
    turn = new.theta - theta
    return Angles(turn - 2.0 * jnp.pi * jnp.round(turn / (2.0 * jnp.pi)), new.phi - phi)


def compensation_of_eqs_25_26(
    R_ned_from_body: Matrix3, theta: ScalarLike, phi: ScalarLike, sight_ned: Vector3
) -> Angles:
    """Changes of the angles by Eqs 25 and 26, from the direction in the axes of the old head (Eq 24).

    Exact only for phi = 0: the head's axes are rotated by phi, the frame's are not (for the paper's change of attitude
    at phi = 10 deg the line of sight is 0.010 deg off). Eq 25 is printed with a minus, which belongs to the mirror's
    drive; here the change is that of phi itself.
    """
    x, y, z = line_of_sight_head(R_ned_from_body, theta, phi, sight_ned)
    return Angles(-jnp.arctan(y / z), jnp.arctan2(x, safe_norm(jnp.stack([y, z]))))
