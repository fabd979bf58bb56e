"""Access to files of archives: small ones by HTTP, rasters by range requests of GDAL, or in a local folder."""

from __future__ import annotations

import contextlib
import dataclasses
import http.client
import math
import os
import threading
import time
import urllib.error
import urllib.request
import weakref
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from rasterio.io import DatasetReader

from jaxgeo.io._gdal import GDAL_ERRORS, header_losses, options
from jaxgeo.io.archives.errors import ArchiveError, Unreachable
from jaxgeo.io.reach import is_remote

T = TypeVar("T")
TIMEOUT = "JAXGEO_HTTP_TIMEOUT"  # environment variable: s without an answer, after which a server is given up
USUAL_TIMEOUT = 20.0
TRIES = 3
PAUSE = 0.5  # s before the second try, doubled for each further one
AGENT = "jaxgeo"
AGAIN = (429, 500, 502, 503, 504)  # HTTP answers after which it is tried again
ABSENT = (404, 410)
NO_HEAD = (403, 405, 501)  # answers of servers that give headers only with content
PIECE = 1 << 16
LARGEST = 500_000_000  # bytes of a file read as a whole
DRIVERS = ["GTiff", "SRTMHGT"]
_guard = threading.Lock()
_locks: weakref.WeakValueDictionary[str, Any] = weakref.WeakValueDictionary()


@dataclasses.dataclass(frozen=True)
class Remote:
    """What a server says of a file: its size in bytes, and a mark that changes with its content; both may be
    unknown."""

    size: int | None
    version: str


