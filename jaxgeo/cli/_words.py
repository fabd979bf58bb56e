"""Python's words for options, in those of the command line."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from typing import Any

from jaxgeo.cli._common import UserError
from jaxgeo.cli._refusals import is_refusal

# Options of `read_acquisition` that have another name on the command line than with dashes for underscores.
OTHER_NAMES = {"crs": "source-crs"}
# Options of readers that the command line has; others are Python's alone.
READING = (
    "height_datum", "takeoff_height", "image_size", "upright", "keep_damaged", "stream", "crs", "camera", "errors",
    "interior",
)  # fmt: skip
_OPTION = re.compile(rf"\b({'|'.join(('vertical_datum', *READING))})=(\.\.\.)?\s?")


def typed(name: str) -> str:
    """An option of a reader as it is typed."""
    return "--" + OTHER_NAMES.get(name, name.replace("_", "-"))


def as_typed(text: str) -> str:
    """A sentence that names options of a reader, with those of the command line."""

    def replaced(found: re.Match[str]) -> str:
        follows = text[found.end() : found.end() + 1]
        return typed(found[1]) + ("" if follows in ":,;." else " ")

    return _OPTION.sub(replaced, text)


def reason_of(error: Exception) -> str:
    """Why a file cannot be read, in a line and in the words of the command line."""
    from jaxgeo.io.acquisitions.detect import WrongOption

    if isinstance(error, WrongOption):
        options = [typed(name) for name in error.takes if name in READING]
        takes = f"it takes {', '.join(options)}" if options else "it takes no option of how it is read"
        return f"{error.path} ({error.kind}) takes no {typed(error.name)}; {takes}."
    return as_typed(" ".join(str(error).split())) or type(error).__name__


def reason_not_read(unread: Any) -> str:
    """Why one of many files could not be read; a fault of the program is called one."""
    if is_refusal(unread.error):
        return reason_of(unread.error)
    name, reason = type(unread.error).__name__, " ".join(str(unread.error).split())
    return (
        f"{unread.path}: unexpected {name}{f' ({reason})' if reason else ''}: a fault of jaxgeo's, not of the file; "
        f"see where with jaxgeo inspect {unread.path} --debug, and report it."
    )


@contextlib.contextmanager
def words_as_typed() -> Iterator[None]:
    """Readers' refusals with the options of the command line in place of Python's."""
    try:
        yield
    except (ValueError, ImportError) as error:
        if not is_refusal(error):
            raise
        raise UserError(reason_of(error)) from error
