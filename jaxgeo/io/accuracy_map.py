"""Maps of accuracy as GeoTIFFs: a raster in any CRS over what an image, or a terrain, covers."""

from __future__ import annotations

import math
import os
import pathlib
import secrets
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import rasterio
from pyproj.exceptions import CRSError
from rasterio.errors import RasterioError
from rasterio.transform import Affine

from jaxgeo._checks import check_is
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.io._proj import NoOperation, operation
from jaxgeo.io.errors import DemError
from jaxgeo.io.mapping import file_map
from jaxgeo.io.vertical import horizontal_part
from jaxgeo.io.windows import Bounds
from jaxgeo.locate import locate
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.uncertainty import NO_FIX, AccuracyMap, ErrorModel, Trust, accuracy_map

LATTICE = 65  # pixels along a side of the image, or places along one of a terrain, by which its extent is told
MARGIN = 0.01  # of the extent, by which it is widened: between the pixels of the lattice it may reach farther
MOST_CELLS = 4_000_000  # of a raster whose resolution nobody named


class _Raster(NamedTuple):
    """A raster's CRS, the transform of its corners, and (rows, cols)."""

    crs: pyproj.CRS
    transform: Affine
    shape: tuple[int, int]


def write_accuracy_map(
    path: str | os.PathLike[str],
    sensor: Sensor,
    shot: Shot | Trajectory | Pose,
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    crs: Any = None,
    bounds: Bounds | None = None,
    resolution: float | int | tuple[float | int, float | int] | None = None,
    **how: Any,
) -> AccuracyMap:
    """The `accuracy_map` of a raster's cells, made and written to a GeoTIFF.

    Arguments and errors as for `accuracy_map`, whose others (`probability`, `count`, `time`, `progress`, ...) go
    through. Each cell has the figures of its middle.

    - `crs`: anything pyproj takes, such as "EPSG:25832"; by default the zone of UTM, or UPS, about the middle of the
      area. Its horizontal part is used.
    - `bounds`: (west, south, east, north) in the unit of that CRS; by default what the image sees of the ground, or
      from a `Pose` all of the terrain. East and south are moved outwards to whole cells.
    - `resolution`: the size of a cell, or (across, down), in the same unit; by default the spacing of the terrain.

    Bands of 32-bit floats: circular error and linear error in m, NaN (the file's nodata) where there is none, infinite
    where too many samples fail; the verdict, a code of `Trust`, or -1 for no fix; and the `Status`. What the codes
    mean, the probability and the number of samples are in the file's tags. The file appears when all is written.
    Raises `ValueError` for a CRS, bounds or a resolution that make no sense, for an area of which none can be told, and
    as `accuracy_map`; `FileNotFoundError` for a folder that is not there; `OSError` where it cannot be written.
    """
    target = _checked_target(path)
    check_is(sensor, Sensor, "sensor")
    raster = _raster(f"{target}", sensor, shot, terrain, crs, bounds, resolution, how)
    found = accuracy_map(sensor, shot, terrain, errors, _cells(f"{target}", raster), **how)
    _write(target, found, raster)
    return found


def _checked_target(path: str | os.PathLike[str]) -> pathlib.Path:
    """Where to write, told before the work if it cannot be done."""
    target = pathlib.Path(path)
    if target.suffix.lower() not in (".tif", ".tiff"):
        raise ValueError(f"{target}: a map of accuracy is written as a GeoTIFF; name a file that ends in .tif.")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{target}: there is no folder {target.parent}.")
    if target.is_dir() or not os.access(target.parent, os.W_OK):
        raise PermissionError(f"{target}: no file can be written here.")
    return target


def _raster(
    name: str, sensor: Sensor, shot: Any, terrain: Any, crs: Any, bounds: Any, resolution: Any, how: dict[str, Any]
) -> _Raster:
    """The raster asked for, with what was left out told from the area that there is to see."""
    if crs is None and bounds is not None:
        raise ValueError(f"{name}: bounds={bounds!r} are in the unit of a CRS; name it with crs=.")
    area = _area(name, sensor, shot, terrain, how) if bounds is None else None
    flat = _checked_crs(name, crs) if crs is not None else _usual_crs(*_middle(area))
    edges = _bounds_of(name, flat, area) if bounds is None else _checked_bounds(name, bounds)
    size = _spacing(name, flat, terrain, edges) if resolution is None else _checked_resolution(name, resolution)
    (west, south, east, north), (across, down) = edges, size
    if bounds is None:
        west, north = across * math.floor(west / across), down * math.ceil(north / down)
    cols, rows = (max(1, math.ceil(n - 1e-9)) for n in ((east - west) / across, (north - south) / down))
    if resolution is None and rows * cols > MOST_CELLS:
        raise ValueError(
            f"{name}: at the terrain's spacing the map would have {rows} x {cols} cells; name a coarser resolution=, "
            f"or a part with bounds=."
        )
    return _Raster(flat, Affine(across, 0.0, west, 0.0, -down, north), (rows, cols))


