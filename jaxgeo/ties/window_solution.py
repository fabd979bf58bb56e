"""Least squares of the last images of a sequence, with what earlier ones left as a prior."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxgeo._blas_threads import one_thread
from jaxgeo.ties.drift import transition
from jaxgeo.ties.map_control import Measured
from jaxgeo.ties.window import POSE, Frame, Quadratic, Window
from jaxgeo.ties.window_points import LEAST_SPREAD, Linear, Rows, linear, of_ties, placed

WIDTH = 3.0  # standard deviations: of the robust (Cauchy) loss
OUTLIER = 4.0  # standard deviations: larger residuals are left out
STEPS, HALVINGS, ROUNDS = 25, 6, 4
CLOSE_ENOUGH, ROUGHLY = 1e-8, 1e-3  # half the squared length of a step in standard deviations; of the robust solution
LEAST_VARIANCE = 1e-12  # m2 and rad2, against division by zero
MEDIAN = 1.177  # of the length of two normal numbers
LEAST_FIT = 0.4  # share of the measurements of an image: if fewer fit, what fits may do so by chance
SLIGHT = 1e-9  # sine of an angle: below it the angle is its sine


def of_others(window: Window, oldest: bool = False) -> tuple[np.ndarray, np.ndarray, float]:
    """(H, g, half the sum of squares) of the prior, the navigation, the processes and the map; of the oldest frame only
    with `oldest`, and all of the prior."""
    each, frames = window.of_frame, window.frames
    n, m = len(frames), len(window.constant)
    H, g, cost = np.zeros((window.size, window.size)), np.zeros(window.size), 0.0
    last = np.arange(n * each, n * each + m)

    def add(J: np.ndarray, r: np.ndarray, columns: np.ndarray) -> None:
        nonlocal cost
        H[np.ix_(columns, columns)] += J.T @ J
        g[columns] += J.T @ r
        cost += 0.5 * float(r @ r)

    for k, frame in enumerate(frames[:1] if oldest else frames):
        own = k * each + np.arange(each)
        J, r = _navigation_rows(frame, window.constant)
        add(J, r, np.r_[own, last])
        if frame.measured is not None:
            J, r = map_rows(frame, frame.measured, window)
            add(J, r, np.r_[own[:POSE], last])
        if k + 1 < n and each > POSE:
            factor, gained = transition(frame.drift.duration, frames[k + 1].time - frame.time)
            r = (frames[k + 1].fading - factor * frame.fading) / gained
            add(np.hstack([-np.diag(factor / gained), np.diag(1.0 / gained)]), r, np.r_[own[POSE:], own[POSE:] + each])
    x = change_from(window, window.prior)
    slope = window.prior.H @ x
    H += window.prior.H
    g += window.prior.g + slope
    return H, g, cost + float(0.5 * x @ slope + window.prior.g @ x)


def change_from(window: Window, prior: Quadratic) -> np.ndarray:
    """Change of the unknowns from where the prior was linearised."""
    parts = []
    for now, then in zip(window.frames, prior.frames, strict=True):
        turn = _vector(then.R_frame_from_camera.T @ now.R_frame_from_camera)
        parts += [now.centre - then.centre, turn, now.fading - then.fading]
    return np.concatenate([*parts, window.constant - prior.constant])


def _navigation_rows(frame: Frame, constant: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (6, 6 + q + m) of the weighted residuals of an image's navigation, and these."""
    drift = frame.drift
    turn = _vector(drift.R_frame_from_camera.T @ frame.R_frame_from_camera)
    by_constant = np.zeros((POSE, len(constant)))
    by_constant[:, : drift.by_constant.shape[1]] = drift.by_constant
    off = np.concatenate([frame.centre - drift.centre, turn])
    off = off - drift.by_fading @ frame.fading - by_constant @ constant
    by_pose = np.eye(POSE)
    by_pose[3:, 3:] = _by_own_turn(turn)
    W = frame.information
    return W @ np.hstack([by_pose, -drift.by_fading, -by_constant]), W @ off


def largest_correction(frame: Frame) -> float:
    """Largest correction of the navigation of an image, in standard deviations of that."""
    drift = frame.drift
    turn = _vector(drift.R_frame_from_camera.T @ frame.R_frame_from_camera)
    off = np.abs(np.concatenate([frame.centre - drift.centre, turn]))
    return float(np.max(off / np.sqrt(np.maximum(np.diagonal(drift.covariance), LEAST_VARIANCE))))


