"""Run-time type checker of the tests: `beartype`, whose checks are made when a function is first called."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from beartype import beartype


def on_first_call(function: Callable[..., Any]) -> Callable[..., Any]:
    """`beartype(function)`, made at the first call: most functions of the package are not called in one process."""
    checked: list[Callable[..., Any]] = []

    def call(*args: Any, **options: Any) -> Any:
        if not checked:
            checked.append(beartype(function))
        return checked[0](*args, **options)

    return call
