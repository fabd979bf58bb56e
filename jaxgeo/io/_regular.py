"""Refusal of pipes, sockets and devices, which may block or never end."""

from __future__ import annotations

import os
import stat

_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def check_regular(path: str | os.PathLike[str], error: type[ValueError]) -> None:
    """Raise `error` for a pipe, a socket or a device, also behind a link, and for an invalid file name.

    Missing files are left to the reader.
    """
    if "\0" in os.fspath(path):
        raise error(f"{os.fspath(path)}: no file can have this name, which has a zero byte in it.")
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    kind = next((name for is_kind, name in _KINDS if is_kind(mode)), None)
    if kind is not None:
        raise error(
            f"{os.fspath(path)}: this is {kind}, not a file. Write what it holds to a file first, and name that."
        )
