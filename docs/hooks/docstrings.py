"""What the reference shows of the source: examples as code, and the fields of records."""

from __future__ import annotations

import re
from typing import Any

import griffe

EXAMPLE = re.compile(r"^>>> .*(?:\n(?!\s*$).*)*", re.MULTILINE)  # Markdown would take it for quotations in quotations
CLASS_VARIABLE = "ClassVar"
LONGEST = 40  # letters of a default that is shown


class Docstrings(griffe.Extension):
    """Fences around everything from a `>>>` to the next empty line; a record's own fields behind its sentence."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = EXAMPLE.sub(lambda found: f"```pycon\n{found[0]}\n```", obj.docstring.value)

    def on_class_members(self, *, cls: griffe.Class, **_: Any) -> None:
        fields = [line for member in cls.members.values() if (line := field(member))]
        if fields and cls.docstring is not None:
            first, _, rest = cls.docstring.value.partition("\n\n")
            listed = "```python\n" + "\n".join(fields) + "\n```"
            cls.docstring.value = "\n\n".join(part for part in (first, listed, rest) if part)


def field(member: Any) -> str:
    """A field as the source has it; empty for what is none, or is private."""
    if not member.is_attribute or member.annotation is None or member.name.startswith("_"):
        return ""
    kind, default = str(member.annotation), "" if member.value is None else str(member.value)
    if kind.startswith(CLASS_VARIABLE) or "AbstractVar" in kind or member.docstring is not None:
        return ""
    is_shown = default and "field(" not in default and len(default) <= LONGEST
    return f"{member.name}: {kind}" + (f" = {default}" if is_shown else "")
