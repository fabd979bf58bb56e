"""Text files as other programs save them: UTF-8 with or without a mark, UTF-16, or the old code page of Windows."""

from __future__ import annotations

import os

from jaxgeo.io._bounded import read_bytes
from jaxgeo.io._regular import check_regular
from jaxgeo.io.errors import TableError

MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}  # first bytes: encoding
CONTROLS = frozenset(map(chr, range(32))) - set("\t\n\r\f\v") | {"\x7f"}


def read_text(path: str | os.PathLike[str], what: str) -> str:
    """What a text file holds, in whatever encoding; `what` it is, for messages.

    Raises `TableError` in one line for a folder, a file that cannot be read, is empty, too long or no text;
    `FileNotFoundError`.
    """
    check_regular(path, TableError)
    try:
        content = read_bytes(path)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such {what}.") from None
    except IsADirectoryError:
        raise TableError(f"{path}: this is a folder; give the {what} in it.") from None
    except OSError as error:
        raise TableError(f"{path}: the {what} cannot be read: {error.strerror}.") from error
    if not content.strip():
        raise TableError(f"{path}: the {what} is empty.")
    text = text_of(content)
    if text is None:
        raise TableError(f"{path}: not a text file, so not a {what}.")
    return text


def text_of(content: bytes, *, is_cut: bool = False) -> str | None:
    """The text in some bytes, or None where they hold none; `is_cut` where they are the first of a longer file.

    Tried in order: the mark at the beginning, UTF-16 without one, UTF-8, and the code page 1252 of Windows, which
    Excel writes in western Europe (all of ISO 8859-1 that is printed is in it).
    """
    ways = ([MARKS[mark] for mark in MARKS if content.startswith(mark)] or _guessed(content))[:2]
    for encoding in ways:
        for end in range(4 if is_cut else 1):  # of a character that is cut off
            try:
                text = content[: len(content) - end].decode(encoding)
            except UnicodeDecodeError:
                continue
            return None if CONTROLS & set(text) else text
    return None


def _guessed(content: bytes) -> list[str]:
    """Encodings to be tried where no mark names one."""
    head = content[:256]
    for encoding, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):
        if len(zeros) > 1 and zeros.count(0) > 0.7 * len(zeros):
            return [encoding]
    return ["utf-8", "cp1252"]
