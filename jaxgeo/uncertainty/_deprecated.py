"""Functions whose work `accuracy` does now: each warns and gives an `Accuracy`, for one release."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxgeo._checks import given_array
from jaxgeo._renamed import warn_renamed
from jaxgeo.observation import Observation
from jaxgeo.uncertainty._accuracy import accuracy
from jaxgeo.uncertainty.accuracy_record import Accuracy
from jaxgeo.uncertainty.sampling import Sampling

HERE = "jaxgeo.uncertainty"


def assess(*given: Any, **options: Any) -> Accuracy:
    """Deprecated: `accuracy(..., sampling=None)`."""
    warn_renamed(f"{HERE}.assess", f"{HERE}.accuracy(..., sampling=None)")
    return accuracy(*given, sampling=None, **options)


def accuracy_of_pixels(*given: Any, **options: Any) -> Accuracy:
    """Deprecated: `accuracy` of pixels (..., 2)."""
    warn_renamed(f"{HERE}.accuracy_of_pixels", f"{HERE}.accuracy of pixels uv (..., 2)")
    if isinstance(given[0], Observation):
        observation, *rest = given
        given = (dataclasses.replace(observation, uv=np.asarray(observation.uv)[None]), *rest)
    else:
        sensor, shot, uv, *rest = given
        given = (sensor, shot, np.asarray(given_array(uv, "uv", "the pixels (column, row)"))[None], *rest)
    return accuracy(*given, **_with_sampling(options))[0]


def accuracy_of_each(*given: Any, in_axes: Sequence[int | None] = (None, 0, 0, None, None), **options: Any) -> Accuracy:
    """Deprecated: `accuracy(..., in_axes=...)`."""
    warn_renamed(f"{HERE}.accuracy_of_each", f"{HERE}.accuracy(..., in_axes={tuple(in_axes)})")
    return accuracy(*given, in_axes=in_axes, **_with_sampling(options))


def _with_sampling(options: dict[str, Any]) -> dict[str, Any]:
    """Keywords with the separate options of a sampling within `sampling`."""
    names = {one.name for one in dataclasses.fields(Sampling)}
    given = {name: value for name, value in options.items() if name in names}
    rest = {name: value for name, value in options.items() if name not in names}
    return rest | ({"sampling": Sampling(**given)} if given else {})
