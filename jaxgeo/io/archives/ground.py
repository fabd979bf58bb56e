"""Ground of an archive: parts of its tiles, fetched where they are asked for, and decisions on absent tiles."""

from __future__ import annotations

import concurrent.futures
import contextlib
import math
import pathlib
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgeo.io.archives.catalogue import ARCHIVES, STAC, Archive, Cell, joined, names_of
from jaxgeo.io.archives.errors import ArchiveError, MissingGrid, NotAtHand, Unreachable
from jaxgeo.io.archives.geoid_window import OFFLINE
from jaxgeo.io.archives.parts import (
    ENDING,
    Part,
    Place,
    TileHeader,
    as_file,
    file_name,
    header_of,
    lowest_of,
    read_part,
    sea_file,
)
from jaxgeo.io.archives.stac import tiles_of
from jaxgeo.io.archives.store import DemCache
from jaxgeo.io.archives.web import Web
from jaxgeo.io.geoid import undulation
from jaxgeo.io.reach import is_remote
from jaxgeo.io.windows import Bounds

AT_ONCE = 4  # tiles read at the same time
LATTICE = 0.02  # deg between the positions at which an area is looked at
FILL = 6  # parts: rectangles of up to so many are filled
GEOID_SLACK = 20.0  # m between geoid models
ANY_SLACK = 130.0  # m between heights of an unknown datum and ellipsoidal ones
FOOT = 0.3048  # m: heights of an unknown unit are at least this
UNRELEASED = ((38, 42), (43, 51))  # latitudes and longitudes of the land that GLO-30 lacks (readme of its archive)


