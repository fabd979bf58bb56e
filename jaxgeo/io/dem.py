"""DEM reader: any rasterio format, on its own grid, with heights above the WGS 84 ellipsoid."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.io._memory_at_hand import check_fits
from jaxgeo.io._proj import DATA
from jaxgeo.io.errors import DemError
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.heights import Source, check_nodata_used, open_source
from jaxgeo.io.paths import Paths
from jaxgeo.io.reach import Reach
from jaxgeo.io.vertical import VerticalDatum
from jaxgeo.io.voids import Nodata
from jaxgeo.io.windows import Bounds, Window, padded_shape
from jaxgeo.terrain.dem import Dem
from jaxgeo.terrain.grid import AbstractGrid

BESIDE_HEIGHTS = 5  # bytes per post for the void mask and height bounds; measured, see the tests
MOST_PADDED = 1 << 22  # posts of a file whose arrays are padded if asked: at most 80 MB more


@dataclasses.dataclass(frozen=True)
class DemReport:
    """Report of `read_dem` for display and logs."""

    files: tuple[str, ...]
    crs: str
    shape: tuple[int, int]
    first_post: tuple[int, int]
    """(row, col) of the first post read, counted from the first file's first post."""
    voids: int
    height_range: tuple[float, float]
    """Lowest and highest known post, ellipsoidal m."""
    cell_size: tuple[float, float]
    """m per row and per column at the centre."""
    grid: str
    map_error_metres: float
    """Largest difference in m between the grid and PROJ over a dense set of posts, both ways."""
    map_error_cells: float
    horizontal: str
    vertical: str

    def __str__(self) -> str:
        rows, cols = self.shape
        (low, high), (along, across) = self.height_range, self.cell_size
        return (
            f"{', '.join(self.files)}\n"
            f"  map         {self.crs}; to WGS 84: {self.horizontal}\n"
            f"  grid        {self.grid}, {rows} x {cols} posts of {along:.6g} x {across:.6g} m\n"
            f"  map error   {self.map_error_metres:.1e} m, {self.map_error_cells:.1e} cells\n"
            f"  heights     {low:.2f} to {high:.2f} m above the ellipsoid, {self.voids} voids\n"
            f"  from        {self.vertical}"
        )


def read_dem(
    path_or_paths: Paths,
    *,
    vertical_datum: VerticalDatum = None,
    bounds: Bounds | None = None,
    band: int = 1,
    nodata: Nodata = None,
    height_unit: str | None = None,
    void_ceiling: float | int | None = None,
    dtype: Any = np.float64,
    assume_wgs84: bool = False,
    allow_remote: bool = False,
    allow_outside: bool = False,
    padded: bool = False,
) -> Dem:
    """A DEM on its file's own grid, with heights above the WGS 84 ellipsoid.

    `path_or_paths` is anything rasterio opens (a VRT too, if its sources are on its grid), or several tiles on one
    grid (not resampled; where tiles overlap, the first known post is used): a list, a folder (all rasters directly in
    it), or a pattern such as "tiles/**/*.tif". Everything is loaded into memory; for larger data see `open_dem`.
    Column spacing may differ between tiles, as in Copernicus DEM and DTED by latitude: these are joined without a step
    (`jaxgeo.io.zones`). A file that spans all longitudes gets one more column at either end, so that rays can cross
    the seam. Unit, scale, voids and datum of a VRT's sources apply to the VRT. Keyword options, all optional:

    - `vertical_datum`: the datum of the file's heights: "ellipsoid", an EPSG code (5773 or "EPSG:5773") or a
      pyproj CRS, a constant undulation in m, or the path of a geoid grid. Required unless the file's CRS states it.
    - `bounds`: (west, south, east, north) in deg of WGS 84; west > east crosses the date line. The window is padded by
      a post, and its arrays as by `padded`.
    - `padded=True`: arrays padded at their end to one of a few sizes, so that another file does not recompile; `extent`
      has the true size. Files of more than 4 million posts keep theirs.
    - `band`: counted from 1. `nodata`: a further void value, or a list of several, where the file's own tag is missing
      or wrong: as stored, before scale, offset and unit. A value that marks no post of the whole file is refused.
    - `height_unit`: "m", "ft", "us-ft", "dm" or "cm", where the file's own is missing or wrong.
      `void_ceiling`: as in `Dem.from_array`.
    - `dtype` of the posts in memory, float64 by default.
    - `assume_wgs84=True`: take the file's latitudes and longitudes as WGS 84, where PROJ has no transformation.
    - `allow_remote=True`: read URLs and other GDAL names (`/vsi...`), and files that refer to such, like a WMS.
      `allow_outside=True`: read a VRT with sources outside its own folder.

    The file's horizontal datum may be any that PROJ can transform to WGS 84, including null transformations of the EPSG
    registry (ETRS89, NAD83); the report names the operation and its accuracy.

    Raises `FileNotFoundError`, `VerticalDatumError` or another `DemError` with the file and the reason; `RuntimeError`
    with 64-bit floats off. `read_dem_and_report` also returns a report, with the measured error of the map.

    >>> from jaxgeo.io.dem import DATA
    >>> ridge = jaxgeo.io.read_dem(DATA / "jacksboro.tif", bounds=(-84.25, 36.30, -84.20, 36.35))
    >>> print(f"{float(ridge.floor):.0f} to {float(ridge.ceiling):.0f} m above the ellipsoid")
    279 to 690 m above the ellipsoid
    """
    return read_dem_and_report(
        path_or_paths,
        vertical_datum=vertical_datum,
        bounds=bounds,
        band=band,
        nodata=nodata,
        height_unit=height_unit,
        void_ceiling=void_ceiling,
        dtype=dtype,
        assume_wgs84=assume_wgs84,
        allow_remote=allow_remote,
        allow_outside=allow_outside,
        padded=padded,
    )[0]


