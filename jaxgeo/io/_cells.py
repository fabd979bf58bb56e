"""CSV cells that spreadsheets do not run as formulas, and their inverse.

Excel, LibreOffice and Google Sheets run a cell that begins with =, +, - or @, in some locales also with their
full-width forms, and skip a tab or line break before it (OWASP, "CSV Injection"). A leading apostrophe makes it a text,
as in a spreadsheet's own cells. It is written before such a text, and before one that already has apostrophes there;
reading removes one, so every text is restored. Numbers are unchanged.
"""

from __future__ import annotations

import re
from typing import Any

from jaxgeo._destination import UNWRITABLE
from jaxgeo._text_numbers import number_in

_RUN = re.compile("'*[=+\\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")


class Rows:
    """Stream adapter that replaces the line end "\\r\\n" of `csv` by "\\n".

    With "\\n" as its line end, `csv` does not quote a carriage return, which then ends the row.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, row: str) -> int:
        return self._stream.write(row.removesuffix("\r\n") + "\n")


def safe_cell(value: Any) -> Any:
    """A value as written: a text that a spreadsheet would run gets a leading apostrophe.

    >>> from jaxgeo.io._cells import safe_cell
    >>> print(safe_cell("=1+1"), safe_cell("-1.5"), safe_cell("'=x"), safe_cell("a=b"), safe_cell(-1.5))
    '=1+1 -1.5 ''=x a=b -1.5
    """
    if not isinstance(value, str) or not _RUN.match(value) or number_in(value.replace(",", ".")) is not None:
        return value
    return f"'{value}"


def utf8_text(value: Any) -> Any:
    """A value whose text UTF-8 can encode: file names need not be UTF-8, nor JSON escapes whole characters."""
    if not isinstance(value, str) or value.isascii():
        return value
    return value.encode("utf-8", UNWRITABLE).decode("utf-8")


def plain_cell(text: str) -> str:
    """The inverse of `safe_cell`."""
    return text[1:] if text.startswith("'") and _RUN.match(text) else text
