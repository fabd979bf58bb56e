"""Constrained optimisation of a design: minimum cost over log sigmas subject to an error bound."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily
from jaxtyping import Bool, Float

from jaxgeo._record import Record
from jaxgeo._typing import Scalar
from jaxgeo.uncertainty._budget import Linear, Sigmas, error_and_slopes

MOST_STEPS = 500


class Problem(Record):
    """Cost and circular error as functions of the log factors on today's sigmas; zero sigmas stay zero."""

    linear: Linear
    today: Sigmas
    probability: Scalar
    cost: Callable[[Sigmas, Sigmas], Scalar]
    low: Float[np.ndarray, " sigmas"]
    high: Float[np.ndarray, " sigmas"]
    ratio: float

    def sigma(self, logs: np.ndarray) -> Sigmas:
        return self.today * jnp.exp(jnp.asarray(logs))

    def log_error(self, logs: np.ndarray) -> tuple[float, np.ndarray]:
        """Logarithm of the circular error in m, and its gradient."""
        sigma = self.sigma(logs)
        error, slopes = error_and_slopes(self.linear, sigma, self.probability)
        return math.log(max(self.ratio * float(error), 1e-300)), np.asarray(slopes * sigma / error)

    def price(self, logs: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and its gradient."""
        sigma = self.sigma(logs)
        cost, slopes = _cost_and_slopes(self.cost, sigma, self.today)
        return float(cost), np.asarray(slopes * sigma)

    @property
    def box(self) -> list[tuple[float, float]]:
        """Bounds of each sigma."""
        return list(zip(self.low.tolist(), self.high.tolist(), strict=True))

    def equal(self, log_factor: float) -> np.ndarray:
        """One log factor for all sigmas, each clipped to its bounds."""
        return np.clip(np.full(self.low.shape, log_factor), self.low, self.high)


@eqx.filter_jit
def _cost_and_slopes(cost: Callable[[Sigmas, Sigmas], Scalar], sigma: Sigmas, today: Sigmas) -> tuple[Scalar, Sigmas]:
    return jax.value_and_grad(lambda sigma: cost(sigma, today))(sigma)


def equal_scaling(problem: Problem, goal: float) -> float:
    """Logarithm of the common factor on all of today's sigmas that meets the goal; NaN if none does."""
    excess = lambda factor: problem.log_error(problem.equal(factor))[0] - goal  # noqa: E731
    low, high = float(np.min(problem.low)), float(np.max(problem.high))
    if excess(low) > 0.0:
        return math.nan
    if excess(high) <= 0.0:
        return high
    factor: Any = scipy.optimize.brentq(excess, low, high, xtol=1e-13)
    return factor if excess(factor) <= 0.0 else factor - 2e-13


def closest(problem: Problem) -> np.ndarray:
    """Log factors of the smallest error within the bounds; with correlated errors some may be above their lowest."""
    found = scipy.optimize.minimize(problem.log_error, problem.low, jac=True, bounds=problem.box, method="SLSQP")
    best = np.clip(found.x, problem.low, problem.high)
    return best if problem.log_error(best)[0] <= problem.log_error(problem.low)[0] else problem.low


def cheapest(problem: Problem, start: np.ndarray, goal: float) -> np.ndarray:
    """Log factors of minimum cost that meet the goal, from a feasible start; cost is relative to that of the start."""
    scale = problem.price(start)[0] or 1.0

    @functools.lru_cache(maxsize=1)  # value and gradient are evaluated in succession
    def log_error(logs: bytes) -> tuple[float, np.ndarray]:
        return problem.log_error(np.frombuffer(logs))

    met = {
        "type": "ineq",
        "fun": lambda logs: goal - log_error(logs.tobytes())[0],
        "jac": lambda logs: -log_error(logs.tobytes())[1],
    }
    found = scipy.optimize.minimize(
        lambda logs: tuple(part / scale for part in problem.price(logs)),
        start, jac=True, bounds=problem.box, constraints=[met],
        method="SLSQP", options={"ftol": 1e-15, "maxiter": MOST_STEPS},
    )  # fmt: skip
    return np.clip(found.x, problem.low, problem.high)


def karush_kuhn_tucker(
    cost: np.ndarray, error: np.ndarray, lowest: np.ndarray, highest: np.ndarray, free: Bool[np.ndarray, " sigmas"]
) -> tuple[float, float]:
    """(multiplier of the constraint on the log of the error, violation of the Karush-Kuhn-Tucker conditions).

    At an optimum cost + multiplier * error has zero gradient, except for sigmas at a bound, where it points outwards.
    """
    between = free & ~lowest & ~highest
    if np.any(between):
        multiplier = -float(cost[between] @ error[between]) / max(float(error[between] @ error[between]), 1e-300)
    else:
        needed = lowest & (error > 0.0)
        multiplier = float(np.max(-cost[needed] / error[needed], initial=0.0))
    balance = cost + multiplier * error
    broken = np.where(lowest, np.maximum(-balance, 0.0), np.where(highest, np.maximum(balance, 0.0), np.abs(balance)))
    return multiplier, max(float(np.max(broken[free], initial=0.0)), -multiplier)
