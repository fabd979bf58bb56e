"""The hall: pixel -> ground, and ground -> pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import as_float64, concrete, require_x64
from jaxgeo._numerics import all_finite, safe_angle, safe_norm, tree_where
from jaxgeo._typing import Flag, Pixel, Scalar, StatusCode, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.earth.ray import Ray
from jaxgeo.fix import Fix, Projection
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.status import Status, first_failure, status_where
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, FirstHit
from jaxgeo.terrain.polish import polish

NEAR_TANGENT = 1e-3  # rad between the ray and the surface: beyond, a derivative is a thousand times that of a plumb ray
UNIT_TOLERANCE = 1e-6
FIRST_HIT = FirstHit()


def intersect(ray: Ray, terrain: AbstractTerrain, *, search: AbstractSearch = FIRST_HIT, throw: bool = False) -> Fix:
    """Where a ray (ECEF, m, unit direction) meets a terrain: the first point, unless `search` looks for another.

    Differentiable to second order in the ray, the terrain's heights and its grid. A ray that cannot be answered has a
    status and NaN coordinates. Raises `RuntimeError` with 64-bit floats off, `TypeError` on float32, `ValueError` for a
    known direction that is not of unit length, and, with `throw=True`, for a fix that is not `ok`.
    Inside a `jit` of your own pass the terrain as an argument: closed over, its posts become constants of the program.
    """
    _check_throw(throw, (ray, terrain))
    ray = as_float64(ray, "ray")
    _check_ray(ray)
    fix = _intersect(ray, Status.hit.code, terrain, search)
    return _thrown(fix) if throw else fix


def locate(
    sensor: Sensor,
    shot: Shot,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    *,
    search: AbstractSearch = FIRST_HIT,
    throw: bool = False,
) -> Fix:
    """The ground point that pixel `uv` = (column, row) of a shot sees; pixel centres lie at integers.

    One pixel and one shot; `jax.vmap` makes the crowd. Differentiable to second order in everything: pose, gimbal,
    mount, camera, pixel and posts. Raises as `intersect`; a pixel outside the image or outside the lens's field, and
    input that is not finite, set the status.
    """
    _check_throw(throw, (sensor, shot, uv, terrain))
    sensor, shot, pixel = _door(sensor, shot, uv)
    fix = _locate(sensor, shot, pixel, terrain, search)
    return _thrown(fix) if throw else fix


def at_range(sensor: Sensor, shot: Shot, uv: ArrayLike | Sequence[ArrayLike], slant_range: ArrayLike) -> Fix:
    """The point at a measured slant range (a laser's, m from the perspective centre) along a pixel's line of sight.

    No terrain is asked: `incidence_surface` and `slope` are NaN. Raises as `intersect`; a range that is not positive
    and finite has the status `invalid_input`.
    """
    sensor, shot, pixel = _door(sensor, shot, uv)
    return _at_range(sensor, shot, pixel, as_float64(slant_range, "slant_range"))


def project(
    sensor: Sensor,
    shot: Shot,
    point: Geodetic,
    *,
    terrain: AbstractTerrain | None = None,
    hidden_tolerance: float = 0.01,
) -> Projection:
    """The pixel that sees a ground point; the inverse of `locate`.

    With a `terrain`, a point whose line of sight meets ground more than `hidden_tolerance` m before it is
    `hidden_by_terrain` (it keeps its `uv`). Raises `RuntimeError` with 64-bit floats off and `TypeError` on float32.
    """
    sensor, shot, point = as_float64(sensor, "sensor"), as_float64(shot, "shot"), as_float64(point, "point")
    return _project(sensor, shot, point, terrain, as_float64(hidden_tolerance, "hidden_tolerance"))


@jax.jit
def _locate(sensor: Sensor, shot: Shot, pixel: Pixel, terrain: AbstractTerrain, search: AbstractSearch) -> Fix:
    return _intersect(*_line_of_sight(sensor, shot, pixel), terrain, search)


@jax.jit
def _at_range(sensor: Sensor, shot: Shot, pixel: Pixel, distance: Scalar) -> Fix:
    ray, status = _line_of_sight(sensor, shot, pixel)
    usable = jnp.isfinite(distance) & (distance > 0.0)
    distance = jnp.where(usable, distance, 1.0)
    status = first_failure(status, status_where(usable, Status.hit, Status.invalid_input.code))
    position, incidence = _seen_from(ray, ray.at(distance))
    unknown = jnp.full_like(distance, jnp.nan)
    return _mask(Fix(position, ray.at(distance), distance, incidence, unknown, unknown, status), status == Status.hit)


@jax.jit
def _project(
    sensor: Sensor, shot: Shot, point: Geodetic, terrain: AbstractTerrain | None, tolerance: Scalar
) -> Projection:
    p_ecef = WGS84.to_ecef(point)
    uv, status = sensor.project_ecef(shot, p_ecef)
    if terrain is not None:
        hidden = _is_hidden(sensor.perspective_centre(shot), p_ecef, terrain, tolerance)
        status = first_failure(status, status_where(hidden, Status.hidden_by_terrain, Status.hit.code))
    keeps = (status == Status.hit) | (status == Status.outside_image) | (status == Status.hidden_by_terrain)
    return Projection(jnp.where(keeps, uv, jnp.nan), status)


@jax.jit
def _intersect(ray: Ray, status: StatusCode, terrain: AbstractTerrain, search: AbstractSearch) -> Fix:
    """Search, polish and describe; `status` is what is already known to be wrong with the ray."""
    length = safe_norm(jnp.where(jnp.isfinite(ray.direction), ray.direction, 0.0))
    is_valid = all_finite(ray) & terrain.is_valid() & (jnp.abs(length - 1.0) <= UNIT_TOLERANCE)
    status = first_failure(status, status_where(is_valid, Status.hit, Status.invalid_input.code))
    stand_in = terrain.safe_ray()
    usable = status == Status.hit
    ray = tree_where(usable, Ray(ray.origin, ray.direction / jnp.where(is_valid, length, 1.0)), stand_in)

    bracket = terrain.bracket(ray, search)
    status = first_failure(status, bracket.status)
    found = _has_point(status)
    bracket = tree_where(found, bracket, jax.tree.map(jnp.zeros_like, bracket))
    ray = tree_where(found, ray, stand_in)
    distance = polish(ray, terrain, bracket)
    p_ecef = ray.at(distance)
    position, incidence = _seen_from(ray, p_ecef)
    slope, incidence_surface = _surface_angles(ray, terrain, p_ecef, bracket)
    grazing = found & (jnp.abs(jnp.cos(incidence_surface)) < NEAR_TANGENT)
    status = status_where(grazing & (status == Status.hit), Status.near_tangent, status)
    return _mask(Fix(position, p_ecef, distance, incidence, incidence_surface, slope, status), found)


def _line_of_sight(sensor: Sensor, shot: Shot, uv: Pixel) -> tuple[Ray, StatusCode]:
    origin, direction, status = sensor.ray_ecef(shot, uv)
    return Ray(origin, direction), status


def _seen_from(ray: Ray, p_ecef: Vector3) -> tuple[Geodetic, Scalar]:
    normal, _ = WGS84.normal_and_height(p_ecef)
    return WGS84.to_geodetic(p_ecef), safe_angle(-ray.direction, normal)


def _surface_angles(ray: Ray, terrain: AbstractTerrain, p_ecef: Vector3, bracket: Any) -> tuple[Scalar, Scalar]:
    """Slope of the surface and incidence on it: its normal is the gradient of the clearance."""
    gradient = jax.grad(terrain.clearance)(p_ecef, bracket.cell)
    up, _ = WGS84.normal_and_height(p_ecef)
    return safe_angle(gradient, up), safe_angle(-ray.direction, gradient)


def _has_point(status: StatusCode) -> Flag:
    return (
        (status == Status.hit)
        | (status == Status.near_tangent)
        | (status == Status.enters_from_side)
        | (status == Status.hits_void)
    )


def _mask(fix: Fix, found: Flag) -> Fix:
    """NaN for every number of a fix that was not found; its status stays."""
    numbers = jax.tree.map(
        lambda x: jnp.where(found, x, jnp.nan),
        (fix.position, fix.ecef, fix.slant_range, fix.incidence_ellipsoid, fix.incidence_surface, fix.slope),
    )
    return Fix(*numbers, status=fix.status)


def _is_hidden(origin: Vector3, p_ecef: Vector3, terrain: AbstractTerrain, tolerance: Scalar) -> Flag:
    """Whether ground lies between the camera and the point, not counting the point's own."""
    line = p_ecef - origin
    distance = safe_norm(line)
    ray = Ray(origin, line / jnp.where(distance > 0.0, distance, 1.0))
    fix = _intersect(jax.lax.stop_gradient(ray), Status.hit.code, terrain, FIRST_HIT)
    return fix.found & (fix.slant_range < distance - tolerance)


def _door(sensor: Sensor, shot: Shot, uv: ArrayLike | Sequence[ArrayLike]) -> tuple[Sensor, Shot, Pixel]:
    require_x64()
    pixel: Any = uv if hasattr(uv, "dtype") else jnp.stack([jnp.asarray(number) for number in uv])  # pyright: ignore
    sensor, shot, pixel = as_float64(sensor, "sensor"), as_float64(shot, "shot"), as_float64(pixel, "uv")
    if pixel.shape != (2,):
        raise ValueError(
            f"uv must be one pixel (column, row) of shape (2,); got shape {pixel.shape}. "
            "For many pixels use jax.vmap(locate, in_axes=(None, None, 0, None))."
        )
    return sensor, shot, pixel


def _check_ray(ray: Ray) -> None:
    for name, vector in (("origin", ray.origin), ("direction", ray.direction)):
        if jnp.shape(vector) != (3,):
            raise ValueError(
                f"ray.{name} must be one vector of shape (3,), ECEF; got shape {jnp.shape(vector)}. "
                "For many rays use jax.vmap(intersect, in_axes=(0, None))."
            )
    known = concrete(ray.direction)
    if known is None or not np.all(np.isfinite(known)):
        return
    length = float(np.linalg.norm(known))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise ValueError(
            f"ray.direction must be a unit vector in ECEF; got one of length {length:.9g}. Divide it by its length."
        )


def _check_throw(throw: bool, arguments: Any) -> None:
    if throw and any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments)):
        raise ValueError(
            "throw=True needs values that are known now, but these are traced by JAX (inside jit, vmap or grad), where "
            "no exception can be raised. Leave throw off and look at `Fix.status`."
        )


def _thrown(fix: Fix) -> Fix:
    status = Status(int(np.asarray(fix.status)))
    if status is not Status.hit:
        raise ValueError(f"{status.name}: {status.message}")
    return fix
