"""Fixes of many frames and their accuracy, in parts by place, as a dataset of GeoParquet files."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import pathlib
import socket
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo._digest import digest_of
from jaxgeo._parallel import Work
from jaxgeo.cluster.parts import MANIFEST, Parts, Run, named, progress_bar, reason_of
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io.errors import DemError
from jaxgeo.io.files import DemFiles
from jaxgeo.io.fix_parts import FixParts, write_summary
from jaxgeo.io.located import (
    FEW,
    SAMPLES_OF_MANY,
    accuracy_of_observations,
    axis_of,
    locate_observations,
    spread,
    terrain_at,
)
from jaxgeo.io.located_over_files import AccuracyOptions, Located, check_straight, locate_over_files, rays_of
from jaxgeo.io.observations import ObservationBatch, Observations
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, ConstantHeight
from jaxgeo.uncertainty import Accuracy
from jaxgeo.uncertainty._accuracy import SAMPLES
from jaxgeo.uncertainty.map_cells import check_level

ROWS = 256  # frames of a part
MARGIN = 1000.0  # m, of ground read around that of the fixes, for their errors
CELL = 16  # posts: frames are ordered by squares of the mosaic of this size
KIND = "fixes"
PARQUET = b"PAR1"  # its first and last bytes

Ground = AbstractTerrain | DemFiles


class Part(NamedTuple):
    """Rows of the whole, in order; their observations and own level ground, or the reasons why they have none."""

    rows: np.ndarray
    observed: Observations | None
    ground: AbstractTerrain | None
    columns: list[dict[str, Any]]
    reasons: list[str | None]


class Setting(NamedTuple):
    """What the computation of all parts has in common."""

    ground: Ground | None
    accuracy: AccuracyOptions | None
    margin: float


class Files(NamedTuple):
    """Where parts are written, and how; what their computation has in common."""

    folder: pathlib.Path
    files: FixParts
    setting: Setting


def locate_frames(
    folder: str | os.PathLike[str],
    observed: Observations,
    terrain: Ground | Sequence[AbstractTerrain],
    *,
    client: Any = None,
    accuracy: bool = False,
    probability: float = 0.9,
    count: int | None = None,
    rows: int = ROWS,
    margin: float = MARGIN,
    crs: Any = "EPSG:4326",
    heights: Any = None,
    ellipses: bool = True,
    mgrs: bool = False,
    progress: bool = False,
) -> Run:
    """Fixes of all rows of `observed`, and their accuracy, as a dataset of GeoParquet files in `folder`.

    - `terrain`: that of `locate_observations`, or a DEM on disk (`jaxgeo.io.open_dem`): a part of the frames reads a
      window of it once. For a mosaic with voids give `open_dem` a `void_ceiling`, or each worker reads all of it.
    - `client`: a Dask `Client` (`connect`), any `concurrent.futures.Executor`, or None for this process. The results do
      not depend on it, except that rounding may differ between kinds of processors.
    - `accuracy`: also the accuracy, with `probability` and `count` of samples as `accuracy_of_observations`.
    - `rows`: largest number of frames of a part, a file. Frames over a DEM on disk are ordered by place, others as
      given; the column `index` is the row in `observed`. `margin`: see `locate_over_files`.
    - `crs`, `heights`, `ellipses`, `mgrs`: as for `write_fixes`; the columns are the same.

    Workers write into `folder`, which all must see. Parts appear when they are whole; a later call with the same
    arguments computes only those that are missing. `_manifest.json` lists all parts; `_metadata` is for readers of
    datasets (pyarrow, DuckDB, GeoPandas, GDAL). A file of `observed` that could not be read is a row with its reason.

    Raises `PartsFailed` if parts could not be computed, after the others are; `ValueError` for arguments that
    contradict each other, and a folder that holds something else; otherwise as `write_fixes`.
    """
    observed, setting = _checked(observed, terrain, accuracy, probability, count, rows, margin)
    files = FixParts.of(
        observed.position,
        observed.columns,
        crs=crs,
        heights=heights,
        mgrs=mgrs,
        ellipses=ellipses,
        probability=probability if accuracy else None,
        is_above_takeoff=observed.is_above_takeoff,
    )
    each = parts_of(observed, terrain, int(rows))
    written = Files(pathlib.Path(folder).absolute(), files, setting)
    names = named("part-", len(each), ".parquet")
    parts = Parts(written.folder, KIND, identity(observed, terrain, written, int(rows)), names)
    missing = set(parts.open(_is_whole))
    given = {name: part for name, part in zip(names, each, strict=True) if name in missing}
    finish = functools.partial(write_summary, written.folder)
    return parts.compute(given, Work(_written_parts, written), client, progress, finish, lambda part: len(part.rows))


def fixes_of_frames(
    observed: Observations,
    terrain: Ground | Sequence[AbstractTerrain],
    *,
    client: Any = None,
    accuracy: bool = False,
    probability: float = 0.9,
    count: int | None = None,
    rows: int = ROWS,
    margin: float = MARGIN,
    progress: bool = False,
) -> tuple[Fix, Accuracy | None]:
    """The fixes of `locate_frames` and their accuracy in memory, without files; None for the accuracy of no fix.

    Arguments as for `locate_frames`. Rows are those of `observed`; a frame that is refused has the status
    `invalid_input`. Raises `RuntimeError` if parts could not be computed, after the others are; `ConnectionError` if
    the cluster ends; otherwise as `locate_frames`.
    """
    observed, setting = _checked(observed, terrain, accuracy, probability, count, rows, margin)
    each = parts_of(observed, terrain, int(rows))
    found: list[tuple[Part, Located]] = []
    failed: list[str] = []
    with progress_bar(progress, len(observed)) as advance:
        for part, future in Work(_located_parts, setting).results(each, client):
            try:
                found.append((part, future.result()))
            except CancelledError:
                raise ConnectionError("the cluster has ended before all frames were located; call again.") from None
            except Exception as error:
                failed.append(reason_of(error))
            advance(len(part.rows), len(failed))
    if failed:
        raise RuntimeError(f"{len(failed)} of {len(each)} parts failed; the first: {failed[0]}")
    place = np.argsort(np.concatenate([part.rows for part, _ in found]))
    fixes = jax.tree.map(lambda *leaves: np.concatenate(leaves)[place], *(one.fixes for _, one in found))
    own = [(part.rows, one.accuracy) for part, one in found if one.accuracy is not None]
    return fixes, spread([one for _, one in own], [rows for rows, _ in own], fixes) if own else None


def _checked(
    observed: Observations,
    terrain: Any,
    accuracy: bool,
    probability: float,
    count: int | None,
    rows: int,
    margin: float,
) -> tuple[Observations, Setting]:
    """(observations with latitudes up to the poles, what all parts have in common). Raises `ValueError`."""
    require_x64()
    if isinstance(rows, bool) or not isinstance(rows, int | np.integer) or rows < 1:
        raise ValueError(
            f"rows must be an integer of at least 1, the largest number of frames of a part; got {rows!r}."
        )
    if not (math.isfinite(margin) and margin >= 0.0):
        raise ValueError(f"margin must be a distance in m, 0 or more; got {margin!r}.")
    if not observed.batches:
        raise ValueError("observed has no frame that could be read.")
    check_straight(terrain, observed.atmosphere)
    if accuracy:
        check_level(probability)
    if count is not None and (isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1):
        raise ValueError(f"count must be an integer of at least 1, samples of a fix; got {count!r}.")
    count = (SAMPLES_OF_MANY if len(observed) > FEW else SAMPLES) if count is None else count
    options = AccuracyOptions(float(probability), int(count)) if accuracy else None
    shared = terrain if isinstance(terrain, AbstractTerrain | DemFiles) else None
    if isinstance(shared, AbstractTerrain) and axis_of(shared) == 0:
        shared = None
    return _with_latitudes(observed), Setting(shared, options, float(margin))


def parts_of(observed: Observations, terrain: Ground | Sequence[AbstractTerrain], rows: int) -> list[Part]:
    """The frames in parts of at most `rows` of one batch; over a DEM on disk those of a part are near each other."""
    reasons = observed.reasons or [None] * len(observed)
    each = list(terrain) if isinstance(terrain, Sequence) else [terrain] * len(observed.batches)
    parts = []
    for number, (batch, ground) in enumerate(zip(observed.batches, each, strict=True)):
        if isinstance(ground, ConstantHeight) and np.size(ground.height) not in (1, len(batch)):
            raise ValueError(
                f"terrain: batch {number} has {len(batch)} frames, and its ground {np.size(ground.height)} heights."
            )
        order = np.arange(len(batch)) if not isinstance(ground, DemFiles) else _order(batch, ground)
        for index in np.array_split(order, -(-len(batch) // rows)):
            some = observed.part(number, index)
            is_own = not isinstance(ground, DemFiles) and (isinstance(terrain, Sequence) or axis_of(ground) == 0)
            own = terrain_at(ground, index) if is_own else None  # pyright: ignore
            parts.append(Part(batch.rows[index], some, own, some.columns, [None] * len(index)))
    for some in _split(np.array(sorted(observed.unread), int), rows):
        told = [reasons[row] for row in some.tolist()]
        parts.append(Part(some, None, None, [observed.columns[row] for row in some.tolist()], told))
    return parts


def _with_latitudes(observed: Observations) -> Observations:
    """Observations with NaN for latitudes beyond the poles, where there is nothing: `locate` does not look at them."""

    def of_poles(batch: ObservationBatch) -> ObservationBatch:
        lat = np.asarray(batch.shots.pose.position.lat)
        lat = np.where(np.abs(lat) <= 0.5 * np.pi, lat, np.nan)
        place: Any = lambda one: one.exposure.motion.pose.position.lat  # noqa: E731
        return dataclasses.replace(batch, observation=eqx.tree_at(place, batch.observation, lat))

    return dataclasses.replace(observed, batches=tuple(map(of_poles, observed.batches)))


def _is_whole(path: pathlib.Path) -> bool:
    """Whether a file ends as a Parquet file does."""
    if not path.exists() or path.stat().st_size < 2 * len(PARQUET):
        return False
    with path.open("rb") as file:
        file.seek(-len(PARQUET), os.SEEK_END)
        return file.read() == PARQUET


def _split(rows: np.ndarray, most: int) -> list[np.ndarray]:
    return np.array_split(rows, -(-len(rows) // most)) if len(rows) else []


def _order(batch: Any, files: DemFiles) -> np.ndarray:
    """Indices of the frames of a batch by the squares of a mosaic that they look at, along a Z-shaped curve."""
    rays, _ = rays_of(batch)
    stretch = np.array([1.0, 1.0, float(WGS84.a / WGS84.b)])  # the ellipsoid as a sphere
    origin, direction = np.asarray(rays.origin) * stretch, np.asarray(rays.direction) * stretch
    squared, along = np.sum(direction**2, axis=1), np.sum(origin * direction, axis=1)
    off = along**2 - squared * (np.sum(origin**2, axis=1) - float(WGS84.a) ** 2)
    there = np.maximum(-along - np.sqrt(np.maximum(off, 0.0)), 0.0) / squared  # at the closest point beside the Earth
    place = origin + there[:, None] * direction
    lon = np.degrees(np.arctan2(place[:, 1], place[:, 0]))
    lat = np.degrees(np.arctan2(stretch[2] * place[:, 2], np.hypot(place[:, 0], place[:, 1])))
    with np.errstate(invalid="ignore"):
        row, col = files.source.mapping.rowcol(lon, lat)
        cells = [np.clip(np.nan_to_num(x) / CELL + (1 << 20), 0, (1 << 21) - 1).astype(np.int64) for x in (row, col)]
    return np.argsort(_spread_bits(cells[0]) | _spread_bits(cells[1]) << 1, kind="stable")


def _spread_bits(numbers: np.ndarray) -> np.ndarray:
    """Whole numbers of 21 bits with a zero bit after each."""
    found = np.zeros_like(numbers)
    for bit in range(21):
        found |= ((numbers >> bit) & 1) << (2 * bit)
    return found


def identity(observed: Observations, terrain: Any, written: Files, rows: int) -> dict[str, str]:
    """What results depend on, by name."""
    setting = written.setting
    has_errors = setting.accuracy is not None
    batches = [
        (one.observation, one.sources if has_errors else None, one.rows, one.is_one_camera) for one in observed.batches
    ]
    ground, out = terrain.identity if isinstance(terrain, DemFiles) else terrain, written.files
    return {
        "frames": digest_of((batches, repr(observed.columns), observed.reasons)),
        "terrain": digest_of(ground),
        "accuracy": str(setting.accuracy and tuple(setting.accuracy)),
        "output": digest_of((f"{out.crs!r} {out.heights!r}", out.mgrs, out.ellipses) + (True,) * out.is_above_takeoff),
        "rows of a part": str(rows),
        "margin": f"{setting.margin!r} m" if has_errors and isinstance(terrain, DemFiles) else "",
    }


def _located_parts(setting: Setting) -> Callable[[Part], Located]:
    return functools.partial(_found_of_all, setting)


def _written_parts(written: Files) -> Callable[[tuple[str, Part]], dict[str, int]]:
    return functools.partial(_write_part, written)


def _write_part(written: Files, item: tuple[str, Part]) -> dict[str, int]:
    """Compute and write a part; returns the count of each status by name."""
    name, part = item
    check_seen(written.folder)
    found = _found_of_all(written.setting, part)
    written.files.write(written.folder / name, found.fixes, found.accuracy, part.rows, part.columns, found.reasons)
    return dict(Counter(Status(int(code)).name for code in np.asarray(found.fixes.status)))


def _found_of_all(setting: Setting, part: Part) -> Located:
    """The fixes of a part; a frame that is refused is a row with its reason."""
    try:
        return _found(setting, part)
    except DemError:  # of the terrain; another run may find it in order
        raise
    except ValueError as error:
        if part.observed is None or len(part.rows) == 1:
            return Located(_without_fix(len(part.rows), Status.invalid_input), None, [str(error)] * len(part.rows))
    each = [_found_of_all(setting, _row(part, k)) for k in range(len(part.rows))]
    fixes = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(one.fixes for one in each))
    own = [(np.array([k]), one.accuracy) for k, one in enumerate(each) if one.accuracy is not None]
    accuracy = spread([one for _, one in own], [rows for rows, _ in own], fixes) if own else None
    return Located(fixes, accuracy, [one.reasons[0] for one in each])


def _row(part: Part, k: int) -> Part:
    """One row of a part."""
    assert part.observed is not None
    own = None if part.ground is None else terrain_at(part.ground, np.array([k]))
    return Part(part.rows[[k]], part.observed.part(0, np.array([k])), own, [part.columns[k]], [part.reasons[k]])


def _found(setting: Setting, part: Part) -> Located:
    if part.observed is None:
        return Located(_without_fix(len(part.rows), Status.file_not_read), None, part.reasons)
    ground = setting.ground if part.ground is None else part.ground
    if isinstance(ground, DemFiles):
        margin = 0.0 if setting.accuracy is None else setting.margin
        return locate_over_files(part.observed, ground, setting.accuracy, margin=margin)
    assert ground is not None
    grounds = [ground]
    fixes = locate_observations(part.observed, grounds)
    if setting.accuracy is None:
        return Located(fixes, None, part.reasons)
    probability, count = setting.accuracy
    own = accuracy_of_observations(part.observed, grounds, fixes, probability=probability, count=count)
    return Located(fixes, own, part.reasons)


def check_seen(folder: pathlib.Path) -> None:
    """Raise `FileNotFoundError` if this process does not see the folder of a run."""
    if not (folder / MANIFEST).exists():
        raise FileNotFoundError(
            f"{folder}: not seen by the worker on {socket.gethostname()}; give a folder on a file system that all "
            f"workers share."
        )


def _without_fix(count: int, status: Status) -> Fix:
    """Fixes of frames that have none."""
    unknown, codes = np.full(count, np.nan), np.full(count, status, np.int8)
    position = Geodetic(lat=unknown, lon=unknown, height=unknown)
    return Fix(position, np.full((count, 3), np.nan), unknown, unknown, unknown, unknown, codes)
