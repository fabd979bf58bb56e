"""Inverse design: cheapest standard deviations of the error sources for a required circular error."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import as_array, as_float64, check_finite
from jaxgeo._record import Record
from jaxgeo._typing import Scalar
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty._budget import Linear, Sigmas, sigma_names, sigma_units, sigmas_of, with_sigmas
from jaxgeo.uncertainty._optimum import Problem, cheapest, closest, equal_scaling, karush_kuhn_tucker
from jaxgeo.uncertainty.linear import Propagation
from jaxgeo.uncertainty.metrics.exact import check_probability
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sampled import Quantile, sample
from jaxgeo.uncertainty.sampling import Sampling, accepts_sampling_options, resolve_sampling

SAMPLES = 100_000  # of a certificate
SAMPLING = Sampling()
CLOSE = 1e-8  # of the target: tolerance for meeting it
AT_BOUND = 1e-7  # of log sigma: distance within which a sigma counts as at its bound
KEPT = 1e-6  # of the cost: tolerance for the Karush-Kuhn-Tucker conditions


class InverseCost(Record):
    """Cost inversely proportional to sigma: `weights` (one, or one for each) times today's sigma / sigma, summed.

    Halving a sigma doubles its cost. A sigma that is zero today costs nothing.
    """

    weights: Any = 1.0

    def __call__(self, sigma: Sigmas, today: Sigmas) -> Scalar:
        weights = jnp.broadcast_to(jnp.asarray(as_array(self.weights, "weights")), today.shape)
        return jnp.sum(weights * jnp.where(sigma > 0.0, today / jnp.where(sigma > 0.0, sigma, 1.0), 0.0))


INVERSE_COST = InverseCost()


class Outcome(enum.Enum):
    """Outcome of a design, as a sentence."""

    optimal = "The target is met, and nothing cheaper meets it."
    slack = "The target is met with every sigma at its highest: looser bounds would be cheaper still."
    infeasible = "The target cannot be met within the bounds: these sigmas come closest to it."
    not_converged = "The optimisation did not converge: these sigmas may not be the cheapest, or miss the target."


class Design(Record):
    """Cheapest standard deviations, and the accuracy of the fix with them.

    `sigmas` in rad, m, px, s, ... under `names`, `model` the error model with them, `cost` their cost. `equal_factor`
    scales all of today's sigmas alike (each within its bounds) to the same target, at `equal_cost`; NaN if it cannot be
    reached. `multiplier` is the cost saved per additional m of target; `kkt_residual` the violation of the
    Karush-Kuhn-Tucker conditions, relative to the cost; `at_lowest` and `at_highest` name the sigmas at their bounds.
    `circular_error` in m is that of linear propagation times `ratio`.
    """

    outcome: Outcome
    names: tuple[str, ...]
    units: tuple[str, ...]
    today: np.ndarray
    sigmas: np.ndarray
    model: ErrorModel
    circular_error: float
    target: float
    probability: float
    ratio: float
    cost: float
    equal_cost: float
    equal_factor: float
    multiplier: float
    kkt_residual: float
    at_lowest: tuple[str, ...]
    at_highest: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and words; the standard deviations and those of `today` in `unit`."""
        rows = zip(self.names, self.units, self.today.tolist(), self.sigmas.tolist(), strict=True)
        figures = "circular_error target probability ratio cost equal_cost equal_factor multiplier kkt_residual".split()
        return {
            "outcome": self.outcome.name,
            "sigmas": [{"name": n, "unit": u, "today": old, "sigma": new} for n, u, old, new in rows],
            **{name: getattr(self, name) for name in figures},
            "at_lowest": list(self.at_lowest),
            "at_highest": list(self.at_highest),
        }

    @accepts_sampling_options
    def certify(
        self,
        sensor: Sensor,
        shot: Shot | Trajectory,
        uv: Any,
        terrain: AbstractTerrain,
        *,
        sampling: Sampling = SAMPLING,
        **options: Any,
    ) -> Certificate:
        """Monte Carlo certificate of the design at its observation, by `sample`, from 100 000 samples by default.

        The design uses linear propagation, the certificate the full model; samples without a fix are infinitely far.
        """
        options |= {"figures": ("CE",), "sampling": resolve_sampling(sampling, SAMPLES)}
        sampled = sample(sensor, shot, uv, terrain, self.model, **options)
        return Certificate(sampled.circular_error(self.probability), self.target, self.circular_error)


