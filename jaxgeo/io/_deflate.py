"""Blocks of TIFF files that are compressed by deflate, held against the checksum that each of them ends in.

libtiff takes a block for whole that decodes to more than it should, as a damaged one may, and does not come to its
checksum; its last values then are what lies in memory by chance, others at every reading.
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
    """Which block under a window of a deflated TIFF file is damaged, in words; empty if none is.

    `sound` are blocks that have been looked at before; it gets those that are now.
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
    if not at or not size:  # a sparse block, that is not in the file
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
