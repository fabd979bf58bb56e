"""2 x 2 linear solve, safe to differentiate."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._typing import Scalar

PlanePoint = Float[Array, "2"]


def determinant(J: Float[Array, "2 2"]) -> Scalar:
    """Determinant of a 2 x 2 matrix."""
    return J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]


def solve_2d(J: Float[Array, "2 2"], value: PlanePoint) -> PlanePoint:
    """`J^-1 value`; a singular J is treated as having determinant one."""
    det = determinant(J)
    det = jnp.where(det == 0.0, 1.0, det)
    return jnp.stack([J[1, 1] * value[0] - J[0, 1] * value[1], J[0, 0] * value[1] - J[1, 0] * value[0]]) / det
