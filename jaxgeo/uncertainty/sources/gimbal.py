"""Gimbal error sources: axis readings and axis mounting."""

from __future__ import annotations

from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxgeo._numerics import matmul3
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import Gimbal
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import AbstractSharing, PerFlight, PerImage
from jaxgeo.uncertainty.sources.base import AbstractSource, Axis, Correlation, Error, Sigma, stated

YAW_PITCH_ROLL = ("z", "y", "x")
AxesT = TypeVar("AxesT", bound="_OfGimbalAxes")


class _OfGimbalAxes(AbstractSource):
    """Base class of sources with one error axis per gimbal axis."""

    sigma: eqx.AbstractVar[Sigma]
    correlation: eqx.AbstractVar[Correlation]
    sharing: eqx.AbstractVar[AbstractSharing]
    gimbal_axes: eqx.AbstractVar[tuple[str, ...]]
    unit: ClassVar = "rad"

    @classmethod
    def from_degrees(
        cls: type[AxesT], *, sharing: AbstractSharing | None = None, distribution: Any = None, **axes: Axis
    ) -> AxesT:
        """From standard deviations in deg, by gimbal axis name: `outer=0.02, inner=0.02`."""
        options = {} if sharing is None else {"sharing": sharing}
        arguments = stated(tuple(axes.values()), {**options, "distribution": distribution}, degrees=True)
        return cls(gimbal_axes=tuple(axes), **arguments)  # pyright: ignore[reportCallIssue]

    @classmethod
    def of(cls: type[AxesT], gimbal: Gimbal, sigma: ArrayLike, **options: Any) -> AxesT:
        """From one standard deviation in rad for all axes of a gimbal, or one for each."""
        values = jnp.broadcast_to(jnp.asarray(sigma, float), (len(gimbal.names),))
        return cls(values, gimbal_axes=gimbal.names, **options)  # pyright: ignore[reportCallIssue]

    @property
    def axes(self) -> tuple[str, ...]:
        return self.gimbal_axes

    def check(self, inputs: ModelInputs) -> None:
        names = inputs.sensor.gimbal.names
        if tuple(self.gimbal_axes) != tuple(names):
            raise ValueError(
                f"{type(self).__name__} is for the axes {', '.join(self.gimbal_axes) or 'none'}, but this gimbal has "
                f"{', '.join(names) or 'none'}."
            )


class GimbalAngles(_OfGimbalAxes):
    """Errors of the gimbal readings, rad, in the order of its axes.

    Of a gimbal relative to level with the axes yaw, pitch, roll, as of drones, the error of the roll is that of the
    level: a tilt about the horizontal direction of the yaw. Straight down, roll and yaw turn about the same vertical,
    and an error of the roll reading would tilt nothing. (Of a `Trajectory` it is that of the reading.)
    """

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerImage()
    gimbal_axes: tuple[str, ...] = eqx.field(static=True, default=("outer", "inner"))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        readings = jnp.asarray(inputs.motion.gimbal_readings)
        gimbal = inputs.sensor.gimbal
        if readings.ndim == 1 and gimbal.reference == "level" and gimbal.axes == YAW_PITCH_ROLL:
            inputs = _tilted(inputs, readings, error[2])
            error = error.at[2].set(0.0)
        readings = readings + (error if readings.ndim == 1 else error[None, :])
        return eqx.tree_at(lambda inputs: inputs.motion.gimbal_readings, inputs, readings)


def _tilted(inputs: ModelInputs, readings: Any, tilt: Any) -> ModelInputs:
    """Inputs with the level tilted by an angle in rad about the horizontal direction of the yaw.

    Applied as a turn of the camera in the head, without the singularity of the angles straight down.
    """
    angles = inputs.sensor.gimbal.angles(readings)
    ahead_head = inputs.sensor.gimbal.R_base_from_head(readings).T @ jnp.stack(
        [jnp.cos(angles[0]), jnp.sin(angles[0]), jnp.zeros(())]
    )
    R = matmul3(R_from_rotation_vector(tilt * ahead_head), jnp.asarray(inputs.sensor.mount.R_head_from_camera))
    return eqx.tree_at(lambda inputs: inputs.sensor.mount.R_head_from_camera, inputs, R)


class GimbalMounting(_OfGimbalAxes):
    """Mounting errors of the gimbal axes, rad of axis angle; they add to the angles (Li et al. 2023)."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerFlight()
    gimbal_axes: tuple[str, ...] = eqx.field(static=True, default=("outer", "inner"))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        gimbal = inputs.sensor.gimbal
        offset = jnp.asarray(gimbal.offset) - error / (jnp.asarray(gimbal.sign) * jnp.asarray(gimbal.gain))
        return eqx.tree_at(lambda inputs: inputs.sensor.gimbal.offset, inputs, offset)
