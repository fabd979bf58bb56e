"""Demo computation: fixes of an oblique camera over real terrain, hidden ground, and the accuracy of one fix."""

from __future__ import annotations

import importlib.resources
import pathlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._locate import locate
from jaxgeo._record import Record
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.earth._on_host import R_ecef_from_enu_of, ecef_of, normals_of
from jaxgeo.fix import Fix
from jaxgeo.io import example_dem
from jaxgeo.io.scene import read_scene
from jaxgeo.sensor import AbstractCamera, FrameCamera, Sensor, Shot
from jaxgeo.sensor.sensor import Sight
from jaxgeo.terrain import Dem, GeographicGrid
from jaxgeo.uncertainty import Accuracy, AccuracyCheck, Budget, Sampling, budget
from jaxgeo.uncertainty._accuracy import accuracy_about
from jaxgeo.uncertainty.map_cells import check_level
from jaxgeo.uncertainty.model import checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sampled import draw_errors
from jaxgeo.uncertainty.sampling import resolve_sampling

GRID = (4, 5)  # fixes across the image, along columns and rows
VIEW = (100, 200)  # pixels of the rendered view, along columns and rows
EDGE = 40  # points along each edge of the image
PROFILE = 800  # samples of the section under the optical axis
REACH = 24_000.0  # m along the optical axis
CHUNK = 4096  # pixels located at a time
HIDDEN_BY = 1.0  # m, least range difference between visible and hidden ground
DOUBTED = 13  # grid fix near a ridge: some perturbed lines of sight hit the ground behind it
SAMPLES = 20_000


class Errors(Record):
    """Accuracy of one fix, checked by samples, and its budget; `number` is its index in the grid."""

    number: int
    checked: AccuracyCheck
    budget: Budget

    @property
    def accuracy(self) -> Accuracy:
        """The answer."""
        return self.checked.accuracy


class Seen(Record):
    """What the camera sees; angles in rad, lengths in m."""

    title: str
    dem: Dem
    sensor: Sensor
    shot: Shot
    centre: Geodetic  # perspective centre
    uv: np.ndarray  # (n, 2)
    fix: Fix  # (n,)
    outline: Geodetic  # (m,)
    axis: Fix  # (1,), of the optical axis
    view: Fix  # (columns, rows)
    hidden: np.ndarray  # (rows, cols) of the DEM: inside the image but hidden by terrain
    section: tuple[np.ndarray, ...]  # distance on the ground, height of the optical axis, of the ground, hidden


class Demo(Seen):
    """Results of the demo."""

    errors: Errors


def scene_file() -> pathlib.Path:
    """The packaged scene file."""
    return pathlib.Path(str(importlib.resources.files("jaxgeo") / "data" / "demo_scene.toml"))


