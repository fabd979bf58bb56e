"""Numbers as text files and command lines write them: ASCII digits, a decimal point, an exponent; nothing else.

Python's `float` and `int` also take underscores between digits (1_0), digits of other scripts, no-break spaces around
a number, and the words nan, inf and infinity. In a table each of them is a mistake of the program that wrote it, or a
word for "unknown" that its reader has to know.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

BLANKS = " \t\r\n\f\v"  # white space that may stand around a number or between two
MOST_DIGITS = 400  # of a number: a float64 written out in full has at most 310 before its point

_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WHOLE = re.compile(r"[+-]?[0-9]+")


def number_in(text: str) -> float | None:
    """The finite number that a text is, blanks around it passed over; None for any other text.

    >>> from jaxgeo._text_numbers import number_in
    >>> print(number_in(" -1.5e3 "), number_in("1_0"), number_in("nan"), number_in("1e999"))
    -1500.0 None None None
    """
    bare = text.strip(BLANKS)
    if len(bare) > MOST_DIGITS or _DECIMAL.fullmatch(bare) is None:
        return None
    value = float(bare)
    return value if math.isfinite(value) else None


def whole_in(text: str) -> int | None:
    """The whole number below 2^63 in size that a text is, blanks around it passed over; None for any other text."""
    bare = text.strip(BLANKS)
    if len(bare) > MOST_DIGITS or _WHOLE.fullmatch(bare) is None:
        return None
    value = int(bare)
    return value if abs(value) < 2**63 else None


def numbers_in(words: Iterable[str]) -> list[float] | None:
    """All words as finite numbers, or None where one of them is none."""
    numbers: list[float] = []
    for word in words:
        number = number_in(word)
        if number is None:
            return None
        numbers.append(number)
    return numbers


def words_of(text: str) -> list[str]:
    """The words of a text with blanks between; a no-break space is part of a word, as it may be part of a number."""
    return re.split(f"[{BLANKS}]+", text.strip(BLANKS)) if text.strip(BLANKS) else []
