"""Detections as observations: a pixel of an exposure for each, and its outline on the ground."""

from __future__ import annotations

import dataclasses
import os
import pathlib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxgeo.fix import Fix
from jaxgeo.io.acquisitions import Unread
from jaxgeo.io.detections import Detection
from jaxgeo.io.errors import TableError
from jaxgeo.io.located import Terrain, batches_with_terrain, terrain_at
from jaxgeo.io.observations import ObservationBatch, Observations, frame_camera_of
from jaxgeo.io.tables import FIX_COLUMNS
from jaxgeo.observation import Observation
from jaxgeo.status import Status, have_fix
from jaxgeo.terrain import AbstractTerrain

ANCHORS = ("centre", "bottom")
PIECES = 32  # of an outline, at least: edges are straight in the image, and follow the ground in these pieces
INPUTS = ("name", "time_s", "time_utc", "u", "v")  # columns of the exposures
FIGURE = re.compile(r"(ce|le|se)[0-9_]+_m|semi_.*|cov_.*|bias_.*")


Path = str | os.PathLike[str]


@dataclasses.dataclass(frozen=True)
class DetectedOutlines:
    """Outlines of boxes and polygons on the ground: for each detection its ring (n, 3) of longitude and latitude in deg
    and height above the ellipsoid in m, or None; and the status of the first point without a fix, else `hit`. None for
    points."""

    rings: list[np.ndarray | None]
    statuses: list[str | None]


def observations_of_detections(
    observed: Observations, detections: Sequence[Detection], *, anchor: str = "centre", files: Sequence[Path] = ()
) -> tuple[Observations, list[np.ndarray]]:
    """(a row for each detection, its vertices (n, 2) in pixels) in exposures that were read with one pixel each.

    Exposures are found by the name of their file, with or without extension, and with as many of its folders as a
    detection names; `files` are the files as they were read. A detection in an image that is not among them, or is so
    twice, becomes a row that is `unread`. Attributes of a detection that are named as a column of fixes become
    `detected_...`; `detected_as` is "point", "box" or "polygon". `anchor` is the pixel that is located of a box or
    polygon: its "centre", or the middle of its lower edge ("bottom"), where an upright object stands.

    Raises `ValueError` for another anchor, `TableError` if no detection is in any of the exposures.
    """
    if anchor not in ANCHORS:
        raise ValueError(f"anchor must be 'centre' or 'bottom'; got {anchor!r}.")
    rows_of = _rows_by_name(observed, files)
    where = {int(row): (k, i) for k, batch in enumerate(observed.batches) for i, row in enumerate(batch.rows)}
    lanes: list[list[tuple[int, int]]] = [[] for _ in observed.batches]
    columns: list[dict[str, Any]] = []
    vertices: list[np.ndarray] = []
    unread: dict[int, Unread] = {}
    pixels: list[np.ndarray] = []
    for number, one in enumerate(detections):
        found = _rows_named(one.image, rows_of)
        own = {f"detected_{name}" if _is_taken(name) else name: value for name, value in one.attributes.items()}
        own["detected_as"] = one.kind
        place = where.get(found[0]) if len(found) == 1 else None
        corners, refusal = np.zeros((0, 2)), None
        if place is None:
            several = f"{len(found)} exposures have this name; name the folder too"
            known = ", ".join(str(column.get("name", row)) for row, column in enumerate(observed.columns[:3]))
            more = ", ..." if len(observed.columns) > 3 else ""
            reason = several if found else f"no exposure has this name; known: {known}{more}"
            refusal = _refused(f"{one.image}: {reason}.")
        else:
            camera = frame_camera_of(observed.batches[place[0]].sensor)
            try:
                corners = one.of_size(camera.width, camera.height)
            except TableError as error:
                refusal = error
        if place is None or refusal is not None:
            failed = observed.unread.get(found[0]) if len(found) == 1 else None
            unread[number] = failed or Unread(one.image, refusal or _refused(one.image), number)
            columns.append({"name": one.image, "u": None, "v": None, **own})
            vertices.append(np.zeros((0, 2)))
            pixels.append(np.full(2, np.nan))
            continue
        batch, index = place
        pixel = one.pixel_of(corners, anchor)
        lanes[batch].append((number, index))
        columns.append({**observed.columns[found[0]], "u": float(pixel[0]), "v": float(pixel[1]), **own})
        vertices.append(corners)
        pixels.append(pixel)
    if not any(lanes):
        names = ", ".join([str(row.get("name")) for row in observed.columns][:3])
        wanted = ", ".join(dict.fromkeys(one.image for one in detections[:3]))
        raise TableError(f"no detection is in an image that was read: they name {wanted}; the images are {names}.")
    batches = tuple(
        _batch(batch, np.array(lane), np.stack([pixels[row] for row, _ in lane]))
        for batch, lane in zip(observed.batches, lanes, strict=True)
        if lane
    )
    names = dict.fromkeys((*INPUTS, *(name for row in columns for name in row)))
    order = [name for name in names if any(name in row for row in columns)]
    columns = [{name: row.get(name) for name in order} for row in columns]
    return dataclasses.replace(observed, batches=batches, columns=columns, unread=unread), vertices


