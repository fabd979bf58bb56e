"""Python's words for options, in those of the command line."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

from jaxgeo.cli._common import UserError

# Options of `read_acquisition` that have another name on the command line than with dashes for underscores.
OTHER_NAMES = {"crs": "source-crs"}
_NAMES = "height_datum|vertical_datum|takeoff_height|image_size|upright|crs|camera|positions|errors|interior|stream"
# Options of a reader with a value that is a flag of its own on the command line.
FLAGS = {"velocities=False": "--no-velocities", "keep_damaged=True": "--keep-damaged"}
_OPTION = re.compile(rf"\b({_NAMES})=(\.\.\.)?\s?")


def as_typed(text: str) -> str:
    """A sentence that names options of a reader, with those of the command line."""

    def typed(found: re.Match[str]) -> str:
        follows = text[found.end() : found.end() + 1]
        return "--" + OTHER_NAMES.get(found[1], found[1].replace("_", "-")) + ("" if follows in ":,;." else " ")

    for said, flag in FLAGS.items():
        text = text.replace(said, flag)
    return _OPTION.sub(typed, text)


@contextlib.contextmanager
def words_as_typed() -> Iterator[None]:
    """Readers' mistakes with the options of the command line in place of Python's."""
    try:
        yield
    except (ValueError, ImportError) as error:
        raise UserError(as_typed(str(error))) from error
