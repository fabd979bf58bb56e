"""Tiles of a STAC collection, found through pystac-client."""

from __future__ import annotations

import urllib.parse
from typing import Any

from jaxgeo.io.archives.catalogue import STAC, Archive, Cell
from jaxgeo.io.archives.errors import ArchiveError, Unreachable
from jaxgeo.io.archives.web import Web

NAMES = ("data", "elevation", "dem", "dsm", "dtm")  # of assets with heights
TIFF = "image/tiff"
MOST = 200  # items of one cell


def tiles_of(archive: Archive, cell: Cell, web: Web) -> list[str]:
    """Addresses of the GeoTIFFs with heights of a cell of a degree. Raises `ArchiveError`; `ImportError` without
    the extra."""
    try:
        import pystac_client
        import requests
        from pystac_client.exceptions import APIError
        from pystac_client.stac_api_io import StacApiIO
    except ImportError as error:
        raise ImportError(f"{archive.name}: STAC needs pystac-client: pip install 'jaxgeo[stac]'") from error
    root, _, collection = archive.name.removeprefix(STAC).partition("/collections/")
    south, west = cell
    try:
        io = StacApiIO(timeout=web.timeout, max_retries=web.tries - 1)
        if web.proxy is not None:
            io.session.proxies = {"http": web.proxy, "https": web.proxy}
        client = pystac_client.Client.open(root, stac_io=io)
        search = client.search(
            collections=[collection.strip("/")],
            bbox=[west, south, west + 1, south + 1],
            max_items=MOST + 1,
        )
        items = list(search.items())
    except requests.exceptions.Timeout as error:
        raise Unreachable(f"{root}: no answer within {web.timeout:g} s") from error
    except (requests.exceptions.RequestException, APIError) as error:
        raise Unreachable(f"{root}: the search failed: {' '.join(f'{error}'.split())[:300]}") from error
    except (KeyError, TypeError, ValueError, NotImplementedError, AttributeError) as error:
        raise ArchiveError(f"{root}: this is no STAC API with item search: {' '.join(f'{error}'.split())}") from error
    if len(items) > MOST:
        raise ArchiveError(f"{archive.name}: more than {MOST} items in one degree; name a collection of larger tiles.")
    finest = min((item.properties.get("gsd") or 0.0 for item in items), default=0.0)
    chosen = [item for item in items if (item.properties.get("gsd") or 0.0) == finest]
    return [_address(archive, item) for item in chosen]


def _address(archive: Archive, item: Any) -> str:
    """The address of the heights of an item: the asset of a usual name or role, or the only GeoTIFF."""
    tiffs = {key: one for key, one in item.assets.items() if (one.media_type or "").startswith(TIFF)
             or one.href.split("?")[0].lower().endswith((".tif", ".tiff"))}  # fmt: skip
    named = [tiffs[name] for name in NAMES if name in tiffs]
    named += [one for one in tiffs.values() if "data" in (one.roles or [])]
    found = named[:1] or (list(tiffs.values()) if len(tiffs) == 1 else [])
    if not found:
        raise ArchiveError(f"{archive.name}: item {item.id} has no GeoTIFF named {', '.join(NAMES)} among its assets.")
    href = found[0].get_absolute_href() or found[0].href
    if href.startswith("s3://"):
        bucket, _, key = href.removeprefix("s3://").partition("/")
        href = f"https://{bucket}.s3.amazonaws.com/{key}"
    if urllib.parse.urlsplit(href).scheme not in ("http", "https"):
        raise ArchiveError(f"{archive.name}: item {item.id} is at {href}; only http and https addresses are read.")
    return href
