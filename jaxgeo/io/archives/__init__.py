"""Elevation models of open archives: which tiles a scene needs, how they are fetched, kept and read.

`fetch_dem` fetches parts of tiles by range requests into a `DemCache`; `ARCHIVES` are the archives known by name.
Nothing here uses a network before one of these functions is called.
"""

from __future__ import annotations

from jaxgeo.io.archives.catalogue import ARCHIVES, Archive, archive_of, is_archive
from jaxgeo.io.archives.errors import ArchiveError
from jaxgeo.io.archives.fetch import fetch_dem
from jaxgeo.io.archives.geoid_window import fetch_geoid
from jaxgeo.io.archives.record import FetchedDem
from jaxgeo.io.archives.store import DemCache
from jaxgeo.io.archives.views import View, view_from, view_of, view_of_image, view_of_images
from jaxgeo.io.archives.writer import write_dem

__all__ = [
    "ARCHIVES",
    "Archive",
    "ArchiveError",
    "DemCache",
    "FetchedDem",
    "View",
    "archive_of",
    "fetch_dem",
    "fetch_geoid",
    "is_archive",
    "view_from",
    "view_of",
    "view_of_image",
    "view_of_images",
    "write_dem",
]
