"""Comparison of reported frame centres and corners with the sensor's own lines of sight."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._numerics import safe_norm
from jaxgeo._typing import Vector3
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu, R_ecef_from_ned
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.acquisitions.st0601 import label
from jaxgeo.sensor import FrameCamera, Sensor, Shot
from jaxgeo.sensor.sensor import Sight

FULL_CORNER, OFFSET_CORNER = 82, 26  # tags of the first (upper left) latitude; longitude follows, corners clockwise


class Comparison(NamedTuple):
    """Differences for n exposures; NaN if the file reports nothing, or if the axis does not intersect the ground.

    - `slant_range`: m, reported minus the distance from the perspective centre to the reported frame centre.
    - `east`, `north`: m, from the reported centre to where the optical axis meets the horizontal plane through it.
    - `azimuth`, `elevation`: rad, the axis minus the direction to the reported centre, seen from the sensor; azimuth
      is the component across the line of sight, the difference times the cosine of the elevation.
    - `turn`: rad, clockwise rotation of the reported corners relative to those of the sensor's image.
    """

    slant_range: np.ndarray
    east: np.ndarray
    north: np.ndarray
    azimuth: np.ndarray
    elevation: np.ndarray
    turn: np.ndarray


def compare_reported(acquisition: Acquisition) -> Comparison:
    """Differences between the optical axis and the reported image centre, and between image and reported corners.

    Raises `ValueError` for an acquisition without a camera, or of files without reported centres.
    """
    if acquisition.sensor is None or acquisition.reported is None:
        missing = "no camera" if acquisition.sensor is None else "no centres of images"
        raise ValueError(f"{acquisition.path}: there is {missing} to compare with.")
    stated = acquisition.reported
    found = _apart(acquisition.sensor, acquisition.shots, stated.centre, reported_corners(acquisition))
    distance, *rest = (np.asarray(x) for x in found)
    return Comparison(stated.slant_range - distance, *rest)


def reported_corners(acquisition: Acquisition) -> np.ndarray:
    """Latitudes and longitudes (n, 4, 2) of the reported corners, rad: absolute, else from their offsets, else NaN."""
    assert acquisition.reported is not None
    tags = acquisition.tags or ({},) * len(acquisition)

    def numbers(first: int) -> np.ndarray:
        names = [label(first + k) for k in range(8)]
        found = [[one.get(name) for name in names] for one in tags]
        plain = [[x if isinstance(x, float) else np.nan for x in row] for row in found]
        return np.radians(np.array(plain, np.float64)).reshape(-1, 4, 2)

    centre = acquisition.reported.centre
    full = numbers(FULL_CORNER)
    by_offset = numbers(OFFSET_CORNER) + np.stack([centre.lat, centre.lon], axis=-1)[:, None, :]
    return np.where(np.isfinite(full), full, by_offset)


@jax.jit
@jax.vmap
def _apart(sensor: Sensor, shot: Shot, centre: Geodetic, corners: jax.Array) -> tuple[jax.Array, ...]:
    """(distance of the centre, east, north, azimuth, elevation, turn) of one exposure, as in `Comparison`."""
    sight = sensor.sight(shot)
    axis = sight.R_ecef_from_camera @ sensor.camera.axis()
    to_centre = WGS84.to_ecef(centre) - sight.centre
    R_enu_from_ecef, R_ned_from_ecef = R_ecef_from_enu(centre).T, R_ecef_from_ned(shot.pose.position).T
    axis_enu, centre_enu = R_enu_from_ecef @ axis, R_enu_from_ecef @ to_centre
    comes_down = axis_enu[2] * centre_enu[2] > 0.0
    reach = centre_enu[2] / jnp.where(comes_down, axis_enu[2], 1.0)
    miss = jnp.where(comes_down, reach * axis_enu - centre_enu, jnp.nan)
    (azimuth, elevation), (stated_azimuth, stated_elevation) = (
        _angles(R_ned_from_ecef @ direction) for direction in (axis, to_centre)
    )
    across = _wrapped(azimuth - stated_azimuth) * jnp.cos(stated_elevation)
    turn = _turn(sensor, sight, Geodetic(lat=corners[:, 0], lon=corners[:, 1], height=centre.height))
    distance = jnp.where(jnp.all(jnp.isfinite(to_centre)), safe_norm(to_centre), jnp.nan)  # `safe_norm` of NaN is zero
    return distance, miss[0], miss[1], across, elevation - stated_elevation, turn


def _turn(sensor: Sensor, sight: Sight, corners: Geodetic) -> jax.Array:
    """The least-squares rotation from the image corners to those on the ground, as seen from the sensor."""
    camera = sensor.camera
    if not isinstance(camera, FrameCamera):
        return jnp.asarray(jnp.nan)
    right, below = camera.width - 0.5, camera.height - 0.5
    own = jnp.array([[-0.5, -0.5], [right, -0.5], [right, below], [-0.5, below]])
    rays = jax.vmap(lambda uv: camera.ray(uv)[0])(own)
    places = jax.vmap(
        lambda lat, lon: sight.to_camera(WGS84.to_ecef(Geodetic(lat=lat, lon=lon, height=corners.height)))
    )
    own, other = (_about_middle(one) for one in (rays, places(corners.lat, corners.lon)))
    return jnp.arctan2(jnp.sum(own[:, 0] * other[:, 1] - own[:, 1] * other[:, 0]), jnp.sum(own * other))


def _about_middle(p_camera: jax.Array) -> jax.Array:
    """Points in the camera frame as (right, down) in the image plane, about their mean; NaN behind the camera."""
    depth = jnp.where(p_camera[:, 2:] > 0.0, p_camera[:, 2:], jnp.nan)
    plane = p_camera[:, :2] / depth
    return plane - jnp.mean(plane, axis=0, keepdims=True)


def _angles(v_ned: Vector3) -> tuple[jax.Array, jax.Array]:
    """(azimuth, elevation) of a direction, rad."""
    return jnp.arctan2(v_ned[1], v_ned[0]), jnp.arctan2(-v_ned[2], safe_norm(v_ned[:2]))


def _wrapped(angle: jax.Array) -> jax.Array:
    """An angle in [-pi, pi)."""
    return jnp.remainder(angle + jnp.pi, 2.0 * jnp.pi) - jnp.pi
