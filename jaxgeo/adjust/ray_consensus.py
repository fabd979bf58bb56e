"""Robust intersections and resections before an adjustment, to detect rays that miss their points."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from jaxgeo.adjust.block import Block
from jaxgeo.adjust.initial_points import camera_rays
from jaxgeo.adjust.readout import has_readout, in_motion

ROUNDS = 12  # alternations of intersection and resection
SETTLED = 3.0  # median residual in sigmas, below which orientations are accurate enough for screening
PAIRS = 15  # ray pairs of a point tried
CAUCHY = 3.0  # width of the weights, in sigmas times the spread of all residuals
LARGEST = 9.0  # square of a residual in these widths, at which the cost is truncated
SUSPECT = 10.0  # sigmas times the spread, above which ray pairs of a point are tried
NEAR, FAR = 0.1, 10.0  # times the median range: limits of point distances


@dataclass
class Rays:
    """Rays (k,) of a block in its frame, from orientations that `improve` updates; angles in rad.

    `image` and `point` are numbers, `own` directions in the camera frame, `sigma` the standard deviation of a
    direction; `used` flags rays that the lens defines. `place` (points, 3) are the robust intersections, `residual`
    (k,) the angles between rays and intersections over their standard deviations, `spread` the typical ratio of the
    residuals to their expected size.
    """

    image: np.ndarray
    point: np.ndarray
    own: np.ndarray
    sigma: np.ndarray
    used: np.ndarray
    centre: np.ndarray
    R: np.ndarray
    names: np.ndarray
    place: np.ndarray = field(init=False)
    residual: np.ndarray = field(init=False)
    spread: float = field(init=False, default=1.0)

    @classmethod
    def of(cls, block: Block) -> Rays:
        """Rays with the start orientations of the block."""
        observations, images = block.observations, block.images
        image = images.rows_of(observations.image)
        names, point = np.unique(observations.point, return_inverse=True)
        own, sigma = np.empty((len(observations), 3)), np.empty(len(observations))
        for name, camera in block.cameras.items():
            rows = np.flatnonzero(images.camera[image] == name)
            if rows.size:
                own[rows] = camera_rays(camera, observations.uv[rows])
                sigma[rows] = observations.sigma[rows].mean(axis=1) / np.mean(np.asarray(camera.focal_px))
        used = np.all(np.isfinite(own), axis=1)
        own[~used] = [0.0, 0.0, 1.0]
        rays = cls(image, point, own, sigma, used, images.centre.copy(), images.R_frame_from_camera.copy(), names)
        rays._meet()
        if has_readout(block):
            rays._at_middle(block)
        return rays

    def _at_middle(self, block: Block) -> None:
        """Replace the directions by those at the middle of each image, towards the same points: of rays that start from
        where the camera is at the time of their row, as far as the intersections are away."""
        shift, turn = in_motion(block, self.image, block.observations.uv[:, 1])
        ranges = np.linalg.norm(self.place[self.point] - self.centre[self.image], axis=1)
        ranges = np.clip(ranges, 0.5 * self._range, 2.0 * self._range)  # of gross errors, about the others'
        direction = np.einsum("kij,kj->ki", turn, self.direction) + shift / ranges[:, None]
        own = np.einsum("kji,kj->ki", self.R[self.image], direction)
        self.own = own / np.linalg.norm(own, axis=1, keepdims=True)
        self._meet()

    @cached_property
    def _of_points(self) -> _Sums:
        return _Sums.of(self.point)

    @cached_property
    def _of_images(self) -> _Sums:
        return _Sums.of(self.image)

    @cached_property
    def checked(self) -> np.ndarray:
        """Redundancy share (k,) by which the other rays of its point check a ray: 1/4 for one of two."""
        count = np.bincount(self.point, weights=self.used, minlength=len(self.names))[self.point]
        return np.maximum(1.0 - 1.5 / np.maximum(count, 1.0), 0.0)

    @property
    def direction(self) -> np.ndarray:
        """Unit directions (k, 3) in the frame."""
        return np.einsum("kij,kj->ki", self.R[self.image], self.own)

    def improve(self, free: np.ndarray) -> None:
        """Alternate resection of the `free` (n,) images and intersection until the rays agree."""
        for _ in range(ROUNDS):
            if self.spread < SETTLED or not np.any(free):
                return
            before = self.spread, self.centre.copy(), self.R.copy()
            self._resect(free)
            self._meet()
            if self.spread > 0.9 * before[0]:
                if self.spread > before[0]:
                    _, self.centre, self.R = before
                    self._meet()
                return

    def off(self, place: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Angles (k,) between the given rays and positions (k, 3), over their standard deviations."""
        to = place - self.centre[self.image[rows]]
        direction = np.einsum("kij,kj->ki", self.R[self.image[rows]], self.own[rows])
        across = np.linalg.norm(np.cross(direction, to), axis=1)
        return np.arctan2(across, np.sum(direction * to, axis=1)) / self.sigma[rows]

    def covariance(self, point: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Covariance (m, 3, 3) in m2 of the intersections of some points by the rays kept; infinite for parallel rays.

        Scaled by the residuals.
        """
        normal, _ = self._normal(kept & self.used, self.place, 1.0)
        scale, eye = np.trace(normal[point], axis1=1, axis2=2), np.eye(3)
        parallel = np.linalg.eigvalsh(normal[point])[:, 0] <= 1e-9 * scale
        safe = np.where(parallel[:, None, None], eye, normal[point])
        found = np.linalg.inv(safe) * max(1.0, self.spread) ** 2
        return np.where(parallel[:, None, None], np.inf * eye, found) if np.any(parallel) else found

    def _normal(self, rows: np.ndarray, place: np.ndarray | None, weight: np.ndarray | float) -> tuple:
        """Normal equations (points, 3, 3) and right-hand sides (points, 3) of the intersections."""
        d, c = self.direction, self.centre[self.image]
        ranges = 1.0 if place is None else np.maximum(np.linalg.norm(place[self.point] - c, axis=1), 1e-9)
        w = np.where(rows, weight / (self.sigma * ranges) ** 2, 0.0)
        across = (np.eye(3) - d[:, :, None] * d[:, None, :]) * w[:, None, None]
        return self._of_points.sums(across), self._of_points.sums(np.einsum("kij,kj->ki", across, c))

    def _meet(self) -> None:
        """Robust intersections of all points: least squares, or the ray pair with the most support."""
        place = _solved(*self._normal(self.used, None, 1.0))
        place = _solved(*self._normal(self.used, place, 1.0))
        everything = np.arange(len(self.point))
        residual = np.where(self.used, self.off(place[self.point], everything), np.inf)
        self.spread = max(1.0, _spread(residual[self.used]))
        limit = np.maximum(SUSPECT * self.spread, 5.0)
        worst = np.zeros(len(self.names))
        np.maximum.at(worst, self.point[self.used], residual[self.used])
        for point in np.flatnonzero(worst > limit).tolist():
            rows = self._of_points.rows(point)
            rows = rows[self.used[rows]]
            if len(rows) > 2:
                place[point] = self._agreed(rows, place[point])
        self.place = place
        self.residual = np.where(self.used, self.off(place[self.point], everything), np.inf)
        self.spread = max(1.0, _spread(self.residual[self.used]))

    def _agreed(self, rows: np.ndarray, start: np.ndarray) -> np.ndarray:
        """The intersection of a ray pair that fits most of a point's rays."""
        width = CAUCHY * self.spread
        d, c = np.einsum("kij,kj->ki", self.R[self.image[rows]], self.own[rows]), self.centre[self.image[rows]]
        across = np.eye(3) - d[:, :, None] * d[:, None, :]
        i, j = np.triu_indices(len(rows), 1)
        angle = np.linalg.norm(np.cross(d[i], d[j]), axis=1)
        if len(i) > PAIRS:
            chosen = np.unique(np.concatenate([np.argsort(-angle)[:PAIRS], np.arange(len(i))[:: len(i) // PAIRS]]))
            i, j = i[chosen], j[chosen]
        normal = across[i] + across[j]
        right = np.einsum("pij,pj->pi", across[i], c[i]) + np.einsum("pij,pj->pi", across[j], c[j])
        tried = np.concatenate([start[None], _solved(normal, right)])
        off = np.stack([self.off(np.broadcast_to(place, c.shape), rows) for place in tried])
        ranges = np.linalg.norm(tried[:, None] - c[None], axis=2)
        usual = np.median(np.linalg.norm(start[None] - c, axis=1)) if not hasattr(self, "place") else self._range
        far = np.any((ranges < NEAR * usual) | (ranges > FAR * usual), axis=1)
        cost = _truncated(off / width) + 1e3 * far
        best, place = int(np.argmin(cost)), tried[np.argmin(cost)]
        weight = 1.0 / (1.0 + (off[best] / width) ** 2) ** 2 / (self.sigma[rows] * ranges[best]) ** 2
        normal = np.einsum("k,kij->ij", weight, across)
        if np.linalg.eigvalsh(normal)[0] > 1e-9 * np.trace(normal):
            refined = np.linalg.solve(normal, np.einsum("k,kij,kj->i", weight, across, c))
            again = _truncated(self.off(np.broadcast_to(refined, c.shape), rows) / width)
            place = refined if again <= cost[best] else place
        return place

    @property
    def _range(self) -> float:
        """Median range of the rays, m."""
        return float(np.median(np.linalg.norm(self.place[self.point] - self.centre[self.image], axis=1)))

    def _resect(self, free: np.ndarray) -> None:
        """One robust resection step of all images: shift in m, rotation in rad about the frame's axes."""
        to = self.place[self.point] - self.centre[self.image]
        ranges = np.maximum(np.linalg.norm(to, axis=1), 1e-9)
        ahead, d = to / ranges[:, None], self.direction
        off = np.cross(d, ahead)  # small rotation from a ray to its point
        usable = self.used & (np.sum(d * ahead, axis=1) > 0.5)
        weight = self.checked / (self.sigma * (1.0 + (self.residual / (CAUCHY * self.spread)) ** 2)) ** 2
        w = np.where(usable, weight, 0.0)
        # # A rotation t moves the ray by t; a shift s of the centre moves its point the opposite way, by d x s / range.
        across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
        crossed = _skew(ahead) / ranges[:, None, None]
        A = np.concatenate([crossed, across], axis=2)
        weighted = A * w[:, None, None]
        normal = self._of_images.sums(np.swapaxes(weighted, 1, 2) @ A)
        right = self._of_images.sums(np.einsum("kai,ka->ki", weighted, off))
        scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
        normal = normal / scale[:, :, None] / scale[:, None, :] + 1e-3 * np.eye(6)
        step = np.linalg.solve(normal, (right / scale)[:, :, None])[:, :, 0] / scale
        enough = np.bincount(self.image, weights=usable, minlength=len(free)) >= 4
        step = np.where((free & enough)[:, None], step, 0.0)
        self.centre = self.centre + step[:, :3]
        self.R = turns(step[:, 3:]) @ self.R


@dataclass(frozen=True)
class _Sums:
    """Grouped sums over rows by a number; every number occurs."""

    order: np.ndarray
    first: np.ndarray

    @classmethod
    def of(cls, number: np.ndarray) -> _Sums:
        order = np.argsort(number, kind="stable")
        return cls(order, np.flatnonzero(np.diff(number[order], prepend=-1)))

    def sums(self, values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values[self.order], self.first, axis=0)

    def rows(self, number: int) -> np.ndarray:
        last = self.first[number + 1] if number + 1 < len(self.first) else len(self.order)
        return self.order[self.first[number] : last]


def _spread(residual: np.ndarray) -> float:
    """Ratio of the residuals to their expected size for a direction, from their median (robust to blunders)."""
    return float(np.median(residual) / 0.8) if len(residual) else 1.0


def _truncated(off: np.ndarray) -> Any:
    """Sum of squares along the last axis, each truncated at `LARGEST`: the size of an outlier carries no
    information."""
    return np.sum(np.minimum(off**2, LARGEST), axis=-1)


def _solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions of small systems; singular ones are regularised."""
    trace = np.maximum(np.trace(normal, axis1=1, axis2=2), 1e-300)
    held = normal + 1e-12 * trace[:, None, None] * np.eye(3)
    held = np.where((trace > 1e-299)[:, None, None], held, np.eye(3))
    return np.linalg.solve(held, right[:, :, None])[:, :, 0]


def _skew(v: np.ndarray) -> np.ndarray:
    """Matrices (k, 3, 3) of the cross products v x."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def turns(vector: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) from rotation vectors, rad."""
    import scipy  # submodules load lazily

    return scipy.spatial.transform.Rotation.from_rotvec(vector).as_matrix()
