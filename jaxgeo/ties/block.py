"""Tie points of many images: candidate pairs, matches, tracks, and what is not connected."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.adjust import ImagePoints
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.ties.feature_matching import match_keypoints
from jaxgeo.ties.features import AbstractFeatures, ImageKeypoints
from jaxgeo.ties.ground import planes_at
from jaxgeo.ties.interest import cell_of, interest_points, power_for
from jaxgeo.ties.kept import KeptMatches
from jaxgeo.ties.matching import Matching, PairMatches, TieOutcome, match_pair
from jaxgeo.ties.pairs import Pair, candidate_pairs
from jaxgeo.ties.pictures import Pictures
from jaxgeo.ties.tracks import Tracks, connected
from jaxgeo.ties.views import Views


@dataclass(frozen=True)
class MatchedPair:
    """Names of a pair of images, the predicted `overlap`, and the number of points per `TieOutcome`."""

    first: str
    second: str
    overlap: float
    counts: dict[TieOutcome, int]

    @property
    def tied(self) -> int:
        """Number of points measured in both."""
        return self.counts.get(TieOutcome.tied, 0)


@dataclass(frozen=True)
class Ties:
    """Tie points of a block.

    `observations` are the measurements of points in two images or more, None if there are none; `pairs` the compared
    pairs. `parts` are the names of images that tie points join, the largest part first; images without ties are parts
    of their own. `contradictions` is the number of measurements left out because two pairs disagreed.
    """

    observations: ImagePoints | None
    pairs: list[MatchedPair]
    parts: list[list[str]]
    contradictions: int = 0

    @property
    def unconnected(self) -> list[str]:
        """Names of images that no tie points join to the largest part."""
        return [name for part in self.parts[1:] for name in part] if len(self.parts[0]) > 1 else self.parts_flat

    @property
    def parts_flat(self) -> list[str]:
        """Names of all images."""
        return [name for part in self.parts for name in part]


def find_ties(
    views: Views,
    terrain: AbstractTerrain,
    pictures: Pictures,
    matching: Matching | None = None,
    *,
    pairs: Sequence[Pair] | None = None,
    points: int = 150,
    callback: Callable[[int, int], Any] | None = None,
    kept: KeptMatches | None = None,
    features: AbstractFeatures | None = None,
) -> Ties:
    """Tie points between all overlapping images of a block.

    Each image has about `points` points, one in each cell of a grid: measurements of earlier tracks, or the best
    texture of the cell. They are matched in the later images of its `pairs` (default: `candidate_pairs`), see
    `match_pair`, and joined to tracks. `callback` is called with the number of pairs done and their total. Images are
    read once per image with pairs, and again if more than `pictures` keeps are needed. With `kept`, each result is
    written to its folder, and read from there in a later call with the same inputs.

    With `features`, points are their keypoints, the strongest of each cell, and matched by their descriptors (see
    `match_keypoints`) in place of areas.

    Raises `ValueError` for a block of one image, no pair of overlapping images, `features` together with a `measure` of
    areas, and features that are none; `ImportError` for those whose library is missing.
    """
    check_is(views, Views, "views")
    check_is(pictures, Pictures, "pictures")
    how = Matching() if matching is None else matching
    if len(views) < 2:
        raise ValueError(f"tie points need two images or more; got {len(views)}.")
    check_points(points)
    keypoints = None if features is None else _keypoints(pictures, features, points, how)
    by = "" if features is None else repr(features)
    if type(features).__repr__ is object.__repr__:
        kept = None
    chosen = list(candidate_pairs(views, terrain) if pairs is None else pairs)
    if not chosen:
        raise ValueError(
            f"no two of {len(views)} images overlap on the terrain, as the navigation has them; check positions, "
            f"heights and their datum, or lower least_overlap."
        )
    tracks, matched, done = Tracks(), [], 0
    for first in sorted({pair.first for pair in chosen}):
        own = [pair for pair in chosen if pair.first == first]
        uv, numbers = _points_of(views, first, pictures, tracks, points, kept, keypoints)
        planes = planes_at(views, first, uv, terrain, float(how.size))
        for pair in own:
            pair_of = views, first, pair.second, uv, planes
            if keypoints is None:
                find = functools.partial(match_pair, *pair_of, pictures, how)
            else:
                find = functools.partial(match_keypoints, *pair_of, keypoints, how)
            found = find() if kept is None else kept.matches(views, pair[:2], uv, planes, how, find, by)
            tracks.add(found, numbers)
            matched.append(_counted(views, pair, found))
            done += 1
            if callback is not None:
                callback(done, len(chosen))
    observations = _observations(tracks, views)
    return Ties(observations, matched, connected(views.name, observations), tracks.contradictions)


def check_points(points: int) -> None:
    """Raises `ValueError` for too few points of each image."""
    if points < 4:
        raise ValueError(f"points must be 4 or more in each image; got {points}.")


def _keypoints(pictures: Pictures, features: AbstractFeatures, points: int, how: Matching) -> ImageKeypoints:
    check_is(features, AbstractFeatures, "features")
    if how.measure != "grey":
        raise ValueError(f"measure {how.measure!r} is of areas, which features take the place of; give one of the two.")
    return ImageKeypoints(pictures, features, points)


def _points_of(
    views: Views,
    row: int,
    pictures: Pictures,
    tracks: Tracks,
    points: int,
    kept: KeptMatches | None,
    keypoints: ImageKeypoints | None,
) -> tuple[np.ndarray, np.ndarray]:
    """(pixels (n, 2), track numbers (n,)) of the points of an image: at most one of each cell, tracks first."""
    camera = views.camera_of(row)
    shape = camera.height, camera.width
    power = power_for(shape)
    by = "" if keypoints is None else repr(keypoints.features)

    def find() -> tuple[np.ndarray, np.ndarray]:
        if keypoints is not None:
            return keypoints.points(row)
        return interest_points(pictures.level(row, power), power, shape, points)

    fresh, fresh_cell = find() if kept is None else kept.points(views, row, points, find, by)
    numbers, uv = tracks.in_image(row)
    cells, first = np.unique(cell_of(uv, shape, points), return_index=True)
    is_free = ~np.isin(fresh_cell, cells)
    all_numbers = np.concatenate([numbers[first], tracks.new(int(np.count_nonzero(is_free)))])
    return np.concatenate([uv[first], fresh[is_free]]), all_numbers


def _counted(views: Views, pair: Pair, found: PairMatches) -> MatchedPair:
    values, counts = np.unique(found.outcome, return_counts=True)
    by_outcome = {TieOutcome(int(value)): int(count) for value, count in zip(values, counts, strict=True)}
    return MatchedPair(str(views.name[pair.first]), str(views.name[pair.second]), pair.overlap, by_outcome)


def _observations(tracks: Tracks, views: Views) -> ImagePoints | None:
    try:
        return tracks.observations(views.name)
    except ValueError:
        return None
