"""References of a VRT, checked before GDAL opens it: known source types, and files beside or below it."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from xml.etree.ElementTree import Element

from jaxgeo.io._beside import OVERVIEWS, check_overviews_named, head_of
from jaxgeo.io._crs_reach import check_crs_in
from jaxgeo.io._gdal_xml import entries, entry, root_of
from jaxgeo.io._regular import check_regular
from jaxgeo.io.reach import ALLOW_OUTSIDE, ALLOW_REMOTE, Reach, is_beside, is_local, is_remote

MOST_XML = 512 * 2**20  # bytes; a mosaic of 100,000 tiles takes some 60 MB
KINDS = ("", "vrtwarpeddataset")
BANDS = ("", "vrtrasterband", "vrtsourcedrasterband", "vrtrawrasterband", "vrtwarpedrasterband")
SOURCES = ("source", "simplesource", "complexsource", "averagedsource", "nodatafrommasksource", "kernelfilteredsource")
NAMING = ("sourcefilename", "sourcedataset", "dempath", "x_dataset", "y_dataset")
OPENING = ("overview_level", "num_threads")  # allowed open options of a source
COMPUTING = ("pixelfunctiontype", "pixelfunctionlanguage", "pixelfunctioncode", "group", "processingsteps", "input")
_SPLIT = re.compile(rb"<(?:" + "|".join(NAMING).encode() + rb")\b[^>]*>[^<]*<[^/]", re.IGNORECASE)


def check_vrt(path: str, reach: Reach, error: type[ValueError], check: Callable[[str], None]) -> None:
    """Raise `error` for a VRT of an unknown type, or one that refers to something out of reach.

    `check` is called once for each source raster.
    """
    content = head_of(path, error, MOST_XML + 1)
    if len(content) > MOST_XML:
        raise error(f"{path}: a VRT of more than {MOST_XML // 2**20} MB is not read. Name the files in its place.")
    check_vrt_text(path, content, os.path.dirname(os.path.realpath(path)), reach, error, check)


def check_vrt_text(
    path: str, content: bytes, folder: str, reach: Reach, error: type[ValueError], check: Callable[[str], None]
) -> None:
    """As `check_vrt`, for the XML of a VRT in `folder`."""
    try:
        root = root_of(content)
    except ValueError as reason:
        raise error(f"{path}: this VRT is no sound XML ({reason}). Write it anew (gdalbuildvrt).") from reason
    if str(root.tag).lower() != "vrtdataset" or _SPLIT.search(content):
        raise error(f"{path}: this is not a VRT as GDAL writes it. Write it anew (gdalbuildvrt).")
    if not reach.outside:
        check_crs_in(path, root, error)
    named: dict[tuple[str, bool, bool], None] = {}
    for element in root.iter():
        _check_kind(path, element, error)
        named |= dict.fromkeys(_named(path, element, error))
    seen: set[str] = set()
    for name, is_relative, is_raw in named:
        file = _reached(path, name, folder if is_relative else "", folder, reach, error)
        if file is None or file in seen:
            continue
        seen.add(file)
        check_regular(file, error)
        if not is_raw and os.path.exists(file):
            check(file)


def _check_kind(path: str, element: Element, error: type[ValueError]) -> None:
    tag = str(element.tag).lower()
    kind, allowed = entry(element, "subclass"), KINDS if tag == "vrtdataset" else BANDS
    if kind.lower() not in allowed:
        how = "resamples" if tag == "vrtdataset" else "is computed"
        raise error(
            f"{path}: this VRT {how} as it is read ({kind}), which is not done here. Name the files that it is put "
            f"together from (or their folder) in its place, or write it to a file first (gdal_translate)."
        )
    for name in (tag, *(key for key, _ in entries(element))):
        if name in COMPUTING or (name.endswith("source") and name not in SOURCES):
            raise error(
                f"{path}: this VRT is computed as it is read ({element.tag}), which is not done here. Name the files "
                f"that it is put together from in its place, or write it to a file first (gdal_translate)."
            )
    if tag == "ooi" and entry(element, "key").lower() not in OPENING:
        raise error(
            f"{path}: this VRT opens its sources with an option that is not known here ({entry(element, 'key')}). "
            f"Write it anew without (gdalbuildvrt), or to a file (gdal_translate)."
        )


def _named(path: str, element: Element, error: type[ValueError]) -> list[tuple[str, bool, bool]]:
    """(name, whether it is relative to the VRT, whether it is a raw source) of an element's references."""
    tag, key = str(element.tag).lower(), entry(element, "key").lower()
    text = element.text or ""
    if OVERVIEWS in (tag, key):
        check_overviews_named(path, text.strip(), error)
    is_raw = entry(element, "subclass").lower() == "vrtrawrasterband"
    found = []
    for child in element:  # children of children are visited with their parent
        if str(child.tag).lower() in NAMING:
            found.append((child.text or "", entry(child, "relativetovrt") not in ("", "0"), is_raw))
    found += [(value, False, is_raw) for name, value in element.attrib.items() if name.lower() in NAMING]
    if tag == "mdi" and key in NAMING:
        found.append((text, False, False))
    return found


def _reached(path: str, name: str, base: str, folder: str, reach: Reach, error: type[ValueError]) -> str | None:
    """The local file of a name; None for an allowed remote one. Raises `error` for one out of reach."""
    if "<" in name:
        raise error(f"{path}: this VRT holds another one in place of the name of a file. Write that to a file first.")
    if is_remote(name) or not is_local(name):
        if reach.remote:
            return None
        raise error(
            f"{path}: it takes values from {name}, which is no file of this machine by its path. {ALLOW_REMOTE}, or "
            f"download it, and write the VRT anew (gdalbuildvrt)."
        )
    file = os.path.join(base, name)
    if not reach.outside and not is_beside(file, folder):
        raise error(
            f"{path}: it takes values from {file}, which does not lie in the folder of the VRT or below. "
            f"{ALLOW_OUTSIDE}, or name the files that it is put together from in its place."
        )
    return file
