"""Rotation matrices as other programs write them."""

from __future__ import annotations

import numpy as np

from jaxgeo.io.errors import TableError

NEAR = 1e-3  # largest difference of a singular value from one, as of rounded elements


def rotation_near(where: str, matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix that is one except for rounding. Raises `TableError` for any other matrix."""
    left, values, right = np.linalg.svd(matrix)
    if np.any(np.abs(values - 1.0) > NEAR) or np.linalg.det(left @ right) < 0.0:
        raise TableError(f"{where}: it is no rotation.")
    return left @ right
