"""The small simulated block flown in uniform motion, read row by row: pixels and navigation by NumPy."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgeo import Pose, Shot
from jaxgeo.adjust import Block
from tests.support.simulated_block import EACH, R_frame_from_enu, Simulated, pixels, simulated

SPEED = 50.0  # m/s
RATE = 0.03  # rad/s: standard deviation of the body's turn rates
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
ROUNDS = 8  # of row and time; each divides the error by a hundred


@cache
def motion() -> tuple[np.ndarray, np.ndarray]:
    """(velocities (15, 3) in m/s, east, north, up; turn rates (15, 3) in rad/s, body axes) of the images."""
    rng = np.random.default_rng(21)
    along = np.repeat([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]], EACH, axis=0)
    return SPEED * along + rng.normal(0.0, 1.0, along.shape), rng.normal(0.0, RATE, along.shape)


def straight() -> tuple[np.ndarray, np.ndarray]:
    """The same without turns, and with one velocity in each strip."""
    velocity, turn_rate = motion()
    along = np.round(velocity / SPEED) * SPEED
    return along, np.zeros_like(turn_rate)


def indices(of: Simulated) -> tuple[np.ndarray, np.ndarray]:
    """(index of the image (k,), true place of the point (k, 3)) of each measurement."""
    image = np.array([of.names.index(name) for name in of.observations.image.tolist()])
    places = dict(zip(of.points.name.tolist(), of.points.place, strict=True))
    return image, np.array([places[name] for name in of.observations.point.tolist()])


def exposed(of: Simulated, readout: float) -> Simulated:
    """The block with pixels of a camera on a fixed mount that reads its rows in `readout` s, the middle row at the
    pose of the shot."""
    image, points = indices(of)
    velocity, turn_rate = (x[image] for x in motion())
    body, camera, mount = R_frame_from_body(of)[image], of.sensor.camera, of.sensor.mount
    imu = np.asarray(of.frame.from_geodetic(of.shots.pose.position))[image]
    in_body = np.asarray(mount.R_body_from_base) @ np.asarray(mount.R_head_from_camera)
    arm = np.asarray(mount.lever_body) + np.asarray(mount.R_body_from_base) @ np.asarray(mount.lever_head)
    uv = of.observations.uv
    for _ in range(ROUNDS):
        tau = (readout / camera.height * (uv[:, 1] - 0.5 * (camera.height - 1)))[:, None]
        turned = body @ Rotation.from_rotvec(tau * turn_rate).as_matrix()
        uv = pixels(camera, imu + tau * velocity + turned @ arm, turned @ in_body, points)
    return replace(of, observations=replace(of.observations, uv=uv))


def R_frame_from_body(of: Simulated) -> np.ndarray:
    """Orientations (15, 3, 3) of the body."""
    pose = of.shots.pose
    angles = np.stack([np.broadcast_to(x, (len(of.names),)) for x in (pose.heading, pose.pitch, pose.roll)], axis=1)
    enu = np.asarray(R_frame_from_enu(of.frame, pose.position))
    return enu @ NED @ Rotation.from_euler("ZYX", angles).as_matrix()


def late(of: Simulated, seconds: Any) -> Simulated:
    """The block with the navigation of `seconds` after the exposures: a number, or one for each image."""
    velocity, turn_rate = motion()
    after = np.broadcast_to(seconds, (len(of.names),))[:, None]
    position = of.frame.to_geodetic(np.asarray(of.frame.from_geodetic(of.shots.pose.position)) + after * velocity)
    R = R_frame_from_body(of) @ Rotation.from_rotvec(after * turn_rate).as_matrix()
    ned = NED @ np.swapaxes(np.asarray(R_frame_from_enu(of.frame, position)), 1, 2)
    heading, pitch, roll = Rotation.from_matrix(ned @ R).as_euler("ZYX").T
    return replace(of, shots=Shot(Pose(position, heading, pitch, roll), of.shots.gimbal_readings, of.shots.time))


def moving(of: Simulated, **changes: Any) -> Block:
    """The block with its navigation, velocities and turn rates."""
    velocity, turn_rate = motion()
    return of.block(**{"velocity": velocity, "turn_rate": turn_rate} | changes)


def truth() -> Simulated:
    """The block on a fixed mount."""
    return simulated()
