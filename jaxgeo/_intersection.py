"""Where a ray meets the ground, and whether ground hides a point: search, exact root, angles, status."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._arguments import (
    UNIT_TOLERANCE,
)
from jaxgeo._compile import quick_jit
from jaxgeo._numerics import all_finite, dot, finite_or, safe_angle, safe_norm, tree_where
from jaxgeo._typing import Flag, Scalar, StatusCode, StatusCodes, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.earth.ray import Ray
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.fix import Fix
from jaxgeo.status import Status, first_failure, status_where
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, Bracket, FirstHit
from jaxgeo.terrain.polish import polish
from jaxgeo.terrain.search.ground import Ground

NEAR_TANGENT = 1e-3  # rad between ray and surface; below it, derivatives exceed a vertical ray's a thousandfold
FIRST_HIT = FirstHit()


def met_by(
    ray: Ray, status: StatusCode, terrain: AbstractTerrain, search: AbstractSearch, air: Atmosphere | None
) -> tuple[Fix, Bracket]:
    """Fix of a ray, and its search bracket: terrain search, root refinement, viewing angles.

    `status` is that of the straight ray before the search.
    """
    terrain, is_sound = terrain.made_safe()
    air, air_is_sound = sound_air(air)
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
    position, incidence, incidence_surface, slope, grazes = _seen_on_surface(ray, terrain, distance, bracket)
    status = status_where(found & grazes & (status == Status.hit), Status.near_tangent, status)
    slant_range = straight_distance(ray, distance)
    fix = Fix(position, ray.at(distance), slant_range, incidence, incidence_surface, slope, status)
    return masked(fix, found), searched


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
    clearance = jax.value_and_grad(_clearance_of(terrain, bracket), (0, 1, 2))
    value, gradient = clearance(*ray.components_at(bracket.near))
    slope = dot(gradient, ray.direction)
    step = jnp.where(slope < 0.0, value / jnp.where(slope < 0.0, slope, -1.0), 0.0)
    grazes = slope * slope < NEAR_TANGENT**2 * dot(gradient, gradient)
    status = status_where(grazes & (status == Status.hit), Status.near_tangent, status)
    return ray.at(bracket.near - step), status


def sound_air(air: Atmosphere | None) -> tuple[Atmosphere | None, Flag]:
    """The atmosphere with non-finite values replaced, and whether all were finite."""
    return finite_or(air, 1.0), all_finite(air)


def straight_distance(ray: Ray, distance: Scalar) -> Scalar:
    """Straight-line distance in m from the origin to the point at `distance` along the ray."""
    return distance if ray.bending is None else safe_norm(ray.at(distance) - ray.origin)


def seen_from_ray(ray: Ray, distance: Scalar) -> tuple[Geodetic, Scalar]:
    """Position at a range along a ray, and the angle there between the line back and the ellipsoid's normal."""
    *normal, height = WGS84.normal_and_height_of(*ray.components_at(distance))
    return WGS84.with_normal(normal, height), safe_angle(_line_back(ray, distance), normal)


def _seen_on_surface(
    ray: Ray, terrain: AbstractTerrain, distance: Scalar, bracket: Bracket
) -> tuple[Geodetic, Scalar, Scalar, Scalar, Flag]:
    """`seen_from_ray`, incidence angle and slope of the surface, and whether the ray is `near_tangent` to it.

    By components, see `Ray.components_at`. The surface normal is the gradient of the clearance.
    """
    p_ecef = ray.components_at(distance)
    *normal, height = WGS84.normal_and_height_of(*p_ecef)
    back = _line_back(ray, distance)

    gradient = jax.grad(_clearance_of(terrain, bracket), (0, 1, 2))(*p_ecef)
    across = dot(gradient, back)
    grazes = across * across < NEAR_TANGENT**2 * (dot(gradient, gradient) * dot(back, back))
    position, incidence = WGS84.with_normal(normal, height), safe_angle(back, normal)
    return position, incidence, safe_angle(back, gradient), safe_angle(gradient, normal), grazes


def _clearance_of(terrain: AbstractTerrain, bracket: Bracket) -> Callable[[Scalar, Scalar, Scalar], Scalar]:
    """The clearance above the cell of a bracket, by components."""
    return lambda x, y, z: terrain.clearance(jnp.stack([x, y, z]), bracket.cell)


def _line_back(ray: Ray, distance: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    x, y, z = ray.heading_at(distance)
    return -x, -y, -z


def has_point(status: StatusCode) -> Flag:
    """Whether a fix with this status has coordinates."""
    return (
        (status == Status.hit)
        | (status == Status.near_tangent)
        | (status == Status.enters_from_side)
        | (status == Status.hits_void)
    )


def masked(fix: Fix, found: Flag) -> Fix:
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
    ray = _ray_towards(origin, p_ecef, air)
    fix, bracket = met_apart(ray, Status.hit.code, terrain, FIRST_HIT, air)
    return _seen_before(origin, p_ecef, fix, bracket, tolerance, air)


def hidden_or(status: StatusCode, visible: StatusCode) -> StatusCode:
    """A status without terrain, and the visibility over terrain, as one: the terrain hides what the Earth does, too."""
    by_both = (status == Status.below_horizon) & (visible == Status.hidden_by_terrain)
    return jnp.where(by_both, visible, first_failure(status, visible))


@quick_jit
def _ray_towards(origin: Vector3, p_ecef: Vector3, air: Atmosphere | None) -> Ray:
    line = _line_towards(origin, p_ecef, air)
    distance = safe_norm(line)
    return jax.lax.stop_gradient(Ray(origin, line / jnp.where(distance > 0.0, distance, 1.0)))


@quick_jit
def _seen_before(
    origin: Vector3, p_ecef: Vector3, fix: Fix, bracket: Bracket, tolerance: Scalar, air: Atmosphere | None
) -> StatusCode:
    """Visibility of a point from where the ray towards it ends."""
    straight, distance = safe_norm(p_ecef - origin), safe_norm(_line_towards(origin, p_ecef, air))
    ahead = jnp.where(fix.found, straight - fix.slant_range, distance - bracket.lower)
    return _in_sight(jnp.asarray(fix.status), ahead > tolerance)


def _line_towards(origin: Vector3, p_ecef: Vector3, air: Atmosphere | None) -> Vector3:
    return (p_ecef if air is None else apparent_point(origin, p_ecef, air)) - origin


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
