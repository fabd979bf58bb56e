"""Polynomial map from ECEF to (row, col, height) within a box, shared by rays that stay close together."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._numerics import dot
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.track import Quartic, Track

if TYPE_CHECKING:
    from jaxtyping import Array, Float

    from jaxgeo.terrain.dem import Dem

DEGREE = 3
# Powers of the three coordinates, each after the one it is a multiple of.
POWERS = sorted((p for p in itertools.product(range(DEGREE + 1), repeat=3) if sum(p) <= DEGREE), key=sum)
_NODES = np.cos(np.pi * (np.arange(5) + 0.5) / 5.0)  # Chebyshev nodes on each axis
_PLACES = np.array(list(itertools.product(_NODES, repeat=3)))
_MONOMIALS = np.stack([np.prod(_PLACES**power, axis=1) for power in POWERS], axis=1)
_FIT = np.linalg.pinv(_MONOMIALS)
_BEYOND = 4.0  # safety factor on the error at the nodes, to bound the error between and beyond them


class Line(NamedTuple):
    """A ray through a box. First axis: ranges in m at its middle and from there to its end. Either other axis: the
    position in the box at the middle, and the change from there to the end."""

    middle: Scalar
    half: Scalar
    second: tuple[Scalar, Scalar]
    third: tuple[Scalar, Scalar]

    @property
    def across(self) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        """The two other axes."""
        return self.second, self.third


class LocalMap(Record):
    """Row, column and height within a box as cubic polynomials of the position.

    `middle` in ECEF m, `axes` (3, 3) unit vectors by row, `half` the box's half lengths in m; `error` in m bounds the
    approximation error. Exact results are polished on the exact map.
    """

    middle: Float[Array, "3"]
    axes: Float[Array, "3 3"]
    half: Float[Array, "3"]
    coefficients: Float[Array, "3 powers"]
    error: ScalarField

    @classmethod
    def about(cls, dem: Dem, middle: Float[Array, "3"], axes: Float[Array, "3 3"], half: Float[Array, "3"]) -> LocalMap:
        """Fit to the exact map of a terrain."""

        def exact(place: Float[Array, "3"]) -> Float[Array, "3"]:
            rowcol, height = dem.over(middle + (place * half) @ axes)
            return jnp.stack([*rowcol, height])

        values = jax.vmap(exact)(jnp.asarray(_PLACES))
        centre = values.mean(axis=0)
        coefficients = jnp.asarray(_FIT) @ (values - centre[None, :])
        missed = jnp.max(jnp.abs(jnp.asarray(_MONOMIALS) @ coefficients + centre[None, :] - values), axis=0)
        metres = jnp.stack([*dem.grid.cell_size(), jnp.asarray(1.0)])
        return cls(middle, axes, half, coefficients.T.at[:, 0].add(centre), _BEYOND * jnp.max(missed * metres))

    def line(self, ray: Ray) -> Line:
        """A ray from one end of the box to the other."""
        away = [p - q for p, q in zip(ray.origin, self.middle, strict=True)]
        first, *others = self.axes
        along = dot(first, ray.direction)
        middle, half = -dot(first, away) / along, self.half[0] / along
        across = []
        for axis, size in zip(others, self.half[1:], strict=True):
            slope = dot(axis, ray.direction)
            across.append(((dot(axis, away) + middle * slope) / size, half * slope / size))
        return Line(middle, half, *across)

    def track(self, line: Line) -> Track:
        """The track of a ray from one end of the box to the other; tau runs along the box's first axis."""
        all_three = jax.lax.map(lambda one: _along(line.across, one), self.coefficients)  # compiled once
        row, col, height = (jax.tree.map(lambda x, k=k: x[k], all_three) for k in range(3))
        return Track(row, col, height, line.middle, line.half, jnp.asarray(self.error))

    def slopes(self, extent: Float[Array, "3"]) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
        """Derivatives of row, column and height by the three coordinates at the box's centre, and bounds of their
        magnitudes where the coordinates are within `extent` of it (1 is the box's end)."""
        powers = np.asarray(POWERS)
        lowered = np.maximum(powers[:, None, :] - np.eye(3, dtype=int), 0)  # by the coordinate of differentiation
        sizes = powers * jnp.prod(extent[None, None, :] ** jnp.asarray(lowered), axis=-1)
        linear = np.array([POWERS.index(power) for power in ((1, 0, 0), (0, 1, 0), (0, 0, 1))])
        return self.coefficients[:, linear], jnp.abs(self.coefficients) @ sizes


def _along(across: Sequence[tuple[Scalar, Scalar]], coefficients: Float[Array, " powers"]) -> Quartic:
    """The polynomial of the three coordinates along a line: the first is tau, the others are linear in tau."""
    total = [jnp.asarray(0.0)] * (DEGREE + 1)
    terms: dict[tuple[int, int], list[Scalar]] = {(0, 0): [jnp.asarray(1.0)]}
    for number, (ahead, *power) in enumerate(POWERS):
        j, k = power
        if (j, k) not in terms:
            terms[j, k] = _times(terms[j - 1, k], across[0]) if j else _times(terms[j, k - 1], across[1])
        for place, part in enumerate(terms[j, k], ahead):
            total[place] = total[place] + coefficients[number] * part
    c0, c1, c2, c3 = total
    return Quartic(c0, c1, c2, c3, jnp.zeros_like(c0))


def _times(polynomial: list[Scalar], linear: tuple[Scalar, Scalar]) -> list[Scalar]:
    """Product of a polynomial and a linear one, by coefficients from the lowest power up."""
    a, b = linear
    inner = [low * b + high * a for low, high in itertools.pairwise(polynomial)]
    return [polynomial[0] * a, *inner, polynomial[-1] * b]
