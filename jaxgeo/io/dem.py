"""Reading elevation models: any file that rasterio opens, on its own grid, with heights above the WGS 84 ellipsoid."""

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

BESIDE_HEIGHTS = 5  # bytes a post: which are void, and bounds of the ground; measured, see the tests


@dataclasses.dataclass(frozen=True)
class DemReport:
    """What `read_dem` found and did: for people to look at, and for logs."""

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
) -> Dem:
    """An elevation model on its file's own grid, with heights above the WGS 84 ellipsoid.

    `path_or_paths` is anything rasterio opens (a VRT too, if its sources are on its grid), or several tiles on one
    grid (they are not resampled; where several hold a post, the first that knows it is taken): a list, a folder, which
    stands for all rasters right inside it, or a pattern such as "tiles/**/*.tif". All of it comes into memory: for
    more than that holds, see `open_dem`. Columns may be spaced differently from tile to tile, as those of Copernicus
    DEM and DTED are by latitude: they are joined without a step (`jaxgeo.io.zones`). A file that goes all round the
    Earth gets a column more at either end, so that rays may cross the line where its ends meet. What the sources of a
    VRT state of unit, scale, voids and datum holds for the VRT. Keyword options, each optional:

    - `vertical_datum`: what the file's heights are measured from: "ellipsoid", an EPSG code (5773 or "EPSG:5773") or a
      pyproj CRS, a constant undulation in m, or the path of a geoid grid. Needed unless the file's CRS says it.
    - `bounds`: (west, south, east, north) in deg of WGS 84; west > east crosses the date line. The window is padded by
      a post, and its arrays to one of a few sizes, so that another window does not recompile.
    - `band`: counted from 1. `nodata`: a further value that marks voids, or several in a list, where the file's own tag
      is missing or wrong: as the file stores it, before scale, offset and unit. One that marks no post of the whole
      file is refused.
    - `height_unit`: "m", "ft", "us-ft", "dm" or "cm", where the file does not state it, or states it wrongly.
      `void_ceiling`: as in `Dem.from_array`.
    - `dtype` of the posts in memory, float64 by default.
    - `assume_wgs84=True`: take the file's latitudes and longitudes as WGS 84's, where PROJ knows no transformation.
    - `allow_remote=True`: read URLs and other names that only GDAL resolves (`/vsi...`), and files that name such, like
      a WMS. `allow_outside=True`: read a VRT that takes values from files outside its own folder.

    The file's horizontal datum may be any that PROJ can bring to WGS 84, null transformations of the EPSG registry
    (ETRS89, NAD83) included; the report names the operation and its accuracy.

    Raises `FileNotFoundError`, `VerticalDatumError` or another `DemError` with the file and the reason; `RuntimeError`
    with 64-bit floats off. `read_dem_and_report` also says what was done, with the map's measured error.

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
) -> tuple[Dem, DemReport]:
    """`read_dem`, and a report of what it found and did."""
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
    along, across = grid.cell_size()
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
    size = heights.shape if bounds is None else padded_shape(heights.shape)
    return build_dem(name, heights, void, grid, void_ceiling, size), report


def _check_fits(source: Source, dtype: np.dtype) -> None:
    """Raises `DemError` where the posts of a source do not fit into memory: as stored, as heights, and their bounds."""
    rows, cols = source.window.shape
    stored = max(tile.dtype.itemsize for tile in source.mosaic.tiles)
    check_fits(
        rows * cols * (stored + 2 * dtype.itemsize + BESIDE_HEIGHTS),
        DemError,
        f"{source.name}: too large: {rows:,} x {cols:,} posts",
        "Read a part of it with bounds=(west, south, east, north) in deg, or cut one out (gdal_translate -projwin).",
    )


def example_dem() -> Dem:
    """Real ground inside the package: SRTM at 90 m about the Jacksboro Fault and Cross Mountain, Tennessee.

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
    """The record, its arrays padded at their end to `size` (rows, cols). Raises `DemError`."""
    extent = heights.shape
    if size != extent:
        wider = [(0, full - n) for full, n in zip(size, extent, strict=True)]
        heights, void = np.pad(heights, wider), np.pad(void, wider)  # beyond `extent` all is void anyhow
    try:
        return Dem.from_array(heights, grid, void=void, void_ceiling=void_ceiling, extent=extent)
    except ValueError as error:
        raise DemError(f"{name}: {error}") from error
