"""Tiles of a STAC API with item search, served on the loopback."""

from __future__ import annotations

import json
import pathlib
from typing import Any

import pytest
from support.tile_server import Served, plane_at, serving, write_tile

import jaxgeo
from jaxgeo.io.archives import ARCHIVES, ArchiveError, DemCache, fetch_dem
from jaxgeo.io.archives.web import Web

HERE = (-84.30, 36.30, -84.28, 36.32)
CORE = ["https://api.stacspec.org/v1.0.0/core", "https://api.stacspec.org/v1.0.0/item-search"]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Web, "usual", classmethod(lambda cls, proxy=None: cls(proxy, 1.0, 1)))


def write_api(served: Served, items: list[dict[str, Any]]) -> str:
    """A landing page and the answer to every search; the name of the collection."""
    root, url = served.root, served.url
    links = [{"rel": "self", "href": f"{url}/api"}, {"rel": "root", "href": f"{url}/api"},
             {"rel": "search", "href": f"{url}/search", "type": "application/geo+json", "method": "POST"}]  # fmt: skip
    landing = {"type": "Catalog", "id": "a", "stac_version": "1.0.0", "description": "a", "links": links}
    (root / "api").write_text(json.dumps(landing | {"conformsTo": CORE}))
    (root / "search").write_text(json.dumps({"type": "FeatureCollection", "features": items, "links": []}))
    return f"stac:{url}/api/collections/heights"


def item(name: str, href: str, *, gsd: float = 30.0, key: str = "data", media: str = "image/tiff; application=geotiff"):
    box = [-85.0, 36.0, -84.0, 37.0]
    ring = [[-85, 36], [-84, 36], [-84, 37], [-85, 37], [-85, 36]]
    return {
        "type": "Feature", "stac_version": "1.0.0", "id": name, "collection": "heights", "bbox": box, "links": [],
        "geometry": {"type": "Polygon", "coordinates": [ring]},
        "properties": {"datetime": "2021-01-01T00:00:00Z", "gsd": gsd},
        "assets": {key: {"href": href, "type": media}},
    }  # fmt: skip


@pytest.fixture
def tile(tmp_path: pathlib.Path) -> str:
    path = write_tile(tmp_path, ARCHIVES["srtm"], (36, -85), posts=240, block=128, heights=plane_at)
    return path.name


def test_the_finest_items_of_a_search_are_read(tmp_path: pathlib.Path, tile: str) -> None:
    cache = DemCache(tmp_path / "cache")
    with serving(tmp_path) as served:
        items = [item("fine", f"{served.url}/{tile}", gsd=10.0), item("coarse", f"{served.url}/none.tif", gsd=30.0)]
        name = write_api(served, items)
        found = fetch_dem(name, bounds=HERE, cache=cache, vertical_datum="EPSG:5773")
    assert found.tiles == (tile,)
    place = jaxgeo.Geodetic.from_degrees(lat=36.31, lon=-84.29, height=0.0)
    expected = plane_at(-84.29, 36.31) + float(jaxgeo.io.undulation(36.31, -84.29))  # pyright: ignore
    assert abs(float(found.read().height_at(place)) - expected) < 1e-2
    assert fetch_dem(name, bounds=HERE, cache=cache, offline=True).files == found.files
    with pytest.raises(ArchiveError, match="offline, and nobody searched for the tiles of N36W086"):
        fetch_dem(name, bounds=(-85.5, 36.3, -85.4, 36.4), cache=cache, offline=True)


@pytest.mark.parametrize(
    "assets, reason",
    [
        ({"href": "file:///etc/passwd"}, "only http and https addresses are read"),
        ({"href": "http://host/a.png", "media": "image/png"}, "has no GeoTIFF named data, elevation"),
    ],
)
def test_items_that_are_refused(tmp_path: pathlib.Path, assets: dict[str, Any], reason: str) -> None:
    with serving(tmp_path) as served:
        name = write_api(served, [item("odd", **assets)])
        with pytest.raises(ArchiveError, match=reason):
            fetch_dem(name, bounds=HERE, cache=DemCache(tmp_path / "cache"))


def test_servers_that_are_no_api(tmp_path: pathlib.Path) -> None:
    cache = DemCache(tmp_path / "cache")
    with serving(tmp_path) as served:
        (tmp_path / "api").write_text("<html>")
        with pytest.raises(ArchiveError, match=r"/api: (this is no STAC API|the search failed)"):
            fetch_dem(f"stac:{served.url}/api/collections/a", bounds=HERE, cache=cache)
        name = write_api(served, [])
        with pytest.raises(ArchiveError, match="the archive has no tile N36W085"):
            fetch_dem(name, bounds=HERE, cache=cache)
        served.fail("/search", "503")
        with pytest.raises(ArchiveError, match="the search failed"):
            fetch_dem(name, bounds=(5.0, 5.0, 5.1, 5.1), cache=cache)
    with pytest.raises(ArchiveError, match=r"the search failed|no answer"):
        fetch_dem(name, bounds=(7.0, 7.0, 7.1, 7.1), cache=cache)
