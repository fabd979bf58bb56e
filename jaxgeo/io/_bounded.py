"""Reading of whole files within the limits of `limits`, and checks of nesting depth."""

from __future__ import annotations

import bz2
import os
import re
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO

import numpy as np

from jaxgeo.io.limits import FILE_BYTES, NESTING, UNPACKED_ALWAYS, UNPACKED_BYTES, UNPACKED_RATIO, Limit

PART = 2**20  # bytes read at a time
# A JSON string, or the rest of a file that ends within one; without backtracking, so that its time is linear.
_STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+(?:"|\\?\Z)', re.DOTALL)
_PART = r"(?:(?<![\w-])[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')[ \t]*+"
_DOTTED = re.compile(rf"(?:{_PART}\.[ \t]*+){{{NESTING.most},}}+")
_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def read_bytes(path: str | os.PathLike[str], limit: Limit = FILE_BYTES) -> bytes:
    """All bytes of a file. Raises `OSError`, and `TableError` above the limit."""
    with open(path, "rb") as file:
        limit.check(path, os.fstat(file.fileno()).st_size)
        return _whole(path, file, limit)


def unpacked(path: str | os.PathLike[str]) -> bytes:
    """All bytes of a file, decompressed if it is a .bz2.

    Raises `OSError` and `EOFError` for invalid files; `TableError` above the limits.
    """
    if not os.fspath(path).endswith(".bz2"):
        return read_bytes(path)
    size = os.stat(path).st_size
    with bz2.open(path, "rb") as file:
        most = max(UNPACKED_RATIO.most * size, UNPACKED_ALWAYS)
        if most < UNPACKED_BYTES.most:
            content = _up_to(file, most)
            if content is None:
                raise UNPACKED_RATIO.refusal(path, None)
            return content
        return _whole(path, file, UNPACKED_BYTES)


def check_nesting_of_json(path: str | os.PathLike[str], content: bytes) -> None:
    """Raises `TableError` for JSON nested too deeply, before it is parsed."""
    brackets = np.frombuffer(_STRING.sub(b"", content).translate(None, _NO_BRACKETS), np.uint8)
    depth = 0
    for start in range(0, len(brackets), PART):
        steps = np.where(np.isin(brackets[start : start + PART], (ord("["), ord("{"))), 1, -1)
        depths = depth + np.cumsum(steps)
        if depths.max() > NESTING.most:
            raise NESTING.refusal(path, None)
        depth = int(depths[-1])


def check_dotted_keys(path: str | os.PathLike[str], text: str) -> None:
    """Raises `TableError` for TOML with a dotted key of too many parts, each of which is a nested table.

    Call it before parsing, whose time and memory grow with the square of the parts.
    """
    if _DOTTED.search(text):
        raise NESTING.refusal(path, None)


def check_nesting(path: str | os.PathLike[str], content: Any) -> None:
    """Raises `TableError` for parsed content nested too deeply."""
    level: list[Any] = [content]
    for _ in range(NESTING.most):
        level = [inner for outer in level for inner in _inside(outer)]
        if not level:
            return
    raise NESTING.refusal(path, None)


def _inside(content: Any) -> Iterable[Any]:
    parts = content.values() if isinstance(content, Mapping) else content if isinstance(content, list) else ()
    return (part for part in parts if isinstance(part, Mapping | list))


def _whole(path: Any, file: Any, limit: Limit) -> bytes:
    content = _up_to(file, limit.most)
    if content is None:
        raise limit.refusal(path, None)
    return content


def _up_to(file: BinaryIO | Any, most: int) -> bytes | None:
    """All bytes of an open file, None if there are more than `most`."""
    parts, size = [], 0
    while part := file.read(PART):
        size += len(part)
        if size > most:
            return None
        parts.append(part)
    return b"".join(parts)