class Certificate(NamedTuple):
    """A target in m, the circular error from samples, and that predicted by the design."""

    sampled: Quantile
    target: float
    designed: float

    @property
    def ratio(self) -> float:
        """Sampled circular error divided by the designed one."""
        return self.sampled.value / self.designed

    @property
    def holds(self) -> bool:
        """Whether the target is at least the lower end of the sampled confidence interval."""
        return self.target >= self.sampled.low

    @property
    def is_proven(self) -> bool:
        """Whether the target is at least the upper end of the interval, i.e. met at the requested confidence."""
        return self.target >= self.sampled.high


def design(
    propagation: Propagation,
    *,
    target: float,
    probability: float = 0.9,
    cost: Callable[[Sigmas, Sigmas], Scalar] = INVERSE_COST,
    bounds: Sequence[Any] = (0.01, 100.0),
    ratio: float = 1.0,
) -> Design:
    """Cheapest standard deviations for which the circular error at `probability` is at most `target` m.

    `cost(sigma, today)` is the cost of standard deviations in rad, m, px, s, ..., in the order of the model's, given
    today's; it must use jax.numpy and decrease as sigmas grow. `bounds` are the lowest and highest multiples of today's
    sigmas, each a number or one per sigma. Solved by sequential quadratic programming in log sigma with exact
    derivatives (Kraft 1988, "A software package for sequential quadratic programming"); for correlated errors, which
    may cancel, it finds a local optimum. Valid for linear propagation, times a `ratio` that samples may have shown:
    `certify` the result, or call `certified_design`, which iterates until it holds. Raises `ValueError` for a target
    that is not positive, a negative cost, invalid bounds, or a propagation without a fix.
    """
    linear = Linear.of(propagation, "A design")
    probability_ = check_probability(probability)
    if not (math.isfinite(target) and target > 0.0):
        raise ValueError(f"target must be a positive circular error in m; got {target!r}.")
    if not (math.isfinite(ratio) and ratio > 0.0):
        raise ValueError(f"ratio must be a positive number; got {ratio!r}.")
    today = sigmas_of(linear.model)
    problem = Problem(linear, today, probability_, as_float64(cost, "cost"), *_log_bounds(bounds, today), ratio)
    _check_cost(problem)
    goal = math.log(target)
    equal = equal_scaling(problem, goal)
    if problem.log_error(problem.high)[0] <= goal:
        return _design(problem, problem.high, Outcome.slack, goal, equal)
    start = problem.equal(equal)
    if math.isnan(equal):
        start = closest(problem)
        if problem.log_error(start)[0] > goal:
            return _design(problem, start, Outcome.infeasible, goal, equal)
    return _design(problem, cheapest(problem, start, goal), Outcome.optimal, goal, equal)


@accepts_sampling_options
def certified_design(
    propagation: Propagation,
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: Any,
    terrain: AbstractTerrain,
    *,
    sampling: Sampling = SAMPLING,
    probability: float = 0.9,
    rounds: int = 4,
    **options: Any,
) -> tuple[Design, Certificate]:
    """(design as by `design` with the same options, its certificate), adjusted until samples confirm it.

    If the sampled error exceeds the linear one, as on rough ground, the design is repeated with a reduced target, at
    most `rounds` times. Samples are drawn as `sampling` says (100 000). Raises as `design` and `sample`.
    """
    ratio = 1.0
    for _ in range(max(rounds, 1)):
        result = design(propagation, probability=probability, ratio=ratio, **options)
        certificate = result.certify(sensor, shot, uv, terrain, sampling=sampling)
        if certificate.holds or result.outcome is Outcome.infeasible or not math.isfinite(certificate.ratio):
            break
        ratio *= certificate.ratio
    return result, certificate


