"""Polynomial track of a ray over a grid: row, column and height as functions of range."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.dem import Dem

LONGEST_TRACK = 40_000.0  # m: beyond this a quartic is not accurate enough
TRACK_TOLERANCE = 1e-6  # m; the error for a bent ray is about 5e-7
_DROPPED = 16.0 / (25.0 * 5.0**0.5)  # largest |tau (tau^2 - 1)^2| on [-1, 1]


class Quartic(Record):
    """Quartic polynomial in tau by its coefficients, each one number or one per ray."""

    c0: ScalarField
    c1: ScalarField
    c2: ScalarField
    c3: ScalarField
    c4: ScalarField

    def at(self, tau: Scalar) -> Scalar:
        """The value at `tau`."""
        return (((self.c4 * tau + self.c3) * tau + self.c2) * tau + self.c1) * tau + self.c0

    def slope(self, tau: Scalar) -> Scalar:
        """The derivative at `tau`."""
        return ((4.0 * self.c4 * tau + 3.0 * self.c3) * tau + 2.0 * self.c2) * tau + self.c1

    def lowered(self, by: Scalar) -> Quartic:
        """The polynomial minus a number."""
        return Quartic(self.c0 - by, self.c1, self.c2, self.c3, self.c4)

    def speed(self) -> Scalar:
        """Upper bound of the derivative's magnitude for tau in [-1, 1]."""
        return abs(self.c1) + 2.0 * abs(self.c2) + 3.0 * abs(self.c3) + 4.0 * abs(self.c4)

    def sag(self) -> Scalar:
        """Upper bound of the deviation from a chord of unit length in tau."""
        return 0.25 * abs(self.c2) + 0.75 * abs(self.c3) + 1.5 * abs(self.c4)


class Track(Record):
    """(row, col, height) along a section of a ray, as polynomials of tau in [-1, 1].

    `middle` and `half` are the range in m at tau = 0 and half the length; `error` bounds the polynomials' error in m.
    """

    row: Quartic
    col: Quartic
    height: Quartic
    middle: ScalarField
    half: ScalarField
    error: ScalarField

    def at(self, tau: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """(row, col, height) at `tau`."""
        return self.row.at(tau), self.col.at(tau), self.height.at(tau)

    def range_at(self, tau: Scalar) -> Scalar:
        """Range in m along the ray at `tau`."""
        return self.middle + self.half * tau

    def speed(self) -> Scalar:
        """Upper bound of the cells passed per unit of tau, on either axis."""
        return jnp.maximum(self.row.speed(), self.col.speed())


def make_track(ray: Ray, dem: Dem, start: Scalar, end: Scalar) -> Track:
    """The track of `ray` over `dem` between two ranges in m.

    A quintic matches values and derivatives of the exact map at both ends and in the middle. Its last term, about 1e-9
    m over 20 km and growing with the fifth power of the length, is dropped where its effect is smallest, and gives the
    error.
    """
    middle, half = 0.5 * (start + end), 0.5 * (end - start)
    # a loop, so that the exact map is compiled once
    values, slopes = jax.lax.map(lambda tau: _exact(ray, dem, middle + half * tau), jnp.array([-1.0, 0.0, 1.0]))
    quantities, dropped = zip(*(_quartic(v, half * s) for v, s in zip(values, slopes, strict=True)), strict=True)
    along, across = dem.grid.cell_size()
    error = jnp.maximum(jnp.maximum(dropped[0] * along, dropped[1] * across), dropped[2])
    return Track(*quantities, middle=middle, half=half, error=error)


def _exact(ray: Ray, dem: Dem, distance: Scalar) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
    """Row, col and height at a range in m, and their derivatives by range."""

    def place(distance: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        *normal, height = WGS84.normal_and_height_of(*ray.components_at(distance))
        return *dem.grid.row_and_col(*normal), height

    return jax.jvp(place, (distance,), (jnp.ones_like(distance),))


def _quartic(values: Float[Array, "3"], slopes: Float[Array, "3"]) -> tuple[Quartic, Scalar]:
    """The quartic through values and slopes (by tau) at -1, 0 and 1, and a bound of its error."""
    (behind, centre, ahead), (behind_slope, centre_slope, ahead_slope) = values, slopes
    even, even_slope = 0.5 * (ahead + behind) - centre, 0.25 * (ahead_slope - behind_slope)
    odd, odd_slope = 0.5 * (ahead - behind), 0.5 * (ahead_slope + behind_slope)
    c3 = 0.5 * (odd_slope - odd)
    c1 = odd - c3
    left_out = _DROPPED * jnp.abs(centre_slope - c1)
    return Quartic(centre, c1, 2.0 * even - even_slope, c3, even_slope - even), left_out