def outline_observations(
    observed: Observations, vertices: Sequence[np.ndarray], terrain: Terrain
) -> tuple[Observations, list[AbstractTerrain], list[np.ndarray]] | None:
    """(a row for each point of all outlines, the terrain of each of their batches, for each detection its rows).

    `terrain` is that of the detections, as for `locate_observations`. None if all detections are points.
    """
    dense = [_dense(corners) if len(corners) > 2 else np.zeros((0, 2)) for corners in vertices]
    counts = np.array([len(one) for one in dense])
    if not counts.sum():
        return None
    ends = np.cumsum(counts)
    own = [np.arange(end - count, end) for end, count in zip(ends.tolist(), counts.tolist(), strict=True)]
    batches, grounds = [], []
    for batch, ground in batches_with_terrain(observed, terrain):
        index = np.repeat(np.arange(len(batch)), counts[batch.rows])
        if not len(index):
            continue
        rows = np.concatenate([own[row] for row in batch.rows.tolist()])
        uv = np.concatenate([dense[row] for row in batch.rows.tolist()])
        batches.append(_batch(batch, np.stack([rows, index], axis=-1), uv))
        grounds.append(terrain_at(ground, index))
    columns: list[dict[str, Any]] = [{} for _ in range(int(ends[-1]))]
    return dataclasses.replace(observed, batches=tuple(batches), columns=columns, unread={}), grounds, own


def outlines_on_ground(fixes: Fix, rows: Sequence[np.ndarray]) -> DetectedOutlines:
    """The outlines of detections, from the fixes of `outline_observations`."""
    lat, lon, height = (np.asarray(one) for one in fixes.position.to_degrees())
    places, codes = np.stack([lon, lat, height], axis=-1), np.asarray(fixes.status)
    known = have_fix(codes) & np.isfinite(places).all(axis=1)
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
    heights = batch.reported_heights(index)
    return ObservationBatch(Observation(observation.exposure, uv), sources, rows, batch.is_one_camera, *heights)


def _dense(corners: np.ndarray) -> np.ndarray:
    """The ring of a polygon with points along its edges."""
    steps = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(steps, axis=1)
    pieces = np.maximum(np.ceil(PIECES * lengths / lengths.sum()).astype(int), 1)
    return np.concatenate(
        [start + step * np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
         for start, step, count in zip(corners, steps, pieces, strict=True)]
    )  # fmt: skip


def _is_taken(name: str) -> bool:
    """Whether a column of fixes has a name."""
    more = ("index", "kind", "status_text", "probability", "azimuth_deg", "accuracy_method", "accuracy_text", "mgrs",
            "outline", "outline_status", "detection", "crs", "vertical_datum", "fid", "geom", "geometry", "ellipse",
            "map_x", "map_y", "map_z", "detected_as")  # fmt: skip
    return name in (*INPUTS, *FIX_COLUMNS, *more) or FIGURE.fullmatch(name) is not None


def _refused(message: str) -> TableError:
    """A refusal as one that was raised."""
    try:
        raise TableError(message)
    except TableError as error:
        return error


def _rows_by_name(observed: Observations, files: Sequence[Path]) -> dict[str, list[tuple[tuple[str, ...], int]]]:
    """By the name of the file of an exposure, with and without extension: (its folders, row) of each."""
    paths = {str(path): path for path in map(pathlib.Path, files)}
    by_name: dict[str, list[pathlib.Path]] = {}
    for path in paths.values():
        by_name.setdefault(path.name, []).append(path)
    found: dict[str, list[tuple[tuple[str, ...], int]]] = {}
    for row, column in enumerate(observed.columns):
        name = str(column.get("name", row))
        same = [paths[name]] if name in paths else by_name.get(name, [])
        path = same[0].absolute() if len(same) == 1 else pathlib.PurePath(name)
        for key in dict.fromkeys((path.name, path.stem)):
            found.setdefault(key, []).append((path.parent.parts, row))
    return found


def _rows_named(image: str, rows_of: dict[str, list[tuple[tuple[str, ...], int]]]) -> list[int]:
    """Rows of exposures whose file has a name, in the folders that are named with it."""
    path = pathlib.PurePosixPath(image.replace("\\", "/"))
    folders = path.parent.parts
    same = rows_of.get(path.name) or rows_of.get(path.stem, [])  # a reconstruction may name images without extension
    return [row for own, row in same if not folders or own[-len(folders) :] == folders]
