"""The optional package `jaxgeo_native`: a search compiled ahead, for programs on this machine's CPU."""

from __future__ import annotations

import functools
import os
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import mlir
from jax.sharding import PartitionSpec

SWITCH = "JAXGEO_NATIVE"  # environment variable; 0: the package is not used; avx2, plain: with vectors no wider
INTERFACE = 2  # of the arrays that the native search takes
TARGETS = {name: f"jaxgeo_{name}_{INTERFACE}" for name in ("first_events", "first_hits")}
T = TypeVar("T")

_lock = threading.Lock()


def is_native() -> bool:
    """Whether programs traced now use the native search: it is installed, fits, and is not switched off."""
    return os.environ.get(SWITCH, "") != "0" and identity() is not None


def identity() -> str | None:
    """What tells one build of the native search from another; None without one. The search is then known to XLA."""
    with _lock:
        return _registered()


@functools.cache
def _registered() -> str | None:
    try:
        import jaxgeo_native  # pyright: ignore[reportMissingImports]

        if jaxgeo_native.INTERFACE != INTERFACE:
            raise RuntimeError(f"it has interface {jaxgeo_native.INTERFACE}, and this version of jaxgeo {INTERFACE}")
        for name, function in jaxgeo_native.functions().items():
            jax.ffi.register_ffi_target(TARGETS[name], jax.ffi.pycapsule(function), platform="cpu")
    except ImportError:
        return None
    except Exception as error:  # of another version of XLA, or another processor; or its source alone is found
        warnings.warn(
            f"jaxgeo_native is installed but cannot be used ({error}): searches run without it. Build it again with "
            f"`pip install --force-reinstall ./native`, or set {SWITCH}=0.",
            RuntimeWarning,
            stacklevel=2,
        )
        return None
    stat = jaxgeo_native.FILE.stat()
    return f"{INTERFACE} {stat.st_size} {stat.st_mtime_ns}"


# One operation with two implementations, chosen when a program is lowered: only then is it known for which device, and
# whether it is exported to machines that may have no native search.
_either = Primitive("jaxgeo_native_or_not")
_either.multiple_results = True


def native_or_not(native: Callable[..., T], portable: Callable[..., T], like: T, *args: Any) -> T:
    """The result of `native` in programs for this machine's CPU, else that of `portable`; without derivatives.

    Both are functions of modules, and have results of the shapes and dtypes of `like`.
    """
    leaves, structure = jax.tree.flatten(args)
    shapes, form = jax.tree.flatten(like)
    results = tuple((x.shape, x.dtype) for x in shapes)
    return jax.tree.unflatten(
        form, _either.bind(*leaves, native=native, portable=portable, structure=structure, results=results)
    )


@_either.def_impl
def _(*leaves: Any, **params: Any) -> Sequence[jax.Array]:
    with jax.disable_jit(False):  # else it would call itself
        return _compiled(leaves, **params)


@functools.partial(jax.jit, static_argnames=("native", "portable", "structure", "results"))
def _compiled(leaves: Sequence[Any], **params: Any) -> Sequence[jax.Array]:
    return _either.bind(*leaves, **params)


@_either.def_abstract_eval
def _(*avals: Any, results: tuple[tuple[tuple[int, ...], Any], ...], **_: Any) -> list[Any]:
    first = avals[0]  # results are distributed over devices as this array is along its first axis
    along = tuple(first.sharding.spec)[:1]
    return [
        first.update(
            shape=shape, dtype=dtype, weak_type=False, sharding=first.sharding.update(spec=PartitionSpec(*along))
        )
        for shape, dtype in results
    ]


def _lower(ctx: Any, *leaves: Any, native: Any, portable: Any, structure: Any, results: Any) -> Any:
    del native, results
    return _lowered(portable, structure, ctx, leaves)


def _lower_on_cpu(ctx: Any, *leaves: Any, native: Any, portable: Any, structure: Any, results: Any) -> Any:
    del results
    is_exported = ctx.module_context.lowering_parameters.for_export
    return _lowered(portable if is_exported else native, structure, ctx, leaves)


def _lowered(function: Callable[..., Any], structure: Any, ctx: Any, leaves: Sequence[Any]) -> Any:
    """Operations of a function, on one device: how arrays are distributed was settled when it was traced."""

    def of_leaves(*leaves: Any) -> list[Any]:
        return jax.tree.leaves(function(*jax.tree.unflatten(structure, leaves)))

    on_one = ctx.replace(avals_in=[ShapedArray(x.shape, x.dtype) for x in ctx.avals_in])
    return mlir.lower_fun(of_leaves)(on_one, *leaves)


mlir.register_lowering(_either, _lower)
mlir.register_lowering(_either, _lower_on_cpu, platform="cpu")
