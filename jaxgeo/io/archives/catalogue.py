"""Open archives of elevation models: addresses of their tiles, vertical datums, licences and rules."""

from __future__ import annotations

import dataclasses
import os
import re
import string
from typing import Literal

from jaxgeo.io.archives.errors import ArchiveError

Cell = tuple[int, int]
"""(south edge, west edge) of a cell of 1 x 1 degree, whole degrees."""

FIELDS = ("S", "N", "W", "E", "s", "n", "w", "e")
COPERNICUS_WIDTHS = ((50, 1.0), (60, 1.5), (70, 2.0), (80, 3.0), (85, 5.0), (90, 10.0))  # up to latitude: spacing
STAC = "stac:"
SCHEMES = ("http://", "https://")
PROJ = "proj"  # name of PROJ's geoid grids among mirrors
MIRROR = "JAXGEO_DEM_MIRROR"  # environment variable: an address or a folder, or NAME=ADDRESS for several archives


@dataclasses.dataclass(frozen=True, kw_only=True)
class Archive:
    """An archive of elevation tiles.

    `pattern` is the address of the tile of a cell, below `base`: `{S}`, `{N}`, `{W}`, `{E}` are its edges as N36 or
    W085, in lower case `{s}`, ... as n36. `datum` is that of the heights, None if the files or the caller state it;
    `geoid` is the grid of PROJ for it, None if it comes with the package or is unknown. `missing` says what an absent
    tile is: ground at height zero ("sea"), or nothing.
    """

    name: str
    title: str
    base: str
    pattern: str
    datum: str | None = None
    geoid: str | None = None
    licence: str = "not known; see its publisher"
    attribution: str = ""
    missing: Literal["sea", "nothing"] = "nothing"
    listing: str | None = None
    """File with the names of all tiles, below `base`."""
    twin: str | None = None
    """An archive that has land where this one has none: an absent tile that it has is not sea."""
    per_degree: int = 0
    """Posts per degree of latitude, where absent tiles are sea."""
    narrowing: bool = False
    """Whether columns are farther apart towards the poles, as in Copernicus DEM."""
    shared_edges: bool = False
    """Whether neighbouring tiles repeat a row and a column of posts."""
    latitudes: tuple[int, int] = (-90, 90)
    """Edges in deg, beyond which there are no tiles."""
    where: str = ""
    """Words for the area that it covers."""

    def path_of(self, cell: Cell) -> str:
        """Address of a cell's tile below `base`."""
        return self.pattern.format(**names_of(cell))

    def url_of(self, cell: Cell) -> str:
        """Full address of a cell's tile."""
        return joined(self.base, self.path_of(cell))

    def sea_grid(self, cell: Cell) -> tuple[tuple[int, int], tuple[float, float, float, float, float, float]]:
        """(rows, cols) and the transform of corners of an absent tile of zero height."""
        south, west = cell
        nearest = south if south >= 0 else -south - 1  # edge towards the equator
        factor = next(by for to, by in COPERNICUS_WIDTHS if nearest < to) if self.narrowing else 1.0
        rows, cols = self.per_degree, round(self.per_degree / factor)
        down, across = 1.0 / rows, 1.0 / cols
        more = int(self.shared_edges)
        return (rows + more, cols + more), (across, 0.0, west - across / 2.0, 0.0, -down, south + 1.0 + down / 2.0)


def names_of(cell: Cell) -> dict[str, str]:
    """Fields of a pattern for a cell."""
    south, west = cell
    upper = {"S": _lat(south), "N": _lat(south + 1), "W": _lon(west), "E": _lon(west + 1)}
    return upper | {key.lower(): text.lower() for key, text in upper.items()}


def _lat(edge: int) -> str:
    return f"{'N' if edge >= 0 else 'S'}{abs(edge):02d}"


def _lon(edge: int) -> str:
    return f"{'E' if edge >= 0 else 'W'}{abs(edge):03d}"


