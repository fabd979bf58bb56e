"""Poses as table rows in degrees and metres, with named columns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any


def pose_columns(shots: Any, names: tuple[str, ...] | None) -> dict[str, Any]:
    """Time, position, attitude and, for axes with `names`, gimbal readings of n shots: an array (n,) per column."""
    import numpy as np

    from jaxgeo.io._csv import POSE_COLUMNS, gimbal_columns

    pose, position = shots.pose, shots.pose.position
    places = [np.rad2deg(position.lat), np.rad2deg(position.lon), position.height]
    attitude = [np.rad2deg(angle) for angle in (pose.heading, pose.pitch, pose.roll)]
    columns = {"time_s": shots.time} | dict(zip(POSE_COLUMNS, [*places, *attitude], strict=True))
    if names is not None:
        readings = np.rad2deg(np.asarray(shots.gimbal_readings)).T
        columns |= dict(zip(gimbal_columns(names), readings, strict=True))
    return columns


def rows_of(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One row per entry of the columns; None for unknown values."""
    import numpy as np

    found = {name: np.asarray(values).tolist() for name, values in columns.items()}
    count = len(next(iter(found.values())))
    return [{name: _known(values[i]) for name, values in found.items()} for i in range(count)]


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
