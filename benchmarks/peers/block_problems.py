"""Bundle blocks as plain NumPy arrays, for any bundle adjustment: a simulated one and a BAL file.

Camera frame: right, down, forward. `uv` are (column, row) in px: with x = X/Z, y = Y/Z, r2 = x^2 + y^2, u = cx + f x (1
+ k1 r2 + k2 r2^2) and v likewise: pycolmap's RADIAL, OpenCV's with two terms.
"""

from __future__ import annotations

import bz2
import pathlib
from dataclasses import dataclass, replace

import numpy as np

WIDTH, HEIGHT = 10_000, 8_000  # px
ABOVE = 500.0  # m, above the mean height of the ground
GROUND = 150.0  # m, mean height of the ground, which varies by 50 m
REACH = 75.0  # m, half side of the area of the points, and of that of the nadir cameras
CIRCLE = 250.0  # m, radius of the circle of the oblique cameras
NOISE = 0.3  # px


@dataclass(frozen=True)
class Pos:
    """Observed centres (n, 3) in m and attitudes (n, 3, 3), with a sigma in m and in rad valid for every axis."""

    centres: np.ndarray
    R_world_from_camera: np.ndarray
    sigma_centre: float
    sigma_attitude: float


@dataclass(frozen=True)
class BlockProblem:
    """Starting values and image measurements of a block.

    `centres` (n, 3), `R_world_from_camera` (n, 3, 3), `points` (m, 3) and `cameras` (c, 5), which are f, cx, cy, k1,
    k2, are the unknowns; cx and cy only if `principal_point_free`. `camera` (n,) is the camera of every image. `image`,
    `point` (k,) and `uv` (k, 2) are the measurements, sorted by point, with standard deviation `sigma` in px. `pos` are
    observations of the images; without them the block has no datum (shift, rotation, scale). `truth` is the block
    without errors, if known.
    """

    centres: np.ndarray
    R_world_from_camera: np.ndarray
    points: np.ndarray
    cameras: np.ndarray
    camera: np.ndarray
    image: np.ndarray
    point: np.ndarray
    uv: np.ndarray
    sigma: float
    principal_point_free: bool
    pos: Pos | None = None
    truth: BlockProblem | None = None

    def projected(self) -> np.ndarray:
        """Image points (k, 2) in px of all measurements, at the current values."""
        return self.depth_and_uv()[1]

    def depth_and_uv(self) -> tuple[np.ndarray, np.ndarray]:
        """Depths (k,) in front of the cameras and image points (k, 2) in px, at the current values."""
        ray_world = self.points[self.point] - self.centres[self.image]
        ray_camera = np.einsum("kij,ki->kj", self.R_world_from_camera[self.image], ray_world)
        f, cx, cy, k1, k2 = self.cameras[self.camera[self.image]].T
        xy = ray_camera[:, :2] / ray_camera[:, 2:]
        r2 = np.sum(xy**2, axis=1)
        scale = f * (1.0 + r2 * (k1 + r2 * k2))
        return ray_camera[:, 2], np.stack([cx, cy], axis=1) + scale[:, None] * xy

    def cost(self) -> float:
        """Half the sum of the squared residuals over their sigma, with the observations of the images."""
        total = np.sum((self.projected() - self.uv) ** 2) / self.sigma**2
        if self.pos is not None:
            total += np.sum((self.centres - self.pos.centres) ** 2) / self.pos.sigma_centre**2
            turn = np.swapaxes(self.R_world_from_camera, 1, 2) @ self.pos.R_world_from_camera
            total += np.sum(rotation_vectors(turn) ** 2) / self.pos.sigma_attitude**2
        return float(0.5 * total)


def simulated(images: int = 50, points: int = 4000, seed: int = 0) -> BlockProblem:
    """A block in which every image sees every point: nadir strips and, for two images in five, an oblique circle.

    One camera with f, cx, cy, k1 and k2 free. Observations of the images: 0.1 m and 0.02 deg on every axis. Starting
    values are off by 0.3 m and 0.02 deg for images and by 1 m for points, on every axis, and have no distortion. Raises
    `ValueError` if a point does not fall into an image.
    """
    rng = np.random.default_rng(seed)
    centres, R_world_from_camera = _flown(images)
    truth = BlockProblem(
        centres=centres,
        R_world_from_camera=R_world_from_camera,
        points=_ground(points, rng),
        cameras=np.array([[10_012.0, 0.5 * WIDTH + 7.5, 0.5 * HEIGHT - 5.5, -0.03, 0.01]]),
        camera=np.zeros(images, int),
        image=np.tile(np.arange(images), points),
        point=np.repeat(np.arange(points), images),
        uv=np.zeros((images * points, 2)),
        sigma=NOISE,
        principal_point_free=True,
    )
    depth, uv = truth.depth_and_uv()
    outside = (depth <= 0.0) | np.any((uv < 0.0) | (uv > (WIDTH - 1, HEIGHT - 1)), axis=1)
    if np.any(outside):
        row = int(np.argmax(outside))
        raise ValueError(f"point {truth.point[row]} falls outside image {truth.image[row]}, at {uv[row]} px.")
    truth = replace(truth, uv=uv)
    small = np.deg2rad(0.02)
    pos = Pos(*_disturbed(truth, 0.1, small, rng), sigma_centre=0.1, sigma_attitude=small)
    begin_centres, begin_R = _disturbed(truth, 0.3, small, rng)
    return replace(
        truth,
        centres=begin_centres,
        R_world_from_camera=begin_R,
        points=truth.points + rng.normal(0.0, 1.0, truth.points.shape),
        cameras=np.array([[10_000.0, 0.5 * WIDTH, 0.5 * HEIGHT, 0.0, 0.0]]),
        uv=uv + rng.normal(0.0, NOISE, uv.shape),
        pos=pos,
        truth=truth,
    )


