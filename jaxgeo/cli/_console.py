"""Console output with control characters escaped, so that text from files cannot control the terminal."""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Callable, Iterable

from rich.console import Console as AnyConsole
from rich.console import ConsoleOptions, RenderableType
from rich.segment import Segment

ACTING = ("Cc", "Cf", "Cs", "Zl", "Zp")  # Unicode categories: control, format, surrogate, separators


class Console(AnyConsole):
    """Rich console that writes control characters as escapes (`\\x1b`)."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            is_text = not segment.control and not segment.text.isprintable()
            yield Segment(as_text(segment.text), segment.style) if is_text else segment


def as_text(words: str, escape: Callable[[str], str] = ascii) -> str:
    """Text with control characters escaped, except line breaks."""
    if words.isprintable():
        return words
    return "".join(escape(c)[1:-1] if c != "\n" and unicodedata.category(c) in ACTING else c for c in words)


def as_json(written: str) -> str:
    """JSON text with control characters as JSON escapes."""
    return as_text(written, json.dumps)
