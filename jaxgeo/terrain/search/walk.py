"""Walk of one ray along one track: skips intervals proven clear and leaves the others to be settled exactly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from jaxgeo._record import Record
from jaxgeo._typing import Flag, Flags, Index, IndexField, Indices, Numbers, ScalarField, ScalarLike

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem
    from jaxgeo.terrain.track import Quartic, Track

FINEST = 25  # dyadic levels of one track
_LEVELS = 32  # a place is position * 32 + level + 1 in one int32


class Stretch(Record):
    """A track cut into `count` = 2^`finest` intervals of `unit` tau, none longer than a cell.

    `rough` holds row, col and `headroom` in 32 bits with error bounds: skipping uses these, at half the time, settling
    uses the track itself. `lowered` is the headroom over ground with a field, else None.
    """

    track: Track
    finest: IndexField
    unit: ScalarField
    rough: tuple[Rough, Rough, Rough]
    lowered: Quartic | None

    @classmethod
    def of(cls, track: Track, rise: ScalarField | None = None) -> Stretch:
        """Cut up a track over ground that may `rise` this many m above the pyramid's bounds (see `Dem.rise`)."""
        cells = jnp.ceil(jnp.clip(2.0 * track.speed(), 1.0, 2.0**FINEST)).astype(jnp.int32)
        finest = 32 - jax.lax.clz(cells - 1)
        unit = 2.0 / jnp.left_shift(jnp.ones_like(finest), finest)
        lowered = None if rise is None else track.height.lowered(rise)
        headroom = track.height if lowered is None else lowered
        return cls(track, finest, unit, (Rough.of(track.row), Rough.of(track.col), Rough.of(headroom)), lowered)

    @property
    def headroom(self) -> Quartic:
        """The track's height minus the largest field value, to compare with the pyramid's bounds."""
        return self.track.height if self.lowered is None else self.lowered

    @property
    def count(self) -> Indices:
        """Number of intervals of the finest level."""
        return jnp.left_shift(jnp.ones_like(self.finest), self.finest)

    def tau(self, position: Indices) -> Numbers:
        """Start of the finest interval `position`."""
        return self.unit * position - 1.0


class Rough(Record):
    """A quartic in 32 bits: within `error` of it for tau in [-1, 1]; `sag` bounds its bending as `Quartic.sag` does."""

    quartic: Quartic
    sag: ScalarField
    error: ScalarField

    @classmethod
    def of(cls, quartic: Quartic) -> Rough:
        """Round to 32 bits.

        Error bound: five products and sums, the coefficients and tau, each rounded to 2^-24, are off by less than 2^-20
        of the sum of the coefficients' magnitudes and of the largest slope.
        """
        size = sum(abs(coefficient) for coefficient in jax.tree.leaves(quartic))
        error = 2.0**-20 * (size + quartic.speed())
        return jax.tree.map(lambda x: x.astype(jnp.float32), cls(quartic, 1.001 * quartic.sag(), 1.001 * error))

    def box(self, begin: ScalarLike, end: ScalarLike, spread: ScalarLike) -> tuple[ScalarLike, ScalarLike]:
        """Lower and upper bound between two taus, in 32 bits, widened by `spread`."""
        first, last, width = self.quartic.at(begin), self.quartic.at(end), end - begin
        bend = self.sag * width * width + self.error + spread
        return jnp.minimum(first, last) - bend, jnp.maximum(first, last) + bend


# A place on a stretch is one int32, so that one fused kernel advances a whole batch of rays: the interval
# [position, position + 2^level) to test next or, with level -1, the finest one there, to be settled.


def place(position: Indices, level: Indices) -> Indices:
    """The place of an interval."""
    return position * _LEVELS + level + 1


def position_of(here: Indices) -> Indices:
    """Start of the interval, in finest intervals."""
    return jnp.right_shift(here, 5)


def must_settle(here: Indices) -> Flags:
    """Whether the walk waits at a finest interval that cannot be skipped."""
    return (here & (_LEVELS - 1)) == 0


