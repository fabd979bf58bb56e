"""Tie points between two images by keypoints: predicted by navigation and terrain, found by descriptors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxgeo.register import BlockOutcome, Matches, PoseConsensus, false_alarms
from jaxgeo.ties.features import SAME, ImageKeypoints, Keypoints
from jaxgeo.ties.ground import Planes
from jaxgeo.ties.matching import REACH, Matching, PairMatches, TieOutcome, judged, measured, nothing, with_heights
from jaxgeo.ties.pair_geometry import Geometry, geometry_of
from jaxgeo.ties.views import Views, project_planes

PEAKS = 4  # candidates of a point, at most
APART = 3.0  # cells: candidates of a point that lie nearer are of one place
STEPS = 5  # of Newton's method, from a pixel to its place on a plane
CLOSE = 1e-3  # px: by how far the last but one step may miss the pixel
REDUNDANT = 3.0  # measurements across the epipolar lines, at least, beyond those that the poses take up
OUTLYING = 4.0  # standard deviations of a residual, beyond which a match is wrong
ROUNDS = 10


class _Seen(NamedTuple):
    """Both images as the points of a pair see them: predicted pixels (n, 2) in each, inverse derivatives (n, 2, 2) of
    the pixels by the plane, in m per px."""

    uv: tuple[np.ndarray, np.ndarray]
    per_pixel: tuple[np.ndarray, np.ndarray]


def match_keypoints(
    views: Views, first: int, second: int, uv: np.ndarray, planes: Planes, keypoints: ImageKeypoints, how: Matching
) -> PairMatches:
    """Find keypoints of one image among those of another.

    `uv` (n, 2) are pixels of keypoints of the first image, `planes` the ground there. Of each, the keypoints of the
    second image within the ellipse of the navigation and height errors are compared by the correlation of the
    descriptors, which takes the place of that of areas in `match_pair`: thresholds, uniqueness, the agreement with one
    error of both poses and the number of false alarms are the same. Compared back, a match must lead to its own
    keypoint.

    The standard deviation of a match is that of the residuals of all matches of the pair across the epipolar lines,
    where no height error moves them, less the degrees of freedom of the poses; it is taken to be the same along the
    lines and for all matches, and includes what else the poses do not explain, such as errors of the lens. Pairs with
    fewer than three residuals more than the poses take up have none, and are not tied; matches beyond four of these
    standard deviations are left out.
    """
    result = nothing((first, second), uv)
    geometry = geometry_of(views, (first, second), planes)
    if len(geometry.rows) < how.least:
        return result
    covariance = views.covariance_of_pair(first, second)
    seen = _seen(views, (first, second), geometry)
    points, others = keypoints.of(first), keypoints.of(second)
    spread = _spreads(geometry, covariance, how)
    found = _candidates(points, others, uv[geometry.rows], seen, spread, geometry.cell, how)
    matches = _matches(views, second, others, geometry, seen, found, spread)
    unmoved = np.zeros((len(geometry.rows), 2))
    total = with_heights(matches, unmoved, geometry.by_height / geometry.cell, how)
    consensus = PoseConsensus(tolerance=how.tolerance, pairs=400)
    chosen = consensus.choose(total, geometry.by_pose / geometry.cell, covariance)
    score = chosen.of(np.where(matches.is_candidate, matches.score, np.nan))
    outcome = judged(matches, chosen, score, how)
    shift = chosen.of(matches.shift) * geometry.cell
    taken = np.where(chosen.is_chosen, found.number[np.arange(len(outcome)), np.maximum(chosen.peak, 0)], -1)
    tied = np.flatnonzero(outcome == TieOutcome.tied)
    back = _lead_back(points, others, uv[geometry.rows], taken, tied, seen, geometry.cell, spread)
    outcome[tied[~back]] = TieOutcome.not_consistent
    alarms = false_alarms(total, chosen)
    result = result._replace(false_alarms=alarms)
    tied = np.flatnonzero(outcome == TieOutcome.tied)
    sigma, inlying = _sigma(geometry, shift, tied, covariance, how)
    outcome[tied[~inlying]] = TieOutcome.off_epipolar
    tied = tied[inlying]
    if len(tied) < how.least or alarms > how.false_alarms or not np.isfinite(sigma):
        outcome[tied] = TieOutcome.off_epipolar
        result.outcome[geometry.rows] = outcome
        return result
    result.outcome[geometry.rows] = outcome
    of_matches = np.tile(sigma**2 * np.eye(2), (len(tied), 1, 1))
    result = measured(views, result, geometry.of(tied), shift[tied], of_matches, score[tied])
    rows = geometry.rows[tied]
    is_kept = result.outcome[rows] == TieOutcome.tied
    result.uv_second[rows[is_kept]] = others.uv[taken[tied]][is_kept]
    return result


class _Found(NamedTuple):
    """Candidates of n points: `number` (n, peaks) of the keypoint, -1 for none, `score` (n, peaks), NaN for none."""

    number: np.ndarray
    score: np.ndarray


def _seen(views: Views, both: tuple[int, int], geometry: Geometry) -> _Seen:
    uv, per_pixel = [], []
    for row in both:
        pose = views.centre[row], views.R_frame_from_camera[row]
        found = project_planes(views.camera_of(row), *pose, geometry.origin, geometry.axes, [1, 1])
        uv.append(found.nodes[:, 1, 1])
        per_pixel.append(np.linalg.inv(found.by_plane))
    return _Seen((uv[0], uv[1]), (per_pixel[0], per_pixel[1]))


def _spreads(geometry: Geometry, covariance: np.ndarray, how: Matching) -> np.ndarray:
    """Covariances (n, 2, 2) in m2 of the shifts by the errors of poses and heights, and what these do not explain."""
    of_pose = np.einsum("nai,ij,nbj->nab", geometry.by_pose, covariance, geometry.by_pose)
    of_height = how.sigma_height**2 * geometry.by_height[:, :, None] * geometry.by_height[:, None, :]
    return of_pose + of_height + (how.tolerance * geometry.cell) ** 2 * np.eye(2)


def _candidates(
    points: Keypoints, others: Keypoints, uv: np.ndarray, seen: _Seen, spread: np.ndarray, cell: float, how: Matching
) -> _Found:
    """The best keypoints of the second image within the search area of each point, `APART` from each other."""
    n = len(uv)
    found = _Found(np.full((n, PEAKS), -1), np.full((n, PEAKS), np.nan))
    if not len(others.uv) or not len(points.uv):
        return found
    weight = np.linalg.inv(spread)
    for k in range(n):
        own = np.flatnonzero(np.all(np.abs(points.uv - uv[k]) <= SAME, axis=1))
        away = (others.uv - seen.uv[1][k]) @ seen.per_pixel[1][k].T
        near = np.flatnonzero(np.einsum("ma,ab,mb->m", away, weight[k], away) <= REACH**2)
        if not len(own) or not len(near):
            continue
        scores = np.max(others.descriptors[near] @ points.descriptors[own].T, axis=1)
        for peak in range(PEAKS):
            best = int(np.argmax(scores))
            if not scores[best] >= 0.5 * how.threshold:
                break
            found.number[k, peak], found.score[k, peak] = near[best], scores[best]
            scores = np.where(_apart(away[near], away[near[best]], cell), scores, -np.inf)
    return found


def _apart(places: np.ndarray, place: np.ndarray, cell: float) -> np.ndarray:
    return np.sum((places - place) ** 2, axis=1) > (APART * cell) ** 2


def _matches(
    views: Views, second: int, others: Keypoints, geometry: Geometry, seen: _Seen, found: _Found, spread: np.ndarray
) -> Matches:
    """Candidates as shifts in cells on the planes; what their positions are worth is not known yet, nor added."""
    k, peak = np.nonzero(found.number >= 0)
    target = others.uv[found.number[k, peak]]
    start = np.einsum("nab,nb->na", seen.per_pixel[1][k], target - seen.uv[1][k])
    shifts = np.full((*found.number.shape, 2), np.nan)
    shifts[k, peak] = _on_planes(views, second, geometry.of(k), target, start) / geometry.cell
    scores = np.where(np.isfinite(shifts[..., 0]), found.score, np.nan)
    covariance = np.where(np.isfinite(scores)[..., None, None], np.zeros((2, 2)), np.nan)
    area = np.pi * REACH**2 * np.sqrt(np.linalg.det(spread)) / geometry.cell**2
    has_any = np.isfinite(scores).any(axis=1)
    outcome = np.where(has_any, BlockOutcome.matched, BlockOutcome.no_peak).astype(np.int8)
    return Matches(np.zeros((len(scores), 2)), shifts, scores, covariance, outcome, np.ceil(area).astype(int))


def _on_planes(views: Views, row: int, geometry: Geometry, uv: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Shifts (n, 2) in m on the planes to what an image shows at pixels (n, 2); NaN where the line of sight passes the
    plane, or the start is too far off."""
    shift, off = start, np.full(uv.shape, np.inf)
    pose = views.centre[row], views.R_frame_from_camera[row]
    for _ in range(STEPS if len(uv) else 0):
        there = geometry.origin + np.einsum("na,nax->nx", shift, geometry.axes)
        at = project_planes(views.camera_of(row), *pose, there, geometry.axes, [1, 1])
        off = uv - at.nodes[:, 1, 1]
        sound = np.all(np.isfinite(off), axis=1) & np.all(np.isfinite(at.by_plane), axis=(1, 2))
        sound &= np.abs(np.linalg.det(np.where(sound[:, None, None], at.by_plane, 0.0))) > 0.0
        step = np.linalg.solve(np.where(sound[:, None, None], at.by_plane, np.eye(2)), off[:, :, None])[:, :, 0]
        shift = np.where(sound[:, None], shift + step, np.nan)
    near = np.max(np.abs(np.nan_to_num(off, nan=np.inf)), axis=1, initial=0.0) <= CLOSE  # before the last step
    return np.where(near[:, None], shift, np.nan)


