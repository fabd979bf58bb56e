"""Relative orientations of cameras on one mount, as an adjustment finds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxgeo.adjust import Adjustment
from jaxgeo.ties.views import Views


@dataclass(frozen=True)
class RelativeOrientation:
    """Orientation of camera `second` against camera `first` on one mount, from `shots` exposures of both.

    `turned` (3,) in rad is the rotation vector from the stated orientation to the adjusted one, and `moved` (3,) in m
    the same of the perspective centre, both in the axes of the first camera (right, down, forward); `sigma_turned` and
    `sigma_moved` (3,) are their standard deviations.
    """

    first: str
    second: str
    shots: int
    turned: np.ndarray
    sigma_turned: np.ndarray
    moved: np.ndarray
    sigma_moved: np.ndarray

    @property
    def is_held(self) -> bool:
        """Whether the orientation is held as stated, for want of mounting errors."""
        return not np.any(self.sigma_turned > 0.0)

    def words(self) -> str:
        """A sentence."""
        cameras = f"Camera {self.second} against camera {self.first}, in {self.shots} shots"
        if self.is_held:
            return (
                f"{cameras}: held as stated, as no error of its mounting is; state a CameraMounting, or a Boresight "
                f"where each has a mount of its own."
            )
        turned, sigma = (", ".join(f"{np.rad2deg(x):.2g}" for x in one) for one in (self.turned, self.sigma_turned))
        return f"{cameras}: turned by {turned} deg about its right, down and forward (one sigma {sigma})."


def relative_orientations(views: Views, adjustment: Adjustment) -> list[RelativeOrientation]:
    """Each camera against an earlier one, that with which it has most shots; [] without shots of several cameras."""
    if views.shot is None:
        return []
    of_camera: dict[str, dict[int, int]] = {}
    adjusted = {str(name) for name in adjustment.images.name}
    for row, name in enumerate(views.name.tolist()):
        if name in adjusted:
            of_camera.setdefault(str(views.camera[row]), {})[int(views.shot[row])] = row
    found, known = [], list(of_camera)
    for k, second in enumerate(known):
        shared = [(len(of_camera[one].keys() & of_camera[second].keys()), one) for one in known[:k]]
        count, first = max(shared, key=lambda one: one[0], default=(0, ""))
        if count:
            shot = min(of_camera[first].keys() & of_camera[second].keys())
            rows = of_camera[first][shot], of_camera[second][shot]
            found.append(_relative(views, adjustment, rows, (first, second), count))
    return found


def _relative(
    views: Views, adjustment: Adjustment, rows: tuple[int, int], cameras: tuple[str, str], count: int
) -> RelativeOrientation:
    """By the numbers that images share: what moves the mount as a whole cancels."""
    names = adjustment.prepared.names.common
    zero = np.zeros((len(views), 6))
    one, other = (np.stack([views.common.get(name, zero)[row] for name in names], axis=1) for row in rows)
    R = [views.R_frame_from_camera[row] for row in rows]
    away = R[0].T @ (views.centre[rows[1]] - views.centre[rows[0]])
    turn = R[0].T @ R[1] @ other[3:] - one[3:]
    move = R[0].T @ (other[:3] - one[:3]) - np.cross(one[3:], away, axisa=0, axisc=0)
    J = np.concatenate([turn, move])
    J[np.abs(J) < 1e-12 * np.max(np.abs(np.concatenate([one, other])))] = 0.0  # what cancels but for rounding
    covariance = J @ adjustment.covariance_of_shared[-len(names) :, -len(names) :] @ J.T
    value = J @ np.asarray(adjustment.solution.values.common)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return RelativeOrientation(*cameras, count, value[:3], sigma[:3], value[3:], sigma[3:])
