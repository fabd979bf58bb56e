"""Nonlinear least squares by a solver of optimistix that the caller passes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float

from jaxgeo._typing import Flag

MAX_STEPS = 64


def check_least_squares(solver: Any) -> None:
    """Raise `TypeError` unless `solver` is None or an optimistix least-squares solver or minimiser."""
    if solver is None:
        return
    import optimistix as optx

    if not isinstance(solver, optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser):
        raise TypeError(
            f"solver must be an optimistix least-squares solver or None; got "
            f"{getattr(solver, '__name__', type(solver).__name__)}. For example optimistix.LevenbergMarquardt("
            "rtol=1e-10, atol=1e-10)."
        )


def minimize(
    residual: Callable[[Float[Array, " n"], Any], Array], solver: Any, start: Float[Array, " n"], args: Any
) -> tuple[Float[Array, " n"], Flag]:
    """(values of least squared residuals; whether the solver reports success). Not differentiable."""
    import optimistix as optx

    start, args = jax.lax.stop_gradient((start, args))
    solution = optx.least_squares(residual, solver, start, args, max_steps=MAX_STEPS, throw=False)
    return jax.lax.stop_gradient(solution.value), solution.result == optx.RESULTS.successful
