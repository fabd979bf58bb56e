"""Typer's runner of commands. It makes a group of commands anew for each call, which takes 0.1 s: here once."""

from __future__ import annotations

import functools
import os
from typing import Any

import typer.testing
from typer.main import get_command
from typer.testing import CliRunner

__all__ = ["CliRunner"]

DETECTION = "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION"  # options of completion depend on it


@functools.cache
def _made(app: typer.Typer, _: str | None) -> Any:
    return get_command(app)


typer.testing._get_command = lambda app: _made(app, os.environ.get(DETECTION))  # pyright: ignore
