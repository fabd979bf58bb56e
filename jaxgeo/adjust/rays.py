"""Lines of sight of one point in several images: intersection, residuals and error propagation."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int8

from jaxgeo._numerics import cross, dot, safe_angle
from jaxgeo._typing import Flag, Matrix3, Pixel, Scalar, StatusCode, Vector3
from jaxgeo.earth import Atmosphere
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.observation import Exposure
from jaxgeo.sensor import AbstractCamera, Sensor, Shot
from jaxgeo.sensor.sensor import Sight
from jaxgeo.status import Status, seen_beside
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import Occasion

PARALLEL = 1e-14  # determinant of the normal equations with a mean eigenvalue of 1: rays within 1e-7 rad
SINGULAR = 1e-30  # determinant below which a matrix is singular in floating point
FLOOR = 1e-10  # of a residual's variance, added as independent: keeps weights finite if all errors are shared

Rays = Float[Array, "rays 3"]
Flags = Bool[Array, " rays"]
Residuals = Float[Array, "rays 2"]
Stacked = Float[Array, "two_rays two_rays"]
Moves = Float[Array, "rays 2 axes"]


class Image(NamedTuple):
    """A camera, its exterior orientation, the pixel measured in it, and whether that is used."""

    camera: AbstractCamera
    sight: Sight
    uv: Pixel
    used: Flag

    def residual(self, p_ecef: Vector3, air: Atmosphere | None) -> tuple[Pixel, StatusCode]:
        """(pixel of a point in ECEF m less the measured one, px; the camera's status, `hit` also where the pixel lies
        outside the image); the residual is zero if unused.

        Zero, with zero derivatives, also where the point has no image; the status is then the reason.
        """
        return self.residual_of(self.seeming(p_ecef, air))

    def seeming(self, p_ecef: Vector3, air: Atmosphere | None) -> Vector3:
        """Apparent position of a point through the atmosphere, ECEF m."""
        return p_ecef if air is None else apparent_point(self.sight.centre, p_ecef, air)

    def residual_of(self, seeming: Vector3) -> tuple[Pixel, StatusCode]:
        """`residual` of a point at its apparent position."""
        uv, status = self.camera.project(self.sight.to_camera(seeming))
        status = seen_beside(status, uv)
        return jnp.where(self.used & (status == Status.hit), uv - self.uv, 0.0), status


def residuals_of(images: Image, p_ecef: Vector3, air: Atmosphere | None) -> tuple[Residuals, Int8[Array, " rays"]]:
    """Residuals in px of a point in ECEF m in images (leading axis), and their statuses."""
    return jax.vmap(lambda image: image.residual(p_ecef, air))(images)


def design_of(images: Image, p_ecef: Vector3, air: Atmosphere | None) -> tuple[Float[Array, "rays 2 3"], Residuals]:
    """(derivatives of residuals in px by the point, neglecting those of the refraction shift, 0.1 %; residuals)."""

    def of_image(image: Image) -> tuple[Float[Array, "2 3"], Pixel]:
        shift = image.seeming(p_ecef, air) - p_ecef

        def residual(p_ecef: Vector3) -> tuple[Pixel, Pixel]:
            uv, _ = image.residual_of(p_ecef + shift)
            return uv, uv

        return jax.jacfwd(residual, has_aux=True)(p_ecef)

    return jax.vmap(of_image)(images)


def nearest_point(origins: Rays, directions: Rays, used: Flags) -> tuple[Vector3, Flag]:
    """(the point with the smallest sum of squared distances from the rays, ECEF m; whether there is one).

    `origins` (rays, 3) in ECEF m, `directions` (rays, 3) unit vectors; only those `used` (rays,) count. Normal
    equations of I - d d^T, relative to one of the origins; exact for intersecting rays. Parallel rays give that origin.
    """
    reference = origins[jnp.argmax(used)]

    def equations(origin: Vector3, direction: Vector3, use: Flag) -> tuple[Matrix3, Vector3]:
        across = jnp.where(use, jnp.eye(3) - direction[:, None] * direction[None, :], 0.0)
        return across, across @ (origin - reference)

    normal, right = (jnp.sum(part, axis=0) for part in jax.vmap(equations)(origins, directions, used))
    inverse, exists = inverse_of(normal, PARALLEL)
    return reference + inverse @ right, exists


def largest_angle(directions: Rays, used: Flags) -> Scalar:
    """The largest angle between any two of the used rays, rad."""
    angles = jax.vmap(lambda a: jax.vmap(lambda b: safe_angle(a, b))(directions))(directions)
    return jnp.max(jnp.where(used[:, None] & used[None, :], angles, 0.0))


def inverse_of(matrix: Matrix3, singular: float = SINGULAR) -> tuple[Matrix3, Flag]:
    """(inverse of a symmetric, positive definite matrix, zero if it is singular; whether it is regular)."""
    scale = jnp.trace(matrix) / 3.0
    safe_scale = jnp.where(scale > 0.0, scale, 1.0)
    a, b, c = matrix / safe_scale
    columns = jnp.stack([jnp.stack(cross(b, c)), jnp.stack(cross(c, a)), jnp.stack(cross(a, b))], axis=1)
    determinant = dot(a, columns[:, 0])
    exists = (scale > 0.0) & (jnp.abs(determinant) > singular)
    return jnp.where(exists, columns / jnp.where(exists, determinant, 1.0) / safe_scale, 0.0), exists


def moved_by_errors(
    model: ErrorModel, rays: tuple[Sensor, Shot, Residuals, Flags], p_ecef: Vector3, air: Atmosphere | None
) -> Moves:
    """Derivatives, at zero error, of the residuals of a point by the error vector of each image.

    `rays` are (sensors, shots, pixels, used flags), with a leading axis. The errors perturb `ModelInputs`, as in all
    error propagation.
    """

    def of_ray(sensor: Sensor, shot: Shot, uv: Pixel, used: Flag) -> Float[Array, "2 axes"]:
        inputs = ModelInputs(Exposure(sensor, shot, 0.0, air), uv)

        def residual(error: Float[Array, " axes"]) -> Pixel:
            moved = model.moved(inputs, error)
            assert isinstance(moved.motion, Shot)
            sight = moved.sensor.sight(moved.motion)
            return Image(moved.sensor.camera, sight, jnp.asarray(moved.uv), used).residual(p_ecef, moved.air)[0]

        return jax.jacfwd(residual)(jnp.zeros(model.size))

    return jax.vmap(of_ray)(*rays)


def shared_covariance(model: ErrorModel, moves: Moves, occasions: Occasion) -> Stacked:
    """Covariance in px2 of the residuals, ray after ray, from the covariances of each source between the occasions.

    `occasions` have a leading axis of rays.
    """
    rays = moves.shape[0]
    total = jnp.zeros((rays, 2, rays, 2))
    for source, place in model.parts():

        def between(here: Occasion, there: Occasion, source=source) -> Float[Array, "axes axes"]:
            return source.cross_covariance(source, (here, there))

        covs = jax.vmap(lambda here: jax.vmap(lambda there: between(here, there))(occasions))(occasions)
        here = moves[:, :, place]
        total = total + jnp.einsum("iak,ijkl,jbl->iajb", here, covs, here)
    return total.reshape(2 * rays, 2 * rays)


def whitening(cov: Stacked) -> Stacked:
    """B with B^T B the inverse of a covariance; a singular one is first increased by `FLOOR`.

    Entries with zero variance get variance 1.
    """
    variance = jnp.diagonal(cov)
    varies = variance > 0.0
    sigma = jnp.sqrt(jnp.where(varies, variance, 1.0))
    correlation = cov / (sigma[:, None] * sigma[None, :]) + jnp.diag(jnp.where(varies, FLOOR, 1.0))
    lower = jnp.linalg.cholesky(correlation)
    return jax.scipy.linalg.solve_triangular(lower, jnp.diag(1.0 / sigma), lower=True)
