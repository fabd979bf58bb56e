"""Photogrammetric iteration (Sheng 2004).

Y. Sheng, "Comparative evaluation of iterative and non-iterative methods to ground coordinate determination from single
aerial images", Computers & Geosciences 30(3), 2004, as described by Li et al. (2023), section 3:

    Z = Z0
    repeat: Z = h(Z)
    until |Z - h(Z)| <= eps

On a plane the error is multiplied by -k per step, k = tan(slope along the line of sight) / tan(depression): the
iteration cycles for k = 1 and diverges for |k| > 1.
"""

from __future__ import annotations

import jax.numpy as jnp

from jaxgeo._typing import Index, Scalar, ScalarField
from jaxgeo.terrain.search.literature.descent import DemSample, Descent
from jaxgeo.terrain.search.literature.fixed_point import iterate, middle_height
from jaxgeo.terrain.search.literature.studied import EPS, AbstractStudiedSearch, Search


class Photogrammetric(AbstractStudiedSearch):
    """Uses the ground height under the last point as the next height.

    `eps` in m ends it; `start` is the initial height in m (the middle between lowest and highest post if None). `limit`
    is the maximum number of steps: with |k| = 0.9 a start 500 m off takes 75, so 100 stops hardly any ray that would
    still converge.
    """

    eps: ScalarField = EPS
    start: ScalarField | None = None
    limit: ScalarField = 100

    def search(self, descent: Descent) -> Search:
        start = middle_height(descent, self.start)
        return iterate(descent, start, _to_ground, jnp.asarray(self.eps), jnp.asarray(self.limit))


def _to_ground(descent: Descent, sample: DemSample) -> tuple[Scalar, Index]:
    return sample.ground, jnp.asarray(0, jnp.int32)