def map_rows(frame: Frame, measured: Measured, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (r, 6 + m) of the residuals of a map in an image, by its pose and the constant numbers, and these."""
    turn = _vector(measured.R_frame_from_camera.T @ frame.R_frame_from_camera)
    x = np.concatenate([frame.centre - measured.centre, turn])
    by_constant = np.zeros((len(measured.offset), len(window.constant)))
    for name, column in measured.by_common.items():
        by_constant[:, window.names.index(name)] = column
    by_pose = measured.by_pose.copy()
    by_pose[:, 3:] = measured.by_pose[:, 3:] @ _by_own_turn(turn)
    return np.hstack([by_pose, by_constant]), measured.offset + measured.by_pose @ x + by_constant @ window.constant


class Solved(NamedTuple):
    """A window at its least squares, the covariance of its unknowns, and whether the steps ended."""

    window: Window
    covariance: np.ndarray
    converged: bool


@one_thread()
def solved(window: Window) -> Solved:
    """Robust solution (Cauchy), then least squares without measurements off by more than `OUTLIER`.

    Images of whose measurements few fit take no part with any of them, the one with the smallest share first."""
    start, without = window, frozenset[int]()
    while True:
        rows = Rows.of(start, without=without)
        window, places, _ = _descended(start, rows, placed(start, rows), None)
        fits = _often(rows, _fitting(linear(window, rows, places).residual))
        worst = _unfit(rows, fits, len(window.frames))
        if worst is None:
            break
        without |= {worst}
    fits, converged = None, False
    for _ in range(ROUNDS):
        before, fits = fits, _often(rows, _fitting(linear(window, rows, places).residual))
        if before is not None and np.array_equal(before, fits):
            break
        window, places, converged = _descended(window, rows, places, fits)
    assert fits is not None
    keys = rows.keys(window)
    window = replace(
        window,
        points=dict(zip(rows.names, places, strict=True)),
        fits=frozenset(key for key, fit in zip(keys, fits.tolist(), strict=True) if fit),
    )
    return Solved(window, covariance_of(window), converged)


def _unfit(rows: Rows, fits: np.ndarray, frames: int) -> int | None:
    """The frame with the smallest share of measurements that fit, if it is below `LEAST_FIT`."""
    offered = np.bincount(rows.frame, minlength=frames)
    share = np.bincount(rows.frame, weights=fits, minlength=frames) / np.maximum(offered, 1)
    share[offered == 0] = 1.0
    worst = int(np.argmin(share))
    return worst if share[worst] < LEAST_FIT else None


def covariance_of(window: Window) -> np.ndarray:
    """Covariance of the unknowns but the points, at the current values and with the measurements in use."""
    H, _, _ = of_others(window)
    rows, at, weight = _in_use(window, None)
    return inverse(H + of_ties(window, rows, at, weight).H)


def _in_use(window: Window, names: set[str] | None) -> tuple[Rows, Linear, np.ndarray]:
    rows = Rows.of(window, set(window.points) if names is None else names & set(window.points))
    places = np.array([window.points[name] for name in rows.names]).reshape(-1, 3)
    at = linear(window, rows, places)
    weight = np.array([key in window.fits for key in rows.keys(window)], float)
    return rows, at._replace(residual=np.where(weight[:, None] > 0.0, at.residual, 0.0)), weight


def _fitting(residual: np.ndarray) -> np.ndarray:
    return (
        np.nan_to_num(np.max(np.abs(residual), axis=1), nan=np.inf) <= OUTLIER if len(residual) else np.zeros(0, bool)
    )


def _often(rows: Rows, fits: np.ndarray) -> np.ndarray:
    """Without the measurements of points that have a single one left."""
    return fits & (np.bincount(rows.point, weights=fits, minlength=len(rows.names)) >= 2)[rows.point]


def _descended(
    window: Window, rows: Rows, places: np.ndarray, fits: np.ndarray | None
) -> tuple[Window, np.ndarray, bool]:
    """(window, places, whether the steps ended) by Gauss-Newton steps, halved where they do not decrease the cost.

    With `fits` least squares of those measurements. Without, the loss is robust, at first as wide as the residuals: it
    then narrows with them."""
    last, enough = np.zeros(len(rows)), ROUGHLY if fits is None else CLOSE_ENOUGH
    for _ in range(STEPS):
        at = linear(window, rows, places)
        weight, width = _weights(rows, at.residual, fits, len(window.frames))
        at = at._replace(residual=np.where(weight[:, None] > 0.0, at.residual, 0.0))
        ties = of_ties(window, rows, at, weight)
        H, g, cost = of_others(window)
        H, g = H + ties.H, g + ties.g
        before = cost + _loss(at.residual, weight, width, fits)
        step = -_solve(H, g)
        gain = 0.5 * float(step @ H @ step)
        settled, last = bool(np.all(np.abs(width - last) <= 0.02 * width)), width
        if gain <= enough and settled:
            moved, to = window.moved(step), places + ties.steps_of_points(step, window.of_frame)
            return moved, to, True
        share = 1.0
        for _ in range(HALVINGS):
            trial, to = window.moved(share * step), places + share * ties.steps_of_points(step, window.of_frame)
            after = of_others(trial)[2] + _loss(linear(trial, rows, to).residual, weight, width, fits)
            if after <= before * (1.0 + 1e-9) + 1e-9:
                break
            share *= 0.5
        window, places = trial, to
    return window, places, False


def _weights(rows: Rows, residual: np.ndarray, fits: np.ndarray | None, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """(weights (n,), widths (n,) of the loss): of a frame's measurements by their own median, at least `WIDTH`."""
    if fits is not None:
        return fits.astype(float) * np.all(np.isfinite(residual), axis=1), np.zeros(len(rows))
    length = np.sqrt(np.sum(residual**2, axis=1))
    width = np.full(frames, WIDTH)
    for k in np.unique(rows.frame):
        own = length[(rows.frame == k) & np.isfinite(length)]
        width[k] = max(WIDTH, WIDTH * float(np.median(own)) / MEDIAN) if len(own) else WIDTH
    width = width[rows.frame]
    return np.nan_to_num(1.0 / (1.0 + (length / width) ** 2), nan=0.0), width


def _loss(residual: np.ndarray, weight: np.ndarray, width: np.ndarray, fits: np.ndarray | None) -> float:
    """Half the sum of the loss; of measurements behind a camera infinite if they are in use."""
    squared = np.where(weight > 0.0, np.sum(residual**2, axis=1), 0.0)
    if fits is not None:
        return 0.5 * float(np.nan_to_num(np.sum(squared), nan=np.inf))
    width = np.where(width > 0.0, width, 1.0)
    return 0.5 * float(np.nan_to_num(np.sum(width**2 * np.log1p(squared / width**2)), nan=np.inf))


def without_oldest(window: Window) -> Window:
    """The window without its oldest frame, with what it says about the others in the prior.

    Points that it measures are eliminated with all their measurements."""
    each, oldest = window.of_frame, window.frames[0]
    names = {name for name in oldest.seen if name in window.points}
    H, g, _ = of_others(window, oldest=True)
    rows, at, weight = _in_use(window, names)
    ties = of_ties(window, rows, at, weight)
    H, g = H + ties.H, g + ties.g
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(H), LEAST_SPREAD))
    scaled = H * scale[:, None] * scale[None, :]
    lower = np.linalg.cholesky(scaled[:each, :each])
    half = np.linalg.solve(lower, scaled[:each, each:])
    own = np.linalg.solve(lower, (scale * g)[:each])
    left = (scaled[each:, each:] - half.T @ half) / scale[each:, None] / scale[None, each:]
    gradient = g[each:] - (half.T @ own) / scale[each:]
    frames = tuple(
        replace(one, seen={name: seen for name, seen in one.seen.items() if name not in names})
        for one in window.frames[1:]
    )
    prior = Quadratic(0.5 * (left + left.T), gradient, frames, window.constant)
    points = {name: place for name, place in window.points.items() if name not in names}
    return replace(window, frames=frames, prior=prior, points=points)


