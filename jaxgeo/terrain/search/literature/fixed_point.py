"""Fixed-point loop shared by photogrammetric and improved iteration: from one height to the next."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxgeo._record import Record
from jaxgeo._typing import Flag, Index, Scalar, ScalarField
from jaxgeo.terrain.search.literature.descent import DemSample, Descent
from jaxgeo.terrain.search.literature.run import Ending, ending_code
from jaxgeo.terrain.search.literature.studied import Search, ending_where

Step = Callable[[Descent, DemSample], tuple[Scalar, Index]]
"""From a sample at Z to the next height, and the number of evaluations used."""


class _State(Record):
    sample: DemSample
    evaluations: Index
    iterations: Index
    has_left: Flag
    has_been_inside: Flag


def middle_height(descent: Descent, height: ScalarField | None) -> Scalar:
    """Start height in m: the given one, or the middle between lowest and highest post."""
    lowest, highest = descent.dem.known_heights
    return 0.5 * (lowest + highest) if height is None else jnp.asarray(height, jnp.float64)


def iterate(descent: Descent, start: Scalar, step: Step, eps: Scalar, limit: Index) -> Search:
    """Iterate `step` from the height `start` until |D| <= eps (m): converged.

    Diverged: the next height is beyond the ray (before its origin, or below its lowest height), or the search left
    the grid after being over it. Cycled: neither happened within `limit` steps.
    """
    bottom = descent.dem.floor - (descent.dem.ceiling - descent.dem.floor) - 1000.0

    def is_going_on(state: _State) -> Flag:
        return ~state.has_left & (jnp.abs(state.sample.clearance) > eps) & (state.iterations < limit)

    def advance(state: _State) -> _State:
        height, evaluations = step(descent, state.sample)
        is_finite = jnp.isfinite(height) & (height > bottom)
        sample = descent.sample_at(jnp.where(is_finite, height, state.sample.height))
        left = ~is_finite | (sample.distance < 0.0) | (state.has_been_inside & ~sample.is_inside)
        return _State(
            sample,
            state.evaluations + evaluations + 1,
            state.iterations + 1,
            left,
            state.has_been_inside | sample.is_inside,
        )

    sample = descent.sample_at(start)
    none = jnp.asarray(0, jnp.int32)
    first = _State(sample, none + 1, none, jnp.asarray(False), sample.is_inside)
    last = jax.lax.while_loop(is_going_on, advance, first)
    is_met = jnp.abs(last.sample.clearance) <= eps
    ending = ending_where(is_met, Ending.converged, ending_code(Ending.cycled))
    ending = ending_where(last.has_left, Ending.diverged, ending)
    return Search(last.sample, last.evaluations, last.iterations, ending)
