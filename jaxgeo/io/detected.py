"""Detections as observations: a pixel of an exposure for each, and its outline on the ground."""

from __future__ import annotations

import dataclasses
import pathlib
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxgeo.fix import Fix
from jaxgeo.io.acquisitions import Unread
from jaxgeo.io.detections import Detection
from jaxgeo.io.errors import TableError
from jaxgeo.io.observations import ObservationBatch, Observations, frame_camera_of
from jaxgeo.observation import Observation
from jaxgeo.status import Status, counts_as_fix

ANCHORS = ("centre", "bottom")
PIECES = 32  # of an outline, at least: edges are straight in the image, and follow the ground in these pieces
INPUTS = ("name", "time_s", "u", "v")  # columns that attributes of a detection do not replace


@dataclasses.dataclass(frozen=True)
class DetectedOutlines:
    """Outlines of boxes and polygons on the ground: for each detection its ring (n, 3) of longitude and latitude in deg
    and height above the ellipsoid in m, or None; and the status of the first point without a fix, else `hit`. None for
    points."""

    rings: list[np.ndarray | None]
    statuses: list[str | None]


def observations_of_detections(
    observed: Observations, detections: Sequence[Detection], *, anchor: str = "centre"
) -> tuple[Observations, list[np.ndarray]]:
    """(a row for each detection, its vertices (n, 2) in pixels) in exposures that were read with one pixel each.

    Exposures are found by name: as written, else without folders, else without extension. A detection in an image that
    is not among them, or is so twice, becomes a row that is `unread`. `anchor` is the pixel that is located of a box or
    polygon: its "centre", or the middle of its lower edge ("bottom"), where an upright object stands.

    Raises `ValueError` for another anchor, `TableError` if no detection is in any of the exposures.
    """
    if anchor not in ANCHORS:
        raise ValueError(f"anchor must be 'centre' or 'bottom'; got {anchor!r}.")
    rows_of = _rows_by_name(observed)
    where = {int(row): (k, i) for k, batch in enumerate(observed.batches) for i, row in enumerate(batch.rows)}
    lanes: list[list[tuple[int, int]]] = [[] for _ in observed.batches]
    columns: list[dict[str, Any]] = []
    vertices: list[np.ndarray] = []
    unread: dict[int, Unread] = {}
    pixels: list[np.ndarray] = []
    for number, one in enumerate(detections):
        found = _rows_named(one.image, rows_of)
        own = {name: value for name, value in one.attributes.items() if name not in INPUTS}
        place = where.get(found[0]) if len(found) == 1 else None
        if place is None:
            reason = "no exposure has this name" if not found else f"{len(found)} exposures have this name"
            failed = observed.unread.get(found[0]) if len(found) == 1 else None
            unread[number] = failed or Unread(one.image, _refused(f"{one.image}: {reason}."), number)
            columns.append({"name": one.image, "u": None, "v": None, **own})
            vertices.append(np.zeros((0, 2)))
            pixels.append(np.full(2, np.nan))
            continue
        batch, index = place
        camera = frame_camera_of(observed.batches[batch].sensor)
        corners = one.of_size(camera.width, camera.height)
        pixel = one.pixel_of(corners, anchor)
        lanes[batch].append((number, index))
        columns.append({**observed.columns[found[0]], "u": float(pixel[0]), "v": float(pixel[1]), **own})
        vertices.append(corners)
        pixels.append(pixel)
    if not any(lanes):
        names = ", ".join(sorted(rows_of)[:3])
        raise TableError(f"{detections[0].image}: no detection is in an image that was read, such as {names}.")
    batches = tuple(
        _batch(batch, np.array(lane), np.stack([pixels[row] for row, _ in lane]))
        for batch, lane in zip(observed.batches, lanes, strict=True)
        if lane
    )
    names = sorted({name for row in columns for name in row}, key=list(columns[0]).index if len(columns) == 1 else str)
    order = [name for name in INPUTS if name in names] + [name for name in names if name not in INPUTS]
    columns = [{name: row.get(name) for name in order} for row in columns]
    return dataclasses.replace(observed, batches=batches, columns=columns, unread=unread), vertices


