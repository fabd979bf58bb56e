"""Checks of arguments: 64-bit floats are required, and mistakes are named before anything is converted."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax._src import xla_bridge
from jax._src.core import trace_state_clean

T = TypeVar("T")

MOST_INDEXED = 2**31 - 1  # int32
TEXTS = "US"  # kinds of NumPy's dtypes
NO_NUMBERS = {
    "U": "texts",
    "S": "texts",
    "O": "an array of objects",
    "M": "dates",
    "m": "spans of time",
    "b": "truth values",
}


def enable_x64() -> None:
    """Turn on JAX's 64-bit floats, which every position on the Earth needs; call it once, first of all.

    Child processes that are started afterwards compute in 64 bits too: JAX_ENABLE_X64=1 is put into the environment
    that they get. For those that started earlier it serves as an initializer.
    """
    jax.config.update("jax_enable_x64", True)
    os.environ["JAX_ENABLE_X64"] = "1"


def is_x64() -> bool:
    """Whether JAX computes in 64-bit floats."""
    return bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]


def require_x64() -> None:
    """Raise `RuntimeError` unless JAX computes in 64-bit floats, in a process where it can compute at all."""
    if not is_x64():
        raise RuntimeError(
            "jaxgeo needs 64-bit floats, but JAX is set to 32 bits, in which a position on the Earth is uncertain "
            "by half a metre. Call jaxgeo.enable_x64() at the start of the program, or set JAX_ENABLE_X64=1."
        )
    if is_forked_from_jax():
        raise RuntimeError(
            "this process was forked from one in which JAX had already started; the threads of JAX are missing here, "
            "and a computation can wait for them for ever. Start worker processes with 'spawn' or 'forkserver', e.g. "
            "ProcessPoolExecutor(mp_context=multiprocessing.get_context('spawn')), or fork before the first "
            "computation."
        )


_is_forked_from_jax = False


def is_forked_from_jax() -> bool:
    """Whether this process was forked from one in which JAX was running, whose threads it does not have."""
    return _is_forked_from_jax


def _after_fork() -> None:
    global _is_forked_from_jax  # noqa: PLW0603
    _is_forked_from_jax = xla_bridge.backends_are_initialized()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_after_fork)


def as_float64(tree: T, name: str | tuple[str, ...]) -> T:
    """`tree` with every number as a float64 array; integers and Python numbers are promoted.

    `name` is how messages call the argument; several names, if `tree` is a tuple of arguments. Integer arrays that
    index (static or int8 statuses) do not belong here. Raises `RuntimeError` with 64-bit floats off, `TypeError` on any
    other float or complex dtype.
    """
    require_x64()
    leaves, structure = jax.tree.flatten(tree)
    if all(isinstance(leaf, jax.Array) and leaf.dtype == np.float64 and not leaf.weak_type for leaf in leaves):
        return tree
    for value, what in [(tree, name)] if isinstance(name, str) else zip(tree, name, strict=True):  # pyright: ignore[reportArgumentType]
        check_no_text(value, what)
    leaves = [_leaf_as_float64(number, leaf, tree, name) for number, leaf in enumerate(leaves)]
    host = [number for number, leaf in enumerate(leaves) if isinstance(leaf, _Host)]
    for number, leaf in zip(host, jax.device_put([leaves[number].values for number in host]), strict=True):
        leaves[number] = leaf  # all at once, which is quicker; jnp.asarray would compile a program for each shape
    return jax.tree.unflatten(structure, leaves)


class _Host(NamedTuple):
    """Values of a leaf that are not on a device yet."""

    values: np.ndarray


def _leaf_as_float64(number: int, leaf: Any, tree: Any, name: str | tuple[str, ...]) -> Any:
    if not (eqx.is_array_like(leaf) or isinstance(leaf, np.generic)):
        return leaf
    dtype = np.asarray(leaf).dtype if isinstance(leaf, bool | int | float | complex) else leaf.dtype
    if dtype == np.float64 or np.issubdtype(dtype, np.integer):
        if isinstance(leaf, jax.Array) and dtype == np.float64 and not leaf.weak_type:
            return leaf
        if isinstance(leaf, jax.Array) or not trace_state_clean():
            return jnp.asarray(leaf, jnp.float64)
        return _Host(np.array(leaf, np.float64))
    path = jax.tree_util.tree_flatten_with_path(tree)[0][number][0]
    if isinstance(name, tuple):
        name, path = name[path[0].idx], path[1:]
    where = f"{name}{jax.tree_util.keystr(path)}"
    _check_dtype(leaf, dtype, where)
    raise TypeError(
        f"{where} has dtype {dtype}, but jaxgeo computes in float64: a {dtype} angle or position has already lost "
        f"the metres. Make it float64 where it is read or created, e.g. np.asarray(x, np.float64)."
    )


def check_no_text(value: Any, name: str) -> None:
    """Raise `TypeError` for a text, or an array of texts, in place of numbers."""
    if isinstance(value, str | bytes):
        raise TypeError(f"{name} must be numbers; got the text {value!r}. Convert it first, as by float(text).")
    if isinstance(value, np.ndarray) and value.dtype.kind in TEXTS:
        _check_dtype(value, value.dtype, name)


def _check_dtype(value: Any, dtype: Any, name: str) -> None:
    """Raise `TypeError` for an array of texts, objects, dates or truth values, in place of numbers."""
    kind = getattr(dtype, "kind", "")
    if kind not in NO_NUMBERS:
        return
    known = concrete(value)
    first = None if known is None else next(iter(known.ravel().tolist()), None)
    such = "" if first is None and kind != "O" else f", such as {first!r}"
    raise TypeError(
        f"{name} must be numbers; got {NO_NUMBERS[kind]}{such}. Convert them first, as by np.asarray(x, np.float64)."
    )


def concrete(value: Any) -> np.ndarray | None:
    """`value` as a NumPy array if it is known now, None while it is traced."""
    if isinstance(value, jax.core.Tracer):
        return None
    return np.asarray(value)


def is_known(tree: Any) -> bool:
    """Whether no number of `tree` is traced: a call by itself, outside `jit`, `vmap` and derivatives."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def by_numpy_if_known(function: Callable[..., Any], *values: Any) -> Any:
    """`function(xp, *values)`: by NumPy in a call by itself, where JAX would compile each operation; traced by JAX."""
    if trace_state_clean() and is_known(values):
        with np.errstate(all="ignore"):  # as JAX
            return jax.device_put(function(np, *jax.tree.map(np.asarray, values)))
    return function(jnp, *values)


