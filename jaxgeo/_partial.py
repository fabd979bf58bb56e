"""Temporary files beside a target, which they replace when complete."""

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
    """Path of a hidden file in the folder of `target`; it is moved to `target` by the caller, otherwise removed.

    Also removed are files whose names extend it, as GDAL creates them, and those left behind by a killed process.
    """
    for one in left_over(target.parent, PARTIAL):
        with contextlib.suppress(OSError):  # owned by another user
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
    """A new hidden name beside `target` that encodes the machine and the process id."""
    return target.with_name(f".jaxgeo-{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{ending}")


def left_over(folder: pathlib.Path, ending: str) -> list[pathlib.Path]:
    """Hidden files with this ending in a folder that a killed process of this machine left behind."""
    if os.name != "posix":  # os.kill(pid, 0) is not a harmless check elsewhere
        return []
    ours = re.compile(rf"\.jaxgeo-{_machine()}-(\d+)-[0-9a-f]{{8}}{re.escape(ending)}")
    named = [(path, ours.match(path.name)) for path in folder.glob(".jaxgeo-*")]
    return [path for path, name in named if name is not None and not _is_running(int(name[1]))]


def _machine() -> str:
    """Hash of this machine or container: process ids are meaningless on another machine that shares the folder."""
    told = os.uname().nodename if hasattr(os, "uname") else ""
    with contextlib.suppress(OSError):
        told += os.readlink("/proc/self/ns/pid")
    return f"{zlib.crc32(told.encode()):08x}"


def _is_running(number: int) -> bool:
    try:
        os.kill(number, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # owned by another user
        return True
    return True
