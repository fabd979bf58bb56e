"""The last images of a sequence, with what earlier ones left as a prior."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from jaxgeo.sensor import FrameCamera
from jaxgeo.ties.drift import Drifting
from jaxgeo.ties.map_control import Measured

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
    # Priors of the new numbers have their minimum at zero, where all are linearised.
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


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation of a rotation vector."""
    from scipy.spatial.transform import Rotation  # submodules load lazily

    return Rotation.from_rotvec(vector).as_matrix()
