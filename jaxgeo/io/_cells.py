"""Texts in cells of CSV files that no spreadsheet runs as a formula, and the same texts read back.

Excel, LibreOffice and Google Sheets run a cell that begins with =, +, - or @, in some languages also with their wide
forms, and pass over a tab or line break before it (OWASP, "CSV Injection"). An apostrophe in front makes it a text, as
in a spreadsheet's own cells. One is written before such a text, and before one that already has apostrophes there, so
that reading, which takes one off, gives every text back. Numbers are left as they are.
"""

from __future__ import annotations

import re
from typing import Any

from jaxgeo._destination import UNWRITABLE
from jaxgeo._text_numbers import number_in

_RUN = re.compile("'*[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")


class Rows:
    """Where a writer of `csv` with the line end "\\r\\n" writes rows that end in "\\n" alone.

    With "\\n" as its line end, `csv` puts no quotes around a carriage return, which then ends the row.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, row: str) -> int:
        return self._stream.write(row.removesuffix("\r\n") + "\n")


def safe_cell(value: Any) -> Any:
    """A value as it is written: a text that a spreadsheet would run has an apostrophe in front.

    >>> from jaxgeo.io._cells import safe_cell
    >>> print(safe_cell("=1+1"), safe_cell("-1.5"), safe_cell("'=x"), safe_cell("a=b"), safe_cell(-1.5))
    '=1+1 -1.5 ''=x a=b -1.5
    """
    if not isinstance(value, str) or not _RUN.match(value) or number_in(value.replace(",", ".")) is not None:
        return value
    return f"'{value}"


def utf8_text(value: Any) -> Any:
    """A value whose text UTF-8 can hold: names of files need not be UTF-8, nor escapes in JSON a whole character."""
    if not isinstance(value, str) or value.isascii():
        return value
    return value.encode("utf-8", UNWRITABLE).decode("utf-8")


def plain_cell(text: str) -> str:
    """A cell as it was before `safe_cell`."""
    return text[1:] if text.startswith("'") and _RUN.match(text) else text
