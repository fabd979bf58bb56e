"""Fast elevation iteration (Li et al. 2023).

Z. Li, H. Kuang, H. Zhang, C. Zhuang, "A target location method for aerial images through fast iteration of elevation
based on DEM", Chinese Optics 16(4), 2023, section 4.2 and figure 11, literally:

    (1) estimate the target's place with the ellipsoid model, take the heights of that area
    (2) Zhi = the highest of them; Zlo = h(Zhi)
    (3) m = (Zhi + Zlo) / 2; D = m - h(m)
        if D > eps: Zhi = m, Zlo = h(m), go to (3)
    (4) if D < 0: Zlo = m, go to (3)
        return m

The paper calls it a bisection, but [Zlo, Zhi] is not a bracket: from a point above the ground it goes half way down to
the height of the ground below it, a damped photogrammetric iteration. On a plane the error shrinks by (1 - k) / 2 per
step, k = tan(slope along the line of sight) / tan(depression).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxgeo._record import Record
from jaxgeo._typing import Flag, Index, Scalar, ScalarField
from jaxgeo.terrain.search.literature.descent import DemSample, Descent
from jaxgeo.terrain.search.literature.run import Ending, ending_code
from jaxgeo.terrain.search.literature.studied import EPS, AbstractStudiedSearch, Search, ending_where
from jaxgeo.terrain.search.literature.window import AbstractWindow, TargetArea

STUCK = 1e-9  # m between the middle and the upper end: resolution of heights


class FastIteration(AbstractStudiedSearch):
    """The fast iteration of Li et al. (2023), without corrections.

    `eps` in m is the printed 0.2 m of the experiments (section 5.2; the text's tenth of the DEM's accuracy is 2 m).
    `window` gives Zmax: that of the target's area as printed, or `WholeTerrain()`, which includes every near peak.
    `limit` is the maximum number of steps: a plane 1 % short of grazing takes 900 from 200 m above. A search that
    starts below the ground and stays there, or reaches the limit, failed.
    """

    eps: ScalarField = EPS
    window: AbstractWindow = TargetArea()
    limit: ScalarField = 1000

    def search(self, descent: Descent) -> Search:
        eps, limit = jnp.asarray(self.eps), jnp.asarray(self.limit)
        _, highest = self.window.heights(descent)
        top = descent.sample_at(highest)

        def is_going_on(state: _State) -> Flag:
            is_met = (state.sample.clearance >= 0.0) & (state.sample.clearance <= eps) & (state.iterations > 0)
            is_stuck = (state.sample.clearance < 0.0) & (jnp.abs(state.high - state.low) < STUCK)
            return ~is_met & ~is_stuck & (state.iterations < limit)

        def halve(state: _State) -> _State:
            sample = descent.sample_at(0.5 * (state.high + state.low))
            is_above = sample.clearance > eps
            high = jnp.where(is_above, sample.height, state.high)
            low = jnp.where(is_above, sample.ground, sample.height)
            return _State(sample, high, low, state.iterations + 1)

        first = _State(top, highest, top.ground, jnp.asarray(0, jnp.int32))
        last = jax.lax.while_loop(is_going_on, halve, first)
        is_met = (last.sample.clearance >= 0.0) & (last.sample.clearance <= eps) & (last.iterations > 0)
        ending = ending_where(is_met, Ending.converged, ending_code(Ending.failed))
        return Search(last.sample, last.iterations + 1, last.iterations, ending)


class _State(Record):
    """The last sample, the two heights to be averaged next, m, and the number of steps."""

    sample: DemSample
    high: Scalar
    low: Scalar
    iterations: Index
