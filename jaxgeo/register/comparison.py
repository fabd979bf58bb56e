"""What is compared in a pass of a registration: the image and the reference, brought into cells that both share."""

from __future__ import annotations

import abc
from typing import Any

import numpy as np

from jaxgeo.register.blocks import Matches
from jaxgeo.register.choice import Chosen
from jaxgeo.register.images import Images
from jaxgeo.register.prediction import Shifts
from jaxgeo.register.ties import TiePoints
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs


class AbstractComparison(abc.ABC):
    """An image, as a look has it, and a reference in the same cells, (rows, cols), with what is known of either.

    `cell` is the side of a cell on the ground, m. Made from `place`, what a plan says of where to compare.
    """

    grey: np.ndarray
    known: np.ndarray
    reference: np.ndarray
    known_reference: np.ndarray
    cell: float

    @abc.abstractmethod
    def __init__(self, look: ModelInputs, model: ErrorModel, images: Images, place: Any, block: int) -> None:
        """Bring both together, with room for blocks of so many cells beside. Raises `Stopped` if there is nothing."""

    @abc.abstractmethod
    def shifts(self, places: np.ndarray, reach: float) -> Shifts:
        """What the navigation's errors do to places (n, 2), (row, col): blocks that reach so many cells."""

    @abc.abstractmethod
    def ties(self, matches: Matches, chosen: Chosen, shifts: Shifts) -> TiePoints:
        """Tie points of the chosen blocks that are seen: the pixel of a block's middle, and the ground of which the
        reference shows the same."""


def tied(chosen: Chosen, shifts: Shifts) -> np.ndarray:
    """Which blocks become ties: those that are chosen, and whose middle is seen."""
    return np.asarray(chosen.is_chosen) & np.asarray(shifts.seen)


def on_ground(covariance: np.ndarray, cells_per_metre: np.ndarray) -> np.ndarray:
    """Covariances (n, 2, 2) of shifts in cells2 as such of places to the east and north, m2."""
    metres = np.linalg.inv(cells_per_metre)
    turned = metres @ covariance @ np.swapaxes(metres, 1, 2)
    return 0.5 * (turned + np.swapaxes(turned, 1, 2))
