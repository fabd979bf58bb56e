"""Conversion of stored raster values to heights above the WGS 84 ellipsoid, with range checks."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from jaxgeo.io.errors import DemError, VerticalDatumError
from jaxgeo.io.height_units import CHOICES, metres_per_unit
from jaxgeo.io.mapping import FileMap, file_map
from jaxgeo.io.paths import Paths
from jaxgeo.io.raster import Mosaic
from jaxgeo.io.reach import HERE, Reach
from jaxgeo.io.tiles import OpenFiles
from jaxgeo.io.vertical import (
    LARGEST_UNDULATION,
    HeightShift,
    VerticalDatum,
    height_shift,
    horizontal_part,
    vertical_part,
)
from jaxgeo.io.voids import Nodata, marks_of
from jaxgeo.io.windows import Bounds, Window, window_of_bounds
from jaxgeo.io.zones import Zones, open_tiles

CHUNK = 1_000_000  # posts transformed at once
POSSIBLE_HEIGHTS = (-11_200.0, 9_100.0)  # m; from below the deepest trench to above the highest peak


@dataclasses.dataclass(frozen=True)
class Source:
    """Files with their map and vertical datum; rows and columns count from the first post of `window`.

    `window` is the selected part of the mosaic, counted from its first tile's first post; `mapping` is the map of that
    part.
    """

    mosaic: Mosaic | Zones
    window: Window
    mapping: FileMap
    shift: HeightShift
    unit: float
    nodata: tuple[float, ...]

    @property
    def unused_nodata(self) -> tuple[float, ...]:
        """Given void values that no post read so far has, and no file tag names."""
        tags = {tile.nodata for tile in self.mosaic.tiles} | self.mosaic.marks_found
        return tuple(mark for mark in self.nodata if mark not in tags and not math.isnan(mark))

    @property
    def name(self) -> str:
        """The file or files, for messages."""
        return self.mosaic.name

    def stored(self, part: Window, files: OpenFiles | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Stored values of a part of this source, in the file's unit, and the void mask."""
        place = part.moved(self.window.row, self.window.col)
        return self.mosaic.read(dataclasses.astuple(place), files)

    def heights(self, part: Window, dtype: np.dtype, files: OpenFiles | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Heights above the ellipsoid in m of a part of this source, zero over voids, and the void mask."""
        values, void = self.stored(part, files)
        return self.ellipsoidal(part, values, void, dtype), void

    def closed(self) -> Source:
        """The source with one column beyond a full turn at either end, if its columns span all longitudes.

        The longitude seam is then within cells at both ends, and rays that cross it continue at the other end.
        """
        turn, (rows, cols) = self.mosaic.first.cols_per_turn, self.window.shape
        if turn is None or cols < turn:
            return self
        part = Window(0, -1, rows, turn + 1)
        window, mapping = part.moved(self.window.row, self.window.col), self.mapping.window(0, -1, part.shape)
        return dataclasses.replace(self, window=window, mapping=mapping)

    def ellipsoidal(self, part: Window, values: np.ndarray, void: np.ndarray, dtype: np.dtype) -> np.ndarray:
        """Heights above the ellipsoid in m of stored `values`; zero over voids."""
        mapping = self.mapping.window(part.row, part.col, part.shape)
        metres = values * self.unit if self.unit != 1.0 else values
        return _ellipsoidal(self.name, metres, void, mapping, self.shift, dtype)


def open_source(
    paths: Paths,
    *,
    band: int,
    vertical_datum: VerticalDatum | HeightShift,
    nodata: Nodata,
    height_unit: str | None,
    assume_wgs84: bool,
    bounds: Bounds | None = None,
    reach: Reach = HERE,
) -> Source:
    """Open files: headers, map and vertical datum of the part within `bounds`; reads no posts.

    A given `HeightShift` is used whatever datum the files state.
    """
    mosaic = open_tiles(paths, band, reach)
    mapping, window = _part(mosaic, bounds, assume_wgs84)
    shift = vertical_datum if isinstance(vertical_datum, HeightShift) else _shift(mosaic, mapping, vertical_datum)
    unit = metres_per_unit(mosaic.first, height_unit, shift.unit if shift.transformer is not None else None)
    marks = marks_of(mosaic.name, nodata)
    return Source(mosaic.read_as(unit, marks), window, mapping, shift, unit, marks)


def check_nodata_used(source: Source, known: tuple[float, float] | None) -> None:
    """Raises `DemError` for a given void value that marks no post of a fully read source.

    `known` is the (lowest, highest) known height in m above the ellipsoid.
    """
    unused = source.unused_nodata
    if not unused:
        return
    range_ = "" if known is None else f" (its known heights are {known[0]:.6g} to {known[1]:.6g} m above the ellipsoid)"
    values = ", ".join(f"nodata={mark:g}" for mark in unused)
    raise DemError(
        f"{source.name}: {values} marks no post of it{range_}. Leave it out, or give the value as the file stores it, "
        f"before scale and unit (gdalinfo -stats shows the lowest and the highest)."
    )


def _part(mosaic: Mosaic | Zones, bounds: Bounds | None, assume_wgs84: bool) -> tuple[FileMap, Window]:
    """The map and the window to read, counted from the first tile's first post."""
    first, name, whole = mosaic.first, mosaic.name, Window(*mosaic.bounds())
    mapping = file_map(name, horizontal_part(first.crs), first.affine[:6], first.shape, assume_wgs84=assume_wgs84)
    mapping = mapping.window(whole.row, whole.col, whole.shape)
    _check_latitudes(name, mapping)
    if bounds is None:
        return mapping, whole
    part = window_of_bounds(name, mapping, bounds, first.cols_per_turn)
    return mapping.window(part.row, part.col, part.shape), part.moved(whole.row, whole.col)


def _shift(mosaic: Mosaic | Zones, mapping: FileMap, asked: VerticalDatum) -> HeightShift:
    rows, cols = (np.linspace(0.0, n - 1.0, 5) for n in mapping.shape)
    lon, lat = mapping.lonlat(*(u.ravel() for u in np.meshgrid(rows, cols)))
    known = np.isfinite(lon) & np.isfinite(lat)
    area = None
    if known.any() and np.ptp(lon[known]) < 180.0:
        west, east = ((edge + 180.0) % 360.0 - 180.0 for edge in (lon[known].min(), lon[known].max()))
        area = (float(west), float(lat[known].min()), float(east), float(lat[known].max()))
    try:
        return height_shift(asked, vertical_part(mosaic.first.crs, unnamed=True), area)
    except VerticalDatumError as error:
        field = mosaic.first.datum_field
        meant = "EGM96, which is EPSG:5773" if field == "E96" else "mean sea level, by a model that it does not name"
        quoted = "" if field is None or asked is not None else f" The file's own field of it is {field!r}: {meant}."
        raise VerticalDatumError(f"{mosaic.name}: {error}{quoted}") from error


def _ellipsoidal(
    name: str, values: np.ndarray, void: np.ndarray, mapping: FileMap, shift: HeightShift, dtype: np.dtype
) -> np.ndarray:
    """Heights above the ellipsoid for each post; zero over voids."""
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
            height = _shifted(name, shift.sign * height, shift.to_ellipsoid(lon, lat, height), shift)
        _check_heights(name, height, row + top, col, shift)
        heights[row + top, col] = height
        if dtype.kind != "f" and np.any(heights[row + top, col] != height):
            raise DemError(f"{name}: dtype={dtype} would round the heights; use float64 or float32.")
    return heights


def _shifted(name: str, height: np.ndarray, shifted: np.ndarray, shift: HeightShift) -> np.ndarray:
    """Heights above the ellipsoid; refused if they differ from those above the datum by more than any geoid."""
    with np.errstate(invalid="ignore"):
        too_far = np.abs(shifted - height) > LARGEST_UNDULATION
    if too_far.any():
        largest = float(np.abs(shifted - height)[too_far].max())
        raise VerticalDatumError(
            f"{name}: {shift.name} would move heights by up to {largest:.6g} m, but the geoid stays within "
            f"{LARGEST_UNDULATION:g} m of the ellipsoid. Is the grid a geoid's, in m?"
        )
    return shifted


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
        f"has. If the unit is another, pass {CHOICES}; if that marks a void, pass the value that the file stores there "
        f"with nodata=."
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
