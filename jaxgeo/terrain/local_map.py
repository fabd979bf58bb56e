"""The way over a grid of rays that stay close together, from a map that is expanded once for all of them."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._numerics import dot
from jaxgeo._typing import Scalar, ScalarField
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.track import Quartic, Track

if TYPE_CHECKING:
    from jaxtyping import Array, Float

    from jaxgeo.terrain.dem import Dem

DEGREE = 3
# Powers of the three coordinates, each after the one that it is a multiple of.
POWERS = sorted((p for p in itertools.product(range(DEGREE + 1), repeat=3) if sum(p) <= DEGREE), key=sum)
_NODES = np.cos(np.pi * (np.arange(5) + 0.5) / 5.0)  # Chebyshev's, on each axis
_PLACES = np.array(list(itertools.product(_NODES, repeat=3)))
_MONOMIALS = np.stack([np.prod(_PLACES**power, axis=1) for power in POWERS], axis=1)
_FIT = np.linalg.pinv(_MONOMIALS)
_BEYOND = 4.0  # times what the expansion misses at the nodes: what it may miss between and behind them


class LocalMap(eqx.Module):
    """Row, column and height within a box as polynomials of the third degree of the place in it.

    `middle` in ECEF m, `axes` (3, 3) unit vectors by row, `half` the box's half lengths in m; `error` in m bounds what
    the polynomials miss. What rays need exact is polished on the exact map.
    """

    middle: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    half: Float[Array, "3"]
    coefficients: Float[Array, "3 powers"]
    error: ScalarField

    @classmethod
    def about(cls, dem: Dem, middle: Float[Array, "3"], axes: Float[Array, "3 3"], half: Float[Array, "3"]) -> LocalMap:
        """Fitted to the exact map of a terrain."""

        def exact(place: Float[Array, "3"]) -> Float[Array, "3"]:
            rowcol, height = dem.over(middle + (place * half) @ axes)
            return jnp.stack([*rowcol, height])

        values = jax.lax.map(exact, jnp.asarray(_PLACES))
        centre = values.mean(axis=0)
        coefficients = jnp.asarray(_FIT) @ (values - centre[None, :])
        missed = jnp.max(jnp.abs(jnp.asarray(_MONOMIALS) @ coefficients + centre[None, :] - values), axis=0)
        metres = jnp.stack([*dem.grid.cell_size(), jnp.asarray(1.0)])
        return cls(middle, axes, half, coefficients.T.at[:, 0].add(centre), _BEYOND * jnp.max(missed * metres))

    def track(self, ray: Ray, start: Scalar, end: Scalar) -> Track:
        """The track of a ray within the box between two ranges in m."""
        middle, half = 0.5 * (start + end), 0.5 * (end - start)
        away = [p - q for p, q in zip(ray.components_at(middle), self.middle, strict=True)]
        line = [
            [dot(axis, away) / size, half * dot(axis, ray.direction) / size]
            for axis, size in zip(self.axes, self.half, strict=True)
        ]
        terms: dict[tuple[int, ...], list[Scalar]] = {(0, 0, 0): [jnp.asarray(1.0)]}
        for power in POWERS[1:]:
            axis = next(number for number, exponent in enumerate(power) if exponent)
            lower = tuple(exponent - (number == axis) for number, exponent in enumerate(power))
            terms[power] = _times(terms[lower], line[axis])
        row, col, height = (_combined(terms, coefficients) for coefficients in self.coefficients)
        return Track(row, col, height, middle, half, jnp.asarray(self.error))


def _times(polynomial: list[Scalar], linear: list[Scalar]) -> list[Scalar]:
    """The product of a polynomial and a linear one, by coefficients from the lowest power up."""
    a, b = linear
    inner = [low * b + high * a for low, high in itertools.pairwise(polynomial)]
    return [polynomial[0] * a, *inner, polynomial[-1] * b]


def _combined(terms: dict[tuple[int, ...], list[Scalar]], coefficients: Float[Array, " powers"]) -> Quartic:
    total = [jnp.asarray(0.0)] * (DEGREE + 1)
    for number, term in enumerate(terms.values()):
        for k, part in enumerate(term):
            total[k] = total[k] + coefficients[number] * part
    c0, c1, c2, c3 = total
    return Quartic(c0, c1, c2, c3, jnp.zeros_like(c0))
