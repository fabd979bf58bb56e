"""Pointing of a gimbal as a root: direction of a target in the camera, its Jacobian, and implicit derivatives."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import matvec, safe_norm
from jaxgeo._typing import Matrix3, Pixel, Scalar, StatusCode, Vector3
from jaxgeo.earth import WGS84, Atmosphere, Geodetic, R_ecef_from_ned
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.sensor._gimbal_inverse import FreeAxes
from jaxgeo.sensor._newton import determinant, solve_2d
from jaxgeo.sensor.gimbal import Readings
from jaxgeo.sensor.line_of_sight import Target
from jaxgeo.sensor.platform import Pose, Station
from jaxgeo.sensor.sensor import Sensor, Sight
from jaxgeo.status import Status, seen_beside

SINGULAR = 1e-7  # relative determinant below which the axes count as parallel: minimum-norm step


class PointingProblem(NamedTuple):
    """Pointing problem: sensor and station, a line of sight in the camera, and a target.

    The target is a point in ECEF m or, if that is None, a direction in ECEF. The rows of `axes` are two axes across the
    line of sight and the line of sight itself, in the camera frame. The readings of `station` are not used.
    """

    sensor: Sensor
    station: Station
    p_ecef: Vector3 | None
    direction: Vector3 | None
    axes: Matrix3
    air: Atmosphere | None

    @classmethod
    def of(
        cls, sensor: Sensor, station: Station, pose: Pose, target: Target, sight: Vector3, air: Any
    ) -> PointingProblem:
        """From a pose, a target and the line of sight in the camera."""
        down = jnp.cross(sight, jnp.array([1.0, 0.0, 0.0]))
        down = down / safe_norm(down)
        axes = jnp.stack([jnp.cross(down, sight), down, sight])
        if isinstance(target, Geodetic):
            return cls(sensor, station, WGS84.to_ecef(target), None, axes, air)
        largest = jnp.max(jnp.abs(target.ned))
        direction = matvec(R_ecef_from_ned(pose.position), target.ned / jnp.where(largest > 0.0, largest, 1.0))
        return cls(sensor, station, None, direction / safe_norm(direction), axes, air)

    def view(self, readings: Readings) -> Sight:
        """Position and orientation of the camera at given readings."""
        return self.sensor.sight(self.station._replace(gimbal_readings=readings))

    def direction_from(self, centre: Vector3, *, for_search: bool = False) -> Vector3:
        """Unit vector in ECEF to the target, or to its apparent position through the atmosphere.

        `for_search` omits the derivative of refraction by the perspective centre: 1e-4 rad times lever arm over
        distance, negligible for Newton steps; this halves the program to compile.
        """
        if self.p_ecef is None:
            return jnp.asarray(self.direction)
        origin = jax.lax.stop_gradient(centre) if for_search else centre
        seeming = self.p_ecef if self.air is None else apparent_point(origin, self.p_ecef, self.air)
        return (seeming - centre) / safe_norm(seeming - centre)


def camera_direction(sensor: Sensor, uv: Pixel | None) -> tuple[Vector3, StatusCode]:
    """Direction in the camera frame to point at the target; the pixel may lie outside the image."""
    axis = sensor.camera.axis()
    if uv is None:
        return axis, Status.hit.code
    direction, status = sensor.camera.ray(uv)
    status = seen_beside(status, direction)
    return jnp.where(status == Status.hit, direction, axis), status


def target_seen(problem: PointingProblem, readings: Readings, *, for_search: bool = False) -> Vector3:
    """Unit vector to the target: two components across the line of sight, then the one along it."""
    view = problem.view(readings)
    direction = problem.direction_from(view.centre, for_search=for_search)
    return matvec(problem.axes, matvec(view.R_ecef_from_camera.T, direction))


def seen_and_slope(
    problem: PointingProblem, readings: Readings, free: FreeAxes, *, for_search: bool = False
) -> tuple[Pixel, Float[Array, "2 free"]]:
    """The two components across the line of sight, and their derivatives by the free axes."""

    def across(angles: Float[Array, " free"]) -> tuple[Pixel, Pixel]:
        seen = target_seen(problem, with_free(readings, free, angles), for_search=for_search)[:2]
        return seen, seen

    J, seen = jax.jacfwd(across, has_aux=True)(readings[free])
    return seen, J


def angle_off(seen: Vector3) -> Scalar:
    """Pointing error in rad of a target seen in that direction."""
    return jnp.arctan2(safe_norm(seen[:2]), seen[2])


def free_axes(problem: PointingProblem, start: Readings) -> FreeAxes:
    """The (at most) two axes that turn the line of sight most at the start, from base to head; others are fixed."""
    gimbal = problem.sensor.gimbal
    if len(gimbal.axes) <= 2:
        return jnp.arange(len(gimbal.axes))
    turns = jax.jacfwd(lambda readings: matvec(problem.view(readings).R_ecef_from_camera, problem.axes[2]))(start)
    per_angle = jnp.sum((turns @ jnp.diag(1.0 / gimbal.gain)) ** 2, axis=0)
    return jnp.sort(jnp.argsort(-per_angle)[:2])


@jax.custom_jvp
def with_derivative(problem: PointingProblem, held: Readings, free: FreeAxes, root: Readings) -> Readings:
    """Readings with `root` on the free axes and `held` on the others; derivatives by the implicit function."""
    return with_free(held, free, root[free])


@with_derivative.defjvp
def _(primals, tangents):
    """d root = -J^-1 (d seen by all other inputs), J by the free axes; recursive, for second derivatives."""
    problem, held, free, root = primals
    d_problem, d_held, _, _ = tangents
    found = with_derivative(problem, held, free, root)
    _, d_seen = jax.jvp(
        lambda w, h: target_seen(w, with_free(h, free, found[free]))[:2], (problem, held), (d_problem, d_held)
    )
    _, J = seen_and_slope(problem, found, free)
    return found, with_free(d_held, free, -least_squares(J, d_seen))


def with_free(readings: Readings, free: FreeAxes, values: Float[Array, " free"]) -> Readings:
    """Readings with other values on the free axes."""
    return readings.at[free].set(values, unique_indices=True)  # otherwise reverse mode cannot transpose it


def least_squares(J: Float[Array, "2 free"], value: Pixel) -> Float[Array, " free"]:
    """Least-squares solution `x` of `J x = value` for one or two unknowns; minimum norm if J is singular.

    J is singular if the line of sight is parallel to an axis.
    """
    if J.shape[1] == 1:
        return (J.T @ value) / jnp.maximum(jnp.sum(J**2), SINGULAR**2)
    size = jnp.sum(J**2)
    singular = jnp.abs(determinant(J)) < SINGULAR * size
    shortest = solve_2d(J.T @ J + SINGULAR**2 * size * jnp.eye(2), J.T @ value)
    return jnp.where(singular, shortest, solve_2d(jnp.where(singular, jnp.eye(2), J), value))
