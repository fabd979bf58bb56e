"""Shared base of the triangle ray tracers."""

from __future__ import annotations

import numpy as np
from support.fractal import Sight, TangentTerrain

from peers import Peer, mesh_of, to_enu


class TrianglePeer(Peer):
    """Two triangles per cell in east, north, up of the terrain's centre; straight edges and rays, curved Earth.

    Rays begin at the ceiling, to keep float32 numbers small.
    """

    def load(self, sight: Sight) -> None:
        self.sight = sight
        start = sight.origin + sight.start[:, None] * sight.direction
        self.origin = to_enu(self.terrain, start).astype(np.float32)
        self.direction = (sight.direction @ self.terrain.axes.T).astype(np.float32)

    def own_surface(self) -> np.ndarray:
        from peers.numba_walk import exact_on_triangles

        origin = to_enu(self.terrain, self.sight.origin)
        direction = self.sight.direction @ self.terrain.axes.T
        return exact_on_triangles(self.terrain, self.sight, self.vertices, origin, direction)

    def _with_triangles(self, terrain: TangentTerrain) -> np.ndarray:
        self.terrain = terrain
        self.vertices, indices = mesh_of(terrain)
        return indices
