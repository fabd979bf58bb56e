"""Deprecated names: each returns the object of its new name with a `DeprecationWarning`, for one release."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping
from typing import Any


def renamed(package: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """A module `__getattr__` that maps the old `names` of a `package` to their new ones: names of the package, or full
    names of another (`jaxgeo.ortho.rectify`)."""

    def __getattr__(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, _, new = full_name(package, names[name]).rpartition(".")
        warnings.warn(
            f"{package}.{name} is now {module}.{new}; the old name goes with version 0.3.",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(importlib.import_module(module), new)

    return __getattr__


def full_name(package: str, new: str) -> str:
    """The full name of an entry of `DEPRECATED`."""
    return new if "." in new else f"{package}.{new}"
