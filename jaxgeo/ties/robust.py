"""Loss of image points in the adjustment of tie points."""

from __future__ import annotations

import jax.numpy as jnp

from jaxgeo._typing import Numbers, Scalar
from jaxgeo.adjust import AbstractLoss

WIDTH, WIDEST = 3.0, 1e6  # standard deviations: of the robust loss, and of one that is least squares


class ScaledCauchy(AbstractLoss):
    """Cauchy's loss with its width as an array: least squares, by a large width, is then the same program."""

    width: Scalar

    def rho(self, squared: Numbers) -> Numbers:
        return self.width**2 * jnp.log1p(squared / self.width**2)

    def weight(self, squared: Numbers) -> Numbers:
        return 1.0 / (1.0 + squared / self.width**2)
