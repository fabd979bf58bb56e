"""A server of archive files on the loopback, with range requests, counters and faults; and the files that it serves."""

from __future__ import annotations

import contextlib
import dataclasses
import email.utils
import hashlib
import http.server
import json
import pathlib
import re
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import rasterio
from rasterio.transform import Affine

import jaxgeo.io
from jaxgeo.io.archives import ARCHIVES, Archive
from jaxgeo.io.archives.catalogue import Cell

DATA = pathlib.Path(jaxgeo.io._proj.DATA)
POSTS = 1200  # per degree of the served tiles
BLOCK = 512


@dataclasses.dataclass
class Served:
    """What a server was asked for, and how it fails: faults by a part of the path, each for `times` requests."""

    root: pathlib.Path
    url: str = ""
    asked: list[tuple[str, str, str]] = dataclasses.field(default_factory=list)
    """(method, path, range) of each request."""
    sent: int = 0
    faults: dict[str, list[object]] = dataclasses.field(default_factory=dict)

    def fail(self, part: str, how: str, times: int = 10**6) -> None:
        """Fail requests for paths with `part`: "cut", "damage", "slow" or an HTTP status."""
        self.faults[part] = [how, times]

    def fault(self, path: str) -> str | None:
        """The fault of a request, counted."""
        for part, fault in self.faults.items():
            how, times = fault
            if part in path and int(str(times)) > 0:
                fault[1] = int(str(times)) - 1
                return str(how)
        return None


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    served: Served

    def log_message(self, format: str, *args: object) -> None:
        pass

    def do_HEAD(self) -> None:
        self._answer(is_head=True)

    def do_GET(self) -> None:
        self._answer(is_head=False)

    def do_POST(self) -> None:  # a search, whose answer is a file
        self.rfile.read(int(self.headers.get("Content-Length", "0")))
        self._answer(is_head=False)

    def _answer(self, *, is_head: bool) -> None:
        served, span = self.served, self.headers.get("Range", "")
        served.asked.append((self.command, self.path, span))
        file = served.root / self.path.split("?")[0].lstrip("/")
        fault = served.fault(f"{self.command} {self.path}")
        if fault == "slow":
            time.sleep(2.5)
        if fault is not None and fault.isdigit():
            self._refuse(int(fault))
            return
        if not file.is_file():
            self._refuse(404)
            return
        content = file.read_bytes()
        found = re.fullmatch(r"bytes=(\d+)-(\d*)", span)
        first, last = (int(found[1]), int(found[2] or len(content) - 1)) if found else (0, len(content) - 1)
        if found and first >= len(content):
            self._refuse(416)
            return
        body = content[first : last + 1]
        self.send_response(206 if found else 200)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("ETag", f'"{hashlib.md5(content).hexdigest()}"')
        self.send_header("Last-Modified", email.utils.formatdate(file.stat().st_mtime, usegmt=True))
        if found:
            self.send_header("Content-Range", f"bytes {first}-{first + len(body) - 1}/{len(content)}")
        self.end_headers()
        if is_head:
            return
        if fault == "damage":  # behind the header of the file
            body = bytes(byte ^ 0x5A if first + i > 4096 else byte for i, byte in enumerate(body))
        if fault == "cut":
            body = body[: len(body) // 2]
        served.sent += len(body)
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.wfile.write(body)
        if fault == "cut":
            self.close_connection = True

    def _refuse(self, code: int) -> None:
        self.send_response(code)
        self.send_header("Content-Length", "0")
        self.end_headers()


@contextlib.contextmanager
def serving(root: pathlib.Path) -> Iterator[Served]:
    """A server of the files below a folder."""
    served = Served(root)
    handler = type("Handler", (_Handler,), {"served": served})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    served.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)  # s between looks for its end
    thread.start()
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()


