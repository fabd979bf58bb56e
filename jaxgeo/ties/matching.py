"""Tie points between two images: predicted by navigation and terrain, found by area correlation on the ground."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from jaxgeo.register import BlockOutcome, Matches, PoseConsensus, false_alarms, match_blocks
from jaxgeo.register.choice import Chosen
from jaxgeo.register.gradient_orientation import TAPS as OF_GRADIENT
from jaxgeo.register.gradient_orientation import check_measure
from jaxgeo.register.refinement import TAPS
from jaxgeo.ties.ground import Planes
from jaxgeo.ties.pair_geometry import Geometry, geometry_of
from jaxgeo.ties.patches import Patches, patches_of
from jaxgeo.ties.pictures import Pictures
from jaxgeo.ties.sharpening import sharpened
from jaxgeo.ties.views import Views, project_planes

WIDTHS = (4, 8, 16, 32, 64)  # cells: half widths of search areas, few to limit compilation
REACH = 3.72  # standard deviations of the 0.999 ellipse
FINER = 4  # largest ratio of the cells of two passes
COARSEST = 64  # largest factor of the first pass
AGAIN = 0.5  # of a cell: standard deviation of a shift predicted by an earlier pass with such cells
SURE = 4.1  # cells: standard deviation of shifts above which another pass follows
# px, added in quadrature to the standard deviation of a measurement: positions of cells are interpolated to 0.01 px
# (see `patches`), which the residuals of a match do not show.
INTERPOLATED = 0.003
# Of a match by default. Unlike sensors agree on fewer orientations than images of one sensor do on grey values; chance,
# which a search allows for by itself (`match_blocks`), is about equal.
LEAST_SCORE = {"grey": 0.5, "orientation": 0.3}


class TieOutcome(enum.IntEnum):
    """Outcome of one point in a pair. Records hold it as an int8 array; `TieOutcome(code).message` is the sentence."""

    tied = 0
    not_visible = 1
    not_found = 2
    low_correlation = 3
    not_unique = 4
    off_epipolar = 5
    not_consistent = 6

    @property
    def message(self) -> str:
        """The outcome as a full sentence."""
        return _MESSAGES[self]


_MESSAGES = {
    TieOutcome.tied: "The point is measured in both images.",
    TieOutcome.not_visible: "The ground is unknown, too oblique, or predicted outside the other image.",
    TieOutcome.not_found: "The patch has no texture, or nothing in the search area correlates better than chance.",
    TieOutcome.low_correlation: "The best correlation is below the threshold.",
    TieOutcome.not_unique: "A second place correlates nearly as well.",
    TieOutcome.off_epipolar: "The match fits no common error of the two poses within their covariances.",
    TieOutcome.not_consistent: "Matching back from the second image, or most cells of the patch, lead elsewhere.",
}


@dataclass(frozen=True)
class Matching:
    """Options of `match_pair`.

    `sigma_height` in m is the standard deviation of terrain heights, independent between points; it sets the length of
    the search along the epipolar direction. `size` is the side of a block in cells, as large on the ground as pixels.
    A match needs a correlation of `least_score` (None: 0.5, of orientations 0.3), and no second one above `uniqueness`
    times it. `measure` is what is correlated: "grey" values, or the "orientation" of their gradients
    (`jaxgeo.register.orientation_channels`), for images of unlike sensors, bands or seasons. `tolerance` cells
    (standard deviation) is allowed for what pose errors do not explain, such as lens errors. Matching back must agree
    to `consistency` cells. A pair needs `least` matches that agree by chance in less than `false_alarms` of all cases.
    """

    sigma_height: float = 5.0
    size: int = 32
    least_score: float | None = None
    uniqueness: float = 0.9
    tolerance: float = 1.0
    consistency: float = 0.5
    least: int = 6
    false_alarms: float = 1e-3
    measure: str = "grey"

    def __post_init__(self) -> None:
        positive = ("sigma_height", "tolerance", "consistency", "false_alarms")
        for name in positive:
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive; got {getattr(self, name)!r}.")
        if self.size < 8 or self.size % 2:
            raise ValueError(f"size must be an even number of cells, 8 or more; got {self.size}.")
        check_measure(self.measure)
        for name in ("least_score", "uniqueness"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value <= 1.0:
                raise ValueError(f"{name} must lie in (0, 1]; got {value!r}.")
        if self.least < 3:
            raise ValueError(f"least must be 3 matches or more; got {self.least}.")

    @property
    def threshold(self) -> float:
        """Smallest correlation of a match."""
        return LEAST_SCORE[self.measure] if self.least_score is None else self.least_score


class PairMatches(NamedTuple):
    """Points of image `first` measured in image `second` (rows of the views).

    `uv_first`, `uv_second` (n, 2) are pixels and `sigma_first`, `sigma_second` (n, 2) their standard deviations, half
    of the variance of the match each; `score` (n,) is the correlation and `outcome` (n,) an int8 `TieOutcome`. What was
    not measured is NaN. `false_alarms` is the expected number of such agreements by chance.
    """

    first: int
    second: int
    uv_first: Float[np.ndarray, "n 2"]
    uv_second: Float[np.ndarray, "n 2"]
    sigma_first: Float[np.ndarray, "n 2"]
    sigma_second: Float[np.ndarray, "n 2"]
    score: Float[np.ndarray, " n"]
    outcome: Int8[np.ndarray, " n"]
    false_alarms: float

    @property
    def tied(self) -> Int[np.ndarray, " m"]:
        """Indices of the measured points."""
        return np.flatnonzero(self.outcome == TieOutcome.tied)


def match_pair(
    views: Views, first: int, second: int, uv: np.ndarray, planes: Planes, pictures: Pictures, how: Matching
) -> PairMatches:
    """Find points of one image in another.

    `uv` (n, 2) are pixels of the first image, `planes` the ground there. Both images are resampled to these planes, so
    that obliquity and scale have no influence, and matched by `jaxgeo.register.match_blocks`: normalised correlation
    within the ellipse of the navigation and height errors, then least squares. The columns of a patch lie along the
    epipolar direction, in which a height error shifts it. Shifts must fit one error of both poses within their
    covariance and that of the match (`PoseConsensus`): the epipolar condition with its covariance, and the prior along
    it. If the navigation is vague, coarser cells are matched first.
    """
    both = first, second
    result = nothing(both, uv)
    geometry = geometry_of(views, both, planes)
    covariance = views.covariance_of_pair(first, second)
    factor, shift = _first_factor(geometry, covariance, how), np.zeros((len(geometry.rows), 2))
    spread, is_first = _spread(geometry, covariance, how), True
    while len(geometry.rows) >= how.least:
        cell = geometry.cell * factor
        is_last = factor == 1 and bool(np.all(spread / cell <= SURE))
        done = _pass(views, both, pictures, geometry, shift, cell, spread / cell, covariance, how, is_last)
        if is_first:
            result = result._replace(false_alarms=done.alarms)
        tied = np.flatnonzero(done.outcome == TieOutcome.tied)
        if len(tied) < how.least or result.false_alarms > how.false_alarms:
            done.outcome[tied] = TieOutcome.off_epipolar
            result.outcome[geometry.rows] = done.outcome
            break
        result.outcome[geometry.rows] = done.outcome
        if is_last:
            return measured(views, result, geometry.of(tied), done.shift[tied], done.covariance[tied], done.score[tied])
        factor, is_first = max(factor // FINER, 1), False
        kept, shift, spread = _predicted(geometry, done, covariance, factor, how)
        geometry = geometry.of(kept)
    return result


class _Pass(NamedTuple):
    """Shifts (n, 2) in m on the planes, their covariance in m2, scores and outcomes of a pass; its false alarms, and
    the size of its cells in m."""

    shift: np.ndarray
    covariance: np.ndarray
    score: np.ndarray
    outcome: np.ndarray
    alarms: float
    cell: float


def _pass(
    views: Views,
    both: tuple[int, int],
    pictures: Pictures,
    geometry: Geometry,
    shift: np.ndarray,
    cell: float,
    spread: np.ndarray,
    cov_error: np.ndarray,
    how: Matching,
    is_last: bool,
) -> _Pass:
    """Match all points in cells of one size, starting at shifts in m. In the last pass, matches must lead back, and are
    refined by the cells that did not change."""
    width = [_width(one) for one in spread]
    is_oriented = how.measure == "orientation"
    aside = WIDTHS[0] + TAPS + 1 + (OF_GRADIENT if is_oriented else 0)
    shape = tuple(how.size + 2 * (one + aside) for one in width)
    origins = geometry.origin, geometry.origin + np.einsum("na,nax->nx", shift, geometry.axes)
    here, there = (
        patches_of(views, row, pictures, origin, geometry.axes, cell, (shape[0], shape[1]))
        for row, origin in zip(both, origins, strict=True)
    )
    if is_oriented:
        here, there = here.oriented(), there.oriented()
    inside = np.diag(((np.array(width) - 1.01) / REACH) ** 2)
    matches = _matched(here, there, np.broadcast_to(inside, (len(shift), 2, 2)), how)
    total = with_heights(matches, shift / cell, geometry.by_height / cell, how)
    chosen = PoseConsensus(tolerance=how.tolerance, pairs=400).choose(total, geometry.by_pose / cell, cov_error)
    found, cov = chosen.of(matches.shift), chosen.of(matches.covariance)
    score = chosen.of(np.where(matches.is_candidate, matches.score, np.nan))
    outcome = judged(matches, chosen, score, how)
    if is_last:
        tied = np.flatnonzero(outcome == TieOutcome.tied)
        outcome[tied[~_agree_back(here, there, found, tied, how)]] = TieOutcome.not_consistent
        tied = np.flatnonzero(outcome == TieOutcome.tied)
        found[tied], cov[tied], converged = sharpened(here, there, found, tied, how.size)
        outcome[tied[~converged]] = TieOutcome.not_consistent
    return _Pass(shift + found * cell, cov * cell**2, score, outcome, false_alarms(total, chosen), cell)


def _predicted(
    geometry: Geometry, done: _Pass, cov_error: np.ndarray, factor: int, how: Matching
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(indices of the points of the next pass, their predicted shifts in m, the standard deviation along rows and
    columns in m): matched points at their shifts; the others by the errors of the poses that these imply, if their
    search is short enough."""
    is_tied = done.outcome == TieOutcome.tied
    H, g = geometry.by_pose, geometry.by_height
    noise = (how.tolerance * geometry.cell) ** 2 * np.eye(2) + how.sigma_height**2 * g[:, :, None] * g[:, None, :]
    weight = np.linalg.inv(done.covariance[is_tied] + noise[is_tied])
    values, vectors = np.linalg.eigh(cov_error)
    G = H @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    weighed = np.einsum("nab,nbz->naz", weight, G[is_tied])
    posterior = np.linalg.inv(np.eye(G.shape[2]) + np.einsum("naz,nay->zy", G[is_tied], weighed))
    mean = posterior @ np.einsum("naz,na->z", weighed, done.shift[is_tied])
    squared = np.einsum("naz,zy,nay->na", G, posterior, G) + np.diagonal(noise, axis1=1, axis2=2)
    again = (AGAIN * done.cell) ** 2
    spread = np.sqrt(np.maximum(np.quantile(squared, 0.9, axis=0), again))
    if np.all(spread <= SURE * geometry.cell * factor):
        return np.arange(len(H)), np.where(is_tied[:, None], done.shift, G @ mean), spread
    return np.flatnonzero(is_tied), done.shift[is_tied], np.full(2, np.sqrt(again))


