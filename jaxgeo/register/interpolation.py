"""How a value between pixels is made: the nearest, bilinear, cubic."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Num

from jaxgeo._typing import Numbers

LEAST = 1e-9  # weight below which a pixel has no part in a value


class AbstractInterpolation(eqx.Module):
    """Weights of the pixels about a place, along rows and columns alike."""

    taps: ClassVar[tuple[int, ...]]
    """Pixels that take part, counted from `first`."""

    @abstractmethod
    def first(self, place: Numbers) -> Numbers:
        """The whole pixel from which taps are counted."""

    @abstractmethod
    def weights(self, fraction: Numbers) -> tuple[Numbers, ...]:
        """One weight for each tap, their sum 1, by the place less `first`."""


class Nearest(AbstractInterpolation):
    """The value of the nearest pixel: for classes, and values that may not be mixed."""

    taps: ClassVar = (0,)

    def first(self, place: Numbers) -> Numbers:
        return jnp.floor(place + 0.5)

    def weights(self, fraction: Numbers) -> tuple[Numbers, ...]:
        return (jnp.ones_like(fraction),)


class Bilinear(AbstractInterpolation):
    """Linear between the four pixels about a place."""

    taps: ClassVar = (0, 1)

    def first(self, place: Numbers) -> Numbers:
        return jnp.floor(place)

    def weights(self, fraction: Numbers) -> tuple[Numbers, ...]:
        return 1.0 - fraction, fraction


class Cubic(AbstractInterpolation):
    """Cubic convolution of sixteen pixels. Keys (1981), "Cubic convolution interpolation for digital image processing",
    with a = -1/2: exact for polynomials of second degree."""

    taps: ClassVar = (-1, 0, 1, 2)

    def first(self, place: Numbers) -> Numbers:
        return jnp.floor(place)

    def weights(self, fraction: Numbers) -> tuple[Numbers, ...]:
        t, s = fraction, 1.0 - fraction
        return -0.5 * t * s * s, 1.0 + t * t * (1.5 * t - 2.5), 1.0 + s * s * (1.5 * s - 2.5), -0.5 * s * t * t


def precision_of(values: Num[Array, "..."]) -> Any:
    """In which sums of values are made: single for those of up to 16 bits, which it holds far better than they are
    rounded to, and for those that are single themselves."""
    return jnp.float64 if values.dtype.itemsize > 2 and values.dtype != jnp.float32 else jnp.float32


def sampled(
    values: Num[Array, "bands rows cols"],
    known: Bool[Array, "rows cols"] | None,
    uv: tuple[Numbers, Numbers],
    how: AbstractInterpolation,
) -> tuple[Float[Array, "bands ..."], Bool[Array, "..."]]:
    """(values at places (column, row), whether all pixels that have part in them are known), of any one shape.

    Pixels beyond the edge are those at the edge; what lies outside is for the caller to say. `known` is None where all
    are.
    """
    bands, rows, cols = values.shape
    flat = values.reshape(bands, rows * cols)
    u, v = uv
    precision = precision_of(values)
    first_col, first_row = how.first(u), how.first(v)
    by_col, by_row = (
        tuple(weight.astype(precision) for weight in how.weights(part)) for part in (u - first_col, v - first_row)
    )
    col0, row0 = first_col.astype(jnp.int32), first_row.astype(jnp.int32)
    columns = [jnp.clip(col0 + tap, 0, cols - 1) for tap in how.taps]
    lines = [jnp.clip(row0 + tap, 0, rows - 1) * cols for tap in how.taps]
    found: list[Any] = [0.0] * bands
    sound = jnp.ones(jnp.shape(u), bool)
    for line, weight_row in zip(lines, by_row, strict=True):
        along: list[Any] = [0.0] * bands
        for column, weight_col in zip(columns, by_col, strict=True):
            place = line + column
            for band in range(bands):
                pixel = flat[band].at[place].get(mode="promise_in_bounds")
                along[band] = along[band] + weight_col * pixel.astype(precision)
            if known is not None:
                here = known.reshape(-1).at[place].get(mode="promise_in_bounds")
                sound &= here | (jnp.abs(weight_row * weight_col) < LEAST)
        found = [total + weight_row * part for total, part in zip(found, along, strict=True)]
    return jnp.stack(found), sound
