"""Digests of values, to tell whether two are equal, in one process or in several."""

from __future__ import annotations

import enum
import functools
import hashlib
import pickle
import sys
import types
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

# What is installed counts by its name: its code is told by versions.
INSTALLED = ("jaxgeo", "jax", "jaxlib", "numpy", "scipy", "equinox", "optimistix", "lineax", "xarray")

OF_CLASSES = bool | int | float | complex | bytes | tuple | np.ndarray  # values of a class that count


def digest_of(value: Any) -> str:
    """Digest of numbers, texts, arrays, keys, containers, records, and functions with all that they use.

    The same in every process. Raises `TypeError` for an object without a value that could be compared.
    """
    return _digest(value, (), {}).hex()


def _digest(value: Any, within: tuple[int, ...], known: dict[int, tuple[Any, bytes]]) -> bytes:
    """Digest of a value; `within` are the identities of those that enclose it, `known` those done before."""
    if id(value) in within:
        return f"{len(within) - within.index(id(value))} up".encode()
    if id(value) not in known:
        kind, content, parts = _taken_apart(value)
        total = hashlib.blake2b(f"{kind}:{len(parts)}:".encode(), digest_size=16)
        total.update(content)
        for part in parts:
            total.update(_digest(part, (*within, id(value)), known))
        known[id(value)] = value, total.digest()  # the value is held, so that its identity stays its own
    return known[id(value)][1]


def _taken_apart(value: Any) -> tuple[str, Any, list[Any]]:
    """(kind, bytes, simpler values) that tell a value from others."""
    kind = _name(type(value))[0]
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | enum.Enum | np.dtype | slice):
        return kind, repr(value).encode(), []
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return f"key {jax.random.key_impl(value)}", b"", [np.asarray(jax.random.key_data(value))]
    if isinstance(value, jax.Array | np.ndarray | np.generic):
        array = np.ascontiguousarray(value)
        content = array.data.cast("B") if array.size and array.dtype.kind in "biufc" else repr(array.tolist()).encode()
        return f"array {array.dtype.str} {np.shape(value)}", content, []
    if isinstance(value, Mapping):
        return kind, b"", [part for item in sorted(value.items(), key=lambda item: repr(item[0])) for part in item]
    if isinstance(value, set | frozenset):
        return kind, b"", sorted(value, key=repr)
    if isinstance(value, tuple | list):
        return kind, b"", list(value)
    return _of_code(value, kind)


def _of_code(value: Any, kind: str) -> tuple[str, Any, list[Any]]:
    """The same of functions, classes, and other objects."""
    if isinstance(value, functools.partial):
        return kind, b"", [value.func, value.args, value.keywords]
    if isinstance(value, types.MethodType):
        return kind, b"", [value.__func__, value.__self__]
    if isinstance(value, types.CodeType):
        return kind, value.co_code, [value.co_name, value.co_consts, value.co_names]
    name, is_installed = _name(value)
    if isinstance(value, types.FunctionType) and not is_installed:
        used = {used: value.__globals__[used] for used in _names(value.__code__) if used in value.__globals__}
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        return name, b"", [value.__code__, value.__defaults__, value.__kwdefaults__, used, cells]
    if isinstance(value, type):
        content = {key: getattr(x, "fget", getattr(x, "__func__", x)) for key, x in vars(value).items()}
        own = {key: x for key, x in content.items() if isinstance(x, types.FunctionType | OF_CLASSES)}
        return name, b"", [] if is_installed else [own]
    if hasattr(value, "__wrapped__"):  # a jitted function
        return kind, b"", [value.__wrapped__]
    if hasattr(value, "__name__") and (callable(value) or isinstance(value, types.ModuleType)):
        return name, value.__name__.encode(), []
    if hasattr(value, "__dict__"):
        return kind, b"", [type(value), vars(value)]
    try:
        return kind, pickle.dumps(value, protocol=5), []
    except Exception as error:
        raise TypeError(f"a {kind} cannot be compared with that of another run: {error}") from error


def _name(value: Any) -> tuple[str, bool]:
    """(name, whether it is installed) of a class or function; of one's own without the module, which may be run as a
    script or imported."""
    module, name = getattr(value, "__module__", None) or "", getattr(value, "__qualname__", "")
    top = module.partition(".")[0]
    is_installed = top in INSTALLED or (top in sys.stdlib_module_names and top != "__main__")
    return (f"{module}.{name}" if is_installed else name), is_installed


def _names(code: types.CodeType) -> set[str]:
    """Names that a function and the functions within it use."""
    inner = [const for const in code.co_consts if isinstance(const, types.CodeType)]
    return set(code.co_names).union(*map(_names, inner))
