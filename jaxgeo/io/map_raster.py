"""Map raster definition: CRS, transform and shape from the caller, or derived from the visible area."""

from __future__ import annotations

import math
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyproj
from rasterio.transform import Affine

from jaxgeo._locate import locate
from jaxgeo.earth import WGS84
from jaxgeo.io._outlines import outline
from jaxgeo.io._proj import UNKNOWN_CRS, NoOperation, Operation, known_crs, operation
from jaxgeo.io.errors import DemError, NothingSeen
from jaxgeo.io.extent import camera_beside
from jaxgeo.io.files import DemFiles
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.mapping import FileMap, file_map
from jaxgeo.io.vertical import horizontal_part
from jaxgeo.sensor import Pose, Sensor, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.terrain.grid import AbstractGrid

ALONG = 4  # places along a side of the outline of a raster
PLACES = 7  # decimals of its longitudes and latitudes: a centimetre
LATTICE = 65  # samples per side of the image or terrain, to find the extent
MARGIN = 0.01  # of the extent: margin, since the edge between lattice pixels may reach farther
MOST_CELLS = 4_000_000  # cells of a raster with the terrain's default resolution
MOST_WRITTEN = 2**36  # cells of a file: hours of work, and close to GDAL's limit
LONGEST = 2**31 - 1  # cells along a side of a file
MOST_CELLS_A_PIXEL = 16.0  # limit at an image's GSD: oblique images cover much ground per pixel
MIDDLE = 64  # lattice meshes at the image centre whose median is the GSD
DIGITS = 3  # significant digits of a default resolution


class MapRaster(NamedTuple):
    """A raster's CRS, the transform of its corners, and (rows, cols)."""

    crs: pyproj.CRS
    transform: Affine
    shape: tuple[int, int]

    def part(self, row: int, col: int, shape: tuple[int, int]) -> MapRaster:
        """The cells from (row, col) on, `shape` = (rows, cols), of the same lattice; also outside the raster."""
        return MapRaster(self.crs, self.transform @ Affine.translation(col, row), shape)

    def rowcol(self, x: float, y: float) -> tuple[float, float]:
        """(row, col) of a place on the map, counted from the corner of the first cell."""
        a, b, c, d, e, f = self.transform[:6]
        x, y, det = x - c, y - f, a * e - b * d
        return (a * y - d * x) / det, (e * x - b * y) / det


class Spacing(NamedTuple):
    """Default cell size in m: its name as text, and the largest number of cells for it."""

    metres: float
    words: str
    most_cells: float
    digits: int | None = None
    """Significant digits kept of the resolution; None for all."""


def raster_of(
    name: str,
    sensor: Sensor,
    shot: Any,
    terrain: Any,
    crs: Any,
    bounds: Any,
    resolution: Any,
    how: Mapping[str, Any],
    spacing: Callable[[], Spacing] | None = None,
) -> MapRaster:
    """The requested raster, with missing parts derived from the visible area.

    `how` are options of `locate`, others are ignored; `spacing` is called if no resolution is given, by default that
    of the terrain. `name` is the file's, for messages. Raises `ValueError` for invalid arguments.
    """
    if crs is None and bounds is not None:
        raise ValueError(f"{name}: bounds={bounds!r} are in the unit of a CRS; name it with crs=.")
    asked = None if crs is None else checked_crs(name, crs)  # before lines of sight are located
    if asked is not None:
        _operation(name, asked, None)
    edges = None if bounds is None else _checked_bounds(name, bounds)
    size = None if resolution is None else checked_resolution(name, resolution)
    usual = terrain_spacing(name, terrain) if size is None and spacing is None else None
    area = _area(name, sensor, shot, terrain, how) if edges is None else None
    flat = usual_crs(*_middle(area)) if asked is None else asked
    edges = bounds_of(name, flat, area) if edges is None else edges
    if size is None:
        usual = spacing() if spacing is not None else usual
        size = in_unit(usual, flat, edges)  # pyright: ignore[reportArgumentType]
    (west, south, east, north), (across, down) = edges, size
    if usual is None:
        _check_resolution_is_not_too_fine(name, resolution, (north - south) / down, (east - west) / across)
    if bounds is None:
        west, north = across * math.floor(west / across), down * math.ceil(north / down)
    cols, rows = (max(1, math.ceil(n - 1e-9)) for n in ((east - west) / across, (north - south) / down))
    if usual is not None and rows * cols > usual.most_cells:
        raise ValueError(
            f"{name}: at the {usual.words} the map would have {rows} x {cols} cells; name a coarser resolution=, "
            f"or a part with bounds=."
        )
    return MapRaster(flat, Affine(across, 0.0, west, 0.0, -down, north), (rows, cols))


