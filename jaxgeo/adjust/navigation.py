"""Navigation observations of the images: IMU position and body attitude, with their covariances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from jaxgeo._checks import as_float64, check_is
from jaxgeo._compile import sized_filter_jit
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.adjust.motion import checked_motion, motion_by_differences, motion_on_trajectory
from jaxgeo.adjust.pose_rows import PoseRows
from jaxgeo.adjust.records import Names, as_names
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.sensor import Mount, Sensor, Shot, Trajectory
from jaxgeo.sensor.platform import Station


@dataclass(frozen=True)
class Navigation:
    """Observed position and attitude of n images, in the block's frame.

    `position` (n, 3) of the IMU in m; `R_frame_from_body`; `R_frame_from_reference`, the reference of the gimbal's
    angles: body or local level; `R_base_from_head` from the gimbal angles. `information_position` and
    `information_attitude` (n, 3, 3) are W with W' W the inverse covariance, in frame axes and m, and of the rotation
    vector of the reference in its own axes and rad; zero where nothing is observed. `mount`, `strip` and `time` (s) are
    those of each image.
    """

    position: np.ndarray
    R_frame_from_body: np.ndarray
    R_frame_from_reference: np.ndarray
    R_base_from_head: np.ndarray
    information_position: np.ndarray
    information_attitude: np.ndarray
    mount: Names
    strip: Names
    time: np.ndarray
    mounts: Mapping[str, tuple[Mount, bool]]
    """By name: the mount, and whether its gimbal reports in local level."""
    common: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Errors that images share, by name: (n, 6), how far one standard deviation of each moves the position (m, frame
    axes) and the reference (rotation vector in its own axes, rad). They are unknowns of every adjustment, with standard
    normal priors; the information of the positions and attitudes is that of the other errors."""
    pose_rows: PoseRows | None = None
    """Further observations of the orientations of the cameras themselves, such as of a map."""
    velocity: np.ndarray | None = None
    """Velocities (n, 3) of the IMU at the exposures, m/s in frame axes, NaN where unknown. An unknown time offset, and
    a readout, need them."""
    turn_rate: np.ndarray | None = None
    """Turn rates (n, 3) of the gimbal's head (of the body, without a moving gimbal) relative to the frame, rad/s about
    the axes of the reference, NaN where unknown."""

    @property
    def names_of_common(self) -> tuple[str, ...]:
        """Names of the errors that images share, and of the numbers that the further observations add."""
        return tuple(dict.fromkeys([*self.common, *(() if self.pose_rows is None else self.pose_rows.by_common)]))

    @property
    def common_errors(self) -> np.ndarray:
        """`common` as one array (n, 6, k), in the order of `names_of_common`."""
        none = np.zeros((len(self.position), 6))
        return np.stack([none, *(self.common.get(name, none) for name in self.names_of_common)], axis=2)[:, :, 1:]

    def of(self, rows: np.ndarray) -> Navigation:
        """That of some images."""
        arrays: dict[str, Any] = {name: getattr(self, name)[rows] for name in _ARRAYS}
        common = {name: errors[rows] for name, errors in self.common.items()}
        measured = None if self.pose_rows is None else self.pose_rows.of(rows)
        moving: dict[str, Any] = {n: None if (x := getattr(self, n)) is None else x[rows] for n in _MOTION}
        return Navigation(**arrays, mounts=self.mounts, common=common, pose_rows=measured, **moving)

    @property
    def R_reference_from_head(self) -> np.ndarray:
        """(n, 3, 3): from the gimbal angles, and, for angles against the body, the boresight of the mount."""
        level = np.array([self.mounts[name][1] for name in self.mount.tolist()])
        base = np.array([np.asarray(self.mounts[name][0].R_body_from_base, float) for name in self.mount.tolist()])
        return np.where(level[:, None, None], np.eye(3), base) @ self.R_base_from_head

    def loosened(self, factor: float) -> Navigation:
        """A copy with standard deviations `factor` times as large, for start values with negligible weight."""
        return replace(
            self,
            information_position=self.information_position / factor,
            information_attitude=self.information_attitude / factor,
            pose_rows=None if self.pose_rows is None else self.pose_rows.weighted(1.0 / factor),
        )


