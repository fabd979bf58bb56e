"""Deprecated names: each returns the object of its new name with a `DeprecationWarning`, for one release."""

from __future__ import annotations

import functools
import importlib
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

T = TypeVar("T")


def renamed(package: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """A module `__getattr__` that maps the old `names` of a `package` to their new ones."""

    def __getattr__(name: str) -> Any:
        new = names.get(name)
        if new is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        warn_renamed(f"{package}.{name}", f"{package}.{new}")
        return getattr(importlib.import_module(package), new)

    return __getattr__


def renamed_argument(old: str, new: str) -> Callable[[Callable[..., T]], Callable[..., T]]:
    """Decorator that passes a keyword argument by its old name on by its new one, with a `DeprecationWarning`."""

    def decorate(function: Callable[..., T]) -> Callable[..., T]:
        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> T:
            if old in kwargs:
                warn_renamed(f"{function.__name__}({old}=)", f"{new}=")
                kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return call

    return decorate


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """A `DeprecationWarning` of an old name, by default at the line that calls the caller."""
    warnings.warn(f"{old} is now {new}; the old name goes with version 0.3.", DeprecationWarning, stacklevel=stacklevel)
