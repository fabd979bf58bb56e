"""Memory size of an image's tags from their counts, checked before they are read.

Each directory entry states a count and an offset. Many entries may share the same bytes, so a file of a megabyte
could fill all memory (TIFF 6.0, section 2; EXIF in JPEG is a TIFF within a segment APP1).
"""

from __future__ import annotations

import contextlib
import mmap
import struct
from collections.abc import Iterator
from typing import BinaryIO

from jaxgeo.io.errors import ImageError
from jaxgeo.io.limits import TAG_BYTES, TAG_VALUES

UNITS = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
AS_BYTES = (1, 2, 7)  # types read as one text or bytes
SUBDIRECTORIES = (0x8769, 0x8825)  # of EXIF and of GPS
EXIF, START_OF_SCAN, APP1 = b"Exif\0\0", 0xDA, 0xE1


def check_tag_sizes(file: BinaryIO, name: str) -> None:
    """Raises `ImageError` for an open JPEG or TIFF file whose tags take more than the limits allow."""
    file.seek(0)
    start = file.read(2)
    if start in (b"II", b"MM"):
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            _check(name, content)
    elif start == b"\xff\xd8":
        _check(name, b"".join(_exif_segments(file)))
    file.seek(0)


def _check(name: str, content: bytes | mmap.mmap) -> None:
    size = values = 0
    with contextlib.suppress(struct.error):  # truncated: reported by the reader
        for kind, count in _entries(content):
            size += count * UNITS[kind]
            values += 0 if kind in AS_BYTES else count
    TAG_BYTES.check(name, size, ImageError)
    TAG_VALUES.check(name, values, ImageError)


def _entries(content: bytes | mmap.mmap) -> Iterator[tuple[int, int]]:
    """(type, count) of the entries of the first directory, and of those of EXIF and GPS."""
    order = ">" if content[:2] == b"MM" else "<"
    big = content[2:4] in (b"+\0", b"\0+")
    offset, width = ("Q", 8) if big else ("I", 4)
    places = [struct.unpack_from(order + offset, content, 8 if big else 4)[0]]
    for at in places:  # the first directory's subdirectories are appended
        (count,) = struct.unpack_from(order + ("Q" if big else "H"), content, at)
        entry = at + (8 if big else 2)
        for _ in range(min(count, len(content) // 12)):
            tag, kind, length = struct.unpack_from(order + "HH" + offset, content, entry)
            if kind in UNITS:
                yield kind, length
            if tag in SUBDIRECTORIES and len(places) < 1 + len(SUBDIRECTORIES):
                places.append(struct.unpack_from(order + offset, content, entry + 4 + width)[0])
            entry += 4 + 2 * width


def _exif_segments(file: BinaryIO) -> Iterator[bytes]:
    """The EXIF parts of a JPEG, in sequence as Pillow joins them."""
    while len(head := file.read(4)) == 4 and head[0] == 0xFF and head[1] != START_OF_SCAN:
        if head[1] == 0xFF or 0xD0 <= head[1] <= 0xD8 or head[1] == 1:  # fill byte, or a marker without a segment
            file.seek(-3 if head[1] == 0xFF else -2, 1)
            continue
        segment = file.read(max(int.from_bytes(head[2:], "big") - 2, 0))
        if head[1] == APP1 and segment.startswith(EXIF):
            yield segment[len(EXIF) :]
