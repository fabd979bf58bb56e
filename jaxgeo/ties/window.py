"""Least squares of the last images of a sequence, with what earlier ones left as a prior."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._blas_threads import one_thread
from jaxgeo._compile import quick_filter_jit
from jaxgeo.adjust.collinearity import pixel_of
from jaxgeo.sensor import FrameCamera
from jaxgeo.ties.drift import Drifting, transition
from jaxgeo.ties.map_control import Measured

CHUNK = 1024  # measurements per call: one size, so that other counts need no compilation
WIDTH = 3.0  # standard deviations: of the robust (Cauchy) loss
OUTLIER = 4.0  # standard deviations: larger residuals are left out
STEPS, HALVINGS, ROUNDS = 25, 6, 4
CLOSE_ENOUGH, ROUGHLY = 1e-8, 1e-3  # half the squared length of a step in standard deviations; of the robust solution
PARALLEL = 1e-6  # least over largest sensitivity of a point: less, and its rays are parallel
LEAST_SPREAD, LEAST_VARIANCE = 1e-300, 1e-12  # against division by zero; m2 and rad2
MEDIAN = 1.177  # of the length of two normal numbers
LEAST_FIT = 0.4  # share of the measurements of an image: if fewer fit, what fits may do so by chance
SLIGHT = 1e-9  # sine of an angle: below it the angle is its sine
POSE = 6


@dataclass
class Frame:
    """An image in the window: its navigation, its camera, measurements by point name (pixel, standard deviations), the
    measurements of a map, and the current orientation and fading errors."""

    name: str
    time: float
    camera: FrameCamera
    drift: Drifting
    information: np.ndarray
    seen: dict[str, tuple[np.ndarray, np.ndarray]]
    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    fading: np.ndarray
    measured: Measured | None = None

    def moved(self, step: np.ndarray) -> Frame:
        """The frame after a step (6 + q,) of orientation and fading errors."""
        turn = _rotation(step[3:POSE])
        return replace(
            self,
            centre=self.centre + step[:3],
            R_frame_from_camera=self.R_frame_from_camera @ turn,
            fading=self.fading + step[POSE:],
        )


class Quadratic(NamedTuple):
    """What images that left the window say about the rest: 1/2 x' H x + g' x of the change x of the frames' unknowns
    and of the constant numbers from the values at which it was linearised."""

    H: np.ndarray
    g: np.ndarray
    frames: tuple[Frame, ...]
    constant: np.ndarray


@dataclass(frozen=True)
class Window:
    """Frames, oldest first, the constant numbers by name, and the prior.

    Unknowns are, frame by frame, the orientation (6) and the fading errors (q), then the constant numbers (m).
    `points` are current places of tie points by name; `excess` px are added to the standard deviations of image points.
    """

    frames: tuple[Frame, ...]
    names: tuple[str, ...]
    constant: np.ndarray
    prior: Quadratic
    excess: float
    points: dict[str, np.ndarray] = field(default_factory=dict)
    fits: frozenset[tuple[str, str]] = frozenset()
    """(image, point) of the measurements in use."""

    @property
    def of_frame(self) -> int:
        """Unknowns of a frame."""
        return POSE + (len(self.frames[0].fading) if self.frames else 0)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.frames) * self.of_frame + len(self.constant)

    def moved(self, step: np.ndarray) -> Window:
        """The window after a step of all unknowns but the points."""
        each = self.of_frame
        frames = tuple(one.moved(step[k * each : (k + 1) * each]) for k, one in enumerate(self.frames))
        return replace(self, frames=frames, constant=self.constant + step[len(self.frames) * each :])


def empty(excess: float) -> Window:
    """A window without frames."""
    none = np.zeros(0)
    return Window((), (), none, Quadratic(np.zeros((0, 0)), none, (), none), excess)


def with_names(window: Window, names: tuple[str, ...]) -> Window:
    """The window with further constant numbers, of standard normal priors."""
    new = tuple(name for name in names if name not in window.names)
    if not new:
        return window
    prior, more = window.prior, len(new)
    H = np.pad(prior.H, (0, more))
    H[-more:, -more:] = np.eye(more)
    constant = np.concatenate([window.constant, np.zeros(more)])
    # # Priors of the new numbers have their minimum at zero, where all are linearised.
    prior = Quadratic(H, np.pad(prior.g, (0, more)), prior.frames, np.concatenate([prior.constant, np.zeros(more)]))
    return replace(window, names=(*window.names, *new), constant=constant, prior=prior)


def with_frame(window: Window, frame: Frame) -> Window:
    """The window with one more frame at its end, unconnected with the others."""
    prior, last = window.prior, len(window.frames) * window.of_frame
    added = POSE + len(frame.fading)
    place = np.r_[:last, last + added : last + added + len(window.constant)]
    H, g = np.zeros((len(prior.g) + added,) * 2), np.zeros(len(prior.g) + added)
    H[np.ix_(place, place)], g[place] = prior.H, prior.g
    if not window.frames:  # the processes start from their stationary distribution
        fading = np.arange(POSE, added)
        H[fading, fading] = 1.0
    prior = Quadratic(H, g, (*prior.frames, frame), prior.constant)
    return replace(window, frames=(*window.frames, frame), prior=prior)


@dataclass(frozen=True)
class Rows:
    """Measurements of points in at least two frames: point and frame of each, pixel and standard deviation."""

    point: np.ndarray
    frame: np.ndarray
    uv: np.ndarray
    sigma: np.ndarray
    names: tuple[str, ...]

    @classmethod
    def of(cls, window: Window, names: set[str] | None = None, without: frozenset[int] = frozenset()) -> Rows:
        """Those of a window, or of some points, without some frames; in the order of points."""
        found: dict[str, list[int]] = {}
        for k, frame in enumerate(window.frames):
            for name in frame.seen if k not in without else ():
                if names is None or name in names:
                    found.setdefault(name, []).append(k)
        kept = {name: frames for name, frames in found.items() if len(frames) > 1}
        point = np.array([i for i, frames in enumerate(kept.values()) for _ in frames], int)
        frame = np.array([k for frames in kept.values() for k in frames], int)
        seen = [window.frames[k].seen[name] for name, frames in kept.items() for k in frames]
        uv = np.array([one for one, _ in seen]).reshape(-1, 2)
        sigma = np.hypot(np.array([one for _, one in seen]).reshape(-1, 2), window.excess)
        return cls(point, frame, uv, sigma, tuple(kept))

    def __len__(self) -> int:
        return len(self.point)

    def keys(self, window: Window) -> list[tuple[str, str]]:
        """(image, point) of each row."""
        names = [frame.name for frame in window.frames]
        return [(names[k], self.names[i]) for k, i in zip(self.frame.tolist(), self.point.tolist(), strict=True)]


class Linear(NamedTuple):
    """Weighted residuals (n, 2) of measurements, and derivatives by the pose (n, 2, 6) and by the point (n, 2, 3)."""

    residual: np.ndarray
    by_pose: np.ndarray
    by_point: np.ndarray


def linear(window: Window, rows: Rows, places: np.ndarray) -> Linear:
    """Measurements at current orientations and places (points, 3); points behind a camera have no residual (NaN)."""
    centre = np.stack([one.centre for one in window.frames])[rows.frame]
    R = np.stack([one.R_frame_from_camera for one in window.frames])[rows.frame]
    there = np.einsum("nji,nj->ni", R, places[rows.point] - centre)
    ahead = there[:, 2] > 0.0
    uv, by_there = _pixels_of(window, rows, np.where(ahead[:, None], there, [0.0, 0.0, 1.0]))
    residual = np.where(ahead[:, None], (uv - rows.uv) / rows.sigma, np.nan)
    by_there = by_there / rows.sigma[:, :, None]
    by_point = np.einsum("nij,nkj->nik", by_there, R)
    # # A small rotation of the camera turns the point the other way: d there = -turn x there = there x turn.
    return Linear(residual, np.concatenate([-by_point, by_there @ _crosses(there)], axis=2), by_point)


def _crosses(v: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) of the cross products v x ."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _pixels_of(window: Window, rows: Rows, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(pixels (n, 2), their derivatives (n, 2, 3)) of points in the frames of the cameras."""
    uv, by = np.zeros((len(there), 2)), np.zeros((len(there), 2, 3))
    cameras: dict[int, FrameCamera] = {id(one.camera): one.camera for one in window.frames}
    number = np.array([id(one.camera) for one in window.frames])[rows.frame]
    for key, camera in cameras.items():
        own = np.flatnonzero(number == key)
        for part in np.split(own, range(CHUNK, len(own), CHUNK)) if len(own) else ():
            padded = jnp.asarray(np.resize(there[part], (CHUNK, 3)))
            found = [np.asarray(x)[: len(part)] for x in _pixels(camera, padded)]
            uv[part], by[part] = found
    return uv, by


