"""Distribution from quantiles, or from measured residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import as_array, as_float64, check_finite, concrete
from jaxgeo._typing import Numbers, Scalar, ScalarField
from jaxgeo.uncertainty.distributions.base import AbstractDistribution

Knots = Float[Array, " knots"]


class Empirical(AbstractDistribution):
    """Distribution with given `values` at increasing `probabilities` from 0 to 1, (knots,), linear between them.

    The values are in any unit; they are shifted and scaled to zero mean and a standard deviation of one. `mean` and
    `standard_deviation` are those before, in that unit: give the latter as `sigma` of the source, and correct the
    measurements for the former, since an error source has no bias.

    >>> from jaxgeo.uncertainty.distributions import Empirical
    >>> found = Empirical.of_residuals([-0.2, 0.1, 0.0, 0.3, -0.1, 1.9])
    >>> print(f"{found.mean:.3f} {found.standard_deviation:.3f}")
    0.333 0.665
    """

    probabilities: Any
    values: Any

    @classmethod
    def of_residuals(cls, residuals: ArrayLike | Sequence[ArrayLike]) -> Empirical:
        """From measured residuals (n,), at least 2: number i in order has the probability (i - 1/2) / n.

        This is the distribution of JCGM 101:2008, 7.5, closed by the smallest and the largest residual; of few of them
        its standard deviation is smaller than theirs. Raises `ValueError` for fewer, or values that are not finite.
        """
        given: Any = as_float64(as_array(residuals, "residuals"), "residuals")
        check_finite(given, "residuals", "one unit")
        if np.ndim(given) != 1 or np.shape(given)[0] < 2:
            raise ValueError(f"residuals must be a list of 2 or more numbers; got shape {np.shape(given)}.")
        count = given.shape[0]
        ordered = jnp.sort(given)
        middle = (jnp.arange(count) + 0.5) / count
        probabilities = jnp.concatenate([jnp.zeros(1), middle, jnp.ones(1)])
        return cls(probabilities, jnp.concatenate([ordered[:1], ordered, ordered[-1:]]))

    @property
    def words(self) -> str:
        return f"empirical with {np.shape(self.values)[-1]} quantiles"

    @property
    def mean(self) -> Scalar:
        """Mean of the given values."""
        return self._about(jnp.zeros(()))[0]

    @property
    def standard_deviation(self) -> Scalar:
        """Standard deviation of the given values."""
        return jnp.sqrt(self._about(self.mean)[1])

    def standardised(self, normal: Numbers) -> Numbers:
        probabilities, values = self._knots()
        return (jnp.interp(ndtr(normal), probabilities, values) - self.mean) / self.standard_deviation

    @property
    def skewness(self) -> ScalarField:
        return self._about(self.mean)[2] / self.standard_deviation**3

    @property
    def kurtosis(self) -> ScalarField:
        return self._about(self.mean)[3] / self.standard_deviation**4

    def check(self, label: str) -> None:
        if np.ndim(self.values) != 1 or np.shape(self.values) != np.shape(self.probabilities):
            raise ValueError(
                f"{label}: Empirical needs a value for each probability; got shapes {np.shape(self.values)} and "
                f"{np.shape(self.probabilities)}."
            )
        check_finite(self.values, f"{label}: values of Empirical", "one unit")
        check_finite(self.probabilities, f"{label}: probabilities of Empirical", "shares")
        probabilities, values = concrete(self.probabilities), concrete(self.values)
        if probabilities is not None:
            _check_increasing(probabilities, f"{label}: probabilities of Empirical")
            if probabilities[0] != 0.0 or probabilities[-1] != 1.0:
                raise ValueError(
                    f"{label}: probabilities of Empirical must begin with 0 and end with 1, so that the smallest and "
                    f"the largest error are known; got {probabilities[0]:.9g} and {probabilities[-1]:.9g}."
                )
        if values is None:
            return
        falls = np.diff(values) < 0.0
        if np.any(falls):
            place = int(np.argmax(falls))
            raise ValueError(
                f"{label}: values of Empirical must be sorted, as quantiles are; got {values[place]:.9g} before "
                f"{values[place + 1]:.9g}. For residuals in any order use Empirical.of_residuals."
            )
        if values[0] == values[-1]:
            raise ValueError(f"{label}: values of Empirical are all {values[0]:.9g}, which leaves no error.")

    def _knots(self) -> tuple[Knots, Knots]:
        return jnp.asarray(self.probabilities, jnp.float64), jnp.asarray(self.values, jnp.float64)

    def _about(self, centre: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """Moments of orders 1 to 4 about a value; the distribution is uniform between two knots."""
        probabilities, values = self._knots()
        share, a, b = jnp.diff(probabilities), values[:-1] - centre, values[1:] - centre
        first, second = (a + b) / 2.0, (a**2 + a * b + b**2) / 3.0
        third, fourth = (a + b) * (a**2 + b**2) / 4.0, (a**4 + a**3 * b + a**2 * b**2 + a * b**3 + b**4) / 5.0
        one, two, three, four = (jnp.sum(share * moment) for moment in (first, second, third, fourth))
        return one, two, three, four


def _check_increasing(values: np.ndarray, name: str) -> None:
    stays = np.diff(values) <= 0.0
    if values.size < 2 or np.any(stays):
        place = int(np.argmax(stays)) if values.size > 1 else 0
        raise ValueError(f"{name} must increase, and be 2 or more; got {values[place : place + 2].tolist()} in turn.")
