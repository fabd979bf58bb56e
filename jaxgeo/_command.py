"""Ctrl-C and garbage of the command `jaxgeo` during start-up.

The package imports this module first. It imports only what Python has already loaded: importing `signal` alone takes
several milliseconds, during which Ctrl-C would end in a traceback.
"""

from __future__ import annotations

import _signal  # pyright: ignore[reportMissingImports]
import gc
import os
import sys


def is_command() -> bool:
    """Whether Python was started as `jaxgeo` or `python -m jaxgeo`, rather than by a program that imports jaxgeo."""
    words = getattr(sys, "argv", None) or [""]
    if words[0] == "-m":  # while Python locates the module
        return sys.orig_argv[-len(words)].removeprefix("-m") in ("jaxgeo", "jaxgeo.__main__", "jaxgeo.cli")
    return os.path.basename(words[0]).lower().removesuffix(".exe") == "jaxgeo"


def collect_later() -> None:
    """Leave garbage until `collect_again`: what an import makes stays."""
    gc.disable()


def collect_again() -> None:
    """Collect garbage again, rarely, and without going through what is loaded; nothing if it was collected anyway."""
    if gc.isenabled():
        return
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


def end_on_interruption() -> None:
    """Exit on Ctrl-C until `jaxgeo._interruption` is loaded, unless the parent process set SIGINT to be ignored."""
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _end)


def _end(number: int, _: object) -> None:
    os.write(2, b"jaxgeo: interrupted\n")
    os._exit(128 + number)
