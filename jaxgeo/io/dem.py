"""Reading elevation models: any file that rasterio opens, on its own grid, with heights above the WGS 84 ellipsoid."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.io._proj import DATA
from jaxgeo.io.errors import DemError, VerticalDatumError
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.mapping import FileMap, file_map
from jaxgeo.io.raster import Mosaic, Paths, metres_per_unit, open_mosaic, read_window
from jaxgeo.io.vertical import (
    LARGEST_UNDULATION,
    HeightShift,
    VerticalDatum,
    height_shift,
    horizontal_part,
    vertical_part,
)
from jaxgeo.io.windows import Bounds, Window, padded_shape, window_of_bounds
from jaxgeo.terrain.dem import Dem
from jaxgeo.terrain.grid import AbstractGrid

CHUNK = 1_000_000  # posts transformed at once
UNTAGGED = -9999.0
POSSIBLE_HEIGHTS = (-12_500.0, 9_500.0)  # m; from the deepest trench to above the highest peak


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
    nodata: float | int | None = None,
    height_unit: str | None = None,
    void_ceiling: float | int | None = None,
    dtype: Any = np.float64,
    assume_wgs84: bool = False,
) -> Dem:
    """An elevation model on its file's own grid, with heights above the WGS 84 ellipsoid.

    `path_or_paths` is anything rasterio opens, or several tiles on one grid (they are not resampled; where several hold
    a post, the first that knows it is taken). Keyword options, each optional:

    - `vertical_datum`: what the file's heights are measured from: "ellipsoid", an EPSG code (5773 or "EPSG:5773") or a
      pyproj CRS, a constant undulation in m, or the path of a geoid grid. Needed unless the file's CRS says it.
    - `bounds`: (west, south, east, north) in deg of WGS 84; west > east crosses the date line. The window is padded by
      a post, and its arrays to one of a few sizes, so that another window does not recompile.
    - `band`: counted from 1. `nodata`: a further value that marks voids, where the file's own tag is missing or wrong
      (the value after the file's scale and offset, if it has any).
    - `height_unit`: "m", "ft" or "us-ft", where the file does not say it. `void_ceiling`: as in `Dem.from_array`.
    - `dtype` of the posts in memory, float64 by default.
    - `assume_wgs84=True`: take the file's latitudes and longitudes as WGS 84's, where PROJ knows no transformation.

    The file's horizontal datum may be any that PROJ can bring to WGS 84, null transformations of the EPSG registry
    (ETRS89, NAD83) included; the report names the operation and its accuracy.

    Raises `FileNotFoundError`, `VerticalDatumError` or another `DemError` with the file and the reason; `RuntimeError`
    with 64-bit floats off. `read_dem_and_report` also says what was done, with the map's measured error.
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
    )[0]


def read_dem_and_report(
    path_or_paths: Paths,
    *,
    vertical_datum: VerticalDatum = None,
    bounds: Bounds | None = None,
    band: int = 1,
    nodata: float | int | None = None,
    height_unit: str | None = None,
    void_ceiling: float | int | None = None,
    dtype: Any = np.float64,
    assume_wgs84: bool = False,
) -> tuple[Dem, DemReport]:
    """`read_dem`, and a report of what it found and did."""
    require_x64()
    mosaic = open_mosaic(path_or_paths, band)
    first, name = mosaic.first, mosaic.name
    mapping, window = _part(mosaic, bounds, assume_wgs84)
    shift = _shift(mosaic, mapping, vertical_datum)
    unit = metres_per_unit(first, height_unit, shift.unit if shift.transformer is not None else None)
    values, void = read_window(mosaic, dataclasses.astuple(window))
    if nodata is not None:
        void |= np.isnan(values) if np.isnan(nodata) else values == nodata
    else:
        _check_untagged_voids(name, values, void)
    if void.all():
        raise DemError(
            f"{name}: all {void.size} posts of rows {window.row} to {window.stop_row - 1}, columns {window.col} to "
            f"{window.stop_col - 1} are void: there is no terrain here."
        )
    grid, error = make_grid(name, mapping)
    heights = _ellipsoidal(name, values * unit if unit != 1.0 else values, void, mapping, shift, np.dtype(dtype))
    along, across = grid.cell_size()
    report = DemReport(
        files=tuple(tile.path for tile in mosaic.tiles),
        crs=first.crs.name,
        shape=window.shape,
        first_post=(window.row, window.col),
        voids=int(void.sum()),
        height_range=(float(heights[~void].min()), float(heights[~void].max())),
        cell_size=(float(along), float(across)),
        grid=type(grid).__name__,
        map_error_metres=error.worst,
        map_error_cells=error.cells,
        horizontal=mapping.horizontal,
        vertical=shift.name,
    )
    return _dem(name, heights, void, grid, void_ceiling, pad=bounds is not None), report


def example_dem() -> Dem:
    """Real ground inside the package: SRTM at 90 m about the Jacksboro Fault and Cross Mountain, Tennessee."""
    return read_dem(DATA / "jacksboro.tif")


def _part(mosaic: Mosaic, bounds: Bounds | None, assume_wgs84: bool) -> tuple[FileMap, Window]:
    """The map and the window, counted from the first tile's first post, of what is to be read."""
    first, name, whole = mosaic.first, mosaic.name, Window(*mosaic.bounds())
    mapping = file_map(name, horizontal_part(first.crs), first.affine[:6], first.shape, assume_wgs84=assume_wgs84)
    mapping = mapping.window(whole.row, whole.col, whole.shape)
    _check_latitudes(name, mapping)
    if bounds is None:
        return mapping, whole
    part = window_of_bounds(name, mapping, bounds, first.cols_per_turn)
    return mapping.window(part.row, part.col, part.shape), part.moved(whole.row, whole.col)


