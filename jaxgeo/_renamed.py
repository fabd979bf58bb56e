"""Deprecated names: each returns the object of its new name with a `DeprecationWarning`, for one release."""

from __future__ import annotations

import functools
import importlib
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

T = TypeVar("T")


def renamed(package: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """A module `__getattr__` that maps the old `names` of a `package` to their new ones: names of the package, or full
    names of another (`jaxgeo.ortho.rectify`)."""

    def __getattr__(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return _found(f"{package}.{name}", full_name(package, names[name]))

    return __getattr__


def renamed_argument(old: str, new: str) -> Callable[[Callable[..., T]], Callable[..., T]]:
    """Decorator that passes a keyword argument by its old name on by its new one, with a `DeprecationWarning`."""

    def decorate(function: Callable[..., T]) -> Callable[..., T]:
        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> T:
            if old in kwargs:
                name = function.__qualname__.rpartition("<locals>.")[2].removesuffix(".__init__")
                warn_renamed(f"{name}({old}=)", f"{new}=")
                kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return call

    return decorate


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """A `DeprecationWarning` of an old name, by default at the line that calls the caller."""
    warnings.warn(f"{old} is now {new}; the old name goes with version 0.3.", DeprecationWarning, stacklevel=stacklevel)


def moved_method(old: str, new: str) -> Callable[..., Any]:
    """A method `old` that is now the function `new` (full names); it takes the object first."""

    def method(self: Any, *given: Any, **options: Any) -> Any:
        return _found(old, new)(self, *given, **options)

    return method


def _found(old: str, new: str) -> Any:
    """The object of the full name `new`, with a warning that it was `old` at the line of the caller's caller."""
    warn_renamed(old, new, stacklevel=4)
    module, _, name = new.rpartition(".")
    return getattr(importlib.import_module(module), name)


def full_name(package: str, new: str) -> str:
    """The full name of an entry of `DEPRECATED`."""
    return new if "." in new else f"{package}.{new}"
