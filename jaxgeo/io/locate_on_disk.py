"""Batched ray intersection with a DEM on disk: nearby rays share one window."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._arguments import UNIT_TOLERANCE, checked_exposure
from jaxgeo._checks import as_array, as_float64, check_is, given_array
from jaxgeo._locate import intersect
from jaxgeo.earth import Geodetic
from jaxgeo.earth.ray import Ray
from jaxgeo.fix import Fix
from jaxgeo.io.files import MAX_POSTS, DemFiles
from jaxgeo.io.sightlines import Sightlines, comes_in, in_parts, padded_rays
from jaxgeo.io.windows import Window
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.exposure import line_of_sight
from jaxgeo.status import Status
from jaxgeo.terrain.search.reach import CEILING_MARGIN

WORTH_SPLITTING = 1_000_000  # posts: smaller windows are not split
SAVING = 0.6  # largest share of a window's posts in its two halves for a split

Batch = tuple[np.ndarray, Window, bool]
"""Ray indices, their window, and whether it needs the whole mosaic's ceiling."""


def intersect_files(rays: Ray, files: DemFiles, *, max_posts: int = MAX_POSTS) -> Fix:
    """First intersections of rays with a DEM on disk, the same as `intersect` over the whole mosaic, ray by ray.

    `rays` is one `Ray` or a batch of any shape, ECEF, with unit directions; the `Fix` has that shape, and a status for
    each ray. Nearby rays are computed together, over windows of at most `max_posts`, one after another,
    their arrays padded to at most 2.25 times that (or 1024 x 1024): this and the rays bound the memory. Except for
    rounding, a result does not depend on which rays share its window.

    Not for use inside `jit` or for derivatives: for these use `files.corridor(rays)` and `intersect`.
    Raises `DemError` if a single ray needs more than `max_posts`, or a file cannot be read; `ValueError` for shapes;
    `TypeError` on float32.
    """
    check_is(rays, Ray, "rays")
    check_is(files, DemFiles, "files")
    rays = as_float64(Ray(as_array(rays.origin, "rays.origin"), as_array(rays.direction, "rays.direction")), "rays")
    shape = np.shape(rays.origin)[:-1]
    if np.shape(rays.origin)[-1:] != (3,) or np.shape(rays.direction) != np.shape(rays.origin):
        raise ValueError(
            f"rays must hold origins and directions of one shape (..., 3), ECEF; got {np.shape(rays.origin)} and "
            f"{np.shape(rays.direction)}."
        )
    flat = Ray(np.asarray(rays.origin).reshape(-1, 3), np.asarray(rays.direction).reshape(-1, 3))
    answers = no_answers(len(flat.origin))
    first = 0
    for part in in_parts(flat):
        _answer(part, files, max_posts, first, answers)
        first += len(part.origin)
    files.blocks.save()
    return jax.tree.map(lambda x: jnp.asarray(x.reshape(shape + x.shape[1:])), answers)


@accepts_observation
def locate_files(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike,
    files: DemFiles,
    *,
    time: ArrayLike | None = None,
    max_posts: int = MAX_POSTS,
) -> Fix:
    """Ground points of pixels `uv` (..., 2) = (column, row) of one image, over a DEM on disk.

    As `locate` for each pixel, of a shot or of the image at `time` on a trajectory; with the limits and errors of
    `intersect_files`.
    """
    moving = checked_exposure(sensor, shot, time)
    pixels = as_float64(given_array(uv, "uv", "the pixels (column, row)"), "uv")
    if pixels.shape[-1:] != (2,):
        raise ValueError(f"uv must be pixels (column, row) of shape (..., 2); got shape {pixels.shape}.")
    rays, status = lines_of_sight(*moving, np.asarray(pixels).reshape(-1, 2))
    seen = status == Status.hit
    fix = intersect_files(Ray(jnp.asarray(rays.origin), jnp.asarray(rays.direction)), files, max_posts=max_posts)
    fix = Fix(*(getattr(fix, name) for name in _NUMBERS), status=jnp.where(seen, fix.status, status))
    return jax.tree.map(lambda x: x.reshape(pixels.shape[:-1] + x.shape[1:]), fix)


_NUMBERS = ("position", "ecef", "slant_range", "incidence_ellipsoid", "incidence_surface", "slope")
_hits = jax.jit(jax.vmap(intersect, in_axes=(0, None)))


def lines_of_sight(sensor: Sensor, shot: Shot | Trajectory, time: Any, uv: np.ndarray) -> tuple[Ray, np.ndarray]:
    """Lines of sight of pixels (n, 2) in ECEF, and the status of each; without one they point away from the Earth."""
    origin, direction, status = (np.asarray(x) for x in _lines_of_sight(sensor, shot, time, jnp.asarray(uv)))
    seen = (status == Status.hit)[:, None]
    away = np.array([1.0, 0.0, 0.0])
    return Ray(np.where(seen, origin, 3e7 * away), np.where(seen, direction, away)), status


