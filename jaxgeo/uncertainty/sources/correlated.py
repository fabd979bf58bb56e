"""Correlated error sources combined into one block."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import AbstractSharing
from jaxgeo.uncertainty.sources.base import AbstractSource, Correlation, Error, Sigma


class Correlated(AbstractSource):
    """Sources as one block, with a correlation matrix over all their axes in order, and one sharing.

    Example: position and attitude from one Kalman filter. Construct with `Correlated.of`.
    """

    parts: tuple[AbstractSource, ...]
    sigma: Sigma
    correlation: Correlation
    sharing: AbstractSharing
    unit: ClassVar = "mixed"

    @classmethod
    def of(cls, *parts: AbstractSource, correlation: Correlation, sharing: AbstractSharing) -> Correlated:
        """From sources, whose standard deviations and distributions are kept, and the correlation (axes, axes) of all
        their axes.

        Raises `ValueError` for a `TerrainField`.
        """
        for part in parts:
            if len(part.sigma_axes) != len(part.axes):
                raise ValueError(f"{part.label} has its own correlation over the ground; it can be no part of a block.")
        sigma = jnp.concatenate([jnp.asarray(part.sigma) for part in parts])
        shapes = None if all(part.is_normal for part in parts) else tuple(s for part in parts for s in part.shapes)
        correlation = jnp.asarray(correlation, float)
        return cls(parts=parts, sigma=sigma, correlation=correlation, sharing=sharing, distribution=shapes)

    @property
    def label(self) -> str:
        return " and ".join(part.label for part in self.parts)

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(f"{part.label}: {axis}" for part in self.parts for axis in part.axes)

    def check(self, inputs: ModelInputs) -> None:
        for part in self.parts:
            part.check(inputs)

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        first = 0
        for part in self.parts:
            inputs = part.moved(inputs, error[first : first + len(part.axes)])
            first += len(part.axes)
        return inputs
