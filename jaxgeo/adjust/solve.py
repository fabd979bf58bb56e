"""Levenberg-Marquardt iteration on the reduced normal equations, with a log.

A loop of its own: general solvers, those of optimistix too, take the Jacobian as one operator and do not eliminate
points one by one (Schur complement). For 16 images and 22,106 points (BAL) a dense Jacobian takes 89 GB; with points
eliminated, a block of 1300 images is adjusted in 2 s on two cores.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._blas_threads import one_thread
from jaxgeo._compile import sized_filter_jit
from jaxgeo._renamed import renamed_argument, warn_renamed
from jaxgeo._typing import Scalar
from jaxgeo.adjust.arrays import Problem, step_of
from jaxgeo.adjust.banded import factored
from jaxgeo.adjust.equations import Equations, cost_of, linearised
from jaxgeo.adjust.losses import AbstractLoss, LeastSquares
from jaxgeo.adjust.reduction import (
    Eliminated,
    Reduced,
    back_substituted,
    backward,
    eliminated,
    gather,
    reduced,
    scales_of_points,
    solve_reduced,
    undamped,
)
from jaxgeo.adjust.values import Values, moved
from jaxgeo.adjust.weak_datum import Motions, apart, at_holds, motions_apart, moved_together, weakly_held, with_holds

LEAST_DAMPING, MOST_DAMPING = 1e-16, 1e16
WELL_PREDICTED = 0.9  # of the predicted decrease; below it the points are placed anew,
SETTLING = 0.01  # of the cost: where less is predicted; far from the solution that leads astray
LEAST_OF_POINTS = 1e-9  # damping of that, relative to the diagonal


@dataclass(frozen=True)
class Iteration:
    """One iteration: the cost after it, the predicted and actual decrease, the damping, and whether the step was
    accepted."""

    number: int
    cost: float
    predicted_decrease: float
    decrease: float
    damping: float
    accepted: bool

    def __str__(self) -> str:
        how = f"fell by {self.decrease:.4g}" if self.accepted else "step refused"
        return f"iteration {self.number:2d}: cost {self.cost:.6e}, {how} (predicted {self.predicted_decrease:.4g})"

    @property
    def promised(self) -> float:
        """Deprecated: `predicted_decrease`."""
        warn_renamed("Iteration.promised", "Iteration.predicted_decrease")
        return self.predicted_decrease


@dataclass(frozen=True)
class Solver:
    """Convergence limits and initial damping.

    Iteration stops if the predicted decrease of the cost is below `relative` times the cost or below `absolute`: half
    the squared length of the step in standard deviations, so that 1e-8 corresponds to 1.4e-4 standard deviations. The
    default of `relative` is 0 for least squares, and 1e-8 for a robust loss, whose weights converge slowly. `damping`
    is the initial relative increase of the diagonal; `max_iterations` bounds their number.
    """

    relative: float | None = None
    absolute: float = 1e-8
    damping: float = 1e-4
    max_iterations: int = 100

    @property
    def most(self) -> int:
        """Deprecated: `max_iterations`."""
        warn_renamed("Solver.most", "Solver.max_iterations")
        return self.max_iterations


Solver.__init__ = renamed_argument("most", "max_iterations")(Solver.__init__)


class Solution(NamedTuple):
    """Final values with their normal equations, the log, and whether the iterations converged."""

    values: Values
    equations: Equations
    log: tuple[Iteration, ...]
    converged: bool

    def after(self, first: Solution) -> Solution:
        """The solution with the iterations of an earlier one, which it starts from, before its own."""
        more = (replace(one, number=one.number + first.log[-1].number) for one in self.log[1:])
        return self._replace(log=(*first.log, *more))


@one_thread()
def solve(
    problem: Problem,
    loss: AbstractLoss | None = None,
    solver: Solver | None = None,
    callback: Callable[[Iteration], Any] | None = None,
    start: Values | None = None,
) -> Solution:
    """Values of least cost near the problem's start, or near another `start`; `callback` is called with every
    iteration.
    """
    loss, solver = LeastSquares() if loss is None else loss, Solver() if solver is None else solver
    relative = solver.relative
    if relative is None:
        relative = 0.0 if isinstance(loss, LeastSquares) else 1e-8
    values = problem.start if start is None else start
    equations = linearised(problem, values, loss)
    cost = float(equations.cost)
    log = [Iteration(0, cost, 0.0, 0.0, solver.damping, True)]
    weak = weakly_held(problem, values, equations, undamped(problem, equations)[1]) is not None
    damping, growth, converged = solver.damping, 2.0, False
    while len(log) <= solver.max_iterations and not converged and damping < MOST_DAMPING:
        trial, new_cost, predicted = _trial(problem, values, equations, loss, jnp.asarray(damping), weak)
        new_cost, predicted = float(new_cost), float(predicted)
        least = max(relative * cost, solver.absolute)
        if least < predicted <= SETTLING * cost and not cost - new_cost > WELL_PREDICTED * predicted:
            trial, new_cost = _with_points(problem, trial, new_cost, loss)
        decrease = cost - new_cost
        # # The sign of the decrease is random once rounding exceeds the possible gain.
        accepted = predicted > 0.0 and (decrease > 0.0 or (abs(decrease) <= 1e-12 * cost and predicted <= 1e-10 * cost))
        gain = decrease / predicted if predicted > 0.0 else 0.0
        log.append(Iteration(len(log), new_cost if accepted else cost, predicted, decrease, damping, accepted))
        if callback is not None:
            callback(log[-1])
        if accepted:
            converged = predicted <= least or (decrease <= least and gain > 0.5)
            values, cost = trial, new_cost
            equations = linearised(problem, values, loss)
            damping = max(damping * max(1.0 / 9.0, 1.0 - (2.0 * gain - 1.0) ** 3), LEAST_DAMPING)
            growth = 2.0
        else:
            converged = 0.0 <= predicted <= 1e-15 * cost
            damping, growth = damping * growth, growth * 2.0
    return Solution(values, equations, tuple(log), converged)


def _trial(
    problem: Problem, values: Values, equations: Equations, loss: AbstractLoss, damping: Scalar, weak: bool
) -> tuple[Values, Scalar, Scalar]:
    """(values after a damped step, their cost, the predicted decrease)."""
    points = eliminated(problem, equations, damping)
    system = reduced(problem, equations, gather(problem, points), damping)
    if weak:
        motions = motions_apart(problem, values, equations, system.matrix)
        return _stepped_apart(problem, values, equations, (points, system), motions, loss, damping)
    return _stepped(problem, values, equations, (points, system), loss, damping)


def _with_points(problem: Problem, values: Values, cost: float, loss: AbstractLoss) -> tuple[Values, float]:
    """(values with the points moved to where their rays now meet, the cost) if that lowers it, else as given.

    A long strip bends in steps: turned images, with points moved along tangents, misfit by the square of the turn.
    """
    equations = linearised(problem, values, loss)
    points = eliminated(problem, equations, LEAST_OF_POINTS)
    placed, new_cost = _placed(problem, values, points, loss)
    return (placed, float(new_cost)) if float(new_cost) < cost else (values, cost)


@sized_filter_jit
def _placed(problem: Problem, values: Values, points: Eliminated, loss: AbstractLoss) -> tuple[Values, Scalar]:
    step = -backward(points.factor, points.forward) * problem.free_point.T
    placed = eqx.tree_at(lambda x: x.points, values, values.points + step.T)
    return placed, cost_of(problem, placed, loss)


@sized_filter_jit
def _stepped(
    problem: Problem,
    values: Values,
    equations: Equations,
    ready: tuple[Eliminated, Reduced],
    loss: AbstractLoss,
    damping: Scalar,
) -> tuple[Values, Scalar, Scalar]:
    points, system = ready
    images, shared = solve_reduced(problem, factored(system.matrix), -system.images, -system.shared)
    of_points = back_substituted(problem, points, images, shared) * problem.free_point.T
    trial = moved(values, step_of(problem, images, shared, of_points), problem.active)
    return trial, cost_of(problem, trial, loss), predicted_by(problem, equations, images, shared, of_points, damping)


def predicted_by(
    problem: Problem, equations: Equations, images: Any, shared: Any, points: Any, damping: Scalar
) -> Scalar:
    """Predicted decrease by a damped step in the quadratic model: half of (damping * D step - gradient) . step."""
    of_images, of_shared = (jnp.diagonal(x, axis1=-2, axis2=-1) for x in (equations.images, equations.shared))
    of_points = jnp.einsum("ijr,jr->ir", scales_of_points(problem, equations), points)
    pairs = (
        (images, equations.image_gradient, of_images * images),
        (shared, equations.shared_gradient, of_shared * shared),
        (points, equations.point_gradient, of_points),
    )
    return 0.5 * sum((jnp.sum(x * (damping * d - g)) for x, g, d in pairs), start=jnp.zeros(()))


@sized_filter_jit
def _stepped_apart(
    problem: Problem,
    values: Values,
    equations: Equations,
    ready: tuple[Eliminated, Reduced],
    motions: Motions,
    loss: AbstractLoss,
    damping: Scalar,
) -> tuple[Values, Scalar, Scalar]:
    """A step with a weakly constrained datum: y of all unknowns, with the block fixed at some images, and motions t
    of the whole, damped by their own weights and applied as finite motions, which leave pixels unchanged."""
    points, system = ready
    factor = factored(with_holds(problem, system.matrix, motions, False))
    images, shared = solve_reduced(problem, factor, -system.images, -system.shared)
    y = images, shared, back_substituted(problem, points, images, shared) * problem.free_point.T
    found = apart(problem, points, factor, motions, damping)
    scale = 1.0 / jnp.sqrt(motions.own)
    right = -(motions.gradient + sum((_along(k, own) for k, own in zip(motions.K, y, strict=True)), jnp.zeros(7)))
    t = scale * jnp.linalg.solve(found.S * scale[:, None] * scale[None, :], scale * right)
    images, shared, of_points = (own - jnp.tensordot(t, F, 1) for own, F in zip(y, found.F, strict=True))
    trial = moved(values, step_of(problem, images, shared, of_points), problem.active)
    trial = moved_together(problem, trial, motions, t)
    predicted = predicted_by(problem, equations, images, shared, of_points, damping)
    held = jnp.einsum("dkm,km->d", motions.holds, at_holds(problem, images)) * motions.kept
    own = damping * jnp.sum(motions.own * motions.kept * t**2) - motions.gradient @ t
    return trial, cost_of(problem, trial, loss), predicted + 0.5 * (jnp.sum(held**2) + own)


def _along(columns: Float[Array, "7 *some"], change: Float[Array, "*some"]) -> Float[Array, "7"]:
    return columns.reshape(7, -1) @ change.ravel()
