"""Hand over large NumPy arrays to JAX without a second copy."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np

ALIGNMENT = 64  # bytes; JAX on a CPU takes over memory aligned like this, and copies other memory twice


def aligned_empty(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Uninitialised array that JAX can take over without a copy: do not write to it after `handed_over`."""
    dtype = np.dtype(dtype)
    size = math.prod(shape) * dtype.itemsize
    memory = np.empty(size + ALIGNMENT, np.uint8)
    first = -memory.ctypes.data % ALIGNMENT
    return memory[first : first + size].view(dtype).reshape(shape)


def handed_over(array: np.ndarray) -> jax.Array:
    """An array from `aligned_empty` as a JAX array, without a copy."""
    return jax.device_put(array)


def copied(array: Any) -> jax.Array:
    """A caller's array as a JAX array, copied once, so that the caller may keep writing to it."""
    if not isinstance(array, np.ndarray):
        return array
    own = aligned_empty(array.shape, array.dtype)
    np.copyto(own, array)
    return handed_over(own)
