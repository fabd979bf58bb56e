"""Files changed at random, but the same for the same number: bytes, lengths, counts, words, nesting."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Callable, Sequence

EXTREME_BYTES = (0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF)
EXTREME_NUMBERS = (0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
EXTREME_FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-320, 1e15, 1e300, -1e300, float("inf"), -float("inf"), float("nan"))
WORDS = (
    "", "0", "-1", "1", "nan", "inf", "-inf", "1e999", "1e308", "-1e308", "1e-320", "999999999999999999999", "1,5",
    "1_0", "0x10", "1/0", "0/0", "--5", "true", "null", "None", "[]", "{}", "''", '"', "'", "\u0663", "\u00b2",
    "\ud7ff", "a" * 3000, "9" * 400, "9" * 5000, "\x00", "\x1a", "%s", "EPSG:4326", "EPSG:999999", "../..", "~", "1e",
    "-", "+", ".", "2024-13-45T99:99:99",
)  # fmt: skip
NESTED = ("[", "{", "(", '{"a":', "<a>", "- ", "a: {", "a = [", "[[", "((", "<!--", '"')
CHARACTERS = (
    "\ufeff",
    "\u2028",
    "\x00",
    "\r",
    "\r\n",
    "\n\n",
    "\t",
    ";",
    ",",
    "\x85",
    "\x0c",
    "'",
    '"',
    "#",
    "=",
    ":",
    "<",
    "&",
)
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[\w.:+-]+")
MOST = 300_000  # bytes of a mutant

Change = Callable[[bytes, random.Random], bytes]


def mutant(seeds: Sequence[bytes], seed: int, number: int, *, text: bool) -> bytes:
    """The mutant of a seed and a number, of one of the sound files `seeds`: one to four changes, or two joined."""
    rng = random.Random(f"{seed} {number}")
    content = rng.choice(seeds)
    changes = (*BYTES, *TEXT, *TEXT) if text else BYTES
    if len(seeds) > 1 and rng.random() < 0.05:
        other = rng.choice(seeds)
        return content[: rng.randrange(len(content) + 1)] + other[rng.randrange(len(other) + 1) :]
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        content = rng.choice(changes)(content, rng)[:MOST]
    return content


def _place(content: bytes, rng: random.Random, size: int = 0) -> int:
    """Where a change is made: anywhere, or more often near the start, where headers are."""
    end = max(len(content) - size, 0)
    return rng.randint(0, end if rng.random() < 0.5 else min(end, 200))


def _written(content: bytes, at: int, new: bytes, replaced: int | None = None) -> bytes:
    return content[:at] + new + content[at + (len(new) if replaced is None else replaced) :]


def _flipped(content: bytes, rng: random.Random) -> bytes:
    for _ in range(rng.choice((1, 1, 2, 8))):
        at = _place(content, rng, 1)
        if content:
            content = _written(content, at, bytes([content[at] ^ 1 << rng.randrange(8)]))
    return content


def _extreme_byte(content: bytes, rng: random.Random) -> bytes:
    return _written(content, _place(content, rng, 1), bytes([rng.choice(EXTREME_BYTES)]))


def _extreme_number(content: bytes, rng: random.Random) -> bytes:
    """A count, length or offset of 1, 2, 4 or 8 bytes, of either order."""
    size = rng.choice((1, 2, 2, 4, 4, 8))
    order = rng.choice(("little", "big"))
    number = rng.choice(EXTREME_NUMBERS) + rng.choice((0, 0, -1))
    at = _place(content, rng, size) // size * size
    return _written(content, at, (number % 256**size).to_bytes(size, order))


def _extreme_float(content: bytes, rng: random.Random) -> bytes:
    layout = rng.choice(("<d", "<d", ">d", "<f", ">f"))
    at = _place(content, rng, 8) // 8 * 8
    number = rng.choice(EXTREME_FLOATS)
    return _written(content, at, struct.pack(layout, number if abs(number) < 1e38 or "d" in layout else 3e38))


def _cut(content: bytes, rng: random.Random) -> bytes:
    return content[: rng.randint(0, len(content))]


def _without_a_part(content: bytes, rng: random.Random) -> bytes:
    return _written(content, _place(content, rng), b"", rng.choice((1, 2, 4, 8, 17, 100, len(content) // 3)))


def _with_a_part_again(content: bytes, rng: random.Random) -> bytes:
    at, size = _place(content, rng), rng.choice((1, 2, 8, 40, 136, len(content) // 2))
    return _written(content, at, content[at : at + size] * rng.choice((2, 3, 50)), size)


def _with_noise(content: bytes, rng: random.Random) -> bytes:
    return _written(content, _place(content, rng), rng.randbytes(rng.choice((1, 3, 16, 200))), 0)


def _zeroed(content: bytes, rng: random.Random) -> bytes:
    size = rng.choice((2, 4, 8, 64, 400))
    return _written(content, _place(content, rng, size), bytes([rng.choice((0, 0xFF))]) * size)


def _moved(content: bytes, rng: random.Random) -> bytes:
    at, size, to = _place(content, rng), rng.choice((1, 4, 16, 136)), _place(content, rng)
    part, rest = content[at : at + size], _written(content, at, b"", size)
    return _written(rest, to, part, 0)


def _replaced(pattern: re.Pattern[bytes], new: Callable[[bytes, random.Random], bytes]) -> Change:
    def change(content: bytes, rng: random.Random) -> bytes:
        found = list(pattern.finditer(content))
        if not found:
            return content
        one = rng.choice(found)
        return content[: one.start()] + new(one[0], rng) + content[one.end() :]

    return change


def _word(old: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.3:
        return old * rng.choice((2, 3))
    return rng.choice(WORDS).encode("utf-8", "surrogatepass")


def _other_word(content: bytes, rng: random.Random) -> bytes:
    found = WORD.findall(content)
    return _replaced(WORD, lambda old, rng: rng.choice(found))(content, rng) if found else content


def _lines(content: bytes, rng: random.Random) -> bytes:
    lines = content.splitlines(keepends=True) or [b""]
    at, to = rng.randrange(len(lines)), rng.randrange(len(lines))
    how = rng.randrange(4)
    if how == 0:
        del lines[at]
    elif how == 1:
        lines.insert(to, lines[at])
    elif how == 2:
        lines[at], lines[to] = lines[to], lines[at]
    else:
        lines[at] = lines[at] * rng.choice((2, 30))
    return b"".join(lines)


def _nested(content: bytes, rng: random.Random) -> bytes:
    deep = rng.choice(NESTED).encode() * rng.choice((3, 50, 3000, 30_000))
    return _written(content, _place(content, rng), deep, 0)


def _with_a_character(content: bytes, rng: random.Random) -> bytes:
    return _written(content, _place(content, rng), rng.choice(CHARACTERS).encode(), 0)


def _written_otherwise(content: bytes, rng: random.Random) -> bytes:
    try:
        text = content.decode()
    except UnicodeDecodeError:
        return content
    how = rng.choice(("utf-16", "utf-8-sig", "latin-1", "\r\n", "\r", ";", "\t", ", "))
    if how.startswith(("utf", "latin")):
        return text.encode(how, "replace")
    return text.replace("\n" if "\r" in how else ",", how).encode()


BYTES: tuple[Change, ...] = (
    _flipped, _flipped, _extreme_byte, _extreme_number, _extreme_number, _extreme_float, _cut, _without_a_part,
    _with_a_part_again, _with_noise, _zeroed, _moved,
)  # fmt: skip
TEXT: tuple[Change, ...] = (
    _replaced(NUMBER, _word), _replaced(NUMBER, _word), _replaced(WORD, _word), _other_word, _lines, _nested,
    _with_a_character, _written_otherwise,
)  # fmt: skip
