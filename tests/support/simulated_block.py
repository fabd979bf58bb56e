"""Small simulated blocks with the same measurement layout, so that many tests share few compiled programs.

Three strips of five images over hilly ground; the last strip crosses the others, higher up. Visibility of points in
images is fixed, for level flight without lens or gimbal, so that a block has the same shapes at every location.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import BrownConrady, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.adjust import Block, GroundPoints, ImagePoints, Images, LocalFrame, Prior, Unknowns
from jaxgeo.adjust.navigation import sights_of
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import boresight_from_degrees

SIGMA_UV = 0.5  # px
SIGMA_POSITION = np.array([0.05, 0.06, 0.10])  # m
SIGMA_ATTITUDE = np.deg2rad([0.03, 0.015, 0.01])
CONTROL = ("p00", "p11", "p22", "p33", "p44", "p55")
LENS = BrownConrady(k1=-0.05, k2=0.02, p1=1e-4, p2=-2e-4)
MOUNT = Mount.nadir(
    R_body_from_base=boresight_from_degrees(heading=0.4, pitch=-0.3, roll=0.2),
    lever_body=np.array([0.8, -0.2, 0.4]),
    lever_head=np.array([0.05, 0.02, 0.1]),
)
DRONE = Mount.forward(lever_body=np.array([0.8, -0.2, 0.4]), lever_head=np.array([0.05, 0.02, 0.1]))
HALF_WIDTH, HALF_HEIGHT = 0.5, 0.375  # of the field at unit distance
STRIPS, EACH = 3, 5
MIDDLE = (47.0, 11.0)


def camera(**changes: Any) -> FrameCamera:
    """The camera, with optional changes."""
    constants = {"focal_px": 4000.0, "principal_px": (2012.0, 1490.0), "distortion": LENS} | changes
    return FrameCamera.from_pixels(width=4000, height=3000, **constants)


def tight(**changes: Any) -> Unknowns:
    """Unknowns of camera, mount and strips that hardly move, with optional changes; one compiled program for all."""
    held = Prior(1e-9)
    given = dict.fromkeys(("focal", "principal", "boresight", "lever", "shift"), held)
    return Unknowns(**given | {"distortion": {"k1": held, "p1": held}} | changes)


def fixed() -> Sensor:
    """Sensor on a fixed mount, with boresight and lever arms."""
    return Sensor(camera(), mount=MOUNT)


def two_axis() -> Sensor:
    """Sensor on a two-axis gimbal."""
    return Sensor(camera(), Gimbal.two_axis(), MOUNT)


def drone() -> Sensor:
    """Sensor on a drone's gimbal, which reports angles in local level."""
    mount = eqx.tree_at(
        lambda m: m.R_head_from_camera, DRONE, small_turn(0.004, -0.006, 0.003) @ DRONE.R_head_from_camera
    )
    return Sensor(camera(), Gimbal.three_axis(), mount)


def small_turn(*vector: float) -> np.ndarray:
    """Rotation matrix of a rotation vector in rad."""
    return np.asarray(_R_from_rotation_vector(np.array(vector, float)))


_R_from_rotation_vector = jax.jit(R_from_rotation_vector)


@eqx.filter_jit
def R_frame_from_enu(frame: LocalFrame, position: Geodetic) -> jax.Array:
    """Rotations at many positions."""
    return jax.vmap(frame.R_local_from_enu)(position)


@eqx.filter_jit
def _distorted(lens: BrownConrady, tangents: jax.Array) -> jax.Array:
    return jax.vmap(lens.distort)(tangents)