@jax.jit
def _lines_of_sight(
    sensor: Sensor, shot: Shot | Trajectory, time: jax.Array, uv: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    return jax.vmap(line_of_sight, in_axes=(None, None, None, 0))(sensor, shot, time, uv)


def no_answers(count: int) -> Any:
    """An unfilled fix of NumPy arrays."""
    nan = lambda *shape: np.full((count, *shape), np.nan)  # noqa: E731
    position = Geodetic(lat=nan(), lon=nan(), height=nan())
    status = np.full(count, Status.invalid_input.value, np.int8)
    return Fix(position, nan(3), nan(), nan(), nan(), nan(), status)


def _answer(rays: Ray, files: DemFiles, max_posts: int, first: int, answers: Fix) -> None:
    """Compute the results for a part of the rays, which begins at `first`."""
    rays, status, windows = windows_of(rays, files, max_posts, lambda ray: f"ray {first + ray} alone")
    np.asarray(answers.status)[first : first + len(status)] = status
    for index, window, whole in windows:
        dem = files.load(window, whole_ceiling=whole, max_posts=max_posts)
        ready = padded_rays(Ray(rays.origin[index], rays.direction[index]))
        fix = _hits(ready, dem)
        del dem
        _put(answers, first + index, fix)


def windows_of(
    rays: Ray, files: DemFiles, max_posts: int, name_of: Callable[[int], str]
) -> tuple[Ray, np.ndarray, Iterator[Batch]]:
    """Windows for rays (n, 3), each for nearby ones, so that no ray crosses its window's edge before its first hit.

    Returns the rays, invalid ones replaced by others that see nothing; the status of each without a window; and an
    iterator of (indices of rays, window, whether it needs the whole mosaic's ceiling), which raises `DemError` for a
    ray, named by `name_of`, whose window is too large.
    """
    count = len(rays.origin)
    length = np.linalg.norm(rays.direction, axis=1)
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(rays.origin).all(axis=1) & (np.abs(length - 1.0) <= UNIT_TOLERANCE)
    away = np.array([3e7, 0.0, 0.0])
    rays = Ray(np.where(valid[:, None], rays.origin, away), np.where(valid[:, None], rays.direction, away / 3e7))
    path = files.follow(rays)
    status = np.full(count, Status.rises_away.value, np.int8)
    is_open = path.exists & ~path.is_simple
    if is_open.any():
        leaves, misses = _beside(rays, files, is_open)
        status[misses], status[leaves] = Status.ray_misses_terrain.value, Status.leaves_terrain.value
        is_open &= ~leaves
    parts = (np.flatnonzero(path.exists & path.is_simple), np.flatnonzero(is_open))
    windows = (found for which in parts for found in _batches(which, path, files, max_posts, name_of))
    return rays, np.where(valid, status, Status.invalid_input.value), windows


def _put(answers: Fix, where: np.ndarray, fix: Fix) -> None:
    for all_, some in zip(jax.tree.leaves(answers), jax.tree.leaves(fix), strict=True):
        all_[where] = np.asarray(some)[: len(where)]


def _beside(rays: Ray, files: DemFiles, is_open: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rays that cross the mosaic's own edge: which leave it above its ceiling, and which of these may miss it."""
    index = np.flatnonzero(is_open)
    some = Ray(rays.origin[index], rays.direction[index])
    exists, is_over, was_over = comes_in(
        some, files.source.mapping, files.grid, files.blocks, files.ceiling + CEILING_MARGIN
    )
    leaves, misses = np.zeros(len(is_open), bool), np.zeros(len(is_open), bool)
    leaves[index], misses[index] = exists & ~is_over & was_over, exists
    return leaves, misses


def _batches(
    which: np.ndarray, path: Sightlines, files: DemFiles, max_posts: int, name_of: Callable[[int], str]
) -> Iterator[Batch]:
    """Groups of rays, each with a window that is not too large; rays that need none are left out."""
    middles = _middles(path)
    waiting = [which] if which.size else []
    while waiting:
        index = waiting.pop()
        window, whole = files.window_under(path.take(index))
        if window is None:
            continue
        is_too_large = files.too_large(window, max_posts)
        if is_too_large and index.size == 1:
            raise files.refuse(window, max_posts, name_of(int(index[0])))
        if is_too_large or _is_worth_splitting(window, index, middles, path, files):
            waiting += _halves(index, middles)
        else:
            yield index, window, whole


def _middles(path: Sightlines) -> np.ndarray:
    """(row, col) of the centre of the region where each ray may hit the ground, (n, 2)."""
    weight = path.touches[..., None] + 1e-9 * path.exists[:, None, None]
    return (weight * 0.5 * (path.low + path.high)).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)


def _halves(index: np.ndarray, middles: np.ndarray) -> list[np.ndarray]:
    """Rays split in two groups of equal size across the direction of their larger spread."""
    axis = int(np.argmax(np.ptp(middles[index], axis=0)))
    order = index[np.argsort(middles[index, axis], kind="stable")]
    return [np.sort(half) for half in np.array_split(order, 2)]


def _is_worth_splitting(
    window: Window, index: np.ndarray, middles: np.ndarray, path: Sightlines, files: DemFiles
) -> bool:
    posts = int(np.prod(window.shape))
    if index.size < 2 or posts < WORTH_SPLITTING:
        return False
    halves = [files.window_under(path.take(half))[0] for half in _halves(index, middles)]
    return sum(int(np.prod(half.shape)) for half in halves if half is not None) < SAVING * posts
