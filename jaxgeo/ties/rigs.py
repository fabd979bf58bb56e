"""Several cameras on one mount: images of one exposure move together; each camera has mounting errors of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxgeo.adjust.exposures import FARTHEST
from jaxgeo.earth import WGS84
from jaxgeo.observation import Exposure
from jaxgeo.sensor import Shot
from jaxgeo.uncertainty import sources
from jaxgeo.uncertainty.sources.base import AbstractSource

OF_CAMERA = (sources.CameraMounting, sources.LeverArm)  # one number for each camera
OF_MOUNT = (sources.Boresight, sources.GimbalMounting, sources.GimbalAngles)  # one for all cameras of a gimbal head
UNSTEADY = 1.0  # m: by which the distance of two cameras may change from shot to shot
OF_CLOCKS = 1.5  # s: by which their times may, as clocks of whole seconds do
SIGMAS = 4.0  # standard deviations of the stated errors, in addition


class Rigs(NamedTuple):
    """Exposures and cameras of n images: `shot` (n,) numbers of exposures, `camera` (n,) names, `mount` (n,) the names
    of the cameras on the same gimbal head; with `centre` (n, 3) in m and `R_frame_from_camera` (n, 3, 3)."""

    shot: np.ndarray
    camera: np.ndarray
    mount: np.ndarray
    centre: np.ndarray
    R_frame_from_camera: np.ndarray

    def of_source(self, source: AbstractSource) -> np.ndarray | None:
        """(n,) names of the cameras that share the numbers of a source; None if all do."""
        parts = source.parts if isinstance(source, sources.Correlated) else (source,)
        if any(isinstance(one, OF_CAMERA) for one in parts):
            return self.camera
        return self.mount if any(isinstance(one, OF_MOUNT) for one in parts) else None

    def together(self, rows: np.ndarray, effects: np.ndarray) -> np.ndarray:
        """Effects (k, 6, axes) of errors on the poses of images `rows` (k,), where all images of one shot move as one
        rigid body: as the effects on its first image make it."""
        found = effects.copy()
        for one in np.unique(self.shot[rows]):
            first, *others = np.flatnonzero(self.shot[rows] == one)
            R = self.R_frame_from_camera[rows[first]]
            turn = R @ effects[first, 3:]  # in the frame
            for k in others:
                away = self.centre[rows[k]] - self.centre[rows[first]]
                found[k, :3] = effects[first, :3] + np.cross(turn, away, axisa=0, axisc=0)
                found[k, 3:] = self.R_frame_from_camera[rows[k]].T @ turn
        return found

    @property
    def is_shared(self) -> np.ndarray:
        """Flags (n,) of images whose shot has others."""
        _, place, count = np.unique(self.shot, return_inverse=True, return_counts=True)
        return count[place] > 1


def second_order(turn: np.ndarray, mounting: np.ndarray, R_frame_from_camera: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) of what a sum of the effects of two independent errors lacks: `turn` (3, 3), the covariance of
    rotations of the mount, and `mounting` (6, 6), that of errors of the camera on it.

    Two small rotations a, b in a row are a + b + a x b / 2 (Baker, Campbell, Hausdorff), and a lever arm that is longer
    by l moves the centre by another a x l. Rotations are about the camera's axes, centres in the frame.
    """
    found = np.zeros((6, 6))
    found[3:, 3:] = 0.25 * of_cross(turn, mounting[3:, 3:])
    R = R_frame_from_camera
    found[:3, :3] = of_cross(R @ turn @ R.T, mounting[:3, :3])
    return found


