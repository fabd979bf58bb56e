"""Recursive correction of a sequence: images one after another, in bounded time and memory each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxgeo._checks import check_is, require_x64
from jaxgeo.adjust import ImagePoints, LocalFrame
from jaxgeo.adjust.block import frame_at
from jaxgeo.adjust.exposures import LEAST_ATTITUDE, LEAST_POSITION
from jaxgeo.observation import Exposure
from jaxgeo.register.registration import Registration
from jaxgeo.sensor import FrameCamera, Shot
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.ties.block_of_views import information_of
from jaxgeo.ties.cameras import are_equal
from jaxgeo.ties.control_choice import CONTRADICTS, IMPROBABLE, UNCLEAR, chance
from jaxgeo.ties.drift import Drifting, drifting
from jaxgeo.ties.map_control import Measured, measured_by
from jaxgeo.ties.views import check_errors, checked_frame, pose_errors
from jaxgeo.ties.window import POSE, Frame, Window, empty, with_frame, with_names
from jaxgeo.ties.window_solution import Solved, largest_correction, map_rows, solved, without_oldest

LEAST_SHARE = 1e-5  # of the navigation's standard deviation: lower bound of that of an image alone, against rounding
JOINED = 3  # points that an image must share with others to be connected


@dataclass(frozen=True)
class FrameEstimate:
    """Estimated orientation of an image of a sequence.

    `centre` (3,) in m and `R_frame_from_camera` (3, 3) (camera right, down, forward) are in `frame`, an
    east-north-up frame at the first image; `covariance` (6, 6) is that of their errors, centre in m (frame axes),
    rotation in rad about the camera's axes, and `prior` (6, 6) that of the navigation. `time` in s is that of the shot.
    `ties` measurements of the image count and `left_out` do not fit; it is `connected` if it shares three points or
    more with others of the window. `sigmas` is the largest correction of its navigation in standard
    deviations; more than 4 is doubtful. `registered` says whether its map measurements count, `refused` why they do
    not.
    """

    name: str
    time: float
    frame: LocalFrame
    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    covariance: np.ndarray
    prior: np.ndarray
    sigmas: float
    ties: int
    left_out: int
    connected: bool
    registered: bool
    refused: str | None

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviations (6,): centre in m (frame axes), rotation in rad about the camera's axes."""
        return np.sqrt(np.diagonal(self.covariance))


