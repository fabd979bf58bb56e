"""Counts of samples on an accelerator: radii per bin and statuses, so that no single sample goes to the host."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgeo.status import Status
from jaxgeo.uncertainty.histogram import BINS, RadiusHistogram, bin_of_bits

STEP = 3  # binary digits between sizes of what goes to the host

if TYPE_CHECKING:
    from jaxgeo.uncertainty.chunks import Drawn, Size


class Counts(NamedTuple):
    """Samples per bin of each figure's radii, group by group, and per status."""

    bins: Int[Array, "figures bins"]
    codes: Int[Array, " statuses"]


class DeviceCounts:
    """Accumulates chunks of samples; the same numbers as `Counter` and `bincount` on the host."""

    def __init__(self, radii: Sequence[int], groups: int, size: Size) -> None:
        """`radii` are the places of the counted figures among the radii of a chunk."""
        self._radii, self._groups, self._size = tuple(radii), groups, size
        self._counts = _none(len(self._radii), groups)

    def add(self, first: int, count: int, share: int, drawn: Drawn) -> None:
        """Count the samples of a chunk from number `first` on, of which each device drew `share`, padded."""
        radii = tuple(drawn.radii[place] for place in self._radii)
        part = tuple(jnp.asarray(number) for number in (first, count, share))
        devices = len(self._size.devices)
        self._counts = _added(self._counts, radii, drawn.statuses, part, devices, self._size.block, self._groups)

    def codes(self) -> np.ndarray:
        """Number of samples by status."""
        return np.asarray(self._counts.codes)

    def histograms(self) -> list[RadiusHistogram]:
        """Histograms so far of the counted figures; only occupied bins go to the host, whose copies take longest."""
        occupied = np.asarray(_occupied(self._counts.bins))
        power = max(int(occupied.max(initial=1)) - 1, 0).bit_length()
        most = min(1 << STEP * -(-power // STEP), self._groups * BINS)  # few sizes, each a program
        found = zip(*jax.device_get(_filled(self._counts.bins, most)), occupied, strict=True)
        return [RadiusHistogram(self._groups, bins[:size], counts[:size]) for bins, counts, size in found]


@functools.partial(jax.jit, static_argnums=(0, 1))
def _none(figures: int, groups: int) -> Counts:
    return Counts(jnp.zeros((figures, groups * BINS), jnp.int64), jnp.zeros(len(Status), jnp.int64))


@jax.jit
def _occupied(bins: Int[Array, "figures bins"]) -> Int[Array, " figures"]:
    return jnp.sum(bins > 0, axis=1)


@functools.partial(jax.jit, static_argnums=1)
def _filled(
    bins: Int[Array, "figures bins"], most: int
) -> tuple[Int[Array, "figures most"], Int[Array, "figures most"]]:
    """(numbers of the occupied bins in order, their counts) of each figure, padded to `most`."""
    numbers = jax.vmap(lambda counts: jnp.nonzero(counts, size=most)[0])(bins)
    return numbers, jnp.take_along_axis(bins, numbers, axis=1)


@functools.partial(jax.jit, static_argnums=(4, 5, 6), donate_argnums=0)
def _added(
    counts: Counts,
    radii: tuple[Float[Array, " samples"], ...],
    statuses: Array,
    part: tuple[Any, Any, Any],
    devices: int,
    block: int,
    groups: int,
) -> Counts:
    first, count, share = part
    size = statuses.shape[0]
    device, within = jnp.divmod(jnp.arange(size), size // devices)
    place = device * share + within - first % block
    is_own = (within < share) & (place >= 0) & (place < count)
    group = (first + place) % groups * BINS
    found = counts.bins
    for number, radius in enumerate(radii):
        bins = bin_of_bits(jax.lax.bitcast_convert_type(radius, jnp.int64), jnp)
        found = found.at[number, jnp.where(is_own, group + bins, groups * BINS)].add(1, mode="drop")
    is_code = statuses[None, :] == jnp.arange(len(Status), dtype=statuses.dtype)[:, None]
    return Counts(found, counts.codes + jnp.sum(is_code & is_own[None, :], axis=1))