@dataclasses.dataclass(frozen=True)
class Web:
    """How servers are reached: `proxy` is an address (default: that of the environment, HTTPS_PROXY)."""

    proxy: str | None = None
    timeout: float = USUAL_TIMEOUT
    tries: int = TRIES

    @classmethod
    def usual(cls, proxy: str | None = None) -> Web:
        """With the timeout of the environment. Raises `ArchiveError`."""
        text = os.environ.get(TIMEOUT)
        try:
            seconds = USUAL_TIMEOUT if not text else float(text)
        except ValueError:
            seconds = math.nan
        if not 0.0 < seconds < math.inf:
            raise ArchiveError(f"{TIMEOUT}={text}: expected a number of seconds above 0.")
        if proxy is not None and "://" not in proxy:
            raise ArchiveError(f"proxy={proxy!r}: expected an address such as http://HOST:PORT.")
        return cls(proxy, seconds)

    def look(self, url: str) -> Remote | None:
        """Size and version of a file; None if there is none. Raises `Unreachable`."""
        if not is_remote(url):
            try:
                found = os.stat(url)
            except OSError:
                return None
            return Remote(found.st_size, f"{found.st_mtime_ns}-{found.st_size}")

        def ask() -> Remote | None:
            try:
                answer = self._asked(url, "HEAD")
            except urllib.error.HTTPError as error:
                if error.code not in NO_HEAD:
                    raise
                answer = self._asked(url, "GET", {"Range": "bytes=0-0"})
            with answer:
                size = answer.headers.get("Content-Range", "").rpartition("/")[2]
                size = size or answer.headers.get("Content-Length")
                mark = answer.headers.get("ETag") or answer.headers.get("Last-Modified") or ""
                return Remote(int(size) if size and size.isdigit() else None, f"{mark.strip()}-{size}")

        return self._tried(url, ask)

    def get(self, url: str, largest: int = LARGEST) -> bytes | None:
        """Content of a file; None if there is none. Raises `Unreachable`, `ArchiveError` if it is too large."""
        if not is_remote(url):
            try:
                with open(url, "rb") as file:
                    return file.read(largest)
            except FileNotFoundError:
                return None

        def read() -> bytes | None:
            with self._asked(url, "GET") as answer:
                pieces, size = [], 0
                while piece := answer.read(PIECE):
                    size += len(piece)
                    if size > largest:
                        raise ArchiveError(f"{url}: larger than {largest / 1e6:.0f} MB; it is not read.")
                    pieces.append(piece)
                told = answer.headers.get("Content-Length")
                if told and told.isdigit() and int(told) != size:
                    raise http.client.IncompleteRead(b"", int(told) - size)
                return b"".join(pieces)

        return self._tried(url, read)

    @contextlib.contextmanager
    def raster(self, url: str) -> Iterator[DatasetReader]:
        """A raster, read by range requests. Raises `Unreachable` if opening or reading fails.

        Threads take turns at one address: GDAL keeps what it read of an address for all of them, and drops it when one
        of them closes its dataset, at which another one that is reading finds nothing.
        """
        name = f"/vsicurl/{url}" if is_remote(url) else url
        name = f"/vsigzip/{name}" if name.endswith(".gz") else name
        try:
            with (
                _lock_of(url),
                header_losses() as lost,
                options(**self._of_gdal()),
                DatasetReader(name, driver=DRIVERS) as data,
            ):
                if lost:
                    raise Unreachable(f"{url}: it was not read whole: {lost[0]}")
                yield data
        except GDAL_ERRORS as error:
            cause = " ".join(f"{error.__cause__ or error}".split()).rstrip(".")
            if "CURL error" in cause or "HTTP response" in cause:
                raise Unreachable(f"{url}: it cannot be reached: {cause.removeprefix('CURL error: ')}") from error
            raise Unreachable(
                f"{url}: it was not read whole; the connection was cut, or the file is damaged (GDAL: {cause})"
            ) from error

    def retried(self, read: Callable[[], T]) -> T:
        """A result of GDAL, tried again if the connection fails. Raises `Unreachable`."""
        for count in range(self.tries):
            try:
                return read()
            except Unreachable:
                if count == self.tries - 1:
                    raise
                time.sleep(PAUSE * 2**count)
        raise AssertionError

    def _of_gdal(self) -> dict[str, Any]:
        """GDAL options: few requests, no listing of folders, no cache between datasets, patience as for others."""
        seconds = max(1, math.ceil(self.timeout))
        found: dict[str, Any] = {
            "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
            "GDAL_HTTP_CONNECTTIMEOUT": seconds,
            "GDAL_HTTP_LOW_SPEED_TIME": seconds,
            "GDAL_HTTP_LOW_SPEED_LIMIT": 1,
            "GDAL_HTTP_USERAGENT": AGENT,
            "CPL_VSIL_CURL_NON_CACHED": "/vsicurl/",
            "GDAL_PAM_ENABLED": "NO",
        }
        return found | ({} if self.proxy is None else {"GDAL_HTTP_PROXY": self.proxy, "GDAL_HTTPS_PROXY": self.proxy})

    def _asked(self, url: str, method: str, headers: dict[str, str] | None = None) -> Any:
        given = {} if self.proxy is None else {"proxies": {"http": self.proxy, "https": self.proxy}}
        opener = urllib.request.build_opener(urllib.request.ProxyHandler(**given))
        request = urllib.request.Request(url, method=method, headers={"User-Agent": AGENT, **(headers or {})})
        return opener.open(request, timeout=self.timeout)

    def _tried(self, url: str, ask: Callable[[], T]) -> T | None:
        reason = ""
        for count in range(self.tries):
            if count:
                time.sleep(PAUSE * 2 ** (count - 1))
            try:
                return ask()
            except urllib.error.HTTPError as error:
                if error.code in ABSENT:
                    return None
                reason = f"the server answers {error.code} {error.reason}".rstrip()
                if error.code not in AGAIN:
                    break
            except TimeoutError:
                reason = f"no answer within {self.timeout:g} s"
            except urllib.error.URLError as error:
                slow = isinstance(error.reason, TimeoutError)
                what = getattr(error.reason, "strerror", None) or error.reason
                reason = f"no answer within {self.timeout:g} s" if slow else f"it cannot be reached: {what}"
            except (http.client.HTTPException, OSError) as error:
                what = "" if isinstance(error, http.client.IncompleteRead) else f": {error}"
                reason = f"the connection was cut{what}"
        raise Unreachable(f"{url}: {reason}")


def _lock_of(url: str) -> contextlib.AbstractContextManager[Any]:
    with _guard:
        return _locks.setdefault(url, threading.Lock())