@cache
def flight() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(positions (15, 3), headings, times) in m and rad of the frame, and s."""
    rng = np.random.default_rng(7)
    along = np.arange(EACH) * 150.0 - 300.0
    rows = [np.stack([np.full(EACH, -140.0), along, np.full(EACH, 700.0)], 1)]
    rows += [np.stack([np.full(EACH, 140.0), -along, np.full(EACH, 720.0)], 1)]
    rows += [np.stack([along, np.zeros(EACH), np.full(EACH, 850.0)], 1)]
    heading = np.deg2rad(np.repeat([0.0, 180.0, 90.0], EACH)) + rng.normal(0.0, 0.02, STRIPS * EACH)
    time = np.arange(STRIPS * EACH) * 3.0 + np.repeat([0.0, 60.0, 120.0], EACH)
    return np.concatenate(rows) + rng.normal(0.0, 4.0, (STRIPS * EACH, 3)), heading, time


def ground(east: Any, north: Any) -> Any:
    """Heights of the hills, m."""
    return 60.0 * np.sin(east / 180.0) * np.cos(north / 150.0 + 0.4)


@cache
def seen(count: int = 64) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(positions (count, 3), image indices, point indices) of all visible image points."""
    rng = np.random.default_rng(11)
    places, heading, _ = flight()
    east, north = rng.uniform(-430.0, 430.0, (2, 4 * count))
    points = np.stack([east, north, ground(east, north)], 1)
    d = points[None] - places[:, None]
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    forward, right = d[..., 0] * s + d[..., 1] * c, d[..., 0] * c - d[..., 1] * s
    there = (np.abs(right / d[..., 2]) < HALF_WIDTH - 0.03) & (np.abs(forward / d[..., 2]) < HALF_HEIGHT - 0.03)
    rays = there.sum(axis=0)
    keep = np.concatenate([np.flatnonzero(rays == 2)[: count // 4], np.flatnonzero(rays >= 3)])[:count]
    there = there[:, keep]
    for point in range(len(keep)):  # two, five or six, ten or eleven rays: three groups, two of them with gaps
        rays = int(there[:, point].sum())
        most = 2 if rays < 5 else min(rays, 5 + point % 2) if rays < 10 else 10 + point % 2
        there[rng.permutation(np.flatnonzero(there[:, point]))[most:], point] = False
    image, point = np.nonzero(there)
    return points[keep], image, point


@dataclass(frozen=True)
class Simulated:
    """The true block, and its measurements."""

    frame: LocalFrame
    sensor: Sensor
    shots: Shot
    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    points: GroundPoints
    observations: ImagePoints
    names: tuple[str, ...]
    strip: np.ndarray

    def control(self, sigma: Any = 0.02, names: tuple[str, ...] = CONTROL) -> GroundPoints:
        """Some of the points as control."""
        return GroundPoints(list(names), self.points.of(names).place, sigma)

    def block(self, **changes: Any) -> Block:
        """The block with the true navigation."""
        given = {
            "sigma_position": SIGMA_POSITION,
            "sigma_attitude": SIGMA_ATTITUDE,
            "control": self.control(),
            "frame": self.frame,
            "strip": self.strip,
        } | changes
        sensor, shots = given.pop("sensor", self.sensor), given.pop("shots", self.shots)
        observations = given.pop("observations", self.observations)
        return Block.from_shots(sensor, self.names, shots, observations, **given)

    def noisy(self, seed: int, times: float = 1.0) -> Simulated:
        """The block with noise in image points and navigation, `times` their standard deviations."""
        rng = np.random.default_rng(seed)
        uv = self.observations.uv + rng.normal(0.0, SIGMA_UV * times, self.observations.uv.shape)
        enu = rng.normal(0.0, times, self.centre.shape) * SIGMA_POSITION
        angles = rng.normal(0.0, times, self.centre.shape) * SIGMA_ATTITUDE
        return replace(
            self,
            observations=replace(self.observations, uv=uv),
            shots=moved_shots(self.frame, self.shots, enu, angles),
        )

    def offsets(self, adjustment: Any) -> dict[str, float]:
        """Differences of an adjustment from the truth: m, rad, m."""
        R = np.swapaxes(self.R_frame_from_camera, 1, 2) @ adjustment.images.R_frame_from_camera
        return {
            "centre": float(np.abs(adjustment.images.centre - self.centre).max()),
            "turn": float(np.abs(R - np.eye(3)).max()),
            "points": float(np.abs(adjustment.differences(self.points)).max()),
        }


@cache
def simulated(kind: str = "fixed", lat: float = MIDDLE[0], lon: float = MIDDLE[1]) -> Simulated:
    """A block at a position in deg on a sensor: "fixed", "two_axis" or "drone", without errors."""
    sensor = {"fixed": fixed, "two_axis": two_axis, "drone": drone}[kind]()
    frame = LocalFrame(Geodetic.from_degrees(lat=lat, lon=lon, height=0.0))
    place, heading, time = flight()
    n, rng = len(time), np.random.default_rng(3)
    # Headings are those of the frame, which near the pole differ much from those of each image's meridian.
    position = frame.to_geodetic(place)
    enu = np.asarray(R_frame_from_enu(frame, position))
    heading = heading + np.arctan2(enu[:, 1, 0], enu[:, 0, 0])
    small = rng.normal(0.0, 0.02, (2, n))
    readings = np.zeros((n, 0))
    if kind == "two_axis":
        readings = rng.normal(0.0, 0.05, (n, 2))
    if kind == "drone":
        readings = np.stack([heading, -0.5 * np.pi + rng.normal(0.0, 0.03, n), rng.normal(0.0, 0.02, n)], 1)
    shots = Shot(Pose(position, heading, *small), readings, time)
    centre, R = sights_of(frame, sensor, shots)
    points, image, point = seen()
    names = tuple(f"i{k:02d}" for k in range(n))
    labels = np.array([f"p{k:02d}" for k in range(len(points))])
    uv = pixels(sensor.camera, centre[image], R[image], points[point])
    observations = ImagePoints(np.array(names)[image], labels[point], uv, SIGMA_UV)
    strip = np.repeat(["north", "south", "across"], EACH)
    return Simulated(frame, sensor, shots, centre, R, GroundPoints(labels, points), observations, names, strip)


def pixels(of: FrameCamera, centre: np.ndarray, R: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels (k, 2) of points (k, 3) from cameras (k, 3), (k, 3, 3), inside the image or not."""
    d = np.einsum("kji,kj->ki", R, points - centre)
    return np.asarray(of.principal_px) + np.asarray(of.focal_px) * np.asarray(
        _distorted(of.distortion, jnp.asarray(d[:, :2] / d[:, 2:]))
    )


def moved_shots(frame: LocalFrame, shots: Shot, enu: np.ndarray, angles: np.ndarray) -> Shot:
    """Shots shifted by m east, north, up, and turned by rad of heading, pitch, roll, or of their gimbal's axes."""
    pose = shots.pose
    turn = np.asarray(R_frame_from_enu(frame, pose.position))
    place = np.asarray(frame.from_geodetic(pose.position)) + np.einsum("nij,nj->ni", turn, enu)
    position = frame.to_geodetic(place)
    if np.shape(shots.gimbal_readings)[1] == 3:  # level itself is right, the gimbal's reported angles in it are not
        readings = np.asarray(shots.gimbal_readings) + angles
        return Shot(Pose(position, pose.heading, pose.pitch, pose.roll), readings, shots.time)
    given = np.stack([np.asarray(x) for x in (pose.heading, pose.pitch, pose.roll)], 1) + angles
    return Shot(Pose(position, *given.T), shots.gimbal_readings, shots.time)


def disturbed(block: Block, metres: float = 3.0, radians: float = 0.01, seed: int = 5) -> Block:
    """The block with disturbed starting values."""
    rng, images = np.random.default_rng(seed), block.images
    centre = images.centre + rng.normal(0.0, metres, images.centre.shape)
    turns = np.stack([small_turn(*v) for v in rng.normal(0.0, radians, images.centre.shape)])
    return replace(block, images=Images(images.name, images.camera, centre, images.R_frame_from_camera @ turns))
