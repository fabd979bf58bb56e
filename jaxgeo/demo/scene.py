"""Demo computation: fixes of an oblique camera over real terrain, hidden ground, and the accuracy of one fix."""

from __future__ import annotations

import importlib.resources
import pathlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import batch_filter_jit, quick_filter_jit
from jaxgeo._locate import locate, project
from jaxgeo._numerics import safe_angle, safe_norm
from jaxgeo._record import Record
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io import example_dem
from jaxgeo.io.scene import read_scene
from jaxgeo.sensor import AbstractCamera, FrameCamera, Sensor, Shot
from jaxgeo.terrain import Dem
from jaxgeo.uncertainty import Accuracy, AccuracyCheck, Budget, Sampling, accuracy, budget, sample

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


def make_demo(meanwhile: Callable[[Seen], None] | None = None) -> Demo:
    """Locate a grid of pixels, the outline and the view of the demo shot, and find the hidden ground.

    `meanwhile` is called with these while programs for the accuracy of one fix are compiled.
    """
    scene = read_scene(scene_file())
    sensor, shot = scene.sensor, scene.shot
    assert shot is not None
    assert scene.errors is not None
    dem = example_dem()
    camera = sensor.camera
    assert isinstance(camera, FrameCamera)
    grid = np.round(_mesh(camera, GRID, 0.06)).reshape(-1, 2)
    edges, view = _edges(camera), _mesh(camera, VIEW, 0.5 / VIEW[0]).reshape(-1, 2)
    uv = np.concatenate([grid, edges, _middle(camera)[None], view])
    n, m = len(grid), len(grid) + len(edges)
    with ThreadPoolExecutor() as pool:  # XLA compiles the parts in parallel
        doubted = (sensor, shot, grid[DOUBTED], dem, scene.errors)
        drawn = pool.submit(sample, *doubted, sampling=Sampling(count=SAMPLES, chunk=SAMPLES), keep=True)
        answered = pool.submit(_answered, *doubted)
        posts = pool.submit(_posts_in_image, sensor, shot, dem)
        section = pool.submit(_section_under_axis, sensor, shot, dem)
        fix = located(sensor, shot, uv, dem)
        hidden = _hidden(sensor, shot, dem, *posts.result())
        centre, along = section.result()
        seen = Seen(
            title=scene.title,
            dem=dem,
            sensor=sensor,
            shot=shot,
            centre=centre,
            uv=grid,
            fix=_part(fix, 0, n),
            outline=_part(fix, n, m).position,
            axis=_part(fix, m, m + 1),
            view=_part(fix, m + 1, len(uv), VIEW),
            hidden=hidden,
            section=along,
        )
        if meanwhile is not None:
            meanwhile(seen)
        found, shares = answered.result()
        return Demo(**vars(seen), errors=Errors(DOUBTED, AccuracyCheck(found, drawn.result()), shares))


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


def _posts_in_image(sensor: Sensor, shot: Shot, dem: Dem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(row and col, pixel, distance in m) of the posts that project into the image, visible or hidden."""
    posts = np.indices(np.shape(dem.posts)).reshape(2, -1).T
    uv, distance, ok = (np.asarray(x) for x in _projected(sensor, shot, dem, posts))
    return posts[ok], uv[ok], distance[ok]


@batch_filter_jit
def _projected(sensor: Sensor, shot: Shot, dem: Dem, posts: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    def project_one(rowcol: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        post = _post(dem, *rowcol)
        image = project(sensor, shot, post)
        return image.uv, safe_norm(sensor.to_camera(shot, WGS84.to_ecef(post))), image.ok

    return jax.vmap(project_one)(posts)


def _post(dem: Dem, row: jax.Array, col: jax.Array) -> Geodetic:
    x, y, z = dem.grid.normal(jnp.stack([row, col]).astype(jnp.float64))
    height = jnp.asarray(dem.posts)[row, col].astype(jnp.float64)
    return Geodetic(lat=jnp.arcsin(z), lon=jnp.arctan2(y, x), height=height)


def _section_under_axis(sensor: Sensor, shot: Shot, dem: Dem) -> tuple[Geodetic, tuple[np.ndarray, ...]]:
    """Perspective centre; (distance, height of the optical axis, height of the ground, hidden) under the axis."""
    centre, *along = _section(sensor, shot, dem, np.linspace(0.0, REACH, PROFILE))
    distance, sight, ground, off_nadir = (np.asarray(x) for x in along)
    highest = np.fmax.accumulate(off_nadir)
    return centre, (distance, sight, ground, off_nadir < highest - 1e-6)


@quick_filter_jit
def _section(sensor: Sensor, shot: Shot, dem: Dem, ranges: Any) -> tuple[Any, ...]:
    origin, direction, _ = sensor.ray_ecef(shot, _middle(sensor.camera))
    up, height = WGS84.normal_and_height(origin)
    foot = origin - up * height

    def sample(s: jax.Array) -> tuple[jax.Array, ...]:
        normal, height = WGS84.normal_and_height(origin + s * direction)
        on_ellipsoid = origin + s * direction - height * normal
        rowcol = dem.grid.rowcol(normal)
        ground = jnp.where(dem.contains(rowcol), dem.surface(rowcol, dem.cell_of(rowcol)), jnp.nan)
        off_nadir = safe_angle(on_ellipsoid + ground * normal - origin, -up)
        return safe_norm(on_ellipsoid - foot), height, ground, off_nadir

    return WGS84.to_geodetic(origin), *jax.vmap(sample)(ranges)


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


def _answered(*look: Any) -> tuple[Accuracy, Budget]:
    found = accuracy(*look, sampling=Sampling(count=SAMPLES))
    return found, budget(found)


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