def bal(path: str | pathlib.Path) -> BlockProblem:
    """A problem of "Bundle Adjustment in the Large" (Agarwal et al. 2010), plain or bzip2-compressed.

    Every image has its own camera with f, k1 and k2 free. The file's camera frame is right, up, backward: y and z are
    negated, and so is the row in the image. sigma is 1 px, so that costs compare with published ones.
    """
    path = pathlib.Path(path)
    raw = path.read_bytes()
    numbers = np.array((bz2.decompress(raw) if path.suffix == ".bz2" else raw).split(), float)
    images, points, count = (int(n) for n in numbers[:3])
    seen, rest = numbers[3 : 3 + 4 * count].reshape(-1, 4), numbers[3 + 4 * count :]
    nine, xyz = rest[: 9 * images].reshape(-1, 9), rest[9 * images :].reshape(points, 3)
    flip = np.array([1.0, -1.0, -1.0])
    R_camera_from_world = flip[:, None] * rotation_matrices(nine[:, :3])
    R_world_from_camera = np.swapaxes(R_camera_from_world, 1, 2)
    f, k1, k2 = nine[:, 6:].T
    seen = seen[np.argsort(seen[:, 1], kind="stable")]
    return BlockProblem(
        centres=-np.einsum("nij,nj->ni", R_world_from_camera, flip * nine[:, 3:6]),
        R_world_from_camera=R_world_from_camera,
        points=xyz,
        cameras=np.stack([f, 0.0 * f, 0.0 * f, k1, k2], axis=1),
        camera=np.arange(images),
        image=seen[:, 0].astype(int),
        point=seen[:, 1].astype(int),
        uv=seen[:, 2:] * (1.0, -1.0),
        sigma=1.0,
        principal_point_free=False,
    )


def rotation_matrices(vectors: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) of rotation vectors (n, 3) in rad, by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * (cross @ cross)


def rotation_vectors(matrices: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) in rad of matrices (n, 3, 3) with angles below pi."""
    m = matrices
    twice_sine = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=1)
    length = np.linalg.norm(twice_sine, axis=1)
    angle = np.arctan2(length, np.trace(m, axis1=1, axis2=2) - 1.0)
    return twice_sine * np.where(length > 0.0, angle / np.where(length > 0.0, length, 1.0), 0.5)[:, None]


def _flown(images: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 3), east, north, up, and attitudes (n, 3, 3): alternating strips, then a circle looking inwards."""
    oblique = 2 * images // 5
    nadir = images - oblique
    lines = max(1, round(np.sqrt(nadir)))
    number = np.arange(nadir)
    line, along = number % lines, number // lines
    east = REACH * (2.0 * line / max(lines - 1, 1) - 1.0)
    north = REACH * (2.0 * along / max((nadir - 1) // lines, 1) - 1.0)
    height = GROUND + ABOVE
    over = np.stack([east, north, np.full(nadir, height)], axis=1)
    azimuth = 2.0 * np.pi * np.arange(oblique) / max(oblique, 1)
    around = np.stack([CIRCLE * np.sin(azimuth), CIRCLE * np.cos(azimuth), np.full(oblique, height)], axis=1)
    down = np.tile([0.0, 0.0, -1.0], (nadir, 1))
    inwards = np.array([0.0, 0.0, GROUND]) - around
    heading = np.where(line % 2 == 0, 0.0, np.pi)
    ahead = np.stack([np.sin(heading), np.cos(heading), 0.0 * heading], axis=1)
    flown = np.stack([np.cos(azimuth), -np.sin(azimuth), 0.0 * azimuth], axis=1)
    forward = np.concatenate([down, inwards])
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.concatenate([np.cross(down, ahead), flown])
    return np.concatenate([over, around]), np.stack([right, np.cross(forward, right), forward], axis=2)


def _ground(points: int, rng: np.random.Generator) -> np.ndarray:
    """Points (m, 3), east, north, up, on hills between 100 and 200 m."""
    east, north = rng.uniform(-REACH, REACH, (2, points))
    hills = 0.6 * np.sin(east / 31.0 + 0.4) * np.cos(north / 27.0) + 0.4 * np.sin((east + 2.0 * north) / 23.0)
    return np.stack([east, north, GROUND + 50.0 * hills], axis=1)


def _disturbed(
    block: BlockProblem, metres: float, angle: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Centres and attitudes with errors of this sigma in m and rad on every axis, the angles about camera axes."""
    centres = block.centres + rng.normal(0.0, metres, block.centres.shape)
    return centres, block.R_world_from_camera @ rotation_matrices(rng.normal(0.0, angle, block.centres.shape))
