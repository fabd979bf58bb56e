"""Limits on the size, depth and counts read from one file. `docs/limits.md` lists them.

Input files are untrusted. Each limit is far above real data and stops files that would take hours or all memory. An
error names the limit, the file's value, and the remedy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from jaxgeo.io.errors import RefusedFile, TableError

MIB, GIB = 2**20, 2**30


@dataclass(frozen=True)
class Limit:
    """The maximum (`most`) of a quantity (`what`) in a file, `why`, and the `remedy` for a file that exceeds it."""

    name: str
    most: int
    what: str
    why: str
    remedy: str

    def refusal(self, where: object, found: Any, error: type[RefusedFile] = TableError) -> RefusedFile:
        """The error for a file that exceeds the limit; `found` is its value, or None if unknown."""
        has = f"more than {self.most:,}" if found is None else f"{found:,}"
        return error(f"{where}: {has} {self.what}, and at most {self.most:,} are read ({self.name}); {self.remedy}.")

    def check(self, where: object, found: int, error: type[RefusedFile] = TableError) -> None:
        """Raises `error`, a subclass of `RefusedFile`, if the limit is exceeded."""
        if found > self.most:
            raise self.refusal(where, found, error)


FILE_BYTES = Limit(
    "FILE_BYTES",
    GIB,
    "bytes",
    "Text, JSON, XML and KLV are read into memory as a whole, and take some ten times that as numbers and names.",
    "split the file, or write only the rows that are needed",
)
PARAMETER_BYTES = Limit(
    "PARAMETER_BYTES",
    MIB,
    "bytes of TOML or YAML",
    "A file of cameras has a few kilobytes, and these parsers read a megabyte in seconds.",
    "a scene or camera file has a few kilobytes; is it the right file?",
)
UNPACKED_BYTES = Limit(
    "UNPACKED_BYTES",
    2 * GIB,
    "bytes once unpacked",
    "The largest published problem has 1.5 GB as text.",
    "unpack it and take a part of the problem",
)
UNPACKED_RATIO = Limit(
    "UNPACKED_RATIO",
    200,
    "bytes for each of the compressed file",
    "Numbers written as text shrink by 3 to 10; a few bytes that unpack to gigabytes hold none.",
    "if the file is sound, unpack it first and name the unpacked file",
)
UNPACKED_ALWAYS = 16 * MIB  # bytes that any compressed file may unpack to, whatever its size
NESTING = Limit(
    "NESTING",
    64,
    "levels of lists or tables within each other",
    "No format that is read has more than ten; parsers and messages that follow them deeper exhaust the stack.",
    "it was not written by a program that jaxgeo knows; export it again",
)
COLUMNS = Limit(
    "COLUMNS",
    10_000,
    "columns",
    "The widest flight logs have some hundreds; names are compared with each other.",
    "write a table with the columns that are needed",
)
COMMENT_LINES = Limit(
    "COMMENT_LINES",
    10_000,
    "lines of comments above the header",
    "Each of them is tried as a header.",
    "take them out",
)
PACKET_ITEMS = Limit(
    "PACKET_ITEMS",
    1000,
    "items",
    "ST 0601 has 143 items, few of which may repeat; two bytes can make one.",
    "the packet is taken as damaged",
)
TAG_BYTES = Limit(
    "TAG_BYTES",
    256 * MIB,
    "bytes of tags",
    "EXIF and XMP have some kilobytes, and a large maker's note a megabyte; entries may all point at the same bytes.",
    "write the image anew without its maker's notes (exiftool -MakerNotes= FILE)",
)
TAG_VALUES = Limit(
    "TAG_VALUES",
    4_000_000,
    "numbers in tags",
    "Each becomes an object of 32 bytes and more. An image of 450 megapixels in strips of a row has 60,000.",
    "write the image anew in larger strips or tiles (gdal_translate -co TILED=YES)",
)
TAG_DIRECTORIES = Limit(
    "TAG_DIRECTORIES",
    1000,
    "directories of tags",
    "An image has one and a grid of a national datum some hundreds; they may lead back to each other.",
    "export it again",
)

LIMITS = (
    FILE_BYTES, PARAMETER_BYTES, UNPACKED_BYTES, UNPACKED_RATIO, NESTING, COLUMNS, COMMENT_LINES, PACKET_ITEMS,
    TAG_BYTES, TAG_VALUES, TAG_DIRECTORIES,
)  # fmt: skip
