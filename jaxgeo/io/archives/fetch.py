"""Elevation models from open archives: the parts of their tiles that an area or lines of sight need."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.earth.ray import Ray
from jaxgeo.io.archives.catalogue import ARCHIVES, PROJ, Archive, archive_of, mirrors_of
from jaxgeo.io.archives.errors import ArchiveError
from jaxgeo.io.archives.geoid_window import datum_for, grid_folder, is_offline
from jaxgeo.io.archives.ground import ArchiveGround, positions
from jaxgeo.io.archives.parts import file_name
from jaxgeo.io.archives.record import FetchedDem, listed
from jaxgeo.io.archives.sight import BESIDE, Extent, follow
from jaxgeo.io.archives.store import DemCache
from jaxgeo.io.archives.views import View
from jaxgeo.io.archives.web import Web
from jaxgeo.io.datum_names import known_datum
from jaxgeo.io.vertical import VerticalDatum
from jaxgeo.io.windows import Bounds

MOST_DEGREES = 16.0  # deg**2 of an area
EGM2008 = ARCHIVES["copernicus"].datum
IN_PLACE = (
    'vertical_datum="EPSG:5773", EGM96 in place of EGM2008: it comes with the package, and is within about a metre of '
    "it in most places."
)


def fetch_dem(
    archive: str | Archive = "copernicus",
    *,
    bounds: Bounds | None = None,
    rays: Ray | Iterable[Ray] | View | None = None,
    spread: float = 0.0,
    beside: float = BESIDE,
    vertical_datum: VerticalDatum = None,
    mirror: str | None = None,
    proxy: str | None = None,
    offline: bool | None = None,
    cache: DemCache | None = None,
) -> FetchedDem:
    """Fetch the parts of an archive's tiles that an area or lines of sight need; uses the network.

    `archive` is a name of `jaxgeo.io.archives.ARCHIVES` ("copernicus", "copernicus-90", "srtm", "skadi", "3dep"), an
    address with fields such as "https://host/{S}{W}.tif", or "stac:" and the address of a STAC collection. Give

    - `bounds`: (west, south, east, north) in deg; or
    - `rays`: ECEF rays of any shape, several batches of them, or a `View` (of `view_of`, `view_of_image`, `view_from`).
      Each is followed until it has certainly hit the ground; with `spread`, an angle in rad, and `beside`, a distance
      in m, by which the lines of sight may be wrong. Rays that stay above the ground are cut at 100 km, rising ones at
      20 km: `FetchedDem.cut` counts them.

    Whole blocks of the tiles are read by range requests and kept in `cache`; what is there is not asked for again, also
    with `offline=True` (default: whether the environment variable JAXGEO_OFFLINE is 1). `mirror` is an address or a
    folder with the layout of the archive, or "NAME=ADDRESS NAME=ADDRESS", where the name "proj" is for PROJ's geoid
    grids (default: JAXGEO_DEM_MIRROR); `proxy` is an address (default: HTTPS_PROXY). `vertical_datum` replaces that of
    the archive, and is required for others if their files do not state it. A geoid grid that PROJ lacks is fetched as a
    window from where PROJ publishes it.

    Raises `ArchiveError`, a `DemError`, if something is missing, with what to do; `ImportError` for STAC without the
    extra.
    """
    found = archive_of(archive)
    area = None if bounds is None else _checked(found, bounds)
    if isinstance(rays, View):
        rays, spread, beside = rays.rays, max(spread, rays.spread), max(beside, rays.beside)
    each = [] if rays is None else [rays] if isinstance(rays, Ray) else list(rays)
    for one in each:
        check_is(one, Ray, "rays")
    if area is None and not each:
        raise ArchiveError(f"{found.name}: say for which ground: bounds=(west, south, east, north) or rays=.")
    mirrors = mirrors_of(mirror, found.name)
    kept = DemCache() if cache is None else cache
    ground = ArchiveGround(found, kept, Web.usual(proxy), is_offline() if offline is None else offline, mirrors)
    extent, cut = Extent(), 0
    if area is not None:
        lon, lat = positions(area)
        ground.fetch(lon, lat)
        extent.add(np.array([area[0], area[2]]), np.array([area[1], area[3]]))
        extent.west, extent.east = area[0], area[2] if area[2] > area[0] else area[2] + 360.0
    for one in each:
        cut += follow(one, ground, extent, spread=spread, beside=beside)
    edges = extent.bounds
    if edges is None:
        raise ArchiveError(f"{found.name}: no line of sight comes near the ground, so no elevation model is needed.")
    ground.fill(edges)
    if not ground.parts:
        raise ArchiveError(
            f"{found.name}: the archive has no tile {listed(sorted(ground.gaps))}: it covers "
            f"{found.where or 'other places'}. Take another archive, such as copernicus."
        )
    datum = known_datum(vertical_datum)
    if found.datum is not None and f"{datum}".removeprefix("EPSG:") in ("None", found.datum.removeprefix("EPSG:")):
        datum = ground.told(
            lambda web: datum_for(str(found.datum), found.geoid, edges, kept, web, mirrors.get(PROJ)),
            f"Get it while online with `jaxgeo dem --geoid {found.datum}`, or put the file into {grid_folder()}; or "
            "take " + (IN_PLACE if found.datum == EGM2008 else "another vertical_datum=... ."),
        )
    parts = [ground.parts[key] for key in sorted(ground.parts)]
    return FetchedDem(
        archive=found,
        files=tuple(part.path for part in parts),
        bounds=edges,
        vertical_datum=datum,
        tiles=tuple(sorted({file_name(key[0]) for key in ground.parts})),
        sea=tuple(sorted({file_name(key[0]) for key, part in ground.parts.items() if part.sea})),
        gaps=tuple(sorted(ground.gaps)),
        fetched=sum(part.size for part in parts if not part.was_cached and not part.sea),
        cached=sum(part.size for part in parts if part.was_cached and not part.sea),
        cut=cut,
        stated=vertical_datum,
    )


def _checked(archive: Archive, bounds: Bounds) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(edge) for edge in bounds)
    except (TypeError, ValueError) as error:
        raise ArchiveError(
            f"{archive.name}: bounds must be (west, south, east, north) in deg; got {bounds!r}."
        ) from error
    known = all(map(math.isfinite, (west, south, east, north))) and max(abs(west), abs(east)) <= 360.0
    if not known or not -90.0 <= south < north <= 90.0 or west == east:
        raise ArchiveError(
            f"{archive.name}: bounds must be (west, south, east, north) in deg, south below north; got {bounds!r}."
        )
    wide = (east - west) % 360.0
    if wide * (north - south) > MOST_DEGREES:
        raise ArchiveError(
            f"{archive.name}: the bounds hold {wide * (north - south):.4g} square degrees; ask for at most "
            f"{MOST_DEGREES:g} at once."
        )
    return west, south, east, north
