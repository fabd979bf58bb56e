"""Interpolation kernels (nearest, bilinear, cubic convolution) and image sampling."""

from __future__ import annotations

import functools
import operator
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Num

from jaxgeo._checks import check_countable
from jaxgeo._record import Record
from jaxgeo._typing import Numbers

LEAST = 1e-9  # weight below which a pixel is ignored
ROWS_AT_ONCE = 512
WORDS = {8: jnp.uint8, 16: jnp.uint16, 32: jnp.uint32, 64: jnp.uint64}  # unsigned types by size in bits


class AbstractInterpolation(Record):
    """Separable kernel: weights of neighbouring pixels, the same along rows and columns."""

    taps: ClassVar[tuple[int, ...]]
    """Offsets of the contributing pixels from `first`."""

    @abstractmethod
    def first(self, place: Numbers) -> Numbers:
        """The whole pixel from which taps are counted."""

    @abstractmethod
    def weights(self, fraction: Numbers) -> tuple[Numbers, ...]:
        """One weight per tap, with sum 1; `fraction` is the position less `first`."""


class Nearest(AbstractInterpolation):
    """Value of the nearest pixel: for class labels and other values that must not be mixed."""

    taps: ClassVar = (0,)

    def first(self, place: Numbers) -> Numbers:
        return jnp.floor(place + 0.5)

    def weights(self, fraction: Numbers) -> tuple[Numbers, ...]:
        return (jnp.ones_like(fraction),)


class Bilinear(AbstractInterpolation):
    """Linear between the four neighbouring pixels."""

    taps: ClassVar = (0, 1)

    def first(self, place: Numbers) -> Numbers:
        return jnp.floor(place)

    def weights(self, fraction: Numbers) -> tuple[Numbers, ...]:
        return 1.0 - fraction, fraction


class Cubic(AbstractInterpolation):
    """Cubic convolution over sixteen pixels: Keys (1981), "Cubic convolution interpolation for digital image
    processing", with a = -1/2; exact for quadratic polynomials."""

    taps: ClassVar = (-1, 0, 1, 2)

    def first(self, place: Numbers) -> Numbers:
        return jnp.floor(place)

    def weights(self, fraction: Numbers) -> tuple[Numbers, ...]:
        t, s = fraction, 1.0 - fraction
        return -0.5 * t * s * s, 1.0 + t * t * (1.5 * t - 2.5), 1.0 + s * s * (1.5 * s - 2.5), -0.5 * s * t * t


def precision_of(values: Num[Array, "..."]) -> Any:
    """Dtype of sums: float32 for float32 values and integers of up to 16 bits, where it is far more accurate than
    their rounding; else float64."""
    return jnp.float64 if values.dtype.itemsize > 2 and values.dtype != jnp.float32 else jnp.float32


