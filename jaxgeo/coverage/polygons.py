"""Overlap of whole outlines by area, and which ground within an outline nearer ground hides."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int8

from jaxgeo._arguments import check_terrain, checked_air
from jaxgeo._checks import check_is
from jaxgeo._numerics import tree_where
from jaxgeo._record import Record
from jaxgeo._typing import PixelField, StatusCode, StatusField
from jaxgeo.coverage._checks import checked_positive
from jaxgeo.coverage.exposure import Image, checked_image, motion_of, on_map
from jaxgeo.coverage.footprint import Footprint
from jaxgeo.earth import Atmosphere, Geodetic, TransverseMercator
from jaxgeo.locate import FIRST_HIT, project
from jaxgeo.sensor import Sensor
from jaxgeo.status import Status, first_failure
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.map_cells import ground_at

BATCH = 4096  # places that are looked at from the camera at a time
MOST = 4_000_000  # of them in all


class VisibleGround(Record):
    """Which ground within an outline an image sees.

    `places` (n, 2) are the (easting, northing) in m of squares `spacing` m wide on the footprint's map, by their
    middles; `status` (n,) is `hit` where the image sees them, `hidden_by_terrain` where nearer ground is in the way,
    and otherwise why nobody can tell.
    """

    places: PixelField
    status: StatusField
    spacing: float = eqx.field(static=True)

    def area(self, status: Status) -> float:
        """Area in m2 of the squares of a status."""
        return self.spacing**2 * float(np.sum(np.asarray(self.status) == status))

    @property
    def hidden_share(self) -> float:
        """Share of the ground within the outline that nearer ground hides."""
        return float(np.mean(np.asarray(self.status) == Status.hidden_by_terrain))


def polygon_overlap(before: Footprint, after: Footprint) -> float:
    """Share of the area within one outline that lies within another as well, both on the map of the first.

    Hidden ground within an outline counts as covered: `visible_ground` tells which that is. Of an outline that crosses
    itself each part counts once. Raises `ValueError` for an outline that is not whole.
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
    """Which ground within the outline of an image is seen, square by square of `spacing` m: is it in sight of the
    camera, or hidden? Exactly so for the middles of the squares.

    Raises `ValueError` for an outline that is not whole, and for a spacing that is not positive or makes more than four
    million squares.
    """
    import shapely  # a well-kept library for polygons; only who asks for them needs it

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


@eqx.filter_jit
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
    """Places in parts of one size; the last place fills up the last part."""
    numbers = [np.minimum(np.arange(first, first + BATCH), len(places) - 1) for first in range(0, len(places), BATCH)]
    return [places[part] for part in numbers]


@eqx.filter_jit
def _mapped(projection: TransverseMercator, p_ecef: Float[Array, "places 3"]) -> Float[Array, "places 2"]:
    return jax.vmap(lambda p: on_map(projection, p))(p_ecef)


def _outline_on(one: Footprint, projection: TransverseMercator) -> np.ndarray:
    """An outline on another map; in batches of one size, since no two outlines have as many places."""
    p_ecef = np.asarray(one.fix.ecef)
    parts = [np.asarray(_mapped(projection, jnp.asarray(part))) for part in _parts(p_ecef)]
    return np.concatenate(parts)[: len(p_ecef)]


def _polygon(outline: np.ndarray) -> Any:
    import shapely

    return shapely.make_valid(shapely.Polygon(outline))
