"""Gimbal angles that compensate an attitude change: section 3.1 of Li et al. (2020)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import safe_angle
from jaxgeo._typing import Matrix3, Scalar
from jaxgeo.coverage.compensation_formulas import compensation_of_eqs_25_26, exact_compensation, line_of_sight_ned
from jaxgeo.rotations import R_from_heading_pitch_roll
from jaxgeo.studies.li2020 import printed

INNER = (0.0, 10.0, -10.0)  # deg; the paper's example has 0


@dataclass(frozen=True)
class Compensation:
    """Compensation of the line of sight from a starting inner angle `inner`, all in deg.

    Changes of the outer and inner angle, exact and by Eqs 25 and 26; the turn of the line of sight by the attitude
    change (`off`), and the error that remains after Eqs 25 and 26 (`left`). The drive of a mirror turns by -inner / 2.
    """

    inner: float
    off: float
    outer_change: float
    inner_change: float
    outer_by_eq_26: float
    inner_by_eq_25: float
    left: float

    @property
    def drive_change(self) -> float:
        """Change of the azimuth drive, whose mirror turns the line of sight by twice the angle."""
        return -0.5 * self.inner_change


def compensations() -> list[Compensation]:
    """The paper's example (inner angle 0), and the same with other inner angles."""
    found = jnp.rad2deg(jax.vmap(_compensation)(jnp.deg2rad(jnp.array(INNER))))
    return [Compensation(inner, *row) for inner, row in zip(INNER, found.tolist(), strict=True)]


@jax.jit
def _compensation(phi: Scalar) -> Float[Array, "6"]:
    """The values of a record, in order, rad."""
    before, after = _attitude(printed.HEADING_BEFORE, 0.0, 0.0), _attitude(*printed.ATTITUDE_AFTER)
    theta = jnp.asarray(-math.radians(printed.OFF_NADIR))
    aim = line_of_sight_ned(before, theta, phi)
    exact, of_print = (solve(after, theta, phi, aim) for solve in (exact_compensation, compensation_of_eqs_25_26))
    off = safe_angle(line_of_sight_ned(after, theta, phi), aim)
    left = safe_angle(line_of_sight_ned(after, theta + of_print.theta, phi + of_print.phi), aim)
    return jnp.stack([off, *exact, *of_print, left])


def _attitude(heading: float, pitch: float, roll: float) -> Matrix3:
    """R_ned_from_body of angles in deg."""
    return R_from_heading_pitch_roll(*(jnp.asarray(math.radians(angle)) for angle in (heading, pitch, roll)))
