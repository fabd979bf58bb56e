"""Counts of samples on an accelerator: laws on synthetic chunks, against the counts on the host."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import _accelerator
from jaxgeo._accelerator import by_device, on_accelerator
from jaxgeo.status import Status
from jaxgeo.uncertainty.chunks import Drawn, Size, blocks_per_device
from jaxgeo.uncertainty.device_counts import DeviceCounts
from jaxgeo.uncertainty.histogram import Counter

BLOCK, CAPACITY, DEVICES = 64, 192, 2


class Device:
    """A stand-in for a device of some platform."""

    def __init__(self, platform: str) -> None:
        self.platform = platform


def drawn(seed: int) -> Drawn:
    """A chunk of two devices with radii of all magnitudes, zero and infinite ones, and statuses."""
    rng = np.random.default_rng(seed)
    size = DEVICES * CAPACITY
    radii = 10.0 ** rng.uniform(-7.0, 9.5, (3, size))
    radii[:, ::17], radii[:, 5::19] = np.inf, 0.0
    statuses = rng.integers(0, len(Status), size).astype(np.int8)
    return Drawn(jnp.zeros((DEVICES, 4, 4)), tuple(jnp.asarray(x) for x in radii), jnp.asarray(statuses), None)


@pytest.mark.costly
@pytest.mark.parametrize("groups", [1, 16])
def test_counts_of_parts_are_those_of_the_host(groups: int) -> None:
    size: Any = Size(CAPACITY, (None,) * DEVICES, True, BLOCK)
    counts = DeviceCounts((0, 2), groups, size)
    counters, codes = [Counter(groups), Counter(groups)], np.zeros(len(Status), int)
    for seed, (first, count) in enumerate([(0, 300), (300, 84), (1000, 16), (70, 250)]):
        part = drawn(seed)
        counts.add(first, count, BLOCK * blocks_per_device(first, count, size), part)
        own = part.of_samples(first, count, size)
        assert own.statuses.size == count
        codes += np.bincount(own.statuses, minlength=len(Status))
        for counter, number in zip(counters, (0, 2), strict=True):
            counter.add(np.asarray(own.radii[number]), first)
    np.testing.assert_array_equal(counts.codes(), codes)
    for found, counter in zip(counts.histograms(), counters, strict=True):
        expected = counter.histogram()
        np.testing.assert_array_equal(found.bins, expected.bins)
        np.testing.assert_array_equal(found.counts, expected.counts)
        assert found.interval(0.9, 0.95) == expected.interval(0.9, 0.95)


@pytest.mark.parametrize("first, count", [(0, 1), (0, 192), (70, 20), (130, 62)])
def test_what_goes_to_the_host_of_a_large_block_are_its_samples(first: int, count: int) -> None:
    whole = drawn(3)
    one = Drawn(whole.moments[:1], *jax.tree.map(lambda x: x[:CAPACITY], tuple(whole)[1:]))
    ways = [one.of_samples(first, count, Size(CAPACITY, (Device(name),), True, BLOCK)) for name in ("cpu", "gpu")]
    for of_cpu, of_gpu in zip(*map(jax.tree.leaves, ways), strict=True):
        np.testing.assert_array_equal(of_gpu, of_cpu)
    start = first % BLOCK
    np.testing.assert_array_equal(ways[1].statuses, one.statuses[start : start + count])


def test_sizes_follow_the_device_of_the_program(monkeypatch) -> None:
    with jax.default_device(jax.devices("cpu")[0]):
        assert not on_accelerator()
    assert by_device(1, 2, [Device("gpu")]) == 2
    assert by_device(1, 2, [Device("cpu")]) == 1
    monkeypatch.setattr(_accelerator.jax, "default_backend", lambda: "gpu")
    assert by_device(1, 2) == 2
    with jax.default_device(jax.devices()[0]):  # a CPU
        assert by_device(1, 2) == 1
    with jax.default_device("cpu"):
        assert by_device(1, 2) == 1
