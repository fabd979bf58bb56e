"""Platform error sources: attitude, position, velocity, time, boresight, camera mounting, lever arm."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgeo._numerics import matmul3, matvec
from jaxgeo._typing import ScalarField, Vector3, Vector3Field
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.rotations import R_from_heading_pitch_roll, R_from_rotation_vector, heading_pitch_roll_from_R
from jaxgeo.sensor import Pose, Shot
from jaxgeo.sensor.gimbal import Numbers
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import AbstractSharing, PerFlight, PerImage
from jaxgeo.uncertainty.sources.base import AbstractSource, Axis, Correlation, Error, Sigma, stated


class Attitude(AbstractSource):
    """Errors of the measured heading, pitch and roll, rad."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerImage()
    names: ClassVar = ("heading", "pitch", "roll")
    unit: ClassVar = "rad"

    @classmethod
    def from_degrees(cls, *, heading: Axis, pitch: Axis, roll: Axis, **options: Any) -> Attitude:
        """From standard deviations in deg."""
        return cls(**stated((heading, pitch, roll), options, degrees=True))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        pose = inputs.pose
        heading, pitch, roll = error
        heading, pitch, roll = pose.heading + heading, pose.pitch + pitch, pose.roll + roll
        return inputs.with_pose(Pose(pose.position, heading, pitch, roll, pose.deflection))


class Position(AbstractSource):
    """Errors of the measured position, m: along local north, east, down, or along the ECEF axes (`frame`)."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerImage()
    frame: Literal["ned", "ecef"] = eqx.field(static=True, default="ned")
    names: ClassVar = ("north", "east", "down")
    unit: ClassVar = "m"

    @classmethod
    def from_ned(cls, *, north: Axis, east: Axis, down: Axis, **options: Any) -> Position:
        """From standard deviations in m."""
        return cls(**stated((north, east, down), options))

    @property
    def axes(self) -> tuple[str, ...]:
        return self.names if self.frame == "ned" else ("x", "y", "z")

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        def shifted(position: Geodetic) -> Geodetic:
            shift = matvec(R_ecef_from_ned(position), error) if self.frame == "ned" else error
            return WGS84.to_geodetic(WGS84.to_ecef(position) + shift)

        pose = inputs.pose
        move = shifted if isinstance(inputs.motion, Shot) else jax.vmap(shifted)
        return inputs.with_pose(Pose(move(pose.position), pose.heading, pose.pitch, pose.roll, pose.deflection))


class Velocity(AbstractSource):
    """Errors of the measured velocity, m/s north, east, down; the position is extrapolated over `latency` s."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerImage()
    latency: ScalarField = 0.005
    names: ClassVar = ("north", "east", "down")
    unit: ClassVar = "m/s"

    @classmethod
    def from_ned(cls, *, north: Axis, east: Axis, down: Axis, **options: Any) -> Velocity:
        """From standard deviations in m/s."""
        return cls(**stated((north, east, down), options))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        return Position(self.sigma).moved(inputs, error * self.latency)


