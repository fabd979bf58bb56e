"""Checksum verification of deflate-compressed TIFF blocks.

libtiff accepts a block that decodes to more than its size, as a damaged one may, and does not reach its
checksum; its last values are then uninitialised memory, different at every read.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np
from rasterio.enums import Compression, Interleaving
from rasterio.io import DatasetReader
from rasterio.windows import Window

Block = tuple[int, int, int]  # band, row and column of blocks


def damaged_block(data: DatasetReader, bands: Iterable[int], window: Window | None, sound: set[Block]) -> str:
    """Description of a damaged block under a window of a deflated TIFF file; empty if there is none.

    `sound` are blocks verified before; newly verified ones are added.
    """
    if data.driver != "GTiff" or data.compression != Compression.deflate or not os.path.isfile(data.name):
        return ""
    together = data.interleaving == Interleaving.pixel
    with open(data.name, "rb") as file:
        for block in _under(data, (1,) if together else bands, window):
            if block in sound:
                continue
            if not _is_sound(data, block, file, data.count if together else 1):
                return f"the block in row {block[1]} and column {block[2]} of its blocks does not fit its checksum"
            sound.add(block)
    return ""


def _under(data: DatasetReader, bands: Iterable[int], window: Window | None) -> Iterator[Block]:
    r0, c0, rows, cols = (0, 0, *data.shape) if window is None else map(
        int, (window.row_off, window.col_off, window.height, window.width)
    )  # fmt: skip
    for band in bands:
        high, wide = data.block_shapes[band - 1]
        for row in range(r0 // high, (r0 + rows - 1) // high + 1):
            for col in range(c0 // wide, (c0 + cols - 1) // wide + 1):
                yield band, row, col


def _is_sound(data: DatasetReader, block: Block, file: BinaryIO, bands: int) -> bool:
    band, row, col = block
    at, size = (data.get_tag_item(f"BLOCK_{what}_{col}_{row}", "TIFF", bidx=band) for what in ("OFFSET", "SIZE"))
    if not at or not size:  # a sparse block, not stored in the file
        return True
    file.seek(int(at))
    stream = zlib.decompressobj()
    high, wide = data.block_shapes[band - 1]
    most = high * wide * bands * np.dtype(data.dtypes[band - 1]).itemsize
    try:
        found = stream.decompress(file.read(int(size)), most + 1)
        return len(found) <= most and (stream.eof or not stream.decompress(stream.unconsumed_tail, 1)) and stream.eof
    except zlib.error:
        return False
