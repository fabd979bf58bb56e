"""Sobol points by their number, and their nested uniform (Owen) scrambling, in 32-bit integers.

Integers are mirrored here: bit 0 carries the weight 1/2, bit 31 the weight 2^-32, as the scrambling wants them.
"""

from __future__ import annotations

import functools
import pathlib

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt32

BITS = 32
_TABLE = pathlib.Path(__file__).resolve().parents[1] / "data" / "joe_kuo_2008.txt"

Words = UInt32[Array, " size"]


def direction_numbers(size: int) -> np.ndarray:
    """Mirrored direction numbers of the first `size` dimensions, (size, 32), uint32.

    From the primitive polynomials and initial values of Joe and Kuo 2008, "Constructing Sobol sequences with better
    two-dimensional projections", SIAM J. Sci. Comput. 30. Raises `ValueError` beyond the table's dimensions.
    """
    lines = _lines()
    if not 0 <= size <= len(lines):
        raise ValueError(
            f"Sobol points are tabulated for 0 to {len(lines)} dimensions; got {size}. Draw with Random() instead: in "
            f"so many dimensions Sobol points are no better."
        )
    table = np.array([_mirrored_directions(line) for line in lines[:size]], np.uint32)
    return table.reshape(size, BITS)


@functools.cache
def _lines() -> tuple[tuple[int, ...], ...]:
    """A primitive polynomial's coefficients as the bits of a number, then its initial values, for every dimension."""
    rows = _TABLE.read_text(encoding="ascii").splitlines()
    return tuple(tuple(map(int, row.split())) for row in rows if row and not row.startswith("#"))


@functools.cache
def _mirrored_directions(line: tuple[int, ...]) -> tuple[int, ...]:
    """One dimension's 32 direction numbers, by the recurrence of Bratley and Fox 1988, ACM TOMS 14, algorithm 659."""
    polynomial, *values = line
    degree = polynomial.bit_length() - 1
    if degree == 0:
        return tuple(1 << k for k in range(BITS))
    while len(values) < BITS:
        value = values[-degree] ^ (values[-degree] << degree)
        for k in range(1, degree):
            if polynomial >> (degree - k) & 1:
                value ^= values[-k] << k
        values.append(value)
    # The k-th value's k bits are binary digits after the point, its lowest bit the last of them.
    return tuple(int(f"{value:0{k + 1}b}"[::-1], 2) for k, value in enumerate(values))


def sobol_point(index: UInt32[Array, ""], directions: UInt32[Array, "size 32"]) -> Words:
    """Point number `index` of the Sobol sequence, mirrored, in the order of the integers (not of their Gray code)."""
    point = jnp.zeros(directions.shape[0], jnp.uint32)
    for k in range(BITS):
        point = point ^ (directions[:, k] * (index >> k & 1))
    return point


def scrambled(point: Words, shift: Words, factor: Words) -> Words:
    """A mirrored point with every digit flipped or not, by a hash of the digits before it: nested uniform scrambling.

    Each dimension has its own random 32 bits in `shift` and in `factor`. A hash of this kind was found by Laine and
    Karras 2011, "Stratified sampling for stochastic transparency"; Burley 2020, "Practical hash-based Owen scrambling",
    made it one for Sobol points; this one's constants are by Vegdahl 2021, "Building a better LK hash".
    """
    point = point ^ point * jnp.uint32(0x3D20ADEA)
    point = (point + shift) * (factor | jnp.uint32(1))
    point = point ^ point * jnp.uint32(0x05526C56)
    return point ^ point * jnp.uint32(0x53A22864)


def mirrored(words: Words) -> Words:
    """The 32 bits of each word in opposite order."""
    for step, mask in [(1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)]:
        words = (words >> step) & jnp.uint32(mask) | (words & jnp.uint32(mask)) << step
    return words >> 16 | words << 16


def mixed(words: Words) -> Words:
    """A hash of each word in which every bit hangs on every other: the finaliser of MurmurHash3, Appleby 2011."""
    words = (words ^ words >> 16) * jnp.uint32(0x85EBCA6B)
    words = (words ^ words >> 13) * jnp.uint32(0xC2B2AE35)
    return words ^ words >> 16
