"""Fixes of observations and their accuracy over a DEM on disk: nearby ones share a window of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import long_run_filter_jit
from jaxgeo.earth import Atmosphere
from jaxgeo.earth.ray import Ray
from jaxgeo.fix import Fix
from jaxgeo.io.errors import WindowTooLarge
from jaxgeo.io.files import MAX_POSTS, DemFiles
from jaxgeo.io.locate_on_disk import no_answers, windows_of
from jaxgeo.io.located import CHUNKS, accuracy_of_observations, locate_observations, spread, take_rows
from jaxgeo.io.observations import ObservationBatch, Observations, axes_of
from jaxgeo.io.windows import Window, square_shape
from jaxgeo.observation import Observation
from jaxgeo.sensor.exposure import line_of_sight
from jaxgeo.status import Status
from jaxgeo.terrain import Dem
from jaxgeo.uncertainty import Accuracy

WIDER = 4  # times the margin, if errors may reach its edge
SMALLEST, LARGEST = 250.0, 20_000.0  # m: margins between which it grows
REACH = 5.0  # times the larger of CE and LE: how far errors reach
FEWEST = 17  # rows, to which fewer are padded: one program for nearly all numbers of rows
AWAY = np.array([1.0, 0.0, 0.0])


class Located(NamedTuple):
    """Fixes of n rows as NumPy arrays, their accuracy if asked for and there is any fix, and reasons without a fix."""

    fixes: Fix
    accuracy: Accuracy | None
    reasons: list[str | None]


class AccuracyOptions(NamedTuple):
    """Probability of the radii, and the number of samples where they are needed."""

    probability: float
    count: int


def locate_over_files(
    observed: Observations,
    files: DemFiles,
    accuracy: AccuracyOptions | None = None,
    *,
    margin: float = 0.0,
    max_posts: int = MAX_POSTS,
) -> Located:
    """Fixes of the n pixels of a single batch over a DEM on disk, and their accuracy.

    Nearby pixels share a window, which is read once: it holds all ground that their rays can touch, and `margin` in m
    on each side for their errors. Where errors may reach farther, the window of these pixels is enlarged, up to 20 km;
    samples that leave it count as samples without a fix. A pixel whose ground is larger than `max_posts` has the status
    `leaves_terrain` and a reason.

    Raises `DemError` if a file cannot be read, `ValueError` for observations with an atmosphere: its rays are bent, and
    windows are those of straight ones.
    """
    (batch,) = observed.batches
    check_straight(files, observed.atmosphere)
    files = files.forgetful()
    rays, seen = rays_of(batch)
    fixes = no_answers(len(batch))
    reasons: list[str | None] = [None] * len(batch)
    found: list[tuple[np.ndarray, Accuracy]] = []
    status = np.full(len(batch), Status.invalid_input.value, np.int8)
    for rows, windows in _windows(rays, files, max_posts, status, reasons):
        for index, window, whole in windows:
            index = rows[index]
            for part, own in _answers(observed, rays, files, index, window, whole, accuracy, margin, max_posts):
                for all_, some in zip(jax.tree.leaves(fixes), jax.tree.leaves(own[0]), strict=True):
                    all_[part] = some
                status[part] = own[0].status
                if own[1] is not None:
                    found.append((part, own[1]))
    status = np.where(seen == Status.hit, status, seen)
    return Located(dataclasses.replace(fixes, status=status), _joined(found, fixes), reasons)


def window_over_files(observed: Observations, files: DemFiles, *, margin: float = SMALLEST) -> Dem:
    """The part of a DEM on disk that the pixels of a single batch may see, with a `margin` in m.

    Raises `ValueError` if their lines of sight pass none of it, or need more posts than `MAX_POSTS`; else as
    `locate_over_files`.
    """
    (batch,) = observed.batches
    check_straight(files, observed.atmosphere)
    rays, _ = rays_of(batch)
    _, _, windows = windows_of(rays, files, MAX_POSTS, lambda _: "its line of sight")
    found = list(windows)
    if len(found) != 1:
        raise ValueError(f"the lines of sight need {len(found)} parts of the elevation model; expected one.")
    index, window, whole = found[0]
    wider = _wider(rays, index, files, window, margin)
    taken = window if files.too_large(wider, MAX_POSTS) else wider
    return files.load(taken, whole_ceiling=whole, size=square_shape(taken.shape))


def check_straight(terrain: Any, atmosphere: Atmosphere | None) -> None:
    """Raise `ValueError` for an atmosphere over a DEM on disk, of which windows are read along straight rays."""
    if isinstance(terrain, DemFiles) and atmosphere is not None:
        raise ValueError(
            "an atmosphere bends rays, and a DEM on disk is read along straight ones: read the DEM with read_dem, or "
            "leave the atmosphere out."
        )


def rays_of(batch: ObservationBatch) -> tuple[Ray, np.ndarray]:
    """Lines of sight of the n pixels of a batch in ECEF, and the status of each."""
    parts, total, size = [], len(batch), CHUNKS[-1]
    for start in range(0, total, size):
        index = np.minimum(np.arange(start, start + size), total - 1)
        found = _lines_of_sight(batch.at(index)[0], batch.is_one_camera)
        parts.append([np.asarray(leaf)[: total - start] for leaf in found])
    origin, direction, status = (np.concatenate(each) for each in zip(*parts, strict=True))
    seen = (status == Status.hit)[:, None]
    return Ray(np.where(seen, origin, 3e7 * AWAY), np.where(seen, direction, AWAY)), status


@long_run_filter_jit
def _lines_of_sight(observation: Observation, is_one_camera: bool) -> tuple[jax.Array, jax.Array, jax.Array]:
    def one(own: Observation) -> tuple[jax.Array, jax.Array, jax.Array]:
        return line_of_sight(own.exposure.sensor, own.exposure.motion, jnp.asarray(0.0), own.uv)  # pyright: ignore

    return jax.vmap(one, in_axes=(axes_of(observation, is_one_camera),))(observation)


def _windows(
    rays: Ray, files: DemFiles, max_posts: int, status: np.ndarray, reasons: list[str | None]
) -> Iterator[tuple[np.ndarray, list[Any]]]:
    """(rows, windows for rays of these rows); of all together, or one by one if the ground of some is too large."""

    def found(rows: np.ndarray) -> list[Any]:
        some = Ray(np.asarray(rays.origin)[rows], np.asarray(rays.direction)[rows])
        _, own, windows = windows_of(some, files, max_posts, lambda _: "its line of sight")
        status[rows] = own
        return list(windows)

    every = np.arange(len(status))
    try:
        yield every, found(every)
        return
    except WindowTooLarge:
        pass
    for row in every:
        try:
            yield every[row : row + 1], found(every[row : row + 1])
        except WindowTooLarge as error:
            status[row], reasons[row] = Status.leaves_terrain, str(error)


def _answers(
    observed: Observations,
    rays: Ray,
    files: DemFiles,
    rows: np.ndarray,
    window: Window,
    whole: bool,
    options: AccuracyOptions | None,
    margin: float,
    max_posts: int,
) -> Iterator[tuple[np.ndarray, tuple[Fix, Accuracy | None]]]:
    """(rows, their answers) over a window, and over larger ones for rows whose errors may reach beyond it."""
    while True:
        wider = _wider(rays, rows, files, window, margin)
        is_too_large = wider != window and files.too_large(wider, max_posts)
        taken = window if is_too_large else wider
        dem = files.load(taken, whole_ceiling=whole, max_posts=max_posts, size=square_shape(taken.shape))
        some = observed.part(0, np.concatenate([rows, np.repeat(rows[-1:], max(FEWEST - len(rows), 0))]))
        fixes = locate_observations(some, dem)
        if options is None:
            yield rows, take_rows(fixes, None, np.arange(len(rows)))
            return
        own = accuracy_of_observations(some, dem, fixes, probability=options.probability, count=options.count)
        del dem
        fixes, own = take_rows(fixes, own, np.arange(len(rows)))
        if own is None:
            yield rows, (fixes, None)
            return
        beyond = reaches_beyond(own, margin)
        if is_too_large or taken.shape == files.shape or margin >= LARGEST:
            beyond = np.zeros_like(beyond)  # samples that leave the window count as without a fix
        if not beyond.all():
            yield rows[~beyond], take_rows(fixes, own, np.flatnonzero(~beyond))
        if not beyond.any():
            return
        rows, margin = rows[beyond], WIDER * max(margin, SMALLEST)


def _wider(rays: Ray, rows: np.ndarray, files: DemFiles, window: Window, margin: float) -> Window:
    """The window of some rays with a margin in m, in which higher ground may ask for a larger one."""
    if margin == 0.0:
        return window
    some = Ray(np.asarray(rays.origin)[rows], np.asarray(rays.direction)[rows])
    wider, _ = files.window_under(files.follow(some), margin=files.posts_of(window, margin))
    assert wider is not None
    return wider


def reaches_beyond(own: Accuracy, margin: float) -> np.ndarray:
    """Which rows' errors may reach beyond a margin in m: by their radii, or by samples without a fix."""
    has_fix = np.asarray(own.method) >= 0
    largest = np.maximum(np.asarray(own.circular), np.asarray(own.linear))
    with np.errstate(invalid="ignore"):
        return has_fix & (~(REACH * largest <= margin) | (np.asarray(own.failed) > 0.0))


def _joined(found: list[tuple[np.ndarray, Accuracy]], fixes: Fix) -> Accuracy | None:
    """Accuracies of parts of the rows as one, NaN for the others; None without any."""
    if not found:
        return None
    rows, each = [one for one, _ in found], [one for _, one in found]
    return spread(each, rows, fixes)
