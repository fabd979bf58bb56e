"""Covariances of blocks on control by QR decomposition of the whole Jacobian, in NumPy alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg

from jaxgeo.adjust import Adjustment

STEP = 1e-30  # complex step, exact to rounding


class Rigorous(NamedTuple):
    """Covariances of the images' columns (6 n, 6 n) and of each point (m, 3, 3), and the largest remaining step of
    any unknown in standard deviations."""

    images: np.ndarray
    points: np.ndarray
    left: float


def by_triangles(adjustment: Adjustment, camera: np.ndarray, control: float) -> Rigorous:
    """Covariances of a block with control of that sigma in m only; `camera` is f, u0, v0, k1, k2, p1, p2.

    Householder QR with pivoting, rows sorted by weight: row-wise backward stable for any weights (Powell and Reid
    1969), whereas normal equations would lose rows with 1e16 times smaller weight.
    """
    block = adjustment.block
    images, places = adjustment.images, adjustment.places
    names = list(places)
    image = np.searchsorted(images.name, block.observations.image)
    point = np.array([names.index(name) for name in block.observations.point.tolist()])
    where = np.array(list(places.values()))
    n, m, k = len(images), len(names), len(image)
    size, columns = 6 * n + 3 * m, [image * 6 + i for i in range(6)] + [6 * n + point * 3 + i for i in range(3)]
    J, left, rows = np.zeros((2 * k, size)), np.zeros(2 * k), np.arange(k)
    sigma = block.observations.sigma
    given = images.centre[image], images.R_frame_from_camera[image], where[point]
    for i, column in enumerate(columns):
        step = np.zeros(9, complex)
        step[i] = 1j * STEP
        uv = _pixels(camera, *given, step)
        for axis in range(2):
            J[2 * rows + axis, column] = uv[:, axis].imag / STEP / sigma[:, axis]
            left[2 * rows + axis] = (uv[:, axis].real - block.observations.uv[:, axis]) / sigma[:, axis]
    at = np.array([names.index(name) for name in block.control.name.tolist()])
    more = np.zeros((3 * len(at), size))
    more[np.arange(3 * len(at)), (6 * n + at[:, None] * 3 + np.arange(3)[None]).ravel()] = 1.0 / control
    left = np.concatenate([left, ((where[at] - block.control.place) / control).ravel()])
    return _solved(np.concatenate([J, more]), left, n, m)


def _pixels(camera: np.ndarray, centre: np.ndarray, R: np.ndarray, place: np.ndarray, step: np.ndarray) -> np.ndarray:
    f, u0, v0, k1, k2, p1, p2 = camera
    d = np.einsum("kji,kj->ki", R, place + step[None, 6:] - centre - step[None, :3])
    x, y, z = (d - np.cross(np.broadcast_to(step[3:6], d.shape), d)).T  # the camera rotated by a small vector
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * k2)
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.stack([u0 + f * u, v0 + f * v], axis=1)


def _solved(J: np.ndarray, left: np.ndarray, n: int, m: int) -> Rigorous:
    scale = 1.0 / np.linalg.norm(J, axis=0)
    order = np.argsort(-np.linalg.norm(J, axis=1))
    q, r, pivots = scipy.linalg.qr((J * scale[None])[order], mode="economic", pivoting=True)
    inverse = scipy.linalg.solve_triangular(r, np.eye(len(r)))
    covariance, step = np.zeros((len(r), len(r))), np.zeros(len(r))
    covariance[np.ix_(pivots, pivots)] = inverse @ inverse.T
    step[pivots] = inverse @ (q.T @ left[order])
    left_over = np.abs(step / np.sqrt(np.diagonal(covariance))).max()
    covariance *= np.outer(scale, scale)
    at = 6 * n + 3 * np.arange(m)[:, None] + np.arange(3)
    return Rigorous(covariance[: 6 * n, : 6 * n], covariance[at[:, :, None], at[:, None, :]], float(left_over))