def heights_at(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """Smooth hills anywhere, m: between 200 and 800 m."""
    return (
        500.0 + 120.0 * np.sin(lon * 90.0) * np.cos(lat * 70.0) + 100.0 * np.sin(lon * 33.0 + lat * 51.0)
        + 60.0 * np.cos(lat * 210.0 - lon * 160.0)
    )  # fmt: skip


def plane_at(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """A plane on the map, m, which interpolation between posts reproduces; without a step at 180 degrees."""
    return 700.0 + 3.0 * np.remainder(lon, 360.0) - 4.0 * lat


def write_tile(
    root: pathlib.Path,
    archive: Archive,
    cell: Cell,
    *,
    posts: int = POSTS,
    block: int = BLOCK,
    heights: Callable[[np.ndarray, np.ndarray], np.ndarray] = heights_at,
) -> pathlib.Path:
    """A tile of an archive at its place below a folder: tiled, compressed, posts at whole degrees in the first row and
    column, the last ones left out, as in Copernicus DEM on AWS."""
    made = dataclasses.replace(archive, per_degree=posts, shared_edges=False)
    shape, transform = made.sea_grid(cell)
    a, _, c, _, e, f = transform
    lon, lat = c + a * (np.arange(shape[1]) + 0.5), f + e * (np.arange(shape[0]) + 0.5)
    values = heights(*np.meshgrid(lon, lat)).astype(np.float32)
    path = root / archive.path_of(cell)
    path.parent.mkdir(parents=True, exist_ok=True)
    profile = {
        "driver": "GTiff", "dtype": "float32", "count": 1, "height": shape[0], "width": shape[1], "crs": "EPSG:4326",
        "transform": Affine(*transform), "tiled": True, "blockxsize": block, "blockysize": block,
        "compress": "deflate", "predictor": 3, "zlevel": 1,
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as sink:
        sink.update_tags(AREA_OR_POINT="Point")
        sink.write(values, 1)
    return path


def write_archive(root: pathlib.Path, name: str, cells: list[Cell], **made: Any) -> list[pathlib.Path]:
    """Tiles of an archive and the list of them; options of `write_tile`."""
    archive = ARCHIVES[name]
    paths = [write_tile(root, archive, cell, **made) for cell in cells]
    if archive.listing is not None:
        (root / archive.listing).write_text("".join(f"{path.stem}\n" for path in paths))
    return paths


def write_geoid(root: pathlib.Path, name: str = "us_nga_egm08_25.tif") -> pathlib.Path:
    """A global geoid grid of that name, as PROJ publishes them: the packaged EGM96, 1 m higher."""
    with rasterio.open(DATA / "us_nga_egm96_15.tif") as data:
        values, profile = data.read(1) + 1.0, dict(data.profile)
        tags, description = data.tags(), data.descriptions[0]
    profile |= {"driver": "GTiff", "compress": "deflate", "tiled": True, "blockxsize": 256, "blockysize": 256}
    path = root / name
    with rasterio.open(path, "w", **profile) as sink:
        sink.update_tags(**tags)
        sink.set_band_description(1, description or "geoid_undulation")
        sink.write(values.astype(profile["dtype"]), 1)
    listed = {"name": name, "sha256sum": hashlib.sha256(path.read_bytes()).hexdigest()}
    (root / "files.geojson").write_text(json.dumps({"features": [{"properties": listed}]}))
    return path


@contextlib.contextmanager
def mirrored(folder: pathlib.Path, setenv: Callable[[str, str], object]) -> Iterator[Served]:
    """A server with the tile of Copernicus DEM of the examples and the geoid grid, which the environment names as
    mirrors; and an empty cache."""
    write_archive(folder, "copernicus", [(36, -85)])
    write_geoid(folder)
    with serving(folder) as served:
        setenv("JAXGEO_DEM_MIRROR", f"copernicus={served.url} proj={served.url}")
        setenv("JAXGEO_DEM_CACHE", str(folder / "cache"))
        yield served
