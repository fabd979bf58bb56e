"""Root finding for gimbal pointing: optimistix solvers within gimbal limits, and the choice of solver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import all_finite
from jaxgeo._record import Record

TOLERANCE = 1e-10  # rad: at 20 m or more, ECEF rounding moves the line of sight by less
SAME_DIRECTION = 1e-7  # ratio of singular values below which two axes move the line of sight in the same direction
MAX_STEPS = 32  # Newton takes three or four from the closed form


class FixedNewton(Record):
    """The package's own pointing solver: a fixed number of unrolled Newton steps from the closed form.

    The default inside `vmap` and `jit`, because a batched loop runs until its slowest lane converges: from the same
    start, to the same readings, `optimistix.Newton` takes 2.4 times as long in one `vmap` over 10,000 pointings of two
    axes (1.3 times with an atmosphere), and `LevenbergMarquardt` 6 times (`benchmarks/pointing.py`, two cores).
    Single pointings use optimistix, whose first call takes a fifth of the time.
    """


def default_root_finder() -> Any:
    """`optimistix.Newton` with minimum-norm steps where two axes move the line of sight in the same direction."""
    import lineax as lx
    import optimistix as optx

    return optx.Newton(rtol=TOLERANCE, atol=TOLERANCE, linear_solver=lx.SVD(rcond=SAME_DIRECTION))


def check_solver(solver: Any) -> None:
    """Raise `TypeError` unless `solver` is None, `FixedNewton`, or an optimistix root finder or least-squares one."""
    if solver is None or isinstance(solver, FixedNewton):
        return
    import optimistix as optx

    if not isinstance(solver, optx.AbstractRootFinder | optx.AbstractLeastSquaresSolver):
        raise TypeError(
            f"solver must be an optimistix root finder or least-squares solver, or coverage.FixedNewton(); got "
            f"{getattr(solver, '__name__', type(solver).__name__)}. For example optimistix.Newton(rtol=1e-10, "
            "atol=1e-10)."
        )


def find_root(
    residual: Callable[[Float[Array, " n"], Any], Array],
    solver: Any,
    start: Float[Array, " n"],
    limits: Float[Array, "n 2"],
    args: Any,
) -> Float[Array, " n"]:
    """Result of the solver within the limits, or the start if it is not finite. Not differentiable.

    Solvers that support bounds (`optimistix.Newton`) use the limits; results of others are clipped to them.
    """
    import optimistix as optx

    low, high = limits[:, 0], limits[:, 1]
    options = {"lower": low, "upper": high}
    start, args = jax.lax.stop_gradient((start, args))
    found = optx.root_find(residual, solver, start, args, options=options, max_steps=MAX_STEPS, throw=False).value
    return jnp.where(all_finite(found), jnp.clip(found, low, high), start)