def read_dem_and_report(
    path_or_paths: Paths,
    *,
    vertical_datum: VerticalDatum = None,
    bounds: Bounds | None = None,
    band: int = 1,
    nodata: Nodata = None,
    height_unit: str | None = None,
    void_ceiling: float | int | None = None,
    dtype: Any = np.float64,
    assume_wgs84: bool = False,
    allow_remote: bool = False,
    allow_outside: bool = False,
    padded: bool = False,
) -> tuple[Dem, DemReport]:
    """`read_dem`, and a report of the file and its processing."""
    require_x64()
    source = open_source(
        path_or_paths,
        band=band,
        vertical_datum=vertical_datum,
        nodata=nodata,
        height_unit=height_unit,
        assume_wgs84=assume_wgs84,
        bounds=bounds,
        reach=Reach(allow_remote, allow_outside),
    )
    name, window = source.name, source.window
    _check_fits(source, np.dtype(dtype))
    closed = source.closed()
    heights, void = closed.heights(Window(0, 0, *closed.window.shape), np.dtype(dtype))
    if void.all():
        raise DemError(
            f"{name}: all {void.size} posts of rows {window.row} to {window.stop_row - 1}, columns {window.col} to "
            f"{window.stop_col - 1} are void: there is no terrain here."
        )
    known, first = ~void, heights.flat[int(np.argmin(void))]
    lowest, highest = heights.min(where=known, initial=first), heights.max(where=known, initial=first)
    del known
    if bounds is None:
        check_nodata_used(source, (float(lowest), float(highest)))
    grid, error = make_grid(name, closed.mapping)
    along, across = np.asarray(grid.cell_size())
    report = DemReport(
        files=tuple(tile.path for tile in source.mosaic.tiles),
        crs=source.mosaic.first.crs.name,
        shape=window.shape,
        first_post=(window.row, window.col),
        voids=int(void[:, window.col - closed.window.col :][:, : window.shape[1]].sum()),
        height_range=(float(lowest), float(highest)),
        cell_size=(float(along), float(across)),
        grid=type(grid).__name__,
        map_error_metres=error.worst,
        map_error_cells=error.cells,
        horizontal=source.mapping.horizontal,
        vertical=source.shift.name,
    )
    is_padded = bounds is not None or (padded and heights.size <= MOST_PADDED)
    size = padded_shape(heights.shape) if is_padded else heights.shape
    return build_dem(name, heights, void, grid, void_ceiling, size), report


def _check_fits(source: Source, dtype: np.dtype) -> None:
    """Raises `DemError` if the posts do not fit into memory: as stored, as heights, and their bounds."""
    rows, cols = source.window.shape
    stored = max(tile.dtype.itemsize for tile in source.mosaic.tiles)
    check_fits(
        rows * cols * (stored + 2 * dtype.itemsize + BESIDE_HEIGHTS),
        DemError,
        f"{source.name}: too large: {rows:,} x {cols:,} posts",
        "Read a part of it with bounds=(west, south, east, north) in deg, or cut one out (gdal_translate -projwin).",
    )


def example_dem() -> Dem:
    """Bundled example DEM: SRTM at 90 m around the Jacksboro Fault and Cross Mountain, Tennessee.

    >>> dem = jaxgeo.io.example_dem()
    >>> print(dem.posts.shape, f"{dem.height_at(jaxgeo.Geodetic.from_degrees(lat=36.3, lon=-84.2, height=0.0)):.1f} m")
    (344, 403) 343.9 m
    """
    return read_dem(DATA / "jacksboro.tif")


def build_dem(
    name: str,
    heights: np.ndarray,
    void: np.ndarray,
    grid: AbstractGrid,
    void_ceiling: float | int | None,
    size: tuple[int, int],
) -> Dem:
    """A `Dem`, with its arrays padded at their end to `size` (rows, cols). Raises `DemError`."""
    extent = heights.shape
    if size != extent:
        wider = [(0, full - n) for full, n in zip(size, extent, strict=True)]
        heights, void = np.pad(heights, wider), np.pad(void, wider)  # beyond `extent` all posts are void
    try:
        return Dem.from_array(heights, grid, void=void, void_ceiling=void_ceiling, extent=extent)
    except ValueError as error:
        raise DemError(f"{name}: {error}") from error
