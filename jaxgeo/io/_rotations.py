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


def omega_phi_kappa(R: np.ndarray) -> np.ndarray:
    """Omega, phi and kappa (n, 3) in rad of rotations (n, 3, 3), R = Rx(omega) Ry(phi) Rz(kappa).

    The kappa is what is left after omega is taken out: near a phi of 90 deg both are uncertain, and together right.
    """
    across = np.hypot(R[:, 1, 2], R[:, 2, 2])
    omega = np.where(across < 1e-15, 0.0, np.arctan2(-R[:, 1, 2], R[:, 2, 2]))
    sine, cosine = np.sin(omega), np.cos(omega)
    ahead, along = (cosine * R[:, 1, k] + sine * R[:, 2, k] for k in (0, 1))
    return np.stack([omega, np.arctan2(R[:, 0, 2], across), np.arctan2(ahead, along)], axis=-1)
