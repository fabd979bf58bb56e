"""A ray over the grid: row, column and height as polynomials of range."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._typing import Scalar
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.dem import Dem

NODES = 6
_TAU = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
_FIT = np.linalg.inv(np.vander(_TAU, increasing=True))
_CHECKS = np.array([-1.0, -0.5, 0.5, 1.0])  # where the error of interpolation is near its extremes
_POWERS = np.arange(NODES)


class Track(eqx.Module):
    """(row, col, height) along a stretch of a ray, as polynomials of tau in [-1, 1].

    `coefficients` are (power, quantity); `middle` and `half` are the range in m at tau = 0 and half the length; `error`
    is the largest distance in m from the exact map at the check points.
    """

    coefficients: Float[Array, "nodes 3"]
    middle: Scalar
    half: Scalar
    error: Scalar

    def at(self, tau: Scalar) -> Float[Array, "3"]:
        """(row, col, height) at `tau`."""
        value = self.coefficients[-1]
        for power in range(NODES - 2, -1, -1):
            value = value * tau + self.coefficients[power]
        return value

    def slope(self, tau: Scalar) -> Float[Array, "3"]:
        """d(row, col, height) / d(tau)."""
        value = (NODES - 1.0) * self.coefficients[-1]
        for power in range(NODES - 2, 0, -1):
            value = value * tau + power * self.coefficients[power]
        return value

    def range_at(self, tau: Scalar) -> Scalar:
        """Range in m along the ray at `tau`."""
        return self.middle + self.half * tau

    def speed(self) -> Scalar:
        """An upper bound on the cells passed per unit of tau, on either axis."""
        return jnp.max(jnp.asarray(_POWERS) @ jnp.abs(self.coefficients[:, :2]))

    def sag(self) -> Float[Array, "3"]:
        """Upper bounds on how far row, col and height bend away from a chord of unit length in tau."""
        return 0.125 * (jnp.asarray(_POWERS * (_POWERS - 1.0)) @ jnp.abs(self.coefficients))


def make_track(ray: Ray, dem: Dem, start: Scalar, end: Scalar) -> Track:
    """The track of `ray` over `dem` between two ranges in m, by interpolation at Chebyshev nodes.

    With six nodes the error over 60 km is some 1e-11 m of position, set against `Track.error` from four more
    conversions.
    """
    middle, half = 0.5 * (start + end), 0.5 * (end - start)

    def exact(tau: Scalar) -> Float[Array, "3"]:
        normal, height = WGS84.normal_and_height(ray.at(middle + half * tau))
        return jnp.append(dem.grid.rowcol(normal), height)

    values = jax.vmap(exact)(jnp.asarray(np.concatenate([_TAU, _CHECKS])))
    coefficients = jnp.asarray(_FIT) @ values[:NODES]
    track = Track(coefficients, middle, half, jnp.zeros_like(half))
    scale = jnp.append(dem.grid.cell_size(), 1.0)
    misses = jnp.abs(jax.vmap(track.at)(jnp.asarray(_CHECKS)) - values[NODES:]) * scale[None, :]
    return eqx.tree_at(lambda t: t.error, track, jnp.max(misses))
