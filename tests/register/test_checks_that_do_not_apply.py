"""A check of a registration that cannot be made, of numbers that are none or ties that are too few, accepts nothing."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxgeo.register import TieErrors
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.passes import Pass
from jaxgeo.register.posterior import Update
from jaxgeo.register.registration import LIMITS, _beyond, _fits, _Given, _judged
from jaxgeo.register.residual_correlation import FEWEST
from jaxgeo.register.ties import TiePoints


def made(kind: type, **fields: Any) -> Any:
    """A record with some of its fields only: those that a check looks at."""
    record = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(record, name, value)
    return record


GIVEN = made(_Given, tie_errors=TieErrors(0.5, 1.0))


def a_pass(**changes: Any) -> Any:
    told = {"matches": SimpleNamespace(outcome=np.zeros(40)), "false_alarms": 1e-9, "agreeing": 30, "offered": 40}
    return made(Pass, **(told | {"rival": 0} | changes))


@pytest.mark.parametrize(
    "alarms, expected",
    [(1e-9, Outcome.registered), (1.0, Outcome.no_agreement), (math.nan, Outcome.no_agreement)],
)
def test_chance_that_is_no_number_is_no_agreement(alarms: float, expected: Outcome) -> None:
    assert _judged(a_pass(false_alarms=alarms), LIMITS, is_first=True) is expected


def test_a_pass_without_any_block_offered_agrees_on_nothing() -> None:
    assert _judged(a_pass(offered=0, agreeing=0), LIMITS, is_first=False) is Outcome.few_agree


def ties(count: int, seed: int = 0) -> tuple[Any, Any]:
    """(ties, an update) whose residuals are noise of their own."""
    rng = np.random.default_rng(seed)
    covariance = np.tile(0.01 * np.eye(2), (count, 1, 1))
    places = made(TiePoints, covariance=covariance, uv=rng.uniform(size=(count, 2)))
    return places, made(Update, normalised=rng.normal(size=(count, 2)))


@pytest.mark.parametrize(
    "count, registration, expected",
    [
        (60, 0.5, True),  # they fit as well as their errors
        (60, 3.0, True),  # worse, but each by itself
        (60, 30.0, False),  # not at all
        (60, math.nan, False),
        (FEWEST - 1, 0.5, True),
        (FEWEST - 1, 3.0, False),  # worse, and so few that nothing tells whether each by itself
    ],
)
def test_ties_fit_only_if_it_can_be_told(count: int, registration: float, expected: bool) -> None:
    places, found = ties(count)
    assert _fits(GIVEN, places, found, TieErrors(registration, 1.0), 1.0, LIMITS) is expected


@pytest.mark.parametrize(
    "chi_square, sigma, expected", [(6.0, 1.0, False), (60.0, 1.0, True), (math.nan, 1.0, True), (0.0, 0.0, False)]
)
def test_a_step_that_is_no_number_is_beyond_the_prior(chi_square: float, sigma: float, expected: bool) -> None:
    prior = SimpleNamespace(covariance=sigma * np.eye(6))
    found = made(Update, prior=prior, chi_square_prior=chi_square)
    assert _beyond(found, LIMITS) is expected
