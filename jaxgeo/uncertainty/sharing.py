"""Correlation of an error between two measurements: per measurement, image, flight, systematic, or by time."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import jax.numpy as jnp

from jaxgeo._checks import check_range
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField, ScalarLike


class Occasion(NamedTuple):
    """Indices of a measured pixel, its shot and its flight, and the time in s."""

    measurement: ScalarLike
    shot: ScalarLike
    flight: ScalarLike
    time: ScalarLike


class AbstractSharing(Record):
    """Correlation of an error between two measurements."""

    @abstractmethod
    def correlation(self, here: Occasion, there: Occasion) -> Scalar:
        """Correlation of the same error axis at two measurements, between -1 and 1."""


class PerMeasurement(AbstractSharing):
    """Independent for every measured pixel."""

    def correlation(self, here: Occasion, there: Occasion) -> Scalar:
        return _same(here.measurement, there.measurement)


class PerImage(AbstractSharing):
    """Common to all pixels of a shot, independent between shots."""

    def correlation(self, here: Occasion, there: Occasion) -> Scalar:
        return _same(here.flight, there.flight) * _same(here.shot, there.shot)


class PerFlight(AbstractSharing):
    """Common to a whole flight, e.g. calibrations."""

    def correlation(self, here: Occasion, there: Occasion) -> Scalar:
        return _same(here.flight, there.flight)


class Systematic(AbstractSharing):
    """Common to all flights, e.g. the geoid or a DEM bias."""

    def correlation(self, here: Occasion, there: Occasion) -> Scalar:
        del here, there
        return jnp.asarray(1.0)


class TimeCorrelated(AbstractSharing):
    """Correlation that decays with the time between two shots: A [alpha + (1 - alpha) (1 + beta) / (beta + e^(dt/T))].

    The four-parameter function of the Community Sensor Model (NGA.STND.0017): `duration` T in s, `alpha` the asymptotic
    part, `beta` the flatness at dt = 0, `strength` A the largest correlation between different shots. With alpha = beta
    = 0 and A = 1 it is exp(-dt/T), a first-order Gauss-Markov process.

    >>> from jaxgeo.uncertainty import TimeCorrelated
    >>> from jaxgeo.uncertainty.sharing import Occasion
    >>> now, later = (Occasion(measurement=k, shot=k, flight=0, time=10.0 * k) for k in (0, 1))
    >>> print(f"{TimeCorrelated(60.0).correlation(now, later):.4f}")
    0.8465
    """

    duration: ScalarField
    alpha: ScalarField = 0.0
    beta: ScalarField = 0.0
    strength: ScalarField = 1.0

    def correlation(self, here: Occasion, there: Occasion) -> Scalar:
        apart = jnp.abs(jnp.asarray(here.time) - there.time)
        fading = (1.0 + self.beta) / (self.beta + jnp.exp(apart / self.duration))
        between = self.strength * (self.alpha + (1.0 - self.alpha) * fading)
        same_shot = jnp.asarray(here.shot) == there.shot
        return _same(here.flight, there.flight) * jnp.where(same_shot, 1.0, between)

    def check(self) -> None:
        """Raise `ValueError` unless the duration is positive, alpha and A are in [0, 1], and beta is in [0, 10]."""
        check_range(self.duration, "duration of TimeCorrelated", "s (positive)", 1e-12, 1e12)
        check_range(self.alpha, "alpha of TimeCorrelated", "(a share)", 0.0, 1.0)
        check_range(self.strength, "strength of TimeCorrelated", "(a correlation)", 0.0, 1.0)
        check_range(self.beta, "beta of TimeCorrelated", "(a number from 0 to 10)", 0.0, 10.0)


def _same(here: ScalarLike, there: ScalarLike) -> Scalar:
    return jnp.where(jnp.asarray(here) == jnp.asarray(there), 1.0, 0.0)
