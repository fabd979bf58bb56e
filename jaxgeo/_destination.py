"""Output destinations: screen, device, or a file that is written atomically."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
import shutil
import sys
from collections.abc import Iterable, Iterator
from typing import Any

from jaxgeo._partial import partial_file

SCREEN = pathlib.Path("-")
UNWRITABLE = "backslashreplace"  # for text that UTF-8 cannot encode, such as file names with invalid bytes
# Write failures of the system: disk full, file too large, quota exceeded, I/O error.
DEVICE_FAILURES = frozenset({errno.ENOSPC, errno.EFBIG, errno.EIO, getattr(errno, "EDQUOT", errno.ENOSPC)})


class DestinationError(ValueError):
    """Results cannot be written to the requested destination."""


@contextlib.contextmanager
def destination(option: str, output: pathlib.Path | None, *, binary: bool = False) -> Iterator[Any]:
    """Stream to the screen, a device, or a file that appears only once it is completely written.

    It is opened before the computation starts, so a destination that cannot be written is reported at once.
    Raises `DestinationError`.
    """
    if output is None or output == SCREEN:
        yield sys.stdout.buffer if binary else sys.stdout
    elif is_device(output):
        with _failure_told(option, output, only=DEVICE_FAILURES), _opened(option, output, output, binary) as stream:
            yield stream
    else:
        check_place(option, output)
        target = output.resolve()  # keep a symbolic link, replace its target
        with partial_file(target) as partial:
            stream = _opened(option, output, partial, binary)
            with _failure_told(option, output, only=DEVICE_FAILURES):
                with stream:
                    yield stream
                if target.exists():
                    shutil.copymode(target, partial)
                partial.replace(target)


def is_device(output: pathlib.Path) -> bool:
    """Whether a path is the screen ("-"), a pipe, a terminal, /dev/null or /dev/stdout: not a replaceable file."""
    if output == SCREEN:
        return True
    of_the_system = os.path.islink(output) and output.absolute().is_relative_to("/dev")
    of_a_process = output.absolute().is_relative_to("/proc")
    is_file_or_folder = os.path.isfile(output) or os.path.isdir(output)
    return of_the_system or of_a_process or (os.path.exists(output) and not is_file_or_folder)


def check_place(option: str, output: pathlib.Path) -> None:
    """Raise `DestinationError` if a file cannot be written: missing folder, path is a folder, or no permission."""
    with _failure_told(option, output), contextlib.suppress(FileNotFoundError):
        output.stat()
    if output.is_dir():
        raise DestinationError(f"{option} {output}: this is a folder; give the name of a file in it.")
    folder = output.resolve().parent
    if not folder.is_dir():
        raise DestinationError(
            f"{option} {output}: there is no folder {output.parent}; make it first, or name another."
        )
    if not os.access(output if output.exists() else folder, os.W_OK):
        raise DestinationError(
            f"{option} {output}: it may not be written; name another file, or change its permissions."
        )


def _opened(option: str, output: pathlib.Path, path: pathlib.Path, binary: bool) -> Any:
    with _failure_told(option, output):
        return open(path, "wb") if binary else open(path, "w", newline="", encoding="utf-8", errors=UNWRITABLE)


def check_no_input(option: str, outputs: Iterable[pathlib.Path], inputs: Iterable[str | os.PathLike[str]]) -> None:
    """Raise `DestinationError` if an output file is also an input, under any name or link."""
    read = [pathlib.Path(path) for path in inputs]
    for output in outputs:
        if any(_are_one(output, path) for path in read):
            raise DestinationError(f"{option} {output}: this is an input, and would be overwritten; name another.")


def _are_one(one: pathlib.Path, other: pathlib.Path) -> bool:
    with contextlib.suppress(OSError, RuntimeError):  # missing file, invalid name or circular link
        return one.resolve() == other.resolve() or one.samefile(other)
    return False


@contextlib.contextmanager
def _failure_told(option: str, output: pathlib.Path, only: frozenset[int] | None = None) -> Iterator[None]:
    """Convert an `OSError` to `DestinationError`; with `only`, just those error numbers, if they name no other file."""
    try:
        yield
    except OSError as error:
        if only is not None and (error.errno is None or error.errno not in only or error.filename is not None):
            raise
        raise DestinationError(
            f"{option} {output}: it cannot be written: {error.strerror}; name another file."
        ) from error