class RecursiveCorrection:
    """Correction of images that come one after another, by tie points with the last ones and by a map now and then.

    Each `add` is one update: the last `window` images are adjusted by all their tie points, navigation and map
    measurements. An image that leaves the window is marginalised: what it says about the others is kept as a normal
    distribution of their orientations, of the navigation's errors and of the map's shift. Time and memory of an update
    depend on the window and its number of points, not on the number of images before.

    Errors of the navigation are states by the `sharing` of their sources: `TimeCorrelated` ones are first-order
    Gauss-Markov processes in the times of the shots, `PerFlight` and `Systematic` ones constants, `PerImage` ones
    independent. All images are of one flight, and each is an exposure of its own: those of several cameras on one mount
    count as independent. Adjust these by `correct`, with `Views.of(..., shot=...)`.

    The estimates are those of one adjustment of all images (`correct`), up to linearisation, where no point is
    measured over more than `window` images, one after the other. The measurements of a longer track count as those of
    several points: this leaves out what holds them together, and counts nothing twice.

    Measurements of points are weighted by a robust loss (Cauchy, as wide as the residuals at first), then left out
    beyond four standard deviations; all of an image are, where less than two fifths of them fit. `excess` px are added
    to their standard deviations in quadrature, such as `Correction.excess` of a first part of the sequence.

    A fixed-lag smoother: Sibley, Matthies and Sukhatme (2010), "Sliding window filter with application to planetary
    landing", sections 2 and 3, with points eliminated by orthogonal projection as in Mourikis and Roumeliotis (2007),
    "A multi-state constraint Kalman filter", Eqs 23 and 24.

    Raises `ValueError` for a window of less than two images, and an excess that is negative or not finite.
    """

    def __init__(self, window: int = 8, *, excess: float = 0.0) -> None:
        require_x64()
        if not isinstance(window, int | np.integer) or window < 2:
            raise ValueError(f"window must be a whole number of 2 images or more; got {window!r}.")
        if not (np.isfinite(excess) and excess >= 0.0):
            raise ValueError(f"excess must not be negative, in px; got {excess!r}.")
        self.window = int(window)
        self.frame: LocalFrame | None = None
        self.count = 0
        self.final: FrameEstimate | None = None
        self._solved = Solved(empty(float(excess)), np.zeros((0, 0)), True)
        self._refused: dict[str, str] = {}

    def add(
        self,
        name: str,
        exposure: Exposure,
        errors: Any,
        points: ImagePoints | None = None,
        *,
        registration: Registration | None = None,
        terrain: AbstractTerrain | None = None,
    ) -> FrameEstimate:
        """Add an image and return its estimate.

        `exposure` and `errors` are as for `Views.of`; all images must have the same sources with the same sharing;
        their sigmas may differ. `points` are the measurements of tie points in this image: points of one name are the
        same ground point. `registration` to a map, with the `terrain` that it was made with, enters as by `register`.

        `final` is then the last estimate of the image that left the window, or None. Raises `ValueError` for an image
        of the window again, a time before that of the last image, other sources than before, points of other images,
        and a navigation without error of position or attitude; `ArithmeticError` for an update without finite solution,
        by standard deviations that differ by too much; `TypeError` for other cameras than frame cameras and for
        moving sensors. Nothing is changed by an image that is refused.
        """
        frame, local = self._frame_of(name, exposure, errors, points)
        measured = None if registration is None else _measured(local, frame, registration, terrain)
        window, final = self._solved.window, None
        refused = dict(self._refused)
        if len(window.frames) == self.window:
            final = self.estimates[0]
            window = without_oldest(window)
            refused.pop(final.name, None)
        window = with_names(window, frame.drift.constant)
        found = _solved(with_frame(window, frame), name)
        self.frame, self.final, self._solved, self._refused = local, final, found, refused
        self.count += 1
        if measured is not None:
            self._enter(name, measured)
        return self.estimates[-1]

    def register(self, name: str, registration: Registration, terrain: AbstractTerrain) -> FrameEstimate:
        """Add the registration of an image of the window to a map, and return the image's new estimate.

        Only its ties enter, as in `MapControl.of`; the map shift is a constant of the sequence. A registration whose
        measurements are less probable than 1e-6, given all else, is refused; if it contradicts that of another image
        of the window and nothing tells which one is wrong, both are left out. Raises `ValueError` for an image that is
        not in the window, that has one already, or that is not registered.
        """
        frame = next((one for one in self._solved.window.frames if one.name == name), None)
        if frame is None:
            known = ", ".join(one.name for one in self._solved.window.frames) or "none"
            raise ValueError(f"image {name!r} is not in the window; its images are: {known}.")
        if frame.measured is not None or name in self._refused:
            raise ValueError(f"image {name!r} has a registration already.")
        assert self.frame is not None
        self._enter(name, _measured(self.frame, frame, registration, terrain))
        return next(one for one in self.estimates if one.name == name)

    @property
    def estimates(self) -> list[FrameEstimate]:
        """Current estimates of the images of the window, oldest first."""
        window, covariance = self._solved.window, self._solved.covariance
        each, count = window.of_frame, {}
        for one in window.frames:
            for point in one.seen:
                count[point] = count.get(point, 0) + 1
        found = []
        for k, one in enumerate(window.frames):
            own = slice(k * each, k * each + POSE)
            used = sum((one.name, point) in window.fits for point in one.seen)
            offered = sum(count[point] > 1 for point in one.seen)
            assert self.frame is not None
            found.append(
                FrameEstimate(
                    one.name,
                    one.time,
                    self.frame,
                    one.centre,
                    one.R_frame_from_camera,
                    covariance[own, own],
                    one.drift.covariance,
                    largest_correction(one),
                    used,
                    offered - used,
                    used >= JOINED,
                    one.measured is not None,
                    self._refused.get(one.name),
                )
            )
        return found

    @property
    def common(self) -> dict[str, tuple[float, float]]:
        """Constant errors by name, such as a boresight or the map's shift: the estimate in standard deviations of each,
        and what is left of one."""
        window = self._solved.window
        first = len(window.frames) * window.of_frame
        left = np.sqrt(np.diagonal(self._solved.covariance)[first:])
        pairs = zip(window.names, window.constant, left, strict=True)
        return {name: (float(value), float(sigma)) for name, value, sigma in pairs}

    @property
    def covariance(self) -> np.ndarray:
        """Joint covariance (6 n, 6 n) of the orientations of the n images of the window, oldest first."""
        window = self._solved.window
        each, n = window.of_frame, len(window.frames)
        own = np.concatenate([np.arange(k * each, k * each + POSE) for k in range(n)]) if n else np.zeros(0, int)
        return self._solved.covariance[np.ix_(own, own)]

    def _frame_of(
        self, name: str, exposure: Exposure, errors: Any, points: ImagePoints | None
    ) -> tuple[Frame, LocalFrame]:
        """The image with its navigation, and the frame of all. Raises as `add`."""
        window = self._solved.window
        if not isinstance(name, str):
            raise TypeError(f"name must be a str; got {name!r}.")
        if any(one.name == name for one in window.frames):
            raise ValueError(f"image {name!r} is in the window already.")
        exposure = checked_frame(name, exposure)
        shot, camera = exposure.motion, exposure.sensor.camera
        assert isinstance(shot, Shot)
        assert isinstance(camera, FrameCamera)
        time = float(np.asarray(shot.time))
        if not np.isfinite(time):
            raise ValueError(f"image {name!r}: the time of its shot must be finite, in s; got {time!r}.")
        if window.frames and time < window.frames[-1].time:
            last = window.frames[-1]
            raise ValueError(
                f"image {name!r} was taken {last.time - time:g} s before {last.name!r}, the last one; add images in "
                "the order of their times, or adjust all at once with correct."
            )
        frame = frame_at(shot.pose.position) if self.frame is None else self.frame
        drift = drifting(frame, exposure, pose_errors(errors), name)
        check_errors(np.array([name]), drift.covariance[None])
        if not (np.all(np.isfinite(drift.centre)) and np.all(np.isfinite(drift.R_frame_from_camera))):
            raise ValueError(f"image {name!r}: its position and attitude must be finite.")
        if window.frames:
            _check_alike(window.frames[-1], drift, name)
        same = next(
            (one.camera for one in window.frames if one.camera is camera or are_equal(one.camera, camera)), camera
        )
        measured = _points_of(name, points)
        zero = np.zeros(len(drift.fading))
        information = np.zeros((POSE, POSE))
        for part, least in ((np.s_[:3], LEAST_POSITION), (np.s_[3:], LEAST_ATTITUDE)):
            whole = float(np.sqrt(np.max(np.diagonal(drift.covariance)[part])))
            information[part, part] = information_of(drift.own[part, part], max(least, LEAST_SHARE * whole))
        return (
            Frame(name, time, same, drift, information, measured, drift.centre, drift.R_frame_from_camera, zero),
            frame,
        )

    def _enter(self, name: str, measured: Measured) -> None:
        """Let map measurements in, if they fit."""
        without = self._solved
        window = with_names(without.window, tuple(measured.by_common))
        if window is not without.window:
            without = _solved(window, name)
        if _fits(without, name, measured):
            self._solved = _solved(_with_map(without.window, name, measured), name)
            return
        for other in [one.name for one in window.frames if one.measured is not None]:
            fewer = _solved(_with_map(without.window, other, None), name)
            if _fits(fewer, name, measured):
                self._refused |= {name: UNCLEAR, other: UNCLEAR}
                self._solved = fewer
                return
        self._refused[name] = CONTRADICTS
        self._solved = without


