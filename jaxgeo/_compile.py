"""Compiling of programs that jaxgeo calls itself, outside of the user's `jit`, in less time than usual."""

from __future__ import annotations

import functools
import gc
import os
import threading
import weakref
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax._src.core import trace_state_clean
from jax.core import Tracer

from jaxgeo._accelerator import core_count, platform_of
from jaxgeo._checks import is_known
from jaxgeo._program_cache import folder_in_use
from jaxgeo._program_store import Programs, is_debugging

ROWS = 1024  # items of a block under a `vmap` that is called directly
MOST_ROWS = 16 * ROWS  # more items are a program of their own, which is quicker to run
MOST_FEW, MOST_SMALL = 1 << 14, 1 << 20
MOST_NUMBERS = 64  # per argument and item: with a height field for each item the older emitter does not finish
T = TypeVar("T", bound=Callable[..., Any])

# Kinds of commands of a program that XLA puts into CUDA graphs: its usual ones, and conditions and loops.
GRAPHS = "FUSION,CUBLAS,CUBLASLT,CUSTOM_CALL,CUDNN,DYNAMIC_SLICE_FUSION,CONDITIONAL,WHILE"
# Passes of XLA that are slow and do not speed up batches.
PASSES = "while-loop-invariant-code-motion,simplify-while-loops,tree_reduction_rewriter"


RUNS = ("short", "long")


def compiler_options(runs: str = RUNS[0]) -> dict[str, Any]:
    """Options of XLA for a program of your own, as jaxgeo compiles its own: for `jax.jit(..., compiler_options=)`.

    For "short" runs, programs of a CPU compile in about half the time and run slower: by a third for one pixel, several
    times for thousands. "long" leaves out what takes long to compile and speeds up no batch; on a GPU, loops and
    branches become CUDA graphs, so that it does not wait for the host. Results differ from those of the usual options
    by rounding, about 1e-8 m in a fix. The options are for JAX's default device; there are none where its compiler does
    not know them. Raises `ValueError` for other `runs`.

    >>> import jax
    >>> miss = jax.jit(lambda x: jax.numpy.sin(x) - x, compiler_options=jaxgeo.compiler_options("short"))
    >>> print(f"{miss(0.1):.4f}")
    -0.0002
    """
    if runs not in RUNS:
        raise ValueError(f"runs must be one of {', '.join(RUNS)}; got {runs!r}.")
    return dict(quick_options() if runs == "short" else long_run_options())


def quick_options() -> dict[str, Any]:
    """XLA CPU options: the older emitter, with little optimisation, by one thread; none on other backends or if not
    supported.

    A level set in `XLA_FLAGS` is kept. Not level 0: with it and the older emitter, XLA of jaxlib 0.10 gives wrong
    numbers on processors with AVX2.
    """
    return _quick_options(platform_of())


def batch_options() -> dict[str, Any]:
    """XLA options for batches: on CPUs optimised, by the older emitter, without passes that help no batch."""
    return _batch_options(platform_of())


def long_run_options() -> dict[str, Any]:
    """As `batch_options`, on CPUs by the usual emitter: a quarter faster to run, for half more time to compile."""
    return _long_run_options(platform_of())


@functools.cache
def _quick_options(platform: str) -> dict[str, Any]:
    options: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False, "xla_disable_hlo_passes": PASSES}
    options["xla_cpu_multi_thread_eigen"] = False  # one item is done sooner than shared among threads
    if "xla_backend_optimization_level" not in os.environ.get("XLA_FLAGS", ""):
        options["xla_backend_optimization_level"] = 1
    return _supported(options, platform)


@functools.cache
def _batch_options(platform: str) -> dict[str, Any]:
    return _graphs(platform) or _supported(
        {"xla_cpu_use_fusion_emitters": False, "xla_disable_hlo_passes": PASSES}, platform
    )


@functools.cache
def _long_run_options(platform: str) -> dict[str, Any]:
    return _graphs(platform) or _supported({"xla_disable_hlo_passes": PASSES}, platform)


def _graphs(platform: str) -> dict[str, Any]:
    """XLA GPU options: loops and branches as CUDA graphs, so that the GPU does not wait for the host in each round."""
    name = "xla_gpu_enable_command_buffer"
    if platform != "gpu" or name in os.environ.get("XLA_FLAGS", ""):
        return {}
    return _accepted({name: GRAPHS})


def _supported(options: dict[str, Any], platform: str) -> dict[str, Any]:
    if platform != "cpu":
        return {}
    split = "xla_cpu_parallel_codegen_split_count"  # parts for threads; one compiles with a tenth less work
    if split not in os.environ.get("XLA_FLAGS", "") and (core_count() == 1 or os.environ.get("NPROC") == "1"):
        options = {**options, split: 1}
    return _accepted(options)


