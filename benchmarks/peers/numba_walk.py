"""Compiled exact walk over every cell: the baseline without a pyramid."""

from __future__ import annotations

from typing import Any

import numba  # pyright: ignore[reportMissingImports]
import numpy as np
from support.fractal import Sight, TangentTerrain

from peers import Facts, Peer, cell_tops, numba_kernels

numba.config.THREADING_LAYER = "omp"  # type: ignore[attr-defined]  # TBB may belong to another package and be too old
NO_TRIANGLES = np.zeros((1, 1, 3), np.float32)


class NumbaWalk(Peer):
    """Every cell under the ray, in the DEM's own grid, by the polynomial track of the ray (degree 5)."""

    facts = Facts(
        package="numba",
        input="tracks of (row, col, height), made beforehand",
        frame="DEM grid, curved tracks true to 1e-9 m",
        precision="float64",
        surface="bilinear",
        threads="all",
        notes="written for this comparison; range only",
    )

    def prepare(self, terrain: TangentTerrain) -> None:
        self.terrain = terrain
        self.tops = cell_tops(terrain.posts)
        self.bounds = bounds_of(terrain)

    def load(self, sight: Sight) -> None:
        self.sight = sight
        self.tracks = tracks_of(self.terrain, sight, self.bounds)

    def run(self) -> np.ndarray:
        return numba_kernels.walk(
            self.terrain.posts, self.tops, *self.tracks, NO_TRIANGLES, False, self.sight.origin, self.sight.direction
        )

    def ranges(self, answer: Any) -> np.ndarray:
        return answer


class NumbaWalkFromEcef(NumbaWalk):
    """The same from ECEF rays: the tracks are computed inside the timed call, as in jaxgeo."""

    facts = Facts(
        package="numba",
        input="ECEF rays",
        frame="ECEF; DEM grid, curved tracks true to 1e-9 m",
        precision="float64",
        surface="bilinear",
        threads="all",
        notes="written for this comparison; range only",
    )

    def run(self) -> np.ndarray:
        self.tracks = tracks_of(self.terrain, self.sight, self.bounds)
        return super().run()


class NumbaFixes(NumbaWalkFromEcef):
    """The same, with latitude, longitude and height of the points."""

    facts = Facts(
        package="numba",
        input="ECEF rays",
        frame="ECEF; DEM grid, curved tracks true to 1e-9 m",
        precision="float64",
        surface="bilinear",
        threads="all",
        notes="written for this comparison; position and range",
    )

    def run(self) -> np.ndarray:
        at, terrain, sight = super().run(), self.terrain, self.sight
        scale = terrain.radii / terrain.spacing
        return numba_kernels.finish(
            terrain.posts, sight.origin, sight.direction, at, terrain.axes, scale, terrain.middle
        )


def bounds_of(terrain: TangentTerrain) -> tuple[float, float]:
    """Heights one metre above and below all posts."""
    return float(terrain.posts.max()) + 1.0, float(terrain.posts.min()) - 1.0


def tracks_of(
    terrain: TangentTerrain, sight: Sight, bounds: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (n, 6, 3), middle range and half length in m of the tracks between two heights."""
    top, bottom = bounds
    scale = terrain.radii / terrain.spacing
    return numba_kernels.tracks(sight.origin, sight.direction, terrain.axes, scale, terrain.middle, top, bottom)


def exact_on_triangles(
    terrain: TangentTerrain, sight: Sight, vertices: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """Ranges in m to the first of the triangles over `vertices` (rows, cols, 3), tested in float64 along every ray.

    `origin` and `direction` are the rays in the frame of the vertices.
    """
    tracks = tracks_of(terrain, sight, bounds_of(terrain))
    tops = cell_tops(terrain.posts)
    return numba_kernels.walk(terrain.posts, tops, *tracks, vertices, True, origin, direction)


def exact_on_chords(terrain: TangentTerrain, polylines: np.ndarray) -> np.ndarray:
    """(row, col, height) where polylines (n, points, 3) first meet the bilinear surface."""
    return numba_kernels.walk_polylines(terrain.posts, cell_tops(terrain.posts), polylines)