def _design(problem: Problem, logs: np.ndarray, outcome: Outcome, goal: float, equal: float) -> Design:
    """The record of a design; verifies optimality if `outcome` claims it."""
    log_error, error_slopes = problem.log_error(logs)
    cost, cost_slopes = problem.price(logs)
    free = problem.low < problem.high
    lowest, highest = free & (logs - problem.low < AT_BOUND), free & (problem.high - logs < AT_BOUND)
    multiplier, residual = math.nan, math.nan
    if outcome is Outcome.optimal:
        multiplier, residual = karush_kuhn_tucker(cost_slopes, error_slopes, lowest, highest, free)
        residual /= cost if cost > 0.0 else 1.0
        if not (residual <= KEPT and log_error - goal <= CLOSE):
            outcome = Outcome.not_converged
    names = sigma_names(problem.linear.model)
    sigma = problem.sigma(logs)
    return Design(
        outcome, names, sigma_units(problem.linear.model), np.asarray(problem.today), np.asarray(sigma),
        with_sigmas(problem.linear.model, sigma), math.exp(log_error), math.exp(goal), float(problem.probability),
        problem.ratio, cost,
        math.nan if math.isnan(equal) else problem.price(problem.equal(equal))[0], math.exp(equal),
        multiplier / math.exp(goal), residual,
        *(tuple(name for name, is_at in zip(names, at, strict=True) if is_at) for at in (lowest, highest)),
    )  # fmt: skip


def _log_bounds(bounds: Any, today: Sigmas) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the bounds, one for each sigma; zero for sigmas that are zero today, which stay zero."""
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise ValueError(f"bounds must be two, the lowest and the highest multiples of today's sigmas; got {bounds!r}.")
    both = []
    for name, bound in zip(("lowest", "highest"), bounds, strict=True):
        given: Any = np.asarray(as_float64(as_array(bound, f"{name} bounds"), f"{name} bounds"))
        if given.shape not in ((), today.shape):
            raise ValueError(f"{name} bounds must be one number or {today.shape[0]}; got the shape {given.shape}.")
        if not np.all((given > 0.0) & (given < np.inf)):
            raise ValueError(f"{name} bounds must be positive multiples of today's sigmas; got {np.min(given):g}.")
        both.append(np.where(np.asarray(today) > 0.0, np.log(np.broadcast_to(given, today.shape)), 0.0))
    low, high = both
    if np.any(low > high):
        worst = int(np.argmax(low - high))
        raise ValueError(
            f"bounds must be in order; for sigma {worst} the lowest is {math.exp(low[worst]):g} times today's, the "
            f"highest {math.exp(high[worst]):g} times."
        )
    return low, high


def _check_cost(problem: Problem) -> None:
    """Raise as `design` for an invalid cost, evaluated at both ends of the bounds."""
    if isinstance(problem.cost, InverseCost):
        weights = np.asarray(as_array(problem.cost.weights, "weights"))
        check_finite(weights, "weights", "units of cost")
        if weights.shape not in ((), problem.today.shape):
            count = problem.today.shape[0]
            raise ValueError(f"weights must be one number or {count}, one a sigma; got the shape {weights.shape}.")
        if np.any(weights < 0.0):
            raise ValueError(f"weights must not be negative, in units of cost; got {np.min(weights):g}.")
    for logs, which in ((problem.low, "lowest"), (problem.high, "highest")):
        value = problem.price(logs)[0]
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f"cost must be a number of at least 0; it is {value:g} with every sigma at its {which}.")