class ArchiveGround:
    """Parts of tiles, fetched where ground is asked for."""

    def __init__(self, archive: Archive, cache: DemCache, web: Web, offline: bool, mirrors: dict[str, str]) -> None:
        self.archive, self.cache, self.web, self.offline, self.mirrors = archive, cache, web, offline, mirrors
        self.parts: dict[tuple[str, Place], Part] = {}
        self.gaps: set[str] = set()
        self._headers: dict[Cell, list[TileHeader]] = {}
        self._sources: dict[str, str] = {}

    def fetch(self, lon: np.ndarray, lat: np.ndarray) -> None:
        """Fetch the parts with positions (n,) in deg. Raises `ArchiveError`."""
        self._fetch(self._needed(lon, lat))

    def fill(self, edges: Bounds) -> None:
        """Fetch all parts of a rectangle, if they are few."""
        west, south, east, north = edges
        if (east - west) % 360.0 > 3.0 or north - south > 3.0:
            return
        lon, lat = positions(edges)
        if any(cell not in self._headers for cell, _ in _by_cell(lon, lat)):
            return
        wanted = self._needed(lon, lat)
        if sum(len(places) for places in wanted.values()) <= FILL:
            with contextlib.suppress(ArchiveError):  # no line of sight needs them
                self._fetch(wanted)

    def lowest(self, lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        """As `Ground.lowest`."""
        found = np.full(len(lon), -np.inf)
        for cell, index in _by_cell(lon, lat):
            for header in self._headers.get(cell, []):
                row, col, inside = header.parts_at(lon[index], lat[index])
                for place in {(int(r), int(c)) for r, c in zip(row[inside], col[inside], strict=True)}:
                    part = self.parts.get((header.url, place))
                    if part is not None:
                        here = index[inside & (row == place[0]) & (col == place[1])]
                        found[here] = part.lowest_around(*header.squares_at(place, lon[here], lat[here]))
        return self._ellipsoidal(lon, lat, found)

    def told(self, ask: Callable[[Web | None], Any], advice: str) -> Any:
        """A result that may need the network; failures with advice."""
        try:
            return ask(None if self.offline else self.web)
        except Unreachable as error:
            raise Unreachable(f"{error}. {self._ways()} {advice}") from error
        except MissingGrid as error:
            why = "offline, and " if self.offline else ""
            raise NotAtHand(f"{self.archive.name}: {why}{error}. {advice}") from error

    def _ellipsoidal(self, lon: np.ndarray, lat: np.ndarray, low: np.ndarray) -> np.ndarray:
        if self.archive.datum is None:
            return np.minimum(low, FOOT * low) - ANY_SLACK
        return low + undulation(lat, lon) - GEOID_SLACK

    def _needed(self, lon: np.ndarray, lat: np.ndarray) -> dict[TileHeader, list[Place]]:
        wanted: dict[TileHeader, list[Place]] = {}
        for cell, index in _by_cell(lon, lat):
            for header in self._of_cell(cell):
                row, col, inside = header.parts_at(lon[index], lat[index])
                places = {(int(r), int(c)) for r, c in zip(row[inside], col[inside], strict=True)}
                missing = [place for place in sorted(places) if (header.url, place) not in self.parts]
                if missing:
                    wanted[header] = missing
        return wanted

    def _fetch(self, wanted: dict[TileHeader, list[Place]]) -> None:
        if len(wanted) == 1:
            ((header, places),) = wanted.items()
            self._fetch_parts(header, places)
            return
        with concurrent.futures.ThreadPoolExecutor(AT_ONCE) as pool:
            tasks = [pool.submit(self._fetch_parts, header, places) for header, places in wanted.items()]
            is_done = False
            try:
                for task in tasks:
                    task.result()
                is_done = True
            finally:
                if not is_done:
                    pool.shutdown(wait=False, cancel_futures=True)

    def _fetch_parts(self, header: TileHeader, places: list[Place]) -> None:
        unknown = []
        for place in places:
            part = self._cached(header, place)
            if part is None and header.sea:
                window = header.window(place)
                zero = np.zeros((int(window.height), int(window.width)), np.float32)
                part = self._keep(header, place, sea_file(header, window), lowest_of(zero, None))
            if part is None:
                unknown.append(place)
            else:
                self.parts[header.url, place] = part
        if not unknown:
            return
        if self.offline and is_remote(self._source(header)):
            raise NotAtHand(self._missing_offline(file_name(header.url), header.url))
        self._reached(header.url, lambda: self.web.retried(lambda: self._read(header, unknown)))

    def _read(self, header: TileHeader, places: list[Place]) -> None:
        source = self._source(header)
        found = self.web.look(source)
        if found is None or found.version != header.version:
            self.cache.forget(_tile_key(header.url))
            raise ArchiveError(
                f"{source}: the file has changed since other parts of it were read; run it again, which reads all anew."
            )
        with self.web.raster(source) as data:
            for place in places:
                if (header.url, place) in self.parts:  # from a try before
                    continue
                window = header.window(place)
                values = read_part(data, window)
                file = as_file(data, window, values)
                lowest = lowest_of(values, data.nodata) * data.scales[0] + data.offsets[0]
                self.parts[header.url, place] = self._keep(header, place, file, lowest)

    def _keep(self, header: TileHeader, place: Place, file: bytes, lowest: np.ndarray) -> Part:
        digest, path = self.cache.put(file, ENDING)
        content = [[None if math.isnan(low) else float(low) for low in row] for row in lowest]
        self.cache.set_entry(_part_key(header, place), {"digest": digest, "size": len(file), "lowest": content})
        return Part(str(path), digest, len(file), lowest, header.sea)

    def _cached(self, header: TileHeader, place: Place) -> Part | None:
        entry = self.cache.entry(_part_key(header, place))
        if entry is None:
            return None
        try:
            digest, size = str(entry["digest"]), int(entry["size"])
            lowest = np.array([[np.nan if low is None else low for low in row] for row in entry["lowest"]], np.float64)
        except (KeyError, TypeError, ValueError):
            return None
        path = self.cache.object(digest, ENDING)
        return None if path is None else Part(str(path), digest, size, lowest, header.sea, was_cached=True)

    def _of_cell(self, cell: Cell) -> list[TileHeader]:
        """Headers of the tiles of a cell."""
        if cell not in self._headers:
            self._headers[cell] = self._found(cell)
        return self._headers[cell]

    def _found(self, cell: Cell) -> list[TileHeader]:
        if self.archive.name.startswith(STAC):
            headers = [self._header(url, url, None) for url in self._searched(cell)]
            found = [one for one in headers if one is not None]
            if not found:
                self.gaps.add(self._shown(cell))
            return found
        low, high = self.archive.latitudes
        url = self.archive.url_of(cell)
        header = None
        if low <= cell[0] < high:
            given = self._given(url)
            header = self._header(url, str(given), None) if given.is_file() else self._header(url, self._at(cell), cell)
        if header is None:
            self.gaps.add(file_name(url))
            return []
        return [header]

    def _header(self, url: str, source: str, cell: Cell | None) -> TileHeader | None:
        """The header of a tile; None if the archive lacks it, unless it is sea then."""
        self._sources[url] = source
        entry = self.cache.entry(_tile_key(url))
        if entry is not None and entry.get("absent"):
            return None
        known = None if entry is None else TileHeader.from_dict(entry)
        if known is not None and (is_remote(source) or known.version == self._version(source)):
            return known
        if self.offline and is_remote(source):
            raise NotAtHand(self._missing_offline(file_name(url), url))

        def look() -> TileHeader | None:
            found = self.web.look(source)
            if found is None:
                return None
            with self.web.raster(source) as data:
                return header_of(url, data, found.version)

        header = self._reached(url, lambda: self.web.retried(look))
        if header is None and cell is not None and self._is_sea(cell, url):
            shape, affine = self.archive.sea_grid(cell)
            header = TileHeader(url, shape, affine, "EPSG:4326", (shape[0], shape[1]), "sea", sea=True)
        self.cache.set_entry(_tile_key(url), {"absent": True} if header is None else header.to_dict())
        return header

    def _version(self, path: str) -> str:
        found = self.web.look(path)
        return "" if found is None else found.version

    def _is_sea(self, cell: Cell, url: str) -> bool:
        """Whether an absent tile is sea. Raises `ArchiveError` if it should exist, or if that cannot be known."""
        if self.archive.missing != "sea":
            return False
        name = file_name(url)
        if self.archive.listing is not None:
            where = joined(self._base(self.archive), self.archive.listing)
            content = self._reached(where, lambda: self.web.get(where))
            if content is None:
                raise ArchiveError(
                    f"{where}: there is no such file, and without it nobody can tell the sea from a missing tile "
                    f"({name}). Copy the file from {joined(self.archive.base, self.archive.listing)}, or the tile."
                )
            if self.archive.pattern.partition("{")[0].encode() not in content:
                raise ArchiveError(f"{where}: this is not the archive's list of tiles; name another mirror=.")
            if name.rpartition(".")[0].encode() in content:
                raise ArchiveError(
                    f"{self._at(cell)}: the archive lists this tile, so it is not sea, but the server has none. Try "
                    f"again later, name another mirror=, or put the tile at {self._given(url)}."
                )
        twin = None if self.archive.twin is None else ARCHIVES[self.archive.twin]
        can_ask = twin is not None and (not self.mirrors or twin.name in self.mirrors)
        is_land = False
        if twin is not None and can_ask:
            other = joined(self._base(twin), twin.path_of(cell))
            is_land = self._reached(other, lambda: self.web.look(other)) is not None
        elif self.archive.listing is None:
            raise ArchiveError(
                f"{self._at(cell)}: there is no such tile, and nobody can tell whether that is sea. Put the tile there "
                f"or at {self._given(url)}, or name a mirror of {twin.name if twin else 'another archive'} too."
            )
        else:
            is_land = all(low <= edge < high for edge, (low, high) in zip(cell, UNRELEASED, strict=True))
        if is_land:
            raise ArchiveError(
                f"{self.archive.name}: the archive has no tile {name}, but that is land; it is not released. Take "
                f"another archive, such as copernicus-90."
            )
        return True

    def _searched(self, cell: Cell) -> list[str]:
        """Addresses that a STAC search finds for a cell."""
        key = f"search {self.archive.name} {cell}"
        entry = self.cache.entry(key)
        if entry is not None and isinstance(entry.get("urls"), list):
            return entry["urls"]
        if self.offline:
            raise ArchiveError(
                f"{self.archive.name}: offline, and nobody searched for the tiles of {self._shown(cell)} yet. "
                f"Go online once, or take the files themselves."
            )
        urls = self._reached("", lambda: tiles_of(self.archive, cell, self.web))
        self.cache.set_entry(key, {"urls": urls})
        return urls

    def _reached(self, url: str, ask: Callable[[], Any]) -> Any:
        """A result of the network; a failure with what to do."""
        try:
            return ask()
        except Unreachable as error:
            put = f", or download it elsewhere and put it at {self._given(url)}" if self._can_be_given(url) else ""
            raise Unreachable(f"{error}. {self._ways()[:-1]}{put}.") from error

    def _ways(self) -> str:
        return "Try again, name a proxy= or a mirror=."

    def _missing_offline(self, name: str, url: str) -> str:
        put = f", or download {url} elsewhere and put it at {self._given(url)}" if self._can_be_given(url) else ""
        return (
            f"{self.archive.name}: offline, and {name} is not in the cache {self.cache.folder}, or not the part that "
            f"is needed. Go online once (without offline=True or {OFFLINE}){put}."
        )

    def _can_be_given(self, url: str) -> bool:
        return bool(url) and not self.archive.name.startswith(STAC) and url.startswith(self.archive.base)

    def _given(self, url: str) -> pathlib.Path:
        name = self.archive.name if self.archive.name in ARCHIVES else re.sub(r"\W+", "-", self.archive.base)
        return self.cache.given(name, file_name(url))

    def _shown(self, cell: Cell) -> str:
        return "{S}{W}".format(**names_of(cell))

    def _source(self, header: TileHeader) -> str:
        return self._sources.get(header.url, header.url)

    def _base(self, archive: Archive) -> str:
        return self.mirrors.get(archive.name, archive.base)

    def _at(self, cell: Cell) -> str:
        return joined(self._base(self.archive), self.archive.path_of(cell))


def _tile_key(url: str) -> str:
    return f"tile {url}"


def _part_key(header: TileHeader, place: Place) -> str:
    return f"part {header.url} {header.version} {place[0]},{place[1]}"


def _by_cell(lon: np.ndarray, lat: np.ndarray) -> list[tuple[Cell, np.ndarray]]:
    """The positions of each cell of a degree."""
    lon = np.remainder(lon + 180.0, 360.0) - 180.0
    south, west = (np.floor(one).astype(int) for one in (np.clip(lat, -90.0, 89.999999), lon))
    keys = south * 1000 + west
    return [
        ((int(south[index[0]]), int(west[index[0]])), index)
        for index in (np.flatnonzero(keys == key) for key in np.unique(keys))
    ]


def positions(bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes of a lattice over an area."""
    west, south, east, north = bounds
    east = east if east > west else east + 360.0
    lon, lat = (np.linspace(a, b, math.ceil((b - a) / LATTICE) + 2) for a, b in ((west, east), (south, north)))
    lons, lats = (one.ravel() for one in np.meshgrid(lon, lat))
    return np.remainder(lons + 180.0, 360.0) - 180.0, lats
