"""Omega, phi, kappa angles of exterior orientations, and their derivatives by small rotations."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxgeo.rotations import omega_phi_kappa_from_R
from jaxgeo.sensor.platform import R_IMAGE_FROM_CAMERA


def omega_phi_kappa(R_frame_from_camera: Any) -> np.ndarray:
    """Angles (n, 3) in rad: R_frame_from_image = Rx(omega) Ry(phi) Rz(kappa), the image right, up, out of the scene.

    Phi lies in [-pi/2, pi/2]; at its limits omega and kappa are not separable, and kappa is set to zero.
    """
    return omega_phi_kappa_from_R(np.asarray(R_frame_from_camera) @ R_IMAGE_FROM_CAMERA.T)


def angle_derivatives(R_frame_from_camera: Any) -> np.ndarray:
    """Derivatives (n, 3, 3) of these angles by a rotation about the camera's axes; infinite where phi is 90 degrees.

    A rotation about the image's axes is Rz' Ry' (1, 0, 0) d omega + Rz' (0, 1, 0) d phi + (0, 0, 1) d kappa.
    """
    _, phi, kappa = omega_phi_kappa(R_frame_from_camera).T
    zero, one = np.zeros_like(phi), np.ones_like(phi)
    with np.errstate(divide="ignore"):
        secant, tangent = 1.0 / np.cos(phi), np.tan(phi)
    rows = [
        [np.cos(kappa) * secant, -np.sin(kappa) * secant, zero],
        [np.sin(kappa), np.cos(kappa), zero],
        [-np.cos(kappa) * tangent, np.sin(kappa) * tangent, one],
    ]
    by_image = np.stack([np.stack(row, axis=1) for row in rows], axis=1)
    return by_image @ R_IMAGE_FROM_CAMERA