def _lead_back(
    points: Keypoints,
    others: Keypoints,
    uv: np.ndarray,
    taken: np.ndarray,
    tied: np.ndarray,
    seen: _Seen,
    cell: float,
    spread: np.ndarray,
) -> np.ndarray:
    """Flags of points among `tied` for whose match no other keypoint of the first image is the best one."""
    leads = np.zeros(len(tied), bool)
    weight = np.linalg.inv(spread)
    for number, k in enumerate(tied):
        away = (points.uv - uv[k]) @ seen.per_pixel[0][k].T
        near = np.flatnonzero(np.einsum("ma,ab,mb->m", away, weight[k], away) <= REACH**2)
        best = near[np.argmax(points.descriptors[near] @ others.descriptors[taken[k]])]
        leads[number] = not _apart(away[best][None], np.zeros(2), cell)[0]
    return leads


def _sigma(
    geometry: Geometry, shift: np.ndarray, tied: np.ndarray, covariance: np.ndarray, how: Matching
) -> tuple[float, np.ndarray]:
    """(standard deviation in m of the shifts (n, 2) of some points, NaN if too few are redundant; flags of those whose
    residuals it explains).

    The variance component of the matches, by their residuals across the epipolar lines and the redundancy of these
    (Foerstner 1979), iterated with the poses' errors that it weighs.
    """
    inlying = np.ones(len(tied), bool)
    values, vectors = np.linalg.eigh(covariance)
    G = geometry.by_pose[tied] @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    g, s = geometry.by_height[tied], shift[tied]
    sigma = how.tolerance * geometry.cell
    for _ in range(ROUNDS):
        if np.count_nonzero(inlying) < how.least:
            return np.nan, inlying
        noise = sigma**2 * np.eye(2) + how.sigma_height**2 * g[:, :, None] * g[:, None, :]
        weight = np.linalg.inv(noise) * inlying[:, None, None]
        weighed = np.einsum("nab,nbz->naz", weight, G)
        posterior = np.linalg.inv(np.eye(G.shape[2]) + np.einsum("naz,nay->zy", G, weighed))
        mean = posterior @ np.einsum("naz,na->z", weighed, s)
        residual = s[:, 0] - G[:, 0] @ mean
        taken_up = np.sum(np.einsum("nz,zy,ny->n", G[:, 0], posterior, G[:, 0])[inlying]) / sigma**2
        redundancy = np.count_nonzero(inlying) - taken_up
        if redundancy < REDUNDANT:
            return np.nan, inlying
        new = float(np.sqrt(np.sum(residual[inlying] ** 2) / redundancy))
        rest = np.abs(residual) <= OUTLYING * new
        if abs(new / sigma - 1.0) < 1e-3 and np.array_equal(rest & inlying, inlying):
            return new, inlying
        sigma, inlying = max(new, 1e-6 * geometry.cell), inlying & rest
    return sigma, inlying
