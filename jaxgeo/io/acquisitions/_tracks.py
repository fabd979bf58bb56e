"""Positions of images on a receiver's trajectory, interpolated to the times of the images."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np

from jaxgeo.earth import Geodetic
from jaxgeo.io.acquisitions._position_tables import PositionTable
from jaxgeo.io.acquisitions._rtklib import QUALITY
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError

MOST_GAP = 1.0  # s between epochs across which positions are interpolated
EARTH_RADIUS = 6.371e6  # m


def at_times(found: Acquisition, table: PositionTable) -> PositionTable:
    """The positions of a trajectory at the times of images, by their names; images outside it are missing.

    Cubic through four epochs, or linear through two where there are no four without a gap. Standard deviations are
    the larger ones of both epochs, and widened by the way in a second if the times are whole seconds. Raises
    `TableError` for times that are not UTC, and if no image is within the trajectory.
    """
    name = os.path.basename(table.path)
    if not found.time_is_utc:
        raise TableError(no_utc(found, table))
    assert table.time is not None
    times = np.asarray(found.shots.time, np.float64)
    after = np.clip(np.searchsorted(table.time, times), 1, len(table.time) - 1)
    within = (times >= table.time[0]) & (times <= table.time[-1])
    within &= table.time[after] - table.time[after - 1] <= MOST_GAP
    if not np.any(within):
        taken = int(np.argmax(np.isfinite(times)))  # images without a mark have no time
        first, last, own = (_clock(one) for one in (table.time[0], table.time[-1], times[taken]))
        one = found.names[taken]
        none = f"{one} was not taken within it" if len(found) == 1 else "no image was taken within it"
        raise TableError(
            f"{table.path}: {none}: it is from {first} to {last} (UTC), with gaps of up to "
            f"{np.max(np.diff(table.time)):.1f} s, and {one} of {own}."
        )
    after, t = after[within], times[within]
    p = table.position
    lat, lon, height = (
        _interpolated(table.time, np.asarray(one), after, t) for one in (p.lat, np.unwrap(p.lon), p.height)
    )
    notes = []
    sigma = None if table.sigma is None else np.maximum(table.sigma[after - 1], table.sigma[after])
    if np.all(t == np.floor(t)):
        velocity = _velocity(table, after)
        speed = float(np.median(np.linalg.norm(velocity, axis=1)))
        notes.append(
            f"Times of images are whole seconds: positions are uncertain by the way in a second ({speed:.1f} m)."
        )
        sigma = np.hypot(0.0 if sigma is None else sigma, np.abs(velocity) / np.sqrt(3.0))
        sigma = np.maximum(sigma, 1e-3)
    notes += _qualities(table, after)
    epochs = f"the {len(table.time)} epochs of {name}"
    return dataclasses.replace(
        table,
        names=found.names[within],
        position=Geodetic(lat=lat, lon=lon, height=height),
        sigma=sigma,
        time=t,
        quality=None,
        is_track=False,
        assumed=(*table.assumed, f"Positions are interpolated in {epochs} to the times of the images.", *notes),
    )


def no_utc(found: Acquisition, table: PositionTable) -> str:
    """Message that solutions of a receiver cannot be joined to images without times in UTC."""
    return (
        f"{table.path}: its positions are joined by time, but the times of {found.path} are not in UTC (no "
        f"UTCAtExposure, GPSTimeStamp or OffsetTimeOriginal in the tags). Put DJI's marks of the flight (.MRK) beside "
        f"the images, add the camera's time zone (OffsetTimeOriginal, such as +08:00), or give positions by the names "
        f"of the images (geo.txt)."
    )


def _interpolated(time: np.ndarray, value: np.ndarray, after: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Values at times t before the epochs `after`: Lagrange's cubic, or linear at ends and beside gaps."""
    lower, upper = after - 1, after
    share = (t - time[lower]) / (time[upper] - time[lower])
    linear = value[lower] + share * (value[upper] - value[lower])
    four = np.clip(after[:, None] + np.arange(-2, 2), 0, len(time) - 1)
    nodes, known = time[four], value[four] - value[lower][:, None]
    has_four = (after >= 2) & (after + 1 < len(time)) & np.all(np.diff(nodes, axis=1) <= MOST_GAP, axis=1)
    nodes = np.where(has_four[:, None], nodes, np.arange(4.0))
    cubic = np.zeros_like(t)
    for i in range(4):
        others = [j for j in range(4) if j != i]
        weight = np.prod([(t - nodes[:, j]) / (nodes[:, i] - nodes[:, j]) for j in others], axis=0)
        cubic += weight * known[:, i]
    return np.where(has_four, value[lower] + cubic, linear)


def _velocity(table: PositionTable, after: np.ndarray) -> np.ndarray:
    """North, east and down in m/s (n, 3) between the epochs beside the images."""
    assert table.time is not None
    p = table.position
    lat, lon, height = np.asarray(p.lat), np.unwrap(p.lon), np.asarray(p.height)
    east = EARTH_RADIUS * np.cos(lat[after]) * (lon[after] - lon[after - 1])
    moved = np.stack([EARTH_RADIUS * (lat[after] - lat[after - 1]), east, height[after - 1] - height[after]], axis=-1)
    return moved / (table.time[after] - table.time[after - 1])[:, None]


def _qualities(table: PositionTable, after: np.ndarray) -> list[str]:
    """A note on images beside solutions that are not fixed; without a count for an image alone, which may be one of a
    folder."""
    if table.quality is None:
        return []
    worst = np.maximum(table.quality[after - 1], table.quality[after])
    kinds = [
        f"{f'{np.sum(worst == q)} ' if len(worst) > 1 else ''}{QUALITY.get(int(q), 'other')} (Q {q})"
        for q in np.unique(worst)
        if q != 1
    ]
    return [f"Images at solutions that are not fixed: {', '.join(kinds)}."] if kinds else []


def _clock(time: Any) -> str:
    return str(np.datetime64(int(time), "s"))
