"""Checks for rasters that GDAL misreads: text grids with invalid numbers, truncated raw files.

GDAL reads the leading digits of a word in a text grid as its value ("391.293.7" as 391.293, "3x3.6" as 3),
and zeros for missing values of some truncated raw files. Both would become heights.
"""

from __future__ import annotations

import functools
import itertools
import os
import re
import zipfile
import zlib
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from rasterio.io import DatasetReader

TEXT_GRIDS = ("AAIGrid", "GRASSASCIIGrid", "GSAG", "XYZ")
ARC = ("AAIGrid", "GRASSASCIIGrid")  # values start at the first line that does not begin with a letter
# Where GDAL starts reading those values: at the first or second character of a line, if that is not a letter.
BEGIN_OF_GDAL = re.compile(rb"(?<=[\r\n])[A-Za-z]?(?=[^A-Za-z\r\n]|null |nan )", re.IGNORECASE)
PLACES = ((b"xllcorner", b"yllcorner"), (b"xllcenter", b"yllcenter"))  # without a pair GDAL uses the origin (0, 0)
STATED = (b"ncols", b"nrows", b"cellsize", b"dx", b"dy", b"nodata_value", *PLACES[0], *PLACES[1],
          *(b"north:", b"south:", b"east:", b"west:", b"rows:", b"cols:", b"null:"))  # fmt: skip
# Minimum header size in bytes of formats with uncompressed values.
RAW = {"ACE2": 0, "BT": 256, "EHdr": 0, "ENVI": 0, "GS7BG": 100, "GSBG": 56, "GTX": 40, "LCP": 0,
       "NGSGEOID": 0, "RST": 0, "ROI_PAC": 0, "SAGA": 0, "SRTMHGT": 0}  # fmt: skip
EXACT = ("BT", "GSBG", "GTX")  # no bytes may follow their values
ARCHIVES = (".zip", ".sg-grd-z")
PACKED = (".hgt", ".raw", ".sdat")  # raw files that GDAL reads from an archive
CLASSIC = b"CDF"  # magic bytes of netCDF files without compression
# Without backtracking, so that its time is linear.
NUMBER = rb"[+-]?(?:[0-9]++(?:[.,][0-9]*+)?+|[.,][0-9]++)(?:[eE][+-]?[0-9]++)?+"
VALUE = rb"(?>" + NUMBER + rb"|[+-]?(?:nan|inf|1\.#(?:qnan|snan|ind|inf)0*+)|\*)"
VALUES = re.compile(rb"\s*+(?:" + VALUE + rb"\s++)*+", re.IGNORECASE)
ONE_VALUE = re.compile(VALUE, re.IGNORECASE)
AS_GDAL_SPLITS = bytes.maketrans(b"\t\r\n", b"   ")  # splits header words; a form feed is part of a word
TO_SPACES = bytes.maketrans(b",;", b"  ")  # separators of XYZ
PART = 1 << 20  # bytes of a text checked at a time
SHOWN = 40  # characters of a word in a message


def mistake_of(data: DatasetReader) -> str:
    """A fault in the values of an open file, as the end of a sentence; empty if none is found."""
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
    """A fault in the raw file in an archive (an SRTM tile, .hgt.zip), whose checksum GDAL does not verify."""
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                if not member.filename.lower().endswith(PACKED):
                    continue
                if member.file_size != needed:
                    return f"by its header it has {needed} bytes, and {member.file_size} are in the archive"
                with archive.open(member) as file:
                    while file.read(PART):  # the checksum is verified at the end
                        pass
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as reason:
        return f"the archive cannot be unpacked ({reason})"
    return ""


def _begins(path: str, mark: bytes) -> bool:
    with open(path, "rb") as file:
        return file.read(len(mark)) == mark


@functools.lru_cache(maxsize=1024)
def _of_text(path: str, driver: str, shape: tuple[int, int], stamp: tuple[int, int]) -> str:
    """The first invalid number of a text grid, or a count of numbers that differs from the posts."""
    del stamp  # only part of the cache key: a changed time or size means a changed file
    count = 0
    with open(path, "rb") as file:
        if driver in ARC and (mistake := _of_header(file.read(PART), driver)):
            return mistake
        file.seek(0)
        for part in _parts(file, driver):
            if VALUES.fullmatch(part) is None:
                words = part.split()
                wrong = next((word for word in words if not ONE_VALUE.fullmatch(word)), words[-1])
                return f"{_shown(wrong)!r} in it is not a number"
            count += len(part.split())
    if driver == "AAIGrid" and count != shape[0] * shape[1]:
        return f"it holds {count} values, and its header says {shape[0]} x {shape[1]}"
    return ""


def _parts(file: BinaryIO, driver: str) -> Iterator[bytes]:
    """The words that should be numbers, in chunks that end between words, each with trailing white space."""
    text = file.read(PART)
    rest = text[_begin(text) :]
    while True:
        new = file.read(PART)
        text = (rest + new).translate(TO_SPACES) if driver == "XYZ" else rest + new
        cut = len(text) if not new else max(text.rfind(mark) for mark in (b" ", b"\n", b"\t", b"\r")) + 1
        yield text[:cut] if new else text + b" "
        if not new:
            return
        rest = text[cut:]
        if len(rest) > PART:
            yield rest  # too long for a word
            return


def _of_header(text: bytes, driver: str) -> str:
    """A fault in the header of a text grid: values that GDAL reads differently, or a missing position."""
    begin = _begin(text)
    found = BEGIN_OF_GDAL.search(text)
    begin_of_gdal = found.end() if found else len(text)
    first, last = sorted((begin, begin_of_gdal))
    if text[first:last].strip():
        wrong, right = (_shown(text[at:].split()[0]) if text[at:].split() else "" for at in (begin_of_gdal, begin))
        return f"GDAL takes its values to begin at {wrong!r}, not at {right!r}"
    words = [word for word in text[:begin].translate(AS_GDAL_SPLITS).split(b" ") if word]
    stated: dict[bytes, bytes] = {}
    for name, value in itertools.pairwise([*words, b""]):
        name = name.lower()
        if name not in STATED:
            continue
        if not ONE_VALUE.fullmatch(value):
            return f"{_shown(value)!r}, which its header states as {_plain(name)}, is not a number"
        if stated.setdefault(name, value) != value:
            return f"its header states {_plain(name)} twice, as {_shown(stated[name])} and {_shown(value)}"
    if driver == "AAIGrid" and not any(all(name in stated for name in pair) for pair in PLACES):
        return "its header states neither xllcorner and yllcorner nor xllcenter and yllcenter, so that it has no place"
    return ""


def _shown(word: bytes) -> str:
    return word[:SHOWN].decode("ascii", "backslashreplace")


def _plain(name: bytes) -> str:
    return name.decode().rstrip(":")


def _begin(text: bytes) -> int:
    """Start of the values of a text grid: the first line whose first word is a number, or begins like one."""
    at = 0
    for line in text.splitlines(keepends=True):
        words = line.split()
        if words and (ONE_VALUE.fullmatch(words[0]) or not words[0][:1].isalpha()):
            break
        at += len(line)
    return at
