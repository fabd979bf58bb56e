"""Elevation models of open archives: which tiles a scene needs, how they are fetched, kept and read.

`fetch_dem` fetches parts of tiles by range requests into a `DemCache`; `ARCHIVES` are the archives known by name.
Nothing here uses a network before one of these functions is called.
"""

from __future__ import annotations

from jaxgeo.io.archives.catalogue import ARCHIVES as ARCHIVES
from jaxgeo.io.archives.catalogue import Archive as Archive
from jaxgeo.io.archives.catalogue import archive_of as archive_of
from jaxgeo.io.archives.catalogue import is_archive as is_archive
from jaxgeo.io.archives.errors import ArchiveError as ArchiveError
from jaxgeo.io.archives.fetch import FetchedDem as FetchedDem
from jaxgeo.io.archives.fetch import fetch_dem as fetch_dem
from jaxgeo.io.archives.geoid_window import fetch_geoid as fetch_geoid
from jaxgeo.io.archives.store import DemCache as DemCache
from jaxgeo.io.archives.views import View as View
from jaxgeo.io.archives.views import view_from as view_from
from jaxgeo.io.archives.views import view_of as view_of
from jaxgeo.io.archives.views import view_of_image as view_of_image
from jaxgeo.io.archives.writer import write_dem as write_dem
