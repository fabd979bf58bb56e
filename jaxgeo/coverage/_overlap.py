"""Overlap of two images on the ground: along the flight at positions across it, and by area."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._arguments import check_terrain, checked_air
from jaxgeo._checks import as_float64, concrete
from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._numerics import dot, larger, safe_norm, smaller
from jaxgeo._record import Record
from jaxgeo._typing import PixelField, Scalar, ScalarField, StatusField, Vector3Field
from jaxgeo.coverage._checks import SeesNoGround
from jaxgeo.coverage.exposure import (
    Along,
    Image,
    checked_image,
    image_size,
    local_projection,
    on_map,
    platform_ecef,
    seen_at,
)
from jaxgeo.earth import Atmosphere, TransverseMercator
from jaxgeo.sensor import Sensor
from jaxgeo.status import Status, counts_as_fix, first_failure, status_where
from jaxgeo.terrain import AbstractTerrain

STATIONS = 33
SCANS = 257  # lines along the flight on which the common area is measured
ALIKE = 0.5 * 3.0**0.5  # cosine of the largest turn between images that share lengths along and across a flight
PlanePoint = Float[Array, "2"]
PlanePoints = Float[Array, "stations 2"]


class Edges(Record):
    """The two edges of an image across the flight, on a map: (easting, northing) in m at stations (n, 2).

    `leading` is the edge ahead in the direction of flight; stations run from the near end to the far end. `status` is
    `hit` if all of them see ground.
    """

    leading: Float[Array, "... stations 2"]
    trailing: Float[Array, "... stations 2"]
    status: StatusField


class GroundEdges(Record):
    """The same edges on the ground: `points` (2, n, 3) and `platform` position in ECEF m, and the status."""

    points: Float[Array, "... 2 stations 3"]
    platform: Vector3Field
    status: StatusField


class Overlap(Record):
    """Overlap of an image with the one before, in shares of the latter's length along the flight.

    `along` (stations,) are overlaps at even distances across the flight from the `near` end to the `far` end of the
    common range, at `across` (stations,) in m on the map; negative is a gap. `least` is their minimum, `side` the
    common share of the first image's extent across the flight (`sideways`: in the same unit, the distances by which
    each image's far end is beyond the other's near end), `area` the common share of its area. `step` is the distance in
    m on the map along the flight between the middles of the two near ends. `status` is that of an edge without ground,
    with all else NaN; `images_apart` without a range across the flight that all edges have in common: `side` is then
    negative and the overlaps along the flight are NaN; `images_turned` if the images are turned against each other by
    more than 30 deg: only the `area` is known; or `invalid_input`, with the overlaps along the flight NaN, if
    one edge is not ahead of the other everywhere: `along` is the wrong axis.
    """

    near: ScalarField
    far: ScalarField
    least: ScalarField
    along: Float[Array, "... stations"]
    across: Float[Array, "... stations"]
    side: ScalarField
    sideways: PixelField
    area: ScalarField
    step: ScalarField
    status: StatusField

    @property
    def ok(self) -> Array:
        """Whether both edges are completely on the ground and have a common range across the flight."""
        return jnp.asarray(self.status) == Status.hit


def overlap(
    sensor: Sensor,
    before: Image,
    after: Image,
    terrain: AbstractTerrain,
    *,
    direction: Float[Array, "2"] | None = None,
    along: Along | None = None,
    stations: int = STATIONS,
    atmosphere: Atmosphere | None = None,
    projection: TransverseMercator | None = None,
    sensor_after: Sensor | None = None,
) -> Overlap:
    """Overlap of two images on the terrain: frames, or strips of a scan.

    The edges across the flight of both images are located at `stations`; the overlap is measured along the `direction`
    of flight, a vector (easting, northing) on the map, by default from the first platform position to the second.
    `along` names the image axis along the flight; by default it is determined, which needs concrete values. The map is
    `local_projection(before)` unless a `projection` is given. Strips side by side overlap in the same way, along the
    step from one to the other. `sensor_after` is the sensor of the second image, if it is another one.
    Between the ends of a jump, where a ridge hides ground, an edge is taken as straight.
    Differentiable. Raises `ValueError` for images from one position without a `direction`.
    """
    check_stations(stations)
    check_along(along)
    check_terrain(terrain, FIRST_HIT)
    air = checked_air(atmosphere)
    sensor, before = checked_image(sensor, before)
    other, after = checked_image(sensor if sensor_after is None else sensor_after, after)
    projection = local_projection(before) if projection is None else projection
    if direction is None:
        direction = flight_direction(before, after, projection)
    way: Any = as_float64(direction, "direction")
    way = way / safe_norm(way)
    along = axis_along(sensor, before, way, terrain, projection) if along is None else along
    sensors = (sensor,) if sensor_after is None else (sensor, other)
    return _overlap(sensors, before, after, terrain, way, along, stations, air, projection)


def check_stations(stations: int) -> None:
    """Raise `ValueError` for fewer than two stations."""
    if stations < 2:
        raise ValueError(f"stations must be at least 2, the near end and the far end; got {stations}.")


def check_along(along: Any) -> None:
    """Raise `ValueError` unless `along` is an image axis or None."""
    if along not in ("columns", "rows", None):
        raise ValueError(f'along must be "columns" or "rows", the axis of the image along the flight; got {along!r}.')


def flight_direction(before: Image, after: Image, projection: TransverseMercator) -> PlanePoint:
    """Unit vector (easting, northing) on a map from one platform to another.

    Raises `ValueError` if they are less than 1 mm apart.
    """
    here, there = (on_map(projection, platform_ecef(image)) for image in (before, after))
    apart = concrete(safe_norm(there - here))
    if apart is not None and apart < 1e-3:
        raise ValueError(
            f"the two images are taken {float(apart):.3g} m apart, which gives no direction of flight: "
            "give direction=(easting, northing)."
        )
    return (there - here) / safe_norm(there - here)


def axis_along(
    sensor: Sensor, image: Image, direction: PlanePoint, terrain: AbstractTerrain, projection: TransverseMercator
) -> Along:
    """The image axis along a direction on the map: the one whose middle line is most parallel to it.

    Raises `ValueError` if the values are traced, and `SeesNoGround` if the middle of the image sees none.
    """
    width, height = image_size(sensor)
    middle = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    step = 0.01 * np.array([width, height])
    places = np.concatenate([middle + np.diag(step), middle - np.diag(step)])
    fix = seen_at(sensor, image, jnp.asarray(places), terrain)
    points = jax.vmap(lambda p: on_map(projection, p))(fix.ecef)
    across = jnp.stack([-direction[1], direction[0]])
    change = points[:2] - points[2:]
    lean = concrete(jnp.abs(change @ direction) / jnp.maximum(jnp.abs(change @ across), 1e-12))
    if lean is None:
        raise ValueError(
            "which axis of the image lies along the flight follows from values, which jit and vmap do not have: say "
            'along="columns" or along="rows".'
        )
    if not np.all(np.isfinite(lean)):
        raise SeesNoGround(
            "the middle of the image sees no ground, from which the axis of the image along the flight would follow: "
            'say along="columns" or along="rows", or load a larger terrain.'
        )
    return "columns" if lean[0] > lean[1] else "rows"


def ground_edges(
    sensor: Sensor, image: Image, terrain: AbstractTerrain, along: Along, stations: int, air: Atmosphere | None
) -> GroundEdges:
    """The two edges of an image across the flight, on the ground."""
    width, height = image_size(sensor)
    size = (width, height) if along == "columns" else (height, width)
    ends, across = jnp.array([-0.5, size[0] - 0.5]), jnp.linspace(-0.5, size[1] - 0.5, stations)
    places = [jnp.stack([jnp.full(stations, end), across], axis=-1) for end in ends]
    places = [place if along == "columns" else place[:, ::-1] for place in places]
    fix = seen_at(sensor, image, jnp.concatenate(places), terrain, air)
    outcome = jnp.where(counts_as_fix(fix.status), Status.hit.code, fix.status)
    status = outcome[jnp.argmax(outcome != Status.hit)]
    platform = platform_ecef(image)
    points = jnp.where(status == Status.hit, fix.ecef, platform)  # a placeholder, so that no NaN enters a gradient
    return GroundEdges(points.reshape(2, stations, 3), platform, status)


def edges_on_map(ground: GroundEdges, direction: PlanePoint, projection: TransverseMercator) -> Edges:
    """Edges on a map, ordered by the direction of flight, and from the near end to the far end."""
    one, other = jax.vmap(jax.vmap(partial(on_map, projection)))(ground.points)
    # Which edge is ahead, and which end is near, depends on signs only: no derivative is lost.
    is_ahead = jnp.mean((one - other) @ direction) > 0.0
    leading, trailing = jnp.where(is_ahead, one, other), jnp.where(is_ahead, other, one)
    below = on_map(projection, ground.platform)
    ends_off = [safe_norm(0.5 * (leading[k] + trailing[k]) - below) for k in (0, -1)]
    is_near = ends_off[0] <= ends_off[1]
    leading, trailing = (jnp.where(is_near, edge, edge[::-1]) for edge in (leading, trailing))
    return Edges(leading, trailing, ground.status)


def shared(before: Edges, after: Edges, direction: PlanePoint, stations: int) -> Overlap:
    """The overlap of two images with known edges, along a direction on the map."""
    status = first_failure(before.status, after.status)
    middle = 0.5 * (before.leading + before.trailing)
    side = jnp.stack([-direction[1], direction[0]])
    # Distances across increase from near to far, on whichever side of the flight the image is.
    side = jnp.where(dot(middle[-1] - middle[0], side) < 0.0, -side, side)
    # At nadir a small roll exchanges near and far end: keep the ends of both images matched.
    ends = 0.5 * (after.leading + after.trailing)[jnp.array([0, -1])]
    falls = dot(ends[1] - ends[0], side) < 0.0
    leading, trailing = (jnp.where(falls, edge[::-1], edge) for edge in (after.leading, after.trailing))
    after = Edges(leading, trailing, after.status)
    lines = [_line(edge, direction, side) for edge in (before.leading, before.trailing, after.leading, after.trailing)]
    near = jnp.max(jnp.stack([across[0] for across, _ in lines]))
    far = jnp.min(jnp.stack([across[-1] for across, _ in lines]))
    own_near, own_far = _reach(lines[:2])
    next_near, next_far = _reach(lines[2:])
    meets = far > near
    side_by_side = far - near
    across = near + jnp.where(meets, side_by_side, 1.0) * jnp.linspace(0.0, 1.0, stations)
    lead, trail, next_trail = (jnp.interp(across, *lines[k]) for k in (0, 1, 3))
    length = lead - trail
    is_ordered = jnp.all(length > 0.0) & (own_far > own_near) & (next_far > next_near)
    length = jnp.where(length > 0.0, length, 1.0)
    along = (lead - next_trail) / length
    own_extent = jnp.where(own_far > own_near, own_far - own_near, 1.0)
    area = _shared_area(*(_ring(one, before.leading[0], side, direction) for one in (before, after)))
    chords = [(one.leading + one.trailing)[-1] - (one.leading + one.trailing)[0] for one in (before, after)]
    is_turned = dot(*chords) < ALIKE * safe_norm(chords[0]) * safe_norm(chords[1])
    step = dot(0.5 * (after.leading[0] + after.trailing[0]) - middle[0], direction)
    is_known = status == Status.hit
    status = status_where(is_known & ~meets, Status.images_apart, status)
    status = status_where(is_known & ~is_ordered & (meets | (own_far <= own_near)), Status.invalid_input, status)
    status = status_where(is_known & is_turned, Status.images_turned, status)
    meets &= is_ordered & ~is_turned
    of_meeting = (along[0], along[-1], jnp.min(along), along, across)
    sideways = jnp.stack([own_far - next_near, next_far - own_near]) / own_extent
    of_both = (side_by_side / own_extent, sideways, step)
    near_, far_, least, along, across = (jnp.where(is_known & meets, x, jnp.nan) for x in of_meeting)
    side_, sideways, step = (jnp.where(is_known & ~is_turned, x, jnp.nan) for x in of_both)
    area = jnp.where(is_known, area, jnp.nan)
    return Overlap(near_, far_, least, along, across, side_, sideways, area, step, status)


@quick_filter_jit
def _overlap(
    sensors: tuple[Sensor, ...],
    before: Image,
    after: Image,
    terrain: AbstractTerrain,
    direction: PlanePoint,
    along: Along,
    stations: int,
    air: Atmosphere | None,
    projection: TransverseMercator,
) -> Overlap:
    def edges(image: Image, sensor: Sensor = sensors[0]) -> Edges:
        return edges_on_map(ground_edges(sensor, image, terrain, along, stations, air), direction, projection)

    if _are_alike(before, after) and len(sensors) == 1:  # the search of the terrain is half of the program
        both = jax.vmap(edges)(jax.tree.map(lambda *x: jnp.stack(x), before, after))
        first, second = (jax.tree.map(lambda x, k=k: x[k], both) for k in range(2))
    else:
        first, second = edges(before), edges(after, sensors[-1])
    return shared(first, second, direction, stations)


def _are_alike(one: Image, other: Image) -> bool:
    """Whether two images are records of one kind and shape."""
    is_same = jax.tree.structure(one) == jax.tree.structure(other)
    return is_same and all(map(lambda *x: jnp.shape(x[0]) == jnp.shape(x[1]), *map(jax.tree.leaves, (one, other))))


def _line(edge: PlanePoints, direction: PlanePoint, side: PlanePoint) -> tuple[Array, Array]:
    """An edge as (distance across, distance along), the first made monotonic; only a turning platform needs that."""
    return jax.lax.cummax(edge @ side), edge @ direction


def _reach(lines: list[tuple[Array, Array]]) -> tuple[Scalar, Scalar]:
    """The range across the flight that both edges of an image cover."""
    (one, _), (other, _) = lines
    return larger(one[0], other[0]), smaller(one[-1], other[-1])


def _ring(edges: Edges, origin: PlanePoint, side: PlanePoint, direction: PlanePoint) -> PlanePoints:
    """An image's outline, closed, as (distance across, distance along) from a place."""
    outline = jnp.concatenate([edges.leading, edges.trailing[::-1], edges.leading[:1]]) - origin[None, :]
    return jnp.stack([outline @ side, outline @ direction], axis=-1)


