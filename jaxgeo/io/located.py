"""Fixes of observations and their accuracy, batch by batch in bounded memory and with few compiled programs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

from jaxgeo._compile import MOST_ROWS, long_run_filter_jit, maps_in_blocks
from jaxgeo._locate import locate
from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io.observations import ObservationBatch, Observations, axes_of
from jaxgeo.observation import Observation
from jaxgeo.sensor import Shot
from jaxgeo.status import Status, have_fix
from jaxgeo.terrain import AbstractTerrain, ConstantHeight
from jaxgeo.uncertainty import Accuracy, Sampling, accuracy
from jaxgeo.uncertainty._accuracy import SAMPLES
from jaxgeo.uncertainty.many_exposures import variances_by_axis
from jaxgeo.uncertainty.sources import AbstractSource

CHUNKS = (1, 16, 1024)  # fixes computed at a time: few shapes, few compilations
FEW = 20  # up to this many fixes, each gets the full number of samples
SAMPLES_OF_MANY = 2000  # per fix if there are more; radii are then good to about 3 %
ARRAYS = (
    *("probability", "circular", "linear", "spherical", "method", "cov_enu", "bias_enu", "failed"),
    "diagnostics",
)  # of an `Accuracy`, except its fixes

Terrain = AbstractTerrain | Sequence[AbstractTerrain]


def locate_observations(
    observed: Observations, terrain: Terrain, *, progress: Callable[[int, int], object] | None = None
) -> Fix:
    """Fixes of all rows (n,) as NumPy arrays; rows whose file could not be read have the status `file_not_read`.

    `terrain` is one for all, or one per batch; a `ConstantHeight` of n heights has one per pixel of its batch.
    `progress` is called with the number of pixels done and their total.
    """
    total, done, each = sum(map(len, observed.batches)), 0, []
    for batch, ground in batches_with_terrain(observed, terrain):
        parts = []
        for fixes in fixes_in_parts(batch, ground):
            parts.append(fixes)
            done += len(fixes.status)
            if progress is not None:
                progress(done, total)
        each.append(jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts))
    return _spread(each, [batch.rows for batch in observed.batches], len(observed), Status.file_not_read)


def accuracy_of_observations(
    observed: Observations,
    terrain: Terrain,
    fixes: Fix,
    *,
    probability: float = 0.9,
    count: int | None = None,
    progress: bool = False,
) -> Accuracy | None:
    """Accuracy of the `fixes` of `locate_observations`, NaN for rows without a fix; None if no row has one.

    The error sources are those of the observations. Where samples are needed, `count` are drawn for each fix: by
    default 20 000 for at most 20 rows and 2000 for more, which gives radii to about 3 %. `progress` shows
    progress bars. Raises as `accuracy`.
    """
    count = (SAMPLES_OF_MANY if len(observed) > FEW else SAMPLES) if count is None else count
    has_fix = have_fix(fixes.status)
    sampling, found, rows = Sampling(count=count, progress=progress), [], []
    for batch, ground in batches_with_terrain(observed, terrain):
        index = np.flatnonzero(has_fix[batch.rows])
        if not len(index):
            continue
        found.append(_accuracy_of(batch, ground, index, probability, sampling))
        rows.append(batch.rows[index])
    if not found:
        return None
    return spread(found, rows, fixes)


def located_with_accuracy(
    observed: Observations, terrain: Terrain, probability: float
) -> tuple[Fix, Accuracy | None] | None:
    """The fix of a single row and its accuracy, by one terrain search for both; None if there are more rows, or other
    rows than one on an image. The accuracy is None without a fix."""
    if len(observed) != 1 or len(observed.batches) != 1 or not observed.batches[0].is_on_image.all():
        return None
    ((batch, ground),) = batches_with_terrain(observed, terrain)
    found = _accuracy_of(batch, ground, np.arange(1), probability, Sampling(count=SAMPLES))
    fix = jax.tree.map(np.asarray, found.fix)
    return fix, dataclasses.replace(found, fix=fix, **_arrays(found)) if have_fix(fix.status).all() else None


def horizontal_variances(
    observed: Observations, terrain: Terrain, fixes: Fix, row: int
) -> tuple[tuple[AbstractSource, ...], np.ndarray]:
    """(error sources of a row, horizontal variance in m2 of its fix by each axis of their errors).

    By linear propagation with the programs of `accuracy_of_observations`; raises as `Observations.place`.
    """
    number, place = observed.place(row)
    batch, ground = list(batches_with_terrain(observed, terrain))[number]
    index = np.flatnonzero(have_fix(fixes.status)[batch.rows])
    given, in_axes, atmosphere = _arguments(batch, ground, index)
    at = int(np.searchsorted(index, place))
    return batch.at(place)[1], variances_by_axis((*given, None, atmosphere), in_axes, at)


def _accuracy_of(
    batch: ObservationBatch, ground: AbstractTerrain, index: np.ndarray, probability: float, sampling: Sampling
) -> Accuracy:
    """Accuracy of several rows of a batch."""
    given, in_axes, atmosphere = _arguments(batch, ground, index)
    return accuracy(*given, in_axes=in_axes, probability=probability, sampling=sampling, atmosphere=atmosphere)


def _arguments(
    batch: ObservationBatch, ground: AbstractTerrain, index: np.ndarray
) -> tuple[tuple[Any, ...], tuple[int | None, ...], Any]:
    """(sensor, shot, uv, terrain and errors; their axes; atmosphere) of several rows of a batch."""
    observation, sources = batch.at(index)
    exposure, own = observation.exposure, None if batch.is_one_camera else 0
    assert isinstance(exposure.motion, Shot)
    given = exposure.sensor, exposure.motion, observation.uv, terrain_at(ground, index), sources
    return given, (own, 0, 0, axis_of(ground), own), exposure.atmosphere


def fixes_in_parts(batch: ObservationBatch, terrain: AbstractTerrain, *, size: int | None = None) -> Iterator[Fix]:
    """Fixes of consecutive parts of a batch, as they are computed, `size` at a time (default: one of `CHUNKS`)."""
    total = len(batch)
    if _are_all_outside(batch):  # needs no compilation
        yield _outside(total)
        return
    size = next((size for size in CHUNKS if size >= total), CHUNKS[-1]) if size is None else size
    if size == 1:
        yield jax.tree.map(lambda leaf: np.asarray(leaf)[None], locate(batch.at(0)[0], terrain_at(terrain, 0)))
        return
    own = [leaf for axis, leaf in zip(*map(_leaves, (batch.in_axes, batch.observation)), strict=True) if axis == 0]
    located = _located if total <= MOST_ROWS and maps_in_blocks(own) else _located_long
    for start in range(0, total, size):
        index = np.minimum(np.arange(start, start + size), total - 1)
        fixes = located(batch.at(index)[0], terrain_at(terrain, index), batch.is_one_camera, axis_of(terrain))
        yield jax.tree.map(lambda leaf, last=total - start: np.asarray(leaf)[:last], fixes)


def _located(observation: Observation, terrain: AbstractTerrain, is_one_camera: bool, axis: int | None) -> Fix:
    """Fixes of a part, by the programs of every `vmap` of `locate`."""
    return jax.vmap(locate, in_axes=(axes_of(observation, is_one_camera), axis))(observation, terrain)


_located_long = long_run_filter_jit(_located)  # a program of its own, which is quicker to run


def _leaves(tree: Any) -> list[Any]:
    return jax.tree.leaves(tree, is_leaf=lambda leaf: leaf is None)


def batches_with_terrain(
    observed: Observations, terrain: Terrain
) -> Iterator[tuple[ObservationBatch, AbstractTerrain]]:
    """The batches of observations, each with its terrain."""
    each = [terrain] * len(observed.batches) if isinstance(terrain, AbstractTerrain) else terrain
    yield from zip(observed.batches, each, strict=True)


def axis_of(terrain: AbstractTerrain) -> int | None:
    """Axis of a terrain for `jax.vmap`: 0 for level ground with a height per pixel, else None."""
    return 0 if isinstance(terrain, ConstantHeight) and np.ndim(terrain.height) == 1 else None


def terrain_at(terrain: AbstractTerrain, index: int | np.ndarray) -> AbstractTerrain:
    """The terrain of one or several pixels."""
    return terrain if axis_of(terrain) is None else jax.tree.map(lambda leaf: np.asarray(leaf)[index], terrain)


def _are_all_outside(batch: ObservationBatch) -> bool:
    """Whether all pixels lie outside the image and all inputs are finite."""
    leaves = jax.tree.leaves(batch.observation)
    return all(np.isfinite(np.asarray(leaf)).all() for leaf in leaves) and not batch.is_on_image.any()


def _outside(count: int) -> Fix:
    """Fixes of `count` pixels outside the image."""
    unknown, status = np.full(count, np.nan), np.full(count, Status.outside_image, np.int8)
    position = Geodetic(lat=unknown, lon=unknown, height=unknown)
    return Fix(position, np.full((count, 3), np.nan), unknown, unknown, unknown, unknown, status)


def _spread(each: Sequence[Any], rows: Sequence[np.ndarray], count: int, code: int) -> Any:
    """Arrays of batches in their rows among `count`; the other rows are NaN, or `code` for integers."""
    where = np.concatenate(rows)

    def spread(*parts: np.ndarray) -> np.ndarray:
        first = parts[0]
        whole = np.full((count, *first.shape[1:]), np.nan if first.dtype.kind == "f" else code, first.dtype)
        whole[where] = np.concatenate(parts)
        return whole

    return jax.tree.map(spread, *each)


def spread(each: Sequence[Accuracy], rows: Sequence[np.ndarray], fixes: Fix) -> Accuracy:
    """Accuracies of parts of the fixes (n,), given the rows of each, as one; NaN for the other rows."""
    arrays = _spread([_arrays(one) for one in each], rows, len(np.asarray(fixes.status)), -1)
    return dataclasses.replace(each[0], fix=fixes, **arrays)


def _arrays(of: Accuracy) -> dict[str, Any]:
    """The arrays of an accuracy except its fixes, as NumPy arrays."""
    return {name: jax.tree.map(np.asarray, getattr(of, name)) for name in ARRAYS}


def take_rows(fixes: Fix, of: Accuracy | None, rows: np.ndarray) -> tuple[Fix, Accuracy | None]:
    """Fixes and their accuracy of some rows."""
    fixes = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], fixes)
    if of is None:
        return fixes, None
    return fixes, dataclasses.replace(of, fix=fixes, **jax.tree.map(lambda leaf: leaf[rows], _arrays(of)))