def check_finite(value: Any, name: str, unit: str) -> None:
    """Raise `ValueError` if a concrete `value` holds NaN or an infinity."""
    check_no_text(value, name)
    known = concrete(value)
    if known is not None and not np.all(np.isfinite(known)):
        raise ValueError(f"{name} must be finite, in {unit}; got {_shown(known)}.")


def check_range(value: Any, name: str, unit: str, low: float, high: float) -> None:
    """Raise `ValueError` if a concrete `value` is not finite or lies outside [low, high]."""
    check_finite(value, name, unit)
    known = concrete(value)
    if known is not None and known.size and not (np.all(known >= low) and np.all(known <= high)):
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}] {unit}; got {_shown(known)}.")


def _shown(value: np.ndarray) -> str:
    if value.ndim == 0:
        return f"{value.item()!r}"
    text = np.array2string(value, threshold=6, edgeitems=2)
    return f"{text} of shape {value.shape}"


def as_array(value: Any, name: str) -> Any:
    """Numbers, some perhaps traced, in a list or tuple, or in lists of lists, as one array; anything else as it is.

    Raises `TypeError` for a text, a mapping, None in a list, and other objects that are no numbers; `ValueError` for
    lists whose rows differ in length.
    """
    check_no_text(value, name)
    if not isinstance(value, list | tuple):
        _check_is_array(value, name)
        return value
    for k, part in enumerate(value):
        if part is None:
            raise TypeError(f"{name}[{k}] must be a number; got None. Give all {len(value)} values.")
    parts = [as_float64(as_array(part, f"{name}[{k}]"), f"{name}[{k}]") for k, part in enumerate(value)]
    shapes = [np.shape(part) for part in parts]
    if len(set(shapes)) > 1:
        other = next(k for k, shape in enumerate(shapes) if shape != shapes[0])
        raise ValueError(
            f"{name} must have parts of one shape; {name}[0] has {shapes[0]}, but {name}[{other}] has {shapes[other]}."
        )
    return jnp.stack(parts) if parts else jnp.zeros(0)


def given_array(value: Any, name: str, what: str) -> Any:
    """`as_array` of an argument that must be given; `what` it is stands in the message.

    Raises `TypeError` for None, and as `as_array`.
    """
    if value is None:
        raise TypeError(f"{name} is missing (None): give {what}.")
    return as_array(value, name)


def _check_is_array(value: Any, name: str) -> None:
    """Raise `TypeError` for a mapping, a set and the like, in place of numbers; None may be a value not given."""
    if value is None:
        return
    if isinstance(value, Mapping):
        keys = [repr(key) for key in value]
        given = ", ".join(f"given[{key}]" for key in keys)
        raise TypeError(
            f"{name} must be numbers in order; got a {type(value).__name__} with the keys {', '.join(keys) or 'none'}. "
            f"Give its values, as ({given})."
        )
    if not any(hasattr(value, one) for one in ("shape", "__array__", "__jax_array__", "__float__", "__index__")):
        raise TypeError(f"{name} must be numbers; got {type(value).__name__}. Give an array, or a list of numbers.")


def check_countable(count: int, what: str, remedy: str) -> None:
    """Raise `ValueError` for more items than the 32-bit indices of compiled programs can tell apart.

    A larger index would wrap around and look up another item in silence; 64-bit ones would slow down every search.
    """
    if count > MOST_INDEXED:
        raise ValueError(f"{what} are too many: {count} to be indexed, of at most {MOST_INDEXED}. {remedy}")


def check_is(value: Any, kind: type, name: str, hint: str = "") -> None:
    """Raise `TypeError` unless `value` is of a kind of record; `hint` is a sentence on what to do."""
    if not isinstance(value, kind):
        hint = f"Did you mean {value.__name__}()?" if isinstance(value, type) else hint
        raise TypeError(f"{name} must be a jaxgeo {kind.__name__}; got {type(value).__name__}. {hint}".rstrip())
