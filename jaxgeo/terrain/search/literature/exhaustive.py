"""Exhaustive search over height (Qiao 2019).

C. Qiao, "Research on ground target geo-location technology based on digital elevation model for high-altitude
long-range aerial camera", Changchun, 2019, named in Li et al. (2023), section 3, which only states that all heights
near the target are tried. Two interpretations, with different results:

    first:   for Z = Zmax, Zmax - step, ... Zmin: if Z - h(Z) <= eps return Z
    nearest: return the Z of all Zmax, Zmax - step, ... Zmin with the least |Z - h(Z)|
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxgeo._numerics import tree_where
from jaxgeo._typing import Flag, Index, Scalar, ScalarField
from jaxgeo.terrain.search.literature.descent import DemSample, Descent
from jaxgeo.terrain.search.literature.run import Ending, ending_code
from jaxgeo.terrain.search.literature.studied import EPS, AbstractStudiedSearch, Search, ending_where
from jaxgeo.terrain.search.literature.window import AbstractWindow, WholeTerrain


class ExhaustiveFirst(AbstractStudiedSearch):
    """Steps down and returns the first height with D <= eps.

    `step` in m is the height between tries, `eps` in m the tolerance, both 0.2 m as in the experiments of Li et al.
    (2023); `window` gives the heights to search: the whole terrain, so that no ground in the way is left out.
    Ridges between two tries are missed, and the point may be below the ground by the change of D in one step.
    """

    eps: ScalarField = EPS
    step: ScalarField = EPS
    window: AbstractWindow = WholeTerrain()

    def search(self, descent: Descent) -> Search:
        lowest, highest = self.window.heights(descent)
        eps, step = jnp.asarray(self.eps), jnp.asarray(self.step)
        count = tries(lowest, highest, step)

        def is_going_on(state: tuple[DemSample, Index]) -> Flag:
            sample, tried = state
            return (sample.clearance > eps) & (tried < count)

        def advance(state: tuple[DemSample, Index]) -> tuple[DemSample, Index]:
            _, tried = state
            return descent.sample_at(highest - step * tried), tried + 1

        sample, tried = jax.lax.while_loop(
            is_going_on, advance, (descent.sample_at(highest), jnp.asarray(1, jnp.int32))
        )
        ending = ending_where(sample.clearance <= eps, Ending.converged, ending_code(Ending.failed))
        return Search(sample, tried, tried, ending)


class ExhaustiveNearest(AbstractStudiedSearch):
    """Tries every height and returns the one with the least |D|, anywhere on the ray.

    `step` in m is the height between tries: 0.2 m, the tolerance of Li et al. (2023). It has no tolerance of its own:
    of all crossings it returns the one that a try happens to be nearest to. It fails if no try is within `farthest` m,
    which happens only without a crossing in the window.
    """

    step: ScalarField = EPS
    farthest: ScalarField = 10.0
    window: AbstractWindow = WholeTerrain()

    def search(self, descent: Descent) -> Search:
        lowest, highest = self.window.heights(descent)
        step = jnp.asarray(self.step)
        count = tries(lowest, highest, step)
        best = nearest_of(descent, highest, step, count)
        is_met = jnp.abs(best.clearance) <= jnp.asarray(self.farthest)
        return Search(best, count, count, ending_where(is_met, Ending.converged, ending_code(Ending.failed)))


def tries(lowest: Scalar, highest: Scalar, step: Scalar) -> Index:
    """Number of heights from the highest down to the lowest; the last one is at or below the lowest."""
    return jnp.ceil((highest - lowest) / step).astype(jnp.int32) + 1


def nearest_of(descent: Descent, highest: Scalar, step: Scalar, count: Index) -> DemSample:
    """Of `count` heights from `highest` down, the sample with the least |D|; the highest among equals."""

    def try_next(k: Index, best: DemSample) -> DemSample:
        sample = descent.sample_at(highest - step * k)
        return tree_where(jnp.abs(sample.clearance) < jnp.abs(best.clearance), sample, best)

    return jax.lax.fori_loop(1, count, try_next, descent.sample_at(highest))
