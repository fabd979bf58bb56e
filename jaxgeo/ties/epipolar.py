"""Coplanarity of the rays of two images, and how the errors of their navigation change it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxgeo.adjust.ray_consensus import Rays

LEAST_BASE = 1e-9  # of the triple product of unit rays and base: below it, rays show nothing across an epipolar plane


class Coplanarity(NamedTuple):
    """Distances of the rays of common points from one plane with the base of two images, in standard deviations of the
    measurements (m,), and their derivatives (m, 12) by the errors of both poses (centre in m in the frame's axes,
    rotation in rad about the camera's axes)."""

    off: np.ndarray
    by_pose: np.ndarray


def coplanarity(rays: Rays, first: np.ndarray, second: np.ndarray) -> Coplanarity:
    """Coplanarity of pairs of rays, by their rows (m,) of `rays`; each pair is of the same two images.

    The triple product of base and rays (Longuet-Higgins 1981), over its standard deviation by that of the two
    directions across their epipolar planes.
    """
    d = rays.direction
    a, b = d[first], d[second]
    base = rays.centre[rays.image[second]] - rays.centre[rays.image[first]]
    scale = np.maximum(np.linalg.norm(base, axis=1), 1e-9)[:, None]
    base = base / scale
    by_first, by_second = np.cross(b, base), np.cross(base, a)
    across = (_across(by_first, a) * rays.sigma[first]) ** 2 + (_across(by_second, b) * rays.sigma[second]) ** 2
    noise = np.sqrt(np.maximum(across, (LEAST_BASE * rays.sigma[first]) ** 2))
    by_base = np.cross(a, b) / scale
    turns = [_by_turn(rays, rows, by) for rows, by in ((first, by_first), (second, by_second))]
    by_pose = np.concatenate([-by_base, turns[0], by_base, turns[1]], axis=1)
    return Coplanarity(np.sum(by_first * a, axis=1) / noise, by_pose / noise[:, None])


def _across(vector: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Lengths of vectors across unit vectors."""
    return np.linalg.norm(vector - np.sum(vector * unit, axis=1)[:, None] * unit, axis=1)


def _by_turn(rays: Rays, rows: np.ndarray, by_direction: np.ndarray) -> np.ndarray:
    """Derivatives by the rotation about the camera's axes from those by the direction in the frame."""
    own = np.einsum("kji,kj->ki", rays.R[rays.image[rows]], by_direction)
    return np.cross(rays.own[rows], own)