def raster_with(crs: Any, transform: Sequence[float], shape: Sequence[int]) -> MapRaster:
    """A raster whose transform is given as six numbers."""
    return MapRaster(crs, Affine(*transform), (shape[0], shape[1]))


def is_too_large(rows: float | int, cols: float | int) -> bool:
    """Whether this number of cells is too large for a file."""
    return max(rows, cols) > LONGEST or rows * cols > MOST_WRITTEN


def map_of(name: str, raster: MapRaster, *, assume_wgs84: bool = False) -> FileMap:
    """PROJ's mapping of a raster, with (row, col) counted from cell centres. Raises as `file_map`."""
    a, b, c, d, e, f = raster.transform[:6]
    centred = (a, b, c + (a + b) / 2.0, d, e, f + (d + e) / 2.0)
    return file_map(name, raster.crs, centred, raster.shape, assume_wgs84=assume_wgs84)


def outline_of(name: str, raster: MapRaster) -> tuple[dict[str, Any], list[float]]:
    """The outline of a raster in longitude and latitude in deg, as a GeoJSON geometry, and its box (west, south, east,
    north), in which west is greater than east where it crosses 180 deg."""
    rows, cols = raster.shape
    t = np.linspace(0.0, 1.0, ALONG, endpoint=False)
    row = rows * np.concatenate([0.0 * t, t, 0.0 * t + 1.0, 1.0 - t]) - 0.5
    col = cols * np.concatenate([1.0 - t, 0.0 * t, t, 0.0 * t + 1.0]) - 0.5
    lon, lat = map_of(name, raster).lonlat(row, col)
    places = np.round(np.stack([np.remainder(lon + 180.0, 360.0) - 180.0, lat], axis=1), PLACES)
    shape = outline(places[np.isfinite(places).all(axis=1)], 360.0)
    parts = [part.bounds for part in getattr(shape, "geoms", [shape])]
    west, south, east, north = (
        f(edges) for f, edges in zip((min, min, max, max), zip(*parts, strict=True), strict=True)
    )
    if len(parts) > 1 and west == -180.0 and east == 180.0:
        west, east = max(one[0] for one in parts), min(one[2] for one in parts)
    return shape.__geo_interface__, [west, south, east, north]


def grid_of(raster: MapRaster, name: str = "raster") -> AbstractGrid:
    """The grid of a raster's cell centres on the Earth; row and column 0 are those of the first cell's centre.

    Raises `DemError` where PROJ cannot map the raster, or no grid matches it to 1 mm.
    """
    return make_grid(name, map_of(name, raster))[0]


def checked_target(path: str | os.PathLike[str], what: str) -> pathlib.Path:
    """Path of the GeoTIFF to write, checked before the computation; `what` names the content in messages."""
    target = pathlib.Path(path)
    if target.suffix.lower() not in (".tif", ".tiff"):
        raise ValueError(f"{target}: {what} is written as a GeoTIFF; name a file that ends in .tif.")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{target}: there is no folder {target.parent}.")
    if target.is_dir() or not os.access(target.parent, os.W_OK):
        raise PermissionError(f"{target}: no file can be written here.")
    return target


def terrain_spacing(name: str, terrain: Any) -> Spacing:
    """The terrain's own post spacing."""
    if not isinstance(terrain, Dem | DemFiles):
        raise ValueError(
            f"{name}: a {type(terrain).__name__} has no spacing; give the size of a cell, resolution=..., in m."
        )
    grid = terrain.grid if isinstance(terrain, Dem) else terrain.middle_grid
    return Spacing(float(np.sqrt(np.prod(np.asarray(grid.cell_size())))), "terrain's spacing", MOST_CELLS)


