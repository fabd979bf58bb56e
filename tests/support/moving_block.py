"""The small simulated block flown in uniform motion, seen by a rolling shutter through the air: pixels by the forward
model of single images, a `RollingShutterCamera` on a `Trajectory`, which shares no code with the adjustment."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import Atmosphere, Pose, RollingShutterCamera, Sensor, Shot
from jaxgeo.adjust import Block, LocalFrame
from jaxgeo.rotations import R_from_rotation_vector, heading_pitch_roll_from_R
from jaxgeo.sensor import Trajectory
from jaxgeo.sensor.exposure import image_of_point
from tests.support.simulated_block import EACH, Simulated, simulated

SPEED = 50.0  # m/s
RATE = 0.03  # rad/s: standard deviation of the body's turn rates


@cache
def motion() -> tuple[np.ndarray, np.ndarray]:
    """(velocities (15, 3) in m/s, east, north, up; turn rates (15, 3) in rad/s, body axes) of the images."""
    rng = np.random.default_rng(21)
    along = np.repeat([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]], EACH, axis=0)
    return SPEED * along + rng.normal(0.0, 1.0, along.shape), rng.normal(0.0, RATE, along.shape)


def exposed(of: Simulated, readout: float = 0.0, air: Atmosphere | None = None) -> Simulated:
    """The block with the pixels of a camera that reads its rows in `readout` s, from a platform in motion."""
    image = np.array([of.names.index(name) for name in of.observations.image.tolist()])
    places = dict(zip(of.points.name.tolist(), of.points.place, strict=True))
    points = np.array([places[name] for name in of.observations.point.tolist()])
    velocity, turn_rate = motion()
    given = (of.sensor, readout) if readout else (of.sensor, None)
    p_ecef = of.frame.to_ecef(points)
    shots = jax.tree.map(lambda x: jnp.asarray(np.asarray(x, float)[image]), _shots(of))
    uv = _pixels(of.frame, *given, shots, jnp.asarray(velocity[image]), jnp.asarray(turn_rate[image]), p_ecef, air)
    return replace(of, observations=replace(of.observations, uv=np.asarray(uv)))


def _shots(of: Simulated) -> Shot:
    pose, n = of.shots.pose, len(of.names)
    angles = [np.broadcast_to(np.asarray(x, float), (n,)) for x in (pose.heading, pose.pitch, pose.roll)]
    return Shot(Pose(pose.position, *angles), of.shots.gimbal_readings, np.asarray(of.shots.time, float))


@eqx.filter_jit
def _pixels(
    frame: LocalFrame,
    sensor: Sensor,
    readout: float | None,
    shots: Shot,
    velocity: Any,
    turn_rate: Any,
    points: Any,
    air: Atmosphere | None,
) -> Any:
    def one(shot: Shot, velocity: Any, turn_rate: Any, point: Any) -> Any:
        if readout is None:
            return image_of_point(sensor, shot, shot.time, point, air)[0]
        rolling = RollingShutterCamera.from_readout(sensor.camera, readout_time=readout)
        enu = frame.R_local_from_enu(shot.pose.position).T @ velocity
        ned = jnp.stack([enu[1], enu[0], -enu[2]])
        path = Trajectory.steady(shot, velocity_ned=ned, body_rates=turn_rate)
        first = shot.time - rolling.line_time * 0.5 * (sensor.camera.height - 1)
        return image_of_point(eqx.tree_at(lambda s: s.camera, sensor, rolling), path, first, point, air)[0]

    return jax.vmap(one)(shots, velocity, turn_rate, points)


def late(of: Simulated, seconds: float | np.ndarray) -> Simulated:
    """The block with the navigation of `seconds` after each exposure."""
    velocity, turn_rate = motion()
    seconds = np.broadcast_to(seconds, (len(of.names),))
    shots = _late(of.frame, _shots(of), seconds[:, None] * velocity, seconds[:, None] * turn_rate)
    return replace(of, shots=jax.tree.map(np.asarray, shots))


@eqx.filter_jit
def _late(frame: LocalFrame, shots: Shot, shift: Any, turn: Any) -> Shot:
    def one(shot: Shot, turn: Any, place: Any) -> Shot:
        local = frame.R_local_from_enu(shot.pose.position)
        position = frame.to_geodetic(place)
        there = frame.R_local_from_enu(position)
        ned = jnp.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        R = ned @ there.T @ local @ ned @ shot.pose.R_ned_from_body @ R_from_rotation_vector(turn)
        return Shot(Pose(position, *heading_pitch_roll_from_R(R)), shot.gimbal_readings, shot.time)

    return jax.vmap(one)(shots, turn, frame.from_geodetic(shots.pose.position) + shift)


def moving(of: Simulated, **changes: Any) -> Block:
    """The block with its navigation, velocities and turn rates."""
    velocity, turn_rate = motion()
    return of.block(**{"velocity": velocity, "turn_rate": turn_rate} | changes)


def truth() -> Simulated:
    """The block on a fixed mount."""
    return simulated()
