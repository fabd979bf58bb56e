"""What the viewer's server answers: the page, the state, the images, the map and the answers, by path and query."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import pathlib
import secrets
import threading
import urllib.parse
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxgeo.io.errors import ImageError
from jaxgeo.plot import words
from jaxgeo.plot.relief import Box, metres_per_degree
from jaxgeo.view.data import ViewData
from jaxgeo.view.images import Pictures, ViewImage

FILES = {
    "/": ("page.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
}
JSON = "application/json"
MOST_RELIEFS = 64  # kept pictures of the relief
PLACES = 7  # decimals of degrees


class Answer(NamedTuple):
    """A response: HTTP status, media type, content, and whether the browser may keep it."""

    status: int
    kind: str
    content: bytes
    may_keep: bool = False


class NotUnderstood(ValueError):
    """A query that has no answer; the message names the parameter."""


@dataclasses.dataclass
class Site:
    """The state of a viewer, from its start until all is computed; safe for threads.

    `doing` is what is being prepared, `error` why the command ended. `images` are known before the `data` with the
    ground; `outlines` when they are located, and `is_warm` once everything is compiled. The pixels of the observations
    are marked if `has_marks`.
    """

    title: str = "jaxgeo"
    tiles: str | None = None
    doing: str = "starting"
    error: str = ""
    images: list[ViewImage] = dataclasses.field(default_factory=list)
    pictures: Pictures | None = None
    data: ViewData | None = None
    outlines: list[np.ndarray] | None = None
    box: Box | None = None
    between: tuple[float, float] | None = None
    notes: list[str] = dataclasses.field(default_factory=list)
    has_marks: bool = False
    is_warm: bool = False
    ready: threading.Event = dataclasses.field(default_factory=threading.Event)
    polled: float = -math.inf  # time.monotonic() of the last request for the state
    edition: str = dataclasses.field(default_factory=lambda: secrets.token_hex(4))  # in addresses that browsers keep

    def answer(self, path: str, query: Mapping[str, str]) -> Answer:
        """The response to a request."""
        if path in FILES:
            name, kind = FILES[path]
            return Answer(200, f"{kind}; charset=utf-8", _file(name))
        found = self._routes.get(path)
        if found is None:
            return _json({"error": "There is no such page."}, 404)
        try:
            return found(query)
        except NotUnderstood as error:
            return _json({"error": str(error)}, 400)
        except ImageError as error:
            return _json({"error": " ".join(str(error).split())}, 404)

    @functools.cached_property
    def _routes(self) -> dict[str, Callable[[Mapping[str, str]], Answer]]:
        return {
            "/api/state": self._state,
            "/api/scene": self._scene,
            "/api/map": self._map,
            "/api/locate": self._locate,
            "/api/project": self._project,
            "/image": self._image,
            "/relief": self._relief,
        }

    def _state(self, query: Mapping[str, str]) -> Answer:
        del query
        return _json(
            {
                "doing": self.doing,
                "error": self.error,
                "has_images": bool(self.images),
                "has_map": self.box is not None,
                "is_ready": self.ready.is_set(),
                "is_warm": self.is_warm,
            }
        )

    def _scene(self, query: Mapping[str, str]) -> Answer:
        del query
        names = ("width", "height", "lat_deg", "lon_deg", "height_m")
        reason = (lambda i: None) if self.pictures is None else self.pictures.reason
        images = [
            {name: getattr(one, name) for name in names}
            | {
                "name": f"exposure {one.name}" if one.name.isdigit() else one.name,
                "reason": reason(i),
                "marks": one.pixels if self.has_marks else [],
            }
            for i, one in enumerate(self.images)
        ]
        content = {"title": self.title, "images": images, "tiles": self.tiles, "notes": self.notes}
        return _json(content | {"edition": self.edition})

    def _map(self, query: Mapping[str, str]) -> Answer:
        del query
        if self.data is None or self.box is None or self.outlines is None:
            return _json({"error": "preparing"}, 503)
        return _json(
            {
                "box": list(self.box),
                "metres": metres_per_degree(self.box.centre[1]),
                "between": self.between,
                "ground": self.data.ground_text,
                "percent": words.percent_name(self.data.probability),
                "has_errors": self.data.has_errors,
                "outlines": [np.round(one, PLACES).tolist() for one in self.outlines],
            }
        )

    def _locate(self, query: Mapping[str, str]) -> Answer:
        data, image = self._ready(), self._image_in(query)
        with_accuracy = query.get("accuracy", "yes") == "yes"
        return _json(data.locate(image, _number(query, "u"), _number(query, "v"), accuracy=with_accuracy))

    def _project(self, query: Mapping[str, str]) -> Answer:
        data, image = self._ready(), self._image_in(query)
        lat, lon = _number(query, "lat"), _number(query, "lon")
        if abs(lat) > 90.0 or abs(lon) > 360.0:
            raise NotUnderstood(f"lat={lat:g}, lon={lon:g}: latitudes end at 90, longitudes at 180 deg.")
        return _json(data.project(image, lat, lon))

    def _image(self, query: Mapping[str, str]) -> Answer:
        image, across = self._image_in(query), int(_number(query, "across", 1600.0))
        if self.pictures is None:
            return _json({"error": "preparing"}, 503)
        box = None
        if "box" in query:
            one = self.images[image]
            left, top, right, bottom = _box(query)
            box = max(left, 0.0), max(top, 0.0), min(right, float(one.width)), min(bottom, float(one.height))
            if not (box[0] < box[2] and box[1] < box[3]):
                raise NotUnderstood(f"box={query['box']}: it lies outside the image.")
        return Answer(200, "image/jpeg", self.pictures.jpeg(image, box, across), may_keep=True)

    def _relief(self, query: Mapping[str, str]) -> Answer:
        west, south, east, north = _box(query)
        if not (west < east <= west + 360.0 and -90.0 <= south < north <= 90.0):
            raise NotUnderstood(f"box={query['box']}: expected west,south,east,north in deg.")
        self._ready()
        found = self._picture_of_relief(Box(west, south, east, north))
        if found is None:
            return _json({"error": "There is no relief here."}, 404)
        return Answer(200, found[1], found[0], may_keep=True)

    @functools.cached_property
    def _picture_of_relief(self) -> Callable[[Box], Any]:
        lock = threading.Lock()

        @functools.lru_cache(maxsize=MOST_RELIEFS)
        def found(box: Box) -> Any:
            with lock:
                return self._ready().relief(box, self.between)

        return found

    def _ready(self) -> ViewData:
        """The data, when there are some; the browser shows meanwhile what is being prepared."""
        self.ready.wait()
        if self.data is None:
            raise NotUnderstood(self.error or "The viewer has ended.")
        return self.data

    def _image_in(self, query: Mapping[str, str]) -> int:
        text = query.get("image", "")
        if not (text.isascii() and text.isdigit() and int(text) < len(self.images)):
            raise NotUnderstood(f"image={text}: expected a number from 0 to {len(self.images) - 1}.")
        return int(text)


def check_tiles(url: str) -> str:
    """The address of web-map tiles, if it has {z}, {x} and {y}. Raises `ValueError`."""
    parts = urllib.parse.urlsplit(url)
    missing = [one for one in ("{z}", "{x}", "{y}") if one not in url]
    if parts.scheme not in ("http", "https") or not parts.hostname or missing or set(parts.netloc) & set("{};, '\""):
        raise ValueError(
            f"{url}: expected the address of web-map tiles, such as https://tile.openstreetmap.org/{{z}}/{{x}}/{{y}}.png."
        )
    return url


def tile_origin(url: str) -> str:
    """Scheme and host of the address of tiles."""
    parts = urllib.parse.urlsplit(url)
    return f"{parts.scheme}://{parts.netloc}"


def _number(query: Mapping[str, str], name: str, default: float | None = None) -> float:
    text = query.get(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise NotUnderstood(f"{name}={text}: expected a number.")
    return value


def _box(query: Mapping[str, str]) -> tuple[float, float, float, float]:
    parts = query.get("box", "").split(",")
    if len(parts) != 4:
        raise NotUnderstood(f"box={query.get('box')}: expected four numbers.")
    left, top, right, bottom = (_number({"box": part}, "box") for part in parts)
    return left, top, right, bottom


@functools.cache
def _file(name: str) -> bytes:
    return (pathlib.Path(__file__).parent / "static" / name).read_bytes()


def _json(content: Any, status: int = 200) -> Answer:
    return Answer(status, JSON, json.dumps(_plain(content), separators=(",", ":"), allow_nan=False).encode())


def _plain(value: Any) -> Any:
    """A JSON value: arrays as lists, NaN and infinities as null."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
