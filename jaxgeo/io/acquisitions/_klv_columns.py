"""Telemetry packet values by name, unknown ones NaN: stated, held from an earlier packet, or derived."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxgeo.io.acquisitions.st0601 import label
from jaxgeo.io.sentinels import KLV, Sentinel

LATEST = 1e11  # s since 1970; later times are invalid
LONGEST_HELD = 30.0  # s; MISB ST 0902 requires each item at least once in this period
TOLD, HELD, DERIVED = range(3)  # source of a field of view

Values = Sequence[Mapping[int, Any]]
Columns = Mapping[str, np.ndarray]


class Numbers(NamedTuple):
    """Columns of n packets, each (n,); the source of the field of view (n,); sentinels by the tag they invalidate.

    Angles are in rad, heights and ranges in m, times in s since 1970. `age` is that of the field of view, in s.
    """

    columns: dict[str, np.ndarray]
    origin: np.ndarray
    age: np.ndarray
    sentinels: dict[int, dict[int, Sentinel]]

    def of(self, rows: np.ndarray) -> Numbers:
        """A subset of the packets by mask; the sentinels stay those of all."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return Numbers(columns, self.origin[rows], self.age[rows], self.sentinels)


def numbers_of(values: Values) -> Numbers:
    """The columns of the decoded values of n packets."""
    voided, sentinels = _without_sentinels(values)

    def numbers(tag: int) -> np.ndarray:
        found = (one.get(tag) for one in voided)
        return np.array([one if isinstance(one, int | float) else math.nan for one in found], np.float64)

    def first_known(*tags: int) -> np.ndarray:
        return _first(*(numbers(tag) for tag in tags))

    def held(column: np.ndarray, *tags: int) -> np.ndarray:
        """A column with the value of an earlier packet filled in, where a packet has none of its items."""
        silent = np.array([not any(tag in one for tag in tags) for one in values], bool)
        return column[_last_before(silent, time)]

    time = 1e-6 * numbers(2) + np.nan_to_num(_carried(numbers(136)))
    time = np.where((time > 0.0) & (time < LATEST), time, np.nan)
    slant_range = numbers(21)
    slant_range = np.where(slant_range > 0.0, slant_range, np.nan)
    fields, origin, age = _fields_of_view(numbers, slant_range, values, time)
    columns = {
        "time": time,
        "lat": np.radians(numbers(13)),
        "lon": np.radians(numbers(14)),
        "height": first_known(104, 75),
        "height_msl": numbers(15),
        "heading": np.radians(numbers(5)),
        "pitch": np.radians(first_known(90, 6)),
        "roll": np.radians(first_known(91, 7)),
        "field_across": fields[0],
        "field_down": fields[1],
        "azimuth": np.radians(numbers(18)),
        "elevation": np.radians(numbers(19)),
        "turn": np.radians(held(numbers(20), 20)),
        "slant_range": slant_range,
        "centre_lat": np.radians(numbers(23)),
        "centre_lon": np.radians(numbers(24)),
        "centre_height": numbers(78),
        "centre_height_msl": numbers(25),
    }
    return Numbers(columns, origin, age, sentinels)


def _without_sentinels(values: Values) -> tuple[list[dict[int, Any]], dict[int, dict[int, Sentinel]]]:
    """(values, unknown ones NaN; by tag the first sentinel that invalidates it, by packet number)."""
    by_tag = [(row, [_TAG_OF[name] for name in row.fields]) for row in KLV]
    voided, found = [], {}
    for number, one in enumerate(values):
        voided.append(dict(one))
        for row, tags in by_tag:
            if all(tag in one for tag in tags) and row.is_unknown(*(one[tag] for tag in tags)):
                for tag in tags:
                    voided[-1][tag] = math.nan
                    found.setdefault(tag, {}).setdefault(number, row)
    return voided, found


_TAG_OF = {label(tag): tag for tag in range(1, 143)}


def _first(*columns: np.ndarray) -> np.ndarray:
    """The first known value of several columns."""
    result = columns[0]
    for column in columns[1:]:
        result = np.where(np.isfinite(result), result, column)
    return result


def _carried(column: np.ndarray) -> np.ndarray:
    """A column sent occasionally, in every packet: each value holds until the next, the first from the start."""
    known = np.flatnonzero(np.isfinite(column))
    if not len(known):
        return column
    return column[known[np.maximum(np.searchsorted(known, np.arange(len(column)), side="right") - 1, 0)]]


def _last_before(silent: np.ndarray, time: np.ndarray) -> np.ndarray:
    """For each packet the index of the packet whose item applies: the last that had it, if it is recent enough.

    `silent` are packets without the item. A packet with the item, even with the value "unknown", applies to itself.
    """
    here = np.arange(len(silent))
    last = np.maximum.accumulate(np.where(silent, -1, here))
    last = np.where(last < 0, here, last)
    with np.errstate(invalid="ignore"):
        young = np.abs(time - time[last]) <= LONGEST_HELD + 1e-3
    return np.where(young, last, here)


def _fields_of_view(
    numbers: Any, slant_range: np.ndarray, values: Values, time: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    """((across, down) in rad, source, age in s): stated, else of an earlier packet, else by target width and range.

    The target width spans the middle row of the image at the slant range: across = 2 atan(width / (2 range)).
    """

    def values_of(tag: int) -> np.ndarray:
        angle = np.radians(numbers(tag))
        return np.where((angle > 0.0) & (angle < np.pi), angle, np.nan)

    width = _first(numbers(96), numbers(22))
    derived = 2.0 * np.arctan(0.5 * np.where(width > 0.0, width, np.nan) / slant_range)
    derived = np.where(derived < np.pi, derived, np.nan)
    own = [values_of(16), values_of(17)]
    silent = np.array([16 not in one and 17 not in one for one in values], bool)
    known = np.isfinite(own[0]) | np.isfinite(own[1])
    source = _last_before(silent, time)
    across, down = (field[source] for field in own)
    origin = np.where(known, TOLD, HELD)
    missing = ~(np.isfinite(across) | np.isfinite(down))
    place = _last_before(~np.isfinite(derived), time)
    across = np.where(missing, derived[place], across)
    origin = np.where(missing, DERIVED, origin)
    with np.errstate(invalid="ignore"):
        age = np.abs(time - time[np.where(missing, place, source)])
    return (across, down), origin, age


def lacking(columns: Columns, fields_too: bool) -> dict[str, tuple[np.ndarray, tuple[int, ...]]]:
    """Requirements of an exposure, as text: the packets that lack each, and the tags that state it; time is optional.

    `fields_too`: whether the camera depends on the field of view.
    """
    unknown = {name: ~np.isfinite(column) for name, column in columns.items()}
    needed = {
        "position of the sensor (tags 13, 14)": (unknown["lat"] | unknown["lon"], (13, 14)),
        "height of the sensor (tags 15, 75 or 104)": (unknown["height"] & unknown["height_msl"], (15, 75, 104)),
        "attitude of the platform (tags 5, 6 or 90, 7 or 91)": (
            unknown["heading"] | unknown["pitch"] | unknown["roll"],
            (5, 6, 90, 7, 91),
        ),
        "azimuth and elevation of the sensor (tags 18, 19)": (unknown["azimuth"] | unknown["elevation"], (18, 19)),
        "field of view (tags 16, 17, or target width 22 or 96 with slant range 21)": (
            unknown["field_across"] & unknown["field_down"],
            (16, 17, 22, 96, 21),
        ),
    }
    return needed if fields_too else {what: one for what, one in needed.items() if not what.startswith("field of view")}
