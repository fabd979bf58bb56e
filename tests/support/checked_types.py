"""Run-time type checker of the tests: `beartype`, whose checks are made when a function is first called."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from beartype import beartype

checks: dict[tuple[str, ...], Callable[..., Any]] = {}  # the last ones of beartype, by module, name and what is checked


def on_first_call(function: Callable[..., Any]) -> Callable[..., Any]:
    """`beartype(function)`, made at the first call: most functions of the package are not called in one process.

    `function` has a signature and does nothing, so that its checks also serve a function within another, which is a new
    one in each call of that.
    """
    checked: list[Callable[..., Any]] = []

    def call(*args: Any, **options: Any) -> Any:
        if not checked:
            checked.append(_checks_of(function))
        return checked[0](*args, **options)

    return call


def _checks_of(function: Callable[..., Any]) -> Callable[..., Any]:
    name = function.__module__, function.__qualname__, *function.__annotations__
    # Annotations differ, as classes do, if a module was imported once more.
    if name not in checks or checks[name].__annotations__ != function.__annotations__:
        checks[name] = beartype(function)
    return checks[name]