def _accepted(options: dict[str, Any]) -> dict[str, Any]:
    try:
        jax.jit(jnp.negative, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return options


def quick_jit(function: T) -> T:
    """`jax.jit`, for functions of one item: called directly they compile in half the time.

    So they do under a `vmap` that is called directly, for up to `MOST_ROWS` items: in blocks of one size, so that one
    program serves every number of items. Inside `jit` and derivatives they are part of the caller's program. The
    programs differ in rounding (about 1e-8 m in a fix).
    """
    alone = _quick(function, jax.jit)
    batches = Batches(function)

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        batch = None if is_known((args, options)) else batches.of((args, options))
        return alone(*args, **options) if batch is None else batch()

    return call  # pyright: ignore


def quick_filter_jit(function: T) -> T:
    """`quick_jit` for arguments that are not all arrays, as `equinox.filter_jit`."""
    return _quick(function, eqx.filter_jit)


def one_program(function: T) -> T:
    """`function` as one program where it is called directly, also under `vmap`, in place of one for each operation;
    elsewhere as it is.

    Numbers of Python are part of the program, so pass arrays.
    """
    whole = quick_filter_jit(function)

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        return (whole if is_direct() or _are_mapped((args, options)) else function)(*args, **options)

    return call  # pyright: ignore


def maps_in_blocks(many: Any) -> bool:
    """Whether a `vmap` of a `quick_jit`, called directly over these arrays, uses one program for every number of items.

    Not with large arrays for each item, and not on accelerators: there one program of all that is computed is better.
    """
    leaves = jax.tree.leaves(many)
    is_small = all(np.size(leaf) <= MOST_NUMBERS * np.shape(leaf)[0] for leaf in leaves)
    return is_small and platform_of() == "cpu" and bool(batch_options()) and not is_debugging()


def is_direct() -> bool:
    """Whether a call is by itself, not part of a program, of a `vmap` or of derivatives: then nothing is traced."""
    return trace_state_clean()


def batch_filter_jit(function: T) -> T:
    """`equinox.filter_jit` for batches that are over in a second: called directly they compile in half the time."""
    return _quick(function, eqx.filter_jit, batch_options)


def sized_filter_jit(function: T) -> T:
    """`quick_filter_jit` for arguments of up to `MOST_FEW` numbers each, with more `batch_filter_jit`, and with more
    than `MOST_SMALL` `equinox.filter_jit`: by then the program runs longer than it compiles."""
    few, small, large = quick_filter_jit(function), batch_filter_jit(function), eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        most = max((np.size(leaf) for leaf in jax.tree.leaves((args, options)) if eqx.is_array(leaf)), default=0)
        return (few if most <= MOST_FEW else small if most <= MOST_SMALL else large)(*args, **options)

    return call  # pyright: ignore


def long_run_jit(function: T) -> T:
    """`jax.jit` for batches that run longer than they compile, without passes that help none."""
    return _quick(function, jax.jit, long_run_options)


def long_run_filter_jit(function: T) -> T:
    """`long_run_jit` for arguments that are not all arrays, as `equinox.filter_jit`."""
    return _quick(function, eqx.filter_jit, long_run_options)


def _are_mapped(values: Any) -> bool:
    """Whether the traced arrays are those that a `vmap` called directly maps."""
    traced = [leaf for leaf in jax.tree.leaves(values) if isinstance(leaf, Tracer)]
    return bool(traced) and all(_is_mapped_once(leaf, traced[0]) for leaf in traced)


class _Fixed:
    """A value that is part of a program: of arguments and results that are no arrays."""

    def __init__(self, value: Any = None) -> None:
        self.value = value


jax.tree_util.register_pytree_node(_Fixed, lambda fixed: ((), fixed.value), lambda value, _: _Fixed(value))
_ARRAY = _Fixed()  # in the place of an array


def _apart(tree: Any) -> tuple[list[Any], tuple[tuple[Any, ...], Any]]:
    """(the arrays of a tree, its other leaves and its form), which `_together` puts together."""
    leaves, form = jax.tree.flatten(tree)
    is_array = [eqx.is_array(leaf) for leaf in leaves]
    others = tuple(_ARRAY if one else leaf for one, leaf in zip(is_array, leaves, strict=True))
    return [leaf for one, leaf in zip(is_array, leaves, strict=True) if one], (others, form)


def _together(arrays: Iterable[Any], others: tuple[tuple[Any, ...], Any]) -> Any:
    left, (leaves, form) = iter(arrays), others
    return jax.tree.unflatten(form, [next(left) if leaf is _ARRAY else leaf for leaf in leaves])


def _filter_jit(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    """`equinox.filter_jit` for direct calls, which take two thirds of its time."""

    def program(others: Any, arrays: list[Any]) -> tuple[list[Any], _Fixed]:
        args, given = _together(arrays, others)
        found, rest = _apart(function(*args, **given))
        return found, _Fixed(rest)

    program.__name__ = function.__name__
    compiled = jax.jit(program, static_argnums=0, compiler_options=options)

    def call(*args: Any, **given: Any) -> Any:
        arrays, others = _apart((args, given))
        found, rest = compiled(others, arrays)
        return _together(found, rest.value)

    return call


def _quick(function: T, jit: Callable[..., Any], options_of: Callable[[], dict[str, Any]] = quick_options) -> T:
    usual = jit(function)

    @functools.cache
    def quick(platform: str) -> Any:
        if jit is eqx.filter_jit:
            return _filter_jit(function, options_of())
        return jit(function, compiler_options=options_of())

    kept = Programs(function, options_of, (lambda _: True) if jit is jax.jit else eqx.is_array)

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        if not is_direct():
            return usual(*args, **options)
        folder = folder_in_use()
        with RARE_COLLECTION:
            by_kept = None if folder is None else kept.call(folder, args, options)
            return quick(platform_of())(*args, **options) if by_kept is None else by_kept()

    return call  # pyright: ignore


class Batches:
    """Calls of a function under a `vmap` that is not part of a larger program, on CPUs."""

    known: ClassVar[weakref.WeakSet[Batches]] = weakref.WeakSet()

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._programs: dict[Any, Any] = {}
        self.known.add(self)

        @functools.wraps(function)
        def mapped(axes: str, inputs: Any) -> Any:
            """The function of a block; `axes` has a 0 for each argument with rows, in the order of the leaves."""
            leaves, form = jax.tree.flatten(inputs)

            def of_leaves(leaves: list[Any]) -> Any:
                args, options = jax.tree.unflatten(form, leaves)
                return function(*args, **options)

            return jax.vmap(of_leaves, in_axes=([0 if axis == "0" else None for axis in axes],))(leaves)

        self._mapped, self._kept = mapped, Programs(mapped, batch_options, lambda leaf: not isinstance(leaf, str))

    def clear(self) -> None:
        """Drop the compiled programs, which `jax.clear_caches` does not know."""
        self._programs.clear()

    def of(self, inputs: tuple[tuple[Any, ...], dict[str, Any]]) -> Callable[[], Any] | None:
        """The call for inputs (arguments and options) that a `vmap` called directly traces, else None."""
        leaves: list[Any]
        leaves, structure = jax.tree.flatten(inputs)
        traced: list[Any] = [leaf for leaf in leaves if isinstance(leaf, Tracer)]
        if not _are_mapped(traced) or platform_of() != "cpu":
            return None
        if not batch_options() or is_debugging():
            return None
        axes: Any = tuple(leaf.batch_dim if isinstance(leaf, Tracer) else None for leaf in leaves)
        values = [leaf.val if isinstance(leaf, Tracer) else leaf for leaf in leaves]
        count = traced[0].val.shape[traced[0].batch_dim]
        if not 0 < count <= MOST_ROWS or any(leaf.size > MOST_NUMBERS for leaf in traced):
            return None
        return lambda: _delivered(self._found(structure, axes, values, count), traced[0])

    def _found(self, structure: Any, axes: tuple[int | None, ...], values: list[Any], count: int) -> Any:
        """The results as NumPy arrays, block by block."""
        blocks = -(-count // ROWS)
        rows = np.minimum(np.arange(blocks * ROWS), count - 1).reshape(blocks, ROWS)
        mapped = {k: np.moveaxis(np.asarray(values[k]), axis, 0) for k, axis in enumerate(axes) if axis is not None}
        blocks = [[mapped[k][row] if k in mapped else x for k, x in enumerate(values)] for row in rows]
        is_mapped = "".join("-" if axis is None else "0" for axis in axes)
        with RARE_COLLECTION:
            run = self._runner(is_mapped, structure, blocks[0])
            parts = [run(block) for block in blocks]
        return jax.tree.map(lambda *x: np.concatenate([np.asarray(part) for part in x])[:count], *parts)

    def _runner(self, axes: str, structure: Any, block: list[Any]) -> Callable[[list[Any]], Any]:
        """The program of all blocks like this one."""
        folder = folder_in_use()
        kept = folder and self._kept.find(folder, (axes, jax.tree.unflatten(structure, block)), {})
        return kept or self._program(axes, structure, block)

    def _program(self, axes: str, structure: Any, block: list[Any]) -> Any:
        """The compiled program, which a `jit` would compile again under each `vmap` of another size."""
        key = structure, axes, tuple((np.shape(leaf), jnp.result_type(leaf)) for leaf in block)
        if key not in self._programs:
            mapped = functools.partial(self._mapped, axes)
            of_leaves = lambda leaves: mapped(jax.tree.unflatten(structure, leaves))  # noqa: E731
            self._programs[key] = jax.jit(of_leaves).lower(block).compile(compiler_options=batch_options())
        return self._programs[key]


def _is_mapped_once(leaf: Any, other: Any) -> bool:
    """Whether a traced array is one that the `vmap` of `other` maps directly, on the default device."""
    value, axis = getattr(leaf, "val", None), getattr(leaf, "batch_dim", None)
    if not isinstance(axis, int) or getattr(leaf, "_trace", leaf) is not getattr(other, "_trace", other):
        return False
    if isinstance(value, np.ndarray):
        return True
    if not isinstance(value, jax.Array) or isinstance(value, Tracer):
        return False
    return value.is_fully_addressable and value.devices() == {jax.devices(platform_of())[0]}


def _delivered(found: Any, traced: Any) -> Any:
    """Results (leading axis) as those of the `vmap` that traces `traced`."""
    return jax.tree.map(lambda x: type(traced)(traced._trace, x, 0), jax.device_put(found))


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