class Making:
    """The demo in the making, part by part; use it in a `with` statement.

    XLA compiles the parts of the accuracy in other threads, about a fix that is found with all others.
    """

    def __init__(self) -> None:
        scene = read_scene(scene_file())
        assert scene.shot is not None
        camera = scene.sensor.camera
        assert isinstance(camera, FrameCamera)
        self._title, self._look, self._errors = scene.title, (scene.sensor, scene.shot), scene.errors
        self._camera, self._dem = camera, example_dem()
        self._grid = np.round(_mesh(camera, GRID, 0.06)).reshape(-1, 2)
        self._pool = ThreadPoolExecutor()
        self._located = self._pool.submit(self._locate)
        self._axis = self._pool.submit(_axis, *self._look, np.linspace(0.0, REACH, PROFILE))

    def __enter__(self) -> Making:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()

    def seen(self) -> Seen:
        """Locate a grid of pixels, the outline and the view of the demo shot, and find the hidden ground.

        The accuracy of one fix is computed from then on.
        """
        fix, axis = self._located.result(), jax.device_get(self._axis.result())
        self._begin_accuracy(jax.tree.map(lambda leaf: leaf[DOUBTED], fix), axis.sight)
        hidden = _hidden(*self._look, self._dem, *_posts_in_image(self._camera, axis.sight, self._dem))
        n, m = len(self._grid), len(self._grid) + len(_edges(self._camera))
        return Seen(
            title=self._title,
            dem=self._dem,
            sensor=self._look[0],
            shot=self._look[1],
            centre=jax.tree.map(lambda x: x[0], axis.points),
            uv=self._grid,
            fix=_part(fix, 0, n),
            outline=_part(fix, n, m).position,
            axis=_part(fix, m, m + 1),
            view=_part(fix, m + 1, m + 1 + VIEW[0] * VIEW[1], VIEW),
            hidden=hidden,
            section=_section(axis, self._dem),
        )

    def whole(self, seen: Seen) -> Demo:
        """All of the demo."""
        found, shares = self._answered.result()
        return Demo(**vars(seen), errors=Errors(DOUBTED, AccuracyCheck(found, self._drawn.result()), shares))

    def _locate(self) -> Fix:
        view = _mesh(self._camera, VIEW, 0.5 / VIEW[0]).reshape(-1, 2)
        uv = np.concatenate([self._grid, _edges(self._camera), _middle(self._camera)[None], view])
        return located(*self._look, uv, self._dem)

    def _begin_accuracy(self, fix: Fix, sight: Sight) -> None:
        """Accuracy and samples of a fix in other threads, without searching for it in a program of its own."""
        inputs = ModelInputs.of(*self._look, self._grid[DOUBTED], self._dem)
        nominal, model = _nominal(fix, sight, self._dem), checked_model(self._errors, inputs)
        sampling = resolve_sampling(Sampling(chunk=SAMPLES), SAMPLES)
        about = inputs, nominal, model
        self._drawn = self._pool.submit(draw_errors, *about, FIRST_HIT, sampling, keep=True)
        self._answered = self._pool.submit(_answered, *about, check_level(0.9), FIRST_HIT, sampling)


def _answered(*asked: Any) -> tuple[Accuracy, Budget]:
    found = accuracy_about(*asked)
    return found, budget(found)


def _nominal(fix: Fix, sight: Sight, dem: Dem) -> NominalFix:
    """What the accuracy of a fix starts from."""
    assert isinstance(dem.grid, GeographicGrid)
    lat, lon = float(fix.position.lat), float(fix.position.lon)
    R_ecef_from_enu = R_ecef_from_enu_of(lat, lon)
    cell = np.floor(dem.grid.places_of(np.array([[lon, lat]]))[0]).astype(np.int32)
    direction = (np.asarray(fix.ecef) - sight.centre) / np.asarray(fix.slant_range)
    found = (fix, fix.ecef, fix.slant_range, cell, R_ecef_from_enu.T @ direction, R_ecef_from_enu)
    return NominalFix(*jax.device_put(found))


def make_demo() -> Demo:
    """Locate pixels of the demo shot, find the hidden ground, and compute the accuracy of one fix."""
    with Making() as making:
        return making.whole(making.seen())


def located(sensor: Sensor, shot: Shot, uv: np.ndarray, dem: Dem) -> Fix:
    """Fixes of pixels (n, 2), some at a time."""
    of_some = jax.vmap(locate, in_axes=(None, None, 0, None))
    chunks = [of_some(sensor, shot, uv[start : start + CHUNK], dem) for start in range(0, len(uv), CHUNK)]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *chunks)


