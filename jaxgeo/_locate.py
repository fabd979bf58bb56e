"""Image-to-ground (locate) and ground-to-image (project)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._arguments import (
    UNIT_TOLERANCE,
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
from jaxgeo._checks import as_array, as_float64, check_is
from jaxgeo._compile import quick_jit
from jaxgeo._numerics import all_finite, dot, finite_or, safe_angle, safe_norm, tree_where
from jaxgeo._typing import Flag, Pixel, Scalar, StatusCode, StatusCodes, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.earth.ray import Ray
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.fix import Fix, Projection
from jaxgeo.observation import accepts_exposure, accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.exposure import image_of_point, line_of_sight
from jaxgeo.status import Status, first_failure, seen_beside, status_where
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Bracket, ConstantHeight, FirstHit
from jaxgeo.terrain.polish import polish
from jaxgeo.terrain.search.ground import Ground

NEAR_TANGENT = 1e-3  # rad between ray and surface; below it, derivatives exceed a vertical ray's a thousandfold
FIRST_HIT = FirstHit()


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
    return thrown(fix) if throw else fix


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
    return thrown(fix) if throw else fix


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
    distance = as_float64(as_array(slant_range, "slant_range"), "slant_range")
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
    (column, row) in px and a status: `behind_camera`, `outside_image`, `outside_distortion_field`, or `hit`. An
    `atmosphere` refracts the line of sight by the same model as in `locate`.

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
    check_is(point, Geodetic, "point")
    if terrain is not None:
        check_terrain(terrain, FIRST_HIT)
    point = as_float64(point, "point")
    check_latitude(point, "point")
    tolerance = jnp.asarray(as_float64(hidden_tolerance, "hidden_tolerance"))
    return _project(*seen_from, point, terrain, tolerance, checked_air(atmosphere))


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
    air, is_sound = _sound(air)
    usable = jnp.isfinite(distance) & (distance > 0.0) & is_sound
    status = first_failure(status, status_where(usable, Status.hit, Status.invalid_input.code))
    seen = status == Status.hit
    distance = jnp.where(seen, distance, 1.0)
    ray = tree_where(seen, ray, ConstantHeight(0.0).safe_ray()).through(air)
    along = distance
    for _ in range(0 if air is None else 2):  # the chord of a refracted ray exceeds its range by about 1e-7
        along = along * distance / _straight_distance(ray, along)
    position, incidence = _seen_from(ray, along)
    unknown = jnp.full_like(distance, jnp.nan)
    return _mask(Fix(position, ray.at(along), distance, incidence, unknown, unknown, status), seen)


@quick_jit
def _project(
    sensor: Sensor,
    shot: Shot | Trajectory,
    time: Scalar,
    point: Geodetic,
    terrain: AbstractTerrain | None,
    tolerance: Scalar,
    air: Atmosphere | None,
) -> Projection:
    air, is_sound = _sound(air)
    is_valid = all_finite(point) & is_sound
    p_ecef = WGS84.to_ecef(finite_or(point, 0.0))
    uv, status, origin = image_of_point(sensor, shot, time, p_ecef, air)
    status = status_where(~is_valid, Status.invalid_input, status)
    has_image = (status == Status.hit) | (status == Status.outside_image)
    if terrain is not None:
        status = first_failure(status, visibility(origin, p_ecef, terrain, tolerance, air))
    return Projection(jnp.where(has_image, uv, jnp.nan), status)


def met_by(
    ray: Ray, status: StatusCode, terrain: AbstractTerrain, search: AbstractSearch, air: Atmosphere | None
) -> tuple[Fix, Bracket]:
    """Fix of a ray, and its search bracket: terrain search, root refinement, viewing angles.

    `status` is that of the straight ray before the search.
    """
    terrain, is_sound = terrain.made_safe()
    air, air_is_sound = _sound(air)
    length = safe_norm(jnp.where(jnp.isfinite(ray.direction), ray.direction, 0.0))
    is_valid = is_sound & air_is_sound & all_finite(ray) & (jnp.abs(length - 1.0) <= UNIT_TOLERANCE)
    status = first_failure(status, status_where(is_valid, Status.hit, Status.invalid_input.code))
    stand_in = terrain.safe_ray()
    usable = status == Status.hit
    ray = tree_where(usable, Ray(ray.origin, ray.direction / jnp.where(is_valid, length, 1.0)), stand_in).through(air)

    searched = terrain.bracket(ray, search)
    status = first_failure(status, searched.status)
    found = has_point(status)
    bracket = tree_where(found, searched, jax.tree.map(jnp.zeros_like, searched))
    ray = tree_where(found, ray, stand_in.through(air))
    distance = polish(ray, terrain, bracket)
    p_ecef = ray.at(distance)
    position, incidence = _seen_from(ray, distance)
    slope, incidence_surface = _surface_angles(ray, terrain, distance, bracket)
    grazing = found & (jnp.abs(jnp.cos(incidence_surface)) < NEAR_TANGENT)
    status = status_where(grazing & (status == Status.hit), Status.near_tangent, status)
    slant_range = _straight_distance(ray, distance)
    fix = Fix(position, p_ecef, slant_range, incidence, incidence_surface, slope, status)
    return _mask(fix, found), searched


# A program of its own where it is called directly: one search for all cameras, gimbals and shots.
met_apart = quick_jit(met_by)


def touched_by(
    ray: Ray, status: StatusCode, terrain: AbstractTerrain, search: AbstractSearch
) -> tuple[Vector3, StatusCode]:
    """(point in ECEF m, or the ray origin if there is none; status) as `met_by`, without derivatives.

    For batches of straight rays and a search accurate enough that one exact Newton step converges.
    """
    ray, status = _checked_ray(ray, status, terrain)
    return _touched(ray, status, terrain.bracket(ray, search), terrain)


def touched_by_each(
    rays: Ray, status: StatusCodes, ground: Ground, search: FirstHit
) -> tuple[Float[Array, "rays 3"], StatusCodes]:
    """`touched_by` of many rays (leading axis) over one ground."""
    rays, status = ground.each(_checked_ray, rays, status)
    brackets = search.brackets(*jax.lax.stop_gradient((rays, ground)))
    return ground.each(_touched, rays, status, brackets)


def _checked_ray(ray: Ray, status: StatusCode, terrain: AbstractTerrain) -> tuple[Ray, StatusCode]:
    """A straight ray, or a substitute unless its status and values are sound; its status."""
    is_valid = all_finite(ray) & (jnp.abs(dot(ray.direction, ray.direction) - 1.0) <= UNIT_TOLERANCE)
    status = first_failure(status, status_where(is_valid, Status.hit, Status.invalid_input.code))
    return tree_where(status == Status.hit, Ray(ray.origin, ray.direction), terrain.safe_ray()), status


def _touched(ray: Ray, status: StatusCode, bracket: Bracket, terrain: AbstractTerrain) -> tuple[Vector3, StatusCode]:
    """(point, status) of a ray after its search, by one Newton step."""
    status = first_failure(status, bracket.status)
    value, gradient = jax.value_and_grad(terrain.clearance)(ray.at(bracket.near), bracket.cell)
    slope = dot(gradient, ray.direction)
    step = jnp.where(slope < 0.0, value / jnp.where(slope < 0.0, slope, -1.0), 0.0)
    grazes = slope * slope < NEAR_TANGENT**2 * dot(gradient, gradient)
    status = status_where(grazes & (status == Status.hit), Status.near_tangent, status)
    return ray.at(bracket.near - step), status


@quick_jit
def _line_of_sight(sensor: Sensor, shot: Shot | Trajectory, time: Scalar, uv: Pixel) -> tuple[Ray, StatusCode]:
    origin, direction, status = line_of_sight(sensor, shot, time, uv)
    return Ray(origin, direction), status


def _sound(air: Atmosphere | None) -> tuple[Atmosphere | None, Flag]:
    """The atmosphere with non-finite values replaced, and whether all were finite."""
    return finite_or(air, 1.0), all_finite(air)


def _straight_distance(ray: Ray, distance: Scalar) -> Scalar:
    """Straight-line distance in m from the origin to the point at `distance` along the ray."""
    return distance if ray.bending is None else safe_norm(ray.at(distance) - ray.origin)


def _seen_from(ray: Ray, distance: Scalar) -> tuple[Geodetic, Scalar]:
    p_ecef = ray.at(distance)
    normal, _ = WGS84.normal_and_height(p_ecef)
    return WGS84.to_geodetic(p_ecef), safe_angle(-ray.heading_at(distance), normal)


def _surface_angles(ray: Ray, terrain: AbstractTerrain, distance: Scalar, bracket: Any) -> tuple[Scalar, Scalar]:
    """Slope of the surface and incidence angle; the surface normal is the gradient of the clearance."""
    p_ecef = ray.at(distance)
    gradient = jax.grad(terrain.clearance)(p_ecef, bracket.cell)
    up, _ = WGS84.normal_and_height(p_ecef)
    return safe_angle(gradient, up), safe_angle(-ray.heading_at(distance), gradient)


def has_point(status: StatusCode) -> Flag:
    """Whether a fix with this status has coordinates."""
    return (
        (status == Status.hit)
        | (status == Status.near_tangent)
        | (status == Status.enters_from_side)
        | (status == Status.hits_void)
    )


def _mask(fix: Fix, found: Flag) -> Fix:
    """The fix with NaN for all values but the status if not `found`."""
    numbers = jax.tree.map(
        lambda x: jnp.where(found, x, jnp.nan),
        (fix.position, fix.ecef, fix.slant_range, fix.incidence_ellipsoid, fix.incidence_surface, fix.slope),
    )
    return Fix(*numbers, status=fix.status)


def visibility(
    origin: Vector3, p_ecef: Vector3, terrain: AbstractTerrain, tolerance: Scalar, air: Atmosphere | None
) -> StatusCode:
    """Visibility of a point over terrain: `hit`, `hidden_by_terrain`, or why it is undecided."""
    line = (p_ecef if air is None else apparent_point(origin, p_ecef, air)) - origin
    distance, straight = safe_norm(line), safe_norm(p_ecef - origin)
    ray = Ray(origin, line / jnp.where(distance > 0.0, distance, 1.0))
    fix, bracket = met_by(jax.lax.stop_gradient(ray), Status.hit.code, terrain, FIRST_HIT, air)
    ahead = jnp.where(fix.found, straight - fix.slant_range, distance - bracket.lower)
    return _in_sight(jnp.asarray(fix.status), ahead > tolerance)


def sight_along(origin: Vector3, p_ecef: Vector3, terrain: AbstractTerrain, tolerance: Scalar) -> StatusCode:
    """`visibility` without atmosphere, for batches: the intersection is refined by one step only."""
    line = p_ecef - origin
    distance = safe_norm(line)
    ray = Ray(origin, line / jnp.where(distance > 0.0, distance, 1.0))
    met, status = touched_by(ray, Status.hit.code, terrain, FIRST_HIT)
    ahead = jnp.where(has_point(status), distance - safe_norm(met - origin), distance)
    return _in_sight(status, ahead > tolerance)


def _in_sight(met: StatusCode, is_nearer: Flag) -> StatusCode:
    """Visibility of a point from the status of a ray towards it, and whether the ray stops before the point."""
    is_ground = has_point(met) & (met != Status.hits_void) | (met == Status.enters_below_terrain)
    sees_past = (met == Status.rises_away) | (met == Status.hit) | (met == Status.near_tangent)
    sees_past |= ~is_nearer & ((met == Status.hits_void) | (met == Status.leaves_terrain))
    sees_past |= ~is_nearer & (met == Status.enters_below_terrain)
    unsettled = jnp.where(sees_past, Status.hit.code, met)
    return status_where(is_nearer & is_ground, Status.hidden_by_terrain, unsettled)
