"""Elevation models of archives, against a server of tiles on the loopback: what is fetched, kept, and refused.

Heights are held against the whole tiles read by hand; layouts against the readme of the archive of Copernicus DEM, and
tile names of SRTM and 3DEP.
"""

from __future__ import annotations

import concurrent.futures
import functools
import gzip
import os
import pathlib
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
import rasterio
from rasterio.transform import Affine
from rasterio.windows import Window
from support.rasters import lose_tag, write
from support.tile_server import Served, heights_at, plane_at, serving, write_archive, write_geoid, write_tile

import jaxgeo
from jaxgeo.demo import scene_file
from jaxgeo.earth import WGS84, R_ecef_from_ned
from jaxgeo.io.archives import ARCHIVES, ArchiveError, DemCache, FetchedDem, fetch_dem, view_of, write_dem
from jaxgeo.io.archives import sight as sight_module
from jaxgeo.io.archives.catalogue import archive_of
from jaxgeo.io.archives.sight import Extent, follow
from jaxgeo.io.archives.web import Web
from jaxgeo.uncertainty import ErrorModel

CELL = (36, -85)
HERE = (-84.30, 36.30, -84.28, 36.32)  # within one block of the tile
NAME = "Copernicus_DSM_COG_10_N36_00_W085_00_DEM.tif"


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """Two tiles of GLO-30 side by side, of 1200 x 1200 posts, and the geoid grid."""
    root = tmp_path_factory.mktemp("archive")
    write_archive(root, "copernicus", [CELL, (36, -84)])
    write_geoid(root)
    return root


