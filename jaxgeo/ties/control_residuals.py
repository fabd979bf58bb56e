"""Residuals of control points and check points in an adjusted block, with their predicted standard deviations."""

from __future__ import annotations

import re
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust import Adjustment, Blunder, GroundPoints, ImagePoints, LocalFrame, reliability
from jaxgeo.adjust.pixels_seen import seen_at
from jaxgeo.adjust.posterior import covariance_of_functions
from jaxgeo.adjust.records import Names
from jaxgeo.ties.control import Control, rows_of
from jaxgeo.ties.prediction import Predicted, predicted

USED, CHECK, LEFT_OUT = "control", "check", "left out"
FUNCTIONS = 32  # pixels times two per call: multiples of one size, so that other counts need no compilation
STEPS = 5
ROW = r" \(row \d+\)"  # of a block, in the words of a blunder: no row of a file
PARALLEL = 1e-10  # smallest eigenvalue of the mean of I - d d' for rays that meet: parallel to about 1e-5 rad


@dataclass(frozen=True)
class ControlResiduals:
    """Residuals of m surveyed points and of their k pixels after a correction.

    `name` (m,) and `role` (m,): "control", "check", or "left out" for a control point that does not fit. `images` (m,)
    is the number of adjusted images that show a point. `enu` (m, 3) is its place by the adjusted images less the
    surveyed one, east, north, up in m, and `sigma_enu` its predicted standard deviation; NaN for check points whose
    rays do not meet, as those of points in one image. Of control points it is the residual of the adjustment.

    `image`, `point` (k,), `px` (k, 2) and `sigma_px` are those of the pixels, predicted from the surveyed place less
    measured (of control points, from the adjusted one).
    """

    name: Names
    role: Names
    images: np.ndarray
    enu: np.ndarray
    sigma_enu: np.ndarray
    image: Names
    point: Names
    px: np.ndarray
    sigma_px: np.ndarray

    def __len__(self) -> int:
        return len(self.name)

    def rms_enu(self, role: str = CHECK) -> np.ndarray:
        """RMS (3,) of the residuals east, north, up of points of a role, m; NaN if there are none."""
        return _rms(self.enu[self.role == role])

    def rms_sigma_enu(self, role: str = CHECK) -> np.ndarray:
        """RMS (3,) of their predicted standard deviations, m."""
        return _rms(self.sigma_enu[self.role == role])

    def rms_px(self, role: str = CHECK) -> float:
        """RMS of the residuals of their pixels per axis, px; NaN if there are none."""
        return float(np.sqrt(np.mean(_rms(self.px[self.of_role(role)]) ** 2)))

    def rms_sigma_px(self, role: str = CHECK) -> float:
        """RMS of the predicted standard deviations of these, px."""
        return float(np.sqrt(np.mean(_rms(self.sigma_px[self.of_role(role)]) ** 2)))

    def of_role(self, role: str) -> np.ndarray:
        """Flags (k,) of the pixels of points of a role."""
        return np.isin(self.point, self.name[self.role == role])


def residuals_of(control: Control, found: Adjustment, excess: float) -> ControlResiduals:
    """Residuals of a control after an adjustment, in the images that are adjusted.

    `excess` px is added to the standard deviations of the pixels of points that are not in the adjustment.
    """
    frame = found.block.frame
    assert isinstance(frame, LocalFrame)
    ground = control.ground(frame)
    known = found.block.control
    used = set() if known is None else set(known.name.tolist()) & set(found.prepared.names.point.tolist())
    marks = control.marks.of(np.isin(control.marks.image, found.images.name))
    roles = [USED if name in used else LEFT_OUT for name in ground.name.tolist()]
    roles = np.where(control.is_check, CHECK, roles)
    enu, sigma_enu = np.full((2, len(ground), 3), np.nan)
    px, sigma_px = np.full((2, len(marks), 2), np.nan)
    inside = roles == USED
    if np.any(inside):
        enu[inside], sigma_enu[inside] = _of_adjusted(ground.of(ground.name[inside].tolist()), found)
        px[:], sigma_px[:] = _of_adjusted_pixels(marks, used, found)
    for k in np.flatnonzero(~inside):
        rows = np.flatnonzero(marks.point == ground.name[k])
        if len(rows):
            own = _NotAdjusted.of(marks.of(rows), ground.place[k], ground.sigma[k], found, excess)
            px[rows], sigma_px[rows] = own.off, own.sigma_of_off
            enu[k], sigma_enu[k] = own.intersected(found)
    images = np.array([int(np.count_nonzero(marks.point == name)) for name in ground.name])
    return ControlResiduals(ground.name, roles, images, enu, sigma_enu, marks.image, marks.point, px, sigma_px)


