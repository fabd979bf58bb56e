"""Two-axis gimbal pointing as a careful SciPy user would write it: `scipy.optimize.root` on the angles, one at a time.

The target is transformed to the gimbal's base once; each solver step then takes two rotations and a lever arm, in plain
Python numbers, which are faster than arrays for three components.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import root

A, E2 = 6_378_137.0, 0.0066943799901413165  # WGS 84


class Held(NamedTuple):
    """Constants: boresight, lever arms in m (to the gimbal, in the head), line of sight in the head."""

    R_body_from_base: np.ndarray
    lever_body: np.ndarray
    lever_head: np.ndarray
    sight: np.ndarray


def readings(held: Held, pose: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(outer, inner) in rad, of (lat, lon, height, heading, pitch, roll) and (lat, lon, height); NaN if not solved."""
    R_ned_from_body = turn_z(pose[3]) @ turn_y(pose[4]) @ turn_x(pose[5])
    R_body_from_ecef = (axes_ned(pose[0], pose[1]) @ R_ned_from_body).T
    in_body = R_body_from_ecef @ (ecef(*target) - ecef(*pose[:3])) - held.lever_body
    x, y, z = (held.R_body_from_base.T @ in_body).tolist()
    lx, ly, lz = held.lever_head.tolist()
    right = np.cross(held.sight, (1.0, 0.0, 0.0))
    right /= np.linalg.norm(right)
    (ax, ay, az), (bx, by, bz) = right.tolist(), np.cross(held.sight, right).tolist()

    def off(angles: np.ndarray) -> tuple[float, float]:
        theta, phi = -angles[0], angles[1]
        c, s = math.cos(theta), math.sin(theta)
        v, w = c * y + s * z, c * z - s * y
        c, s = math.cos(phi), math.sin(phi)
        u, v, w = c * x - s * w - lx, v - ly, s * x + c * w - lz
        length = math.sqrt(u * u + v * v + w * w)
        return (ax * u + ay * v + az * w) / length, (bx * u + by * v + bz * w) / length

    found = root(off, np.zeros(2), method="hybr", tol=1e-12)
    return found.x if found.success else np.full(2, np.nan)


def ecef(lat: float, lon: float, height: float) -> np.ndarray:
    normal = A / math.sqrt(1.0 - E2 * math.sin(lat) ** 2)
    level = (normal + height) * math.cos(lat)
    return np.array([level * math.cos(lon), level * math.sin(lon), (normal * (1.0 - E2) + height) * math.sin(lat)])


def axes_ned(lat: float, lon: float) -> np.ndarray:
    """Axes as columns: north, east, down in ECEF."""
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])


def turn_x(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def turn_y(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def turn_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
