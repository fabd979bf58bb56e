"""Base class of jaxgeo's records: frozen pytrees that stay float64 when pickled between processes."""

from __future__ import annotations

import dataclasses
import os
import sys
import types
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar, no_type_check

import equinox as eqx
import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax._src import xla_bridge

from jaxgeo._checks import enable_x64, is_forked_from_jax, is_x64
from jaxgeo._export import register_for_export
from jaxgeo._keywords import check_keywords, hinted

T = TypeVar("T")


class Record(eqx.Module):
    """A frozen record, a pytree of its fields. Subclasses declare fields as an `equinox.Module` does.

    Pickling (and so `copy`, `multiprocessing`, joblib, Dask) carries arrays as NumPy arrays of their own dtype. Loading
    one where JAX computes in 32 bits raises `RuntimeError`, except in a worker process in which JAX has computed
    nothing yet: there it turns on 64-bit floats. Constructing a record from an array that JAX has already rounded to 32
    bits raises too, since `jnp.asarray` rounds silently.
    """

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        register_for_export(cls)
        for name, value in tuple(vars(cls).items()):
            if isinstance(value, classmethod) and not name.startswith("_"):
                setattr(cls, name, classmethod(hinted(value.__func__)))

    if not TYPE_CHECKING:

        @no_type_check  # each call would be checked in tests
        def __new__(cls, *args: Any, **kwargs: Any) -> Any:
            """A new record; raises `TypeError` as `check_keywords`."""
            if kwargs:
                check_keywords(cls.__init__, cls, "", kwargs)
            return super().__new__(cls, *args, **kwargs)

    def __check_init__(self) -> None:
        if is_x64():
            return
        for name, value in vars(self).items():
            if isinstance(value, jax.Array) and value.dtype in (jnp.float32, jnp.complex64):
                raise RuntimeError(
                    f"{type(self).__name__}.{name} has dtype {value.dtype}, but jaxgeo needs 64-bit floats: JAX is set "
                    f"to 32 bits, in which a position on the Earth is uncertain by half a metre. {_TURN_ON}"
                )

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _loaded, (type(self), packed(dict(vars(self))))

    if not TYPE_CHECKING:

        @no_type_check  # each access would be checked in tests
        def __getattribute__(self, name: str) -> Any:
            """As an `equinox.Module`, whose bound methods are pytrees; it takes 20 us and more to make one."""
            found = _attribute(self, name)
            if type(found) is not types.MethodType or found.__self__ is not self or name.startswith("__"):
                return found
            return _bound(found.__func__, self) if _IS_BOUND_SO else super().__getattribute__(name)


_attribute = object.__getattribute__


@no_type_check
def _bound(function: Any, record: Any) -> Any:
    """The bound method that equinox makes, without its checks."""
    method = object.__new__(_BoundMethod)
    fields = {"__func__": function, "__self__": record, "__module__": function.__module__}
    fields |= {"__name__": function.__name__, "__qualname__": function.__qualname__}
    fields |= {"__doc__": function.__doc__, "__annotations__": function.__annotations__}
    _attribute(method, "__dict__").update(fields)
    return method


def _bound_by_equinox() -> Any:
    """A bound method that equinox makes."""

    class Empty(eqx.Module):
        def method(self) -> None:
            """Does nothing."""

    return Empty().method


_EXAMPLE = _bound_by_equinox()
_BoundMethod: Any = type(_EXAMPLE)
# whether this version of equinox makes the same bound methods as `_bound`
_IS_BOUND_SO = vars(_EXAMPLE) == vars(_bound(_EXAMPLE.__func__, _EXAMPLE.__self__))


def has_numbers(*values: Any) -> bool:
    """Whether all values are numbers or arrays of numbers, none of them traced or a placeholder."""

    def is_number(value: Any) -> bool:
        if isinstance(value, bool | jax.core.Tracer):
            return False
        is_array = isinstance(value, np.ndarray | np.generic | jax.Array)
        return isinstance(value, int | float) or (is_array and value.dtype.kind in "fiu")

    return all(map(is_number, values))


