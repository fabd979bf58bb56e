"""Tracks: ground points measured in several images, joined from the matches of pairs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from jaxgeo.adjust import ImagePoints
from jaxgeo.ties.matching import PairMatches

APART = 1.5  # px: measurements of one track in one image that lie further apart contradict each other
SIGMAS = 4.0  # or by their standard deviations


class Tracks:
    """Measurements of ground points by image, grown pair by pair.

    A point of an image is either new or the measurement of a track there: matches of it extend that track. Two
    different measurements of one track in one image, from different pairs, contradict each other; the track then loses
    both, and `contradictions` counts them.
    """

    def __init__(self) -> None:
        self._seen: list[dict[int, tuple[np.ndarray, np.ndarray]]] = []
        self._refused: set[tuple[int, int]] = set()
        self.contradictions = 0

    def __len__(self) -> int:
        return len(self._seen)

    def in_image(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """(numbers (k,), pixels (k, 2)) of the tracks that are measured in an image."""
        found = [(number, seen[row][0]) for number, seen in enumerate(self._seen) if row in seen]
        numbers = np.array([number for number, _ in found], int)
        return numbers, np.array([uv for _, uv in found], float).reshape(-1, 2)

    def new(self, count: int) -> np.ndarray:
        """Numbers (count,) of new tracks without measurements."""
        first = len(self._seen)
        self._seen += [{} for _ in range(count)]
        return np.arange(first, first + count)

    def add(self, matches: PairMatches, numbers: np.ndarray) -> None:
        """Add the matches of a pair; `numbers` (n,) are the tracks of its points."""
        for k in matches.tied:
            number = int(numbers[k])
            first = matches.uv_first[k], matches.sigma_first[k]
            second = matches.uv_second[k], matches.sigma_second[k]
            if matches.first not in self._seen[number] and (number, matches.first) not in self._refused:
                self._seen[number][matches.first] = first
            held = self._seen[number].get(matches.first)
            uv, sigma = second
            if held is not None:  # what this pair is less sure of than the first one is in its second image
                sigma = sigma * np.sqrt(1.0 + np.maximum(1.0 - (held[1] / first[1]) ** 2, 0.0))
            self._measure(number, matches.second, uv, sigma)

    def _measure(self, number: int, row: int, uv: np.ndarray, sigma: np.ndarray) -> None:
        seen = self._seen[number]
        if (number, row) in self._refused:
            return
        if row not in seen:
            seen[row] = uv, sigma
            return
        away = np.abs(seen[row][0] - uv)
        if np.any(away > np.maximum(APART, SIGMAS * np.hypot(seen[row][1], sigma))):
            del seen[row]
            self._refused.add((number, row))
            self.contradictions += 1

    def observations(self, names: np.ndarray, least: int = 2) -> ImagePoints:
        """Measurements of the tracks in at least `least` images; `names` are those of the images.

        Points are named "tie 0" and so on. Raises `ValueError` if there are none.
        """
        rows = [
            (names[row], f"tie {number}", *seen[row])
            for number, seen in enumerate(self._seen)
            if len(seen) >= least
            for row in sorted(seen)
        ]
        if not rows:
            raise ValueError("no two images share a tie point; nothing can be adjusted.")
        image, point, uv, sigma = zip(*rows, strict=True)
        return ImagePoints(list(map(str, image)), list(point), np.array(uv), np.array(sigma))


def connected(names: np.ndarray, observations: ImagePoints | None, least: int = 3) -> list[list[str]]:
    """Names of the images of each part of a block, largest first; images share a part if they are joined by pairs of
    images with at least `least` common points. Images without such a pair are parts of their own."""
    index = {str(name): row for row, name in enumerate(names)}
    parent = list(range(len(names)))

    def root(row: int) -> int:
        while parent[row] != row:
            parent[row] = parent[parent[row]]
            row = parent[row]
        return row

    for first, second in _joined(index, observations, least):
        parent[root(first)] = root(second)
    parts: dict[int, list[str]] = {}
    for name, row in index.items():
        parts.setdefault(root(row), []).append(name)
    return sorted(parts.values(), key=len, reverse=True)


def _joined(index: dict[str, int], observations: ImagePoints | None, least: int) -> Iterable[tuple[int, int]]:
    """Pairs of rows with enough common points."""
    if observations is None:
        return []
    import scipy  # submodules load lazily

    image = np.array([index[str(name)] for name in observations.image])
    points, point = observations.point_numbers
    ones = np.ones(len(image), int)
    seen = scipy.sparse.coo_array((ones, (image, point)), shape=(len(index), len(points))).tocsr()
    common = (seen @ seen.T).tocoo()
    enough = (common.data >= least) & (common.coords[0] < common.coords[1])
    return zip(common.coords[0][enough].tolist(), common.coords[1][enough].tolist(), strict=True)
