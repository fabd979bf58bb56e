"""Roots by an optimistix solver, started from a closed form and kept within the limits of a gimbal."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import all_finite
from jaxgeo._record import Record

TOLERANCE = 1e-10  # rad: rounding of ECEF moves the line of sight by less from 20 m on
SAME_DIRECTION = 1e-7  # ratio of singular values: below it two axes move the line of sight alike
MAX_STEPS = 32  # from the closed form Newton takes three or four


class FixedNewton(Record):
    """The package's own pointing solver: a fixed number of unrolled Newton steps from the closed form.

    The default inside `vmap` and `jit`. It stays beside optimistix because a loop waits for its slowest lane: from the
    same start, with the same readings, `optimistix.Newton` takes 2.4 times as long in one `vmap` over 10,000 pointings
    of two axes (1.3 times through the air), and `LevenbergMarquardt` 6 times (`benchmarks/pointing.py`, two cores).
    The first call of a single pointing takes a fifth by optimistix, hence those go by it.
    """


def default_root_finder() -> Any:
    """`optimistix.Newton` with steps that leave an axis alone where two axes move the line of sight alike."""
    import lineax as lx
    import optimistix as optx

    return optx.Newton(rtol=TOLERANCE, atol=TOLERANCE, linear_solver=lx.SVD(rcond=SAME_DIRECTION))


@functools.cache
def compiled_quickly(program: Callable[..., Any]) -> Callable[..., Any]:
    """`program` for single calls: compiled in a third of the time, to run for 0.2 ms in place of 0.1."""
    return eqx.filter_jit(program, compiler_options=_quick_to_compile())  # pyright: ignore[reportCallIssue]


def _quick_to_compile() -> dict[str, Any]:
    """Options of XLA on CPUs: its older emitter, without optimisation; none where a version does not know them."""
    options = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(jnp.negative, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return options


def check_solver(solver: Any) -> None:
    """Raise `TypeError` unless this is a solver that finds roots, or None."""
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
    """Where the solver ends within the limits; the start where that is not finite. Not differentiable.

    Solvers that take bounds (`optimistix.Newton`) get them; the result of others is cut off at them.
    """
    import optimistix as optx

    low, high = limits[:, 0], limits[:, 1]
    options = {"lower": low, "upper": high}
    start, args = jax.lax.stop_gradient((start, args))
    found = optx.root_find(residual, solver, start, args, options=options, max_steps=MAX_STEPS, throw=False).value
    return jnp.where(all_finite(found), jnp.clip(found, low, high), start)
