"""Bytes of files, read as a whole within the limits of `limits`; and how deep lists lie within each other."""

from __future__ import annotations

import bz2
import os
import re
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO

import numpy as np

from jaxgeo.io.limits import FILE_BYTES, NESTING, UNPACKED_ALWAYS, UNPACKED_BYTES, UNPACKED_RATIO, Limit

PART = 2**20  # bytes that are read at a time
# A string of JSON, or the rest of a file that ends within one; without a way back, so that its time is linear.
_STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+(?:"|\\?\Z)', re.DOTALL)
_PART = r"(?:(?<![\w-])[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')[ \t]*+"
_DOTTED = re.compile(rf"(?:{_PART}\.[ \t]*+){{{NESTING.most},}}+")
_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


def read_bytes(path: str | os.PathLike[str], limit: Limit = FILE_BYTES) -> bytes:
    """All bytes of a file. Raises `OSError`, and `TableError` where there are more than the limit allows."""
    with open(path, "rb") as file:
        limit.check(path, os.fstat(file.fileno()).st_size)
        return _whole(path, file, limit)


def unpacked(path: str | os.PathLike[str]) -> bytes:
    """All bytes of a file, those of a .bz2 unpacked.

    Raises `OSError` and `EOFError` for what is no such file; `TableError` for more bytes than the limits allow.
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
    """Raises `TableError` for JSON whose lists and tables lie too deep within each other, before it is parsed."""
    brackets = np.frombuffer(_STRING.sub(b"", content).translate(None, _NO_BRACKETS), np.uint8)
    depth = 0
    for start in range(0, len(brackets), PART):
        steps = np.where(np.isin(brackets[start : start + PART], (ord("["), ord("{"))), 1, -1)
        depths = depth + np.cumsum(steps)
        if depths.max() > NESTING.most:
            raise NESTING.refusal(path, None)
        depth = int(depths[-1])


def check_dotted_keys(path: str | os.PathLike[str], text: str) -> None:
    """Raises `TableError` for TOML with a key of too many parts, a.b.c, each of which is a table within the last.

    To be called before it is parsed: the time and memory of that grow with the square of the parts.
    """
    if _DOTTED.search(text):
        raise NESTING.refusal(path, None)


def check_nesting(path: str | os.PathLike[str], content: Any) -> None:
    """Raises `TableError` for parsed content whose lists and tables lie too deep within each other."""
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
    """All bytes of an open file, None where there are more than `most`."""
    parts, size = [], 0
    while part := file.read(PART):
        size += len(part)
        if size > most:
            return None
        parts.append(part)
    return b"".join(parts)
