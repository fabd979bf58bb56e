"""Open3D's RaycastingScene (based on Embree): triangles in float32, nearest hit."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from support.fractal import Sight, TangentTerrain

from peers import Facts
from peers.triangles import TrianglePeer

_open3d: Any = importlib.import_module("open3d")


class Open3D(TrianglePeer):
    """`RaycastingScene.cast_rays`, which also returns normals and coordinates within the triangle."""

    facts = Facts(
        package="open3d",
        input="float32 rays from the ceiling, made beforehand",
        frame="east, north, up at the terrain's middle",
        precision="float32",
        surface="triangles",
        threads="all",
        notes="range, normal, triangle and its coordinates",
    )

    def prepare(self, terrain: TangentTerrain) -> None:
        indices = self._with_triangles(terrain)
        self.scene = _open3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(self.vertices.reshape(-1, 3), indices.astype(np.uint32))
        self.scene.cast_rays(_open3d.core.Tensor(np.array([[0.0, 0.0, 1e4, 0.0, 0.0, -1.0]], np.float32)))

    def load(self, sight: Sight) -> None:
        super().load(sight)
        self.rays = _open3d.core.Tensor(np.concatenate([self.origin, self.direction], axis=-1))

    def run(self) -> Any:
        return self.scene.cast_rays(self.rays)

    def ranges(self, answer: Any) -> np.ndarray:
        found = answer["t_hit"].numpy().astype(float)
        return self.sight.start + np.where(np.isfinite(found), found, np.nan)
