"""Sidecar files that GDAL opens with a raster (masks, overviews, auxiliary XML), checked before it does.

GDAL opens `dem.tif.msk` and `dem.tif.ovr` with any of its drivers, and follows the overview file name in
`dem.tif.aux.xml`: each could refer to a network location.
"""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Iterator

from jaxgeo.io._crs_reach import check_crs_in
from jaxgeo.io._gdal_xml import entry, root_of
from jaxgeo.io._regular import check_regular

RASTERS = (".msk", ".ovr", ".aux", ".rrd")
XML = ".aux.xml"
DEEPEST = 2  # nesting depth, such as masks of overviews
MOST_XML = 64 * 2**20  # bytes
AUX, HFA = ".aux", b"EHFA_HEADER_TAG"
MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", HFA)
OVERVIEWS, BASE = "overview_file", ":::BASE:::"


def check_beside(path: str, error: type[ValueError]) -> list[str]:
    """The masks and overviews beside a raster; raises `error` for sidecars that may refer to other locations."""
    rasters = []
    for file in _candidates(path):
        check_regular(file, error)
        if file.lower().endswith(XML):
            _check_xml(file, error)
        elif file.lower().endswith(AUX) and not head_of(file, error).startswith(HFA):
            continue  # GDAL looks at its first bytes, too: LaTeX, for one, writes such files
        elif not head_of(file, error).startswith(MAGICS):
            raise error(
                f"{path}: GDAL would open {file} beside it as its mask or overviews, and that is no TIFF file. "
                f"Move it elsewhere."
            )
        else:
            rasters.append(file)
    return rasters


def head_of(path: str, error: type[ValueError], size: int = 1024) -> bytes:
    """The first bytes of a file. Raises `error` if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return file.read(size)
    except OSError as reason:
        raise error(f"{path}: it cannot be read: {reason.strerror}.") from reason


def check_overviews_named(path: str, named: str | None, error: type[ValueError]) -> None:
    """Raise `error` if a file names overviews that are not beside it."""
    if not named:
        return
    rest = named.removeprefix(BASE)
    if named == rest or os.path.basename(rest) != rest or not rest.lower().endswith(RASTERS):
        raise error(
            f"{path}: it names {named!r} as the file of its overviews; GDAL would open that. Take the entry out "
            f"(gdal_translate to a new file does)."
        )


def _candidates(path: str) -> Iterator[str]:
    folder, name = os.path.split(os.path.abspath(path))
    try:
        there = _listed(folder, os.stat(folder).st_mtime_ns)
    except OSError:
        return
    if not there:
        return
    for base in dict.fromkeys((name.lower(), os.path.splitext(name)[0].lower())):
        for length in range(DEEPEST + 1):
            for endings in itertools.product(RASTERS, repeat=length):
                stem = base + "".join(endings)
                beside = there.get(stem, ()) if endings else ()
                for found in (*beside, *there.get(stem + XML, ())):
                    if found != name:
                        yield os.path.join(folder, found)


@functools.lru_cache(maxsize=64)
def _listed(folder: str, stamp: int) -> dict[str, tuple[str, ...]]:
    """Possible sidecar names in a folder by their lower-case form: GDAL ignores case."""
    del stamp  # only part of the cache key
    found: dict[str, tuple[str, ...]] = {}
    for one in os.listdir(folder):
        if one.lower().endswith((*RASTERS, XML)):
            found[one.lower()] = (*found.get(one.lower(), ()), one)
    return found


def _check_xml(path: str, error: type[ValueError]) -> None:
    content = head_of(path, error, MOST_XML + 1)
    if len(content) > MOST_XML:
        raise error(f"{path}: {len(content)} bytes and more are too many for auxiliary XML of GDAL's; move it away.")
    try:
        root = root_of(content)
    except ValueError as reason:
        raise error(
            f"{path}: this is not the auxiliary XML that GDAL expects here ({reason}); move it away."
        ) from reason
    check_crs_in(path, root, error)
    for element in root.iter():
        if entry(element, "key").lower() == OVERVIEWS:
            check_overviews_named(path, (element.text or "").strip() or "a file", error)
