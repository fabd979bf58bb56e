"""Laplace distribution: double exponential tails."""

from __future__ import annotations

import math

import jax.numpy as jnp

from jaxgeo._typing import Numbers, ScalarField
from jaxgeo.uncertainty.distributions.base import AbstractDistribution, both_tails, odd


class Laplace(AbstractDistribution):
    """Laplace (double exponential): more small and more large errors than normal ones, as in elevation models."""

    @property
    def words(self) -> str:
        return "Laplace"

    def standardised(self, normal: Numbers) -> Numbers:
        return odd(lambda size: -math.sqrt(0.5) * jnp.log(both_tails(size)), normal)

    @property
    def kurtosis(self) -> ScalarField:
        return 6.0