def _measured(local: LocalFrame, frame: Frame, registration: Registration, terrain: AbstractTerrain | None) -> Measured:
    if terrain is None:
        raise ValueError(f"image {frame.name!r}: a registration needs the terrain that it was made with.")
    return measured_by(local, frame.camera, registration, terrain, frame.name)


def _with_map(window: Window, name: str, measured: Measured | None) -> Window:
    frames = tuple(replace(one, measured=measured) if one.name == name else one for one in window.frames)
    return replace(window, frames=frames)


def _fits(given: Solved, name: str, measured: Measured) -> bool:
    """Whether map measurements are as probable as `IMPROBABLE`, as all else predicts them."""
    window, each = given.window, given.window.of_frame
    row = next(k for k, one in enumerate(window.frames) if one.name == name)
    J, r = map_rows(window.frames[row], measured, window)
    own = np.r_[row * each : row * each + POSE, len(window.frames) * each : window.size]
    used = np.any(J != 0.0, axis=1)
    J, r = J[used], r[used]
    covariance = np.eye(len(r)) + J @ given.covariance[np.ix_(own, own)] @ J.T
    return bool(chance(r, covariance) >= np.log(IMPROBABLE))


def _solved(window: Window, name: str) -> Solved:
    """The least squares of a window. Raises `ArithmeticError` if they are not finite."""
    try:
        found = solved(window)
    except np.linalg.LinAlgError:
        found = None
    if found is None or not np.all(np.isfinite(found.covariance)):
        raise ArithmeticError(
            f"the update by image {name!r} has no finite solution; check its navigation, standard deviations that "
            "differ by more than 1e6 among them, and its measurements."
        )
    return found


def _check_alike(last: Frame, drift: Drifting, name: str) -> None:
    if (drift.constant, drift.fading) != (last.drift.constant, last.drift.fading):
        raise ValueError(
            f"image {name!r} has other error sources, or other sharing, than {last.name!r}: "
            f"{_listed(drift)} against {_listed(last.drift)}. State the same sources for all images; sigmas may differ."
        )
    if not np.allclose(drift.duration, last.drift.duration, rtol=1e-9):
        raise ValueError(
            f"image {name!r} has other correlation times than {last.name!r}, in s: {drift.duration.tolist()} against "
            f"{last.drift.duration.tolist()}."
        )


def _listed(drift: Drifting) -> str:
    return ", ".join((*drift.constant, *drift.fading)) or "none that is shared"


def _points_of(name: str, points: ImagePoints | None) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    if points is None:
        return {}
    check_is(points, ImagePoints, "points")
    others = sorted({str(one) for one in points.image if one != name})
    if others:
        raise ValueError(f"points of image {name!r} are measured in other images: {', '.join(others[:5])}.")
    pairs: Sequence[Any] = zip(points.uv, points.sigma, strict=True)  # pyright: ignore
    return {str(point): (uv, sigma) for point, (uv, sigma) in zip(points.point, pairs, strict=True)}