def range_text(values: Any, digits: int) -> str:
    """A number as text, or the least and the largest of many: `12.5`, `12.5 to 13.0`."""
    numbers = np.asarray(values, np.float64)
    known = numbers[np.isfinite(numbers)]
    if not known.size:
        return "unknown"
    texts = dict.fromkeys(f"{one:z.{digits}f}" for one in (known.min(), known.max()))
    return " to ".join(texts)


def portable(cls: type[T]) -> type[T]:
    """Class decorator: pickle a `NamedTuple` or dataclass like a `Record`; also for exceptions with extra arguments."""
    if issubclass(cls, BaseException):
        cls.__reduce__ = lambda self: (_loaded_error, (type(self), self.args, dict(vars(self))))
    elif issubclass(cls, tuple):
        cls.__reduce__ = lambda self: (_loaded_tuple, (type(self), packed(list(self))))  # pyright: ignore
    else:
        cls.__reduce__ = lambda self: (_loaded, (type(self), packed(dict(vars(self)))))  # pyright: ignore
    return cls


class _JaxArray:
    """The values of a `jax.Array` inside a pickle."""

    def __init__(self, values: np.ndarray):
        self.values = values


_TURN_ON = "Call jaxgeo.enable_x64() at the start of the program, or set JAX_ENABLE_X64=1."


def packed(value: Any) -> Any:
    """A field, or a container of plain Python, with JAX arrays converted to NumPy arrays; records pack themselves."""
    if isinstance(value, jax.Array) and not isinstance(value, jax.core.Tracer):
        is_key = jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        return value if is_key else _JaxArray(np.asarray(value))
    return _walked(packed, value)


def unpacked(value: Any) -> Any:
    if isinstance(value, _JaxArray):
        # A process that was forked from one in which JAX runs may not call it: public functions say so.
        return value.values if is_forked_from_jax() else jnp.array(value.values)
    return _walked(unpacked, value)


def _walked(each: Callable[[Any], Any], value: Any) -> Any:
    if isinstance(value, tuple):  # or a NamedTuple
        return tuple.__new__(type(value), (each(item) for item in value))
    if type(value) is list:
        return [each(item) for item in value]
    if type(value) is dict:
        return {name: each(item) for name, item in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type | Record):
        return _filled(type(value), {name: each(item) for name, item in vars(value).items()})
    return value


def check_loading(cls: type) -> None:
    """Raise `RuntimeError` if loading an object of a class would lose digits; enable x64 in a new worker process."""
    if is_x64():
        return
    if _is_new_worker():
        enable_x64()
        return
    raise RuntimeError(
        f"a jaxgeo {cls.__name__} cannot be loaded while JAX is set to 32 bits: its positions would be off by up to "
        f"half a metre. {_TURN_ON}{_for_workers()}"
    )


def _is_worker() -> bool:
    """Whether `multiprocessing` started this process; `concurrent.futures`, joblib and Dask do so too."""
    module = sys.modules.get("multiprocessing.process")
    return module is not None and module.current_process().name != "MainProcess"


def _is_new_worker() -> bool:
    """Whether this is a worker process without an explicit choice of 32 bits in which JAX has computed nothing yet."""
    return _is_worker() and "JAX_ENABLE_X64" not in os.environ and not xla_bridge.backends_are_initialized()


def _for_workers() -> str:
    """Advice for worker processes, for error messages."""
    if not _is_worker():
        return ""
    if "distributed" in sys.modules:
        return " For the workers of Dask: client.register_worker_callbacks(jaxgeo.enable_x64), before other work."
    return " For the workers of a pool: initializer=jaxgeo.enable_x64."


def _loaded(cls: type[T], state: dict[str, Any]) -> T:
    check_loading(cls)
    return _filled(cls, unpacked(state))


def _filled(cls: type[T], state: dict[str, Any]) -> T:
    record = object.__new__(cls)
    for name, value in state.items():
        object.__setattr__(record, name, value)
    return record


def _loaded_tuple(cls: type[T], items: list[Any]) -> T:
    check_loading(cls)
    return tuple.__new__(cls, unpacked(items))  # pyright: ignore


def _loaded_error(cls: type[T], args: tuple[Any, ...], state: dict[str, Any]) -> T:
    error = cls.__new__(cls, *args)
    vars(error).update(state)
    return error
