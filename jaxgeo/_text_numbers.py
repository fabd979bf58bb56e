"""Parsing of numbers in text files and command lines: ASCII digits, a decimal point, an exponent; nothing else.

Python's `float` and `int` also accept underscores between digits (1_0), digits of other scripts, no-break spaces
around a number, and the words nan, inf and infinity. In a table each of them is an error of the writing program, or a
no-data word that the reader must handle.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

BLANKS = " \t\r\n\f\v"  # white space allowed around or between numbers
MOST_DIGITS = 400  # of a number: a float64 in full has at most 310 before its decimal point

MINUSES = "\u2010\u2011\u2012\u2013\u2212"  # hyphens, dashes and minus that are no ASCII hyphen

_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WHOLE = re.compile(r"[+-]?[0-9]+")


def number_in(text: str) -> float | None:
    """The finite number in a text, surrounding blanks ignored; None for any other text.

    >>> from jaxgeo._text_numbers import number_in
    >>> print(number_in(" -1.5e3 "), number_in("1_0"), number_in("nan"), number_in("1e999"))
    -1500.0 None None None
    """
    bare = text.strip(BLANKS)
    if len(bare) > MOST_DIGITS or _DECIMAL.fullmatch(bare) is None:
        return None
    value = float(bare)
    return value if math.isfinite(value) else None


def no_number(text: str) -> str:
    """The words for a text that is not a number, with the character that is not ASCII if only that is the reason.

    >>> from jaxgeo._text_numbers import no_number
    >>> print(no_number("12;5"))
    '12;5' is not a number
    >>> print(no_number(chr(0x2212) + "84.2").encode("ascii", "backslashreplace").decode())
    '\\u221284.2' is not a number: its sign is the character U+2212; write -
    """
    said = f"{text[:60]!r} is not a number"
    sign = next((mark for mark in text if mark in MINUSES), None)
    if sign is None or number_in(text.translate(dict.fromkeys(map(ord, MINUSES), "-"))) is None:
        return said
    return f"{said}: its sign is the character U+{ord(sign):04X}; write -"


def whole_in(text: str) -> int | None:
    """The integer below 2^63 in magnitude in a text, surrounding blanks ignored; None for any other text."""
    bare = text.strip(BLANKS)
    if len(bare) > MOST_DIGITS or _WHOLE.fullmatch(bare) is None:
        return None
    value = int(bare)
    return value if abs(value) < 2**63 else None


def numbers_in(words: Iterable[str]) -> list[float] | None:
    """All words as finite numbers, or None if any is not a finite number."""
    numbers: list[float] = []
    for word in words:
        number = number_in(word)
        if number is None:
            return None
        numbers.append(number)
    return numbers


def words_of(text: str) -> list[str]:
    """The blank-separated words of a text; a no-break space counts as part of a word, as it may be part of a number."""
    return re.split(f"[{BLANKS}]+", text.strip(BLANKS)) if text.strip(BLANKS) else []


def numbers_or_texts(cells: Sequence[str]) -> list[Any]:
    """A column as numbers, None where a cell is empty; as it is if a cell is no number."""
    numbers = [number_in(cell) for cell in cells]
    is_text = any(cell.strip() and number is None for cell, number in zip(cells, numbers, strict=True))
    return list(cells) if is_text else list(numbers)