@pytest.fixture
def server(archive: pathlib.Path) -> Iterator[Served]:
    with serving(archive) as served:
        yield served


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a server up after two tries a moment apart, and a second without an answer."""
    monkeypatch.setattr("jaxgeo.io.archives.web.PAUSE", 0.01)
    monkeypatch.setattr(Web, "usual", classmethod(lambda cls, proxy=None: cls(proxy, 1.0, 2)))
    for name in ("JAXGEO_DEM_MIRROR", "JAXGEO_OFFLINE", "JAXGEO_DEM_CACHE_SIZE", "HTTPS_PROXY", "HTTP_PROXY"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def cache(tmp_path: pathlib.Path) -> DemCache:
    return DemCache(tmp_path / "cache")


def mirrors(served: Served, *names: str) -> str:
    return " ".join(f"{name}={served.url}" for name in ("copernicus", "proj", *names))


def fetched(served: Served, cache: DemCache, **how: Any) -> FetchedDem:
    return fetch_dem(**({"bounds": HERE, "mirror": mirrors(served), "cache": cache} | how))


def again(cache: DemCache) -> DemCache:
    """The same folder, as another process sees it."""
    return DemCache(cache.folder)


@functools.cache
def by_hand(archive: pathlib.Path, bounds: tuple[float, float, float, float] | None = None) -> jaxgeo.Dem:
    tile = archive / NAME.removesuffix(".tif") / NAME
    return jaxgeo.io.read_dem(tile, vertical_datum=archive / "us_nga_egm08_25.tif", bounds=bounds)


def same_heights(found: FetchedDem, whole: jaxgeo.Dem, bounds: tuple[float, float, float, float] = HERE) -> None:
    """Heights between posts, of what was fetched and of the whole tile."""
    rng = np.random.default_rng(1)
    terrain = found.read()
    for lon, lat in zip(rng.uniform(bounds[0], bounds[2], 5), rng.uniform(bounds[1], bounds[3], 5), strict=True):
        place = jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
        assert abs(float(terrain.height_at(place)) - float(whole.height_at(place))) < 1e-6


@pytest.mark.costly
def test_parts_of_a_tile_are_those_of_the_whole(server: Served, cache: DemCache, archive: pathlib.Path) -> None:
    found = fetched(server, cache)
    assert found.tiles == (NAME,)
    assert len(found.files) == 1
    assert server.sent < 0.35 * (archive / NAME.removesuffix(".tif") / NAME).stat().st_size + 4e5  # and the geoid grid
    same_heights(found, by_hand(archive))
    with rasterio.open(found.files[0]) as part, rasterio.open(archive / NAME.removesuffix(".tif") / NAME) as whole:
        row, col = whole.index(*part.xy(0, 0))
        window = Window(col, row, part.width, part.height)  # pyright: ignore[reportCallIssue]
        np.testing.assert_array_equal(part.read(1), whole.read(1, window=window))


def test_the_second_time_nothing_is_asked_for(server: Served, cache: DemCache) -> None:
    first = fetched(server, cache)
    count = len(server.asked)
    second = fetched(server, again(cache))
    third = fetch_dem(bounds=HERE, cache=again(cache), offline=True)
    assert len(server.asked) == count
    assert first.files == second.files == third.files
    assert (second.fetched, second.cached) == (third.fetched, third.cached) == (0, first.fetched)
    assert third.vertical_datum == first.vertical_datum


def test_across_two_tiles_there_is_no_step(server: Served, cache: DemCache) -> None:
    edges = (-84.01, 36.50, -83.99, 36.51)
    found = fetched(server, cache, bounds=edges)
    assert len(found.tiles) == 2
    terrain = found.read()
    for lon in np.linspace(-84.002, -83.998, 9):
        place = jaxgeo.Geodetic.from_degrees(lat=36.505, lon=lon, height=0.0)
        undulation = float(jaxgeo.io.undulation(36.505, lon)) + 1.0
        assert abs(float(terrain.height_at(place)) - undulation - heights_at(np.array(lon), np.array(36.505))) < 0.2


def test_the_datum_of_the_archive_may_be_repeated(server: Served, cache: DemCache) -> None:
    assert fetched(server, cache, vertical_datum="EPSG:3855").vertical_datum == fetched(server, cache).vertical_datum
    assert fetched(server, cache, vertical_datum=3855).vertical_datum == fetched(server, cache).vertical_datum


def test_a_datum_of_the_caller_needs_no_geoid_grid(server: Served, cache: DemCache) -> None:
    found = fetched(server, cache, vertical_datum="EPSG:5773", mirror=server.url)
    assert found.vertical_datum == "EPSG:5773"
    assert not [path for _, path, _ in server.asked if "egm08" in path]


# Faults of the network


@pytest.mark.costly
def test_a_connection_that_is_cut_is_tried_again(server: Served, cache: DemCache, archive: pathlib.Path) -> None:
    server.fail(NAME, "cut", times=1)
    same_heights(fetched(server, cache), by_hand(archive))


@pytest.mark.costly
@pytest.mark.parametrize("how", ["cut", "damage", "503", "403"])
def test_a_server_that_fails_is_given_up_in_a_line(server: Served, cache: DemCache, how: str) -> None:
    server.fail(NAME, how)
    with pytest.raises(ArchiveError, match=NAME) as told:
        fetched(server, cache)
    message = str(told.value)
    assert "\n" not in message
    assert {"403": "answers 403", "503": "answers 503"}.get(how, "it was not read whole") in message
    assert "name a proxy= or a mirror=" in message
    assert f"put it at {cache.given('copernicus', NAME)}" in message
    server.faults.clear()
    fetched(server, again(cache))  # nothing of the failure was kept


@pytest.mark.costly
def test_slow_answers_are_given_up(server: Served, cache: DemCache) -> None:
    server.fail(NAME, "slow")
    with pytest.raises(ArchiveError, match="no answer within 1 s"):
        fetched(server, cache)


@pytest.mark.costly
def test_a_server_that_is_not_there(archive: pathlib.Path, cache: DemCache) -> None:
    with serving(archive) as server:
        pass
    with pytest.raises(ArchiveError, match=r"it cannot be reached.*Connection refused"):
        fetched(server, cache)


def test_a_proxy_is_used(server: Served, cache: DemCache) -> None:
    """The server stands in for a proxy, which is asked for whole addresses."""
    server.fail("http://archive.invalid", "400")
    with pytest.raises(ArchiveError, match="the server answers 400"):
        fetch_dem(bounds=HERE, cache=cache, mirror="http://archive.invalid", proxy=server.url)
    assert server.asked[0][:2] == ("HEAD", f"http://archive.invalid/{NAME.removesuffix('.tif')}/{NAME}")


# Sea and land


def test_an_absent_tile_is_sea_if_the_list_lacks_it(server: Served, cache: DemCache) -> None:
    edges = (-84.5, 35.99, -84.49, 36.01)  # the tile to the south is not there
    found = fetched(server, cache, bounds=edges)
    assert found.sea == ("Copernicus_DSM_COG_10_N35_00_W085_00_DEM.tif",)
    assert any("sea, at height zero above EGM2008" in message for message in found.messages())
    assert found.to_dict()["sea_at_height_zero"] == list(found.sea)


def test_the_sea_has_height_zero_above_the_geoid(server: Served, cache: DemCache) -> None:
    found = fetched(server, cache, bounds=(-30.02, 36.30, -30.0, 36.32))
    place = jaxgeo.Geodetic.from_degrees(lat=36.31, lon=-30.01, height=0.0)
    assert abs(float(found.read().height_at(place)) - float(jaxgeo.io.undulation(36.31, -30.01)) - 1.0) < 1e-3


def test_a_listed_tile_that_is_absent_is_an_error(tmp_path: pathlib.Path, cache: DemCache) -> None:
    root = tmp_path / "archive"
    root.mkdir()
    (root / "tileList.txt").write_text(f"{NAME.removesuffix('.tif')}\n")
    with serving(root) as server, pytest.raises(ArchiveError, match="the archive lists this tile, so it is not sea"):
        fetched(server, cache)


def test_without_a_list_nobody_knows_the_sea(tmp_path: pathlib.Path, cache: DemCache) -> None:
    with serving(tmp_path) as server, pytest.raises(ArchiveError, match=r"tell the sea from a missing tile"):
        fetched(server, cache)


@pytest.mark.costly
def test_an_error_page_is_no_list(tmp_path: pathlib.Path, cache: DemCache) -> None:
    (tmp_path / "tileList.txt").write_text("<html>Please log in</html>")
    with serving(tmp_path) as server, pytest.raises(ArchiveError, match="this is not the archive's list of tiles"):
        fetched(server, cache)


@pytest.mark.costly
def test_servers_that_answer_no_head(archive: pathlib.Path, cache: DemCache) -> None:
    with serving(archive) as server:
        server.fail("HEAD", "405")
        same_heights(fetched(server, cache, mirror=mirrors(server)), by_hand(archive))
    assert ("GET", f"/{NAME.removesuffix('.tif')}/{NAME}", "bytes=0-0") in server.asked


def test_land_that_is_not_released_is_not_sea(tmp_path: pathlib.Path, cache: DemCache) -> None:
    """By GLO-90, which has it; and by what is known of GLO-30 where only that has a mirror."""
    (tmp_path / "tileList.txt").write_text("Copernicus_DSM_COG_10_N00_00_E006_00_DEM\n")
    write_tile(tmp_path, ARCHIVES["copernicus-90"], CELL, posts=300, block=256)
    with serving(tmp_path) as server:
        with pytest.raises(ArchiveError, match=r"that is land; it is not released\. Take another archive"):
            fetched(server, cache, mirror=mirrors(server, "copernicus-90"))
        with pytest.raises(ArchiveError, match="that is land"):
            fetched(server, cache, bounds=(44.5, 40.2, 44.51, 40.21))


def test_outside_an_archive_another_is_named(server: Served, cache: DemCache) -> None:
    with pytest.raises(ArchiveError, match=r"no tile USGS_13_n37w085\.tif: it covers the conterminous"):
        fetch_dem("3dep", bounds=HERE, cache=cache, mirror=server.url)
    with pytest.raises(
        ArchiveError, match=r"nobody can tell whether that is sea.* or name a mirror of copernicus-90 too"
    ):
        fetch_dem("srtm", bounds=HERE, cache=cache, mirror=server.url)
    with pytest.raises(ArchiveError, match="it covers land between 56 S and 60 N"):
        fetch_dem("srtm", bounds=(5.0, 70.0, 5.01, 70.01), cache=cache, mirror=server.url)


@pytest.mark.costly
@pytest.mark.parametrize("edge", [50, 60, 70, 80, 85])
@pytest.mark.parametrize("south", [False, True])
def test_where_the_columns_change_tiles_are_joined(
    tmp_path: pathlib.Path, cache: DemCache, edge: int, south: bool
) -> None:
    """At the parallels of 50, 60, 70, 80 and 85 degrees: a plane that continues from one tile to the other."""
    cells = [(-edge - 1, 5), (-edge, 5)] if south else [(edge - 1, 5), (edge, 5)]
    paths = write_archive(tmp_path, "copernicus", cells, posts=240, block=128, heights=plane_at)
    widths = set()
    for path in paths:
        with rasterio.open(path) as data:
            widths.add(data.width)
    assert len(widths) == 2
    lat = float(-edge if south else edge)
    with serving(tmp_path) as server:
        found = fetched(server, cache, bounds=(5.3, lat - 0.02, 5.4, lat + 0.02), vertical_datum="ellipsoid")
    assert len(found.tiles) == 2
    terrain = found.read()
    for off in (-0.01, -0.004, -0.0005, 0.0, 0.0005, 0.004, 0.01):
        place = jaxgeo.Geodetic.from_degrees(lat=lat + off, lon=5.357, height=0.0)
        assert abs(float(terrain.height_at(place)) - plane_at(np.array(5.357), np.array(lat + off))) < 1e-3


def test_sea_beside_a_tile_has_the_columns_of_its_zone() -> None:
    """Widths of GLO-30 by latitude: the table in the readme of the archive."""
    table = {0: 3600, 49: 3600, 50: 2400, 59: 2400, 60: 1800, 69: 1800, 70: 1200, 79: 1200, 80: 720, 84: 720, 85: 360}
    for lat, width in table.items():
        assert ARCHIVES["copernicus"].sea_grid((lat, 0))[0] == (3600, width)
        assert ARCHIVES["copernicus"].sea_grid((-lat - 1, 0))[0] == (3600, width)
        _, (across, _, west, _, down, north) = ARCHIVES["copernicus"].sea_grid((lat, 7))
        assert abs(west + across / 2 - 7.0) < 1e-12
        assert abs(north + down / 2 - (lat + 1)) < 1e-12


# Names


@pytest.mark.parametrize(
    "name, cell, path",
    [
        ("copernicus", (36, -85), f"{NAME.removesuffix('.tif')}/{NAME}"),
        ("copernicus", (-14, -172), "{0}/{0}.tif".format("Copernicus_DSM_COG_10_S14_00_W172_00_DEM")),
        ("copernicus-90", (0, 6), "{0}/{0}.tif".format("Copernicus_DSM_COG_30_N00_00_E006_00_DEM")),
        ("srtm", (12, 80), "N12E080.tif"),
        ("skadi", (41, -124), "N41/N41W124.hgt.gz"),
        ("3dep", (35, -119), "StagedProducts/Elevation/13/TIFF/current/n36w119/USGS_13_n36w119.tif"),
        ("https://host/a/{s}{e}_{N}.tif?key=1", (-1, 179), "s01e180_N00.tif?key=1"),
    ],
)  # fmt: skip
def test_names_of_tiles(name: str, cell: tuple[int, int], path: str) -> None:
    assert archive_of(name).path_of(cell) == path


@pytest.mark.parametrize(
    "name, reason",
    [
        ("copernicos", "no such archive; known are copernicus, copernicus-90, srtm, skadi, 3dep"),
        ("https://host/{x}{y}.tif", r"the field \{x\} is unknown"),
        ("https://host/{S}.tif", "it needs a field of latitude and one of longitude"),
        ("stac:https://host/api", "this names no STAC collection"),
        ("stac:file:///api/collections/a", "this names no STAC collection"),
        ("file:///tiles/{S}{W}.tif", "only http:// and https:// addresses are read"),
    ],
)
def test_names_that_are_refused(name: str, reason: str, cache: DemCache) -> None:
    with pytest.raises(ArchiveError, match=reason):
        fetch_dem(name, bounds=HERE, cache=cache)


@pytest.mark.parametrize(
    "how, reason",
    [
        ({}, r"say for which ground"),
        ({"bounds": (0, 10, 1, 5)}, "south below north"),
        ({"bounds": (0, 0, 20, 20)}, "400 square degrees; ask for at most 16"),
        ({"bounds": HERE, "mirror": "nowhere"}, "neither an address .* nor a folder"),
        ({"bounds": HERE, "mirror": "copernic=http://host"}, "no archive copernic; known are"),
    ],
)
def test_arguments_that_are_refused(how: dict[str, Any], reason: str, cache: DemCache) -> None:
    with pytest.raises(ArchiveError, match=reason):
        fetch_dem(cache=cache, **how)


def test_an_address_with_fields_is_an_archive(server: Served, cache: DemCache) -> None:
    found = fetch_dem(f"{server.url}/{ARCHIVES['copernicus'].pattern}", bounds=HERE, cache=cache)
    assert found.tiles == (NAME,)
    assert found.vertical_datum is None
    with pytest.raises(jaxgeo.io.VerticalDatumError, match="does not state the vertical datum"):
        found.read()
    assert found.read(vertical_datum="ellipsoid").posts.shape == (256, 256)


@pytest.mark.costly
def test_a_folder_can_be_the_mirror(archive: pathlib.Path, cache: DemCache) -> None:
    found = fetch_dem(bounds=HERE, cache=cache, mirror=f"copernicus={archive} proj={archive}", offline=False)
    same_heights(found, by_hand(archive))


@pytest.mark.costly
def test_tiles_in_gzip_are_read_as_a_whole(tmp_path: pathlib.Path, cache: DemCache) -> None:
    """SRTM's own format: 1201 x 1201 big-endian integers, rows from the north, posts on the edges of the degree."""
    lat, lon = np.linspace(37.0, 36.0, 1201), np.linspace(-85.0, -84.0, 1201)
    heights = np.rint(plane_at(*np.meshgrid(lon, lat)) - 900.0)  # whole metres
    (tmp_path / "N36").mkdir()
    (tmp_path / "N36" / "N36W085.hgt.gz").write_bytes(gzip.compress(heights.astype(">i2").tobytes()))
    with serving(tmp_path) as server:
        found = fetch_dem("skadi", bounds=HERE, cache=cache, mirror=server.url)
    assert found.vertical_datum == "EPSG:5773"
    row, col = 840, 852
    place = jaxgeo.Geodetic.from_degrees(lat=float(lat[row]), lon=float(lon[col]), height=0.0)
    expected = heights[row, col] + float(jaxgeo.io.undulation(lat[row], lon[col]))
    assert abs(float(found.read().height_at(place)) - expected) < 1e-3


