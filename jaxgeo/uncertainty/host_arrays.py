"""Batches of records on the host: entries, blocks, concatenation and scattering by NumPy, which compiles nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

import jax
import jax.core
import numpy as np

from jaxgeo._accelerator import by_device

T = TypeVar("T")


def on_host(tree: T) -> T:
    """The tree with NumPy arrays."""
    return jax.tree.map(np.asarray, tree)


def take(tree: T, index: Any) -> T:
    """One or several entries along the leading axis; traced arrays stay traced."""
    return jax.tree.map(lambda leaf: _entries(leaf, index), tree)


def blocks_of(tree: T, size: int, words: str, progress: bool) -> Iterator[T]:
    """Entries (n, ...) in blocks of one size; the last one is padded with the last entry."""
    host = on_host(tree)
    count = len(jax.tree.leaves(host)[0])
    starts = range(0, count, size)
    for start in with_bar(starts, len(starts), words, progress):
        yield take(host, np.minimum(np.arange(start, start + size), count - 1))


def block_size(count: int, block: int) -> int:
    """Size of the blocks for a number of items: at most the next power of two, on an accelerator of eight, where a
    program takes longer to compile and larger blocks hardly take longer to run."""
    step = by_device(1, 3)
    return min(block, 1 << step * -(-(count - 1).bit_length() // step))


def concatenate(parts: Sequence[T], count: int) -> T:
    """The first `count` entries of blocks, as NumPy arrays."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *parts)


def scatter(values: T, index: np.ndarray, count: int) -> T:
    """Entries of some of `count` places put in all of them; NaN elsewhere, -1 for integers."""

    def spread(leaf: np.ndarray) -> np.ndarray:
        blank = np.nan if np.issubdtype(leaf.dtype, np.floating) else -1
        whole = np.full((count, *leaf.shape[1:]), blank, leaf.dtype)
        whole[index] = leaf
        return whole

    return jax.tree.map(spread, values)


def _entries(leaf: Any, index: Any) -> Any:
    return leaf[index] if isinstance(leaf, jax.core.Tracer) else jax.device_put(np.asarray(leaf)[index])


def with_bar(items: Iterable[Any], count: int, words: str, progress: bool) -> Iterable[Any]:
    """The items, with a progress bar if requested."""
    if not progress:
        return items
    from rich.progress import track  # optional, imported only if used

    return track(items, description=words, total=count)