def words_of(residuals: ControlResiduals, blunders: list[Blunder], excess: float) -> list[str]:
    """Control and check points as sentences."""
    lines = []
    used, checks = (int(np.count_nonzero(residuals.role == role)) for role in (USED, CHECK))
    if used:
        lines.append(
            f"Control points: {used} used, residuals {_metres(residuals.rms_enu(USED))} (RMS E, N, U) and "
            f"{residuals.rms_px(USED):.2f} px"
            + (f"; {excess:.2f} px added to the sigmas of their pixels." if excess >= 0.005 else ".")
        )
    lines += [f"Left out, as it does not fit: {re.sub(ROW, '', f'{one}')}." for one in blunders]
    if not checks:
        lines.append("No check points: nothing independent shows the accuracy. Hold some control points back.")
        return lines
    by_rays = int(np.count_nonzero((residuals.role == CHECK) & np.isfinite(residuals.enu[:, 0])))
    line = f"Check points: {checks}"
    if by_rays:
        expected = _metres(residuals.rms_sigma_enu())
        line += f", off by {_metres(residuals.rms_enu())} (RMS E, N, U of {by_rays}; predicted {expected})"
    if np.isfinite(residuals.rms_px()):
        line += f", {residuals.rms_px():.2f} px (predicted {residuals.rms_sigma_px():.2f})"
    lines.append(f"{line}.")
    unseen = residuals.name[(residuals.role == CHECK) & (residuals.images == 0)].tolist()
    if unseen:
        lines.append(f"Check points in no adjusted image: {', '.join(unseen)}.")
    return lines


def _metres(values: np.ndarray) -> str:
    return f"{', '.join(f'{x:.3g}' for x in values)} m"


def mean_position_sigma(found: Adjustment) -> np.ndarray:
    """Standard deviations (3,) of the mean position of the adjusted images along the axes of the frame, m."""
    problem = found.prepared.problem
    images = np.zeros((FUNCTIONS, problem.n, problem.of_image))
    images[:3, :, :3] = np.eye(3)[:, None, :] / problem.n
    shared = jnp.zeros((FUNCTIONS, len(found.covariance_of_shared)))
    covariance = np.asarray(covariance_of_functions(problem, found.posterior, jnp.asarray(images), shared))
    return np.sqrt(np.maximum(np.diagonal(covariance)[:3], 0.0))


def _of_adjusted(ground: GroundPoints, found: Adjustment) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (m, 3) of control points in the adjustment and their standard deviations: those of the survey less
    those of the adjusted points."""
    rows = rows_of(found.points.name, ground.name)
    left = ground.sigma**2 - found.points.sigma[rows] ** 2
    return found.points.place[rows] - ground.place, np.sqrt(np.maximum(left, 0.0))


def _of_adjusted_pixels(marks: ImagePoints, used: set[str], found: Adjustment) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (k, 2) of pixels and their standard deviations by the adjustment; NaN for those that are not in it."""
    observed = found.block.observations
    variance = (1.0 - reliability(found).redundancy) * observed.sigma**2
    left = np.sqrt(np.maximum(observed.sigma**2 - variance, 0.0))
    row_of = {key: row for row, key in enumerate(zip(observed.image.tolist(), observed.point.tolist(), strict=True))}
    px, sigma = np.full((2, len(marks), 2), np.nan)
    for k, key in enumerate(zip(marks.image.tolist(), marks.point.tolist(), strict=True)):
        if key in row_of and key[1] in used:
            px[k], sigma[k] = found.residuals[row_of[key]], left[row_of[key]]
    return px, sigma


