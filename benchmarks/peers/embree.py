"""Intel's Embree through embreex: triangles in float32, robust traversal, nearest hit."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from support.fractal import TangentTerrain

from peers import Facts
from peers.triangles import TrianglePeer

_mesh: Any = importlib.import_module("embreex.mesh_construction")
_scene: Any = importlib.import_module("embreex.rtcore_scene")


class Embreex(TrianglePeer):
    """`EmbreeScene(robust=True)`, one ray after another."""

    facts = Facts(
        package="embreex",
        input="float32 rays from the ceiling, made beforehand",
        frame="east, north, up at the terrain's middle",
        precision="float32, robust",
        surface="triangles",
        threads="1",
        notes="range only",
    )

    def prepare(self, terrain: TangentTerrain) -> None:
        indices = self._with_triangles(terrain)
        self.scene = _scene.EmbreeScene(robust=True)
        self.mesh = _mesh.TriangleMesh(self.scene, self.vertices.reshape(-1, 3), indices)
        down = np.array([[0.0, 0.0, -1.0]], np.float32)
        self.scene.run(1e4 * -down, down, query="DISTANCE")  # builds the hierarchy

    def run(self) -> np.ndarray:
        return self.scene.run(self.origin, self.direction, query="DISTANCE")

    def ranges(self, answer: Any) -> np.ndarray:
        return self.sight.start + np.where(answer > 1e30, np.nan, answer.astype(float))


class EmbreexFixes(Embreex):
    """The traversal, and by numba from its triangle to the bilinear surface, latitude, longitude and height."""

    facts = Facts(
        package="embreex",
        input="float32 rays from the ceiling, made beforehand, and ECEF rays",
        frame="east, north, up at the terrain's middle; then ECEF",
        precision="float32, robust; then float64",
        surface="bilinear",
        threads="1; then all",
        notes="position and range",
    )

    def run(self) -> np.ndarray:
        kernels: Any = importlib.import_module("peers.numba_kernels")
        at = self.ranges(super().run())
        terrain, sight = self.terrain, self.sight
        scale = terrain.radii / terrain.spacing
        return kernels.finish(terrain.posts, sight.origin, sight.direction, at, terrain.axes, scale, terrain.middle)
