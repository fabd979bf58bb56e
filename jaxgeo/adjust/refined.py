"""Refraction of the rays of a block at adjusted orientations and points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from jaxgeo.adjust.losses import AbstractLoss
from jaxgeo.adjust.problem import Prepared
from jaxgeo.adjust.solve import Iteration, Solution, Solver, solve
from jaxgeo.adjust.values import Values


def bent_at(ready: Prepared, values: Values) -> Prepared:
    """The arrays with the bending of rays at the given values; as they are without refraction."""
    problem = ready.problem
    if problem.effects is None or problem.effects.bending is None:
        return ready
    return ready._replace(problem=replace(problem, effects=problem.effects.bent(problem.layout, values)))


def refined(
    ready: Prepared,
    solution: Solution,
    loss: AbstractLoss,
    solver: Solver | None,
    callback: Callable[[Iteration], Any] | None,
) -> tuple[Prepared, Solution]:
    """(arrays, solution) with the bending of rays at the solution, from which the iterations continue."""
    again = bent_at(ready, solution.values)
    if again is ready or not solution.converged:
        return ready, solution
    return again, solve(again.problem, loss, solver, callback, solution.values).after(solution)