def _solve(H: np.ndarray, g: np.ndarray) -> np.ndarray:
    scale = 1.0 / np.sqrt(np.diagonal(H))
    return scale * np.linalg.solve(H * scale[:, None] * scale[None, :], scale * g)


def inverse(H: np.ndarray) -> np.ndarray:
    """Inverse of a positive definite matrix, scaled to a unit diagonal."""
    scale = 1.0 / np.sqrt(np.diagonal(H))
    lower = np.linalg.cholesky(H * scale[:, None] * scale[None, :])
    half = np.linalg.solve(lower, np.diag(scale))
    return half.T @ half


def _vector(R: np.ndarray) -> np.ndarray:
    """Rotation vector of a rotation, by less than half a turn."""
    twice = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine, cosine = 0.5 * float(np.sqrt(twice @ twice)), 0.5 * (float(np.trace(R)) - 1.0)
    return 0.5 * twice * (np.arctan2(sine, cosine) / sine if sine > SLIGHT else 1.0)


def _by_own_turn(vector: np.ndarray) -> np.ndarray:
    """Derivative of the rotation vector of R(vector) R(step) by the step: the inverse right Jacobian of SO(3)."""
    angle = float(np.linalg.norm(vector))
    skew = np.cross(np.eye(3), vector)  # (e_i x v) . w = e_i . (v x w)
    if angle < 1e-4:
        return np.eye(3) + 0.5 * skew + skew @ skew / 12.0
    half = 0.5 * angle
    return np.eye(3) + 0.5 * skew + (1.0 - half / np.tan(half)) / angle**2 * skew @ skew
