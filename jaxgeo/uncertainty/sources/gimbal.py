"""Gimbal error sources: axis readings and axis mounting."""

from __future__ import annotations

from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxgeo.sensor import Gimbal
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import AbstractSharing, PerFlight, PerImage
from jaxgeo.uncertainty.sources.base import AbstractSource, Axis, Correlation, Error, Sigma, stated

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
    """Errors of the gimbal readings, rad, in the order of its axes."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerImage()
    gimbal_axes: tuple[str, ...] = eqx.field(static=True, default=("outer", "inner"))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        readings = jnp.asarray(inputs.motion.gimbal_readings)
        readings = readings + (error if readings.ndim == 1 else error[None, :])
        return eqx.tree_at(lambda inputs: inputs.motion.gimbal_readings, inputs, readings)


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
