"""Whether Python was started as the command `jaxgeo`, which then ends on Ctrl-C in one line from here on.

The package imports this first of all. It loads nothing that Python has not loaded at its start: the module `signal`
alone takes several milliseconds, in which an interruption would end in a traceback.
"""

from __future__ import annotations

import _signal  # pyright: ignore[reportMissingImports]
import os
import sys


def is_command() -> bool:
    """Whether Python was started as `jaxgeo` or `python -m jaxgeo`, and is not a program that imports it."""
    words = getattr(sys, "argv", None) or [""]
    if words[0] == "-m":  # while Python looks for the module
        return sys.orig_argv[-len(words)].removeprefix("-m") in ("jaxgeo", "jaxgeo.__main__", "jaxgeo.cli")
    return os.path.basename(words[0]).lower().removesuffix(".exe") == "jaxgeo"


def end_on_interruption() -> None:
    """Handle Ctrl-C until `jaxgeo._interruption` is loaded, unless the caller has the process ignore it."""
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _end)


def _end(number: int, _: object) -> None:
    os.write(2, b"jaxgeo: interrupted\n")
    os._exit(128 + number)