@quick_filter_jit
def _pixels(camera: FrameCamera, there: Float[Array, "n 3"]) -> tuple[Float[Array, "n 2"], Float[Array, "n 2 3"]]:
    one = lambda p: (pixel_of(camera, p), jax.jacfwd(lambda x: pixel_of(camera, x))(p))  # noqa: E731
    return jax.vmap(one)(there)


def placed(window: Window, rows: Rows) -> np.ndarray:
    """Places (points, 3) where the rays of the measurements come closest, by current orientations."""
    centre = np.stack([one.centre for one in window.frames])[rows.frame]
    R = np.stack([one.R_frame_from_camera for one in window.frames])[rows.frame]
    rays = np.einsum("nij,nj->ni", R, _directions(window, rows))
    known = np.all(np.isfinite(rays), axis=1)[:, None, None]
    across = np.where(known, np.eye(3)[None] - rays[:, :, None] * rays[:, None, :], 0.0)
    count = len(rows.names)
    normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(normal, rows.point, across)
    np.add.at(right, rows.point, np.einsum("nij,nj->ni", across, centre))
    slight = np.maximum(1e-12 * np.trace(normal, axis1=1, axis2=2), LEAST_SPREAD)[:, None, None] * np.eye(3)[None]
    return np.linalg.solve(normal + slight, right[:, :, None])[:, :, 0]