@pytest.mark.costly
def test_tiles_that_overlap_are_one_terrain(tmp_path: pathlib.Path, cache: DemCache) -> None:
    """As 3DEP: NAD83, cells whose corners are on whole degrees, six more on each side."""
    posts, more = 180, 6
    for west in (-85, -84):
        place = tmp_path / ARCHIVES["3dep"].path_of((36, west))
        place.parent.mkdir(parents=True)
        affine = Affine(1 / posts, 0.0, west - more / posts, 0.0, -1 / posts, 37.0 + more / posts)
        number = np.arange(posts + 2 * more) + 0.5
        values = plane_at(*np.meshgrid(affine.c + affine.a * number, affine.f + affine.e * number)).astype(np.float32)
        write(place, values, crs="EPSG:4269", affine=affine, tiled=True, blockxsize=128, blockysize=128)
    with serving(tmp_path) as server:
        found = fetch_dem(
            "3dep", bounds=(-84.05, 36.4, -83.95, 36.5), cache=cache, mirror=server.url, vertical_datum=-30
        )
    assert len(found.tiles) == 2
    terrain = found.read()
    for lon in (-84.02, -84.001, -83.999, -83.97):
        place = jaxgeo.Geodetic.from_degrees(lat=36.4567, lon=lon, height=0.0)
        assert abs(float(terrain.height_at(place)) + 30.0 - plane_at(np.array(lon), np.array(36.4567))) < 1e-3


