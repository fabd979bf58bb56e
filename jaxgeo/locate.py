"""The hall: pixel -> ground, and ground -> pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool

from jaxgeo._checks import as_float64, concrete, require_x64
from jaxgeo._numerics import all_finite, safe_angle, safe_norm, tree_where
from jaxgeo._typing import Flag, Pixel, PixelField, Scalar, ScalarField, StatusCode, Vector3, Vector3Field
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.earth.ray import Ray
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.status import Status, first_failure, status_where
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, FirstHit
from jaxgeo.terrain.polish import polish

NEAR_TANGENT = 1e-3  # rad between the ray and the surface: beyond, a derivative is a thousand times that of a plumb ray
UNIT_TOLERANCE = 1e-6
FIRST_HIT = FirstHit()


class Fix(eqx.Module):
    """A point on the ground, how it is seen, and whether it can be trusted.

    `position` and `ecef` (m) are the same point; `slant_range` in m from the perspective centre; angles in rad:
    `incidence_ellipsoid` between the reversed ray and the ellipsoid's normal there, `incidence_surface` between it and
    the normal of the terrain's own surface, `slope` between that surface and the horizontal. `status` is an int8
    `Status`. What could not be computed is NaN.
    """

    position: Geodetic
    ecef: Vector3Field
    slant_range: ScalarField
    incidence_ellipsoid: ScalarField
    incidence_surface: ScalarField
    slope: ScalarField
    status: Any

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether the fix is an unconditional hit."""
        return jnp.asarray(self.status) == Status.hit

    @property
    def found(self) -> Bool[Array, "..."]:
        """Whether there are coordinates: also near a tangent, after coming in from the side, and at a void's edge."""
        return jnp.isfinite(jnp.asarray(self.slant_range))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and words, in degrees and m, of one fix (or lists of them for a batch)."""
        lat, lon, height = self.position.to_degrees()
        status = np.asarray(self.status)
        words = [Status(int(code)).name for code in status.reshape(-1)]
        return {
            "lat_deg": np.asarray(lat).tolist(),
            "lon_deg": np.asarray(lon).tolist(),
            "height_m": np.asarray(height).tolist(),
            "slant_range_m": np.asarray(self.slant_range).tolist(),
            "incidence_ellipsoid_deg": np.rad2deg(self.incidence_ellipsoid).tolist(),
            "incidence_surface_deg": np.rad2deg(self.incidence_surface).tolist(),
            "slope_deg": np.rad2deg(self.slope).tolist(),
            "status": words[0] if status.ndim == 0 else np.reshape(words, status.shape).tolist(),
        }


class Projection(eqx.Module):
    """Where a ground point lies in an image: `uv` = (column, row) in px, and an int8 `Status`.

    `uv` is NaN where there is no image of the point; a point beside the image keeps its `uv`.
    """

    uv: PixelField
    status: Any

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether the point is seen inside the image."""
        return jnp.asarray(self.status) == Status.hit


def intersect(
    ray: Ray, terrain: AbstractTerrain, *, search: AbstractSearch = FIRST_HIT, throw: bool = False
) -> Fix:
    """Where a ray (ECEF, m, unit direction) meets a terrain: the first point, unless `search` looks for another.

    Differentiable to second order in the ray, the terrain's heights and its grid. A ray that cannot be answered has a
    status and NaN coordinates. Raises `RuntimeError` with 64-bit floats off, `TypeError` on float32, `ValueError` for a
    known direction that is not of unit length, and, with `throw=True`, for a fix that is not `ok`.
    """
    _check_throw(throw, (ray, terrain))
    ray = as_float64(ray, "ray")
    _check_unit(ray.direction)
    fix = _intersect(ray, terrain, search, Status.hit.code)
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
    ray, status = _line_of_sight(sensor, shot, pixel)
    fix = _intersect(ray, terrain, search, status)
    return _thrown(fix) if throw else fix


def at_range(sensor: Sensor, shot: Shot, uv: ArrayLike | Sequence[ArrayLike], slant_range: ArrayLike) -> Fix:
    """The point at a measured slant range (a laser's, m from the perspective centre) along a pixel's line of sight.

    No terrain is asked: `incidence_surface` and `slope` are NaN. Raises as `intersect`; a range that is not positive and
    finite has the status `invalid_input`.
    """
    sensor, shot, pixel = _door(sensor, shot, uv)
    distance = as_float64(slant_range, "slant_range")
    ray, status = _line_of_sight(sensor, shot, pixel)
    usable = jnp.isfinite(distance) & (distance > 0.0)
    distance = jnp.where(usable, distance, 1.0)
    status = first_failure(status, status_where(usable, Status.hit, Status.invalid_input.code))
    position, incidence = _seen_from(ray, ray.at(distance))
    unknown = jnp.full_like(distance, jnp.nan)
    return _mask(Fix(position, ray.at(distance), distance, incidence, unknown, unknown, status), status == Status.hit)


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
    p_ecef = WGS84.to_ecef(point)
    uv, status = sensor.project_ecef(shot, p_ecef)
    if terrain is not None:
        hidden = _is_hidden(sensor.perspective_centre(shot), p_ecef, terrain, hidden_tolerance)
        status = first_failure(status, status_where(hidden, Status.hidden_by_terrain, Status.hit.code))
    keeps = (status == Status.hit) | (status == Status.outside_image) | (status == Status.hidden_by_terrain)
    return Projection(jnp.where(keeps, uv, jnp.nan), status)


def _intersect(ray: Ray, terrain: AbstractTerrain, search: AbstractSearch, status: StatusCode) -> Fix:
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


def _is_hidden(origin: Vector3, p_ecef: Vector3, terrain: AbstractTerrain, tolerance: float) -> Flag:
    """Whether ground lies between the camera and the point; a line of sight that meets only the point's own ground is free."""
    line = p_ecef - origin
    distance = safe_norm(line)
    ray = Ray(origin, line / jnp.where(distance > 0.0, distance, 1.0))
    fix = _intersect(jax.lax.stop_gradient(ray), terrain, FIRST_HIT, Status.hit.code)
    return fix.found & (fix.slant_range < distance - tolerance)


def _door(sensor: Sensor, shot: Shot, uv: ArrayLike | Sequence[ArrayLike]) -> tuple[Sensor, Shot, Pixel]:
    require_x64()
    pixel = uv if hasattr(uv, "dtype") else jnp.stack([jnp.asarray(number) for number in uv])  # pyright: ignore
    sensor, shot, pixel = as_float64(sensor, "sensor"), as_float64(shot, "shot"), as_float64(pixel, "uv")
    if pixel.shape != (2,):
        raise ValueError(
            f"uv must be one pixel (column, row) of shape (2,); got shape {pixel.shape}. "
            "For many pixels use jax.vmap(locate, in_axes=(None, None, 0, None))."
        )
    return sensor, shot, pixel


def _check_unit(direction: Any) -> None:
    known = concrete(direction)
    if known is None or not np.all(np.isfinite(known)):
        return
    length = np.linalg.norm(known, axis=-1)
    if np.any(np.abs(length - 1.0) > UNIT_TOLERANCE):
        raise ValueError(
            f"ray.direction must be a unit vector in ECEF; got one of length {np.max(np.abs(length)):.9g}. "
            "Divide it by its length."
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
