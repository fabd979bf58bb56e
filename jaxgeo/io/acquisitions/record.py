"""Exposures read from a file: sensor, shots, errors, and the assumptions of its reader."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.earth import Geodetic
from jaxgeo.io.errors import TableError
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.uncertainty.sources import AbstractSource


class UnstatedDatum(TableError):
    """The datum of a file's heights is stated neither by the file nor by the caller."""


@dataclass(frozen=True)
class Reported:
    """Ground position and range at the centre of n images as reported by the file; NaN if missing.

    `centre` are positions, rad and m above the ellipsoid; `slant_range` is in m.
    """

    centre: Geodetic
    slant_range: np.ndarray


@dataclass(frozen=True)
class Acquisition:
    """n exposures. Every array in `sensor`, `shots` and `sources` has a leading axis of n, one entry for each.

    - `path` and `form`, the kind of file as text ("DJI drone image"); `names` (n,) of the images or records.
    - `sensor`: None if the file has no camera (navigation records alone).
    - `shots`: poses with heights above the ellipsoid, gimbal readings, and times in s: since 1970 in UTC if
      `time_is_utc`, else by the clock of the file. An unknown time is zero.
    - `sources`: the errors stated in the file, if any.
    - `assumed`: a sentence for each assumption of the reader.
    - `facts`: contents of the file for display: name and value.
    - `reported`: the ground position reported by the file, for comparison.
    - `above_takeoff` (n,): the height above the take-off as reported by the file, m, NaN where unknown; or None.
    - `takeoff_sigma`: the standard deviation in m of the height of the take-off, to which heights above it were added;
      0 where there is none, or it is exact. It is part of the default errors of position.
    - `of_camera`: whether poses without a sensor are the camera's own, as of a body that carries it in
      `Mount.nadir()` with `Gimbal.fixed()`: then only the camera of a scene applies to them.
    - `start`: the time of the first record of the file, from which the times of a video count; None if unknown.
    - `camera_time` (n,): times in s by the camera's clock, where `shots` have those of marks in their place; or None.
    - `tags`: everything found for each exposure, by the file's own names, including those unknown to the reader.
    """

    path: str
    form: str
    names: np.ndarray
    sensor: Sensor | None
    shots: Shot
    sources: tuple[AbstractSource, ...] = ()
    assumed: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    reported: Reported | None = None
    above_takeoff: np.ndarray | None = None
    tags: tuple[Mapping[str, Any], ...] = ()
    time_is_utc: bool = False
    of_camera: bool = False
    start: float | None = None
    takeoff_sigma: float = 0.0
    camera_time: np.ndarray | None = None

    def __post_init__(self) -> None:
        check_is(self.shots, Shot, "shots", "One Shot, whose fields hold an entry for each exposure.")
        object.__setattr__(self, "names", np.asarray(self.names, dtype=str))
        count = len(self.names)
        for what, tree in (("sensor", self.sensor), ("shots", self.shots), ("sources", self.sources)):
            for leaf in jax.tree.leaves(tree):
                if np.ndim(leaf) < 1 or np.shape(leaf)[0] != count:
                    raise ValueError(f"{self.path}: {what} must have {count} entries; got shape {np.shape(leaf)}.")
        if self.tags and len(self.tags) != count:
            raise ValueError(f"{self.path}: tags must have {count} entries; got {len(self.tags)}.")

    def __len__(self) -> int:
        return len(self.names)

    def exposure(self, index: int) -> tuple[Sensor | None, Shot, tuple[AbstractSource, ...]]:
        """The sensor, the shot and the error sources of one exposure, without the leading axis."""
        return jax.tree.map(lambda leaf: np.asarray(leaf)[index], (self.sensor, self.shots, self.sources))

    def index_of(self, name: str) -> int:
        """The index of an exposure by name. Raises `KeyError` with the available names."""
        where = np.flatnonzero(self.names == name)
        if not len(where):
            some = ", ".join(self.names[:5]) + (", ..." if len(self) > 5 else "")
            raise KeyError(f"{self.path}: no exposure is called {name!r}; there are {some}")
        return int(where[0])


def for_each(tree: Any, count: int) -> Any:
    """A tree whose leaves are broadcast along a leading axis, without copying."""
    return jax.tree.map(lambda leaf: np.broadcast_to(np.asarray(leaf), (count, *np.shape(leaf))), tree)
