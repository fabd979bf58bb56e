"""Atmospheric error source: temperature and pressure used for refraction."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx

from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import AbstractSharing, PerFlight
from jaxgeo.uncertainty.sources.base import AbstractSource, Axis, Correlation, Error, Sigma, stated


class Refraction(AbstractSource):
    """Errors of the air temperature, K at every height, and of the sea-level pressure, Pa."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = PerFlight()
    names: ClassVar = ("temperature", "pressure")
    unit: ClassVar = "K and Pa"

    @classmethod
    def from_kelvin_and_pascal(cls, *, temperature: Axis, pressure: Axis, **options: Any) -> Refraction:
        """From standard deviations in K and Pa."""
        return cls(**stated((temperature, pressure), options))

    def check(self, inputs: ModelInputs) -> None:
        if inputs.air is None:
            raise ValueError(
                "A Refraction source needs the air whose temperature and pressure err: pass atmosphere=Atmosphere()."
            )

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        air = inputs.air
        assert air is not None
        after = (air.temperature_offset + error[0], air.sea_level_pressure + error[1])
        return eqx.tree_at(lambda inputs: (inputs.air.temperature_offset, inputs.air.sea_level_pressure), inputs, after)
