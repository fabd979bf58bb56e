"""What is unknown in an adjustment, what is known beforehand, and how well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np


@dataclass(frozen=True)
class Free:
    """Unknown, and nothing is known of it beforehand."""


@dataclass(frozen=True)
class Fixed:
    """Known: it keeps its value."""


@dataclass(frozen=True)
class Prior:
    """Unknown, but known beforehand to `sigma`: a standard deviation, or one for each of the numbers meant.

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
    """What an adjustment finds; everything but orientations and points is known unless said otherwise.

    Each is `Free()`, `Fixed()` or `Prior(sigma)`, or a mapping from the names of cameras, mounts or strips to these.

    - `images`: exterior orientations; a mapping goes by the images' names, and those that it leaves out are free.
      `Fixed()` for all is the intersection of rays alone. A prior is what the block's navigation is for.
    - `focal` (px), `aspect` (rows over columns, 1) and `principal` (px, column and row) of each camera, `distortion`:
      coefficients of its lens; a choice for all, or a mapping from their names.
    - `boresight` (rad, about the axes of the body, or of the head for a gimbal that reports in local level) and `lever`
      (m, IMU to gimbal, body axes) of each mount.
    - `shift` (m) and `drift` (m/s) of the navigation's positions in each strip, east, north and up of the frame.
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


def spread(choices: Choices, names: Sequence[str], size: int, what: str, others: Choice | None = None) -> np.ndarray:
    """Standard deviations (names, size) of what is known beforehand: 0 where fixed, infinite where free.

    Raises `ValueError` for a name that there is not, and a prior of another size; `TypeError` for no choice at all.
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