def _matched(here: Patches, there: Patches, covariance: np.ndarray, how: Matching) -> Matches:
    options = {"size": how.size, "peaks": 4, "least_score": 0.5 * how.threshold}
    return match_blocks(here.grey, here.known, there.grey, there.known, here.centres(), covariance, **options)


def _agree_back(here: Patches, there: Patches, found: np.ndarray, tied: np.ndarray, how: Matching) -> np.ndarray:
    """Flags of points among `tied` whose match leads back to where it came from."""
    if not len(tied):
        return np.zeros(0, bool)
    side, found = 2 * (how.size // 2 + WIDTHS[0] + TAPS + 1), found[tied]
    moved = np.rint(found)
    parts = there.of(tied).cut(moved, side), here.of(tied).cut(np.zeros_like(found), side)
    back = _matched(*parts, _near(len(found)), how)
    away = np.linalg.norm(np.asarray(back.shift)[:, 0] + (found - moved), axis=1)
    with np.errstate(invalid="ignore"):
        return away <= how.consistency


def _near(count: int) -> np.ndarray:
    """Covariances (n, 2, 2) in cells2 of a search in the smallest window."""
    return np.broadcast_to(np.eye(2) * ((WIDTHS[0] - 1.01) / REACH) ** 2, (count, 2, 2))


def with_heights(matches: Matches, before: np.ndarray, by_height: np.ndarray, how: Matching) -> Matches:
    """Candidates with shifts from the prediction by the navigation, and covariances that include height errors."""
    of_height = how.sigma_height**2 * by_height[:, :, None] * by_height[:, None, :]
    return Matches(
        matches.centre,
        np.asarray(matches.shift) + before[:, None, :],
        matches.score,
        np.asarray(matches.covariance) + of_height[:, None],
        matches.outcome,
        matches.searched,
    )


def judged(matches: Matches, chosen: Chosen, score: np.ndarray, how: Matching) -> np.ndarray:
    """Outcomes by threshold, uniqueness and agreement."""
    outcome = np.full(len(score), TieOutcome.tied, np.int8)
    scores = np.where(matches.is_candidate, matches.score, -np.inf)
    own = np.arange(scores.shape[1])[None, :] == np.asarray(chosen.peak)[:, None]
    rival = np.max(np.where(own, -np.inf, scores), axis=1, initial=-np.inf)
    with np.errstate(invalid="ignore"):
        outcome[rival > how.uniqueness * score] = TieOutcome.not_unique
        outcome[score < how.threshold] = TieOutcome.low_correlation
    outcome[~chosen.is_chosen] = TieOutcome.off_epipolar
    outcome[np.asarray(matches.outcome) != BlockOutcome.matched] = TieOutcome.not_found
    return outcome


def _spread(geometry: Geometry, covariance: np.ndarray, how: Matching) -> np.ndarray:
    """90 % quantile of the standard deviations of the shifts along rows and columns, m."""
    of_pose = np.einsum("nai,ij,naj->na", geometry.by_pose, covariance, geometry.by_pose)
    squared = of_pose + (how.sigma_height * geometry.by_height) ** 2 + (how.tolerance * geometry.cell) ** 2
    return np.sqrt(np.quantile(squared, 0.9, axis=0))


def _first_factor(geometry: Geometry, covariance: np.ndarray, how: Matching) -> int:
    """Factor of the cells of the first pass: the smallest power of two whose search area suffices."""
    if not len(geometry.rows):
        return 1
    spread, factor = float(np.max(_spread(geometry, covariance, how))) / geometry.cell, 1
    while REACH * spread / factor + 1.01 > WIDTHS[-1] and factor < COARSEST:
        factor *= 2
    return factor


def _width(spread: float) -> int:
    """Half width of a search area in cells."""
    return next((width for width in WIDTHS if REACH * spread + 1.01 <= width), WIDTHS[-1])


def measured(
    views: Views, result: PairMatches, geometry: Geometry, shift: np.ndarray, covariance: np.ndarray, score: np.ndarray
) -> PairMatches:
    """The result with the pixels of matched points, by their shifts (n, 2) in m on the planes, the covariances of these
    (n, 2, 2), and scores (n,)."""
    rows = geometry.rows
    there = geometry.origin + np.einsum("na,nax->nx", shift, geometry.axes)
    for row, origin, sigma in (
        (result.first, geometry.origin, result.sigma_first),
        (result.second, there, result.sigma_second),
    ):
        pose = views.centre[row], views.R_frame_from_camera[row]
        found = project_planes(views.camera_of(row), *pose, origin, geometry.axes, [1, 1])
        if row == result.second:
            result.uv_second[rows] = found.nodes[:, 1, 1]
        of_pixel = np.einsum("nia,nab,nib->ni", found.by_plane, 0.5 * covariance, found.by_plane)
        sigma[rows] = np.sqrt(of_pixel + INTERPOLATED**2)
    result.score[rows] = score
    lost = rows[~np.all(np.isfinite(result.uv_second[rows]), axis=1)]
    result.outcome[lost] = TieOutcome.not_visible
    return result


def nothing(both: tuple[int, int], uv: np.ndarray) -> PairMatches:
    """The result of a pair in which nothing is measured."""
    n, (first, second) = len(uv), both
    second_uv, sigma_first, sigma_second = (np.full((n, 2), np.nan) for _ in range(3))
    outcome = np.full(n, TieOutcome.not_visible, np.int8)
    uv = np.array(uv, np.float64)
    return PairMatches(first, second, uv, second_uv, sigma_first, sigma_second, np.full(n, np.nan), outcome, np.inf)
