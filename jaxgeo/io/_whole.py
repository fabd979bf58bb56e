"""Rasters of which GDAL reads more than is there: text grids with words that are no numbers, raw files cut short.

GDAL takes the digits at the beginning of a word of a text grid for its value ("391.293.7" as 391.293, "3x3.6" as 3), and
zero for the values that some raw files are too short for. Both would be heights.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
import rasterio

TEXT_GRIDS = ("AAIGrid", "GRASSASCIIGrid", "GSAG")
# Bytes of the header of files that hold their values as they are; nothing where the header is a file of its own.
EXACT = ("BT", "GSBG", "GTX")  # nothing may come behind their values
RAW = {"BT": 256, "EHdr": 0, "ENVI": 0, "ERS": 0, "GS7BG": 100, "GSBG": 56, "GTX": 40, "KRO": 20, "RST": 0, "SAGA": 0,
       "SRTMHGT": 0}  # fmt: skip
# Without a way back, so that its time is linear.
NUMBER = rb"[+-]?(?:[0-9]++(?:[.,][0-9]*+)?+|[.,][0-9]++)(?:[eE][+-]?[0-9]++)?+"
VALUE = rb"(?>" + NUMBER + rb"|[+-]?(?:nan|inf|1\.#(?:qnan|snan|ind|inf)0*+)|\*)"
VALUES = re.compile(rb"\s*+(?:" + VALUE + rb"\s++)*+", re.IGNORECASE)
ONE_VALUE = re.compile(VALUE, re.IGNORECASE)
HEADER = re.compile(rb"\s*(?:DSAA\s+|(?:[A-Za-z_]+:?[ \t]+\S+\s+)*)")
PART = 1 << 20  # bytes of a text that are looked at at a time
SHOWN = 40  # characters of a word in a message


def mistake_of(data: rasterio.DatasetReader) -> str:
    """What is wrong with the values of an open file, as the end of a sentence; empty if nothing is, as far as is known."""
    path = data.name
    if not os.path.isfile(path):
        return ""
    if data.driver in TEXT_GRIDS:
        return _wrong_word(path)
    if data.driver in RAW:
        needed = RAW[data.driver] + data.width * data.height * sum(np.dtype(name).itemsize for name in data.dtypes)
        there = max((os.path.getsize(name) for name in data.files if os.path.isfile(name)), default=0)
        is_whole = there == needed if data.driver in EXACT else there >= needed
        return "" if is_whole else f"by its header it has {needed} bytes, and {there} are there"
    return ""


def _wrong_word(path: str) -> str:
    """The first word of a text grid, below its header, that is no number."""
    with open(path, "rb") as file:
        for part in _parts(file):
            if VALUES.fullmatch(part) is None:
                words = part.split()
                wrong = next((word for word in words if not ONE_VALUE.fullmatch(word)), words[-1])
                return f"{wrong[:SHOWN].decode('ascii', 'backslashreplace')!r} in it is not a number"
    return ""


def _parts(file: BinaryIO) -> Iterator[bytes]:
    """The text below the header, in parts that end between words, each with white space at its end."""
    rest = file.read(PART)
    rest = rest[HEADER.match(rest).end() :]  # type: ignore[union-attr]
    while True:
        new = file.read(PART)
        text = rest + new
        cut = len(text) if not new else max(text.rfind(mark) for mark in (b" ", b"\n", b"\t", b"\r")) + 1
        yield text[:cut] if new else text + b" "
        if not new:
            return
        rest = text[cut:]
        if len(rest) > PART:
            yield rest  # no word is that long
            return
