"""GDAL through rasterio: options for opening and reading, and error translation."""

from __future__ import annotations

import contextlib
import logging
import re
import threading
from collections.abc import Iterator
from typing import Any

import rasterio
from rasterio._err import CPLE_BaseError, CPLE_OutOfMemoryError
from rasterio.errors import RasterioError

# rasterio converts most of GDAL's errors into its own, but not all; it decodes GDAL's messages and names in a file as
# UTF-8, which a damaged file violates.
GDAL_ERRORS = (RasterioError, CPLE_BaseError, UnicodeDecodeError)
LOG = logging.getLogger("rasterio._env")  # where rasterio writes what GDAL warns of
LOST_TAG = re.compile(r'IO error during reading of "((?:Geo|GDAL|RPC)\w*)')
# - The vertical part of a GeoTIFF's CRS is kept.
# - PNG is decoded by libpng, row by row: GDAL's path for whole images does not verify checksums, and returns
#   uninitialised memory where a damaged file has no pixels.
# - libjpeg warnings, such as a premature end of the image, are errors.
# - Python code in a VRT is not run.
OPTIONS = {
    "GDAL_VRT_ENABLE_PYTHON": "NO",
    "GTIFF_REPORT_COMPD_CS": "YES",
    "GDAL_PNG_WHOLE_IMAGE_OPTIM": "NO",
    "GDAL_ERROR_ON_LIBJPEG_WARNING": "YES",
}


def options(**more: Any) -> rasterio.Env:
    """GDAL options with additions, for use with `with`; they apply to opening and reading."""
    settings: dict[str, Any] = OPTIONS | more
    return rasterio.Env(**settings)


@contextlib.contextmanager
def header_losses() -> Iterator[list[str]]:
    """What GDAL could not read of the headers that this thread opens: it warns, and goes on without those tags, so
    that the place of a raster or its mark of voids would be lost."""
    lost: list[str] = []
    here = threading.get_ident()

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            found = LOST_TAG.search(record.getMessage())
            if found and record.thread == here:
                lost.append(f"its tag {found[1]} cannot be read")

    handler = Handler(logging.WARNING)
    LOG.addHandler(handler)
    try:
        yield lost
    finally:
        LOG.removeHandler(handler)


@contextlib.contextmanager
def refused_as(error: type[ValueError], name: str, what: str) -> Iterator[None]:
    """Re-raise GDAL errors as `error`, whose message names the file and `what` cannot be read."""
    try:
        with options():
            yield
    except MemoryError as reason:
        raise error(
            f"{name}: {what} cannot be read: that takes more memory than there is. Read a part of it, or fewer bands."
        ) from reason
    except GDAL_ERRORS as reason:
        cause = reason.__cause__ or reason
        if isinstance(cause, CPLE_OutOfMemoryError):
            raise error(f"{name}: {what} cannot be read: GDAL needs more memory for it than there is.") from reason
        raise error(f"{name}: {what} cannot be read; the file is damaged or cut short: {cause}") from reason
