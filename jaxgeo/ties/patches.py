"""Plane patches: parts of two images resampled to cells on the ground, stacked for block matching."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxgeo.register.blocks import cut
from jaxgeo.register.gradient_orientation import orientation_channels
from jaxgeo.ties.pictures import Pictures, sample
from jaxgeo.ties.views import Projected, Views, project_planes


class Patches(NamedTuple):
    """n patches of (rows, cols) cells below each other, (n rows, cols), and their known cells; `shape` of one. `grey`
    may have several channels (channels, n rows, cols)."""

    grey: np.ndarray
    known: np.ndarray
    shape: tuple[int, int]

    def centres(self) -> np.ndarray:
        """Centres (n, 2) of the patches, (row, col) in the stack."""
        rows, cols = self.shape
        first = rows * np.arange(len(self.known) // rows)
        return np.stack([first + 0.5 * (rows - 1), np.full(len(first), 0.5 * (cols - 1))], axis=1)

    def of(self, chosen: np.ndarray) -> Patches:
        """Some of the patches."""
        return _stacked(*(one[..., chosen, :, :] for one in self.apart()))

    def apart(self) -> tuple[np.ndarray, np.ndarray]:
        """(values (..., n, rows, cols), known cells (n, rows, cols)) of the patches."""
        grey, known = (x.reshape(*x.shape[:-2], -1, *self.shape) for x in (self.grey, self.known))
        return grey, known

    def oriented(self) -> Patches:
        """The channels of the orientation of the patches, each by itself."""
        return _stacked(*orientation_channels(*self.apart()))

    def cut(self, moved: np.ndarray, side: int) -> Patches:
        """Squares of `side` cells (even, as the patches are) around points `moved` (n, 2) whole cells from the
        centres; unknown beyond the patches."""
        first = (np.array(self.shape) - side) // 2 + moved.astype(int)
        parts = [
            np.stack([cut(values[..., k, :, :], corner, (side, side)) for k, corner in enumerate(first)], axis=-3)
            for values in self.apart()
        ]
        return _stacked(parts[0], parts[1])


def _stacked(grey: np.ndarray, known: np.ndarray) -> Patches:
    """Patches from values (..., n, rows, cols) and known cells (n, rows, cols)."""
    rows, cols = known.shape[1:]
    return Patches(grey.reshape(*grey.shape[:-3], -1, cols), known.reshape(-1, cols), (rows, cols))


def patches_of(
    views: Views,
    row: int,
    pictures: Pictures,
    origin: np.ndarray,
    axes: np.ndarray,
    cell: float,
    shape: tuple[int, int],
) -> Patches:
    """Patches of `cell` m around `origin` (n, 3) on planes with `axes` (n, 2, 3), as one image shows them."""
    half = 0.5 * cell * (np.array(shape) - 1.0)
    found = project_planes(views.camera_of(row), views.centre[row], views.R_frame_from_camera[row], origin, axes, half)
    fine = np.median(_smallest(found)) * cell  # pixels of a cell
    power = max(int(np.floor(np.log2(max(fine, 1.0)) + 0.3)), 0)
    level = pictures.level(row, power)
    uv = _between(found.nodes, shape)
    grey, known = sample(level, uv, power)
    known &= found.visible[:, None, None]
    return Patches(grey.reshape(-1, shape[1]), known.reshape(-1, shape[1]), shape)


def _smallest(found: Projected) -> np.ndarray:
    """Smaller singular values (n,) of the derivatives by the plane, px per m."""
    return np.linalg.svd(np.nan_to_num(found.by_plane), compute_uv=False)[:, 1]


def _between(nodes: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Pixels (n, rows, cols, 2) of cells, by biquadratic interpolation between the nodes: under 0.01 px off for a
    perspective image and a lens."""
    by_row, by_col = (_basis(np.linspace(-1.0, 1.0, count)) for count in shape)
    return np.einsum("ri,nijk,cj->nrck", by_row, np.nan_to_num(nodes, nan=-1e6), by_col, optimize=True)


def _basis(t: np.ndarray) -> np.ndarray:
    """Lagrange polynomials of -1, 0, 1 at t, (count, 3)."""
    return np.stack([0.5 * t * (t - 1.0), 1.0 - t * t, 0.5 * t * (t + 1.0)], axis=1)
