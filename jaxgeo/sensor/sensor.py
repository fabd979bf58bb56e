"""Sensor: a camera on a gimbal on a platform, and the chain of frames from pixel to ECEF."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp

from jaxgeo._checks import as_float64, check_is
from jaxgeo._numerics import all_finite, finite_or, matmul3, matvec
from jaxgeo._record import Record
from jaxgeo._renamed import moved_method
from jaxgeo._typing import Flag, Matrix3, Pixel, StatusCode, Vector3
from jaxgeo.earth import Atmosphere, R_ecef_from_ned
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.sensor.camera import AbstractCamera, PixelLike, Vector3Like
from jaxgeo.sensor.gimbal import Gimbal
from jaxgeo.sensor.platform import Mount, Shot, Station
from jaxgeo.status import Status, seen_beside, status_where

T = TypeVar("T")


class Sight(NamedTuple):
    """Camera position and orientation: perspective centre in ECEF m, and R_ecef_from_camera."""

    centre: Vector3
    R_ecef_from_camera: Matrix3

    def to_camera(self, p_ecef: Vector3, air: Atmosphere | None = None) -> Vector3:
        """Vector in m, camera frame, from the centre to a point in ECEF m, or to its apparent place through the air."""
        seeming = p_ecef if air is None else apparent_point(self.centre, p_ecef, air)
        return matvec(self.R_ecef_from_camera.T, seeming - self.centre)


class Sensor(Record):
    """Camera, gimbal and mount: the parts that stay the same from shot to shot."""

    camera: AbstractCamera
    gimbal: Gimbal = eqx.field(default_factory=Gimbal.fixed)
    mount: Mount = eqx.field(default_factory=Mount.nadir)

    def sight(self, shot: Shot | Station) -> Sight:
        """Perspective centre in ECEF m (pose position plus both lever arms) and orientation of the camera in ECEF."""
        if not isinstance(shot, Station):
            check_is(shot, Shot, "shot", "Of a Trajectory, trajectory.at(time) is one; locate takes the whole.")
        station = Station.of(shot) if isinstance(shot, Shot) else shot
        mount = as_float64(self.mount, "mount")
        R_base_from_head = self.gimbal.R_base_from_head(station.gimbal_readings)
        if self.gimbal.reference == "level":
            R_ecef_from_head = matmul3(station.R_ecef_from_level, R_base_from_head)
        else:
            R_ecef_from_head = matmul3(matmul3(station.R_ecef_from_body, mount.R_body_from_base), R_base_from_head)
        lever = matvec(station.R_ecef_from_body, mount.lever_body) + matvec(R_ecef_from_head, mount.lever_head)
        return Sight(station.p_ecef + lever, matmul3(R_ecef_from_head, mount.R_head_from_camera))

    def line(self, station: Station, direction_camera: Vector3) -> tuple[Vector3, Vector3]:
        """(perspective centre in ECEF m, a camera direction in ECEF): as by `sight`, but vector by vector.

        Faster if every line has its own shot; for many lines from one shot, the single matrix of `sight` is faster.
        """
        mount = as_float64(self.mount, "mount")
        base_from_head = self.gimbal.base_from_head(station.gimbal_readings)

        def to_ecef(v_head: Vector3) -> Vector3:
            v_base = base_from_head(v_head)
            if self.gimbal.reference == "level":
                return matvec(station.R_ecef_from_level, v_base)
            return matvec(station.R_ecef_from_body, matvec(mount.R_body_from_base, v_base))

        lever = matvec(station.R_ecef_from_body, mount.lever_body) + to_ecef(mount.lever_head)
        return station.p_ecef + lever, to_ecef(matvec(mount.R_head_from_camera, direction_camera))

    def R_ned_from_camera(self, shot: Shot) -> Matrix3:
        """Orientation of the camera (right, down, forward) in north-east-down at the position of the pose."""
        R_ned_from_ecef = R_ecef_from_ned(as_float64(shot.pose.position, "shot.pose.position")).T
        return matmul3(R_ned_from_ecef, self.R_ecef_from_camera(shot))

    def R_ecef_from_camera(self, shot: Shot) -> Matrix3:
        """Orientation of the camera (right, down, forward) in ECEF."""
        return self.sight(shot).R_ecef_from_camera

    def perspective_centre(self, shot: Shot) -> Vector3:
        """Perspective centre in ECEF, m: pose position plus both lever arms."""
        return self.sight(shot).centre

    def ray_ecef(self, shot: Shot, uv: PixelLike) -> tuple[Vector3, Vector3, StatusCode]:
        """(origin, direction, status) of a pixel's ray: perspective centre in ECEF m, unit vector in ECEF.

        The direction is finite with `hit`, and with `outside_image` within the lens model's range; otherwise NaN. With
        `invalid_input` (any input not finite) the origin is NaN too. Such lanes have zero, not NaN, gradients.
        """
        valid, sensor, shot, uv = made_safe(self, shot, uv)
        return sensor.ray_from(sensor.sight(shot), uv, valid)

    def ray_from(self, sight: Sight, uv: Pixel, valid: Flag) -> tuple[Vector3, Vector3, StatusCode]:
        """`ray_ecef` of finite numbers from a given camera position; `valid` states whether all inputs were finite."""
        direction_camera, status = self.camera.ray(uv)
        usable = valid & (seen_beside(status, direction_camera) == Status.hit)
        direction_camera = jnp.where(usable, direction_camera, jnp.array([0.0, 0.0, 1.0]))
        origin, direction = sight.centre, matvec(sight.R_ecef_from_camera, direction_camera)
        status = status_where(~valid, Status.invalid_input, status)
        return jnp.where(valid, origin, jnp.nan), jnp.where(usable, direction, jnp.nan), status

    def to_camera(self, shot: Shot, p_ecef: Vector3Like) -> Vector3:
        """A point in ECEF m as a vector from the perspective centre in the camera frame, m."""
        return self.sight(shot).to_camera(as_float64(p_ecef, "p_ecef"))

    def project_ecef(self, shot: Shot, p_ecef: Vector3Like, air: Atmosphere | None = None) -> tuple[Pixel, StatusCode]:
        """Pixel of a point in ECEF m and the camera's status; `invalid_input` and NaN for non-finite input.

        With `air`, includes refraction, which makes the point appear higher than it is.
        """
        valid, sensor, shot, p_ecef = made_safe(self, shot, p_ecef)
        uv, status = sensor.camera.project(sensor.sight(shot).to_camera(p_ecef, air))
        return jnp.where(valid, uv, jnp.nan), status_where(~valid, Status.invalid_input, status)

    looking_at = moved_method("jaxgeo.Sensor.looking_at", "jaxgeo.sensor.point_shot")
    steered = moved_method("jaxgeo.Sensor.steered", "jaxgeo.sensor.point_trajectory")


def made_safe(sensor: Sensor, motion: T, vector: Any) -> tuple[Flag, Sensor, T, Any]:
    """Whether all inputs of a ray are finite, and the inputs in float64 with ones in place of non-finite values.

    `motion` is a shot or other motion data; `vector` a pixel or a point.
    """
    sensor, motion, vector = as_float64((sensor, motion, vector), "(sensor, shot, uv or point)")
    gimbal = sensor.gimbal
    valid = all_finite((sensor.camera, gimbal.sign, gimbal.gain, gimbal.offset, sensor.mount, motion, vector))
    return valid, *finite_or((sensor, motion, vector), 1.0)
