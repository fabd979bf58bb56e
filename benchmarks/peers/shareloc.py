"""Shareloc's C++ intersection of lines of sight with a DTM (CNES), its batch call."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from support.fractal import Sight, TangentTerrain

from peers import Facts, Peer, along

_bindings: Any = importlib.import_module("bindings_cpp")


class SharelocCurved(Peer):
    """Lines of sight as 17 points each, which follow the Earth's curvature to 2 cm."""

    points = 17
    facts = Facts(
        package="shareloc",
        input="17 points a ray in the DTM's frame, made beforehand",
        frame="DTM grid and height; chords of the curved track",
        precision="float64, height tolerance 1e-4 m",
        surface="chords",
        threads="1",
        notes="with 33 points a ray its search did not end on these rays; it gives no sign of rays without an answer",
    )

    def prepare(self, terrain: TangentTerrain) -> None:
        self.terrain = terrain
        rows, cols = terrain.posts.shape
        to_map = (-0.5, 1.0, 0.0, -0.5, 0.0, 1.0)  # GDAL's order: x is the column, y the row, posts at integers
        self.dtm = _bindings.DTMIntersection(4326, terrain.posts, rows, cols, to_map)

    def load(self, sight: Sight) -> None:
        self.sight = sight
        self.polylines = _polylines(self.terrain, sight, self.points)
        self.lines = np.ascontiguousarray(self.polylines[..., [1, 0, 2]])

    def run(self) -> np.ndarray:
        return self.dtm.intersection_n_los_dtm(self.lines)

    def ranges(self, answer: Any) -> np.ndarray:
        return self._ranges(answer[:, [1, 0]], answer[:, 2])

    def own_surface(self) -> np.ndarray:
        from peers.numba_walk import exact_on_chords

        hits = exact_on_chords(self.terrain, self.polylines)
        return self._ranges(hits[:, :2], hits[:, 2])

    def _ranges(self, rowcol: np.ndarray, height: np.ndarray) -> np.ndarray:
        return along(self.sight, self.terrain.position(rowcol, height))


class SharelocChord(SharelocCurved):
    """Lines of sight as two points each: the fastest call, without Earth curvature between them."""

    points = 2
    facts = Facts(
        package="shareloc",
        input="2 points a ray in the DTM's frame, made beforehand",
        frame="DTM grid and height; one chord, metres off the curved track",
        precision="float64, height tolerance 1e-4 m",
        surface="chords",
        threads="1",
    )


def _polylines(terrain: TangentTerrain, sight: Sight, points: int) -> np.ndarray:
    """(row, col, height) of `points` points of every ray, from 1 m above the highest to 1 m below the lowest post."""
    top, bottom = float(terrain.posts.max()) + 1.0, float(terrain.posts.min()) - 1.0
    start = _range_at(terrain, sight, top, np.linalg.norm(sight.origin, axis=-1) * 0.0)
    end = _range_at(terrain, sight, bottom, start)
    at = start[:, None] + (end - start)[:, None] * np.linspace(0.0, 1.0, points)
    rowcol, height = terrain.over(sight.origin[:, None, :] + at[..., None] * sight.direction[:, None, :])
    return np.concatenate([rowcol, height[..., None]], axis=-1)


def _range_at(terrain: TangentTerrain, sight: Sight, height: float, guess: np.ndarray) -> np.ndarray:
    """Ranges at which descending rays pass a height, by Newton with a slope from a difference of 1 m."""
    at = guess
    for _ in range(8):
        _, here = terrain.over(sight.origin + at[:, None] * sight.direction)
        _, there = terrain.over(sight.origin + (at + 1.0)[:, None] * sight.direction)
        at = at + (height - here) / (there - here)
    return at
