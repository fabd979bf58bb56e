"""Answers of the viewer: the place of a pixel with its accuracy, the pixels of a place, outlines, and relief."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import functools
import math
import pathlib
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import batch_filter_jit
from jaxgeo._locate import project
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.io._fix_columns import figures_of, rows_of
from jaxgeo.io.located import CHUNKS, axis_of, fixes_in_parts, located_with_accuracy, terrain_at
from jaxgeo.io.observations import ObservationBatch, Observations, axes_of
from jaxgeo.io.tables import ABOVE_TAKEOFF
from jaxgeo.observation import Observation
from jaxgeo.plot import words
from jaxgeo.plot.relief import Box, encoded, relief_pixels
from jaxgeo.status import Status, counts_as_fix
from jaxgeo.terrain import AbstractTerrain, ConstantHeight, Dem
from jaxgeo.uncertainty import Accuracy
from jaxgeo.uncertainty.metrics import error_ellipse
from jaxgeo.view.images import Pictures, ViewImage, images_of

MANY = CHUNKS[-1]  # pixels located at a time
LANES = (64, 1024)  # pixels projected at a time
RING = 48  # vertices of an error ellipse
POINTS, MOST_OUTLINES = 20, 16_000  # points of an outline per side of the image; points of all outlines
ACROSS = 1400  # columns of a relief
LEAST = 60.0  # m, least extent of the map
NO_HEIGHT = "The elevation model has no height at this place."


class Ellipse(NamedTuple):
    """An error ellipse, or the circle of samples: (n, 2) latitudes and longitudes in deg, and what it is."""

    ring: np.ndarray
    what: str


@dataclasses.dataclass(frozen=True)
class ViewData:
    """Images, the ground of each batch of `observed`, and the image file of each, as `jaxgeo view` shows them.

    `files` are in the order of `images`, with None for an exposure without a file. `probability` is that of CE and LE.
    `has_errors` says whether accuracy is estimated, from the error sources of the observations.
    """

    observed: Observations
    grounds: Sequence[AbstractTerrain]
    files: Sequence[pathlib.Path | None] = ()
    probability: float = 0.9
    has_errors: bool = True

    @functools.cached_property
    def images(self) -> list[ViewImage]:
        """The images, in the order of their first rows."""
        return images_of(self.observed)

    @functools.cached_property
    def pictures(self) -> Pictures:
        """Scaled copies of the image files."""
        return Pictures(self.images, self.files or [None] * len(self.images))

    @functools.cached_property
    def _locks(self) -> dict[str, threading.Lock]:
        """A lock for each program, so that two requests do not compile it twice."""
        return {name: threading.Lock() for name in ("accuracy", "locate", "project")}

    def locate(self, image: int, u: float, v: float, *, accuracy: bool = True) -> dict[str, Any]:
        """The fix of a pixel of an image: the columns of `jaxgeo locate`, texts, and its error ellipse.

        The accuracy takes longer, so that it may be left out. `ellipse` (n, 2) has latitudes and longitudes in deg,
        `ellipse_uv` (n, 2) the pixels that show them. Without a fix the coordinates are None and the status gives the
        reason. Raises `IndexError` for an image that is not there.
        """
        observed, ground = self._pixel(image, u, v)
        both = None
        if accuracy and self.has_errors:
            with self._locks["accuracy"]:
                both = located_with_accuracy(observed, [ground], self.probability)
        fix, found = both if both is not None else (self._located(observed.batches[0], ground), None)
        figures = figures_of("view", fix, found, None, None, None)
        (row,) = rows_of(fix, figures, None, is_above_takeoff=self.observed.is_above_takeoff)
        answer: dict[str, Any] = {"image": image, "u": u, "v": v, **_plain(row)}
        answer |= _texts(row, int(np.asarray(fix.status)[0]), bool(_count(fix)[0]))
        if found is not None:
            answer |= self._accuracy(image, fix, found, row)
        return answer

    def project(self, image: int, lat_deg: float, lon_deg: float) -> dict[str, Any]:
        """The pixel of an image that shows the ground at a latitude and longitude in deg, and which images see it.

        `u` and `v` are None if the point has no image; `seen` lists the images, nearest camera first, in which the
        ground there is visible, with its pixel. Raises `IndexError` for an image that is not there.
        """
        self.images[image]
        answer: dict[str, Any] = {"image": image, "lat_deg": lat_deg, "lon_deg": lon_deg}
        lat, lon = np.full(len(self.images), np.deg2rad(lat_deg)), np.full(len(self.images), np.deg2rad(lon_deg))
        height, uv, status = self._projected(np.arange(len(self.images)), lat, lon)
        if not (abs(lat_deg) <= 90.0 and math.isfinite(height[image])):
            return answer | {"u": None, "v": None, "status": None, "label": "No ground", "status_text": NO_HEIGHT,
                             "height_m": None, "seen": []}  # fmt: skip
        found = Status(int(status[image]))
        label = "Visible" if found == Status.hit else "Not visible"
        order = sorted(np.flatnonzero(status == Status.hit).tolist(), key=lambda i: self._distance(i, lat_deg, lon_deg))
        u, v = (float(x) if math.isfinite(x) else None for x in uv[image])
        return answer | {
            "u": u,
            "v": v,
            "status": found.name,
            "label": label,
            "status_text": found.message,
            "height_m": float(height[image]),
            "above": self._above,
            "seen": [{"image": i, "u": float(uv[i, 0]), "v": float(uv[i, 1])} for i in order],
        }

    def outlines(self) -> list[np.ndarray]:
        """The footprint of each image as (n, 2) latitudes and longitudes in deg, NaN where its edge sees no ground."""
        per_side = int(np.clip(MOST_OUTLINES // (4 * len(self.images)), 4, POINTS))
        steps = np.linspace(0.0, 1.0, per_side, endpoint=False)[:, None]
        found: list[np.ndarray] = [np.zeros((0, 2))] * len(self.images)
        for number, batch in enumerate(self.observed.batches):
            own = [i for i, one in enumerate(self.images) if one.batch == number]
            width, height = batch.camera.width, batch.camera.height
            corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], float) - 0.5
            ring = np.concatenate(
                [a + steps * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
            )
            index = np.repeat([self.images[i].index for i in own], len(ring))
            many = _at(batch, index, np.tile(ring, (len(own), 1)))
            fix = self._located(many, terrain_at(self.grounds[number], index))
            places = np.rad2deg(np.column_stack([np.asarray(fix.position.lat), np.asarray(fix.position.lon)]))
            places[~_count(fix)] = np.nan
            for k, i in enumerate(own):
                found[i] = places[k * len(ring) : (k + 1) * len(ring)]
        return found

    def box(self, outlines: Sequence[np.ndarray]) -> Box:
        """The extent of cameras and footprints on the map."""
        cameras = np.array([[one.lat_deg, one.lon_deg] for one in self.images])
        places = np.concatenate([cameras, *outlines])
        places = places[np.isfinite(places).all(axis=1)]
        middle = places[0, 1]
        lat, lon = places[:, 0], middle + np.remainder(places[:, 1] - middle + 180.0, 360.0) - 180.0
        return Box(float(lon.min()), float(lat.min()), float(lon.max()), float(lat.max())).grown(0.08, LEAST)

    def relief(
        self, box: Box, between: tuple[float, float] | None = None, across: int = ACROSS
    ) -> tuple[bytes, str, tuple[float, float]] | None:
        """(content, media type, height range in m) of a picture of the relief; None over level or unknown ground."""
        dem = self.grounds[0]
        found = relief_pixels(dem, box, across=across, between=between) if isinstance(dem, Dem) else None
        return None if found is None else (*encoded(found[0]), found[1])

    @property
    def _above(self) -> str:
        return "above the take-off" if self.observed.is_above_takeoff else "above the WGS 84 ellipsoid"

    @property
    def ground_text(self) -> str:
        """What the ground is, in words."""
        ground = self.grounds[0]
        if isinstance(ground, ConstantHeight):
            heights = np.asarray(ground.height, np.float64).reshape(-1)
            known = heights[np.isfinite(heights)]
            low, high = (words.metres(float(x), 1) for x in (known.min(), known.max())) if known.size else ("?", "?")
            return f"level ground {low if low == high else f'{low} to {high}'} m {self._above}"
        return "elevation model"

    def warm_up(self) -> None:
        """Compile what answers need; the first answers are then as quick as later ones."""
        first = self.images[0]
        middle = 0.5 * (first.width - 1), 0.5 * (first.height - 1)
        with concurrent.futures.ThreadPoolExecutor(2) as pool:
            jobs = [
                pool.submit(self.project, 0, first.lat_deg, first.lon_deg),
                pool.submit(self.locate, 0, *middle),
            ]
            for job in jobs:
                job.result()

    def _distance(self, image: int, lat_deg: float, lon_deg: float) -> float:
        one = self.images[image]
        north, east = one.lat_deg - lat_deg, (one.lon_deg - lon_deg + 180.0) % 360.0 - 180.0
        return math.hypot(north, east * math.cos(math.radians(lat_deg)))

    def _pixel(self, image: int, u: float, v: float) -> tuple[Observations, AbstractTerrain]:
        """(the observation of one pixel, the ground of its image)."""
        one = self.images[image]
        observed = self.observed.part(one.batch, np.array([one.index]))
        batch = _at(observed.batches[0], np.zeros(1, int), np.array([[u, v]], np.float64))
        ground = terrain_at(self.grounds[one.batch], np.array([one.index]))
        return dataclasses.replace(observed, batches=(batch,)), ground

    def _located(self, batch: ObservationBatch, ground: AbstractTerrain) -> Any:
        """Fixes of a batch by the one program that locates many pixels."""
        with self._locks["locate"]:
            parts = list(fixes_in_parts(batch, ground, size=MANY))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

    def _projected(
        self, images: np.ndarray, lat: np.ndarray, lon: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(ground heights, pixels (n, 2), statuses) of places in rad, each in an image."""
        height, uv, status = np.full(len(images), np.nan), np.full((len(images), 2), np.nan), np.zeros(len(images), int)
        own = np.array([self.images[i].batch for i in images.tolist()])
        for number, batch in enumerate(self.observed.batches):
            lanes = np.flatnonzero(own == number)
            size = next((size for size in LANES if size >= len(lanes)), LANES[-1])
            for first in range(0, len(lanes), size):
                part = lanes[np.minimum(np.arange(first, first + size), len(lanes) - 1)]
                index = np.array([self.images[images[k]].index for k in part.tolist()])
                ground = terrain_at(self.grounds[number], index)
                given = _at(batch, index, np.zeros((len(index), 2))).observation
                with self._locks["project"]:
                    seen = _project_many(given, ground, lat[part], lon[part], batch.is_one_camera, axis_of(ground))
                height[part], uv[part], status[part] = map(np.asarray, seen)
        return height, uv, status

    def _accuracy(self, image: int, fix: Any, found: Accuracy, row: dict[str, Any]) -> dict[str, Any]:
        circular, linear = (float(np.asarray(x)[0]) for x in (found.circular, found.linear))
        answer: dict[str, Any] = {
            "circular_m": circular if math.isfinite(circular) else None,
            "circular_text": words.length(circular),
            "linear_text": words.length(linear),
            "accuracy_text": row["accuracy_text"],
        }
        ellipse = ellipse_of(fix, found, self.probability)
        if ellipse is None:
            return answer
        rad = np.deg2rad(ellipse.ring)
        _, uv, _ = self._projected(np.full(len(rad), image), rad[:, 0], rad[:, 1])
        return answer | {"ellipse": ellipse.ring, "ellipse_uv": uv, "ellipse_text": ellipse.what}


