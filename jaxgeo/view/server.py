"""The viewer's HTTP server: on the loopback address only, for reading only."""

from __future__ import annotations

import http.server
import pathlib
import sys
import threading
import time
import traceback
import urllib.parse
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxgeo.io.observations import Observations
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.view.data import ViewData
from jaxgeo.view.images import Pictures, images_of
from jaxgeo.view.site import Answer, Site, check_tiles, tile_origin

LOOPBACK = "127.0.0.1"
HOSTS = {LOOPBACK, "localhost"}  # names by which the server may be addressed
LONGEST = 4096  # characters of a path with its query
LINGER = 2.0  # s for which an open page can still ask why the command ended


class NoGround(ValueError):
    """No image sees the ground."""


class ViewServer:
    """A viewer's server, started at once on a free port or on `port`; `show` gives it data, `close` ends it.

    Only programs on this machine can reach it, and only by the name of this machine: a request whose Host is another
    name, as of a web page that has made its name point here, is refused. There is nothing to change by a request.
    `tiles` is the address of web-map tiles, `https://host/{z}/{x}/{y}.png`, that the browser asks for; by default
    none, and the browser asks no other machine for anything. Raises `OSError` if the port is taken, `ValueError` for
    an address without {z}, {x} and {y}.

    >>> from jaxgeo.view import ViewServer
    >>> with ViewServer(title="Flight 7") as viewer:
    ...     print(viewer.address.rpartition(":")[0])
    http://127.0.0.1
    """

    def __init__(self, *, port: int = 0, title: str = "jaxgeo", tiles: str | None = None) -> None:
        self.site = Site(title=title, tiles=None if tiles is None else check_tiles(tiles))
        self._server = _Server((LOOPBACK, port), _Handler)
        self._server.site = self.site
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{LOOPBACK}:{self._server.server_port}/"

    def show_images(
        self, observed: Observations, files: Sequence[pathlib.Path | None] = (), *, marks: bool = False
    ) -> None:
        """Show the images, before their ground is read; with `marks` also the pixels of the observations."""
        images, self.site.has_marks = images_of(observed), marks
        self.site.pictures = Pictures(images, files or [None] * len(images))
        self.site.images = images

    def show(self, data: ViewData, *, notes: Sequence[str] = ()) -> None:
        """Show images on their ground, and compile what answers need, which may take a minute the first time.

        `notes` are sentences shown on the page, such as assumptions. Raises `NoGround` if no image sees the ground.
        """
        site = self.site
        site.doing = "locating the edges of the images"
        site.images, site.pictures, site.notes = data.images, data.pictures, [*notes]
        outlines = data.outlines()
        if not any(np.isfinite(one).all(axis=1).any() for one in outlines):
            first = data.images[0]
            middle = data.locate(0, 0.5 * (first.width - 1), 0.5 * (first.height - 1), accuracy=False)
            raise NoGround(f"no image sees the ground. {first.name}, its middle: {middle['status_text']}")
        site.doing = "drawing the relief"
        box = data.box(outlines)
        relief = data.relief(box)
        site.between = None if relief is None else relief[2]
        site.data, site.outlines, site.box = data, outlines, box
        site.doing = "compiling"
        site.ready.set()
        data.warm_up()
        site.is_warm, site.doing = True, ""

    def fail(self, message: str) -> None:
        """Tell an open page why the viewer ends."""
        self.site.error, self.site.doing = message, ""
        if time.monotonic() - self.site.polled < LINGER:
            time.sleep(LINGER)

    def close(self) -> None:
        """Stop answering."""
        self.site.ready.set()
        self._server.shutdown()
        self._server.server_close()

    def __enter__(self) -> ViewServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def serve(
    observed: Observations,
    grounds: AbstractTerrain | Sequence[AbstractTerrain],
    files: Sequence[pathlib.Path | None] = (),
    *,
    port: int = 0,
    probability: float = 0.9,
    accuracy: bool | None = None,
    title: str = "jaxgeo",
    tiles: str | None = None,
) -> ViewServer:
    """A started viewer of observations on their ground; open its `address` in a browser, end it with `close`.

    `grounds` is one terrain for all, or one for each batch; `files` has the image file of each image, in the order of
    `images_of(observed)`. `accuracy`, by default whether the observations have error sources. Raises as `ViewServer`,
    and `NoGround`, a `ValueError`, if no image sees the ground.
    """
    each = [grounds] * len(observed.batches) if isinstance(grounds, AbstractTerrain) else list(grounds)
    has_errors = all(batch.sources for batch in observed.batches) if accuracy is None else accuracy
    paths = [None if one is None else pathlib.Path(one) for one in files]
    viewer = ViewServer(port=port, title=title, tiles=tiles)
    try:
        viewer.show(ViewData(observed, each, paths, probability, has_errors))
    except BaseException:
        viewer.close()
        raise
    return viewer


class _Server(http.server.ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = sys.platform != "win32"  # there it would let two servers share a port
    site: Site

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of pages that were closed before their answer came."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class _Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "jaxgeo", ""
    timeout = 60.0

    def do_GET(self) -> None:
        self._respond(is_head=False)

    def do_HEAD(self) -> None:
        self._respond(is_head=True)

    def _refuse_method(self) -> None:
        self.close_connection = True  # its body is not read
        self._send(Answer(405, "text/plain", b"Only GET: nothing can be changed here."), False)

    do_POST = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = _refuse_method

    def _respond(self, is_head: bool) -> None:
        site = self.server.site  # pyright: ignore[reportAttributeAccessIssue]
        reason = self._refusal()
        if reason:
            self.close_connection = True
            self._send(Answer(403, "text/plain", reason.encode()), is_head)
            return
        parts = urllib.parse.urlsplit(self.path)
        if parts.path == "/api/state":
            site.polled = time.monotonic()
        try:
            answer = site.answer(parts.path, dict(urllib.parse.parse_qsl(parts.query)))
        except Exception:
            traceback.print_exc()
            answer = Answer(500, "application/json", b'{"error":"internal error; the terminal shows the traceback"}')
        self._send(answer, is_head)

    def _refusal(self) -> str:
        """Why a request is refused: of another name, or of a page of another site."""
        hosts = self.headers.get_all("Host") or []
        if len(hosts) != 1 or hosts[0].rpartition(":")[0].lower() not in HOSTS:
            return "This server answers requests to this machine's loopback address only."
        is_page = urllib.parse.urlsplit(self.path).path == "/"  # which a link elsewhere may open
        if not is_page and self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            return "This server answers its own page only."
        return "The address is too long." if len(self.path) > LONGEST else ""

    def _send(self, answer: Answer, is_head: bool) -> None:
        tiles = self.server.site.tiles  # pyright: ignore[reportAttributeAccessIssue]
        pictures = "'self' data: blob:" + (f" {tile_origin(tiles)}" if tiles else "")
        self.send_response(answer.status)
        self.send_header("Content-Type", answer.kind)
        self.send_header("Content-Length", str(len(answer.content)))
        self.send_header("Cache-Control", "private, max-age=3600" if answer.may_keep else "no-store")
        self.send_header(
            "Content-Security-Policy",
            f"default-src 'none'; script-src 'self'; style-src 'self'; img-src {pictures}; connect-src 'self'; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        )
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Referrer-Policy", "no-referrer" if tiles is None else "strict-origin-when-cross-origin")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        if not is_head:
            self.wfile.write(answer.content)

    def log_message(self, format: str, *args: Any) -> None:
        """No log of requests."""
