"""Geoid grids for heights of archives: PROJ's own where they are installed, else a window of those that PROJ offers.

PROJ publishes its grids at https://cdn.proj.org (`pyproj.sync.get_proj_endpoint`, PROJ_NETWORK_ENDPOINT). A window of
a grid gives the same undulations as the whole, since PROJ interpolates bilinearly between its posts.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import pathlib

import pyproj
from pyproj.crs import CompoundCRS
from pyproj.datadir import append_data_dir, get_user_data_dir  # pyright: ignore[reportPrivateImportUsage]
from pyproj.exceptions import CRSError
from pyproj.sync import get_proj_endpoint  # pyright: ignore[reportPrivateImportUsage]
from rasterio.io import MemoryFile
from rasterio.transform import Affine
from rasterio.windows import Window

from jaxgeo._partial import partial_file
from jaxgeo.io._proj import NoOperation, operation
from jaxgeo.io.archives.catalogue import PROJ, joined, mirrors_of
from jaxgeo.io.archives.errors import ArchiveError, MissingGrid, Unreachable
from jaxgeo.io.archives.store import DemCache
from jaxgeo.io.archives.web import Web
from jaxgeo.io.datum_names import known_datum
from jaxgeo.io.errors import VerticalDatumError
from jaxgeo.io.vertical import VerticalDatum, height_shift

ROUND = 4  # deg: windows have edges at multiples, so that neighbouring places share one
MORE = 3  # posts around it

OFFLINE = "JAXGEO_OFFLINE"  # environment variable: 1 for no access to a network

Bounds = tuple[float, float, float, float]


def is_offline() -> bool:
    """Whether the environment forbids the network."""
    return os.environ.get(OFFLINE, "") not in ("", "0")


def grid_folder() -> str:
    """PROJ's folder of the user for grids."""
    return get_user_data_dir()


def datum_for(
    datum: str, grid: str | None, bounds: Bounds, cache: DemCache, web: Web | None, base: str | None = None
) -> VerticalDatum:
    """A vertical datum as `read_dem` takes it: the code if PROJ has its grid, else a window of the grid in the cache.

    `web` is None offline; `base` is a mirror of the grids that PROJ publishes. Raises `ArchiveError`,
    `VerticalDatumError`.
    """
    try:
        height_shift(datum, None, bounds if bounds[0] < bounds[2] else None)
        return datum
    except VerticalDatumError:
        if grid is None:
            raise
    west, south, east, north = (
        math.floor(bounds[0] / ROUND) * ROUND,
        max(math.floor(bounds[1] / ROUND) * ROUND, -90),
        math.ceil((bounds[2] + (360.0 if bounds[2] < bounds[0] else 0.0)) / ROUND) * ROUND,
        min(math.ceil(bounds[3] / ROUND) * ROUND, 90),
    )
    key = f"geoid {grid} {west} {south} {east} {north}"
    entry = cache.entry(key)
    found = None if entry is None else cache.object(str(entry.get("digest")), ".tif")
    if found is not None:
        return found
    if web is None:
        raise MissingGrid(f"heights above {datum} need the geoid grid {grid}, which is not on this machine")
    url = joined(base or get_proj_endpoint(), grid)
    content = web.retried(lambda: _window_of(url, web, (west, south, east, north)))
    digest, path = cache.put(content, ".tif")
    cache.set_entry(key, {"digest": digest, "url": url})
    return path