@dataclass(frozen=True)
class _NotAdjusted:
    """A surveyed point whose k pixels are not in the adjustment: `off` (k, 2), predicted from the surveyed place less
    measured, and the covariance (2k, 2k) of the predictions by the adjustment and of the pixels."""

    marks: ImagePoints
    place: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    by_place: np.ndarray
    off: np.ndarray

    @classmethod
    def of(
        cls, marks: ImagePoints, place: np.ndarray, sigma: np.ndarray, found: Adjustment, excess: float
    ) -> _NotAdjusted:
        there = _predicted(marks, place, found)
        own = (marks.sigma**2 + excess**2).ravel()
        covariance = _covariance(marks, there, found) + np.diag(own)
        return cls(marks, place, sigma, covariance, there.by_place, there.uv - marks.uv)

    @property
    def sigma_of_off(self) -> np.ndarray:
        """Standard deviations (k, 2) of `off`, with those of the survey."""
        survey = np.einsum("kai,i,kai->ka", self.by_place, self.sigma**2, self.by_place)
        return np.sqrt(np.diagonal(self.covariance).reshape(-1, 2) + survey)

    def intersected(self, found: Adjustment) -> tuple[np.ndarray, np.ndarray]:
        """(place where the rays meet less the surveyed one (3,), its standard deviations (3,)); NaN if they do not."""
        nothing = np.full(3, np.nan), np.full(3, np.nan)
        if not _meet(self.marks, self.place, found):
            return nothing
        weight, place = np.linalg.inv(self.covariance), self.place
        normal = np.eye(3)
        for _ in range(STEPS):
            there = _predicted(self.marks, place, found)
            if not np.all(there.ahead):
                return nothing
            B = there.by_place.reshape(-1, 3)
            normal = B.T @ weight @ B
            place = place - np.linalg.solve(normal, B.T @ weight @ (there.uv - self.marks.uv).ravel())
        variance = np.diagonal(np.linalg.inv(normal)) + self.sigma**2
        return place - self.place, np.sqrt(variance)


def _predicted(marks: ImagePoints, place: np.ndarray, found: Adjustment) -> Predicted:
    """Pixels of a place in the adjusted images of its marks."""
    images, image = found.images, rows_of(found.images.name, marks.image)
    seen = seen_at(found, image, marks.uv[:, 1], np.broadcast_to(place, (len(marks), 3)))
    there = predicted(found.cameras, images.camera[image], seen.centre, seen.R_frame_from_camera, seen.place)
    by_entries = np.einsum("kai,kei->kae", there.by_place, seen.by_entries)
    return there._replace(by_lens=np.concatenate([there.by_lens, by_entries], axis=2))


def _meet(marks: ImagePoints, place: np.ndarray, found: Adjustment) -> bool:
    """Whether the directions from the images to a place are not parallel."""
    away = place - found.images.centre[rows_of(found.images.name, marks.image)]
    direction = away / np.linalg.norm(away, axis=1, keepdims=True)
    across = np.mean(np.eye(3) - direction[:, :, None] * direction[:, None, :], axis=0)
    return bool(np.linalg.eigvalsh(across)[0] > PARALLEL)


def _covariance(marks: ImagePoints, there: Predicted, found: Adjustment) -> np.ndarray:
    """Joint covariance (2k, 2k) of predicted pixels by the errors of the adjusted orientations and cameras."""
    problem = found.prepared.problem
    image = rows_of(found.images.name, marks.image)
    camera, active = np.asarray(problem.layout.camera)[image], list(problem.active)
    count = 2 * len(marks)
    size = -(-count // FUNCTIONS) * FUNCTIONS
    images = np.zeros((size, problem.n, problem.of_image))
    shared = np.zeros((size, len(found.covariance_of_shared)))
    for k in range(len(marks)):
        functions = slice(2 * k, 2 * k + 2)
        images[functions, image[k], :6] = there.by_pose[k]
        by_lens = there.by_lens[k][:, active]
        if problem.own_lens:
            images[functions, image[k], 6:] = by_lens
        else:
            first = camera[k] * len(active)
            shared[functions, first : first + len(active)] = by_lens
    whole = covariance_of_functions(problem, found.posterior, jnp.asarray(images), jnp.asarray(shared))
    return np.asarray(whole)[:count, :count]


def _rms(values: np.ndarray) -> np.ndarray:
    """RMS along the first axis, of what is known."""
    known = np.isfinite(values)
    count = np.sum(known, axis=0)
    total = np.sum(np.where(known, values, 0.0) ** 2, axis=0)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))
