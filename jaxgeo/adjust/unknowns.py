"""Unknowns of an adjustment and their priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np


@dataclass(frozen=True)
class Free:
    """Unknown without a prior."""


@dataclass(frozen=True)
class Fixed:
    """Known: the value is kept."""


@dataclass(frozen=True)
class Prior:
    """Unknown with a prior `sigma`: one standard deviation, or one per component.

    Raises `ValueError` for one that is not positive and finite.
    """

    sigma: Any

    def __post_init__(self) -> None:
        sigma = np.asarray(self.sigma, np.float64)
        if not np.all(np.isfinite(sigma) & (sigma > 0.0)):
            raise ValueError(
                f"the standard deviation of a prior must be positive and finite; got {sigma.tolist()!r}: what is known "
                f"exactly is Fixed(), what is not known at all Free()."
            )


Choice: TypeAlias = Free | Fixed | Prior
Choices: TypeAlias = Choice | Mapping[str, Choice]  # one for all, or by name; those not named are fixed


@dataclass(frozen=True)
class Unknowns:
    """Unknowns of an adjustment; all except orientations and points are fixed by default.

    Each is `Free()`, `Fixed()` or `Prior(sigma)`, or a mapping from the names of cameras, mounts or strips to these.

    - `images`: exterior orientations; a mapping by image names, with free orientations for names left out. `Fixed()`
      for all gives a pure ray intersection. Use the block's navigation for priors.
    - `focal` (px), `aspect` (rows over columns, 1) and `principal` (px, column and row) of each camera, `distortion`:
      coefficients of its lens; a choice for all, or a mapping from their names.
    - `boresight` (rad, about the axes of the body, or of the head for a gimbal that reports in local level) and `lever`
      (m, IMU to gimbal, body axes) of each mount.
    - `shift` (m) and `drift` (m/s) of the navigation positions in each strip, east, north and up of the frame.
    - `time_offset` (s) of the navigation in each strip: its positions and attitudes are those of so long after the
      exposures. Needs velocities and turn rates (`Navigation`).
    - `readout` (s) of each camera, from the first row of an image to that of the next, as of
      `RollingShutterCamera.from_readout`: negative from the bottom up. Needs velocities and turn rates, too.
    - `refraction` (1) of each camera: factor on the bending of rays in the block's `atmosphere`, 1 as the model says.
    """

    images: Choices = field(default_factory=Free)
    focal: Choices = field(default_factory=Fixed)
    aspect: Choices = field(default_factory=Fixed)
    principal: Choices = field(default_factory=Fixed)
    distortion: Choices = field(default_factory=Fixed)
    boresight: Choices = field(default_factory=Fixed)
    lever: Choices = field(default_factory=Fixed)
    shift: Choices = field(default_factory=Fixed)
    drift: Choices = field(default_factory=Fixed)
    time_offset: Choices = field(default_factory=Fixed)
    readout: Choices = field(default_factory=Fixed)
    refraction: Choices = field(default_factory=Fixed)


def spread(choices: Choices, names: Sequence[str], size: int, what: str, others: Choice | None = None) -> np.ndarray:
    """Prior standard deviations (names, size): 0 if fixed, infinite if free.

    Raises `ValueError` for an unknown name and a prior of another size; `TypeError` for an invalid choice.
    """
    if not isinstance(choices, Mapping):
        choices = dict.fromkeys(names, choices)
    unknown = [name for name in choices if name not in set(names)]
    if unknown:
        raise ValueError(f"Unknowns.{what}: there is no {unknown[0]!r}; known are {', '.join(names) or 'none'}.")
    rows = [_sigma(choices.get(name, others or Fixed()), size, what) for name in names]
    return np.reshape(rows, (len(names), size))


def _sigma(choice: Any, size: int, what: str) -> np.ndarray:
    if isinstance(choice, Fixed):
        return np.zeros(size)
    if isinstance(choice, Free):
        return np.full(size, np.inf)
    if not isinstance(choice, Prior):
        raise TypeError(f"Unknowns.{what} must be Free(), Fixed() or Prior(sigma); got {choice!r}.")
    sigma = np.asarray(choice.sigma, np.float64)
    if sigma.shape not in ((), (size,)):
        raise ValueError(f"Unknowns.{what}: a prior takes 1 or {size} standard deviations; got shape {sigma.shape}.")
    return np.broadcast_to(sigma, (size,))
