"""Image error sources: measured pixel, interior orientation, lens distortion."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxgeo.sensor import AbstractCamera, FrameCamera
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import AbstractSharing, PerFlight, PerMeasurement
from jaxgeo.uncertainty.sources.base import AbstractSource, Axis, Correlation, Error, Sigma, stated


class PixelMeasurement(AbstractSource):
    """Errors of the measured pixel, px along columns and rows."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerMeasurement()
    names: ClassVar = ("column", "row")
    unit: ClassVar = "px"

    @classmethod
    def from_pixels(cls, *, column: Axis, row: Axis, **options: Any) -> PixelMeasurement:
        """From standard deviations in px."""
        return cls(**stated((column, row), options))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        if inputs.uv is None:  # of an exposure as a whole no pixel is measured
            return inputs
        return eqx.tree_at(lambda inputs: inputs.uv, inputs, inputs.uv + error)


class InteriorOrientation(AbstractSource):
    """Errors of the focal length (one scale factor for both axes) and the principal point (column, row), px."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerFlight()
    names: ClassVar = ("focal length", "principal column", "principal row")
    unit: ClassVar = "px"

    @classmethod
    def from_pixels(
        cls, *, focal: Axis, principal_column: Axis, principal_row: Axis, **options: Any
    ) -> InteriorOrientation:
        """From standard deviations in px."""
        return cls(**stated((focal, principal_column, principal_row), options))

    def check(self, inputs: ModelInputs) -> None:
        optics_of(inputs.sensor.camera)

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        optics = optics_of(inputs.sensor.camera)
        focal = jnp.asarray(optics.focal_px)
        after = (focal * (1.0 + error[0] / focal[0]), jnp.asarray(optics.principal_px) + error[1:])

        def where(inputs: ModelInputs) -> tuple[Any, Any]:
            optics = optics_of(inputs.sensor.camera)
            return optics.focal_px, optics.principal_px

        return eqx.tree_at(where, inputs, after)


class Distortion(AbstractSource):
    """Errors of named lens distortion coefficients, dimensionless."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerFlight()
    coefficients: tuple[str, ...] = eqx.field(static=True, default=("k1",))
    unit: ClassVar = "1"

    @classmethod
    def from_coefficients(
        cls, *, sharing: AbstractSharing | None = None, distribution: Any = None, **coefficients: Axis
    ) -> Distortion:
        """From the standard deviation of each named coefficient: `k1=1e-4, k2=1e-4`."""
        options = {} if sharing is None else {"sharing": sharing}
        arguments = stated(tuple(coefficients.values()), {**options, "distribution": distribution})
        return cls(coefficients=tuple(coefficients), **arguments)

    @property
    def axes(self) -> tuple[str, ...]:
        return self.coefficients

    def check(self, inputs: ModelInputs) -> None:
        distortion = optics_of(inputs.sensor.camera).distortion
        missing = [name for name in self.coefficients if name not in distortion.names]
        if missing:
            raise ValueError(
                f"The camera's {type(distortion).__name__} has no coefficient {', '.join(missing)}; give the camera a "
                "BrownConrady lens, of zeros if need be."
            )

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        lens = optics_of(inputs.sensor.camera).distortion
        by_name = dict(zip(self.coefficients, error, strict=True))
        change = jnp.stack([by_name.get(name, jnp.zeros(())) for name in lens.names])
        changed = lens.with_coefficients(lens.coefficients() + change)
        return eqx.tree_at(lambda inputs: optics_of(inputs.sensor.camera).distortion, inputs, changed)


def optics_of(camera: AbstractCamera) -> FrameCamera:
    """Frame camera that holds the lens and detector of a camera: itself, or its `optics` or `frame`.

    Raises `ValueError` if it has none.
    """
    for part in (camera, getattr(camera, "optics", None), getattr(camera, "frame", None)):
        if isinstance(part, FrameCamera):
            return part
    raise ValueError(f"A {type(camera).__name__} has no focal length and principal point; leave this source out.")
