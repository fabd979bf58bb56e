"""Outcome of one ray's walk, from which its bracket is made."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxgeo._record import Record
from jaxgeo._typing import FlagField, IndexField, ScalarField

if TYPE_CHECKING:
    from jaxgeo.terrain.search.walker import Walker


class Found(Record):
    """Outcome of a walk: its `news` (see `march.news_of`), number of `tracks`, and the place of its event.

    Ranges in m: the ray is above the surface of the `cell` at `begin`, meets it at `near`, and is below it at `below`;
    undefined without an event. `is_above` states whether the end of the last track is above all ground.
    """

    begin: ScalarField
    near: ScalarField
    below: ScalarField
    cell: Int[Array, "... 2"]
    news: IndexField
    tracks: IndexField
    is_above: FlagField

    @classmethod
    def nothing(cls, walker: Walker) -> Found:
        """That of a ray before its first track."""
        zero = walker.passed - walker.passed
        none = walker.tracks - walker.tracks
        return cls(zero, zero, zero, jnp.stack([none, none]), walker.news, walker.tracks, none > 0)
