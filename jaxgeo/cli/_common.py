"""What the commands share: mistakes in one line, codes of exit, endings of names."""

from __future__ import annotations

import contextlib
import os
import pathlib
import sys
import traceback
from collections.abc import Iterator
from typing import Annotated, Any, NoReturn

import typer

from jaxgeo._destination import DEVICE_FAILURES
from jaxgeo.cli._refusals import is_refusal
from jaxgeo.cli._screen import tell

DONE, NO_ANSWER, MISTAKE, FAULT, INTERRUPTED = 0, 1, 2, 70, 130  # codes of exit; 70 as in sysexits.h, 130 as shells do

Debug = Annotated[bool, typer.Option("--debug", help="Show where an error was raised.")]


class UserError(Exception):
    """A mistake of the caller's, reported in one message."""


@contextlib.contextmanager
def report_errors(debug: bool) -> Iterator[None]:
    """What goes wrong as one message on stderr: exit code 2 for a caller's mistake, 70 for a fault of the program's.

    `is_refusal` decides which: a `KeyError`, or a `ValueError` that nobody raised for the caller, is a fault.
    With `debug`, the message stands below the traceback.
    """
    try:
        with _words_of_gdal_dropped():
            yield
    except (typer.Exit, typer.Abort, BrokenPipeError):
        raise
    except Exception as error:
        if isinstance(error, UserError) or is_refusal(error):
            _end(reason_of_system(error) or str(error) or type(error).__name__, MISTAKE, debug)
        reason = " ".join(str(error).split())
        if _is_of_memory(error):
            said = f"there is not enough memory for this{f' ({reason})' if reason else ''}; "
            _end(f"{said}ask for fewer pixels, cells or samples at once.", MISTAKE, debug)
        said = f"unexpected {type(error).__name__}{f' ({reason})' if reason else ''}: a fault of jaxgeo's, not of yours"
        _end(f"{said}; run it again with --debug to see where, and report it.", FAULT, debug)


def reason_of_system(error: BaseException) -> str:
    """What the system says of a file, or of the output where it names none; empty for other errors."""
    if not isinstance(error, OSError) or error.strerror is None:
        return ""
    if error.filename is not None:
        return f"{os.fsdecode(error.filename)}: {error.strerror}."
    if error.errno in DEVICE_FAILURES:
        return f"the output cannot be written: {error.strerror}; make room, or send it elsewhere."
    return f"{error.strerror}."


@contextlib.contextmanager
def _words_of_gdal_dropped() -> Iterator[None]:
    """Drop what rasterio cannot decode of GDAL's messages over a damaged file: Python prints it with a traceback."""
    before = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        if not (isinstance(unraisable.exc_value, UnicodeDecodeError) and "rasterio" in str(unraisable.object)):
            before(unraisable)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


def _end(message: str, code: int, debug: bool) -> NoReturn:
    if debug:
        traceback.print_exc()
    tell(message)
    raise typer.Exit(code) from None


def _is_of_memory(error: Exception) -> bool:
    """Whether memory ran out, NumPy's or XLA's."""
    return isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and "RESOURCE_EXHAUSTED" in str(error))


def name_says(output: pathlib.Path) -> str:
    """Why a format is not determined by the name of a file."""
    return f"the ending {output.suffix} is not one that is known" if output.suffix else "the name has no ending"


def check_writable(folder: pathlib.Path) -> None:
    """Raises `UserError` for a folder of results that is a file, or in which nothing may be written; it is not made."""
    if folder.exists() and not folder.is_dir():
        raise UserError(f"--output {folder}: this is a file; name a folder for the results.")
    nearest = next(one for one in (folder, *folder.absolute().parents) if one.exists())
    if not nearest.is_dir():
        raise UserError(f"--output {folder}: {nearest} is a file; name another folder.")
    if not os.access(nearest, os.W_OK):
        raise UserError(f"--output {folder}: nothing may be written there; name another folder.")
