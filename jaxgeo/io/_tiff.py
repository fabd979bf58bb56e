"""Layout tags of a TIFF file, checked before PROJ reads it, because PROJ divides by them.

PROJ's grid reader does not check that they are present and positive; otherwise the process may crash. A
TIFF file of one strip may omit its rows per strip: such a grid is refused, since GDAL never writes one.
"""

from __future__ import annotations

import mmap
import pathlib
import struct

from jaxgeo.io.limits import TAG_DIRECTORIES

SIZES = {3: ("H", 2), 4: ("I", 4), 16: ("Q", 8)}  # TIFF integer types: SHORT, LONG, LONG8
WIDTH, HEIGHT, STRIPS, ROWS_PER_STRIP, TILES, TILE_WIDTH, TILE_HEIGHT = 256, 257, 273, 278, 324, 322, 323
NAMES = {WIDTH: "ImageWidth", HEIGHT: "ImageLength", ROWS_PER_STRIP: "RowsPerStrip", TILE_WIDTH: "TileWidth",
         TILE_HEIGHT: "TileLength"}  # fmt: skip


def layout_mistake(path: pathlib.Path) -> str:
    """A fault in the layout of a TIFF file, as the end of a sentence; empty if there is none, or it is not a TIFF."""
    if path.stat().st_size < 8:
        return ""
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return _layout_mistake(content)


def _layout_mistake(content: mmap.mmap) -> str:
    order = {b"II": "<", b"MM": ">"}.get(content[:2], "")
    if not order or struct.unpack(order + "H", content[2:4])[0] not in (42, 43):
        return ""
    big = struct.unpack(order + "H", content[2:4])[0] == 43
    try:
        at = _number(content, order, *((8, "Q") if big else (4, "I")))
        for _ in range(TAG_DIRECTORIES.most):
            if at == 0:
                return ""
            tags, at = _directory(content, order, at, big)
            mistake = _mistake(tags)
            if mistake:
                return mistake
    except struct.error:
        return "a directory of its tags lies beyond its end"
    return f"it has more than {TAG_DIRECTORIES.most} {TAG_DIRECTORIES.what} ({TAG_DIRECTORIES.name})"


def _mistake(tags: dict[int, int | None]) -> str:
    if TILES not in tags and STRIPS not in tags:
        return "it has neither strips nor tiles"
    needed = (WIDTH, HEIGHT, *((TILE_WIDTH, TILE_HEIGHT) if TILES in tags else (ROWS_PER_STRIP,)))
    wrong = next((NAMES[tag] for tag in needed if not tags.get(tag)), "")
    return f"its tag {wrong} is no number above zero" if wrong else ""


def _directory(content: mmap.mmap, order: str, at: int, big: bool) -> tuple[dict[int, int | None], int]:
    """(single integers by tag, None for other values, and the offset of the next directory)."""
    count = _number(content, order, at, "Q" if big else "H")
    at += 8 if big else 2
    size = 20 if big else 12
    if at + count * size > len(content):
        raise struct.error("the directory is cut off")
    tags: dict[int, int | None] = {}
    for entry in range(at, at + count * size, size):
        tag, kind = struct.unpack_from(order + "HH", content, entry)
        length = _number(content, order, entry + 4, "Q" if big else "I")
        layout, width = SIZES.get(kind, ("", 0))
        single = length == 1 and 0 < width <= (8 if big else 4)
        tags.setdefault(tag, _number(content, order, entry + (12 if big else 8), layout) if single else None)
    return tags, _number(content, order, at + count * size, "Q" if big else "I")


def _number(content: mmap.mmap, order: str, at: int, layout: str) -> int:
    return struct.unpack_from(order + layout, content, at)[0]
