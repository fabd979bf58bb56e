"""Batched evaluation of a function over many items in bounded memory."""

from __future__ import annotations

import ctypes
import gc
import itertools
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxgeo._accelerator import by_device
from jaxgeo._compile import long_run_filter_jit

SIZE, SIZE_ACCELERATOR = 16_384, 2**20
WRITERS = 8  # threads that write the results of an accelerator to the host's memory, each an array at a time


def in_batches(function: Callable[..., Any], many: Any, *common: Any, size: int | None = None) -> Any:
    """Results of `function(item, *common)` for each item of `many`, `size` items at a time, as NumPy arrays.

    `size` is 16,384 by default, and 1,048,576 on an accelerator.

    `many` is an array or a record (or a tuple of such) with a leading axis of items; the result has that axis too. Only
    the result and one batch are in memory. One program is compiled, since the last batch is padded with its last item;
    `jax.lax.map(..., batch_size=)` compiles a second one for the remainder. The program is cached for the next call
    with the same `function`: pass `jaxgeo.locate` or a named function, not a new lambda. Raises `ValueError` if there
    are no items, leading axes differ in length, or `size` is below 1.
    """
    size = by_device(SIZE, SIZE_ACCELERATOR) if size is None else size
    if isinstance(size, bool) or not isinstance(size, int | np.integer) or size < 1:
        raise ValueError(f"size must be an integer of at least 1, the number of items at a time; got {size!r}.")
    leaves = [leaf for leaf in jax.tree.leaves(many) if eqx.is_array_like(leaf)]
    counts = {np.shape(leaf)[0] if np.ndim(leaf) else 0 for leaf in leaves}
    if len(counts) != 1 or 0 in counts:
        told = sorted(str(np.shape(leaf)) for leaf in leaves)
        raise ValueError(
            f"many must be arrays with one leading axis of at least one item; got shapes {', '.join(told)}."
        )
    count = int(counts.pop() or 0)
    size, whole = min(int(size), count), None
    many = jax.tree.map(lambda x: np.asarray(x) if isinstance(x, jax.Array) else x, many)  # each slice is a program
    parts = by_device(_in_turn, _one_ahead)(function, many, common, [*range(0, count, size)], size)
    with ThreadPoolExecutor(WRITERS) as pool:  # without a thread until it is used
        each = by_device(map, pool.map)
        for first, part in parts:
            if whole is None:
                _give_back(function, part)
                whole = jax.tree.map(lambda x: np.empty((count, *x.shape[1:]), x.dtype), part)
            some = itertools.repeat(slice(first, first + size))
            list(each(_put, jax.tree.leaves(whole), jax.tree.leaves(part), some))
    return whole


def _in_turn(
    function: Callable[..., Any], many: Any, common: tuple[Any, ...], starts: list[int], size: int
) -> Iterator[tuple[int, Any]]:
    """(first item, results) batch by batch."""
    for first in starts:
        part = jax.tree.map(lambda x, a=first: _filled(x, a, size), many)
        yield first, _batch(function, part, common)


def _one_ahead(*how: Any) -> Iterator[tuple[int, Any]]:
    """As `_in_turn`; a device of its own computes the next batch while one goes to the host."""
    waiting = None
    for first, part in _in_turn(*how):
        for leaf in jax.tree.leaves(part):
            leaf.copy_to_host_async()
        if waiting is not None:
            yield waiting
        waiting = first, part
    if waiting is not None:
        yield waiting


@long_run_filter_jit
def _batch(function: Callable[..., Any], many: Any, common: tuple[Any, ...]) -> Any:
    return jax.vmap(lambda item: function(item, *common))(many)


def _filled(x: Any, first: int, size: int) -> np.ndarray:
    """`size` entries from `first` on, padded by repeating the last one."""
    part = np.asarray(x[first : first + size])
    missing = size - len(part)
    return part if missing == 0 else np.concatenate([part, np.repeat(part[-1:], missing, axis=0)])


def _put(whole: np.ndarray, part: Any, here: slice) -> None:
    """Write a batch, without its padding, into its place."""
    place = whole[here]
    place[:] = np.asarray(part)[: len(place)]


def _give_back(function: Callable[..., Any], part: Any) -> None:
    """Return memory freed after tracing and compiling to the system: half a GB, which glibc would keep.

    Not again for the same function and results of the same shapes, which hardly compile anything.
    """
    key = hash((id(function), *[(x.shape, x.dtype) for x in jax.tree.leaves(part)]))
    if key in _given_back:
        return
    _given_back.add(key)
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:  # glibc only
            trim(0)


_given_back: set[int] = set()
