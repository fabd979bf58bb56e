"""Measurements of tie points in the last images of a sequence: residuals, derivatives, and points eliminated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import quick_filter_jit
from jaxgeo.adjust.collinearity import pixel_of
from jaxgeo.sensor import FrameCamera
from jaxgeo.ties.window import POSE, Window

CHUNK = 1024  # measurements per call: one size, so that other counts need no compilation
PARALLEL = 1e-6  # least over largest sensitivity of a point: less, and its rays are parallel
LEAST_SPREAD = 1e-300  # against division by zero


@dataclass(frozen=True)
class Rows:
    """Measurements of points in at least two frames: point and frame of each, pixel and standard deviation."""

    point: np.ndarray
    frame: np.ndarray
    uv: np.ndarray
    sigma: np.ndarray
    names: tuple[str, ...]

    @classmethod
    def of(cls, window: Window, names: set[str] | None = None, without: frozenset[int] = frozenset()) -> Rows:
        """Those of a window, or of some points, without some frames; in the order of points."""
        found: dict[str, list[int]] = {}
        for k, frame in enumerate(window.frames):
            for name in frame.seen if k not in without else ():
                if names is None or name in names:
                    found.setdefault(name, []).append(k)
        kept = {name: frames for name, frames in found.items() if len(frames) > 1}
        point = np.array([i for i, frames in enumerate(kept.values()) for _ in frames], int)
        frame = np.array([k for frames in kept.values() for k in frames], int)
        seen = [window.frames[k].seen[name] for name, frames in kept.items() for k in frames]
        uv = np.array([one for one, _ in seen]).reshape(-1, 2)
        sigma = np.hypot(np.array([one for _, one in seen]).reshape(-1, 2), window.excess)
        return cls(point, frame, uv, sigma, tuple(kept))

    def __len__(self) -> int:
        return len(self.point)

    def keys(self, window: Window) -> list[tuple[str, str]]:
        """(image, point) of each row."""
        names = [frame.name for frame in window.frames]
        return [(names[k], self.names[i]) for k, i in zip(self.frame.tolist(), self.point.tolist(), strict=True)]


class Linear(NamedTuple):
    """Weighted residuals (n, 2) of measurements, and derivatives by the pose (n, 2, 6) and by the point (n, 2, 3)."""

    residual: np.ndarray
    by_pose: np.ndarray
    by_point: np.ndarray


def linear(window: Window, rows: Rows, places: np.ndarray) -> Linear:
    """Measurements at current orientations and places (points, 3); points behind a camera have no residual (NaN)."""
    centre = np.stack([one.centre for one in window.frames])[rows.frame]
    R = np.stack([one.R_frame_from_camera for one in window.frames])[rows.frame]
    there = np.einsum("nji,nj->ni", R, places[rows.point] - centre)
    ahead = there[:, 2] > 0.0
    uv, by_there = _pixels_of(window, rows, np.where(ahead[:, None], there, [0.0, 0.0, 1.0]))
    residual = np.where(ahead[:, None], (uv - rows.uv) / rows.sigma, np.nan)
    by_there = by_there / rows.sigma[:, :, None]
    by_point = np.einsum("nij,nkj->nik", by_there, R)
    # A small rotation of the camera turns the point the other way: d there = -turn x there = there x turn.
    return Linear(residual, np.concatenate([-by_point, by_there @ _crosses(there)], axis=2), by_point)


def _crosses(v: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) of the cross products v x ."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _pixels_of(window: Window, rows: Rows, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(pixels (n, 2), their derivatives (n, 2, 3)) of points in the frames of the cameras."""
    uv, by = np.zeros((len(there), 2)), np.zeros((len(there), 2, 3))
    cameras: dict[int, FrameCamera] = {id(one.camera): one.camera for one in window.frames}
    number = np.array([id(one.camera) for one in window.frames])[rows.frame]
    for key, camera in cameras.items():
        own = np.flatnonzero(number == key)
        for part in np.split(own, range(CHUNK, len(own), CHUNK)) if len(own) else ():
            padded = jnp.asarray(np.resize(there[part], (CHUNK, 3)))
            found = [np.asarray(x)[: len(part)] for x in _pixels(camera, padded)]
            uv[part], by[part] = found
    return uv, by


@quick_filter_jit
def _pixels(camera: FrameCamera, there: Float[Array, "n 3"]) -> tuple[Float[Array, "n 2"], Float[Array, "n 2 3"]]:
    one = lambda p: (pixel_of(camera, p), jax.jacfwd(lambda x: pixel_of(camera, x))(p))  # noqa: E731
    return jax.vmap(one)(there)


def placed(window: Window, rows: Rows) -> np.ndarray:
    """Places (points, 3) where the rays of the measurements come closest, by current orientations."""
    centre = np.stack([one.centre for one in window.frames])[rows.frame]
    R = np.stack([one.R_frame_from_camera for one in window.frames])[rows.frame]
    rays = np.einsum("nij,nj->ni", R, _directions(window, rows))
    known = np.all(np.isfinite(rays), axis=1)[:, None, None]
    across = np.where(known, np.eye(3)[None] - rays[:, :, None] * rays[:, None, :], 0.0)
    count = len(rows.names)
    normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(normal, rows.point, across)
    np.add.at(right, rows.point, np.einsum("nij,nj->ni", across, centre))
    slight = np.maximum(1e-12 * np.trace(normal, axis1=1, axis2=2), LEAST_SPREAD)[:, None, None] * np.eye(3)[None]
    return np.linalg.solve(normal + slight, right[:, :, None])[:, :, 0]


