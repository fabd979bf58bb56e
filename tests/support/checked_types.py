"""Run-time type checker of the tests: `beartype`, whose checks are made when a function is first called."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from typing import Any

from beartype import beartype

MOST = 100  # checked calls of one function in a process: some are called a hundred thousand times


def on_first_call(function: Callable[..., Any]) -> Callable[..., Any]:
    """`beartype(function)`, made at the first call: most functions of the package are not called in one process."""
    checked: list[Callable[..., Any]] = []
    calls = 0

    def call(*args: Any, **options: Any) -> Any:
        nonlocal calls
        if not checked:
            checked.append(beartype(function))
        calls += 1
        if calls == MOST:
            _end_checks_of(function)
        return checked[0](*args, **options)

    return call


def _end_checks_of(function: Callable[..., Any]) -> None:
    """Let jaxtyping call the function of this module and name without a check; not one defined within another."""
    found: Any = sys.modules.get(function.__module__)
    for name in function.__qualname__.split("."):
        found = inspect.getattr_static(found, name, None)
        found = getattr(found, "fget" if isinstance(found, property) else "__func__", found)
    while inspect.isfunction(found):
        found.__no_type_check__ = True  # pyright: ignore[reportFunctionMemberAccess]
        found = getattr(found, "__wrapped__", None)