def _dem(
    name: str, heights: np.ndarray, void: np.ndarray, grid: AbstractGrid, void_ceiling: float | int | None, pad: bool
) -> Dem:
    extent = heights.shape
    if pad:
        wider = [(0, size - n) for size, n in zip(padded_shape(extent), extent, strict=True)]
        heights, void = np.pad(heights, wider), np.pad(void, wider, constant_values=True)
    try:
        return Dem.from_array(heights, grid, void=void, void_ceiling=void_ceiling, extent=extent)
    except ValueError as error:
        raise DemError(f"{name}: {error}") from error


def _shift(mosaic: Mosaic, mapping: FileMap, asked: VerticalDatum) -> HeightShift:
    rows, cols = (np.linspace(0.0, n - 1.0, 5) for n in mapping.shape)
    lon, lat = mapping.lonlat(*(u.ravel() for u in np.meshgrid(rows, cols)))
    known = np.isfinite(lon) & np.isfinite(lat)
    area = None
    if known.any() and np.ptp(lon[known]) < 180.0:
        west, east = ((edge + 180.0) % 360.0 - 180.0 for edge in (lon[known].min(), lon[known].max()))
        area = (float(west), float(lat[known].min()), float(east), float(lat[known].max()))
    try:
        return height_shift(asked, vertical_part(mosaic.first.crs), area)
    except VerticalDatumError as error:
        raise VerticalDatumError(f"{mosaic.name}: {error}") from error


def _ellipsoidal(
    name: str, values: np.ndarray, void: np.ndarray, mapping: FileMap, shift: HeightShift, dtype: np.dtype
) -> np.ndarray:
    """Heights above the ellipsoid, post by post; zero over voids."""
    if dtype.kind not in "fiu" or dtype == np.float16:
        raise DemError(f"{name}: dtype={dtype} cannot hold heights; use float64, float32 or an integer type.")
    heights = np.zeros(values.shape, dtype)
    cols = values.shape[1]
    step = max(1, CHUNK // cols)
    for top in range(0, values.shape[0], step):
        rows = slice(top, min(top + step, values.shape[0]))
        row, col = np.nonzero(~void[rows])
        if not row.size:
            continue
        height = values[rows][row, col].astype(np.float64)
        if not shift.is_identity:
            lon, lat = mapping.lonlat(row + float(top), col.astype(np.float64))
            height = _shifted(name, height, shift.to_ellipsoid(lon, lat, height), shift)
        _check_heights(name, height, row + top, col, shift)
        heights[row + top, col] = height
        if dtype.kind != "f" and np.any(heights[row + top, col] != height):
            raise DemError(f"{name}: dtype={dtype} would round the heights; use float64 or float32.")
    return heights


def _shifted(name: str, height: np.ndarray, shifted: np.ndarray, shift: HeightShift) -> np.ndarray:
    """The shifted heights, unless the shift is larger than any geoid's."""
    with np.errstate(invalid="ignore"):
        too_far = np.abs(shifted - height) > LARGEST_UNDULATION
    if too_far.any():
        largest = float(np.abs(shifted - height)[too_far].max())
        raise VerticalDatumError(
            f"{name}: {shift.name} would move heights by up to {largest:.6g} m, but the geoid stays within "
            f"{LARGEST_UNDULATION:g} m of the ellipsoid. Is the grid a geoid's, in m?"
        )
    return shifted


def _check_untagged_voids(name: str, values: np.ndarray, void: np.ndarray) -> None:
    """Refuse posts of exactly -9999 far below all others: the most usual mark of a void, here without its tag."""
    marked = (values == UNTAGGED) & ~void
    if not marked.any():
        return
    others = values[~void & ~marked]
    if not others.size or others.min() > UNTAGGED + 1000.0:
        row, col = np.argwhere(marked)[0]
        raise DemError(
            f"{name}: {int(marked.sum())} posts, the first at row {row}, column {col}, are exactly {UNTAGGED:g}, far "
            f"below all others, and the file has no nodata tag for that. Pass nodata={UNTAGGED:g}."
        )


def _check_heights(name: str, height: np.ndarray, row: np.ndarray, col: np.ndarray, shift: HeightShift) -> None:
    low, high = POSSIBLE_HEIGHTS
    wrong = ~((height >= low) & (height <= high))
    if not wrong.any():
        return
    first = int(np.argmax(wrong))
    where = f"{name}: at row {row[first]}, column {col[first]}"
    if np.isnan(height[first]):
        raise VerticalDatumError(
            f"{where} the vertical datum gives no height ({shift.name}): its grid does not reach there."
        )
    raise DemError(
        f"{where} (and {int(wrong.sum()) - 1} more) the height is {height[first]:.6g} m, which no place on the Earth "
        f"has. If that marks a void, pass nodata=...; if the unit is not the metre, pass height_unit=..."
    )


def _check_latitudes(name: str, mapping: FileMap) -> None:
    if not mapping.crs.is_geographic:
        return
    _, _, _, d, e, f = mapping.affine
    to_degrees = np.degrees(mapping.crs.axis_info[0].unit_conversion_factor)
    rows, cols = mapping.shape[0] - 1, mapping.shape[1] - 1
    corners = np.array([f, f + d * cols, f + e * rows, f + d * cols + e * rows]) * to_degrees
    if np.abs(corners).max() > 90.0 + 1e-9:
        raise DemError(
            f"{name}: the transform puts posts at latitude {corners[np.abs(corners).argmax()]:.6g} deg, past a pole. "
            f"Either it is wrong (rows and columns swapped?), or the CRS {mapping.crs.name!r} is."
        )
