"""Linear observations of orientations, such as of the points of a map that an image shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class PoseRows:
    """r linear observations of the orientation of each of n images: offset + by_pose x + by_lens y + by_common z.

    All have zero mean and unit standard deviation, independent of each other; rows of zeros observe nothing. x (6) is
    the change of an orientation from `centre` (n, 3), m, and `R_frame_from_camera` (n, 3, 3): of the centre in m, in
    the axes of the block's frame, and the rotation vector about the camera's axes, rad. y (l) is the change of the
    interior orientation and lens from those of the block's cameras, in the order of `names_of_interior`, and z are
    common numbers by name with standard normal priors; names that `Navigation.common` does not have are added to it.
    `offset` (n, r), `by_pose` (n, r, 6), `by_lens` (n, r, l), `by_common` (n, r) of each name.
    """

    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    offset: np.ndarray
    by_pose: np.ndarray
    by_lens: np.ndarray
    by_common: Mapping[str, np.ndarray]

    def of(self, rows: np.ndarray) -> PoseRows:
        """Those of some images."""
        arrays = {name: getattr(self, name)[rows] for name in ARRAYS}
        return PoseRows(**arrays, by_common={name: one[rows] for name, one in self.by_common.items()})

    def weighted(self, factor: float) -> PoseRows:
        """A copy with all rows times `factor`."""
        common = {name: one * factor for name, one in self.by_common.items()}
        return replace(
            self,
            offset=self.offset * factor,
            by_pose=self.by_pose * factor,
            by_lens=self.by_lens * factor,
            by_common=common,
        )

    def columns(self, names: tuple[str, ...]) -> np.ndarray:
        """`by_common` (n, r, k) of the given names; zero for others."""
        none = np.zeros(self.offset.shape)
        return np.stack([none, *(self.by_common.get(name, none) for name in names)], axis=2)[:, :, 1:]


ARRAYS = ("centre", "R_frame_from_camera", "offset", "by_pose", "by_lens")
