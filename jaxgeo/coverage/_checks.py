"""Input checks of the overlap formulas."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from jaxgeo._checks import as_array, as_float64, check_finite, concrete
from jaxgeo._typing import Numbers


class SeesNoGround(ValueError):
    """An image, or the part of it that a result needs, sees no ground."""


def checked_off_nadir(off_nadir: Any) -> Numbers:
    """An angle off nadir in rad; raises `ValueError` unless a known one is in [0, pi/2)."""
    return _checked(
        off_nadir,
        "off_nadir",
        "rad",
        lambda known: (known >= 0.0) & (known < 0.5 * math.pi),
        "must lie in [0, pi/2) rad, 0 straight down: at pi/2 a line of sight no longer meets level ground",
    )


def checked_field_of_view(field_of_view: Any) -> Numbers:
    """A full field of view in rad; raises `ValueError` unless a known one is in (0, pi)."""
    return _checked(
        field_of_view,
        "field_of_view",
        "rad",
        lambda known: (known > 0.0) & (known < math.pi),
        "must lie between 0 and pi rad, both left out: without a field a frame covers no ground",
    )


def checked_overlap(overlap: Any, name: str = "overlap") -> Numbers:
    """A target overlap, a share of a frame's length; raises `ValueError` unless a known one is in [0, 1)."""
    return _checked(
        overlap,
        name,
        "shares of a frame's length",
        lambda known: (known >= 0.0) & (known < 1.0),
        "must lie in [0, 1), a share of a frame's length (0.15 for 15 %): at 1 the camera would not move on",
    )


def checked_positive(value: Any, name: str, unit: str) -> Numbers:
    """A finite number; raises `ValueError` unless a known one is positive."""
    return _checked(value, name, unit, lambda known: known > 0.0, f"must be above 0 {unit}")


def checked_finite(value: Any, name: str, unit: str) -> Numbers:
    """Any finite number; raises `ValueError` for a known one that is not finite."""
    value = as_array(value, name)
    check_finite(value, name, unit)
    return as_float64(value, name)


def _checked(value: Any, name: str, unit: str, holds: Callable[[Any], Any], must: str) -> Any:
    given = checked_finite(value, name, unit)
    known = concrete(as_array(value, name))
    if known is not None and not holds(known).all():
        raise ValueError(f"{name} {must}; got {known.tolist()!r}.")
    return given
