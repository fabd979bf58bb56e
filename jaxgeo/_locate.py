"""Image-to-ground (locate) and ground-to-image (project)."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxgeo._arguments import (
    check_latitude,
    check_on_image,
    check_ray,
    check_terrain,
    check_throw,
    checked_air,
    checked_exposure,
    checked_observation,
    thrown,
)
from jaxgeo._checks import as_array, as_float64, check_is, given_array
from jaxgeo._compile import is_direct, quick_jit
from jaxgeo._intersection import (
    FIRST_HIT,
    hidden_or,
    masked,
    met_apart,
    met_by,
    seen_from_ray,
    sound_air,
    straight_distance,
    visibility,
)
from jaxgeo._numerics import all_finite, finite_or, tree_where
from jaxgeo._typing import Pixel, Scalar, StatusCode, Vector3
from jaxgeo.earth._horizon import hidden_by_earth
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic, check_position
from jaxgeo.earth.ray import Ray
from jaxgeo.fix import Fix, Projection
from jaxgeo.observation import accepts_exposure, accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.exposure import image_of_point, line_of_sight
from jaxgeo.status import Status, first_failure, seen_beside, status_where
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Bracket, ConstantHeight


def intersect(
    ray: Ray,
    terrain: AbstractTerrain,
    *,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    throw: bool = False,
) -> Fix:
    """Intersection of a ray (ECEF, m, unit direction) with a terrain: the first, unless `search` finds another.

    `ray` is one ray, with `origin` (3,) in ECEF m and `direction` (3,) a unit vector; `terrain` a `Dem` or a
    `ConstantHeight`. For many rays: `jax.vmap(intersect, in_axes=(0, None))`. The result is a `Fix`, differentiable to
    second order in the ray, the terrain heights and the grid. Without an intersection the coordinates are NaN and the
    status gives the reason. With an `atmosphere`, `direction` is the apparent direction at the origin, and the ray is
    refracted.
    Raises `RuntimeError` with 64-bit floats off, `TypeError` on float32, `ValueError` for a concrete direction that is
    not of unit length, and, with `throw=True`, for a fix that is not `ok`.
    Inside your own `jit`, pass the terrain as an argument: if closed over, its posts become constants of the program.
    Rays can be sharded over devices; on a mesh with explicit axes, let the compiler shard the intermediate arrays:
    `jax.sharding.auto_axes(jax.vmap(intersect, in_axes=(0, None)), out_sharding=jax.P("rays"))`.

    >>> above = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=1000.0)
    >>> p_ecef = jaxgeo.WGS84.to_ecef(above)
    >>> down = -jaxgeo.WGS84.normal_and_height(p_ecef)[0]
    >>> fix = jaxgeo.intersect(jaxgeo.Ray(p_ecef, down), jaxgeo.ConstantHeight(600.0))
    >>> print(f"{fix.slant_range:.3f} m to the ground")
    400.000 m to the ground
    """
    check_throw(throw, (ray, terrain, atmosphere))
    check_is(ray, Ray, "ray")
    check_terrain(terrain, search)
    air = checked_air(atmosphere if ray.bending is None else ray.bending.air)
    ray = as_float64(Ray(as_array(ray.origin, "ray.origin"), as_array(ray.direction, "ray.direction")), "ray")
    check_ray(ray)
    fix, _ = met_apart(ray, Status.hit.code, terrain, search, air)
    return thrown(fix, lambda: ray.origin, terrain) if throw else fix


@accepts_observation
def locate(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    *,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    throw: bool = False,
) -> Fix:
    """Ground point imaged at pixel `uv` = (column, row) of a shot; pixel centres are at integers.

    `sensor` (camera, gimbal, mount) and `shot` (pose, gimbal readings in rad) are single records, `uv` is (2,) in px,
    `terrain` a `Dem` or a `ConstantHeight`, `search` the terrain search (`FirstHit()` or `Bisection()`). For many
    pixels: `jax.vmap(locate, in_axes=(None, None, 0, None))`. In place of a shot, give a `Trajectory` and the `time` of
    the image in s (default 0); each pixel is then exposed `camera.time_of(uv)` later.
    The result is a `Fix`: position in rad and m above the ellipsoid, ECEF m, slant range, angles, and a status.
    Differentiable to second order in all inputs: pose, trajectory and time, gimbal, mount, camera, pixel, terrain
    posts and `atmosphere`. An `atmosphere` refracts the line of sight (`jaxgeo.Atmosphere()` is the standard
    atmosphere; from 15 km height and at 60 km slant range it moves the fix by 89 m).

    A pixel outside the image or the lens field, or input that is not finite, sets the status and gives NaN. Raises
    `RuntimeError` with 64-bit floats off; `TypeError` for float32 and for arguments of the wrong type; `ValueError` for
    a wrong shape, a concrete latitude beyond a pole, and, with `throw=True`, for a fix that is not `ok`.

    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())  # a drone's
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0))
    >>> fix = jaxgeo.locate(sensor, shot, (1999.5, 1499.5), jaxgeo.ConstantHeight(600.0))
    >>> print(*np.round(fix.position.to_degrees(), 6), round(float(fix.slant_range), 2))
    47.000935 11.000789 600.0 169.71
    >>> sky = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=10.0, roll=0.0))
    >>> above = jaxgeo.locate(sensor, sky, (1999.5, 1499.5), jaxgeo.ConstantHeight(600.0))
    >>> print(bool(above.ok), jaxgeo.Status(int(above.status)).name, above.slant_range)
    False rises_away nan
    """
    check_throw(throw, (sensor, shot, uv, terrain, time, atmosphere))
    check_terrain(terrain, search)
    looked = checked_observation(sensor, shot, time, uv)
    if throw:
        check_on_image(looked[0], looked[-1])
    fix = _locate(*looked, terrain, search, checked_air(atmosphere))
    return thrown(fix, lambda: _line_of_sight(*looked)[0].origin, terrain) if throw else fix


@accepts_observation
def at_range(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    slant_range: ArrayLike,
    *,
    time: ArrayLike | None = None,
    atmosphere: Atmosphere | None = None,
) -> Fix:
    """Point at a measured slant range (laser, m from the perspective centre) along the line of sight of a pixel.

    No terrain is used: `incidence_surface` and `slope` are NaN. An `atmosphere` refracts the line of sight; the lower
    speed of light in air (about 0.3 m per km at sea level) is left to the calibration of the laser. Raises as
    `intersect`; a range that is not positive and finite gives the status `invalid_input`.

    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0))
    >>> hit = jaxgeo.at_range(sensor, shot, (1999.5, 1499.5), 250.0)  # the laser says 250 m
    >>> print(f"{hit.position.height:.2f} m above the ellipsoid")
    543.23 m above the ellipsoid
    """
    looked = checked_observation(sensor, shot, time, uv)
    distance = as_float64(given_array(slant_range, "slant_range", "the distance in m"), "slant_range")
    if distance.shape != ():
        raise ValueError(f"slant_range must be one number in m; got shape {distance.shape}. For many use jax.vmap.")
    return _at_range(*looked, distance, checked_air(atmosphere))


@accepts_exposure
def project(
    sensor: Sensor,
    shot: Shot | Trajectory,
    point: Geodetic,
    *,
    time: ArrayLike | None = None,
    terrain: AbstractTerrain | None = None,
    atmosphere: Atmosphere | None = None,
    hidden_tolerance: float = 0.01,
) -> Projection:
    """Image point (pixel) of a ground point; the inverse of `locate`.

    `point` is one position (rad, m above the ellipsoid), on the ground or not. The result is a `Projection`: `uv` =
    (column, row) in px and a status: `behind_camera`, `outside_image`, `outside_distortion_field`, `below_horizon` (the
    Earth is in the way, whatever the terrain; `uv` is kept), or `hit`. An `atmosphere` refracts the line of sight by
    the same model as in `locate`.

    On a `Trajectory`, with the `time` of the image in s (default 0), a camera that exposes row by row images the point
    at a time that is solved for together with the pixel. If there are several such times (a line that swings back), the
    result is the first on the image among the first three. If there is none, including a tenth of the exposure before
    and after it, the status is `never_seen`, or `outside_trajectory` if the trajectory does not cover the exposure. The
    exposure is sampled twice per record, at 65 to 257 times; much shorter oscillations may be missed.

    With a `terrain`, a point whose line of sight meets ground more than `hidden_tolerance` m before it is
    `hidden_by_terrain`; if visibility cannot be decided (the line of sight leaves the terrain, enters it from the side
    or from below, or passes a void), the status gives the reason. The point keeps its `uv` in all these cases.
    Raises `RuntimeError` with 64-bit floats off, `TypeError` on float32, `ValueError` for a latitude beyond a pole.

    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0))
    >>> seen = jaxgeo.project(sensor, shot, jaxgeo.Geodetic.from_degrees(lat=47.001, lon=11.001, height=600.0))
    >>> print(np.round(seen.uv, 1), bool(seen.ok))
    [2211.  1291.2] True
    >>> behind = jaxgeo.project(sensor, shot, jaxgeo.Geodetic.from_degrees(lat=46.99, lon=10.99, height=600.0))
    >>> print(jaxgeo.Status(int(behind.status)).name)
    behind_camera
    """
    seen_from = checked_exposure(sensor, shot, time)
    check_position(point, "point")
    if terrain is not None:
        check_terrain(terrain, FIRST_HIT)
    point = as_float64(point, "point")
    check_latitude(point, "point")
    tolerance = jnp.asarray(as_float64(hidden_tolerance, "hidden_tolerance"))
    by_parts = terrain is not None and is_direct()  # then the search is that of `locate`, which is compiled once
    return (_project_by_parts if by_parts else _project)(*seen_from, point, terrain, tolerance, checked_air(atmosphere))


def _locate(
    sensor: Sensor,
    shot: Shot | Trajectory,
    time: Scalar,
    pixel: Pixel,
    terrain: AbstractTerrain,
    search: AbstractSearch,
    air: Atmosphere | None,
) -> Fix:
    return met_apart(*_line_of_sight(sensor, shot, time, pixel), terrain, search, air)[0]


def located_anywhere(
    sensor: Sensor,
    shot: Shot | Trajectory,
    time: Scalar,
    pixel: Pixel,
    terrain: AbstractTerrain,
    search: AbstractSearch,
    air: Atmosphere | None,
) -> tuple[Fix, Bracket]:
    """`locate` of checked input, and the search bracket; a pixel outside the image is allowed (measured pixels)."""
    ray, status = _line_of_sight(sensor, shot, time, pixel)
    status = seen_beside(status, ray.direction)
    return met_by(ray, status, terrain, search, air)


@quick_jit
def _at_range(
    sensor: Sensor,
    shot: Shot | Trajectory,
    time: Scalar,
    pixel: Pixel,
    distance: Scalar,
    air: Atmosphere | None,
) -> Fix:
    ray, status = _line_of_sight(sensor, shot, time, pixel)
    air, is_sound = sound_air(air)
    usable = jnp.isfinite(distance) & (distance > 0.0) & is_sound
    status = first_failure(status, status_where(usable, Status.hit, Status.invalid_input.code))
    seen = status == Status.hit
    distance = jnp.where(seen, distance, 1.0)
    ray = tree_where(seen, ray, ConstantHeight(0.0).safe_ray()).through(air)
    along = distance
    for _ in range(0 if air is None else 2):  # the chord of a refracted ray exceeds its range by about 1e-7
        along = along * distance / straight_distance(ray, along)
    position, incidence = seen_from_ray(ray, along)
    unknown = jnp.full_like(distance, jnp.nan)
    return masked(Fix(position, ray.at(along), distance, incidence, unknown, unknown, status), seen)


def _project_by_parts(
    sensor: Sensor,
    shot: Shot | Trajectory,
    time: Scalar,
    point: Geodetic,
    terrain: AbstractTerrain | None,
    tolerance: Scalar,
    air: Atmosphere | None,
) -> Projection:
    seen, origin, p_ecef = _image_of(sensor, shot, time, point, air)
    return seen if terrain is None else _unless_hidden(seen, visibility(origin, p_ecef, terrain, tolerance, air))


_project = quick_jit(_project_by_parts)


@quick_jit
def _image_of(
    sensor: Sensor, shot: Shot | Trajectory, time: Scalar, point: Geodetic, air: Atmosphere | None
) -> tuple[Projection, Vector3, Vector3]:
    """The image of a point as far as no terrain hides it, the perspective centre and the point, ECEF m."""
    air, is_sound = sound_air(air)
    is_valid = all_finite(point) & is_sound
    p_ecef = WGS84.to_ecef(finite_or(point, 0.0))
    uv, status, origin = image_of_point(sensor, shot, time, p_ecef, air)
    status = status_where(~is_valid, Status.invalid_input, status)
    has_image = (status == Status.hit) | (status == Status.outside_image)
    is_hidden = (status == Status.hit) & hidden_by_earth(origin, p_ecef)
    status = status_where(is_hidden, Status.below_horizon, status)
    return Projection(jnp.where(has_image, uv, jnp.nan), status), origin, p_ecef


@quick_jit
def _unless_hidden(seen: Projection, visible: StatusCode) -> Projection:
    return Projection(seen.uv, hidden_or(jnp.asarray(seen.status), visible))


@quick_jit
def _line_of_sight(sensor: Sensor, shot: Shot | Trajectory, time: Scalar, uv: Pixel) -> tuple[Ray, StatusCode]:
    origin, direction, status = line_of_sight(sensor, shot, time, uv)
    return Ray(origin, direction), status