def is_passing(here: Indices, stretch: Stretch) -> Flags:
    """Whether the walk may go on: it is not at the track's end, nor at an interval to settle."""
    return ~must_settle(here) & (position_of(here) < stretch.count)


def first_place(stretch: Stretch) -> Index:
    """A quarter of the track; the whole is never clear, because it starts just below the ceiling."""
    return place(jnp.zeros_like(stretch.finest), jnp.maximum(stretch.finest - 2, 0))


def place_at(stretch: Stretch, tau: ScalarLike, longest: int) -> Index:
    """Place to continue at from `tau`: with intervals of up to 2^`longest` finest ones or, with -1, to settle one.

    Not before the first place.
    """
    position = jnp.floor((tau + 1.0) / stretch.unit).astype(jnp.int32)
    level = jnp.clip(31 - jax.lax.clz(position & -position), min(0, longest), longest)
    return jnp.where(position > 0, place(position, level), first_place(stretch))


def clear_ahead(stretch: Stretch, dem: Dem, spread: tuple[ScalarLike, ScalarLike, ScalarLike]) -> ScalarLike:
    """The tau up to which all tracks over the grid within `spread` of this one are clear."""
    over = jnp.asarray(True)
    move = lambda here: advance(here, stretch, dem, over, spread)  # noqa: E731
    here = jax.lax.while_loop(lambda here: is_passing(here, stretch), move, first_place(stretch))
    return stretch.tau(position_of(here))


def advance(
    here: Index, stretch: Stretch, dem: Dem, entered: Flag, spread: tuple[ScalarLike, ScalarLike, ScalarLike]
) -> Index:
    """The next place: the following interval, twice as long where aligned, or the first half of this one.

    `spread` in cells, cells and m widens the track on all sides (zero for one ray).
    """
    level = jnp.maximum((here & (_LEVELS - 1)) - 1, 0)
    position = position_of(here)
    end = position + jnp.left_shift(jnp.ones_like(level), level)
    clear = _is_clear(stretch, dem, position, end, level, entered, spread)
    is_aligned = (jnp.right_shift(end, level) & 1) == 0
    after = place(end, level + (is_aligned & (level < stretch.finest)))
    return jnp.where(is_passing(here, stretch), jnp.where(clear, after, here - 1), here)


def _is_clear(
    stretch: Stretch,
    dem: Dem,
    position: Index,
    end: Index,
    level: Index,
    entered: Flag,
    spread: tuple[ScalarLike, ScalarLike, ScalarLike],
) -> Flag:
    """Whether the interval surely holds no event: above all ground it can touch, or (before entry) beside the grid.

    A position is within the grid only if the whole box is, so its (row, col) can be truncated to integers. Computed in
    32 bits, with boxes widened by more than the rounding error.
    """
    unit = stretch.unit.astype(jnp.float32)
    begin, stop = unit * position.astype(jnp.float32) - 1.0, unit * end.astype(jnp.float32) - 1.0
    boxes = [rough.box(begin, stop, more) for rough, more in zip(stretch.rough, spread, strict=True)]
    (low_row, high_row), (low_col, high_col), (low_height, _) = boxes
    last_row, last_col = ((size - 1).astype(jnp.float32) for size in jnp.asarray(dem.extent))
    is_inside = (low_row >= 0.0) & (low_col >= 0.0) & (high_row <= last_row) & (high_col <= last_col)
    is_beside = (high_row < 0.0) | (high_col < 0.0) | (low_row > last_row) | (low_col > last_col)
    row, col = (jnp.right_shift(x.astype(jnp.int32), level) for x in (low_row, low_col))
    far_row, far_col = (jnp.right_shift(x.astype(jnp.int32), level) for x in (high_row, high_col))
    fits = (far_row <= row + 1) & (far_col <= col + 1)
    is_above = is_inside & fits & (low_height > dem.pyramid.bound(level, row, col))
    return jnp.where(entered, is_above, is_beside)
