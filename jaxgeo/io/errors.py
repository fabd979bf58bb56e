"""What the readers of this package raise when they refuse a file."""

from __future__ import annotations

import re
import unicodedata

LONGEST = 1000  # characters of a message; the middle of a longer one, that quotes a file at length, is left out

_BREAK = re.compile(r"[ \t]*[\r\n\v\f\x1c-\x1e\x85\u2028\u2029]+[ \t]*")


class RefusedFile(ValueError):
    """Base of the errors that refuse a file: one line, however long or strange the words are that it quotes."""

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


def one_line(message: object) -> str:
    """A message in one line of printable characters, the middle of a long one left out."""
    words = _BREAK.sub(" ", str(message).strip())
    if not words.isprintable():
        words = "".join(c if _is_shown(c) else ascii(c)[1:-1] for c in words)
    return words if len(words) <= LONGEST else f"{words[: 2 * LONGEST // 3]} [...] {words[-LONGEST // 3 :]}"


def _is_shown(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) == "Zs"


class DemError(RefusedFile):
    """An elevation file that cannot be used as it stands: the message names the file, the place and the reason."""


class VerticalDatumError(DemError):
    """Heights whose vertical datum is unknown, contradictory, or not reachable with the grids that are here."""


class OutsideDatum(ValueError):
    """A position that a vertical datum's grid does not reach; the readers that meet it name the file."""


class TableError(RefusedFile):
    """A table that cannot be read; the message names the file, the row and the column."""


class ImageError(RefusedFile):
    """An image or an orthoimage that cannot be used as it stands: the message names the file, the place, the reason."""
