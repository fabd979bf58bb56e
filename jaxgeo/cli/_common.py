"""What the commands share: mistakes in one message, endings of names, and a compiler that does not dawdle."""

from __future__ import annotations

import contextlib
import os
import pathlib
import subprocess
import sys
from collections.abc import Iterator
from typing import Annotated

import typer

from jaxgeo.cli._screen import tell

QUICK_TO_COMPILE = "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"

Traceback = Annotated[bool, typer.Option("--traceback", help="Show where an error was raised.")]


class UserError(Exception):
    """A mistake of the caller's, told in one message."""


@contextlib.contextmanager
def mistakes_told(show_traceback: bool) -> Iterator[None]:
    """Callers' mistakes as one message on stderr and exit code 2."""
    try:
        yield
    except (UserError, ValueError, OSError) as error:
        if show_traceback:
            raise
        tell(str(error) or type(error).__name__)
        raise typer.Exit(2) from None
    except (MemoryError, RuntimeError) as error:
        if show_traceback or not _is_of_memory(error):
            raise
        reason = " ".join(str(error).split())
        told = f" ({reason})" if reason else ""
        tell(f"there is not enough memory for this{told}; ask for fewer pixels, cells or samples at once.")
        raise typer.Exit(2) from None


def _is_of_memory(error: MemoryError | RuntimeError) -> bool:
    """Whether memory ran out, NumPy's or XLA's."""
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)


def name_says(output: pathlib.Path) -> str:
    """Why a format cannot be told by the name of a file."""
    return f"the ending {output.suffix} is not one that is known" if output.suffix else "the name has no ending"


def compile_quickly() -> None:
    """Have XLA compile in half the time what is computed only a few times; before anything is computed.

    A version of XLA that does not know the flags would end the process, so another process tries them first.
    """
    if "XLA_FLAGS" in os.environ:
        return
    environment = {**os.environ, "XLA_FLAGS": QUICK_TO_COMPILE}
    probe = [sys.executable, "-c", "import jax; jax.devices()"]
    if subprocess.run(probe, env=environment, capture_output=True, check=False).returncode == 0:
        os.environ["XLA_FLAGS"] = QUICK_TO_COMPILE