def fetch_geoid(datum: str = "EPSG:3855", *, mirror: str | None = None, proxy: str | None = None) -> list[pathlib.Path]:
    """Download the geoid grid that a vertical datum needs into PROJ's folder of the user, for use without a network.

    The grid and its checksum are those that PROJ publishes, as for `pyproj sync`; `mirror` is "proj=ADDRESS" (default:
    JAXGEO_DEM_MIRROR), `proxy` as in `fetch_dem`. The list of files is empty if the grid is there. Raises
    `ArchiveError` if a grid cannot be fetched or its checksum is wrong, or for an unknown datum.
    """
    web = Web.usual(proxy)
    if is_offline():
        raise ArchiveError(f"{datum}: {OFFLINE} is set; a geoid grid is fetched through the network.")
    try:
        vertical = pyproj.CRS.from_user_input(known_datum(datum))
        if not vertical.is_vertical:
            raise ArchiveError(f"{datum}: {vertical.name!r} is no vertical datum; give a code such as EPSG:3855.")
        operation(CompoundCRS("x", components=["EPSG:4326", vertical]), "EPSG:4979")
        return []
    except CRSError as error:
        raise ArchiveError(f"{datum}: PROJ does not know this datum; give a code such as EPSG:3855.") from error
    except NoOperation as error:
        names = [name for _, name, _ in error.missing if name]
    if not names:
        raise ArchiveError(f"{datum}: PROJ knows no transformation from it to the WGS 84 ellipsoid.")
    base = mirrors_of(mirror).get(PROJ) or get_proj_endpoint()
    folder = pathlib.Path(get_user_data_dir(True))
    try:
        known = _published(web, base)
    except Unreachable as error:
        raise Unreachable(
            f"{error}. Try again, name a proxy=... or mirror=..., or download {names[0]} elsewhere and put it into "
            f"{folder}."
        ) from error
    names = [name for name in dict.fromkeys(names) if name in known][:1]
    if not names:
        raise ArchiveError(f"{datum}: PROJ does not offer the grid that it needs; get it from its publisher.")
    found = []
    for name in names:
        url = joined(base, name)
        content = web.get(url)
        if content is None:
            raise ArchiveError(f"{url}: there is no such file.")
        if hashlib.sha256(content).hexdigest() != known[name]:
            raise ArchiveError(f"{url}: its SHA-256 is not the one that PROJ's list states; try again later.")
        try:
            with partial_file(folder / name) as partial:
                partial.write_bytes(content)
                partial.replace(folder / name)
        except OSError as error:
            raise ArchiveError(f"{folder}: the grid {name} cannot be written: {error.strerror}.") from error
        found.append(folder / name)
    append_data_dir(os.fspath(folder))
    return found


def _published(web: Web, base: str) -> dict[str, str]:
    """SHA-256 of each grid that PROJ offers."""
    url = joined(base, "files.geojson")
    content = web.get(url)
    try:
        listed = [one["properties"] for one in json.loads(content or b"")["features"]]
        return {one["name"]: one["sha256sum"] for one in listed if "name" in one and "sha256sum" in one}
    except (KeyError, TypeError, ValueError) as error:
        raise ArchiveError(f"{url}: this is not PROJ's list of grids.") from error


def _window_of(url: str, web: Web, box: tuple[int, int, int, int]) -> bytes:
    """A window of a grid as a GeoTIFF that PROJ reads."""
    with web.raster(url) as data:
        a, _, c, _, e, f = data.transform[:6]
        west, south, east, north = box
        turn = round(360.0 / a)
        first = math.floor((west - c) / a) - MORE
        count = math.ceil((east - west) / a) + 2 * MORE + 1
        shift = turn * math.floor(first / turn) if data.width >= turn else 0
        first -= shift
        if data.width >= turn and first + count > data.width:
            first, count, shift = 0, data.width, 0  # across its seam: all longitudes
        first, last = max(first, 0), min(first + count, data.width)
        top = max(math.floor((north - f) / e) - MORE, 0)
        bottom = min(math.ceil((south - f) / e) + MORE + 1, data.height)
        if first >= last or top >= bottom:
            raise MissingGrid(f"{url}: the grid does not reach there")
        window = Window(first, top, last - first, bottom - top)  # pyright: ignore[reportCallIssue]
        values = data.read(1, window=window)
        affine = Affine(a, 0.0, c + a * (first + shift), 0.0, e, f + e * top)
        profile = {"driver": "GTiff", "dtype": values.dtype, "count": 1, "height": values.shape[0],
                   "width": values.shape[1], "transform": affine, "crs": data.crs, "nodata": data.nodata,
                   "compress": "deflate"}  # fmt: skip
        with MemoryFile() as memory:
            with memory.open(**profile) as sink:
                sink.update_tags(**{key: text for key, text in data.tags().items() if key in ("TYPE", "AREA_OR_POINT")})
                sink.set_band_description(1, data.descriptions[0] or "geoid_undulation")
                sink.write(values, 1)
            return bytes(memory.getbuffer())
