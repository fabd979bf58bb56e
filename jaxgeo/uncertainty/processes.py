"""Sampling by several processes of `jax.distributed`: each draws a part, and all gather the whole."""

from __future__ import annotations

import math
import pickle
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgeo.uncertainty.batched_rays import block_size
from jaxgeo.uncertainty.intervals import relative_half_width
from jaxgeo.uncertainty.sampled_record import Sampled

TIMEOUT = 300.0  # s
ROOM = 8  # sizes of messages per octave, each of which compiles a program


class Failure(NamedTuple):
    """Sent by a process in place of its part: why it has none."""

    reason: str


def drawn_together(draw: Callable[[int, int], Sampled], first: int, count: int, timeout: float) -> Sampled:
    """Samples from number `first` on, of which each process draws a part by `draw(first, count)`.

    Raises `RuntimeError` if another process fails, has other arguments, or takes `timeout` seconds longer.
    """
    shares = divided(first, count, jax.process_count())
    mine = shares[jax.process_index()]
    try:
        part: Sampled | Failure | None = draw(*mine) if mine[1] else None
    except Exception as error:
        exchange(Failure(f"{type(error).__name__}: {error}"), timeout)
        raise
    every = exchange((shares, part), timeout)
    for number, one in enumerate(every):
        if isinstance(one, Failure):
            raise RuntimeError(f"sample: process {number} of jax.distributed failed with {one.reason}")
        if one[0] != shares:
            raise RuntimeError(
                f"sample: process {number} of jax.distributed draws {one[0]} (first, count of each process), and this "
                f"one, {jax.process_index()}, {shares}. All processes must call sample with the same arguments."
            )
    (whole, *others) = (one[1] for one in every if one[1] is not None)
    try:
        return whole.merge(*others)
    except ValueError as error:
        raise RuntimeError(
            f"sample: the processes of jax.distributed must call sample with the same arguments, but {error}"
        ) from error


def divided(first: int, count: int, processes: int) -> list[tuple[int, int]]:
    """(first sample, number of samples) of each process, in whole blocks if possible."""
    share, block = -(-count // processes), block_size()
    ends = [first + min(share * (number + 1), count) for number in range(processes)]
    whole = [end if end == first + count else -(-end // block) * block for end in ends]
    ends = [min(end, first + count) for end in whole]
    return [(start, end - start) for start, end in zip([first, *ends[:-1]], ends, strict=True)]


def until_sharp(draw: Callable[[int, int], Sampled], first: int, options: Any, step: int) -> Sampled:
    """Samples in rounds of `step`, then 25 % more, until the first figure at 90 % is known to `options.half_width`."""
    end = first + options.count
    whole = draw(first, min(step, options.count))
    while whole.runs[-1].end < end and not _is_sharp(whole, options.half_width):
        start = whole.runs[-1].end
        more = max(step, whole.count // 4)
        whole = whole.merge(draw(start, min(more, end - start)))
    return whole


def _is_sharp(whole: Sampled, half_width: float) -> bool:
    return relative_half_width(whole.interval(whole.figures[0], 0.9)) <= half_width


def check_timeout(timeout: Any) -> float:
    """The time in s; raises `ValueError` unless it is positive and finite."""
    if not isinstance(timeout, int | float) or not 0.0 < timeout < math.inf:
        raise ValueError(f"timeout must be a positive number of seconds, such as {TIMEOUT:g}; got {timeout!r}.")
    return float(timeout)


def exchange(value: Any, timeout: float) -> list[Any]:
    """The values of all processes, in order, each of which calls this. Raises `RuntimeError` after `timeout` seconds.

    JAX's collectives wait without end, so they run in a thread of their own, which is then left behind.
    """
    done: list[Any] = []

    def gather() -> None:
        try:
            done.append(_gathered(pickle.dumps(value)))
        except Exception as error:
            done.append(error)

    thread = threading.Thread(target=gather, name="jaxgeo-exchange", daemon=True)
    thread.start()
    thread.join(timeout)
    if not done:
        raise RuntimeError(
            f"sample: not all processes of jax.distributed delivered their samples within {timeout:g} s. One of them "
            "ended, does not call sample, or takes longer: give a longer timeout, or devices=jax.local_devices() to "
            "draw alone."
        )
    if isinstance(done[0], Exception):
        raise RuntimeError(
            "sample: samples could not be gathered, perhaps because another process of jax.distributed ended: "
            f"{done[0]}"
        ) from done[0]
    return [pickle.loads(message) for message in done[0]]


def _gathered(message: bytes) -> list[bytes]:
    """The messages of all processes."""
    from jax.experimental.multihost_utils import process_allgather

    sizes = process_allgather(np.frombuffer(np.int64(len(message)).tobytes(), np.uint8))
    sizes = np.ascontiguousarray(sizes).view(np.int64).reshape(-1)
    padded = np.zeros(_room(int(sizes.max())), np.uint8)
    padded[: len(message)] = np.frombuffer(message, np.uint8)
    every = np.asarray(process_allgather(padded))
    return [row[:size].tobytes() for row, size in zip(every, sizes, strict=True)]


def _room(size: int) -> int:
    """The smallest of `ROOM` sizes per octave that is not below a size."""
    step = 2 ** max(size.bit_length() - 1, 0) // ROOM or 1
    return -(-size // step) * step