_MOTION = ("velocity", "turn_rate")
_ARRAYS = tuple(
    name for name in Navigation.__dataclass_fields__ if name not in ("mounts", "common", "pose_rows", *_MOTION)
)


def sights_of(frame: LocalFrame, sensor: Sensor, shots: Shot) -> tuple[np.ndarray, np.ndarray]:
    """(perspective centres (n, 3) in the frame, R_frame_from_camera) of a batch of shots, from the navigation."""
    sights = _sights(sensor, as_float64(shots, "shots"))
    R = np.asarray(frame.R_ecef_from_local).T
    return np.asarray(frame.from_ecef(sights.centre)), R @ np.asarray(sights.R_ecef_from_camera)


def navigation_of(
    frame: LocalFrame,
    sensor: Sensor,
    shots: Shot,
    sigma_position: Any,
    sigma_attitude: Any,
    mount: str,
    strip: Names,
    *,
    velocity: Any = None,
    turn_rate: Any = None,
    trajectory: Trajectory | None = None,
) -> Navigation:
    """Navigation of n shots (fields with a leading axis), all with one mount.

    `sigma_position` east, north, up in m: a number, (3,), (n, 3) or covariances (n, 3, 3); infinite if not observed.
    `sigma_attitude` heading, pitch, roll in rad, likewise; about the axes north, east and down for a gimbal that
    reports in local level. `velocity` and `turn_rate` are those of `Navigation`; those not given are of a `trajectory`
    at the times of the shots, or by differences between neighbouring images of a strip (`motion_by_differences`).
    Raises `ValueError` for sigmas that are not positive, and as `motion_on_trajectory`.
    """
    check_is(shots, Shot, "shots", "One Shot, whose fields hold an entry for each image.")
    count = np.shape(shots.time)[0]
    stations, R_base_from_head = _stations(sensor, as_float64(shots, "shots"))
    R = np.asarray(frame.R_ecef_from_local).T
    level = sensor.gimbal.reference == "level"
    R_body, R_level = (R @ np.asarray(x) for x in (stations.R_ecef_from_body, stations.R_ecef_from_level))
    R_base = np.asarray(R_base_from_head)
    R_frame_from_enu = R @ np.asarray(jax.vmap(R_ecef_from_enu)(as_float64(shots.pose.position, "position")))
    by_position = information(sigma_position, count, "sigma_position", "m") @ np.swapaxes(R_frame_from_enu, 1, 2)
    turns = np.broadcast_to(np.eye(3), (count, 3, 3)) if level else _turn_by_angles(shots)
    by_attitude = _of_turns(sigma_attitude, turns, count)
    found = Navigation(
        position=np.asarray(frame.from_ecef(stations.p_ecef)),
        R_frame_from_body=R_body,
        R_frame_from_reference=R_level if level else R_body,
        R_base_from_head=R_base,
        information_position=by_position,
        information_attitude=by_attitude,
        mount=np.full(count, mount),
        strip=as_names(strip, "strip"),
        time=np.broadcast_to(np.asarray(shots.time, np.float64), (count,)),
        mounts={mount: (sensor.mount, level)},
    )
    velocity, turn_rate = checked_motion(velocity, count, "velocity"), checked_motion(turn_rate, count, "turn_rate")
    if velocity is None or turn_rate is None:
        derived = _motion_of(frame, sensor, trajectory, found)
        velocity, turn_rate = (b if a is None else a for a, b in zip((velocity, turn_rate), derived, strict=True))
    return replace(found, velocity=velocity, turn_rate=turn_rate)


def _motion_of(
    frame: LocalFrame, sensor: Sensor, trajectory: Trajectory | None, given: Navigation
) -> tuple[np.ndarray, np.ndarray]:
    if trajectory is not None:
        return motion_on_trajectory(frame, sensor, trajectory, given.time)
    head = given.R_frame_from_reference @ given.R_reference_from_head
    return motion_by_differences(given.position, head, given.R_frame_from_reference, given.time, given.strip)


