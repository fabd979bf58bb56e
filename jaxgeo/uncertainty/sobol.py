"""Sobol points by index, with nested uniform (Owen) scrambling, in 32-bit integers.

Integers are bit-reversed here, as the scrambling requires: bit 0 has weight 1/2, bit 31 weight 2^-32. The functions of
words take arrays of NumPy and of JAX.
"""

from __future__ import annotations

import functools
import pathlib
from typing import Any

import numpy as np
from jaxtyping import Array, UInt32

BITS = 32
_TABLE = pathlib.Path(__file__).resolve().parents[1] / "data" / "joe_kuo_2008.txt"

Words = UInt32[Array | np.ndarray, "..."]


def direction_numbers(size: int) -> np.ndarray:
    """Bit-reversed direction numbers of the first `size` dimensions, (size, 32), uint32.

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
    """For every dimension the coefficients of a primitive polynomial as bits of a number, then its initial values."""
    rows = _TABLE.read_text(encoding="ascii").splitlines()
    return tuple(tuple(map(int, row.split())) for row in rows if row and not row.startswith("#"))


@functools.cache
def _mirrored_directions(line: tuple[int, ...]) -> tuple[int, ...]:
    """The 32 direction numbers of one dimension, by the recurrence of Bratley and Fox 1988, ACM TOMS 14, alg. 659."""
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
    # The k bits of value k are binary digits after the point, the lowest bit last.
    return tuple(int(f"{value:0{k + 1}b}"[::-1], 2) for k, value in enumerate(values))


@functools.lru_cache(maxsize=16)
def point_table(size: int) -> np.ndarray:
    """Points (4, 256, size) of the numbers that have bits in one of their four bytes only, bit-reversed.

    Points are linear over the field of two elements: that of any number is the sum of four. Raises as
    `direction_numbers`.
    """
    directions = direction_numbers(size).T.reshape(4, 8, size)
    table = np.zeros((4, 256, size), np.uint32)
    for bit in range(8):
        table[:, 2**bit : 2 ** (bit + 1)] = table[:, : 2**bit] ^ directions[:, bit, None]
    return table


def sobol_point(index: Any, table: Any) -> Any:
    """Points (..., size) number `index` (...), uint32, of the Sobol sequence, bit-reversed, in integer order (not Gray
    code order)."""
    point = table[0][index & np.uint32(255)]
    for byte in range(1, 4):
        point = point ^ table[byte][index >> np.uint32(8 * byte) & np.uint32(255)]
    return point


def scramble(point: Words, shift: Words, factor: Words) -> Words:
    """A bit-reversed point with each digit flipped by a hash of the preceding digits: nested uniform scrambling.

    Each dimension has its own random 32 bits in `shift` and in `factor`. Hash of this kind: Laine and Karras 2011,
    "Stratified sampling for stochastic transparency"; for Sobol points: Burley 2020, "Practical hash-based Owen
    scrambling"; constants: Vegdahl 2021, "Building a better LK hash".
    """
    point = point ^ point * np.uint32(0x3D20ADEA)
    point = (point + shift) * (factor | np.uint32(1))
    point = point ^ point * np.uint32(0x05526C56)
    return point ^ point * np.uint32(0x53A22864)


def mirror(words: Words) -> Words:
    """The 32 bits of each word in reverse order."""
    for step, mask in [(1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)]:
        words = (words >> step) & np.uint32(mask) | (words & np.uint32(mask)) << step
    return words >> 16 | words << 16


def mix(words: Words) -> Words:
    """Hash of each word in which every bit depends on every other: the finaliser of MurmurHash3, Appleby 2011."""
    words = (words ^ words >> 16) * np.uint32(0x85EBCA6B)
    words = (words ^ words >> 13) * np.uint32(0xC2B2AE35)
    return words ^ words >> 16
