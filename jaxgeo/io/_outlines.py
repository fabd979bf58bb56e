"""Ground outlines and lines as map geometries: cut at the map's seam, oriented as in GeoJSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely
from shapely.affinity import translate
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient


def outline(places: np.ndarray, turn: float | None) -> BaseGeometry:
    """The area within a ring of points (n, 2 or 3), x or longitude first: a polygon, or several if it is cut.

    `turn` is 360 deg of longitude in the unit of a geographic CRS: the area is cut at longitude jumps, and may
    contain a pole. None for a projected CRS. Outer rings run anticlockwise on the map, as in RFC 7946.
    Self-intersecting rings are split there.
    """
    area: BaseGeometry = shapely.Polygon(places if turn is None else _unwound(places, turn))
    if not area.is_valid:
        area = _of_kind("Polygon", shapely.make_valid(area))
    if turn is not None:
        area = _of_kind("Polygon", _within_a_turn(area, turn))
    parts = [orient(part, 1.0) for part in shapely.get_parts(area)]
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def line(places: np.ndarray, turn: float | None) -> BaseGeometry:
    """The line through points (n, 2 or 3), x or longitude first; several if longitude jumps. `turn` as above."""
    if turn is None:
        return shapely.LineString(places)
    unwrapped = np.concatenate([np.unwrap(places[:, :1], axis=0, period=turn), places[:, 1:]], axis=1)
    return _of_kind("LineString", _within_a_turn(shapely.LineString(unwrapped), turn))


def runs(labels: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """(label, points) of the runs of equal labels around a ring; edge i goes from point i to the next.

    Points are indices along the run, its end included; zero means no label. One label all around gives a closed run.
    """
    count = len(labels)
    changes = np.flatnonzero(labels != np.roll(labels, 1))
    starts = changes if changes.size else np.zeros(1, int)
    lengths = np.diff(np.append(starts, starts[0] + count))
    for start, length in zip(starts, lengths, strict=True):
        if labels[start]:
            yield int(labels[start]), (start + np.arange(length + 1)) % count


def within_a_turn(area: BaseGeometry, turn: float) -> BaseGeometry:
    """Polygons cut at the seam of longitudes and shifted to within half a `turn` of the prime meridian."""
    return _of_kind("Polygon", _within_a_turn(area, turn))


def _unwound(ring: np.ndarray, turn: float) -> np.ndarray:
    """A ring without longitude jumps; one around a pole goes to it and back along the meridian."""
    x = np.unwrap(ring[:, 0], period=turn)
    unwound = np.concatenate([x[:, None], ring[:, 1:]], axis=1)
    end = x[-1] + math.remainder(x[0] - x[-1], turn)
    if abs(end - x[0]) < 0.5 * turn:
        return unwound
    pole = math.copysign(0.25 * turn, ring[:, 1].mean())
    around = np.repeat(unwound[:1], 3, axis=0)
    around[:2, 0], around[1:, 1] = end, pole
    return np.concatenate([unwound, around])


def _within_a_turn(geometry: BaseGeometry, turn: float) -> BaseGeometry:
    """A geometry cut at the seam and shifted to within 180 deg of the prime meridian."""
    west, _, east, _ = geometry.bounds
    half = 0.5 * turn
    first, last = math.floor((west + half) / turn), math.ceil((east - half) / turn)
    if first >= last:
        return _shifted(geometry, first * turn)
    parts = []
    for lap in range(first, last + 1):
        window = shapely.box(lap * turn - half, -turn, lap * turn + half, turn)
        parts.append(_shifted(shapely.intersection(geometry, window), lap * turn))
    return shapely.GeometryCollection(parts)


def _shifted(geometry: BaseGeometry, x: float) -> BaseGeometry:
    return translate(geometry, xoff=-x) if x else geometry


def _of_kind(kind: str, geometry: BaseGeometry) -> BaseGeometry:
    """The polygons, or the lines, of a nested geometry; parts that touch a seam in a point are dropped."""
    parts: list[Any] = [geometry]
    while any(hasattr(part, "geoms") for part in parts):
        parts = [inner for part in parts for inner in getattr(part, "geoms", [part])]
    kept = [part for part in parts if part.geom_type == kind and not part.is_empty]
    if len(kept) == 1:
        return kept[0]
    return shapely.MultiPolygon(kept) if kind == "Polygon" else shapely.MultiLineString(kept)