def joined(parts: list[Navigation]) -> Navigation:
    """Concatenated navigation of several lists of images; common errors of one name are the same.

    Raises `ValueError` for parts with further observations of orientations.
    """
    if any(part.pose_rows is not None for part in parts):
        raise ValueError("navigation with pose_rows cannot be joined; join the parts first, then add the rows.")
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS}
    mounts = {name: mount for part in parts for name, mount in part.mounts.items()}
    names = dict.fromkeys(name for part in parts for name in part.common)
    none = [np.zeros((len(part.position), 6)) for part in parts]
    common = {
        name: np.concatenate([part.common.get(name, zero) for part, zero in zip(parts, none, strict=True)])
        for name in names
    }
    motion: dict[str, Any] = {name: _joined([getattr(part, name) for part in parts], none) for name in _MOTION}
    return Navigation(**arrays, mounts=mounts, common=common, **motion)


def _joined(parts: list[np.ndarray | None], none: list[np.ndarray]) -> np.ndarray | None:
    """Velocities or turn rates of several lists of images, NaN where unknown; None if all are."""
    if all(part is None for part in parts):
        return None
    return np.concatenate(
        [np.full((len(zero), 3), np.nan) if part is None else part for part, zero in zip(parts, none, strict=True)]
    )


def information(sigma: Any, count: int, what: str, unit: str) -> np.ndarray:
    """W (n, 3, 3) with W' W = inverse covariance, from standard deviations or covariances; zero where infinite."""
    sigma = np.asarray(sigma, np.float64)
    if sigma.shape == (count, 3, 3):
        return _of_covariances(sigma, what, unit)
    if sigma.shape not in ((), (3,), (count, 3)):
        raise ValueError(
            f"{what} must be a number, (3,), ({count}, 3) or covariances ({count}, 3, 3); got shape {sigma.shape}."
        )
    sigma = np.broadcast_to(sigma, (count, 3))
    if not np.all(sigma > 0.0):
        image = int(np.argmax(~np.all(sigma > 0.0, axis=1)))
        raise ValueError(
            f"{what} of image {image} must be positive, in {unit} (infinite where nothing is observed); got "
            f"{sigma[image].tolist()}."
        )
    return np.eye(3) * (1.0 / sigma)[:, None, :]


def _of_covariances(covariance: np.ndarray, what: str, unit: str) -> np.ndarray:
    symmetric = np.all(np.isfinite(covariance), axis=(1, 2)) & np.all(
        np.abs(covariance - np.swapaxes(covariance, 1, 2))
        <= 1e-12 * np.max(np.abs(covariance), axis=(1, 2))[:, None, None],
        axis=(1, 2),
    )
    positive = symmetric.copy()
    positive[symmetric] = np.linalg.eigvalsh(covariance[symmetric])[:, 0] > 0.0
    if not np.all(positive):
        image = int(np.argmax(~positive))
        raise ValueError(
            f"{what} of image {image} must be a symmetric, positive definite matrix, in {unit} squared; got "
            f"{covariance[image].tolist()}."
        )
    return np.linalg.inv(np.linalg.cholesky(covariance))


def _of_turns(sigma: Any, turns: np.ndarray, count: int) -> np.ndarray:
    """Information of rotation vectors e = T a from that of the angles a."""
    given = information(sigma, count, "sigma_attitude", "rad")
    upright = np.abs(np.linalg.det(turns)) < 1e-6
    if np.any(upright):
        raise ValueError(
            f"image {int(np.argmax(upright))} has a pitch of 90 degrees, where heading and roll are one angle, so that "
            f"its attitude has no covariance by them."
        )
    return given @ np.linalg.inv(turns)


def _turn_by_angles(shots: Shot) -> np.ndarray:
    """Derivatives of body-axis rotation vectors (columns) by heading, pitch and roll, (n, 3, 3)."""
    count = np.shape(shots.time)[0]
    pitch, roll = (np.broadcast_to(np.asarray(x, np.float64), (count,)) for x in (shots.pose.pitch, shots.pose.roll))
    zero, one = np.zeros(count), np.ones(count)
    heading = [-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)]
    columns = [heading, [zero, np.cos(roll), -np.sin(roll)], [one, zero, zero]]
    return np.stack([np.stack(column, axis=1) for column in columns], axis=2)


@sized_filter_jit
def _sights(sensor: Sensor, shots: Shot) -> Any:
    return jax.vmap(sensor.sight)(shots)


@sized_filter_jit
def _stations(sensor: Sensor, shots: Shot) -> tuple[Any, Any]:
    stations = jax.vmap(Station.of)(shots)
    return stations, jax.vmap(sensor.gimbal.R_base_from_head)(stations.gimbal_readings)
