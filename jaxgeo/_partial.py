"""Files that are being written: hidden beside the one whose place they take when they are whole."""

from __future__ import annotations

import contextlib
import os
import pathlib
import re
import secrets
import zlib
from collections.abc import Iterator

from jaxgeo._interruption import undone_if_stopped

PARTIAL = ".partial"


@contextlib.contextmanager
def partial_file(target: pathlib.Path) -> Iterator[pathlib.Path]:
    """The name of a hidden file in the folder of `target`, to be written and moved to it; else it is removed.

    So are files whose names go on after it, as GDAL makes them, and those that a killed process has left there.
    """
    for one in left_over(target.parent, PARTIAL):
        with contextlib.suppress(OSError):  # another user's
            one.unlink()
    path = hidden_name(target, PARTIAL)

    def remove() -> None:
        for one in target.parent.glob(f"{path.name}*"):
            one.unlink(missing_ok=True)

    with undone_if_stopped(remove):
        try:
            yield path
        finally:
            remove()


def hidden_name(target: pathlib.Path, ending: str) -> pathlib.Path:
    """A name beside `target` that is new, and tells which process of which machine it belongs to."""
    return target.with_name(f".jaxgeo-{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{ending}")


def left_over(folder: pathlib.Path, ending: str) -> list[pathlib.Path]:
    """What has a hidden name with this ending in a folder, and belongs to a process of this machine that was killed."""
    if os.name != "posix":  # where a process is not looked up without harm
        return []
    ours = re.compile(rf"\.jaxgeo-{_machine()}-(\d+)-[0-9a-f]{{8}}{re.escape(ending)}")
    named = [(path, ours.match(path.name)) for path in folder.glob(".jaxgeo-*")]
    return [path for path, name in named if name is not None and not _is_running(int(name[1]))]


def _machine() -> str:
    """A word for this machine, or container: numbers of processes mean nothing on another that shares the folder."""
    told = os.uname().nodename if hasattr(os, "uname") else ""
    with contextlib.suppress(OSError):
        told += os.readlink("/proc/self/ns/pid")
    return f"{zlib.crc32(told.encode()):08x}"


def _is_running(number: int) -> bool:
    try:
        os.kill(number, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # another user's
        return True
    return True
