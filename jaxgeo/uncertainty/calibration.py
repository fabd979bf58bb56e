"""Result of a calibration of an error model, and what it means in words."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import scipy  # submodules load lazily, when first used

from jaxgeo.uncertainty._figures import figure
from jaxgeo.uncertainty.model import ErrorModel

MUCH = 3.0  # times the stated sigmas: if even the lower limit of a factor is above it, something else may be wrong


@dataclasses.dataclass(frozen=True)
class Component:
    """One source, or axis of it: `scale` times its `stated` sigmas (axes,) in `unit`, from `least` to `most`.

    `standard_error` is that of the logarithm of the scale; NaN for one that is zero or `held`, which says why.
    """

    label: str
    axes: tuple[str, ...]
    unit: str
    stated: np.ndarray
    scale: float
    least: float
    most: float
    standard_error: float
    held: str | None

    @property
    def sigma(self) -> np.ndarray:
        """Calibrated standard deviations (axes,), in `unit`."""
        return self.scale * self.stated

    @property
    def freedom(self) -> float:
        """Degrees of freedom that the errors give the scale, 1 / (2 standard_error^2)."""
        return 0.5 / self.standard_error**2

    @property
    def is_doubtful(self) -> bool:
        """Whether the errors are so much larger than stated that another cause is likelier than a wrong sigma."""
        return self.held is None and self.least > MUCH

    @property
    def words(self) -> str:
        """The component in a line."""
        if self.held is not None:
            return f"{self.label}: as stated, {_sigmas(self.stated, self.unit)} ({self.held})"
        limits = f"{figure(self.least)} to {_number(self.most)} times"
        more = " (at zero: the errors do not call for it)" if self.scale == 0.0 else ""
        times = f"{figure(self.scale)} times the stated sigmas ({limits})"
        return f"{self.label}: {times}: {_sigmas(self.sigma, self.unit)}{more}"


@dataclasses.dataclass(frozen=True)
class FixedEffect:
    """An effect common to all errors, removed before calibrating: its estimate and standard deviation in `unit`.

    NaN if the points cannot tell it from the other fixed effects.
    """

    label: str
    unit: str
    value: float
    sigma: float

    @property
    def words(self) -> str:
        """The effect in a few words."""
        if math.isnan(self.value):
            return f"{self.label} not determined beside the others"
        return f"{self.label} {figure(self.value, 3, '+')} ± {figure(self.sigma, 2)} {self.unit}"


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Calibrated error model and its components; `str` says what they mean.

    - `errors`: the error model with calibrated sigmas.
    - `components`, `fixed_effects`: see `calibrate_errors`.
    - `not_separable`: labels of components that the points cannot tell apart, or a single one that they do not
      determine.
    - `contrasts`: number of independent errors left by the fixed effects; `pixels` are those with a fix.
    - `gain`: twice the gain in log likelihood over the stated sigmas.
    - `without_fix`: points that have no fix and are left out, with their statuses.
    """

    components: tuple[Component, ...]
    fixed_effects: tuple[FixedEffect, ...]
    not_separable: tuple[tuple[str, ...], ...]
    errors: ErrorModel
    confidence: float
    contrasts: int
    gain: float
    pixels: int
    note: str | None = None
    without_fix: tuple[str, ...] = ()

    @property
    def p(self) -> float:
        """p-value of the stated sigmas by the likelihood ratio."""
        count = sum(one.held is None for one in self.components)
        return float(scipy.stats.chi2.sf(max(self.gain, 0.0), count))

    @property
    def words(self) -> str:
        """What was found, in a few lines."""
        percent = f"{100.0 * self.confidence:g} %"
        lines = [f"Sigmas from {self.pixels} pixels ({self.contrasts} independent errors), with {percent} intervals:"]
        lines += [f"  {one.words}" for one in self.components]
        lines += [_apart(group) for group in self.not_separable]
        doubtful = [one.label for one in self.components if one.is_doubtful]
        if doubtful:
            lines.append(
                f"Doubtful: {' and '.join(doubtful)}, more than {MUCH:g} times as large as stated. Sigmas are "
                "seldom so wrong. Look first for a wrong datum of the heights, a wrong unit, wrong points, and for "
                "errors that neighbouring points share, such as those of an elevation model: their correlation has to "
                "be stated."
            )
        if self.fixed_effects:
            effects = "; ".join(one.words for one in self.fixed_effects)
            lines.append(f"Removed before, as effects common to all: {effects}.")
        p = "p < 0.0001" if self.p < 1e-4 else f"p = {self.p:.2g}"
        verdict = "does not fit" if self.p < 0.05 else "fits"
        lines.append(f"The stated model {verdict} beside the calibrated one (likelihood ratio, {p}).")
        if self.without_fix:
            lines.append(f"Left out, without a fix: {', '.join(self.without_fix)}.")
        return "\n".join(lines if self.note is None else [*lines, self.note])

    def __str__(self) -> str:
        return self.words

    def to_dict(self) -> dict[str, Any]:
        """Figures as plain Python values."""
        components = [
            {
                "label": one.label,
                "axes": list(one.axes),
                "unit": one.unit,
                "stated": one.stated.tolist(),
                "sigma": one.sigma.tolist(),
                "scale": one.scale,
                "least": one.least,
                "most": one.most if math.isfinite(one.most) else None,
                "standard_error": None if math.isnan(one.standard_error) else one.standard_error,
                "held": one.held,
                "doubtful": one.is_doubtful,
            }
            for one in self.components
        ]
        effects = [
            {"label": one.label, "unit": one.unit}
            | {name: None if math.isnan(x) else x for name, x in (("value", one.value), ("sigma", one.sigma))}
            for one in self.fixed_effects
        ]
        return {
            "words": self.words,
            "components": components,
            "fixed_effects": effects,
            "not_separable": [list(group) for group in self.not_separable],
            "confidence": self.confidence,
            "contrasts": self.contrasts,
            "gain": self.gain,
            "p": self.p,
            "pixels": self.pixels,
            "without_fix": list(self.without_fix),
        }


def _apart(group: tuple[str, ...]) -> str:
    if len(group) == 1:
        return f"{group[0]}: these points do not determine it; give more images or flights."
    return (
        f"{group[0]} is not separable from {' and '.join(group[1:])} with these points; fly more flights, other "
        "headings, or hold one of them as stated."
    )


def _sigmas(sigma: np.ndarray, unit: str) -> str:
    if unit == "rad":
        return f"{', '.join(map(figure, np.rad2deg(sigma)))} deg"
    return f"{', '.join(map(figure, sigma))} {unit}"


def _number(value: float) -> str:
    return figure(value) if math.isfinite(value) else "any"