def _directions(window: Window, rows: Rows) -> np.ndarray:
    """Unit directions (n, 3) of the measured pixels in the frames of the cameras."""
    found = np.zeros((len(rows), 3))
    for k, frame in enumerate(window.frames):
        own = np.flatnonzero(rows.frame == k)
        for part in np.split(own, range(CHUNK, len(own), CHUNK)) if len(own) else ():
            padded = jnp.asarray(np.resize(rows.uv[part], (CHUNK, 2)))
            found[part] = np.asarray(_rays(frame.camera, padded))[: len(part)]
    return found


@quick_filter_jit
def _rays(camera: FrameCamera, uv: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    rays = jax.vmap(lambda one: camera.ray(one)[0])(uv)
    return rays / jnp.sqrt(jnp.sum(rays**2, axis=1, keepdims=True))


class Normal(NamedTuple):
    """Normal equations H x = -g of all unknowns but the points, which are eliminated; half the sum of squares; and what
    gives the points' steps: `by_frame` (points, 3, frames, 6), `own` (points, 3), `root` (points, 3, 3)."""

    H: np.ndarray
    g: np.ndarray
    cost: float
    by_frame: np.ndarray
    own: np.ndarray
    root: np.ndarray

    def steps_of_points(self, step: np.ndarray, each: int) -> np.ndarray:
        """Steps (points, 3) of the points for a step of the other unknowns."""
        frames = self.by_frame.shape[2]
        poses = step[: frames * each].reshape(frames, each)[:, :POSE]
        return -np.linalg.solve(self.root, (self.own + np.einsum("pikc,kc->pi", self.by_frame, poses))[:, :, None])[
            :, :, 0
        ]


def of_ties(window: Window, rows: Rows, at: Linear, weight: np.ndarray) -> Normal:
    """Normal equations of the measurements, each weighted by `weight` (n,), with the points eliminated by orthogonal
    projection. Points whose rays are parallel take no part."""
    frames, each, points = len(window.frames), window.of_frame, len(rows.names)
    H, g = np.zeros((window.size, window.size)), np.zeros(window.size)
    if not len(rows):
        none = np.zeros((0, 3, frames, POSE))
        return Normal(H, g, 0.0, none, np.zeros((0, 3)), np.zeros((0, 3, 3)))
    root = np.sqrt(weight)[:, None]
    residual, by_pose = at.residual * root, at.by_pose * root[:, :, None]
    by_point = at.by_point * root[:, :, None]
    stacked = np.zeros((points, 2 * frames, 3))  # a point is measured at most once in a frame
    for axis in range(2):
        stacked[rows.point, 2 * rows.frame + axis] = by_point[:, axis]
    Q, T = np.linalg.qr(stacked)
    sound = _has_place(T)
    Q = Q * sound[:, None, None]
    used = sound[rows.point]
    residual, by_pose = residual * used[:, None], by_pose * used[:, None, None]
    of_rows = np.stack([Q[rows.point, 2 * rows.frame + axis] for axis in range(2)], axis=1)  # (n, 2, 3)
    by_frame = np.zeros((points, 3, frames, POSE))
    by_frame[rows.point, :, rows.frame] = np.einsum("nai,nac->nic", of_rows, by_pose)
    own = np.zeros((points, 3))
    np.add.at(own, rows.point, np.einsum("nai,na->ni", of_rows, residual))
    flat = by_frame.reshape(points * 3, frames * POSE)
    of_poses = -(flat.T @ flat).reshape(frames, POSE, frames, POSE)
    gradient = -(flat.T @ own.reshape(-1)).reshape(frames, POSE)
    squares = np.zeros((frames, POSE, POSE))
    np.add.at(squares, rows.frame, np.einsum("nai,naj->nij", by_pose, by_pose))
    np.add.at(gradient, rows.frame, np.einsum("nai,na->ni", by_pose, residual))
    of_poses[np.arange(frames), :, np.arange(frames)] += squares
    columns = (each * np.arange(frames)[:, None] + np.arange(POSE)[None]).ravel()
    H[np.ix_(columns, columns)] = of_poses.reshape(len(columns), -1)
    g[columns] = gradient.ravel()
    T = np.where(sound[:, None, None], T, np.eye(3)[None])
    return Normal(H, g, 0.5 * float(np.sum(residual**2) - np.sum(own**2)), by_frame, own, T)


def _has_place(triangle: np.ndarray) -> np.ndarray:
    """Flags of points whose rays are not parallel, from the triangular factors (points, 3, 3) of their derivatives."""
    sizes = np.linalg.svd(triangle, compute_uv=False)
    return sizes[:, 2] > PARALLEL * np.maximum(sizes[:, 0], LEAST_SPREAD)


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


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation of a rotation vector."""
    from scipy.spatial.transform import Rotation  # submodules load lazily

    return Rotation.from_rotvec(vector).as_matrix()


def _by_own_turn(vector: np.ndarray) -> np.ndarray:
    """Derivative of the rotation vector of R(vector) R(step) by the step: the inverse right Jacobian of SO(3)."""
    angle = float(np.linalg.norm(vector))
    skew = np.cross(np.eye(3), vector)  # (e_i x v) . w = e_i . (v x w)
    if angle < 1e-4:
        return np.eye(3) + 0.5 * skew + skew @ skew / 12.0
    half = 0.5 * angle
    return np.eye(3) + 0.5 * skew + (1.0 - half / np.tan(half)) / angle**2 * skew @ skew
