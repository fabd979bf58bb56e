"""Exceptions raised by the readers of this package."""

from __future__ import annotations

import re
import unicodedata

A_WRONG_GUESS = "a wrong guess can shift the result by up to 100 m"  # of the vertical datum: geoid undulations
LONGEST = 1000  # characters of a message; longer ones are cut in the middle

_BREAK = re.compile(r"[ \t]*[\r\n\v\f\x1c-\x1e\x85\u2028\u2029]+[ \t]*")


class RefusedFile(ValueError):
    """Base class of errors that reject a file: one line, whatever text of the file it quotes."""

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


def one_line(message: object) -> str:
    """A message as one line of printable characters, long ones cut in the middle."""
    words = _BREAK.sub(" ", str(message).strip())
    if not words.isprintable():
        words = "".join(c if _is_shown(c) else ascii(c)[1:-1] for c in words)
    return words if len(words) <= LONGEST else f"{words[: 2 * LONGEST // 3]} [...] {words[-LONGEST // 3 :]}"


def _is_shown(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) == "Zs"


class DemError(RefusedFile):
    """An unusable elevation file; the message names the file, the position and the reason."""


class VerticalDatumError(DemError):
    """Heights whose vertical datum is unknown, contradictory, or needs a grid that is not installed."""


class WindowTooLarge(DemError):
    """Terrain that rays can touch is larger than the caller allows."""


class NothingSeen(ValueError):
    """An image that shows none of the ground asked for."""


class OutsideDatum(ValueError):
    """A position outside a vertical datum's grid; readers that catch it add the file's name."""


class TableError(RefusedFile):
    """A table that cannot be read; the message names the file, the row and the column."""


class ImageError(RefusedFile):
    """An unusable image or orthoimage; the message names the file, the position and the reason."""


class UnwritableLens(ValueError):
    """A camera's lens model that a file format does not have; the message names the camera and what is written."""
