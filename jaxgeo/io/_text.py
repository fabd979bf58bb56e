"""Text files in the encodings of other programs: UTF-8 with or without BOM, UTF-16, or Windows 1252."""

from __future__ import annotations

import os

from jaxgeo.io._bounded import read_bytes
from jaxgeo.io._regular import check_regular
from jaxgeo.io.errors import TableError

MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}  # first bytes: encoding
CONTROLS = frozenset(map(chr, range(32))) - set("\t\n\r\f\v") | {"\x7f"}


def read_text(path: str | os.PathLike[str], what: str) -> str:
    """The content of a text file in any of these encodings; `what` describes it in messages.

    Raises `TableError` in one line for a folder, a file that is unreadable, empty, too long or not text;
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
        raise TableError(f"{path}: not a text file, so no {what}.")
    return text


def text_of(content: bytes, *, is_cut: bool = False) -> str | None:
    """Decode bytes to text, or None if they are not text; `is_cut` if they are the first of a longer file.

    Tried in order: the BOM, UTF-16 without one, UTF-8, and Windows code page 1252, which
    Excel writes in western Europe (it includes all printable characters of ISO 8859-1).
    """
    ways = ([MARKS[mark] for mark in MARKS if content.startswith(mark)] or _guessed(content))[:2]
    for encoding in ways:
        for end in range(4 if is_cut else 1):  # bytes of a truncated character
            try:
                text = content[: len(content) - end].decode(encoding)
            except UnicodeDecodeError:
                continue
            return None if CONTROLS & set(text) else text
    return None


def _guessed(content: bytes) -> list[str]:
    """Encodings to try without a BOM."""
    head = content[:256]
    for encoding, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):
        if len(zeros) > 1 and zeros.count(0) > 0.7 * len(zeros):
            return [encoding]
    return ["utf-8", "cp1252"]
