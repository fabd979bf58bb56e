"""Overlap by coordinate transformation: near ends of strips, located, on a map.

Li et al. (2020), "Effect and compensation of overlap influenced by flight parameter of oblique aerial camera", section
2.3: Eqs 13-15 are `jaxgeo.locate` over terrain of a constant height, Eq 10 the map, Eq 16 the step. (The middle part of
Eq 14 is printed with a wrong numerator, (y_T - y_S) over itself.) All functions take one pair of points; use `jax.vmap`
for many. A point that was not found has NaN coordinates, and so have all results of it.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64
from jaxgeo._numerics import dot
from jaxgeo._typing import Scalar, ScalarLike
from jaxgeo.coverage._checks import checked_positive
from jaxgeo.earth.geodetic import Geodetic, check_position

MapVector = Float[Array, "2"]


@runtime_checkable
class MapProjection(Protocol):
    """A conformal map, such as a `TransverseMercator` or a `GaussKruegerSeries`."""

    def forward(self, lat: ScalarLike, lon: ScalarLike) -> tuple[Scalar, Scalar]:
        """(easting, northing) in m of a latitude and longitude in rad."""
        ...


def step_on_map(projection: MapProjection, before: Geodetic, after: Geodetic) -> MapVector:
    """The step from one ground point to the next on the map: (easting, northing) in m."""
    return _on_map(projection, after, "after") - _on_map(projection, before, "before")


def bearing_on_map(projection: MapProjection, start: Geodetic, end: Geodetic) -> Scalar:
    """Bearing in rad, clockwise from grid north, from one point to another, e.g. the nominal direction of a step.

    Between two nominal ground points, or two aircraft positions. Between equal points it is 0, without a gradient.
    """
    east, north = step_on_map(projection, start, end)
    same = (east == 0.0) & (north == 0.0)
    return jnp.arctan2(jnp.where(same, 0.0, east), jnp.where(same, 1.0, north))


def projected_step(projection: MapProjection, before: Geodetic, after: Geodetic, *, bearing: ArrayLike) -> Scalar:
    """Step in m along the nominal direction, a `bearing` in rad clockwise from grid north (`bearing_on_map`).

    It decreases monotonically as the line of sight turns backwards, and is negative if the next frame is behind.
    """
    east, north = step_on_map(projection, before, after)
    angle: Any = as_float64(bearing, "bearing")
    return east * jnp.sin(angle) + north * jnp.cos(angle)


def euclidean_step(projection: MapProjection, before: Geodetic, after: Geodetic) -> Scalar:
    """Step in m by Eq 16: the distance between the two points, in any direction.

    It is never negative, and includes offsets across the flight: with the 0.88 deg of the paper's camera it folds
    beyond 0.78 deg of heading, where turning farther back gives less "overlap". Its gradient is zero between equal
    points.
    """
    return _length(step_on_map(projection, before, after))


def frame_length_on_map(projection: MapProjection, rear_edge: Geodetic, front_edge: Geodetic) -> Scalar:
    """Length in m of a single frame on the map, between the located middles of its edges across the flight.

    In the same metres as a step on this map, so that the map's scale cancels in the overlap (Eq 1 and a slant range
    give a length on the ground). The edges of an image are half a pixel outside its first and last pixel centres.
    """
    return _length(step_on_map(projection, rear_edge, front_edge))


def overlap_along(
    projection: MapProjection, before: Geodetic, after: Geodetic, *, bearing: ArrayLike, length: ArrayLike
) -> Scalar:
    """Overlap of two frames of one `length` in m from their step along the nominal direction (see `projected_step`).

    Raises `ValueError` for a length that is not finite and positive.
    """
    return _overlap(projected_step(projection, before, after, bearing=bearing), length)


def overlap_of_eq_16(projection: MapProjection, before: Geodetic, after: Geodetic, *, length: ArrayLike) -> Scalar:
    """Overlap of two frames of one `length` in m from the paper's step, which folds (see `euclidean_step`).

    Raises `ValueError` for a length that is not finite and positive.
    """
    return _overlap(euclidean_step(projection, before, after), length)


def _length(step: MapVector) -> Scalar:
    """Length of a step, with a gradient of zero where it is zero; NaN stays NaN, unlike in `safe_norm`."""
    squared = dot(step, step)
    nothing = squared == 0.0
    return jnp.where(nothing, 0.0, jnp.sqrt(jnp.where(nothing, 1.0, squared)))


def _overlap(step: Scalar, length: ArrayLike) -> Scalar:
    """As `geometry.overlap_of_step`, for steps that may be NaN."""
    return 1.0 - step / checked_positive(length, "length", "m")


def _on_map(projection: MapProjection, point: Geodetic, name: str) -> MapVector:
    check_position(point, name)
    return jnp.stack(projection.forward(point.lat, point.lon))