def outline_observations(
    observed: Observations, vertices: Sequence[np.ndarray]
) -> tuple[Observations, list[np.ndarray]] | None:
    """(a row for each point of all outlines, for each detection its rows); None if all detections are points."""
    dense = [_dense(corners) if len(corners) > 2 else np.zeros((0, 2)) for corners in vertices]
    counts = np.array([len(one) for one in dense])
    if not counts.sum():
        return None
    ends = np.cumsum(counts)
    own = [np.arange(end - count, end) for end, count in zip(ends.tolist(), counts.tolist(), strict=True)]
    batches = []
    for batch in observed.batches:
        index = np.repeat(np.arange(len(batch)), counts[batch.rows])
        if not len(index):
            continue
        rows = np.concatenate([own[row] for row in batch.rows.tolist()])
        uv = np.concatenate([dense[row] for row in batch.rows.tolist()])
        batches.append(_batch(batch, np.stack([rows, index], axis=-1), uv))
    columns: list[dict[str, Any]] = [{} for _ in range(int(ends[-1]))]
    return dataclasses.replace(observed, batches=tuple(batches), columns=columns, unread={}), own


def outlines_on_ground(fixes: Fix, rows: Sequence[np.ndarray]) -> DetectedOutlines:
    """The outlines of detections, from the fixes of `outline_observations`."""
    lat, lon, height = (np.asarray(one) for one in fixes.position.to_degrees())
    places, codes = np.stack([lon, lat, height], axis=-1), np.asarray(fixes.status)
    known = np.asarray(counts_as_fix(jnp.asarray(codes))) & np.isfinite(places).all(axis=1)
    rings: list[np.ndarray | None] = []
    statuses: list[str | None] = []
    for own in rows:
        lost = own[~known[own]]
        rings.append(places[own] if len(own) and not len(lost) else None)
        statuses.append((Status(int(codes[lost[0]])) if len(lost) else Status.hit).name if len(own) else None)
    return DetectedOutlines(rings, statuses)


def _batch(batch: ObservationBatch, lanes: np.ndarray, uv: np.ndarray) -> ObservationBatch:
    """Pixels of exposures of a batch, given (row, index of the exposure) of each."""
    rows, index = lanes.T
    observation, sources = batch.at(index)
    heights = None if batch.centre_heights is None else batch.centre_heights[index]
    return ObservationBatch(Observation(observation.exposure, uv), sources, rows, batch.is_one_camera, heights)


def _dense(corners: np.ndarray) -> np.ndarray:
    """The ring of a polygon with points along its edges."""
    steps = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(steps, axis=1)
    pieces = np.maximum(np.ceil(PIECES * lengths / lengths.sum()).astype(int), 1)
    return np.concatenate(
        [start + step * np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
         for start, step, count in zip(corners, steps, pieces, strict=True)]
    )  # fmt: skip


def _refused(message: str) -> TableError:
    """A refusal as one that was raised."""
    try:
        raise TableError(message)
    except TableError as error:
        return error


def _rows_by_name(observed: Observations) -> dict[str, list[int]]:
    """Rows of exposures by name: as written, without folders, and without extension."""
    found: dict[str, list[int]] = {}
    for row, column in enumerate(observed.columns):
        name = str(column.get("name", row))
        for key in dict.fromkeys((name, pathlib.PurePath(name).name, pathlib.PurePath(name).stem)):
            found.setdefault(key, []).append(row)
    return found


def _rows_named(image: str, rows_of: dict[str, list[int]]) -> list[int]:
    path = pathlib.PurePosixPath(image.replace("\\", "/"))
    return next((rows_of[key] for key in (image, path.name, path.stem) if key in rows_of), [])