def _cells(name: str, raster: _Raster) -> Geodetic:
    """Positions (rows, cols) of the middles of cells; NaN where the CRS maps nothing."""
    a, _, c, _, e, f = raster.transform[:6]
    mapping = file_map(name, raster.crs, (a, 0.0, c + a / 2.0, 0.0, e, f + e / 2.0), raster.shape)
    row, col = np.meshgrid(*(np.arange(float(n)) for n in raster.shape), indexing="ij")
    lon, lat = (x.reshape(raster.shape) for x in mapping.lonlat(row.ravel(), col.ravel()))
    known = np.isfinite(lon) & np.isfinite(lat)
    if not known.any():
        raise ValueError(
            f"{name}: {raster.crs.name!r} maps none of the raster's cells; its bounds are in its own unit."
        )
    lat, lon = (jnp.asarray(np.radians(np.where(known, x, np.nan))) for x in (lat, lon))
    return Geodetic(lat=lat, lon=lon, height=jnp.zeros_like(lat))


def _area(name: str, sensor: Sensor, shot: Any, terrain: Any, how: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes in deg that the map is to cover, no jump between them."""
    if isinstance(shot, Pose):
        if not isinstance(terrain, Dem):
            raise ValueError(f"{name}: a {type(terrain).__name__} has no edge; name the area with crs= and bounds=.")
        last = np.asarray(terrain.extent) - 1.0
        t = np.linspace(0.0, 1.0, LATTICE)
        rowcol = np.stack(np.meshgrid(t * last[0], t * last[1], indexing="ij"), axis=-1).reshape(-1, 2)
        x, y, z = np.asarray(_normals(terrain, jnp.asarray(rowcol))).T
        lat, lon = np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x))
    else:
        width, height = (getattr(sensor.camera, side) for side in ("width", "height"))
        u, v = np.linspace(-0.5, width - 0.5, LATTICE), np.linspace(-0.5, height - 0.5, LATTICE)
        uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        options = {key: how[key] for key in ("time", "search", "atmosphere") if key in how}
        fix = _located(sensor, shot, jnp.asarray(uv), terrain, options)
        seen = np.asarray(fix.status) == Status.hit
        if not seen.any():
            raise ValueError(
                f"{name}: no line of sight of the image comes down on the terrain; there is nothing to map."
            )
        lat, lon, _ = (np.asarray(x)[seen] for x in fix.position.to_degrees())
    return lon[0] + np.remainder(lon - lon[0] + 180.0, 360.0) - 180.0, lat


@eqx.filter_jit
def _located(sensor: Sensor, shot: Any, uv: jax.Array, terrain: AbstractTerrain, options: dict[str, Any]) -> Any:
    return jax.vmap(lambda pixel: locate(sensor, shot, pixel, terrain, **options))(uv)


@eqx.filter_jit
def _normals(terrain: Dem, rowcol: jax.Array) -> jax.Array:
    return jax.vmap(terrain.grid.normal)(rowcol)


def _middle(area: tuple[np.ndarray, np.ndarray] | None) -> tuple[float, float]:
    assert area is not None
    lon, lat = ((x.min() + x.max()) / 2.0 for x in area)
    return float((lon + 180.0) % 360.0 - 180.0), float(lat)


def _usual_crs(lon: float, lat: float) -> pyproj.CRS:
    """UTM on WGS 84, without the exceptions of Norway and Spitsbergen; UPS about the poles."""
    if not -80.0 <= lat <= 84.0:
        return pyproj.CRS.from_epsg(5041 if lat > 0.0 else 5042)
    zone = int((lon + 180.0) // 6.0) % 60 + 1
    return pyproj.CRS.from_epsg((32600 if lat >= 0.0 else 32700) + zone)


def _checked_crs(name: str, crs: Any) -> pyproj.CRS:
    try:
        flat = horizontal_part(pyproj.CRS.from_user_input(crs))
    except CRSError as error:
        raise ValueError(f"{name}: PROJ does not know the crs {crs!r}: {error}") from error
    if not (flat.is_geographic or flat.is_projected):
        raise ValueError(f"{name}: a map needs a projected or geographic crs; {flat.name!r} is a {flat.type_name}.")
    return flat


def _checked_bounds(name: str, bounds: Any) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(edge) for edge in bounds)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: bounds must be (west, south, east, north) in the CRS; got {bounds!r}.") from error
    if not (all(map(math.isfinite, (west, south, east, north))) and west < east and south < north):
        raise ValueError(f"{name}: bounds must be finite, with west < east and south < north; got {bounds!r}.")
    return west, south, east, north


def _checked_resolution(name: str, resolution: Any) -> tuple[float, float]:
    try:
        across, down = (float(x) for x in np.broadcast_to(resolution, 2))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name}: resolution must be one size of a cell, or (across, down); got {resolution!r}."
        ) from error
    if not (0.0 < across < math.inf and 0.0 < down < math.inf):
        raise ValueError(f"{name}: resolution must be positive and finite, in the CRS's unit; got {resolution!r}.")
    return across, down


def _bounds_of(name: str, crs: pyproj.CRS, area: Any) -> tuple[float, float, float, float]:
    """(west, south, east, north) in a CRS of an area in deg, and a little more."""
    lon, lat = area
    turned = (lon + 180.0) % 360.0 - 180.0
    try:
        found = operation(crs, "EPSG:4326", (turned[0], lat.min(), turned[0], lat.max()))
    except NoOperation as error:
        raise DemError(
            f"{name}: PROJ knows no transformation from WGS 84 to {crs.name!r} but a ballpark one."
        ) from error
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


def _spacing(name: str, crs: pyproj.CRS, terrain: Any, edges: tuple[float, float, float, float]) -> tuple[float, float]:
    """The terrain's spacing, across and down, in the unit of a CRS."""
    if not isinstance(terrain, Dem):
        raise ValueError(
            f"{name}: a {type(terrain).__name__} has no spacing; name the size of a cell with resolution=."
        )
    metres = float(np.sqrt(np.prod(np.asarray(terrain.grid.cell_size()))))
    unit = crs.axis_info[0].unit_conversion_factor
    if not crs.is_geographic:
        return metres / unit, metres / unit
    lat = (edges[1] + edges[3]) / 2.0 * unit
    return metres / (WGS84.a * max(math.cos(lat), 0.01) * unit), metres / (WGS84.a * unit)


def _write(target: pathlib.Path, found: AccuracyMap, raster: _Raster) -> None:
    bands = np.stack([np.asarray(x, np.float32) for x in (found.circular, found.linear, found.trust, found.status)])
    rows, cols = raster.shape
    profile = {"driver": "GTiff", "dtype": "float32", "count": 4, "height": rows, "width": cols, "nodata": np.nan}
    profile |= {"crs": raster.crs.to_wkt(), "transform": raster.transform, "compress": "deflate"}
    partial = target.with_name(f".jaxgeo-{secrets.token_hex(4)}.partial")
    percent = f"{100.0 * found.probability:g}"
    try:
        with rasterio.open(partial, "w", **profile) as sink:
            sink.write(bands)
            sink.descriptions = (f"CE{percent}, m", f"LE{percent}, m", "verdict", "status")
            sink.units = ("m", "m", "", "")
            sink.update_tags(**_tags(found))
        partial.replace(target)
    except (OSError, RasterioError) as error:
        raise OSError(f"{target}: the map cannot be written here: {error}") from error
    finally:
        partial.unlink(missing_ok=True)


def _tags(found: AccuracyMap) -> dict[str, str]:
    verdicts = [(NO_FIX, "no fix"), *((int(one), one.words) for one in Trust)]
    return {
        "SOFTWARE": "jaxgeo",
        "PROBABILITY": f"{found.probability:g}",
        "SAMPLES": str(found.count),
        "VERDICT_CODES": " | ".join(f"{code}: {words}" for code, words in verdicts),
        "STATUS_CODES": " | ".join(f"{int(one)}: {found.meaning(one).rstrip('.')}" for one in Status),
    }