# The cache


def test_offline_it_says_what_is_missing_and_where_to_put_it(
    server: Served, cache: DemCache, archive: pathlib.Path
) -> None:
    with pytest.raises(ArchiveError, match="offline") as told:
        fetch_dem(bounds=HERE, cache=cache, offline=True)
    url, place = re.findall(r"download (\S+) elsewhere and put it at (\S+)\.", str(told.value))[0]
    assert url == f"https://copernicus-dem-30m.s3.amazonaws.com/{NAME.removesuffix('.tif')}/{NAME}"
    pathlib.Path(place).parent.mkdir(parents=True)
    shutil.copy(archive / NAME.removesuffix(".tif") / NAME, place)
    with pytest.raises(ArchiveError, match=r"offline, and .*us_nga_egm08_25\.tif.*jaxgeo dem --geoid EPSG:3855"):
        fetch_dem(bounds=HERE, cache=again(cache), offline=True)
    found = fetch_dem(bounds=HERE, cache=again(cache), offline=True, vertical_datum=archive / "us_nga_egm08_25.tif")
    same_heights(found, by_hand(archive))


@pytest.mark.costly
def test_a_damaged_part_is_fetched_anew(server: Served, cache: DemCache, archive: pathlib.Path) -> None:
    found = fetched(server, cache)
    content = bytearray(pathlib.Path(found.files[0]).read_bytes())
    content[-100] ^= 1
    pathlib.Path(found.files[0]).write_bytes(content)
    with pytest.raises(ArchiveError, match=f"offline, and {NAME} is not in the cache"):
        fetch_dem(bounds=HERE, cache=again(cache), offline=True)
    same_heights(fetched(server, again(cache)), by_hand(archive))


