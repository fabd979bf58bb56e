"""Points of a pair of images: planes of the ground, and what moves a point of the second image on them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxgeo.ties.ground import Planes
from jaxgeo.ties.views import Views, project_planes

SMALL_LEAN = 0.01  # m per m of height: below it, the epipolar direction is arbitrary


class Geometry(NamedTuple):
    """Visible points of a pair: planes' origins and axes (row, col), derivatives in m of the shift by the errors of
    both poses (n, 2, 12) and by the height (n, 2), and the size of a cell in m."""

    rows: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    by_pose: np.ndarray
    by_height: np.ndarray
    cell: float

    def of(self, kept: np.ndarray) -> Geometry:
        """Some of the points."""
        return Geometry(
            self.rows[kept], self.origin[kept], self.axes[kept], self.by_pose[kept], self.by_height[kept], self.cell
        )


def geometry_of(views: Views, both: tuple[int, int], planes: Planes) -> Geometry:
    """Points that the second image sees, by the navigation."""
    leans = [_lean(planes, views.centre[row]) for row in both]
    lean = leans[1] - leans[0]
    axes = _axes(planes, lean)
    views_of = [
        project_planes(
            views.camera_of(row), views.centre[row], views.R_frame_from_camera[row], planes.origin, axes, [1, 1]
        )
        for row in both
    ]
    steep = np.sum(planes.normal * (planes.origin - views.centre[both[1]]), axis=1)
    rows = np.flatnonzero(planes.known & views_of[0].visible & views_of[1].visible & (steep < 0.0))
    if not len(rows):
        empty = [np.zeros((0, *part)) for part in ((3,), (2, 3), (2, 12), (2,))]
        return Geometry(rows, empty[0], empty[1], empty[2], empty[3], 1.0)
    by_plane = [one.by_plane[rows] for one in views_of]
    cell = max(float(np.median(np.abs(np.linalg.det(one)) ** -0.5)) for one in by_plane)
    sides = [np.linalg.solve(one, seen.by_pose[rows]) for one, seen in zip(by_plane, views_of, strict=True)]
    by_height = np.einsum("nax,nx->na", axes[rows], lean[rows])
    return Geometry(
        rows, planes.origin[rows], axes[rows], np.concatenate([-sides[0], sides[1]], axis=2), by_height, cell
    )


def _lean(planes: Planes, centre: np.ndarray) -> np.ndarray:
    """Shift on the plane (n, 3), m per m, of a point that lies higher, as seen from a centre."""
    away = planes.origin - centre
    slant = np.sum(planes.normal * planes.up, axis=1) / np.sum(planes.normal * away, axis=1)
    return planes.up - slant[:, None] * away


def _axes(planes: Planes, lean: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 2, 3) on the planes: rows across, columns along the epipolar direction."""
    far = np.linalg.norm(lean, axis=1) > SMALL_LEAN
    other = np.cross(np.array([0.0, 1.0, 0.0]), planes.normal)  # level enough: east
    along = np.where(far[:, None], lean, other)
    along = along / np.linalg.norm(along, axis=1)[:, None]
    return np.stack([np.cross(planes.normal, along), along], axis=1)
