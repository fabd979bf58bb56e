"""The sensor: a camera on a gimbal on a platform, and the staircase of frames from pixel to Earth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxgeo._checks import as_float64
from jaxgeo._numerics import all_finite, finite_or
from jaxgeo._typing import Flag, Matrix3, Pixel, StatusCode, Vector3
from jaxgeo.earth import WGS84, Atmosphere, Geodetic, R_ecef_from_ned
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.sensor.camera import AbstractCamera, Numbers, PixelLike, Vector3Like
from jaxgeo.sensor.gimbal import Gimbal
from jaxgeo.sensor.platform import Mount, Pose, Shot
from jaxgeo.status import Status, status_where

if TYPE_CHECKING:
    from jaxgeo.sensor.trajectory import Trajectory

T = TypeVar("T")


class Sensor(eqx.Module):
    """A camera, the gimbal that turns it, and how both are mounted; what stays the same from shot to shot."""

    camera: AbstractCamera
    gimbal: Gimbal = eqx.field(default_factory=Gimbal.fixed)
    mount: Mount = eqx.field(default_factory=Mount.nadir)

    def R_ned_from_head(self, shot: Shot) -> Matrix3:
        """Orientation of the gimbal's head in north-east-down at the position of the pose."""
        R_base_from_head = self.gimbal.R_base_from_head(shot.gimbal_readings)
        if self.gimbal.reference == "level":
            return shot.pose.levelled(R_base_from_head)
        R_body_from_base = as_float64(self.mount.R_body_from_base, "mount.R_body_from_base")
        return shot.pose.R_ned_from_body @ R_body_from_base @ R_base_from_head

    def R_ned_from_camera(self, shot: Shot) -> Matrix3:
        """Orientation of the camera (right, down, forward) in north-east-down at the position of the pose."""
        return self.R_ned_from_head(shot) @ as_float64(self.mount.R_head_from_camera, "mount.R_head_from_camera")

    def R_ecef_from_camera(self, shot: Shot) -> Matrix3:
        """Orientation of the camera (right, down, forward) in ECEF."""
        position = as_float64(shot.pose.position, "shot.pose.position")
        return R_ecef_from_ned(position) @ self.R_ned_from_camera(shot)

    def perspective_centre(self, shot: Shot) -> Vector3:
        """Perspective centre in ECEF, m: the position of the pose and both lever arms."""
        position, mount = as_float64((shot.pose.position, self.mount), "sensor")
        lever_ned = shot.pose.R_ned_from_body @ mount.lever_body + self.R_ned_from_head(shot) @ mount.lever_head
        return WGS84.to_ecef(position) + R_ecef_from_ned(position) @ lever_ned

    def ray_ecef(self, shot: Shot, uv: PixelLike) -> tuple[Vector3, Vector3, StatusCode]:
        """(origin, direction, status) of what a pixel sees: perspective centre in ECEF m, unit vector in ECEF.

        The direction is given with `hit` and `outside_image` and NaN otherwise; with `invalid_input` (anything that is
        not finite) the origin is NaN too. Such lanes have zero, not NaN, gradients.
        """
        valid, sensor, shot, uv = made_safe(self, shot, uv)
        direction_camera, status = sensor.camera.ray(uv)
        usable = valid & ((status == Status.hit) | (status == Status.outside_image))
        direction_camera = jnp.where(usable, direction_camera, jnp.array([0.0, 0.0, 1.0]))
        direction = sensor.R_ecef_from_camera(shot) @ direction_camera
        origin = sensor.perspective_centre(shot)
        status = status_where(~valid, Status.invalid_input, status)
        return jnp.where(valid, origin, jnp.nan), jnp.where(usable, direction, jnp.nan), status

    def to_camera(self, shot: Shot, p_ecef: Vector3Like) -> Vector3:
        """A point in ECEF m as a vector from the perspective centre in the camera frame, m."""
        p_ecef = as_float64(p_ecef, "p_ecef")
        return self.R_ecef_from_camera(shot).T @ (p_ecef - self.perspective_centre(shot))

    def project_ecef(self, shot: Shot, p_ecef: Vector3Like, air: Atmosphere | None = None) -> tuple[Pixel, StatusCode]:
        """Pixel of a point in ECEF m and the camera's status; `invalid_input`, NaN, for what is not finite.

        Through the `air`, if given, by which the point seems to lie higher than it is.
        """
        valid, sensor, shot, p_ecef = made_safe(self, shot, p_ecef)
        if air is not None:
            p_ecef = apparent_point(sensor.perspective_centre(shot), p_ecef, air)
        uv, status = sensor.camera.project(sensor.to_camera(shot, p_ecef))
        return jnp.where(valid, uv, jnp.nan), status_where(~valid, Status.invalid_input, status)

    def looking_at(
        self,
        pose: Pose,
        point: Geodetic,
        *,
        uv: Numbers | None = None,
        readings: Numbers | None = None,
        time: ArrayLike = 0.0,
        atmosphere: Atmosphere | None = None,
    ) -> Shot:
        """Shot whose gimbal readings put the optical axis on `point`, from `pose`; or pixel `uv`, or a sweep's middle.

        Lever arms, boresight, gains, distortion and, if given, the air are allowed for. `readings` are where the search
        starts, and what axes are held at that are not needed: of more than two, those that there move the line of sight
        least (the roll of a drone's gimbal); by default axis angles of zero, or the nearest within the limits.
        Raises `ValueError` if the gimbal cannot reach the point within its limits, in words and degrees; where the
        input is traced, the readings are NaN instead.
        """
        from jaxgeo.sensor.pointing import readings_towards  # it needs this class

        return Shot(pose, readings_towards(self, pose, point, uv, readings, atmosphere), time)

    def steered(
        self,
        trajectory: Trajectory,
        points: Geodetic,
        *,
        uv: Numbers | None = None,
        readings: Numbers | None = None,
        atmosphere: Atmosphere | None = None,
    ) -> Trajectory:
        """The trajectory with the gimbal readings that keep the optical axis (or `uv`) on `points` while it is flown.

        `points` hold one position for each knot, the way of a scan over the ground, or a single one to stare at.
        `readings` are where the search for the first knot starts; each of the others starts from the one before, so
        that axes do not jump. Raises `ValueError` as `looking_at`, naming the knot.
        """
        from jaxgeo.sensor.pointing import steered  # it needs this class

        return steered(self, trajectory, points, uv, readings, atmosphere)


def made_safe(sensor: Sensor, motion: T, vector: Any) -> tuple[Flag, Sensor, T, Any]:
    """Whether everything that makes a ray is finite, and the same in float64 with ones for what is not.

    `motion` is a shot, or what else says where the sensor is; `vector` a pixel or a point.
    """
    sensor, motion, vector = as_float64((sensor, motion, vector), "(sensor, shot, uv or point)")
    gimbal = sensor.gimbal
    valid = all_finite((sensor.camera, gimbal.sign, gimbal.gain, gimbal.offset, sensor.mount, motion, vector))
    return valid, *finite_or((sensor, motion, vector), 1.0)
