"""Fetched ground as one GeoTIFF with heights above the WGS 84 ellipsoid."""

from __future__ import annotations

import os
import pathlib
from typing import Any

import numpy as np
import pyproj
import rasterio
from rasterio.transform import Affine

from jaxgeo._partial import partial_file
from jaxgeo.io._gdal import GDAL_ERRORS, options
from jaxgeo.io._memory_at_hand import check_fits
from jaxgeo.io.archives.errors import ArchiveError
from jaxgeo.io.archives.record import FetchedDem
from jaxgeo.io.heights import open_source
from jaxgeo.io.vertical import horizontal_part
from jaxgeo.io.windows import Window

BYTES = 40  # per post, while it is written


def write_dem(path: str | os.PathLike[str], found: FetchedDem, **how: Any) -> tuple[int, int]:
    """Write the ground of `found` within its bounds; returns (rows, cols).

    The posts are those of the tiles, as float64, heights in m above the WGS 84 ellipsoid, voids as NaN. The CRS says so
    (EPSG:4979) if that of the tiles is WGS 84 in degrees; else give `vertical_datum="ellipsoid"` to `read_dem`. `how`
    are `nodata`, `height_unit` and `assume_wgs84` of `read_dem`. Raises `DemError`; `ArchiveError` if it cannot be
    written.
    """
    target = pathlib.Path(path)
    if target.suffix.lower() not in (".tif", ".tiff"):
        raise ArchiveError(f"{target}: an elevation model is written as a GeoTIFF; use .tif.")
    given: dict[str, Any] = {"nodata": None, "height_unit": None, "assume_wgs84": False}
    source = open_source(
        list(found.files), band=1, vertical_datum=found.vertical_datum, bounds=found.bounds, **(given | how)
    )
    rows, cols = source.window.shape
    check_fits(rows * cols * BYTES, ArchiveError, f"{target}: {rows:,} x {cols:,} posts", "Ask for less ground.")
    heights, void = source.heights(Window(0, 0, rows, cols), np.dtype(np.float64))
    heights[void] = np.nan
    flat = horizontal_part(source.mosaic.first.crs)
    crs = pyproj.CRS("EPSG:4979") if flat.to_epsg() == 4326 else flat
    a, b, c, d, e, f = source.mapping.affine
    profile: dict[str, Any] = {
        "driver": "GTiff", "dtype": "float64", "count": 1, "height": rows, "width": cols, "nodata": np.nan,
        "crs": crs.to_wkt(), "transform": Affine(a, b, c - (a + b) / 2.0, d, e, f - (d + e) / 2.0),
        "compress": "deflate", "predictor": 3,
    }  # fmt: skip
    try:
        with partial_file(target) as partial:
            with options(), rasterio.open(partial, "w", **profile) as sink:
                sink.update_tags(AREA_OR_POINT="Point", TIFFTAG_COPYRIGHT=_ascii(found.archive.attribution))
                sink.write(heights, 1)
            partial.replace(target)
    except (OSError, *GDAL_ERRORS) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else " ".join(f"{error}".split())
        raise ArchiveError(f"{target}: it cannot be written: {reason}; name another file.") from error
    return rows, cols


def _ascii(text: str) -> str:
    return text.replace("©", "(c)").encode("ascii", "replace").decode()
