"""Candidate pairs of images: those whose predicted footprints on the terrain overlap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxgeo.terrain import AbstractTerrain
from jaxgeo.ties.ground import ground_of
from jaxgeo.ties.views import Views

LATTICE = 8  # pixels along a side of an image, whose ground stands for its footprint


class Pair(NamedTuple):
    """Two images by row, and the `overlap`: the smaller of the shares of each that the other sees."""

    first: int
    second: int
    overlap: float


def candidate_pairs(
    views: Views, terrain: AbstractTerrain, *, least_overlap: float = 0.1, most: int | None = 10
) -> list[Pair]:
    """Pairs of images whose predicted footprints overlap by at least a share, in order of their rows.

    A lattice of pixels of each image is intersected with the terrain. Boxes around these ground points exclude most
    pairs; the overlap is the share of one image's points that the navigation projects into the other, the smaller of
    both directions. Each image keeps at most `most` pairs in which it is the one with its own largest overlaps; a pair
    counts if either of its images keeps it. Raises `ValueError` for a share outside (0, 1] and `most` under 1.
    """
    if not 0.0 < least_overlap <= 1.0:
        raise ValueError(f"least_overlap is a share in (0, 1]; got {least_overlap}.")
    if most is not None and most < 1:
        raise ValueError(f"most must be 1 pair of an image or more, or None for all; got {most}.")
    grounds = [_lattice_ground(views, row, terrain) for row in range(len(views))]
    found = []
    for first, second in _touching(grounds):
        overlap = min(_share(views, grounds[first], second), _share(views, grounds[second], first))
        if overlap >= least_overlap:
            found.append(Pair(first, second, overlap))
    return found if most is None else _largest(found, most)


def unpaired(views: Views, pairs: list[Pair]) -> list[str]:
    """Names of the images that are in no pair."""
    paired = {row for pair in pairs for row in pair[:2]}
    return [str(name) for row, name in enumerate(views.name) if row not in paired]


def _lattice_ground(views: Views, row: int, terrain: AbstractTerrain) -> np.ndarray:
    """Ground points (n, 3) of a lattice of an image; those without ground are left out, the count stays `LATTICE`2."""
    camera = views.camera_of(row)
    t = (np.arange(LATTICE) + 0.5) / LATTICE
    u, v = np.meshgrid(t * camera.width - 0.5, t * camera.height - 0.5)
    points, hit = ground_of(views, row, np.stack([u.ravel(), v.ravel()], axis=1), terrain)
    return points[hit]


def _touching(grounds: list[np.ndarray]) -> list[tuple[int, int]]:
    """Pairs of point sets whose bounding boxes overlap, by a sweep along the first axis."""
    seen = [row for row, points in enumerate(grounds) if len(points)]
    low = {row: grounds[row][:, :2].min(axis=0) for row in seen}
    high = {row: grounds[row][:, :2].max(axis=0) for row in seen}
    found, active = [], []
    for row in sorted(seen, key=lambda one: low[one][0]):
        active = [one for one in active if high[one][0] >= low[row][0]]
        found += [
            (min(one, row), max(one, row))
            for one in active
            if low[one][1] <= high[row][1] and low[row][1] <= high[one][1]
        ]
        active.append(row)
    return sorted(found)


def _share(views: Views, points: np.ndarray, row: int) -> float:
    """Share of a whole lattice whose ground `points` project into an image."""
    camera = views.camera_of(row)
    p_camera = (points - views.centre[row]) @ views.R_frame_from_camera[row]
    ahead = p_camera[:, 2] > 0.0
    ideal = p_camera[:, :2] / np.where(ahead, p_camera[:, 2], 1.0)[:, None]
    uv = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * ideal  # a lens moves it by a few per cent
    inside = np.all((uv > -0.5) & (uv < np.array([camera.width, camera.height]) - 0.5), axis=1)
    return float(np.count_nonzero(inside & ahead)) / LATTICE**2


def _largest(pairs: list[Pair], most: int) -> list[Pair]:
    """Pairs that are among the `most` with the largest overlap of one of their images."""
    kept: set[Pair] = set()
    for row in {row for pair in pairs for row in pair[:2]}:
        own = sorted((pair for pair in pairs if row in pair[:2]), key=lambda pair: -pair.overlap)
        kept |= set(own[:most])
    return sorted(kept)
