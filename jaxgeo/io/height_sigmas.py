"""Reader of rasters of standard deviations of terrain heights, such as height error layers of elevation models."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.io._memory_at_hand import check_fits
from jaxgeo.io.errors import DemError
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.heights import check_nodata_used, open_source
from jaxgeo.io.paths import Paths
from jaxgeo.io.reach import Reach
from jaxgeo.io.vertical import HeightShift
from jaxgeo.io.voids import Nodata
from jaxgeo.io.windows import Bounds, Window
from jaxgeo.uncertainty import sources
from jaxgeo.uncertainty.datasheet import linear_error

UNSHIFTED = HeightShift("standard deviations")  # they have no vertical datum
BYTES = 24  # per post: as stored, as a mask, and in float64


def read_height_sigmas(
    path_or_paths: Paths,
    *,
    scale: float | int = 1.0,
    probability: float | int | None = None,
    bounds: Bounds | None = None,
    band: int = 1,
    nodata: Nodata = None,
    height_unit: str | None = None,
    assume_wgs84: bool = False,
    allow_remote: bool = False,
    allow_outside: bool = False,
    **options: Any,
) -> sources.TerrainHeightRaster:
    """The terrain height error whose standard deviation at each place is that of a raster, as an error source.

    The raster may have another CRS, spacing and extent than the elevation model; values are looked up by position,
    bilinear between posts, and those in a void are unknown (see `TerrainHeightRaster`). The height error mask (HEM) of
    the Copernicus DEM is one standard deviation in m per pixel, from the interferometric coherence and the geometry
    ("Copernicus DEM Product Handbook"): it leaves out systematic errors, and where the DEM was edited or filled.

    - `path_or_paths`, `bounds`, `band`, `nodata`, `height_unit` and those that follow: as of `read_dem`. A vertical
      datum that a file states is that of the elevation model and is ignored.
    - `scale`: factor on the values, such as 0.001 for mm.
    - `probability`: that of linear errors, if the raster has these in place of standard deviations: 0.9 for LE90.
    - `options`: `sharing` and `distribution` of the source; by default one normal error common to all measurements.

    Raises `FileNotFoundError`, or `DemError` with the file and the reason, also for negative values (of an unstated
    nodata value, say); `ValueError` for a scale or probability that cannot be; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    factor = _factor(scale, probability)
    source = open_source(
        path_or_paths,
        band=band,
        vertical_datum=UNSHIFTED,
        nodata=nodata,
        height_unit=height_unit,
        assume_wgs84=assume_wgs84,
        bounds=bounds,
        reach=Reach(allow_remote, allow_outside),
    )
    closed = source.closed()
    rows, cols = closed.window.shape
    advice = "Read a part of it with bounds=(west, south, east, north) in deg."
    check_fits(rows * cols * BYTES, DemError, f"{source.name}: too large: {rows:,} x {cols:,} values", advice)
    values, void = closed.stored(Window(0, 0, rows, cols))
    sigma = np.where(void, np.nan, values.astype(np.float64) * closed.unit)
    _check(source.name, sigma, void)
    if bounds is None:
        check_nodata_used(source, None)
    grid, _ = make_grid(source.name, closed.mapping)
    return sources.TerrainHeightRaster.from_array(sigma, grid, scale=factor, **options)


def _factor(scale: Any, probability: Any) -> float:
    if isinstance(scale, bool) or not isinstance(scale, int | float | np.number) or not 0.0 < scale < math.inf:
        raise ValueError(f"scale must be a positive factor on the values; got {scale!r}.")
    return float(scale) * (1.0 if probability is None else linear_error(1.0, probability=probability).sigma)


def _check(name: str, sigma: np.ndarray, void: np.ndarray) -> None:
    if void.all():
        raise DemError(f"{name}: all {void.size} values are void: no standard deviation is known here.")
    wrong = ~void & ~((sigma >= 0.0) & (sigma < math.inf))
    if wrong.any():
        row, col = np.argwhere(wrong)[0].tolist()
        raise DemError(
            f"{name}: at row {row}, column {col} (and {int(wrong.sum()) - 1} more) the standard deviation is "
            f"{sigma[row, col]:g} m; it must be 0 or more. If that marks a void, pass the value that the file stores "
            f"there with nodata=; is this a raster of standard deviations?"
        )
