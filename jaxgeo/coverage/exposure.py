"""Planned images: a sensor at an exposure time, and the ground intersections of its pixels."""

from __future__ import annotations

from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._arguments import checked_exposure
from jaxgeo._checks import check_is
from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._locate import locate
from jaxgeo._numerics import dot
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField, Vector3
from jaxgeo.earth import WGS84, Atmosphere, TransverseMercator
from jaxgeo.fix import Fix
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import AbstractTerrain

Places = Float[Array, "places 2"]
Along = Literal["columns", "rows"]  # the image axis along the flight


class MovingExposure(Record):
    """An image of a moving sensor: a `Trajectory` and the exposure `time` in s."""

    trajectory: Trajectory
    time: ScalarField

    @property
    def shot(self) -> Shot:
        """The shot at the time of the image."""
        return self.trajectory.at(self.time)


Image = Shot | MovingExposure


def motion_of(image: Image) -> tuple[Shot | Trajectory, Any]:
    """(shot or trajectory, time) as `locate` takes them. Raises `TypeError` if not a shot or an exposure."""
    if isinstance(image, Shot):
        return image, None
    check_is(
        image, MovingExposure, "image", "Of one moment it is a Shot; of a Trajectory, MovingExposure(trajectory, time)."
    )
    return image.trajectory, image.time


def checked_image(sensor: Sensor, image: Image) -> tuple[Sensor, Image]:
    """Sensor and image in float64, with the input checks of `locate`."""
    sensor, motion, time = checked_exposure(sensor, *motion_of(image))
    return sensor, motion if isinstance(motion, Shot) else MovingExposure(motion, time)


def seen_at(
    sensor: Sensor, image: Image, places: Places, terrain: AbstractTerrain, air: Atmosphere | None = None
) -> Fix:
    """Fixes of pixels (n, 2) of an image, including its edges."""
    motion, time = motion_of(image)

    def one(uv: Float[Array, "2"]) -> Fix:
        return locate(sensor, motion, uv, terrain, time=time, search=FIRST_HIT, atmosphere=air)

    return jax.vmap(one)(places)


def platform_ecef(image: Image) -> Vector3:
    """Platform position at the exposure time, ECEF m."""
    return WGS84.to_ecef((image if isinstance(image, Shot) else image.shot).pose.position)


def local_projection(image: Image) -> TransverseMercator:
    """Gauss-Krueger map with the platform's meridian; scale error within 30 km of it 1.1e-5."""
    shot = image if isinstance(image, Shot) else image.shot
    return TransverseMercator.gauss_krueger(shot.pose.position.lon)


def on_map(projection: Any, p_ecef: Vector3) -> Float[Array, "2"]:
    """(easting, northing) in m of a point in ECEF m."""
    if isinstance(projection, TransverseMercator):  # from the normal: no date line, no pole
        normal, _ = WGS84.normal_and_height(p_ecef)
        return jnp.stack(projection.forward_from_normal(normal))
    position = WGS84.to_geodetic(p_ecef)
    return jnp.stack(projection.forward(position.lat, position.lon))


def image_size(sensor: Sensor) -> tuple[int, int]:
    """(columns, rows) of the sensor's image."""
    camera: Any = sensor.camera
    return camera.width, camera.height


def end_places(sensor: Sensor, along: Along) -> Places:
    """Near and far end of an image, in either order: middles of its two edges parallel to the flight."""
    size, across = image_size(sensor), 1 if along == "columns" else 0
    middle = 0.5 * (jnp.array(size, jnp.float64) - 1.0)
    return jnp.stack([middle.at[across].set(end) for end in (-0.5, size[across] - 0.5)])


@quick_filter_jit
def near_edge(
    sensor: Sensor, image: Image, terrain: AbstractTerrain, along: Along, atmosphere: Atmosphere | None = None
) -> Fix:
    """Fix of the middle of an image's near edge: the nearer of its two edges parallel to the flight.

    `along` names the image axis along the flight. If neither end sees ground, the fix of one of them.
    """
    fix = seen_at(sensor, image, end_places(sensor, along), terrain, atmosphere)
    reach = jnp.where(counts_as_fix(fix.status), fix.slant_range, jnp.inf)
    return jax.tree.map(lambda x: x[jnp.argmin(reach)], fix)


def near_length(
    sensor: Sensor, image: Image, terrain: AbstractTerrain, along: Along, ahead: Vector3, air: Atmosphere | None
) -> tuple[Scalar, Scalar]:
    """(length in m of an image's near edge on the ground along a unit vector in ECEF, between its corners; ground
    height in m). NaN if a corner sees no ground."""
    width, height = image_size(sensor)
    corners = jnp.array([[x, y] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    fix = seen_at(sensor, image, corners, terrain, air)
    sides = ((0, 2), (1, 3)) if along == "columns" else ((0, 1), (2, 3))
    seen = counts_as_fix(fix.status)
    reach = [jnp.where(seen[i] & seen[j], fix.slant_range[i] + fix.slant_range[j], jnp.inf) for i, j in sides]
    lengths = [jnp.abs(dot(fix.ecef[j] - fix.ecef[i], ahead)) for i, j in sides]
    heights = [0.5 * (fix.position.height[i] + fix.position.height[j]) for i, j in sides]
    first = reach[0] <= reach[1]
    return jnp.where(first, lengths[0], lengths[1]), jnp.where(first, heights[0], heights[1])
