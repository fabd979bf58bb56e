"""Velocities over ground at exposure, from the speeds in the tags of drone images."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from jaxgeo.io._csv import Limits
from jaxgeo.io.acquisitions._image_tags import ImageTags, read_tags
from jaxgeo.io.errors import ImageError

Path = str | os.PathLike[str]
SPEEDS = ("drone-dji:FlightXSpeed", "drone-dji:FlightYSpeed", "drone-dji:FlightZSpeed")
LIMITS: Limits = (-200.0, 200.0, "m/s")


def read_velocities(paths: Sequence[Path]) -> np.ndarray:
    """Velocities (n, 3) in m/s, north, east, down, of the aircraft at the exposure of each image; NaN where its tags
    have none.

    DJI's `FlightXSpeed`, `FlightYSpeed` and `FlightZSpeed` are towards north, east and, in its NED system, down. Some
    models write zero for all images: then all are NaN. Raises `TableError` for tags that are not numbers or out of
    range.
    """
    found = np.array([_speeds(path) for path in paths], np.float64).reshape(-1, 3)
    return np.full(found.shape, np.nan) if np.all(np.nan_to_num(found) == 0.0) else found


def _speeds(path: Path) -> list[float]:
    try:
        tags: ImageTags = read_tags(path)
    except ImageError:  # an image of a table or a reconstruction may be of any format
        return [np.nan] * 3
    each = [tags.number(name, LIMITS) for name in SPEEDS]
    return [np.nan if one is None else one for one in each]
