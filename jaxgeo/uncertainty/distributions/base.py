"""Base class of distributions: a map from a standard normal number to an error in standard deviations."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax.scipy.special import erfc, ndtri
from jax.typing import ArrayLike

from jaxgeo._checks import as_array, as_float64, check_range
from jaxgeo._record import Record
from jaxgeo._typing import Numbers, ScalarField


class AbstractDistribution(Record):
    """Distribution of the error of one axis, in units of the source's `sigma`: zero mean, standard deviation one.

    It is given by its quantile function at the probability of a standard normal number, so that correlated normal
    numbers become correlated errors with these distributions (a Gaussian copula).
    """

    @property
    @abc.abstractmethod
    def words(self) -> str:
        """Name with parameters, for messages."""

    @abc.abstractmethod
    def standardised(self, normal: Numbers) -> Numbers:
        """Value at the probability of standard normal numbers, elementwise: F^-1(Phi(z)); increases with z."""

    @property
    def skewness(self) -> ScalarField:
        """Third standardised moment; that of a symmetric distribution is zero."""
        return 0.0

    @property
    @abc.abstractmethod
    def kurtosis(self) -> ScalarField:
        """Fourth standardised moment, 3 for a normal distribution; infinite if it does not exist."""

    @property
    def finite_orders(self) -> float:
        """Moments of orders below this one are finite."""
        return math.inf

    def check(self, label: str) -> None:
        """Raise `ValueError` for invalid parameters; `label` is the source, for the message."""
        del label

    def prepared(self) -> AbstractDistribution:
        """The same for many draws, perhaps as a table; it need not be differentiable in the parameters."""
        return self

    def quantile(self, probability: ArrayLike | Sequence[ArrayLike]) -> Numbers:
        """Value in standard deviations at probabilities from 0 to 1, elementwise.

        Raises `ValueError` for probabilities outside [0, 1].
        """
        given: Any = as_float64(as_array(probability, "probability"), "probability")
        check_range(given, "probability", "(a share)", 0.0, 1.0)
        return self.standardised(ndtri(given))


def odd(of_size: Any, normal: Numbers) -> Numbers:
    """An odd function from its values for sizes of 0 and more; its derivative at zero is that from above."""
    below = normal < 0.0
    value = of_size(jnp.where(below, -normal, normal))
    return jnp.where(below, -value, value)


def both_tails(size: Numbers) -> Numbers:
    """Probability that a standard normal number is larger than `size` in absolute value, exact to the last digits."""
    return erfc(size * math.sqrt(0.5))