def image_spacing(name: str, sensor: Sensor, shot: Any, terrain: AbstractTerrain, how: Mapping[str, Any]) -> Spacing:
    """Ground sample distance at the image centre: side of a square with the area of a pixel's horizontal footprint.

    The median over the lattice meshes nearest to the centre that see ground. Raises `NothingSeen`.
    """
    uv, lon, lat, seen = _seen(sensor, shot, terrain, how)
    if not seen.any():
        raise nothing_seen(name, shot, terrain)
    place = np.radians([lon - lon[seen][0], lat])
    place[0] = np.remainder(place[0] + np.pi, 2.0 * np.pi) - np.pi
    east, north = (WGS84.a * x.reshape(LATTICE, LATTICE) for x in (place[0] * np.cos(place[1]), place[1]))
    falling, rising = ((x[1:, 1:] - x[:-1, :-1], x[1:, :-1] - x[:-1, 1:]) for x in (east, north))
    area = 0.5 * np.abs(falling[0] * rising[1] - falling[1] * rising[0]).ravel()
    usable = np.flatnonzero(np.isfinite(area) & (area > 0.0))
    if not usable.size:
        raise NothingSeen(f"{name}: too little of the image sees ground to tell its sampling; name resolution=.")
    pixels = uv.reshape(LATTICE, LATTICE, 2)
    off = np.linalg.norm((pixels[1:, 1:] + pixels[:-1, :-1]) / 2.0 - uv.mean(axis=0), axis=-1).ravel()
    nearest = usable[np.argsort(off[usable], kind="stable")[:MIDDLE]]
    per_mesh = float(np.prod(pixels[1, 1] - pixels[0, 0]))
    most = MOST_CELLS_A_PIXEL * per_mesh * (LATTICE - 1) ** 2
    return Spacing(float(np.sqrt(np.median(area[nearest]) / per_mesh)), "image's sampling", most, DIGITS)


def checked_crs(name: str, crs: Any) -> pyproj.CRS:
    """The horizontal part of a CRS that pyproj takes. Raises `ValueError` for one without map coordinates."""
    try:
        flat = horizontal_part(known_crs(crs))
    except UNKNOWN_CRS as error:
        raise ValueError(f"{name}: PROJ does not know the crs {crs!r}: {error}") from error
    if not (flat.is_geographic or flat.is_projected):
        raise ValueError(f"{name}: a map needs a projected or geographic crs; {flat.name!r} is a {flat.type_name}.")
    return flat


def _area(name: str, sensor: Sensor, shot: Any, terrain: Any, how: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes in deg of the area to cover, without a jump between them."""
    if isinstance(shot, Pose):
        lon, lat = _all_of(name, terrain)
    else:
        _, lon, lat, seen = _seen(sensor, shot, terrain, how)
        if not seen.any():
            raise nothing_seen(name, shot, terrain)
        lon, lat = lon[seen], lat[seen]
    return lon[0] + np.remainder(lon - lon[0] + 180.0, 360.0) - 180.0, lat


def _all_of(name: str, terrain: Any) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes in deg of a lattice over a terrain."""
    if not isinstance(terrain, Dem | DemFiles):
        raise ValueError(f"{name}: a {type(terrain).__name__} has no edge; name the area with crs= and bounds=.")
    shape = terrain.extent if isinstance(terrain, Dem) else terrain.shape
    row, col = (x.ravel() for x in np.meshgrid(*(np.linspace(0.0, n - 1.0, LATTICE) for n in shape), indexing="ij"))
    if isinstance(terrain, DemFiles):
        return terrain.source.mapping.lonlat(row, col)
    x, y, z = np.asarray(_normals(terrain, jnp.asarray(np.stack([row, col], axis=-1)))).T
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))