def _hidden(
    sensor: Sensor, shot: Shot, dem: Dem, posts: np.ndarray, uv: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    """Mask (rows, cols) of hidden posts: at the pixel they project to, the camera sees nearer ground."""
    nearer = located(sensor, shot, uv, dem).slant_range < distance - HIDDEN_BY
    hidden = np.zeros(np.shape(dem.posts), bool)
    hidden[tuple(posts[nearer].T)] = True
    return hidden


class Axis(NamedTuple):
    """The camera's position and orientation, and points (n) along its optical axis."""

    sight: Sight
    points: Geodetic


@quick_filter_jit
def _axis(sensor: Sensor, shot: Shot, ranges: Any) -> Axis:
    origin, direction, _ = sensor.ray_ecef(shot, _middle(sensor.camera))
    return Axis(sensor.sight(shot), jax.vmap(lambda s: WGS84.to_geodetic(origin + s * direction))(ranges))


def _posts_in_image(camera: FrameCamera, sight: Sight, dem: Dem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row and col, pixel, distance in m) of the posts that project into the image, visible or hidden."""
    assert isinstance(dem.grid, GeographicGrid)
    posts = np.indices(np.shape(dem.posts)).reshape(2, -1).T
    lon, lat = dem.grid.lonlat_at(posts).T
    p_ecef = ecef_of(normals_of(lat, lon), np.asarray(dem.posts, np.float64).ravel())
    x, y, z = ((p_ecef - sight.centre) @ sight.R_ecef_from_camera).T
    uv = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * np.stack([x / z, y / z], axis=1)
    inside = (z > 0.0) & np.all((uv >= -0.5) & (uv <= np.array([camera.width, camera.height]) - 0.5), axis=1)
    return posts[inside], uv[inside], np.linalg.norm(p_ecef[inside] - sight.centre, axis=1)


def _section(axis: Axis, dem: Dem) -> tuple[np.ndarray, ...]:
    """(distance, height of the optical axis, height of the ground, hidden) under the optical axis."""
    assert isinstance(dem.grid, GeographicGrid)
    lat, lon, height = axis.points.lat, axis.points.lon, np.asarray(axis.points.height)
    rowcol = dem.grid.places_of(np.stack([lon, lat], axis=1))
    known = np.all((rowcol >= 0.0) & (rowcol <= np.array(np.shape(dem.posts)) - 1.0), axis=1)
    ground = sampled(np.asarray(dem.posts, np.float64)[..., None], np.where(known[:, None], rowcol, 0.0))[:, 0]
    normals = normals_of(lat, lon)
    on_ellipsoid = ecef_of(normals, 0.0)
    down = (on_ellipsoid[0] - axis.sight.centre) / height[0]
    to_ground = ecef_of(normals, ground) - axis.sight.centre
    off_nadir = np.arccos(np.clip(to_ground @ down / np.linalg.norm(to_ground, axis=1), -1.0, 1.0))
    off_nadir, ground = np.where(known, off_nadir, np.nan), np.where(known, ground, np.nan)
    distance = np.linalg.norm(on_ellipsoid - on_ellipsoid[0], axis=1)
    return distance, height, ground, off_nadir < np.fmax.accumulate(off_nadir) - 1e-6


def _middle(camera: AbstractCamera) -> np.ndarray:
    assert isinstance(camera, FrameCamera)
    return np.array([(camera.width - 1) / 2.0, (camera.height - 1) / 2.0])


def _mesh(camera: FrameCamera, counts: tuple[int, int], margin: float) -> np.ndarray:
    """Evenly spaced pixels (columns, rows, 2), from `margin` (a share of the image size) inside the edges."""
    sides = [
        np.linspace(margin, 1.0 - margin, count) * size - 0.5
        for count, size in zip(counts, (camera.width, camera.height), strict=True)
    ]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)


def _edges(camera: FrameCamera) -> np.ndarray:
    """Pixels (n, 2) along the edge of the image."""
    mesh = _mesh(camera, (EDGE, EDGE), 0.0)
    return np.concatenate([mesh[:-1, 0], mesh[-1, :-1], mesh[:0:-1, -1], mesh[0, :0:-1]])


def _part(fix: Fix, start: int, stop: int, shape: tuple[int, ...] = (-1,)) -> Fix:
    return jax.tree.map(lambda leaf: leaf[start:stop].reshape(*shape, *leaf.shape[1:]), fix)


def sampled(image: np.ndarray, rowcol: np.ndarray) -> np.ndarray:
    """Bilinear interpolation (..., bands) of an image (rows, cols, bands)."""
    first = np.clip(np.floor(rowcol).astype(int), 0, np.array(image.shape[:2]) - 2)
    row, col = first[..., 0], first[..., 1]
    r, c = np.moveaxis(np.clip(rowcol - first, 0.0, 1.0)[..., None], -2, 0)
    near, far = (
        image[row, col] * (1 - c) + image[row, col + 1] * c,
        image[row + 1, col] * (1 - c) + image[row + 1, col + 1] * c,
    )
    return near * (1 - r) + far * r
