"""Accuracy of a fix held against samples: the share of them within its radius, and those on other ground."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import check_is
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import Record
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty._accuracy import SAMPLES, accuracy
from jaxgeo.uncertainty._figures import figure
from jaxgeo.uncertainty.accuracy_record import Accuracy
from jaxgeo.uncertainty.intervals import Share
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sampled import sample
from jaxgeo.uncertainty.sampled_record import Sampled
from jaxgeo.uncertainty.sampling import Sampling, resolve_sampling

SAMPLING = Sampling()


class AccuracyCheck(Record):
    """Accuracy of one fix, and samples that were drawn to check it; print it for the answer.

    `accuracy` is the answer, and `sampled` are kept samples of the same errors. Raises `TypeError` for other records,
    and `ValueError` for an accuracy of many fixes, or without its details, and for samples that were not kept.
    """

    accuracy: Accuracy
    sampled: Sampled

    def __check_init__(self) -> None:
        check_is(self.accuracy, Accuracy, "accuracy", "Make it with jaxgeo.accuracy.")
        check_is(self.sampled, Sampled, "sampled", "Make it with jaxgeo.sample.")
        if self.accuracy.propagation is None or self.accuracy.profile is None:
            raise ValueError("accuracy must be that of one fix, from jaxgeo.accuracy outside of jit and vmap.")
        if self.sampled.errors_enu is None:
            raise ValueError("the samples were not kept: sample again with keep=True.")

    @property
    def within(self) -> Share:
        """Share of the samples within the circular error, and its confidence interval."""
        return self.sampled.share_within("CE", float(self.accuracy.circular))

    @property
    def beyond_gap(self) -> np.ndarray:
        """Mask (count,) of the samples on other ground than the fix, beyond a gap of hidden ground."""
        linear, profile, errors = self.accuracy.propagation, self.accuracy.profile, self.sampled.errors_enu
        assert linear is not None
        assert profile is not None
        assert errors is not None
        return profile.beyond_gap(errors + self.sampled.centre_enu, linear.nominal.direction_enu)

    @property
    def jumped(self) -> float:
        """Share of the samples beyond a gap of hidden ground."""
        return float(np.mean(self.beyond_gap))

    @property
    def words(self) -> str:
        """What the samples say of the circular error, in one or two sentences."""
        share, low, high = (100.0 * one for one in self.within)
        name, count = f"CE{100.0 * self.accuracy.level():g}", f"{self.sampled.count:,}".replace(",", " ")
        own = ", which is of these samples" if self._is_of_these_samples else ""
        said = f"{share:.1f} % of {count} samples lie within this {name} ({low:.1f} to {high:.1f} %){own}."
        jumped, failed = 100.0 * self.jumped, 100.0 * self.sampled.failed
        if jumped > 0.0 or failed > 0.0:
            said += f" {figure(jumped, 2)} % of them hit a nearer or farther slope, {figure(failed, 2)} % have no fix."
        return said

    @property
    def _is_of_these_samples(self) -> bool:
        """Whether the circular error is the quantile of the samples themselves, which say nothing else of it then."""
        drawn, radii = self.accuracy.sampled, self.sampled.radii["CE"]
        return drawn is not None and np.array_equal(drawn.radii.get("CE", ()), radii)

    def __str__(self) -> str:
        return f"{self.accuracy} {self.words}"


@accepts_observation
def check_accuracy(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    probability: ArrayLike = 0.9,
    sampling: Sampling = SAMPLING,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
) -> AccuracyCheck:
    """The `accuracy` of one fix, and samples of it that are drawn whatever its method: 20 000, or as `sampling` says.

    Where the accuracy is itself by samples, they are those of another key. Raises as `accuracy` and `sample`. `compare`
    shows every method of propagation beside samples.
    """
    options: dict[str, Any] = {"time": time, "search": search, "atmosphere": atmosphere}
    drawn = resolve_sampling(sampling, SAMPLES)
    found = accuracy(sensor, shot, uv, terrain, errors, probability=probability, sampling=drawn, **options)
    if found.sampled is not None:  # later points of the same Sobol scrambles would fill the gaps of the first ones
        drawn = dataclasses.replace(drawn, key=jax.random.fold_in(drawn.random_key, 1))
    others = sample(sensor, shot, uv, terrain, errors, sampling=drawn, keep=True, **options)
    return AccuracyCheck(found, others)
