"""Robust loss functions of squared standardised residuals."""

from __future__ import annotations

import abc

import jax.numpy as jnp

from jaxgeo._record import Record
from jaxgeo._typing import Numbers


class AbstractLoss(Record):
    """rho(s) with rho'(0) = 1, and its derivative, the weight of a residual. The cost is half its sum."""

    @abc.abstractmethod
    def rho(self, squared: Numbers) -> Numbers:
        """Twice the cost of a residual of squared length `squared`."""

    @abc.abstractmethod
    def weight(self, squared: Numbers) -> Numbers:
        """Derivative of `rho`, in [0, 1]."""


class LeastSquares(AbstractLoss):
    """Plain least squares, weight 1: rho = s."""

    def rho(self, squared: Numbers) -> Numbers:
        return squared

    def weight(self, squared: Numbers) -> Numbers:
        return jnp.ones_like(squared)


class Huber(AbstractLoss):
    """Weight 1 up to `width` standard deviations, then inverse to the distance: rho = 2 w sqrt(s) - w2.

    Huber (1964).
    """

    width: float = 2.5

    def rho(self, squared: Numbers) -> Numbers:
        within = squared <= self.width**2
        length = jnp.sqrt(jnp.where(within, self.width**2, squared))
        return jnp.where(within, squared, 2.0 * self.width * length - self.width**2)

    def weight(self, squared: Numbers) -> Numbers:
        return self.width / jnp.sqrt(jnp.maximum(squared, self.width**2))


class Cauchy(AbstractLoss):
    """Weight 1 / (1 + s / w2): rho = w2 log(1 + s / w2)."""

    width: float = 3.0

    def rho(self, squared: Numbers) -> Numbers:
        return self.width**2 * jnp.log1p(squared / self.width**2)

    def weight(self, squared: Numbers) -> Numbers:
        return 1.0 / (1.0 + squared / self.width**2)


class Tukey(AbstractLoss):
    """Weight (1 - s / w2)2 within `width` standard deviations, zero beyond. Beaton and Tukey (1974)."""

    width: float = 6.0

    def rho(self, squared: Numbers) -> Numbers:
        left = jnp.maximum(1.0 - squared / self.width**2, 0.0)
        return self.width**2 / 3.0 * (1.0 - left**3)

    def weight(self, squared: Numbers) -> Numbers:
        return jnp.maximum(1.0 - squared / self.width**2, 0.0) ** 2