def _texts(row: dict[str, Any], code: int, is_fix: bool) -> dict[str, Any]:
    """Texts of a fix, as in reports."""
    label, sentence = words.status(code)
    answer: dict[str, Any] = {"label": label, "status_text": sentence, "is_fix": is_fix}
    if row["fix_lat_deg"] is None or not math.isfinite(row["fix_lat_deg"]):
        return answer
    lat, lon = row["fix_lat_deg"], row["fix_lon_deg"]
    return answer | {
        "lat_text": words.coordinate(lat, "N", "S"),
        "lon_text": words.coordinate(lon, "E", "W"),
        **_heights(row),
        "range_text": words.length(row["slant_range_m"]),
        "incidence_text": f"{words.number(row['incidence_surface_deg'])}°",
    }


def _heights(row: dict[str, Any]) -> dict[str, str]:
    """Texts of the heights of a fix."""
    if ABOVE_TAKEOFF in row:
        return {"height_text": f"{words.metres(row[ABOVE_TAKEOFF])} m above the take-off"}
    return {
        "height_text": f"{words.metres(row['fix_height_m'])} m above the WGS 84 ellipsoid",
        "msl_text": f"{words.metres(row['fix_height_msl_m'])} m above mean sea level (EGM96)",
    }


def ellipse_of(fix: Any, found: Accuracy, probability: float) -> Ellipse | None:
    """The error ellipse of the first of the fixes; a circle if linear propagation is not valid, None without a fix."""
    cov, bias = np.asarray(found.cov_enu)[0], np.asarray(found.bias_enu)[0]
    level = f"{words.percent_name(probability)} %"
    if np.isfinite(cov).all():
        one = error_ellipse(cov[:2, :2], probability)
        major, minor, azimuth = (float(x) for x in (one.major, one.minor, one.azimuth))
        what = f"{level} error ellipse with semi-axes of {words.length(major)} and {words.length(minor)}"
    else:
        major = minor = float(np.asarray(found.circular)[0])
        azimuth, bias, what = 0.0, np.zeros(3), f"{level} circle of samples; an ellipse would be wrong here"
    if not math.isfinite(major):
        return None
    turn = np.linspace(0.0, 2.0 * np.pi, RING, endpoint=False)
    ahead, aside = major * np.cos(turn), minor * np.sin(turn)
    east = bias[0] + ahead * math.sin(azimuth) + aside * math.cos(azimuth)
    north = bias[1] + ahead * math.cos(azimuth) - aside * math.sin(azimuth)
    lat, lon, height = (float(np.asarray(x)[0]) for x in jax.tree.leaves(fix.position))
    across = float(WGS84.prime_vertical_radius(jnp.asarray(lat))) + height
    up = float(WGS84.meridian_radius(jnp.asarray(lat))) + height
    ring = np.column_stack([lat + north / up, lon + east / (across * max(math.cos(lat), 1e-9))])
    return Ellipse(np.rad2deg(ring), what)