def test_a_folder_in_the_place_of_a_part_or_an_entry_is_replaced(cache: DemCache) -> None:
    digest, path = cache.put(b"a part", ".tif")
    cache.set_entry("a part of a file", {"digest": digest})
    for each in (path, *(cache.folder / "entries").iterdir()):
        each.unlink()
        each.mkdir()
        (each / "in it").write_text("something else")
    assert again(cache).object(digest, ".tif") is None
    assert again(cache).entry("a part of a file") is None
    mended = again(cache)
    assert mended.put(b"a part", ".tif") == (digest, path)
    assert path.read_bytes() == b"a part"
    mended.set_entry("a part of a file", {"digest": digest})
    assert again(cache).entry("a part of a file") == {"key": "a part of a file", "digest": digest}
    path.unlink()
    path.mkdir()
    again(cache).clear()
    assert not list((cache.folder / "objects").iterdir())


@pytest.mark.costly
def test_damaged_entries_count_as_absent(server: Served, cache: DemCache, archive: pathlib.Path) -> None:
    fetched(server, cache)
    for number, path in enumerate(sorted((cache.folder / "entries").glob("*.json"))):
        path.write_text(("{", "[]", '{"key": 1}', "")[number % 4])
    same_heights(fetched(server, again(cache)), by_hand(archive))


@pytest.mark.costly
def test_a_changed_tile_is_not_mixed_with_its_former_parts(tmp_path: pathlib.Path, cache: DemCache) -> None:
    (path,) = write_archive(tmp_path, "copernicus", [CELL])
    elsewhere = (-84.9, 36.9, -84.89, 36.91)
    with serving(tmp_path) as server:
        how = {"vertical_datum": "ellipsoid"}
        fetched(server, cache, **how)
        with rasterio.open(path, "r+") as data:
            data.write(data.read(1) + 10.0, 1)
        with pytest.raises(ArchiveError, match="has changed since other parts of it were read; run it again"):
            fetched(server, again(cache), bounds=elsewhere, **how)
        found = fetched(server, again(cache), **how)
    place = jaxgeo.Geodetic.from_degrees(lat=36.31, lon=-84.29, height=0.0)
    assert abs(float(found.read().height_at(place)) - heights_at(np.array(-84.29), np.array(36.31)) - 10.0) < 1.0


