"""Table layout detection: comments, header, separator and decimal mark."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

from jaxgeo.io._cells import plain_cell
from jaxgeo.io.errors import TableError
from jaxgeo.io.limits import COLUMNS, COMMENT_LINES

SEPARATORS = (",", ";", "\t", "|")  # in order of trial; then white space
WHITE = " "
BY_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
BY_POINT = re.compile(r"[+-]?[0-9]*\.[0-9]+(?:[eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Layout:
    """The header and rows of a table as written, the line in which each row ends, and the comments above.

    `separator` is that of the rows (a space for any white space). In `cells`, decimals have points, whatever the file
    has, and texts are without the apostrophe of `safe_cell`.
    """

    header: list[str]
    lines: list[int]
    cells: list[list[str]]
    comments: list[str]
    separator: str


def layout_of(path: str | os.PathLike[str], text: str, known: Collection[str] = ()) -> Layout:
    """A table's layout, detected from its content: `known` are column names in lower case that guide the choice.

    Lines that begin with # are comments; if the first other line is not a header, the last comment that fits the rows
    is, as Metashape, RealityCapture and MicMac write it. Raises `TableError` for unclosed quotes, and
    for a row that begins with # below the header.
    """
    lines = re.split(r"\r\n|\r|\n", text)
    start, comments, declared = _preamble(lines)
    if start == len(lines):
        raise TableError(f"{path}: no rows; all that is there are comments.")
    COMMENT_LINES.check(path, len(comments))
    white = _quote(lines)
    if len(lines[start]) > COLUMNS.most:
        COLUMNS.check(path, max(len(_split(lines[start], mark, white)) for mark in SEPARATORS))
    header, first, separator = _header(lines[start:], comments, declared, known, white)
    first += start
    body = list(_without_comments(path, lines[first:], first, separator, len(header), white))
    found = list(_rows(path, body, first, separator, white))
    cells = with_points([row for _, row in found], separator)
    if separator != WHITE and "'" in text:
        header, cells = [plain_cell(name) for name in header], [[plain_cell(cell) for cell in row] for row in cells]
    return Layout(header, [line for line, _ in found], cells, comments, separator)


def header_of(text: str, known: Collection[str] = ()) -> list[str]:
    """The column names from the first lines of a table; empty if there are only comments."""
    lines = re.split(r"\r\n|\r|\n", text)
    start, comments, declared = _preamble(lines)
    return _header(lines[start:], comments, declared, known, _quote(lines))[0] if start < len(lines) else []


def _header(
    lines: list[str], comments: list[str], declared: str | None, known: Collection[str], quote: str
) -> tuple[list[str], int, str]:
    """(column names, index of the first row line, separator of the rows) of lines below the comments."""
    separator = declared or _separator(lines[0], lines[1:], known, quote)
    header = _split(lines[0], separator, quote)
    above = _header_above(header, comments, known, quote)
    if above is None:
        return header, 1, separator
    return above, 0, declared or _fitting(lines[0], len(above), quote) or separator


def _preamble(lines: list[str]) -> tuple[int, list[str], str | None]:
    """(the first line that is not a comment, the comments above, the separator if Excel's line `sep=;` gives it)."""
    comments: list[str] = []
    declared = None
    for number, line in enumerate(lines):
        bare = line.strip()
        sep = re.fullmatch(r'"?sep=(.)"?', line.strip(" \r\n"), re.IGNORECASE)
        if sep:
            declared = sep[1]
        elif bare.startswith("#"):
            comments.append(bare)
        elif bare:
            return number, comments, declared
    return len(lines), comments, declared


def _header_above(first: list[str], comments: list[str], known: Collection[str], quote: str) -> list[str] | None:
    """The column names in the comments, if the first line below them is a row and not a header."""
    if not any(_is_number(cell) for cell in first) or _hits(first, known) > 1:
        return None
    for comment in reversed(comments):
        bare = comment.lstrip("#").strip()
        for separator in (*SEPARATORS, WHITE):
            names = _split(bare, separator, quote)
            if len(names) == len(first) and (not known or _hits(names, known) > 1):
                return names
    for comment in reversed(comments):  # a header that does not fit its rows is reported as such
        for separator in (*SEPARATORS, WHITE):
            names = _split(comment.lstrip("#").strip(), separator, quote)
            if known and _hits(names, known) > 2:
                return names
    return None


def _separator(header: str, below: list[str], known: Collection[str], quote: str) -> str:
    """The separator of a header: the one with the most known names, else the most names."""
    counts = {mark: _split(header, mark, quote) for mark in (*SEPARATORS, WHITE)}
    row = next((line for line in below if line.strip() and not line.lstrip().startswith("#")), "")

    def rank(mark: str) -> tuple[int, bool, bool, int]:
        names = counts[mark]
        fits = len(_split(row, mark, quote)) == len(names)
        return _hits(names, known), len(names) > 1 and mark != WHITE, fits, len(names)

    best = max((*SEPARATORS, WHITE), key=rank)
    if best == "\t" and len(_split(row, best, quote)) != len(counts[best]) == len(_split(row, WHITE, quote)):
        return WHITE  # tabs in the header, spaces below
    return best if len(counts[best]) > 1 else ","


def _fitting(row: str, count: int, quote: str) -> str | None:
    """The separator that splits a row into `count` cells."""
    return next((mark for mark in (*SEPARATORS, WHITE) if len(_split(row, mark, quote)) == count), None)


def _hits(names: Iterable[str], known: Collection[str]) -> int:
    return sum(name.strip().lower() in known for name in names)


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r"[+-]?([0-9]+([.,][0-9]*)?|[.,][0-9]+)([eE][+-]?[0-9]+)?", cell.strip()))


