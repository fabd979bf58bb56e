"""Rasters of which GDAL reads more than is there: text grids with words that are no numbers, raw files cut short.

GDAL takes the digits at the beginning of a word of a text grid for its value ("391.293.7" as 391.293, "3x3.6" as 3),
and zero for the values that some raw files are too short for. Both would be heights.
"""

from __future__ import annotations

import functools
import os
import re
import zipfile
import zlib
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from rasterio.io import DatasetReader

TEXT_GRIDS = ("AAIGrid", "GRASSASCIIGrid", "GSAG", "XYZ")
ARC = ("AAIGrid", "GRASSASCIIGrid")  # whose values begin with the first line that begins with no letter
# Bytes of the header of files that hold their values as they are, at least.
RAW = {"ACE2": 0, "BT": 256, "EHdr": 0, "ENVI": 0, "GS7BG": 100, "GSBG": 56, "GTX": 40, "LCP": 0,
       "NGSGEOID": 0, "RST": 0, "ROI_PAC": 0, "SAGA": 0, "SRTMHGT": 0}  # fmt: skip
EXACT = ("BT", "GSBG", "GTX")  # nothing may come behind their values
ARCHIVES = (".zip", ".sg-grd-z")
PACKED = (".hgt", ".raw", ".sdat")  # raw files that GDAL takes from an archive
CLASSIC = b"CDF"  # the first bytes of netCDF files that are never compressed
# Without a way back, so that its time is linear.
NUMBER = rb"[+-]?(?:[0-9]++(?:[.,][0-9]*+)?+|[.,][0-9]++)(?:[eE][+-]?[0-9]++)?+"
VALUE = rb"(?>" + NUMBER + rb"|[+-]?(?:nan|inf|1\.#(?:qnan|snan|ind|inf)0*+)|\*)"
VALUES = re.compile(rb"\s*+(?:" + VALUE + rb"\s++)*+", re.IGNORECASE)
ONE_VALUE = re.compile(VALUE, re.IGNORECASE)
TO_SPACES = bytes.maketrans(b",;", b"  ")  # separators of XYZ
PART = 1 << 20  # bytes of a text that are looked at at a time
SHOWN = 40  # characters of a word in a message


def mistake_of(data: DatasetReader) -> str:
    """What is wrong with the values of an open file, as the end of a sentence; empty if nothing is known to be."""
    path = data.name
    if not os.path.isfile(path):
        return ""
    if data.driver in TEXT_GRIDS:
        found = os.stat(path)
        return _of_text(path, data.driver, data.shape, (found.st_mtime_ns, found.st_size))
    if data.driver in RAW or (data.driver == "netCDF" and _begins(path, CLASSIC)):
        needed = RAW.get(data.driver, 0) + data.width * data.height * sum(
            np.dtype(name).itemsize for name in data.dtypes
        )
        if path.lower().endswith(ARCHIVES):
            return _of_packed(path, needed)
        there = os.path.getsize(path)
        is_whole = there == needed if data.driver in EXACT else there >= needed
        return "" if is_whole else f"by its header it has {needed} bytes, and {there} are there"
    return ""


def _of_packed(path: str, needed: int) -> str:
    """What is wrong with the raw file in an archive (an SRTM tile, .hgt.zip), whose checksum GDAL does not look at."""
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                if not member.filename.lower().endswith(PACKED):
                    continue
                if member.file_size != needed:
                    return f"by its header it has {needed} bytes, and {member.file_size} are in the archive"
                with archive.open(member) as file:
                    while file.read(PART):  # at its end the checksum is compared
                        pass
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as reason:
        return f"the archive cannot be unpacked ({reason})"
    return ""


def _begins(path: str, mark: bytes) -> bool:
    with open(path, "rb") as file:
        return file.read(len(mark)) == mark


@functools.lru_cache(maxsize=1024)
def _of_text(path: str, driver: str, shape: tuple[int, int], stamp: tuple[int, int]) -> str:
    """The first word of a text grid that should be a number and is none, or that there are not as many as posts."""
    del stamp  # part of the key only: another time or size is another file
    count = 0
    with open(path, "rb") as file:
        if driver in ARC and (name := _indented(file.read(PART))):
            return f"the line of {name[:SHOWN].decode('ascii', 'backslashreplace')} in its header begins with a blank"
        file.seek(0)
        for part in _parts(file, driver):
            if VALUES.fullmatch(part) is None:
                words = part.split()
                wrong = next((word for word in words if not ONE_VALUE.fullmatch(word)), words[-1])
                return f"{wrong[:SHOWN].decode('ascii', 'backslashreplace')!r} in it is not a number"
            count += len(part.split())
    if driver == "AAIGrid" and count != shape[0] * shape[1]:
        return f"it holds {count} values, and its header says {shape[0]} x {shape[1]}"
    return ""


def _parts(file: BinaryIO, driver: str) -> Iterator[bytes]:
    """The words that should be numbers, in parts that end between words, each with white space at its end."""
    rest = _below_header(file.read(PART), driver)
    while True:
        new = file.read(PART)
        text = (rest + new).translate(TO_SPACES) if driver == "XYZ" else rest + new
        cut = len(text) if not new else max(text.rfind(mark) for mark in (b" ", b"\n", b"\t", b"\r")) + 1
        yield text[:cut] if new else text + b" "
        if not new:
            return
        rest = text[cut:]
        if len(rest) > PART:
            yield rest  # no word is that long
            return


def _indented(text: bytes) -> bytes:
    """The first word of a line of the header that begins with a blank: GDAL takes the values to begin there."""
    for line in text.splitlines():
        words = line.split()
        if words and (ONE_VALUE.fullmatch(words[0]) or not words[0][:1].isalpha()):
            break
        if words and line[:1].isspace():
            return words[0]
    return b""


def _below_header(text: bytes, driver: str) -> bytes:
    """Text from the first line on that begins with a number; before it, a value of the header that is none."""
    start, wrong = 0, b""
    for line in text.splitlines(keepends=True):
        words = line.split()
        if words and (ONE_VALUE.fullmatch(words[0]) or not words[0][:1].isalpha()):
            break
        if driver == "AAIGrid" and len(words) == 2 and not ONE_VALUE.fullmatch(words[1]):
            wrong = wrong or words[1] + b" "
        start += len(line)
    return wrong + text[start:]
