"""Raster opening with an allow-list of local drivers and checked references.

GDAL opens a document that refers to network locations (WMS, WCS, WMTS, STAC), or other local files, as readily
as a TIFF file, whatever its name. So files are opened only with allow-listed drivers; a VRT, whose sources GDAL opens
with any driver, is first parsed as XML.
"""

from __future__ import annotations

import contextlib
import functools
import os

import numpy as np
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetReader

from jaxgeo.io._beside import MAGICS, check_beside, check_overviews_named, head_of
from jaxgeo.io._gdal import GDAL_ERRORS, header_losses, options
from jaxgeo.io._memory_at_hand import check_fits
from jaxgeo.io._quietly import quietly
from jaxgeo.io._regular import check_regular
from jaxgeo.io._vrt_names import check_vrt, check_vrt_text
from jaxgeo.io._whole import mistake_of
from jaxgeo.io.reach import ALLOW_OUTSIDE, ALLOW_REMOTE, HERE, Reach, file_in, is_beside, is_local, is_remote

# Formats of one file, or of several with one name; none of them follows references in its content. Formats missing in
# the GDAL build are skipped.
DRIVERS = (
    "GTiff", "HFA", "AIG", "AAIGrid", "GRASSASCIIGrid", "ISG", "DTED", "PNG", "JPEG", "JPEGXL", "GIF", "BIGGIF", "BMP",
    "PCRaster", "SRTMHGT", "Terragen", "netCDF", "JP2OpenJPEG", "JP2ECW", "JP2KAK", "JP2MrSID",
    "ECW", "MrSID", "WEBP", "NITF", "RST", "SAGA", "GSAG", "GSBG", "GS7BG", "NWT_GRD", "USGSDEM", "BT", "GTX", "BYN",
    "NGSGEOID", "HF2", "LCP", "SIGDEM", "ZMap", "XYZ", "ENVI", "EHdr", "ROI_PAC", "PNM", "ACE2", "GXF",
)  # fmt: skip
GRIDS = ("GTiff", "GTX")  # that PROJ reads
RAW_VALUES = "GDAL_VRT_RAWRASTERBAND_ALLOWED_SOURCE"  # newer GDAL versions use it to refuse outside sources
# Document types by their first bytes. GDAL searches some of them anywhere in the header.
DOCUMENTS = {
    b"<GDAL_WMS": "WMS", b"<WMS_": "WMS", b"<WMT_MS_Capabilities": "WMS", b"<TileMap": "TMS", b"<WCS_GDAL": "WCS",
    b"<GDAL_WMTS": "WMTS", b"<Capabilities": "WMTS", b"stac_version": "STAC", b"<GDALTileIndexDataset": "tile index",
    b"<MRF_META": "MRF", b"PCIDSK": "PCIDSK", b"OziExplorer": "OziExplorer", b"<kml": "KML", b"SQLite format": "SQLite",
}  # fmt: skip
ARCHIVES = (b"PK\3\4", b"\x1f\x8b", b"BZh", b"7z\xbc\xaf")  # magic bytes
OPENED = (*MAGICS, b"\x89PNG", b"\xff\xd8\xff", b"CDF", b"GIF8", b"NITF")  # of DRIVERS: unopened ones are damaged
VRT = b"<VRTDataset"
MOST_NESTED = 16  # nested VRTs


def open_raster(
    name: str, reach: Reach, error: type[ValueError], what: str, drivers: tuple[str, ...] = DRIVERS
) -> DatasetReader:
    """Open a raster file; `what` is expected, for messages, and `drivers` may open it, or that of VRTs.

    Raises `error` if it is not a raster, damaged, or out of reach; `FileNotFoundError`.
    """
    given = _checked(name, reach, error)
    chosen = ["VRT"] if _is_vrt(name, error) else None if reach.remote else list(drivers)
    more = {RAW_VALUES: "ALL"} if reach.outside else {}
    with options(**more), quietly(NotGeoreferencedWarning), header_losses() as lost:
        try:
            data = DatasetReader(given, driver=chosen)
        except GDAL_ERRORS as reason:
            raise error(f"{name}: {_why(name, reach, error, what)}{reason}{_way_out(name, reach, error)}") from reason
        with contextlib.ExitStack() as until_checked:
            until_checked.enter_context(data)
            if lost:
                raise error(f"{name}: the file is damaged or cut short: {lost[0]}.")
            _check_opened(name, data, reach, error)
            until_checked.pop_all()
        return data


def check_name(name: str, reach: Reach, error: type[ValueError]) -> None:
    """Raise `error` for a name that only GDAL can resolve, unless allowed; or for a pipe."""
    if "\0" in name or (os.path.exists(name) and not is_remote(name)):
        check_regular(name, error)
        return
    if is_local(name) or reach.remote:
        return
    file = file_in(name)
    if file is None:
        raise error(f"{name}: this is no file of this machine by its path. {ALLOW_REMOTE}, or download it first.")
    check_regular(file, error)


def _checked(name: str, reach: Reach, error: type[ValueError]) -> str:
    """The name passed to GDAL: a local file's name cannot be mistaken for a GDAL name."""
    check_name(name, reach, error)
    file = name if is_local(name) or os.path.exists(name) else file_in(name)
    if file is None or is_remote(name):
        return name
    if not os.path.exists(file):
        raise FileNotFoundError(f"{file}: no such file.")
    if name.startswith("vrt://"):
        _check_source(file, reach, error, 0)
    else:
        _check_file(file, reach, error, 0)
    return name if file != name or os.path.isabs(name) else os.path.join(os.curdir, name)


