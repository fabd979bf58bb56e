"""Interface of image comparisons: image and reference resampled to one grid of cells."""

from __future__ import annotations

import abc
from typing import Any

import numpy as np

from jaxgeo.register.blocks import Matches, block_shape
from jaxgeo.register.choice import Chosen
from jaxgeo.register.images import Images
from jaxgeo.register.prediction import Shifts
from jaxgeo.register.ties import TiePoints
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs


class AbstractComparison(abc.ABC):
    """Image and reference in the same cells, (rows, cols) or (channels, rows, cols), with masks (rows, cols) of valid
    cells.

    `cell` is the side of a cell on the ground, m, `block` that of a block in cells. Constructed from `place`, the part
    of a plan that defines the cells.
    """

    grey: np.ndarray
    known: np.ndarray
    reference: np.ndarray
    known_reference: np.ndarray
    cell: float
    block: int

    @abc.abstractmethod
    def __init__(self, inputs: ModelInputs, model: ErrorModel, images: Images, place: Any, block: int) -> None:
        """Resample both, with a margin of `block` cells. Raises `RegistrationFailed` if there is nothing to compare."""

    @abc.abstractmethod
    def shifts(self, places: np.ndarray, reach: float) -> Shifts:
        """Effect of the navigation errors at (n, 2), (row, col), for blocks that extend `reach` cells to each side."""

    @abc.abstractmethod
    def ties(self, matches: Matches, chosen: Chosen, shifts: Shifts) -> TiePoints:
        """Tie points of the chosen blocks whose centres are visible: the pixel of the block's centre, and the ground
        position of the same content in the reference."""

    def sides(self, cells_per_metre: np.ndarray) -> np.ndarray:
        """Sides (n, 2, 2) of blocks on the ground as columns, to the east and north in m."""
        return sides_on_ground(block_shape(self.known.shape, self.block), cells_per_metre)


def tied(chosen: Chosen, shifts: Shifts) -> np.ndarray:
    """Flags of blocks that become ties: chosen, with a visible centre."""
    return np.asarray(chosen.is_chosen) & np.asarray(shifts.visible)


def sides_on_ground(shape: tuple[int, int], cells_per_metre: np.ndarray) -> np.ndarray:
    """Sides (n, 2, 2) of blocks of `shape` (rows, cols) cells as columns, to the east and north in m."""
    return np.linalg.inv(cells_per_metre) * np.array(shape)[None, None, :]


def on_ground(covariance: np.ndarray, cells_per_metre: np.ndarray) -> np.ndarray:
    """Covariances (n, 2, 2) of shifts in cells2 converted to east and north, m2."""
    metres = np.linalg.inv(cells_per_metre)
    turned = metres @ covariance @ np.swapaxes(metres, 1, 2)
    return 0.5 * (turned + np.swapaxes(turned, 1, 2))
