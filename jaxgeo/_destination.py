"""Where results go: the screen, a device, or a file that appears only when it is whole."""

from __future__ import annotations

import contextlib
import errno
import os
import pathlib
import secrets
import shutil
import sys
from collections.abc import Iterable, Iterator
from typing import Any

SCREEN = pathlib.Path("-")
UNWRITABLE = "backslashreplace"  # how text that UTF-8 cannot hold is written: bytes of a file's name that are no UTF-8
# What the system says where bytes cannot be written: no room, too large a file, a quota, a fault of the device.
DEVICE_FAILURES = frozenset({errno.ENOSPC, errno.EFBIG, errno.EIO, getattr(errno, "EDQUOT", errno.ENOSPC)})


class DestinationError(ValueError):
    """Results cannot be written where the caller asked."""


@contextlib.contextmanager
def destination(option: str, output: pathlib.Path | None, *, binary: bool = False) -> Iterator[Any]:
    """The screen, a device, or a file that appears only when all of it is written.

    It is opened before the work, so that a place that cannot be written to is told at once. Raises `DestinationError`.
    """
    if output is None or output == SCREEN:
        yield sys.stdout.buffer if binary else sys.stdout
    elif is_device(output):
        with _failure_told(option, output, only=DEVICE_FAILURES), _opened(option, output, output, binary) as stream:
            yield stream
    else:
        check_place(option, output)
        target = output.resolve()  # a link stays a link
        partial = target.with_name(f".jaxgeo-{secrets.token_hex(4)}.partial")
        stream = _opened(option, output, partial, binary)
        try:
            with _failure_told(option, output, only=DEVICE_FAILURES):
                with stream:
                    yield stream
                if target.exists():
                    shutil.copymode(target, partial)
                partial.replace(target)
        finally:
            partial.unlink(missing_ok=True)


def is_device(output: pathlib.Path) -> bool:
    """Whether a path is a pipe, a terminal, /dev/null, /dev/stdout or "-", the screen: no file that another may take
    the place of."""
    if output == SCREEN:
        return True
    of_the_system = os.path.islink(output) and output.absolute().is_relative_to("/dev")
    of_a_process = output.absolute().is_relative_to("/proc")
    is_file_or_folder = os.path.isfile(output) or os.path.isdir(output)
    return of_the_system or of_a_process or (os.path.exists(output) and not is_file_or_folder)


def check_place(option: str, output: pathlib.Path) -> None:
    """Raises `DestinationError` where a file cannot be written: in no folder, onto a folder, without permission."""
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
    """Raises `DestinationError` where a file to be written is one that is read, by whatever name or link."""
    read = [pathlib.Path(path) for path in inputs]
    for output in outputs:
        if any(_are_one(output, path) for path in read):
            raise DestinationError(f"{option} {output}: this is an input, and would be overwritten; name another.")


def _are_one(one: pathlib.Path, other: pathlib.Path) -> bool:
    with contextlib.suppress(OSError, RuntimeError):  # one is not there, or no file's name, or links go in a circle
        return one.resolve() == other.resolve() or one.samefile(other)
    return False


@contextlib.contextmanager
def _failure_told(option: str, output: pathlib.Path, only: frozenset[int] | None = None) -> Iterator[None]:
    """Failures of the system as `DestinationError`; `only` those of some numbers that name no file of their own."""
    try:
        yield
    except OSError as error:
        if only is not None and (error.errno not in only or error.filename is not None):
            raise
        raise DestinationError(
            f"{option} {output}: it cannot be written: {error.strerror}; name another file."
        ) from error