def _directions(window: Window, rows: Rows) -> np.ndarray:
    """Unit directions (n, 3) of the measured pixels in the frames of the cameras."""
    found = np.zeros((len(rows), 3))
    for k, frame in enumerate(window.frames):
        own = np.flatnonzero(rows.frame == k)
        for part in np.split(own, range(CHUNK, len(own), CHUNK)) if len(own) else ():
            padded = jnp.asarray(np.resize(rows.uv[part], (CHUNK, 2)))
            found[part] = np.asarray(_rays(frame.camera, padded))[: len(part)]
    return found


@quick_filter_jit
def _rays(camera: FrameCamera, uv: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    rays = jax.vmap(lambda one: camera.ray(one)[0])(uv)
    return rays / jnp.sqrt(jnp.sum(rays**2, axis=1, keepdims=True))


class Normal(NamedTuple):
    """Normal equations H x = -g of all unknowns but the points, which are eliminated; half the sum of squares; and what
    gives the points' steps: `by_frame` (points, 3, frames, 6), `own` (points, 3), `root` (points, 3, 3)."""

    H: np.ndarray
    g: np.ndarray
    cost: float
    by_frame: np.ndarray
    own: np.ndarray
    root: np.ndarray

    def steps_of_points(self, step: np.ndarray, each: int) -> np.ndarray:
        """Steps (points, 3) of the points for a step of the other unknowns."""
        frames = self.by_frame.shape[2]
        poses = step[: frames * each].reshape(frames, each)[:, :POSE]
        return -np.linalg.solve(self.root, (self.own + np.einsum("pikc,kc->pi", self.by_frame, poses))[:, :, None])[
            :, :, 0
        ]


def of_ties(window: Window, rows: Rows, at: Linear, weight: np.ndarray) -> Normal:
    """Normal equations of the measurements, each weighted by `weight` (n,), with the points eliminated by orthogonal
    projection. Points whose rays are parallel take no part."""
    frames, each, points = len(window.frames), window.of_frame, len(rows.names)
    H, g = np.zeros((window.size, window.size)), np.zeros(window.size)
    if not len(rows):
        none = np.zeros((0, 3, frames, POSE))
        return Normal(H, g, 0.0, none, np.zeros((0, 3)), np.zeros((0, 3, 3)))
    root = np.sqrt(weight)[:, None]
    residual, by_pose = at.residual * root, at.by_pose * root[:, :, None]
    by_point = at.by_point * root[:, :, None]
    stacked = np.zeros((points, 2 * frames, 3))  # a point is measured at most once in a frame
    for axis in range(2):
        stacked[rows.point, 2 * rows.frame + axis] = by_point[:, axis]
    Q, T = np.linalg.qr(stacked)
    sound = _has_place(T)
    Q = Q * sound[:, None, None]
    used = sound[rows.point]
    residual, by_pose = residual * used[:, None], by_pose * used[:, None, None]
    of_rows = np.stack([Q[rows.point, 2 * rows.frame + axis] for axis in range(2)], axis=1)  # (n, 2, 3)
    by_frame = np.zeros((points, 3, frames, POSE))
    by_frame[rows.point, :, rows.frame] = np.einsum("nai,nac->nic", of_rows, by_pose)
    own = np.zeros((points, 3))
    np.add.at(own, rows.point, np.einsum("nai,na->ni", of_rows, residual))
    flat = by_frame.reshape(points * 3, frames * POSE)
    of_poses = -(flat.T @ flat).reshape(frames, POSE, frames, POSE)
    gradient = -(flat.T @ own.reshape(-1)).reshape(frames, POSE)
    squares = np.zeros((frames, POSE, POSE))
    np.add.at(squares, rows.frame, np.einsum("nai,naj->nij", by_pose, by_pose))
    np.add.at(gradient, rows.frame, np.einsum("nai,na->ni", by_pose, residual))
    of_poses[np.arange(frames), :, np.arange(frames)] += squares
    columns = (each * np.arange(frames)[:, None] + np.arange(POSE)[None]).ravel()
    H[np.ix_(columns, columns)] = of_poses.reshape(len(columns), -1)
    g[columns] = gradient.ravel()
    T = np.where(sound[:, None, None], T, np.eye(3)[None])
    return Normal(H, g, 0.5 * float(np.sum(residual**2) - np.sum(own**2)), by_frame, own, T)


def _has_place(triangle: np.ndarray) -> np.ndarray:
    """Flags of points whose rays are not parallel, from the triangular factors (points, 3, 3) of their derivatives."""
    sizes = np.linalg.svd(triangle, compute_uv=False)
    return sizes[:, 2] > PARALLEL * np.maximum(sizes[:, 0], LEAST_SPREAD)
