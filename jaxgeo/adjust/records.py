"""Image point measurements of a block, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:  # any sequence of names is accepted and converted to an array of str
    Names: TypeAlias = Any
else:
    Names: TypeAlias = np.ndarray | Sequence[str]


@dataclass(frozen=True)
class ImagePoints:
    """Measured image points, one per row: point name, image name, pixel, standard deviation.

    `image` and `point` are names (n,); `uv` (n, 2) are (column, row) in px with pixel centres at integers; `sigma` (n,
    2) their standard deviations in px. A single number, or one per row, applies to both axes. Raises `ValueError` for
    numbers that are not finite, sigmas that are not positive, and a point that is measured twice in one image, naming
    image and point.
    """

    image: Names
    point: Names
    uv: np.ndarray
    sigma: Any = 1.0

    def __post_init__(self) -> None:
        image, point = as_names(self.image, "image"), as_names(self.point, "point")
        uv = np.asarray(self.uv, np.float64)
        if uv.shape != (len(image), 2) or len(point) != len(image):
            raise ValueError(
                f"image, point and uv must have one entry for each measurement, uv of shape (n, 2); got {len(image)} "
                f"images, {len(point)} points and uv of shape {uv.shape}."
            )
        sigma = _both_axes(self.sigma, len(image))
        for name, value in (("image", image), ("point", point), ("uv", uv), ("sigma", sigma)):
            object.__setattr__(self, name, value)
        self._refuse(~np.all(np.isfinite(uv), axis=1), "uv", "must be finite; leave out what was not measured")
        wrong = ~np.all(np.isfinite(sigma) & (sigma > 0.0), axis=1)
        self._refuse(wrong, "sigma", "must be positive and finite, in px")
        self._refuse_doubles()

    def __len__(self) -> int:
        return len(self.image)

    @cached_property
    def image_numbers(self) -> tuple[np.ndarray, np.ndarray]:
        """(names in order, the index (n,) of each row's image among them)."""
        return np.unique(self.image, return_inverse=True)

    @cached_property
    def point_numbers(self) -> tuple[np.ndarray, np.ndarray]:
        """(names in order, the index (n,) of each row's point among them)."""
        return np.unique(self.point, return_inverse=True)

    def of(self, rows: Any) -> ImagePoints:
        """A subset of the measurements, by index or flag."""
        return ImagePoints(self.image[rows], self.point[rows], self.uv[rows], self.sigma[rows])

    def seen_often(self, least: int = 2, known: Sequence[str] = ()) -> ImagePoints:
        """The measurements of points that are in at least `least` images, or among those `known`."""
        names, point = self.point_numbers
        return self.of(((np.bincount(point) >= least) | np.isin(names, list(known)))[point])

    @classmethod
    def joined(cls, parts: Sequence[ImagePoints]) -> ImagePoints:
        """Several sets of measurements concatenated."""
        fields = ("image", "point", "uv", "sigma")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))

    def _refuse(self, wrong: np.ndarray, field: str, reason: str) -> None:
        if np.any(wrong):
            row = int(np.argmax(wrong))
            value = getattr(self, field)[row].tolist()
            others = f" ({int(np.sum(wrong))} such rows)" if np.sum(wrong) > 1 else ""
            raise ValueError(
                f"measurement {row}, point {self.point[row]} in image {self.image[row]}: {field} {reason}; "
                f"got {value}{others}."
            )

    def _refuse_doubles(self) -> None:
        _, image = np.unique(self.image, return_inverse=True)
        points, point = np.unique(self.point, return_inverse=True)
        keys = image.astype(np.int64) * max(len(points), 1) + point
        order = np.argsort(keys, kind="stable")
        same = keys[order][1:] == keys[order][:-1]
        if np.any(same):
            first, second = order[int(np.argmax(same))], order[int(np.argmax(same)) + 1]
            raise ValueError(
                f"point {self.point[first]} is measured twice in image {self.image[first]}, in rows {first} and "
                f"{second}; keep one of them."
            )


def as_names(values: Any, what: str) -> Names:
    """Names as an array of str; raises `TypeError` for anything else."""
    names = np.asarray(values)
    if names.ndim != 1 or (names.size and names.dtype.kind not in "US"):
        if names.ndim == 1 and names.dtype == object and all(isinstance(name, str) for name in names):
            return names.astype(str)
        raise TypeError(f"{what} must be a list of names (str); got {names.dtype} of shape {names.shape}.")
    return names.astype(str)


def _both_axes(sigma: Any, count: int) -> np.ndarray:
    sigma = np.asarray(sigma, np.float64)
    if sigma.shape not in ((), (count,), (count, 2)):
        raise ValueError(f"sigma must be a number, one for each row, or (n, 2), in px; got shape {sigma.shape}.")
    return np.broadcast_to(sigma[:, None] if sigma.ndim == 1 else sigma, (count, 2)).copy()
