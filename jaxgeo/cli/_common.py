"""Error reporting, exit codes and output-path checks shared by the commands."""

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
from jaxgeo._refusals import is_refusal
from jaxgeo.cli._screen import print_message

DONE, NO_ANSWER, MISTAKE, FAULT, INTERRUPTED = 0, 1, 2, 70, 130  # exit codes; 70 as in sysexits.h, 130 as shells do

Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


class UserError(Exception):
    """A usage or input error, reported in one message."""


@contextlib.contextmanager
def report_errors(debug: bool) -> Iterator[None]:
    """Report exceptions as one message on stderr: exit code 2 for a caller's error, 70 for an internal error.

    `is_refusal` decides which: a `KeyError`, or a `ValueError` not raised by this package, is an internal error.
    With `debug`, the traceback precedes the message.
    """
    try:
        with _suppress_gdal_messages():
            yield
    except (typer.Exit, typer.Abort, BrokenPipeError):
        raise
    except Exception as error:
        if isinstance(error, UserError) or is_refusal(error):
            _end(reason_of_system(error) or str(error) or type(error).__name__, MISTAKE, debug)
        reason = " ".join(str(error).split())
        if _is_of_memory(error):
            said = f"out of memory{f' ({reason})' if reason else ''}; "
            _end(f"{said}use fewer pixels, cells or samples at once.", MISTAKE, debug)
        said = f"internal error: unexpected {type(error).__name__}{f' ({reason})' if reason else ''}"
        _end(f"{said}; run again with --debug for the traceback, and report it.", FAULT, debug)


def reason_of_system(error: BaseException) -> str:
    """The message of an `OSError`, for its file or for the output; empty for other errors."""
    if not isinstance(error, OSError) or error.strerror is None:
        return ""
    if error.filename is not None:
        return f"{os.fsdecode(error.filename)}: {error.strerror}."
    if error.errno in DEVICE_FAILURES:
        return f"the output cannot be written: {error.strerror}; free some space, or choose another place."
    return f"{error.strerror}."


@contextlib.contextmanager
def _suppress_gdal_messages() -> Iterator[None]:
    """Suppress GDAL messages on damaged files that rasterio cannot decode: Python would print a traceback."""
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
    print_message(message)
    raise typer.Exit(code) from None


def _is_of_memory(error: Exception) -> bool:
    """Whether NumPy or XLA ran out of memory."""
    return isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and "RESOURCE_EXHAUSTED" in str(error))


def name_says(output: pathlib.Path) -> str:
    """Why the name of a file determines no format."""
    return f"unsupported file type {output.suffix}" if output.suffix else "the name has no extension"


def check_writable(folder: pathlib.Path) -> None:
    """Raises `UserError` if the output folder is a file or not writable; it is not created."""
    if folder.exists() and not folder.is_dir():
        raise UserError(f"--output {folder}: this is a file; name a folder for the results.")
    nearest = next(one for one in (folder, *folder.absolute().parents) if one.exists())
    if not nearest.is_dir():
        raise UserError(f"--output {folder}: {nearest} is a file; name another folder.")
    if not os.access(nearest, os.W_OK):
        raise UserError(f"--output {folder}: not writable; name another folder.")


def counted(count: int, noun: str) -> str:
    """A count and its noun, in the plural unless it is one."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