@pytest.mark.costly
def test_the_cache_is_bounded(server: Served, cache: DemCache) -> None:
    """The least recently used parts go first; what is in use stays; one run cannot need more than all."""
    found = fetched(server, cache, vertical_datum="ellipsoid")
    (first,) = map(pathlib.Path, found.files)
    size = first.stat().st_size
    other = {"bounds": (-83.5, 36.5, -83.49, 36.51), "vertical_datum": "ellipsoid"}
    fetched(server, DemCache(cache.folder, largest=int(1.5 * size)), **other)
    assert first.exists()  # used a moment ago
    before = time.time() - 3600.0
    for path in (cache.folder / "objects").iterdir():
        os.utime(path, (before + (path != first), before + (path != first)))
    third = {"bounds": (-83.1, 36.9, -83.09, 36.91), "vertical_datum": "ellipsoid"}
    bounded = DemCache(cache.folder, largest=cache.size() + 1)
    fetched(server, bounded, **third)
    assert not first.exists()
    assert bounded.size() <= bounded.largest
    with pytest.raises(ArchiveError, match=r"more than the .* MB that the cache may hold; set JAXGEO_DEM_CACHE_SIZE"):
        fetched(server, DemCache(cache.folder, largest=size // 2), vertical_datum="ellipsoid")


@pytest.mark.costly
def test_a_full_disk_is_told(server: Served, cache: DemCache) -> None:
    """A limit on the size of files stands in for it: it fails as a full disk does, in the middle of a file."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(ArchiveError, match=r"the cache cannot be written: .*; free some space, or name another"):
            fetched(server, cache)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list((cache.folder / "objects").glob("*"))
    fetched(server, again(cache))


def test_a_folder_that_cannot_be_made(server: Served, tmp_path: pathlib.Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ArchiveError, match=r"name another folder by JAXGEO_DEM_CACHE"):
        fetched(server, DemCache(tmp_path / "file" / "cache"))


def test_sizes_of_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path) -> None:
    monkeypatch.setenv("JAXGEO_DEM_CACHE", str(tmp_path))
    monkeypatch.setenv("JAXGEO_DEM_CACHE_SIZE", "3")
    assert (DemCache().folder, DemCache().largest) == (tmp_path, 3_000_000)
    monkeypatch.setenv("JAXGEO_DEM_CACHE_SIZE", "much")
    with pytest.raises(ArchiveError, match="JAXGEO_DEM_CACHE_SIZE=much: expected a number of MB"):
        DemCache()


FETCH = """
import sys
from jaxgeo.io.archives import DemCache, fetch_dem
found = fetch_dem(bounds={bounds}, mirror={mirror!r}, cache=DemCache({folder!r}), vertical_datum="ellipsoid")
print(*found.files)
"""


@pytest.mark.costly
def test_two_processes_at_once(server: Served, cache: DemCache) -> None:
    """Both fetch the same parts into one folder: each gets them whole, and they are kept once."""
    code = FETCH.format(bounds=(-84.9, 36.1, -84.1, 36.9), mirror=mirrors(server), folder=str(cache.folder))
    both = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(2)]
    files = [one.communicate()[0].split() for one in both]
    assert [one.returncode for one in both] == [0, 0]
    assert files[0] == files[1]
    assert len(files[0]) == 9
    assert {path.name for path in (cache.folder / "objects").iterdir()} == {pathlib.Path(one).name for one in files[0]}
    same = fetch_dem(bounds=HERE, cache=again(cache), offline=True, vertical_datum="ellipsoid")
    assert set(same.files) <= set(files[0])


def test_threads_share_a_cache(server: Served, cache: DemCache) -> None:
    areas = [(-84.9 + 0.2 * k, 36.2, -84.89 + 0.2 * k, 36.8) for k in range(4)]
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        tasks = [pool.submit(fetched, server, again(cache), bounds=area, vertical_datum="ellipsoid") for area in areas]
        found = [task.result() for task in tasks]
    assert all(pathlib.Path(file).is_file() for one in found for file in one.files)


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
@pytest.mark.parametrize("tag", [33550, 33922, 34735], ids=["scale", "place", "CRS"])
def test_a_tile_whose_header_is_not_read_whole_is_refused(tmp_path: pathlib.Path, cache: DemCache, tag: int) -> None:
    """GDAL warns, and goes on; nothing of it is kept."""
    write_archive(tmp_path / "served", "copernicus", [CELL], posts=64)
    write_geoid(tmp_path / "served")
    (path,) = (tmp_path / "served").rglob(NAME)
    whole = path.read_bytes()
    lose_tag(path, tag)
    with serving(tmp_path / "served") as served:
        with pytest.raises(ArchiveError, match="was not read whole: its tag Geo"):
            fetched(served, cache)
        path.write_bytes(whole)
        assert fetched(served, cache).files


# Lines of sight


class Flat:
    """Level ground that notes where it was asked for."""

    def __init__(self, height: float) -> None:
        self.height, self.farthest = height, 0.0

    def fetch(self, lon: np.ndarray, lat: np.ndarray) -> None:
        self.farthest = max(self.farthest, float(np.hypot((lon - 10.0) * np.cos(np.radians(45.0)), lat - 45.0).max()))

    def lowest(self, lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        return np.full(len(lon), self.height)


def rays_of(height: float, *depressions_deg: float) -> jaxgeo.Ray:
    place = jaxgeo.Geodetic.from_degrees(lat=45.0, lon=10.0, height=height)
    down = np.radians(np.array(depressions_deg))
    ned = np.stack([np.cos(down), np.zeros_like(down), np.sin(down)], axis=-1)
    direction = ned @ np.asarray(R_ecef_from_ned(place)).T
    return jaxgeo.Ray(np.tile(np.asarray(WGS84.to_ecef(place)), (len(down), 1)), direction)


@pytest.mark.parametrize("depression", [90.0, 45.0, 10.0, 3.0])
def test_the_ground_in_sight_is_all_that_is_fetched(depression: float) -> None:
    """Up to where a ray of 1000 m above level ground comes down, and not much farther."""
    ground, extent = Flat(500.0), Extent()
    assert follow(rays_of(1500.0, depression), ground, extent) == 0
    reach = 1000.0 / np.tan(np.radians(depression))
    metres = 111_000.0 * ground.farthest
    assert reach - 400.0 < metres < 1.1 * reach + 1500.0
    assert extent.bounds is not None
    assert extent.bounds[1] < 45.0 < extent.bounds[3]


def test_lines_of_sight_that_rise_or_look_past_the_horizon_are_cut() -> None:
    ground, extent = Flat(0.0), Extent()
    assert follow(rays_of(8000.0, 0.1, -1.0, 30.0), ground, extent) == 2
    assert ground.farthest * 111_000.0 < 1.2 * sight_module.REACH + 1000.0


def test_errors_widen_what_is_fetched() -> None:
    """Rays that look up by the error, and positions that are off by it."""
    plain, wide, beside = (Flat(500.0) for _ in range(3))
    follow(rays_of(1500.0, 10.0), plain, Extent())
    follow(rays_of(1500.0, 10.0), wide, Extent(), spread=np.radians(4.0))
    follow(rays_of(1500.0, 10.0), beside, Extent(), beside=3000.0)
    assert 111_000.0 * wide.farthest > 1000.0 / np.tan(np.radians(6.0))
    assert 111_000.0 * (beside.farthest - plain.farthest) > 2000.0


def test_nothing_is_fetched_for_what_sees_no_ground(server: Served, cache: DemCache) -> None:
    with pytest.raises(ArchiveError, match="no line of sight comes near the ground"):
        fetched(server, cache, bounds=None, rays=jaxgeo.Ray(np.array([[3e7, 0, 0]]), np.array([[1.0, 0, 0]])))
    assert not server.asked


@jax.jit
def heights_of(dem: jaxgeo.Dem, places: jaxgeo.Geodetic) -> jax.Array:
    return jax.vmap(dem.height_at)(places)


@pytest.mark.costly
@pytest.mark.parametrize("depression", [pytest.param(60.0, marks=pytest.mark.slow), 4.0])
def test_first_hits_are_those_of_the_whole_tile(
    server: Served, cache: DemCache, archive: pathlib.Path, depression: float
) -> None:
    place = jaxgeo.Geodetic.from_degrees(lat=36.3, lon=-84.6, height=1200.0)
    down = np.radians(depression)
    ned = np.array([np.cos(down) * 0.5, np.cos(down) * np.sqrt(0.75), np.sin(down)])
    ray = jaxgeo.Ray(WGS84.to_ecef(place), R_ecef_from_ned(place) @ ned)
    found = fetched(server, cache, bounds=None, rays=ray)
    assert found.cut == 0
    assert len(found.files) < 9
    hit = jaxgeo.intersect(ray, found.read())
    assert int(hit.status) == jaxgeo.Status.hit
    way = np.append(np.arange(1.0, float(hit.slant_range) - 1.0, 10.0), float(hit.slant_range))  # m
    along = np.asarray(ray.origin) + way[:, None] * np.asarray(ray.direction)
    lon, lat, height = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*along.T)
    places = jaxgeo.Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height)
    above = height - np.asarray(heights_of(by_hand(archive), places))
    assert abs(above[-1]) < 1e-6  # m
    assert np.all(above[:-1] > 0.0)


@pytest.mark.slow
def test_accuracy_over_hills_does_not_depend_on_how_far_the_model_extends(
    server: Served, cache: DemCache, archive: pathlib.Path
) -> None:
    """CE90 at a low angle over ground that is no plane: of what its line of sight needs, and of more of the tile, in
    arrays of one size."""
    observed = jaxgeo.io.read_observations(scene=scene_file(), pixels=[(1200.0, 2400.0)])
    observation, errors = observed.at(0)
    found = fetched(server, cache, bounds=None, rays=view_of(observed))
    assert found.read().posts.shape == (256, 256)
    mine, whole = (
        jaxgeo.accuracy(observation, terrain, ErrorModel(errors), sampling=None)
        for terrain in (found.read(), by_hand(archive, bounds=(-84.305, 36.16, -84.10, 36.36)))
    )
    assert abs(float(whole.circular) / float(whole.diagnostics.facet) - 1.0) > 1e-3  # not that of a plane
    for name in ("circular", "linear", "spherical"):
        assert abs(float(getattr(mine, name)) - float(getattr(whole, name))) < 1e-6  # m


@pytest.mark.costly
def test_across_the_date_line(tmp_path: pathlib.Path, cache: DemCache) -> None:
    write_archive(tmp_path, "copernicus", [(10, 179), (10, -180)], posts=240, block=128, heights=plane_at)
    with serving(tmp_path) as server:
        found = fetched(server, cache, bounds=(179.97, 10.5, -179.97, 10.52), vertical_datum="ellipsoid")
    assert len(found.tiles) == 2
    terrain = found.read()
    for lon in (179.98, 179.999, -179.98):
        place = jaxgeo.Geodetic.from_degrees(lat=10.51, lon=lon, height=0.0)
        assert abs(float(terrain.height_at(place)) - plane_at(np.array(lon), np.array(10.51))) < 1e-3


# Writing, and geoid grids


@pytest.mark.costly
def test_a_written_model_has_the_same_heights(server: Served, cache: DemCache, tmp_path: pathlib.Path) -> None:
    found = fetched(server, cache)
    write_dem(tmp_path / "ground.tif", found)
    written, whole = jaxgeo.io.read_dem(tmp_path / "ground.tif"), found.read()
    for lon, lat in ((-84.291, 36.307), (-84.2855, 36.3131)):
        place = jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
        assert abs(float(written.height_at(place)) - float(whole.height_at(place))) < 1e-6
    with pytest.raises(ArchiveError, match=r"is written as a GeoTIFF; use \.tif"):
        write_dem(tmp_path / "ground.png", found)


def test_a_window_of_the_geoid_is_that_of_the_whole_grid(
    server: Served, cache: DemCache, archive: pathlib.Path
) -> None:
    found = fetched(server, cache)
    assert isinstance(found.vertical_datum, pathlib.Path)
    rng = np.random.default_rng(2)
    lon, lat = rng.uniform(HERE[0], HERE[2], 20), rng.uniform(HERE[1], HERE[3], 20)
    whole = jaxgeo.io.undulation(lat, lon, archive / "us_nga_egm08_25.tif")
    np.testing.assert_allclose(jaxgeo.io.undulation(lat, lon, found.vertical_datum), whole, atol=1e-9)
    assert found.vertical_datum.stat().st_size < 0.05 * (archive / "us_nga_egm08_25.tif").stat().st_size


@pytest.mark.costly
def test_outside_a_geoid_grid_another_datum_is_asked_for(
    server: Served, cache: DemCache, tmp_path: pathlib.Path
) -> None:
    """NAVD88's grid of the conterminous United States, and a tile of Alaska."""
    write_tile(tmp_path, ARCHIVES["3dep"], (64, -150), posts=60, block=64)
    write(tmp_path / "us_noaa_g2018u0.tif", np.zeros((40, 60), np.float32), affine=Affine(1, 0, -130, 0, -1, 58))
    with serving(tmp_path) as near, pytest.raises(ArchiveError, match=r"the grid does not reach there\. .*another"):
        fetch_dem("3dep", bounds=(-149.6, 64.4, -149.5, 64.5), cache=cache, mirror=f"3dep={near.url} proj={near.url}")


@pytest.mark.costly
@pytest.mark.parametrize("fault", ["wrong checksum", "cut", "absent", "no list"])
def test_a_geoid_grid_is_verified(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    folder = tmp_path / "proj"
    folder.mkdir()
    monkeypatch.setattr("jaxgeo.io.archives.geoid_window.get_user_data_dir", lambda create=False: str(folder))
    monkeypatch.setattr("jaxgeo.io.archives.geoid_window.append_data_dir", lambda path: None)
    grid = write_geoid(tmp_path)
    reason = {
        "wrong checksum": "its SHA-256 is not the one", "cut": "the connection was cut",
        "absent": "there is no such file", "no list": "this is not PROJ's list of grids",
    }[fault]  # fmt: skip
    with serving(tmp_path) as server:
        assert jaxgeo.io.fetch_geoid(mirror=f"proj={server.url}") == [folder / grid.name]
        assert (folder / grid.name).read_bytes() == grid.read_bytes()
        (folder / grid.name).unlink()
        if fault == "wrong checksum":
            grid.write_bytes(grid.read_bytes() + b"\0")
        elif fault == "cut":
            server.fail(grid.name, "cut")
        elif fault == "absent":
            grid.unlink()
        else:
            (tmp_path / "files.geojson").write_text("{")
        with pytest.raises(ArchiveError, match=reason):
            jaxgeo.io.fetch_geoid(mirror=f"proj={server.url}")
    assert not list(folder.iterdir())


def test_datums_of_geoids_that_are_refused() -> None:
    for datum, reason in (("EPSG:4326", "is no vertical datum"), ("EPSG:0", "PROJ does not know this datum")):
        with pytest.raises(ArchiveError, match=reason):
            jaxgeo.io.fetch_geoid(datum)
    assert jaxgeo.io.fetch_geoid("EPSG:5773") == []  # comes with the package
