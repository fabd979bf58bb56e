"""Overlap of outlines by area, and ground within an outline hidden by nearer ground."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int8

from jaxgeo._arguments import check_terrain, checked_air
from jaxgeo._checks import check_is
from jaxgeo._compile import batch_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._locate import project
from jaxgeo._numerics import tree_where
from jaxgeo._record import Record
from jaxgeo._typing import PixelField, StatusCode, StatusField
from jaxgeo.coverage._checks import checked_positive
from jaxgeo.coverage._footprint import Footprint
from jaxgeo.coverage.exposure import Image, checked_image, motion_of, on_map
from jaxgeo.earth import Atmosphere, Geodetic, TransverseMercator
from jaxgeo.sensor import Sensor
from jaxgeo.status import Status, first_failure
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.map_cells import ground_at

BATCH = 4096  # points tested for visibility at a time
MOST = 4_000_000  # points in all


class VisibleGround(Record):
    """Visibility of the ground within an outline.

    `places` (n, 2) are the (easting, northing) in m of the centres of squares `spacing` m wide on the footprint's map;
    `status` (n,) is `hit` where the image sees them, `hidden_by_terrain` where nearer ground hides them, and otherwise
    the reason why visibility is unknown.
    """

    places: PixelField
    status: StatusField
    spacing: float = eqx.field(static=True)

    def area(self, status: Status) -> float:
        """Area in m2 of the squares with a status."""
        return self.spacing**2 * float(np.sum(np.asarray(self.status) == status))

    @property
    def hidden_share(self) -> float:
        """Share of the ground within the outline that is hidden by nearer ground or the Earth."""
        hidden = (Status.hidden_by_terrain, Status.below_horizon)
        return float(np.mean(np.isin(np.asarray(self.status), hidden)))


def polygon_overlap(before: Footprint, after: Footprint) -> float:
    """Share of the area within one outline that is also within another, both on the map of the first.

    Hidden ground within an outline counts as covered; `visible_ground` finds it. Each part of a self-intersecting
    outline counts once. Raises `ValueError` for an incomplete outline.
    """
    shapes = []
    for name, one in (("before", before), ("after", after)):
        check_is(one, Footprint, name)
        if not one.ok:
            status = Status(int(np.asarray(one.status)))
            raise ValueError(f"{name} has no whole outline, so no area: {status.name}. {status.message}")
        shapes.append(_polygon(_outline_on(one, before.projection)))
    first, second = shapes
    return float(first.intersection(second).area / first.area)


def visible_ground(
    sensor: Sensor,
    image: Image,
    terrain: AbstractTerrain,
    outline: Footprint,
    *,
    spacing: float,
    atmosphere: Atmosphere | None = None,
) -> VisibleGround:
    """Visibility of the ground within an image's outline, by squares of `spacing` m; exact for their centres.

    Raises `ValueError` for an incomplete outline, and for a spacing that is not positive or makes more than four
    million squares.
    """
    import shapely  # polygon library, needed by these functions only

    sensor, image = checked_image(sensor, image)
    check_terrain(terrain, FIRST_HIT)
    check_is(outline, Footprint, "outline")
    checked_positive(spacing, "spacing", "m")
    if not outline.ok:
        raise ValueError(f"the outline is not whole: {Status(int(np.asarray(outline.status))).message}")
    shape = _polygon(np.asarray(outline.outline))
    low_e, low_n, high_e, high_n = shape.bounds
    count = (high_e - low_e) / spacing * ((high_n - low_n) / spacing)
    if count > MOST:
        raise ValueError(
            f"a spacing of {spacing:g} m makes {count:.3g} squares, more than {MOST:g}: take a larger one."
        )
    east, north = (np.arange(low + 0.5 * spacing, high, spacing) for low, high in ((low_e, high_e), (low_n, high_n)))
    places = np.stack([x.ravel() for x in np.meshgrid(east, north)], axis=1)
    places = places[shapely.contains_xy(shape, places[:, 0], places[:, 1])]
    if not len(places):
        raise ValueError(f"no square of {spacing:g} m has its middle within the outline: take smaller ones.")
    codes = [
        np.asarray(_seen_from(sensor, image, terrain, jnp.asarray(part), outline.projection, checked_air(atmosphere)))
        for part in _parts(places)
    ]
    return VisibleGround(places, np.concatenate(codes)[: len(places)], float(spacing))


@batch_filter_jit
def _seen_from(
    sensor: Sensor,
    image: Image,
    terrain: AbstractTerrain,
    places: Float[Array, "places 2"],
    projection: TransverseMercator,
    air: Atmosphere | None,
) -> Int8[Array, " places"]:
    motion, time = motion_of(image)

    def one(place: Float[Array, "2"]) -> StatusCode:
        ground, unknown = ground_at(*projection.inverse(place[0], place[1]), terrain)
        level = Geodetic(lat=ground.lat, lon=ground.lon, height=jnp.zeros_like(ground.lat))
        there = tree_where(unknown == Status.hit, ground, level)
        seen = project(sensor, motion, there, time=time, terrain=terrain, atmosphere=air)
        return first_failure(unknown, jnp.asarray(seen.status))

    return jax.vmap(one)(places)


def _parts(places: np.ndarray) -> list[np.ndarray]:
    """Points in parts of one size; the last point is repeated to fill the last part."""
    numbers = [np.minimum(np.arange(first, first + BATCH), len(places) - 1) for first in range(0, len(places), BATCH)]
    return [places[part] for part in numbers]


@eqx.filter_jit
def _mapped(projection: TransverseMercator, p_ecef: Float[Array, "places 3"]) -> Float[Array, "places 2"]:
    return jax.vmap(lambda p: on_map(projection, p))(p_ecef)


def _outline_on(one: Footprint, projection: TransverseMercator) -> np.ndarray:
    """An outline on another map; in batches of one size, since outlines differ in their number of points."""
    p_ecef = np.asarray(one.fix.ecef)
    parts = [np.asarray(_mapped(projection, jnp.asarray(part))) for part in _parts(p_ecef)]
    return np.concatenate(parts)[: len(p_ecef)]


def _polygon(outline: np.ndarray) -> Any:
    import shapely

    return shapely.make_valid(shapely.Polygon(outline))
