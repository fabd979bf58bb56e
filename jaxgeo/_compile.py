"""Compiling of programs that jaxgeo calls itself, outside of the user's `jit`, in less time than usual."""

from __future__ import annotations

import functools
import gc
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgeo._checks import is_known

T = TypeVar("T", bound=Callable[..., Any])


PASSES = "while-loop-invariant-code-motion,simplify-while-loops,tree_reduction_rewriter"  # slow, of no use to batches


@functools.cache
def quick_options() -> dict[str, Any]:
    """XLA CPU options: the older emitter, without optimisation; none on other backends or if not supported."""
    return _supported({"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False})


@functools.cache
def batch_options() -> dict[str, Any]:
    """XLA CPU options for batches: optimised, by the older emitter, without passes that help no batch."""
    return _supported({"xla_cpu_use_fusion_emitters": False, "xla_disable_hlo_passes": PASSES})


@functools.cache
def long_run_options() -> dict[str, Any]:
    """As `batch_options`, by the usual emitter: a quarter faster to run, for half more time to compile."""
    return _supported({"xla_disable_hlo_passes": PASSES})


def _supported(options: dict[str, Any]) -> dict[str, Any]:
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(jnp.negative, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return options


def quick_jit(function: T) -> T:
    """`jax.jit`, for functions of one item: called directly they compile quickly, for a third more run time.

    Inside `jit`, `vmap` and derivatives they are part of the caller's program. The two programs differ in rounding
    (about 1e-8 m in a fix).
    """
    return _quick(function, jax.jit)


def quick_filter_jit(function: T) -> T:
    """`quick_jit` for arguments that are not all arrays, as `equinox.filter_jit`."""
    return _quick(function, eqx.filter_jit)


def batch_filter_jit(function: T) -> T:
    """`equinox.filter_jit` for batches that are over in a second: called directly they compile in half the time."""
    return _quick(function, eqx.filter_jit, batch_options)


def long_run_filter_jit(function: T) -> T:
    """`equinox.filter_jit` for batches that run longer than they compile, without passes that help none."""
    return _quick(function, eqx.filter_jit, long_run_options)


def _quick(function: T, jit: Callable[..., Any], options_of: Callable[[], dict[str, Any]] = quick_options) -> T:
    usual = jit(function)

    @functools.cache
    def quick() -> Any:
        return jit(function, compiler_options=options_of())

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        if not is_known((args, options)):
            return usual(*args, **options)
        with RARE_COLLECTION:
            return quick()(*args, **options)

    return call  # pyright: ignore


class _RareCollection:
    """While in use, Python looks for unreachable cycles rarely: a tenth of the time of a first call.

    Tracing makes many small objects that it keeps. Safe for threads: the first to begin sets, the last to end resets.
    """

    MOST = 100_000  # new objects between searches

    def __init__(self) -> None:
        self._lock, self._users, self._usual = threading.Lock(), 0, gc.get_threshold()

    def __enter__(self) -> None:
        with self._lock:
            self._users += 1
            if self._users == 1:
                self._usual = gc.get_threshold()
                if 0 < self._usual[0] < self.MOST:
                    gc.set_threshold(self.MOST, *self._usual[1:])

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._users -= 1
            if self._users == 0:
                gc.set_threshold(*self._usual)


RARE_COLLECTION = _RareCollection()
