"""What GDAL raises, through rasterio, over a file that it cannot read."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from rasterio._err import CPLE_BaseError, CPLE_OutOfMemoryError
from rasterio.errors import RasterioError

# rasterio turns most of GDAL's errors into its own, but not all; it decodes GDAL's messages and the names in a file as
# UTF-8, which those of a damaged one are not.
GDAL_ERRORS = (RasterioError, CPLE_BaseError, UnicodeDecodeError)


@contextlib.contextmanager
def refused_as(error: type[ValueError], name: str, what: str) -> Iterator[None]:
    """Errors of GDAL over a file as `error`, whose message names the file and `what` cannot be read."""
    try:
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