def _at(batch: ObservationBatch, index: np.ndarray, uv: np.ndarray) -> ObservationBatch:
    """Pixels of exposures of a batch."""
    observation, sources = batch.at(index)
    return dataclasses.replace(
        batch, observation=Observation(observation.exposure, uv), sources=sources, rows=np.arange(len(index))
    )


def _count(fix: Any) -> np.ndarray:
    return np.isin(np.asarray(fix.status), [int(one) for one in Status if counts_as_fix(one.code)])


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """The columns with None for numbers that are not finite."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in row.items()
    }


@batch_filter_jit
def _project_many(
    observation: Observation, terrain: AbstractTerrain, lat: Any, lon: Any, is_one_camera: bool, axis: int | None
) -> tuple[Any, Any, Any]:
    """(ground height, pixel, status) of places, each in an exposure."""

    def one(given: Observation, ground: AbstractTerrain, lat: Any, lon: Any) -> tuple[Any, Any, Any]:
        height = ground.height_at(Geodetic(lat=lat, lon=lon, height=jnp.zeros_like(lat)))
        seen = project(given.exposure, Geodetic(lat=lat, lon=lon, height=height), terrain=ground)
        return height, seen.uv, seen.status

    return jax.vmap(one, in_axes=(axes_of(observation, is_one_camera), axis, 0, 0))(observation, terrain, lat, lon)