def of_cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Covariance (3, 3) of the cross product of two independent vectors of zero mean with covariances a, b (3, 3)."""
    both = a @ b
    spread = np.trace(a) * np.trace(b) - np.trace(both)
    return spread * np.eye(3) + both + both.T - np.trace(a) * b.T - np.trace(b) * a.T


def shots_of(shot: Any, count: int) -> np.ndarray:
    """Numbers (n,) of exposures. Raises `ValueError`."""
    numbers = np.asarray(shot)
    if numbers.shape != (count,) or not np.issubdtype(numbers.dtype, np.integer):
        raise ValueError(
            f"shot must be one whole number for each of {count} images, the same for images of one exposure; got "
            f"{shot!r}."
        )
    return numbers


def check_cameras(names: np.ndarray, shot: np.ndarray, camera: np.ndarray, flight: np.ndarray) -> None:
    """Raises `ValueError` for a shot with two images of one camera, or of two flights."""
    first: dict[int, int] = {}
    seen: dict[tuple[int, str], int] = {}
    for row, (number, by) in enumerate(zip(shot.tolist(), camera.tolist(), strict=True)):
        other = seen.setdefault((number, by), row)
        if other != row:
            raise ValueError(
                f"images {names[other]} and {names[row]} are both of shot {number} and of camera {by}, but a camera "
                f"takes one image of a shot. Number the shots apart; name cameras that are equal by camera=."
            )
        other = first.setdefault(number, row)
        if flight[other] != flight[row]:
            raise ValueError(
                f"images {names[other]} and {names[row]} are both of shot {number}, but of flights {flight[other]} and "
                f"{flight[row]}; number the shots of all flights in one series."
            )


def check_together(
    names: np.ndarray, exposures: Sequence[Exposure], shot: np.ndarray, camera: np.ndarray, covariance_of_pair: Any
) -> None:
    """Raises `ValueError` for images of one shot whose stated positions or times show that they are of several:
    positions more than `FARTHEST` apart, or by `UNSTEADY` nearer or farther than those of the same two cameras are in
    the median, and times likewise by `OF_CLOCKS`."""
    pairs = _pairs(shot, camera)
    motions = [one.motion for one in exposures if isinstance(one.motion, Shot)]
    place = np.array([np.asarray(WGS84.to_ecef(one.pose.position)) for one in motions]) if pairs else np.zeros((0, 3))
    time = np.array([float(np.asarray(one.time)) for one in motions])
    for both in pairs.values():
        i, j = np.array(both).T
        away = np.linalg.norm(place[i] - place[j], axis=1)
        usual = float(np.median(away))
        for k, (one, other) in enumerate(both):
            sigma = SIGMAS * _sigma_between(covariance_of_pair(one, other))
            if away[k] > FARTHEST + sigma or abs(away[k] - usual) > UNSTEADY + sigma:
                raise ValueError(
                    f"images {names[one]} and {names[other]} are both of shot {shot[one]}, but their stated positions "
                    f"are {away[k]:.3g} m apart{_of_others(away[k], usual, camera[one], camera[other])}. Are images "
                    f"mixed up? Those of one shot are exposed at once, on one mount."
                )
        known = (time[i] != 0.0) & (time[j] != 0.0) & np.isfinite(time[i] - time[j])
        apart = np.where(known, time[j] - time[i], np.nan)
        off = np.abs(apart - (np.nanmedian(apart) if np.any(known) else 0.0))
        if np.any(off > OF_CLOCKS):
            k = int(np.nanargmax(off))
            one, other = both[k]
            raise ValueError(
                f"images {names[one]} and {names[other]} are both of shot {shot[one]}, but their times are "
                f"{apart[k]:.3g} s apart, those of other shots of cameras {camera[one]} and {camera[other]} "
                f"{np.nanmedian(apart):.3g} s. Are images mixed up? Those of one shot are exposed at once, on one "
                f"mount."
            )


def _of_others(away: float, usual: float, one: str, other: str) -> str:
    if abs(away - usual) <= UNSTEADY:
        return ""
    return f", those of other shots of cameras {one} and {other} {usual:.3g} m"


def _pairs(shot: np.ndarray, camera: np.ndarray) -> dict[tuple[str, str], list[tuple[int, int]]]:
    """Images of one shot, two by two, by the names of their cameras."""
    found: dict[tuple[str, str], list[tuple[int, int]]] = {}
    by_shot: dict[int, list[int]] = {}
    for row, number in enumerate(shot.tolist()):
        for other in by_shot.setdefault(number, []):
            one, two = sorted((other, row), key=lambda k: str(camera[k]))
            found.setdefault((str(camera[one]), str(camera[two])), []).append((one, two))
        by_shot[number].append(row)
    return found


def _sigma_between(covariance: np.ndarray) -> float:
    """Largest standard deviation in m of the distance of two images, from their covariance (12, 12)."""
    J = np.hstack([-np.eye(3), np.zeros((3, 3)), np.eye(3), np.zeros((3, 3))])
    return float(np.sqrt(max(np.linalg.eigvalsh(J @ covariance @ J.T)[-1], 0.0)))
