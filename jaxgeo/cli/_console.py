"""Consoles that show the texts of files as text: nothing in a name colours, clears or turns round a terminal."""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Callable, Iterable

from rich.console import Console as AnyConsole
from rich.console import ConsoleOptions, RenderableType
from rich.segment import Segment

ACTING = ("Cc", "Cf", "Cs", "Zl", "Zp")  # categories of Unicode: control, format, half characters, separators


class Console(AnyConsole):
    """Rich's, but characters that act in place of being shown are written as escapes (`\\x1b`)."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            is_text = not segment.control and not segment.text.isprintable()
            yield Segment(as_text(segment.text), segment.style) if is_text else segment


def as_text(words: str, escape: Callable[[str], str] = ascii) -> str:
    """Words with acting characters as escapes, but for line breaks."""
    if words.isprintable():
        return words
    return "".join(escape(c)[1:-1] if c != "\n" and unicodedata.category(c) in ACTING else c for c in words)


def as_json(written: str) -> str:
    """The same of JSON, whose escapes a reader takes for the characters."""
    return as_text(written, json.dumps)