class Pixels(Record):
    """The pixels of an image (bands, rows, cols) in a layout for fast gathering.

    Two to four 8-bit bands can share a word, with eight bits each, or sixteen for means in units of 1/256. Other bands
    are stored separately. `known` is None if all pixels are known.
    """

    words: tuple[Num[Array, " pixels"], ...]
    known: Bool[Array, " pixels"] | None
    bands: int = eqx.field(static=True)
    shape: tuple[int, int] = eqx.field(static=True)
    bits: int = eqx.field(static=True)
    """Bits per band in a word; 0 if bands are stored separately."""

    @classmethod
    def of(cls, values: Num[ArrayLike, "bands rows cols"], known: Bool[ArrayLike, "rows cols"] | None) -> Pixels:
        """Unpacked layout, one array per band."""
        bands, rows, cols = np.shape(values)
        check_countable(rows * cols, f"{rows} x {cols} pixels in one image", "Cut it into parts, or make it coarser.")
        words = tuple(jnp.asarray(band).reshape(-1) for band in values)  # pyright: ignore[reportGeneralTypeIssues]
        return cls(words, None if known is None else jnp.asarray(known).reshape(-1), bands, (rows, cols), 0)

    @property
    def are_few_bytes(self) -> bool:
        """Whether the bands fit into one word."""
        return not self.bits and self.words[0].dtype == jnp.uint8 and 2 <= self.bands <= 4

    def packed(self) -> Pixels:
        """The same pixels packed into words, if they fit."""
        if not self.are_few_bytes:
            return self
        return Pixels((_packed(self.words, 8),), self.known, self.bands, self.shape, 8)

    def taken(self, place: Int[Array, "..."], precision: Any) -> list[Float[Array, "..."]]:
        """Pixel values at indices into the flat arrays, band by band."""
        words = [word.at[place].get(mode="promise_in_bounds") for word in self.words]
        if not self.bits:
            return [word.astype(precision) for word in words]
        scale = 1.0 / 256.0 if self.bits == 16 else 1.0
        return [part.astype(jnp.int32).astype(precision) * scale for part in self._unpacked(words[0])]

    def precision(self) -> Any:
        """Dtype of sums over these pixels."""
        return jnp.float32 if self.bits else precision_of(self.words[0])

    def halved(self) -> Pixels:
        """Means of 2 x 2 pixels; known where all four are. An odd last row or column is dropped."""
        rows, cols = (n // 2 * 2 for n in self.shape)

        def four(flat: Array) -> list[Array]:
            image = flat.reshape(self.shape)
            return [image[i:rows:2, j:cols:2].reshape(-1) for i in (0, 1) for j in (0, 1)]

        if self.are_few_bytes:
            means = [_total([x.astype(jnp.uint32) for x in four(word)]) << 6 for word in self.words]
            words, bits = (_packed(means, 16),), 16
        elif self.bits:
            parts = [self._unpacked(word) for word in four(self.words[0])]
            sums = [_total([part[band].astype(jnp.uint32) for part in parts]) for band in range(self.bands)]
            words, bits = (_packed([(total + 2) >> 2 for total in sums], self.bits),), self.bits
        else:
            words, bits = (
                tuple(0.25 * _total([x.astype(self.precision()) for x in four(word)]) for word in self.words),
                0,
            )
        known = None if self.known is None else functools.reduce(operator.and_, four(self.known))
        return Pixels(words, known, self.bands, (rows // 2, cols // 2), bits)

    def _unpacked(self, word: Array) -> list[Array]:
        mask = jnp.asarray((1 << self.bits) - 1, word.dtype)
        return [(word >> jnp.asarray(self.bits * band, word.dtype)) & mask for band in range(self.bands)]


def halved_pixels(values: np.ndarray, known: np.ndarray | None) -> Pixels:
    """`Pixels.of(values, known).halved()` in parts, without a full copy of the image."""
    rows = values.shape[1] // 2 * 2
    count = min(ROWS_AT_ONCE, rows)
    parts = []
    for first in range(0, rows, count):
        overlap = max(first + count - rows, 0)  # all parts have one size, so that one compiled program serves all
        part = np.s_[first - overlap : first - overlap + count]
        found = _halved(Pixels.of(values[:, part], None if known is None else known[part]))
        skipped = overlap // 2 * (values.shape[2] // 2)
        parts.append(jax.tree.map(lambda x: x[skipped:], found))  # noqa: B023
    shape = (rows // 2, values.shape[2] // 2)
    whole = parts[0] if len(parts) == 1 else jax.tree.map(lambda *flat: jnp.concatenate(flat), *parts)
    return Pixels(whole.words, whole.known, whole.bands, shape, whole.bits)


_halved = eqx.filter_jit(Pixels.halved)


def _total(parts: Sequence[Array]) -> Array:
    return functools.reduce(operator.add, parts)


def _packed(bands: Sequence[Array], bits: int) -> Array:
    """Integers of `bits` bits packed into one word."""
    need = bits * len(bands)
    dtype = next(dtype for size, dtype in WORDS.items() if size >= need)
    return functools.reduce(operator.or_, [band.astype(dtype) << (bits * k) for k, band in enumerate(bands)])


def sampled(
    pixels: Pixels, uv: tuple[Numbers, Numbers], how: AbstractInterpolation
) -> tuple[list[Float[Array, "..."]], Bool[Array, "..."]]:
    """(values at (column, row) positions of any shape, band by band; whether all contributing pixels are known).

    Beyond the edge, the edge pixels repeat; the caller masks positions outside the image.
    """
    rows, cols = pixels.shape
    u, v = uv
    precision = pixels.precision()
    first_col, first_row = how.first(u), how.first(v)
    by_col, by_row = (
        tuple(weight.astype(precision) for weight in how.weights(part)) for part in (u - first_col, v - first_row)
    )
    col0, row0 = first_col.astype(jnp.int32), first_row.astype(jnp.int32)
    columns = [jnp.clip(col0 + tap, 0, cols - 1) for tap in how.taps]
    lines = [jnp.clip(row0 + tap, 0, rows - 1) * cols for tap in how.taps]
    found: list[Any] = [0.0] * pixels.bands
    sound = jnp.ones(jnp.shape(u), bool)
    for line, weight_row in zip(lines, by_row, strict=True):
        along: list[Any] = [0.0] * pixels.bands
        for column, weight_col in zip(columns, by_col, strict=True):
            place = line + column
            along = [
                part + weight_col * pixel for part, pixel in zip(along, pixels.taken(place, precision), strict=True)
            ]
            if pixels.known is not None:
                here = pixels.known.at[place].get(mode="promise_in_bounds")
                sound &= here | (jnp.abs(weight_row * weight_col) < LEAST)
        found = [total + weight_row * part for total, part in zip(found, along, strict=True)]
    return found, sound
