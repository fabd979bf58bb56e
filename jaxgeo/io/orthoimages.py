"""Orthoimage reader: orthophotos, satellite images and rectified images, georeferenced."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
from rasterio.io import DatasetReader
from rasterio.transform import Affine
from rasterio.windows import Window

from jaxgeo._checks import require_x64
from jaxgeo.io._crs_reach import check_crs
from jaxgeo.io._gdal import GDAL_ERRORS, refused_as
from jaxgeo.io._proj import UNKNOWN_CRS, known_crs
from jaxgeo.io.errors import DemError, ImageError
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.images import Bands, chosen_bands, opened, read_bands
from jaxgeo.io.map_raster import MapRaster, map_of
from jaxgeo.io.mapping import MapError
from jaxgeo.io.reach import HERE, Reach
from jaxgeo.io.vertical import horizontal_part
from jaxgeo.io.windows import Bounds, window_of_bounds
from jaxgeo.ortho.orthoimage import Orthoimage


class OrthoimageReport(NamedTuple):
    """Report on how an orthoimage was read.

    `raster` is the CRS, transform and shape of the part read, for writing another onto the same
    cells; `window` its (row, col) in the file; `bands` their numbers, from 1; `horizontal` the operation to WGS 84 as
    text; `map_error` the difference between the grid and PROJ.
    """

    path: str
    raster: MapRaster
    window: tuple[int, int]
    bands: tuple[int, ...]
    horizontal: str
    map_error: MapError


def read_orthoimage(
    path: str | os.PathLike[str],
    bands: Bands = None,
    bounds: Bounds | None = None,
    *,
    assume_wgs84: bool = False,
    allow_remote: bool = False,
    allow_outside: bool = False,
) -> Orthoimage:
    """Read a georeferenced image from any file that GDAL opens, in any CRS of PROJ, not resampled.

    - `bands` count from 1; by default all but an alpha band.
    - `bounds`: (west, south, east, north) in deg of WGS 84, to read a part.
    - `assume_wgs84`: take the latitudes and longitudes of the file's datum as WGS 84, if PROJ has only a
      ballpark transformation between them.
    - `allow_remote`, `allow_outside`: as in `read_dem`.

    Known cells are as in `read_image`. Raises `ImageError` as `read_image`, and for a file without a CRS or a
    geotransform, with a map that cannot be followed, or outside the bounds; `FileNotFoundError`;
    `RuntimeError` with 64-bit floats off.
    """
    return read_orthoimage_and_report(
        path, bands, bounds, assume_wgs84=assume_wgs84, allow_remote=allow_remote, allow_outside=allow_outside
    )[0]


def read_orthoimage_and_report(
    path: str | os.PathLike[str],
    bands: Bands = None,
    bounds: Bounds | None = None,
    *,
    assume_wgs84: bool = False,
    allow_remote: bool = False,
    allow_outside: bool = False,
) -> tuple[Orthoimage, OrthoimageReport]:
    """An orthoimage, and a report on reading it; arguments and errors as for `read_orthoimage`."""
    require_x64()
    name = os.fspath(path)
    reach = Reach(allow_remote, allow_outside)
    with opened(name, reach) as data, refused_as(ImageError, name, "its header"):
        chosen = chosen_bands(name, data, bands)
        raster = _raster_of_file(name, data, reach)
        try:
            mapping = map_of(name, raster, assume_wgs84=assume_wgs84)
            rows, cols = raster.shape
            row, col = 0, 0
            if bounds is not None:
                part = window_of_bounds(name, mapping, bounds, None)
                (row, col), (rows, cols) = (part.row, part.col), part.shape
            mapping = mapping.window(row, col, (rows, cols))
            grid, error = make_grid(name, mapping)
        except DemError as refusal:
            raise ImageError(_about_images(refusal)) from refusal
        window = None if bounds is None else Window(col, row, cols, rows)  # pyright: ignore[reportCallIssue]
        values, known = read_bands(name, data, chosen, window)
    here = MapRaster(raster.crs, raster.transform @ Affine.translation(col, row), (rows, cols))
    report = OrthoimageReport(name, here, (row, col), tuple(chosen), mapping.horizontal, error)
    return Orthoimage.of(values, grid, known), report


def raster_of_file(path: str | os.PathLike[str], reach: Reach = HERE) -> MapRaster:
    """The map raster of a file. Raises `ImageError` for one without a map; `FileNotFoundError`."""
    name = os.fspath(path)
    with opened(name, reach) as data, refused_as(ImageError, name, "its header"):
        return _raster_of_file(name, data, reach)


def _raster_of_file(name: str, data: DatasetReader, reach: Reach) -> MapRaster:
    transform = data.transform
    if transform.is_identity:
        how = "ground control points" if data.gcps[0] else "rational polynomials" if data.rpcs else None
        reason = f"it is placed by {how} only; warp it first (gdalwarp)" if how else "it has no geotransform"
        more = "" if how else "; give an orthoimage, or the file with its world file (.tfw, .jgw) beside it"
        raise ImageError(f"{name}: this is on no map: {reason}{more}.")
    if not np.isfinite(transform.determinant) or transform.is_degenerate:
        raise ImageError(f"{name}: the geotransform {tuple(transform)[:6]} squeezes the raster into a line.")
    if data.crs is None:
        raise ImageError(
            f"{name}: the reference is without a CRS, so nobody knows where it lies. Write one into it, e.g. "
            f"gdal_edit -a_srs EPSG:32632 {name}."
        )
    try:
        whole = known_crs(data.crs.to_wkt())
        crs = horizontal_part(whole)
    except (*UNKNOWN_CRS, *GDAL_ERRORS) as error:
        raise ImageError(f"{name}: PROJ does not understand the file's CRS: {error}") from error
    if not reach.outside:
        check_crs(name, whole, ImageError)
    if not (crs.is_geographic or crs.is_projected):
        raise ImageError(f"{name}: {crs.name!r} ({crs.type_name}) does not say where on the Earth the file lies.")
    return MapRaster(crs, transform, data.shape)


def _about_images(refusal: DemError) -> str:
    """A DEM reader's message, reworded for image cells."""
    return str(refusal).replace("hold no posts of the file", "hold nothing of the file")