def _check_file(path: str, reach: Reach, error: type[ValueError], depth: int) -> None:
    """Raise `error` for a local raster that refers, itself or by a sidecar, to something out of reach."""
    if depth > MOST_NESTED:
        raise error(f"{path}: VRTs in VRTs, more than {MOST_NESTED} deep; does one have itself among its sources?")
    for beside in check_beside(path, error):
        _check_by_opening(beside, ["GTiff", "HFA"], error)
    if not os.path.isdir(path) and VRT in head_of(path, error):
        check_vrt(path, reach, error, lambda file: _check_source(file, reach, error, depth + 1))


def _check_source(path: str, reach: Reach, error: type[ValueError], depth: int) -> None:
    """Check a raster that GDAL will open by itself, with any of its drivers."""
    if VRT in head_of(path, error):
        _check_file(path, reach, error, depth)
        return
    found, around = os.stat(path), os.stat(os.path.dirname(os.path.abspath(path)))
    _check_plain_source(path, reach, error, (found.st_mtime_ns, found.st_size, around.st_mtime_ns))


@functools.lru_cache(maxsize=65_536)
def _check_plain_source(path: str, reach: Reach, error: type[ValueError], stamp: tuple[int, int, int]) -> None:
    """As `_check_source`, for files other than VRTs; cached by time and size of the file and time of its folder."""
    del stamp
    _check_file(path, reach, error, 0)
    if reach.remote:
        return
    kind = _document(head_of(path, error))
    if kind is not None:
        raise error(f"{path}: {_of_document(kind)}")
    _check_by_opening(path, list(DRIVERS), error)


def _check_by_opening(path: str, drivers: list[str], error: type[ValueError]) -> None:
    with options(), quietly(NotGeoreferencedWarning):
        try:
            with DatasetReader(path, driver=drivers) as data:
                _check_opened(path, data, HERE, error)
        except GDAL_ERRORS as reason:
            raise error(f"{path}: not a raster of a kind that is read here, or a damaged one: {reason}") from reason


def _is_vrt(name: str, error: type[ValueError]) -> bool:
    return name.startswith("vrt://") or (os.path.isfile(name) and VRT in head_of(name, error))


def _check_opened(name: str, data: DatasetReader, reach: Reach, error: type[ValueError]) -> None:
    """Check the references of an open file before any other query: GDAL then searches for overviews."""
    if reach.remote and not reach.outside and data.driver == "VRT" and is_remote(name):
        xml = data.tags(ns="xml:VRT").get("xml:VRT", "").encode()
        check_vrt_text(name, xml, os.path.dirname(name), reach, error, lambda file: None)
    if is_remote(name):
        return
    mistake = mistake_of(data)
    if mistake:
        raise error(f"{name}: the file is damaged or cut short: {mistake}.")
    check_overviews_named(name, data.tags(ns="OVERVIEWS").get("OVERVIEW_FILE"), error)
    _check_blocks(name, data, error)
    if reach.outside or data.driver == "VRT":
        return
    folder = os.path.dirname(os.path.abspath(file_in(name) or name))
    for file in data.files:
        plain = os.path.abspath(file)
        if is_local(file) and not plain.startswith(folder.rstrip(os.sep) + os.sep) and not is_beside(file, folder):
            raise error(f"{name}: a part of it is {file}, which lies outside its folder. {ALLOW_OUTSIDE}.")


def _check_blocks(name: str, data: DatasetReader, error: type[ValueError]) -> None:
    """Raise `error` if one block of the file, which GDAL reads as a whole, is too large."""
    together = data.count if data.interleaving is not None and data.interleaving.name == "pixel" else 1
    for (rows, cols), dtype in zip(data.block_shapes, data.dtypes, strict=True):
        size = together * rows * cols * (16 if dtype.startswith("complex") else np.dtype(dtype).itemsize)
        check_fits(
            size,
            error,
            f"{name}: it is stored in blocks of {rows:,} x {cols:,} values, which each",
            "Write it in smaller ones (gdal_translate -co TILED=YES).",
        )


def _why(name: str, reach: Reach, error: type[ValueError], what: str) -> str:
    """Why a file cannot be opened, as the beginning of a sentence that ends with GDAL's message."""
    if not reach.remote and is_local(name) and os.path.isfile(name):
        kind = _document(head_of(name, error))
        if kind is not None:
            return _of_document(kind) + " GDAL: "
    return f"not {what} that GDAL can open, or a damaged one: "


def _way_out(name: str, reach: Reach, error: type[ValueError]) -> str:
    """Remedy for a local file that no driver opens, as a sentence."""
    if not is_local(name) or not os.path.isfile(name):
        return ""
    head = head_of(name, error)
    if head.startswith(ARCHIVES):
        return " It is an archive: unpack it first, and name the raster in it."
    if reach.remote or not head or _document(head) is not None or head.startswith(OPENED):
        return ""
    return f" Is it of another of GDAL's formats? {ALLOW_REMOTE}, or write it to a GeoTIFF first (gdal_translate)."


def _document(head: bytes) -> str | None:
    """The document type by its first bytes."""
    return next((kind for mark, kind in DOCUMENTS.items() if mark in head), None)


def _of_document(kind: str) -> str:
    return (
        f"this is of a kind of GDAL's ({kind}) that may name other places, on the network perhaps. {ALLOW_REMOTE}, or "
        f"write what it shows to a file first (gdal_translate)."
    )