def _shared_area(one: PlanePoints, other: PlanePoints) -> Scalar:
    """The share of the area of one outline that is within another, by lines along the flight at even distances."""
    whole = _common_area(one, one)
    return _common_area(one, other) / jnp.where(whole > 0.0, whole, 1.0)


def _common_area(one: PlanePoints, other: PlanePoints) -> Scalar:
    near = larger(jnp.min(one[:, 0]), jnp.min(other[:, 0]))
    width = smaller(jnp.max(one[:, 0]), jnp.max(other[:, 0])) - near
    across = near + width * (jnp.arange(SCANS) + 0.5) / SCANS
    (lowest, highest), (other_lowest, other_highest) = _cut(one, across), _cut(other, across)
    both = larger(smaller(highest, other_highest) - larger(lowest, other_lowest), 0.0)
    return jnp.where(width > 0.0, width * jnp.mean(both), 0.0)


def _cut(ring: PlanePoints, across: Float[Array, " scans"]) -> tuple[Array, Array]:
    """The first and the last crossing of an outline along lines at distances across."""
    x, y, x_next, y_next = jnp.concatenate([ring[:-1].T, ring[1:].T])[:, None, :]
    away = across[:, None]
    crosses = (x <= away) != (x_next <= away)
    at = y + (away - x) * (y_next - y) / jnp.where(x_next == x, 1.0, x_next - x)
    return jnp.min(jnp.where(crosses, at, jnp.inf), axis=1), jnp.max(jnp.where(crosses, at, -jnp.inf), axis=1)