def _quote(lines: list[str]) -> str:
    """The quote character of a table with white space, double or single."""
    found = re.search(r"(?:^|\s)(['\"])", "\n".join(lines[:1000]))
    return found[1] if found else '"'


def _reader(lines: Iterable[str], separator: str, quote: str, *, strict: bool = True) -> Iterator[list[str]]:
    if separator != WHITE:
        return csv.reader(lines, delimiter=separator, strict=strict)
    return csv.reader(
        (re.sub(r"\s+$", "", line.strip().replace("\t", " ")) for line in lines),
        delimiter=" ",
        quotechar=quote,
        skipinitialspace=True,
    )


def _split(line: str, separator: str, quote: str) -> list[str]:
    """The cells of one line; not split if its quotes do not close."""
    try:
        return [cell.strip() for cell in next(iter(_reader([line], separator, quote)), [])]
    except csv.Error:
        return [line.strip()]


def _without_comments(
    path: object, lines: list[str], offset: int, separator: str, count: int, quote: str
) -> Iterator[str]:
    """The lines, with comments blanked; raises `TableError` for one that may be a row whose name begins with #."""
    is_open = False  # a quoted cell continues in the next line
    for number, line in enumerate(lines, start=offset + 1):
        is_comment = not is_open and line.lstrip().startswith("#")
        if is_comment and count > 1 and len(_split(line, separator, quote)) == count:
            raise TableError(
                f"{path}, row {number}: it begins with # and has as many cells as the header; take the row out, or put "
                f"the name in quotes."
            )
        is_open ^= separator != WHITE and line.count('"') % 2 == 1
        yield "" if is_comment else line


def _rows(path: object, lines: list[str], offset: int, separator: str, quote: str) -> Iterator[tuple[int, list[str]]]:
    reader = _reader((f"{line}\n" for line in lines), separator, quote)
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                yield offset + reader.line_num, row  # type: ignore[attr-defined]
    except csv.Error as error:
        raise TableError(f"{path}, row {offset + reader.line_num}: not a table: {error}.") from error  # type: ignore[attr-defined]


def with_points(cells: list[list[str]], separator: str) -> list[list[str]]:
    """Cells with decimal points if all decimals of the table have commas, and the separator is another.

    In comma-separated tables, a quoted "1,234" may have a thousands separator; it is left unchanged.
    """
    if separator == ",":
        return cells
    with_comma = [
        (i, j)
        for i, row in enumerate(cells)
        for j, cell in enumerate(row)
        if "," in cell and BY_COMMA.fullmatch(cell.strip())
    ]
    if not with_comma or any(BY_POINT.fullmatch(cell.strip()) for row in cells for cell in row):
        return cells
    changed = [list(row) for row in cells]
    for i, j in with_comma:
        changed[i][j] = changed[i][j].replace(",", ".")
    return changed
