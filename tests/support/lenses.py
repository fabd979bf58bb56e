"""Lenses and cameras at many points, by one compiled program for each kind of lens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

POINTS = 400  # of one call; fewer are padded


def at_points(function: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """`function(lens, point)` at points (n, size), with numbers of the lens as arrays: they compile nothing anew."""
    compiled = jax.jit(jax.vmap(function, (None, 0)))

    def call(lens: Any, points: Any) -> Any:
        points = np.asarray(points, float)
        count = len(points)
        padded = points[np.minimum(np.arange(max(count, POINTS)), count - 1)]
        found = compiled(jax.tree.map(lambda leaf: np.asarray(leaf, float), lens), padded)
        return jax.tree.map(lambda x: np.asarray(x)[:count], found)

    return call


correct = at_points(lambda lens, point: lens.correct(point))
distort = at_points(lambda lens, point: lens.distort(point))
undistort = at_points(lambda lens, point: lens.undistort(point))
in_field = at_points(lambda lens, point: lens.in_field(point))
rays = at_points(lambda camera, uv: camera.ray(uv))
pixels = at_points(lambda camera, p: camera.project(p))
