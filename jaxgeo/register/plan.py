"""Planning of a registration pass: comparison type, cell size and block size."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxgeo._record import Record
from jaxgeo.register.choice import AbstractChoice
from jaxgeo.register.comparison import AbstractComparison
from jaxgeo.register.images import Images, RegistrationFailed
from jaxgeo.register.in_image import ImagePlace, InImage, shifts_in_image
from jaxgeo.register.on_map import MapPlace, OnMap
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.prediction import Shifts, shifts_of, window_of
from jaxgeo.terrain.grid import AbstractGrid
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs

SIDES = (32, 48, 64, 96, 128, 192, 256, 300)  # cells of a block: few sizes, few compilations
LATTICE = 9  # positions along a side of the window at which shifts are predicted
FAR = 40.0  # cells: standard deviation of a shift above which coarser cells are used
SURE = 5.0  # cells: standard deviation below which blocks may be many and small
FEW, MANY = 16, 48  # target numbers of blocks
BENT = 2.5  # cells: one-sigma difference between the shifts of a block's edge and its centre
FEWEST_CELLS = 64  # on a side of the image, at least
FAR_IN_IMAGE = 20.0  # `FAR` in image space, where the reference is rendered cell by cell
MOST_FAR = 250.0  # cells: standard deviation of a shift above which the search is refused
OBLIQUE = 2.0  # ground stretch along the line of sight, above which the comparison is in image space
WIDE = 3.7  # standard deviations of the margin rendered around the image
STEP = 8  # cells: the margin is a multiple of it


class Search(NamedTuple):
    """Search options: the candidate selection, the probability of the search area, the largest block in cells."""

    choice: AbstractChoice
    probability: float
    block: int


class Plan(Record):
    """A pass: comparison type and cells; blocks of `block` cells. `is_last` if no finer pass follows."""

    comparison: type[AbstractComparison] = eqx.field(static=True)
    place: Any
    block: int
    is_last: bool


class _Size(NamedTuple):
    """Cell size of a pass as a `factor`, the side of a block, and whether no finer pass follows."""

    factor: int
    block: int
    is_last: bool


def planned(
    inputs: ModelInputs, model: ErrorModel, covariance: np.ndarray, images: Images, search: Search, coarser: int = 0
) -> Plan:
    """Plan of a pass from model inputs whose errors and map shift have `covariance` (axes + 2, axes + 2).

    `coarser` is the number of additional halvings of the resolution. Raises `RegistrationFailed` if there is nothing to
    match.
    """
    reference = images.reference
    window = window_of(inputs, reference.grid, reference.shape)
    if window is None:
        raise RegistrationFailed(Outcome.no_overlap)
    shifts, share = _foretold(inputs, model, reference.grid, window)
    finest = max(1, round(float(np.median(shifts.ground_sampling)) / reference.ground_sampling))
    side = np.sqrt(share * (window[2] - window[0]) * (window[3] - window[1]))
    if float(np.median(shifts.stretch)) > OBLIQUE:
        return _in_image(inputs, model, covariance, images, search, coarser)
    bends = _bends(shifts, covariance)
    size = _sized(side, _spread(shifts.covariance(covariance)), bends, finest, FAR, search, coarser)
    if size.block * bends > 2.0 * BENT:
        return _in_image(inputs, model, covariance, images, search, coarser)
    top, left, bottom, right = window
    coarse = top // size.factor, left // size.factor, -(-bottom // size.factor), -(-right // size.factor)
    return Plan(OnMap, MapPlace(size.factor, coarse), size.block, size.is_last)


def _in_image(
    inputs: ModelInputs, model: ErrorModel, covariance: np.ndarray, images: Images, search: Search, coarser: int
) -> Plan:
    """Plan of a pass in image space."""
    rows, cols = images.grey.shape[1:]
    t = (np.arange(LATTICE) + 0.5) / LATTICE
    row, col = np.meshgrid(t * rows - 0.5, t * cols - 0.5, indexing="ij")
    found = shifts_in_image(inputs, model, np.stack([col.ravel(), row.ravel()], axis=1), 1)
    seen = np.asarray(found.seen)
    if not seen.any():
        raise RegistrationFailed(Outcome.unknown_ground)
    shifts = Shifts(*(np.asarray(part)[seen] for part in found))
    moved = shifts.covariance(covariance)
    sampling, cell = float(np.median(shifts.ground_sampling)), images.reference.ground_sampling
    finest = max(1, round(cell / sampling))
    side = np.sqrt(seen.mean() * rows * cols)
    size = _sized(side, _spread(moved), 0.0, finest, FAR_IN_IMAGE, search, coarser)
    extent = WIDE * np.sqrt(np.quantile(np.diagonal(moved, axis1=1, axis2=2), 0.9, axis=0)) / size.factor
    down, across = (int(STEP * np.ceil((x + 2.0) / STEP)) for x in extent)
    source = max(1, round(0.7 * size.factor * sampling / cell))
    return Plan(InImage, ImagePlace(size.factor, source, (down, across), sampling), size.block, size.is_last)


def _sized(side: float, spread: float, bends: float, finest: int, far: float, search: Search, coarser: int) -> _Size:
    """Cell factor and block size for an image of `side` finest cells."""
    factor = finest
    while spread > far * factor and side / (2 * factor) >= FEWEST_CELLS:
        factor *= 2
    while coarser > 0 and side / (2 * factor) >= FEWEST_CELLS:
        factor, coarser = factor * 2, coarser - 1
    if side / factor < SIDES[0]:
        raise RegistrationFailed(Outcome.too_small)
    if not spread <= MOST_FAR * factor:
        raise RegistrationFailed(Outcome.too_vague)
    is_sure = spread <= SURE * factor
    fits = side / factor / np.sqrt(MANY if is_sure else FEW)
    straight = 2.0 * BENT / max(bends, 1e-9)
    return _Size(factor, _side(min(search.block, fits, straight)), is_sure and factor == finest)


def _foretold(
    inputs: ModelInputs, model: ErrorModel, grid: AbstractGrid, window: tuple[int, int, int, int]
) -> tuple[Shifts, float]:
    """(shifts at the visible positions of the window, the visible share of all positions)."""
    t = (np.arange(LATTICE) + 0.5) / LATTICE
    row, col = np.meshgrid(
        window[0] + t * (window[2] - window[0]) - 0.5, window[1] + t * (window[3] - window[1]) - 0.5, indexing="ij"
    )
    reach = 0.5 * min(window[2] - window[0], window[3] - window[1]) / LATTICE
    shifts = shifts_of(inputs, model, grid, np.stack([row.ravel(), col.ravel()], axis=1), reach)
    seen = np.asarray(shifts.seen)
    if not seen.any():
        raise RegistrationFailed(Outcome.unknown_ground)
    return Shifts(*(np.asarray(part)[seen] for part in shifts)), float(seen.mean())


def _bends(shifts: Shifts, covariance: np.ndarray) -> float:
    """Change of the shift per cell, one standard deviation: the stretch and rotation of the image by navigation
    errors."""
    change = _changes(shifts) @ _root(covariance)
    return _typical(change) if len(change) else 0.0


def _changes(shifts: Shifts) -> np.ndarray:
    """Differences of the shift derivatives between neighbouring positions, per cell of distance, (pairs, 2, axes).

    Each position is paired with its nearest neighbour in pixels.
    """
    uv = np.asarray(shifts.uv)
    by_error = np.asarray(shifts.by_error)
    per_metre = np.asarray(shifts.cells_per_metre)
    if len(uv) < 2:
        return np.zeros((0, *by_error.shape[1:]))
    apart = np.linalg.norm(uv[:, None] - uv[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = np.argmin(apart, axis=1)
    pixels = apart[np.arange(len(uv)), nearest]
    cells = pixels * np.asarray(shifts.ground_sampling) * np.sqrt(np.abs(np.linalg.det(per_metre)))
    return (by_error - by_error[nearest]) / cells[:, None, None]


def _typical(change: np.ndarray) -> float:
    """75 % quantile of changes (pairs, 2, axes) caused by errors of one standard deviation each."""
    return float(np.quantile(np.sqrt(np.sum(change**2, axis=(1, 2)) / 2.0), 0.75))


def _spread(covariance: np.ndarray) -> float:
    """90 % quantile of the largest standard deviation, of covariances (n, 2, 2) in cells2."""
    return float(np.quantile(np.sqrt(np.linalg.eigvalsh(covariance)[:, -1]), 0.9))


def _side(cells: float) -> int:
    return max(side for side in SIDES if side <= max(cells, SIDES[0]))


def _root(covariance: np.ndarray) -> np.ndarray:
    """Root of a possibly singular covariance of axes in different units."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
