"""GDAL through rasterio: the options that files are opened and read with, and what it raises over a damaged one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import rasterio
from rasterio._err import CPLE_BaseError, CPLE_OutOfMemoryError
from rasterio.errors import RasterioError

# rasterio turns most of GDAL's errors into its own, but not all; it decodes GDAL's messages and the names in a file as
# UTF-8, which those of a damaged one are not.
GDAL_ERRORS = (RasterioError, CPLE_BaseError, UnicodeDecodeError)
# - The vertical part of a GeoTIFF's CRS is not dropped.
# - PNG is decoded by libpng, row by row: GDAL's way for whole images does not look at the checksums, and gives what is
#   in memory by chance where a damaged file has no pixels.
# - What libjpeg only warns of, such as an image that ends before its time, is an error.
# - No Python that a VRT holds is run.
OPTIONS = {
    "GDAL_VRT_ENABLE_PYTHON": "NO",
    "GTIFF_REPORT_COMPD_CS": "YES",
    "GDAL_PNG_WHOLE_IMAGE_OPTIM": "NO",
    "GDAL_ERROR_ON_LIBJPEG_WARNING": "YES",
}


def options(**more: Any) -> rasterio.Env:
    """The options, and more, within a `with`: they hold for opening and for reading alike."""
    settings: dict[str, Any] = OPTIONS | more
    return rasterio.Env(**settings)


@contextlib.contextmanager
def refused_as(error: type[ValueError], name: str, what: str) -> Iterator[None]:
    """Errors of GDAL over a file as `error`, whose message names the file and `what` cannot be read."""
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