class TimeTag(AbstractSource):
    """Error of the image time relative to the navigation clock, s.

    On a trajectory it shifts the time. For a single shot give its motion: `velocity_ned` in m/s over the ground and, if
    relevant, `body_rates` about forward, right and down and `gimbal_rates`, rad/s.
    """

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerImage()
    velocity_ned: Vector3Field | None = None
    body_rates: Vector3Field | None = None
    gimbal_rates: Any = None
    names: ClassVar = ("time",)
    unit: ClassVar = "s"

    @classmethod
    def from_seconds(
        cls,
        time: Axis,
        *,
        velocity_ned: Numbers | None = None,
        body_rates: Numbers | None = None,
        gimbal_rates: Numbers | None = None,
        **options: Any,
    ) -> TimeTag:
        """From a standard deviation in s, and the motion of a single shot."""
        rates = (velocity_ned, body_rates, gimbal_rates)
        velocity, turning, moving = (None if rate is None else jnp.asarray(rate, float) for rate in rates)
        return cls(**stated((time,), options), velocity_ned=velocity, body_rates=turning, gimbal_rates=moving)

    def check(self, inputs: ModelInputs) -> None:
        if isinstance(inputs.motion, Shot) and self.velocity_ned is None:
            raise ValueError(
                "A TimeTag needs to know how a single shot moves: give it velocity_ned in m/s (and body_rates, "
                "gimbal_rates in rad/s), or a Trajectory in place of the shot."
            )

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        later = error[0]
        if not isinstance(inputs.motion, Shot):
            return eqx.tree_at(lambda inputs: inputs.time, inputs, inputs.time + later)
        shot, pose = inputs.motion, inputs.motion.pose
        velocity: Vector3 = jnp.zeros(3) if self.velocity_ned is None else jnp.asarray(self.velocity_ned)
        way = matvec(R_ecef_from_ned(pose.position), later * velocity)
        position = WGS84.to_geodetic(WGS84.to_ecef(pose.position) + way)
        pose = Pose(position, pose.heading, pose.pitch, pose.roll, pose.deflection)
        if self.body_rates is not None:
            R_level_from_body = R_from_heading_pitch_roll(*map(jnp.asarray, (pose.heading, pose.pitch, pose.roll)))
            R = matmul3(R_level_from_body, R_from_rotation_vector(later * jnp.asarray(self.body_rates)))
            pose = Pose(position, *heading_pitch_roll_from_R(R), pose.deflection)
        readings = jnp.asarray(shot.gimbal_readings)
        if self.gimbal_rates is not None:
            readings = readings + later * jnp.asarray(self.gimbal_rates)
        return eqx.tree_at(lambda inputs: inputs.motion, inputs, Shot(pose, readings, shot.time))


class Boresight(AbstractSource):
    """Misalignment between navigation system and gimbal base, rad: rotates `R_body_from_base` by
    Rz(heading) Ry(pitch) Rx(roll) in body axes. Li et al. (2023) call it the INS calibration.
    """

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerFlight()
    names: ClassVar = ("heading", "pitch", "roll")
    unit: ClassVar = "rad"

    @classmethod
    def from_degrees(cls, *, heading: Axis, pitch: Axis, roll: Axis, **options: Any) -> Boresight:
        """From standard deviations in deg."""
        return cls(**stated((heading, pitch, roll), options, degrees=True))

    def check(self, inputs: ModelInputs) -> None:
        if inputs.sensor.gimbal.reference == "level":
            raise ValueError(
                "A gimbal that reports in local level has no boresight against the body: its angles are against the "
                "horizon. Use CameraMounting for the camera in the head, or GimbalMounting for the axes."
            )

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        turn = R_from_heading_pitch_roll(*error)
        R = matmul3(turn, jnp.asarray(inputs.sensor.mount.R_body_from_base))
        return eqx.tree_at(lambda inputs: inputs.sensor.mount.R_body_from_base, inputs, R)


class CameraMounting(AbstractSource):
    """Misalignment of the camera in the gimbal head, rad: a small rotation about the head axes forward, right, down."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerFlight()
    names: ClassVar = ("forward", "right", "down")
    unit: ClassVar = "rad"

    @classmethod
    def from_degrees(cls, *, forward: Axis, right: Axis, down: Axis, **options: Any) -> CameraMounting:
        """From standard deviations in deg."""
        return cls(**stated((forward, right, down), options, degrees=True))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        R = matmul3(R_from_rotation_vector(error), jnp.asarray(inputs.sensor.mount.R_head_from_camera))
        return eqx.tree_at(lambda inputs: inputs.sensor.mount.R_head_from_camera, inputs, R)


class LeverArm(AbstractSource):
    """Errors of the lever arm from the IMU to the gimbal centre, m in body axes forward, right, down."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerFlight()
    names: ClassVar = ("forward", "right", "down")
    unit: ClassVar = "m"

    @classmethod
    def from_metres(cls, *, forward: Axis, right: Axis, down: Axis, **options: Any) -> LeverArm:
        """From standard deviations in m."""
        return cls(**stated((forward, right, down), options))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        lever = jnp.asarray(inputs.sensor.mount.lever_body) + error
        return eqx.tree_at(lambda inputs: inputs.sensor.mount.lever_body, inputs, lever)
