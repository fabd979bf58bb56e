"""Accuracy maps as GeoTIFFs: a raster in any CRS over the footprint of an image or over a terrain."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import rasterio
import rasterio.shutil
from rasterio.errors import RasterioError

from jaxgeo._checks import check_is
from jaxgeo._partial import partial_file
from jaxgeo.earth import Geodetic
from jaxgeo.io._read_back import WrittenWindows
from jaxgeo.io.map_raster import MapRaster, checked_target, map_of, raster_of
from jaxgeo.io.windows import Bounds
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty import NO_FIX, AccuracyMap, ErrorModel, Method, accuracy_map
from jaxgeo.uncertainty._accuracy_map import checked_map
from jaxgeo.uncertainty.sampling import accepts_sampling_options

COG = {"compress": "deflate", "predictor": "yes", "overview_resampling": "nearest"}
UNITS = ("m", "m", "", "")


@accepts_sampling_options
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
    cog: bool = False,
    **how: Any,
) -> AccuracyMap:
    """Compute the `accuracy_map` of a raster's cell centres and write it to a GeoTIFF.

    Arguments and errors as for `accuracy_map`; its other options (`probability`, `sampling`, `time`, ...) are passed
    on.

    - `crs`: anything pyproj takes, such as "EPSG:25832"; by default the UTM zone, or UPS, at the centre of the area.
      Its horizontal part is used.
    - `bounds`: (west, south, east, north) in the unit of that CRS; by default the visible ground of the image, or for
      a `Pose` all of the terrain. East and south are moved outwards to whole cells.
    - `resolution`: cell size, or (across, down), in the same unit; by default the terrain's post spacing.
    - `cog`: write a cloud-optimised GeoTIFF. Its overviews use nearest-neighbour resampling, which preserves codes.

    Bands (float32): circular error and linear error in m, NaN (the nodata value) where unknown, infinite where too many
    samples fail; the method, a code of `Method`, or -1 for no fix; and the `Status`. The file's tags list the codes,
    the probability and the number of samples. The file appears only when complete.
    Raises `ValueError` for an invalid CRS, bounds or resolution, for an area that cannot be determined, and
    as `accuracy_map`; `FileNotFoundError` for a missing folder; `OSError` where it cannot be written.
    """
    target = checked_target(path, "a map of accuracy")
    check_is(sensor, Sensor, "sensor")
    checked_map(sensor, shot, terrain, errors, **how)  # before lines of sight are located
    raster = raster_of(f"{target}", sensor, shot, terrain, crs, bounds, resolution, how)
    cells = centres_of(f"{target}", raster)
    if not np.isfinite(np.asarray(cells.lat)).any():
        raise ValueError(
            f"{target}: {raster.crs.name!r} maps none of the raster's cells; its bounds are in its own unit."
        )
    found = accuracy_map(sensor, shot, terrain, errors, cells, **how)
    write_bands(target, bands_of(found), raster, found.probability, tags_of(found), cog)
    return found


def centres_of(name: str, raster: MapRaster) -> Geodetic:
    """Positions (rows, cols) of cell centres; NaN outside the domain of the CRS."""
    mapping = map_of(name, raster)
    row, col = np.meshgrid(*(np.arange(float(n)) for n in raster.shape), indexing="ij")
    lon, lat = (x.reshape(raster.shape) for x in mapping.lonlat(row.ravel(), col.ravel()))
    known = np.isfinite(lon) & np.isfinite(lat)
    lat, lon = (jnp.asarray(np.radians(np.where(known, x, np.nan))) for x in (lat, lon))
    return Geodetic(lat=lat, lon=lon, height=jnp.zeros_like(lat))


def bands_of(found: AccuracyMap) -> np.ndarray:
    """The bands (4, ...) of a map."""
    return np.stack([np.asarray(x, np.float32) for x in (found.circular, found.linear, found.method, found.status)])


def band_names(probability: float) -> tuple[str, ...]:
    """Names of the bands."""
    percent = f"{100.0 * probability:g}"
    return f"CE{percent}, m", f"LE{percent}, m", "method", "status"


def write_bands(
    target: pathlib.Path,
    bands: np.ndarray,
    raster: MapRaster,
    probability: float,
    tags: Mapping[str, str],
    cog: bool,
) -> None:
    """Write the bands (4, rows, cols) of a map. The file appears only when complete; raises `OSError`."""
    rows, cols = raster.shape
    profile = {"driver": "GTiff", "dtype": "float32", "count": 4, "height": rows, "width": cols, "nodata": np.nan}
    profile |= {"crs": raster.crs.to_wkt(), "transform": raster.transform, "compress": "deflate"}
    written = WrittenWindows((rows, cols))
    written.add(0, 0, bands, None)
    try:
        with partial_file(target) as partial:
            with rasterio.open(partial, "w", **profile) as sink:
                sink.write(bands)
                sink.descriptions = band_names(probability)
                sink.units = UNITS
                sink.update_tags(**tags)
            whole = partial
            if cog:
                whole = partial.with_name(f"{partial.name}.cog")
                rasterio.shutil.copy(partial, whole, driver="COG", **COG)
            if mistake := written.mistake(whole):
                raise OSError(mistake)
            whole.replace(target)
    except (OSError, RasterioError) as error:
        raise OSError(f"{target}: the map cannot be written here: {error}") from error


def tags_of(found: AccuracyMap) -> dict[str, str]:
    """What the codes of a map mean, the probability and the number of samples."""
    methods = [(NO_FIX, "no fix"), *((int(one), one.words) for one in Method)]
    return {
        "SOFTWARE": "jaxgeo",
        "PROBABILITY": f"{found.probability:g}",
        "SAMPLES": str(found.count),
        "METHOD_CODES": " | ".join(f"{code}: {words}" for code, words in methods),
        "STATUS_CODES": " | ".join(f"{int(one)}: {found.meaning(one).rstrip('.')}" for one in Status),
    }