def lattice_of(camera: Any) -> np.ndarray:
    """Pixels (n, 2) of a lattice over an image, its outer edges included, row by row."""
    u, v = (np.linspace(-0.5, getattr(camera, side) - 0.5, LATTICE) for side in ("width", "height"))
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _seen(
    sensor: Sensor, shot: Any, terrain: AbstractTerrain, how: Mapping[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (n, 2) of a lattice over the image, row by row, the longitudes and latitudes in deg of their ground
    points, NaN if there is none, and the mask of those with one."""
    uv = lattice_of(sensor.camera)
    options = {key: how[key] for key in ("time", "search", "atmosphere") if key in how}
    lat, lon, status = (np.asarray(x) for x in _located(sensor, shot, jnp.asarray(uv), terrain, options))
    seen = status == Status.hit
    lat, lon = (np.where(seen, np.degrees(x), np.nan) for x in (lat, lon))
    return uv, lon, lat, seen


def nothing_seen(name: str, motion: Any, terrain: Any) -> NothingSeen:
    """Error for an image without ground, with the reason if its camera is beside the DEM, or the files of one."""
    shot = motion.at(motion.start) if isinstance(motion, Trajectory) else motion
    beside = camera_beside(terrain, shot.pose.position)
    why = f": {beside}." if beside else "; there is nothing to map."
    return NothingSeen(f"{name}: no line of sight of the image comes down on the terrain{why}")


def _located(sensor: Sensor, shot: Any, uv: jax.Array, terrain: AbstractTerrain, options: dict[str, Any]) -> Any:
    """Latitudes and longitudes in rad, and statuses."""
    fix = jax.vmap(lambda pixel: locate(sensor, shot, pixel, terrain, **options))(uv)
    return fix.position.lat, fix.position.lon, fix.status


@eqx.filter_jit
def _normals(terrain: Dem, rowcol: jax.Array) -> jax.Array:
    return jax.vmap(terrain.grid.normal)(rowcol)


def _middle(area: tuple[np.ndarray, np.ndarray] | None) -> tuple[float, float]:
    assert area is not None
    lon, lat = ((x.min() + x.max()) / 2.0 for x in area)
    return float((lon + 180.0) % 360.0 - 180.0), float(lat)


def usual_crs(lon: float, lat: float) -> pyproj.CRS:
    """UTM on WGS 84, without the exceptions of Norway and Spitsbergen; UPS about the poles."""
    if not -80.0 <= lat <= 84.0:
        return pyproj.CRS.from_epsg(5041 if lat > 0.0 else 5042)
    zone = int((lon + 180.0) // 6.0) % 60 + 1
    return pyproj.CRS.from_epsg((32600 if lat >= 0.0 else 32700) + zone)


def _checked_bounds(name: str, bounds: Any) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(edge) for edge in bounds)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: bounds must be (west, south, east, north) in the CRS; got {bounds!r}.") from error
    if not (all(map(math.isfinite, (west, south, east, north))) and west < east and south < north):
        raise ValueError(f"{name}: bounds must be finite, with west < east and south < north; got {bounds!r}.")
    return west, south, east, north


def checked_resolution(name: str, resolution: Any) -> tuple[float, float]:
    """A cell size as (across, down). Raises `ValueError` unless it is positive and finite."""
    try:
        across, down = (float(x) for x in np.broadcast_to(resolution, 2))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name}: resolution must be one size of a cell, or (across, down); got {resolution!r}."
        ) from error
    if not (0.0 < across < math.inf and 0.0 < down < math.inf):
        raise ValueError(f"{name}: resolution must be positive and finite, in the CRS's unit; got {resolution!r}.")
    return across, down


def _check_resolution_is_not_too_fine(name: str, resolution: Any, rows: float, cols: float) -> None:
    if is_too_large(rows, cols):
        raise ValueError(
            f"{name}: at a resolution of {resolution!r} the map would have {rows:.3g} x {cols:.3g} cells, more than a "
            f"file can have ({MOST_WRITTEN:.2g}); name a coarser resolution=, or a part with bounds=."
        )


def bounds_of(name: str, crs: pyproj.CRS, area: Any) -> tuple[float, float, float, float]:
    """(west, south, east, north) in a CRS of an area in deg, slightly enlarged."""
    lon, lat = area
    turned = (lon + 180.0) % 360.0 - 180.0
    found = _operation(name, crs, (turned[0], lat.min(), turned[0], lat.max()))
    x, y = (np.asarray(v) for v in found.transformer.transform(turned, lat, direction="INVERSE"))
    if crs.is_geographic:
        turn = 2.0 * np.pi / crs.axis_info[0].unit_conversion_factor
        x = x - turn * np.round((x - x[0]) / turn)
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        raise ValueError(f"{name}: the area lies outside what {crs.name!r} maps.")
    x, y = x[known], y[known]
    wider = MARGIN * np.array([np.ptp(x), np.ptp(y)])
    west, south, east, north = x.min() - wider[0], y.min() - wider[1], x.max() + wider[0], y.max() + wider[1]
    return float(west), float(south), float(east), float(north)


def _operation(name: str, crs: pyproj.CRS, area: tuple[float, float, float, float] | None) -> Operation:
    """The transformation from a CRS to WGS 84 for an area in deg. Raises `DemError` if PROJ has none."""
    try:
        return operation(crs, "EPSG:4326", area)
    except NoOperation as error:
        raise DemError(
            f"{name}: PROJ knows no transformation from WGS 84 to {crs.name!r} but a ballpark one."
        ) from error


def in_unit(usual: Spacing, crs: pyproj.CRS, edges: tuple[float, float, float, float]) -> tuple[float, float]:
    """A spacing, across and down, in the unit of a CRS."""
    metres, unit = usual.metres, crs.axis_info[0].unit_conversion_factor
    if not crs.is_geographic:
        return _rounded(metres / unit, usual.digits), _rounded(metres / unit, usual.digits)
    lat = (edges[1] + edges[3]) / 2.0 * unit
    across, down = metres / (WGS84.a * max(math.cos(lat), 0.01) * unit), metres / (WGS84.a * unit)
    return _rounded(across, usual.digits), _rounded(down, usual.digits)


def _rounded(value: float, digits: int | None) -> float:
    return value if digits is None else float(f"{value:.{digits}g}")
