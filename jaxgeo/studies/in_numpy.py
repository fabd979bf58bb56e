"""Rotations and ellipsoidal coordinates in NumPy, independent of the package, for the printed equations.

Angles in rad, lengths in m, WGS 84.
"""

from __future__ import annotations

import numpy as np

A, E2 = 6378137.0, 0.0066943799901413165


def R_about_x(angle: float) -> np.ndarray:
    """Rotation about the first axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def R_about_y(angle: float) -> np.ndarray:
    """Rotation about the second axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def R_about_z(angle: float) -> np.ndarray:
    """Rotation about the third axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def R_ned_from_body(heading: float, pitch: float, roll: float) -> np.ndarray:
    """Rz(heading) Ry(pitch) Rx(roll)."""
    return R_about_z(heading) @ R_about_y(pitch) @ R_about_x(roll)


def R_ecef_from_ned(lat: float, lon: float) -> np.ndarray:
    """Rotation matrix with the directions of north, east and down as columns."""
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    east = [-np.sin(lon), np.cos(lon), 0.0]
    down = [-np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), -np.sin(lat)]
    return np.array([north, east, down]).T


def ecef(lat: float, lon: float, height: float) -> np.ndarray:
    """Geocentric coordinates (3,)."""
    N = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    along = (N + height) * np.cos(lat)
    return np.array([along * np.cos(lon), along * np.sin(lon), (N * (1.0 - E2) + height) * np.sin(lat)])