COPERNICUS_LICENCE = (
    "free for any use with attribution (Copernicus DEM licence, "
    "https://dataspace.copernicus.eu/explore-data/data-collections/copernicus-contributing-missions)"
)
COPERNICUS_ATTRIBUTION = (
    "© DLR e.V. 2010-2014 and © Airbus Defence and Space GmbH 2014-2018 provided under COPERNICUS by the European "
    "Union and ESA; all rights reserved"
)
# Layouts: https://copernicus-dem-30m.s3.amazonaws.com/readme.html (names by the south-west corner, posts at whole
# degrees in the first row and column, no tiles over the ocean, "there one can assume height values equal to zero");
# https://opentopography.s3.sdsc.edu/raster/SRTM_GL1/ (SRTM version 3, tiles as of NASA); https://registry.opendata.aws/
# terrain-tiles/ (skadi); https://prd-tnm.s3.amazonaws.com/StagedProducts/Elevation/13/TIFF/current/ (1/3 arc second,
# names by the north-west corner).
ARCHIVES = {
    one.name: one
    for one in (
        Archive(
            name="copernicus",
            title="Copernicus DEM GLO-30 (surface, 30 m)",
            base="https://copernicus-dem-30m.s3.amazonaws.com",
            pattern="Copernicus_DSM_COG_10_{S}_00_{W}_00_DEM/Copernicus_DSM_COG_10_{S}_00_{W}_00_DEM.tif",
            datum="EPSG:3855",
            geoid="us_nga_egm08_25.tif",
            licence=COPERNICUS_LICENCE,
            attribution=COPERNICUS_ATTRIBUTION,
            missing="sea",
            listing="tileList.txt",
            twin="copernicus-90",
            per_degree=3600,
            narrowing=True,
        ),
        Archive(
            name="copernicus-90",
            title="Copernicus DEM GLO-90 (surface, 90 m)",
            base="https://copernicus-dem-90m.s3.amazonaws.com",
            pattern="Copernicus_DSM_COG_30_{S}_00_{W}_00_DEM/Copernicus_DSM_COG_30_{S}_00_{W}_00_DEM.tif",
            datum="EPSG:3855",
            geoid="us_nga_egm08_25.tif",
            licence=COPERNICUS_LICENCE,
            attribution=COPERNICUS_ATTRIBUTION,
            missing="sea",
            listing="tileList.txt",
            per_degree=1200,
            narrowing=True,
        ),
        Archive(
            name="srtm",
            title="SRTM GL1 version 3 (surface, 30 m, from 56 S to 60 N)",
            base="https://opentopography.s3.sdsc.edu/raster/SRTM_GL1/SRTM_GL1_srtm",
            pattern="{S}{W}.tif",
            datum="EPSG:5773",
            licence="public domain (NASA)",
            attribution="NASA Shuttle Radar Topography Mission Global 1 arc second, distributed by OpenTopography",
            missing="sea",
            per_degree=3600,
            shared_edges=True,
            twin="copernicus-90",
            latitudes=(-56, 60),
            where="land between 56 S and 60 N",
        ),
        Archive(
            name="skadi",
            title="Terrain Tiles (SRTM and national models, 30 m)",
            base="https://s3.amazonaws.com/elevation-tiles-prod/skadi",
            pattern="{S}/{S}{W}.hgt.gz",
            datum="EPSG:5773",
            licence="see https://github.com/tilezen/joerd/blob/master/docs/attribution.md",
            attribution="Mapzen Terrain Tiles, with SRTM of NASA and models of national mapping agencies",
            where="the Earth",
        ),
        Archive(
            name="3dep",
            title="USGS 3DEP 1/3 arc second (bare earth, 10 m)",
            base="https://prd-tnm.s3.amazonaws.com",
            pattern="StagedProducts/Elevation/13/TIFF/current/{n}{w}/USGS_13_{n}{w}.tif",
            datum="EPSG:5703",
            geoid="us_noaa_g2018u0.tif",
            licence="public domain (U.S. Geological Survey)",
            attribution="U.S. Geological Survey, 3D Elevation Program 1/3 arc second DEM",
            where="the conterminous United States and parts of Alaska and its islands",
        ),
    )
}


def is_archive(name: str) -> bool:
    """Whether the name of an elevation model means an archive: one of `ARCHIVES`, a pattern with fields, or STAC."""
    if name.startswith(STAC) or (_fields(name) and not os.path.exists(name)):
        return True
    return name in ARCHIVES and not os.path.exists(name)


def archive_of(name: str | Archive) -> Archive:
    """The archive of a name: of `ARCHIVES`, an address with fields (`https://host/{S}{W}.tif`), or `stac:` and the
    address of a STAC collection. Raises `ArchiveError`."""
    if isinstance(name, Archive):
        return name
    if name in ARCHIVES:
        return ARCHIVES[name]
    if name.startswith(STAC):
        url = name.removeprefix(STAC)
        if "/collections/" not in url or not url.startswith(SCHEMES):
            raise ArchiveError(
                f"{name}: this names no STAC collection; give its address, stac:https://HOST/.../collections/NAME."
            )
        return Archive(name=name, title=f"STAC collection {url.rpartition('/')[2]}", base=url, pattern="")
    fields = _fields(name)
    if not fields:
        raise ArchiveError(
            f"{name}: no such archive; known are {', '.join(ARCHIVES)}, an address with fields such as "
            f"https://HOST/{{S}}{{W}}.tif, or stac:https://HOST/.../collections/NAME."
        )
    wrong = [one for one in fields if one not in FIELDS]
    if wrong or not ({"S", "N", "s", "n"} & set(fields) and {"W", "E", "w", "e"} & set(fields)):
        what = f"the field {{{wrong[0]}}} is unknown" if wrong else "it needs a field of latitude and one of longitude"
        raise ArchiveError(
            f"{name}: {what}; {{S}} or {{N}} is the southern or northern edge of a cell of a degree (N36), {{W}} or "
            f"{{E}} its western or eastern (W085), in lower case n36, w085."
        )
    if "://" in name and not name.startswith(SCHEMES):
        raise ArchiveError(f"{name}: only http:// and https:// addresses are read, and files.")
    root, _, pattern = name.partition("{")
    base, _, start = root.rpartition("/")
    return Archive(name=name, title=f"tiles at {base}", base=base, pattern=f"{start}{{{pattern}")


def mirrors_of(text: str | None, archive: str = "") -> dict[str, str]:
    """Base address or folder by archive: from NAME=ADDRESS pairs, or one for `archive`; by default those of the
    environment. Raises `ArchiveError`."""
    text = os.environ.get(MIRROR) if text is None else text
    if not text:
        return {}
    pairs = re.findall(r"(?:^|\s)([\w-]+)=(\S+)", text)
    wrong = next((name for name, _ in pairs if name not in (*ARCHIVES, PROJ)), None)
    if wrong is not None:
        raise ArchiveError(f"mirror={text!r}: no archive {wrong}; known are {', '.join((*ARCHIVES, PROJ))}.")
    each = dict(pairs) or {archive: text}
    for base in each.values():
        if not base.startswith(SCHEMES) and not os.path.isdir(base):
            raise ArchiveError(f"mirror={base!r}: neither an address (https://...) nor a folder.")
    return each


def _fields(name: str) -> list[str]:
    try:
        return [field for _, field, _, _ in string.Formatter().parse(name) if field is not None]
    except ValueError:
        return []


def joined(base: str, path: str) -> str:
    """An address or file name below a base."""
    return f"{base.rstrip('/')}/{path}"
