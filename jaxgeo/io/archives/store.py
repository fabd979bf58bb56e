"""Cache of parts of elevation tiles: by content, with checksums, bounded, shared between processes.

Objects are named by the SHA-256 of their content; an entry says which part of which file an object is. Both are written
whole or not at all, and never changed. An object is verified whenever it is used; a damaged one counts as absent.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import pathlib
import shutil
import time
from typing import Any

from jaxgeo._destination import DEVICE_FAILURES
from jaxgeo._partial import partial_file
from jaxgeo.io.archives.errors import ArchiveError

FOLDER = "JAXGEO_DEM_CACHE"  # environment variable
SIZE = "JAXGEO_DEM_CACHE_SIZE"  # environment variable: MB
USUAL_SIZE = 2000  # MB
IN_USE = 600.0  # s since its last use, in which an object may be in use by another process, and is kept
OBJECTS, ENTRIES = "objects", "entries"


class DemCache:
    """A folder with parts of elevation tiles.

    `folder` is by default that of the environment variable `JAXGEO_DEM_CACHE`, or the user's cache folder; `largest`
    is in bytes, by default the MB of `JAXGEO_DEM_CACHE_SIZE`, or 2000 MB. The least recently used objects are removed
    beyond it, but none that this run uses or that was used within ten minutes. Raises `ArchiveError` if it cannot be
    written, or for an invalid size.
    """

    def __init__(self, folder: str | os.PathLike[str] | None = None, *, largest: int | None = None) -> None:
        asked = os.environ.get(FOLDER) if folder is None else os.fspath(folder)
        self.folder = pathlib.Path(asked).absolute() if asked else _usual_folder()
        self.largest = _usual_size() if largest is None else int(largest)
        if self.largest < 1:
            raise ArchiveError(f"largest={largest}: the cache needs a size of at least 1 byte.")
        self._used: dict[pathlib.Path, int] = {}

    def given(self, archive: str, name: str) -> pathlib.Path:
        """Where a whole tile that was downloaded by hand is looked for."""
        return self.folder / "given" / archive / name

    def entry(self, key: str) -> dict[str, Any] | None:
        """The entry of a key, or None; a damaged one counts as absent."""
        try:
            found = json.loads(self._entry(key).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) and found.get("key") == key else None

    def set_entry(self, key: str, content: dict[str, Any]) -> None:
        """Write an entry. Raises `ArchiveError`."""
        self._write(self._entry(key), json.dumps({"key": key, **content}).encode())

    def forget(self, key: str) -> None:
        """Remove an entry; its object goes with the least recently used ones."""
        with contextlib.suppress(OSError):
            self._entry(key).unlink()

    def object(self, digest: str, ending: str) -> pathlib.Path | None:
        """The file of an object, verified, and marked as used; None if it is absent or damaged (then removed)."""
        path = self._object(digest, ending)
        if path in self._used:
            return path
        try:
            with open(path, "rb") as file:
                is_sound = hashlib.file_digest(file, "sha256").hexdigest() == digest
            if not is_sound:
                _remove(path)
                return None
            with contextlib.suppress(OSError):  # a cache that may only be read
                os.utime(path)
            self._used[path] = path.stat().st_size
        except OSError:
            return None
        return path

    def put(self, content: bytes, ending: str) -> tuple[str, pathlib.Path]:
        """(digest, file) of new content. Raises `ArchiveError` if it cannot be written, or the cache is too small."""
        digest = hashlib.sha256(content).hexdigest()
        path = self._object(digest, ending)
        if sum(self._used.values()) + len(content) > self.largest:
            raise ArchiveError(
                f"{self.folder}: this needs more than the {self.largest / 1e6:.4g} MB that the cache may hold; set "
                f"{SIZE} to more MB, or ask for less ground."
            )
        if self.object(digest, ending) is None:
            self._make_room(len(content))
            self._write(path, content)
            self._used[path] = len(content)
        return digest, path

    def size(self) -> int:
        """Bytes of all objects."""
        return sum(size for _, size, _ in self._objects())

    def clear(self) -> int:
        """Remove all objects and entries; returns the bytes of the objects."""
        size = 0
        for _, one, path in self._objects():
            _remove(path)
            size += one
        for path in (self.folder / ENTRIES).glob("*.json"):
            _remove(path)
        return size

    def _make_room(self, more: int) -> None:
        objects = sorted(self._objects())
        total = sum(size for _, size, _ in objects) + more
        now = time.time()
        for used, size, path in objects:
            if total <= self.largest:
                return
            if path in self._used or now - used < IN_USE:
                continue
            with contextlib.suppress(OSError):
                _remove(path)
                total -= size

    def _objects(self) -> list[tuple[float, int, pathlib.Path]]:
        """(time of last use, bytes, file) of each object."""
        found = []
        for path in (self.folder / OBJECTS).glob("*.*"):
            with contextlib.suppress(OSError):
                stat = path.stat()
                found.append((stat.st_mtime, stat.st_size, path))
        return found

    def _object(self, digest: str, ending: str) -> pathlib.Path:
        return self.folder / OBJECTS / f"{digest}{ending}"

    def _entry(self, key: str) -> pathlib.Path:
        return self.folder / ENTRIES / f"{hashlib.sha256(key.encode()).hexdigest()}.json"

    def _write(self, path: pathlib.Path, content: bytes) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.is_dir():  # no folder is ever made there: it stands in the way of a part
                _remove(path)
            with partial_file(path) as partial:
                partial.write_bytes(content)
                partial.replace(path)
        except OSError as error:
            way = "free some space, or name" if error.errno in DEVICE_FAILURES else "name"
            raise ArchiveError(
                f"{self.folder}: the cache cannot be written: {error.strerror}; {way} another folder by {FOLDER}."
            ) from error


def _remove(path: pathlib.Path) -> None:
    """Remove a part, or what is in its place."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _usual_folder() -> pathlib.Path:
    import platformdirs

    return pathlib.Path(platformdirs.user_cache_dir("jaxgeo", appauthor=False)) / "dem"


def _usual_size() -> int:
    text = os.environ.get(SIZE)
    try:
        megabytes = USUAL_SIZE if not text else float(text)
        size = int(megabytes * 1e6)
    except (ValueError, OverflowError):
        size = 0
    if size < 1:
        raise ArchiveError(f"{SIZE}={text}: expected a number of MB above 0.")
    return size
