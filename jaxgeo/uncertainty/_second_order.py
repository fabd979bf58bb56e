"""Second-order error propagation: sigma points and exact Hessians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int, Int8

from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import portable
from jaxgeo._typing import Matrix3, Scalar, StatusField, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.radii import circular_radius, linear_radius, spherical_radius

SPREAD = 3.0**0.5  # sigmas: distance of a sigma point, exact to the fourth moment of a Gaussian along its axis


@portable
class Moments(NamedTuple):
    """Mean (m) and covariance (m2) of the fix error in east, north, up; `failed` counts sigma points without a fix."""

    mean_enu: Vector3
    cov_enu: Matrix3
    status: StatusField
    failed: Int[Array, ""]

    def circular_error(self, probability: ArrayLike) -> Scalar:
        """Radius in m about the nominal fix in the horizontal plane.

        Raises `ValueError` for a probability outside (0, 1 - 1e-10] (90 % is 0.9), as the next two.
        """
        return circular_radius(self.cov_enu, probability, self.mean_enu)

    def linear_error(self, probability: ArrayLike) -> Scalar:
        """Height in m above and below the nominal fix."""
        return linear_radius(self.cov_enu, probability, self.mean_enu)

    def spherical_error(self, probability: ArrayLike) -> Scalar:
        """3D radius in m about the nominal fix."""
        return spherical_radius(self.cov_enu, probability, self.mean_enu)


@accepts_observation
def sigma_points(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
) -> Moments:
    """Mean and covariance of the fix error from 2 n + 1 sigma points (Julier and Uhlmann 1997), at 3^(1/2) sigmas.

    Along each axis this is Gauss-Hermite quadrature with three nodes, i.e. the unscented transform with central weight
    1 - n/3: correct to third order in the errors, without information between its points. Along an independent axis
    that is not normal it is the Gauss quadrature of its distribution, by skewness and kurtosis (Julier 1998, "A skewed
    approach to filtering"); axes that are correlated within a source count as normal. If a point has no fix, its
    contribution is unknown: the moments are NaN, and `failed` counts such points. Raises as `propagate`, and
    `ValueError` for a distribution without a finite fourth moment.
    """
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    model = checked_model(errors, inputs, moments=4)
    nominal = inputs.nominal_fix(search)
    model.check_at(nominal)
    return sigma_moments(inputs, nominal, model, search)


@quick_filter_jit
def sigma_moments(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, search: AbstractSearch) -> Moments:
    """`sigma_points` of validated input, about the nominal fix."""
    model = model.at(inputs, nominal)
    order = axis_moments(model)
    points = sigma_points_of(model.size, order) @ model.factor().T
    offsets, statuses = jax.vmap(lambda error: model.fix_offset(inputs, nominal, error, search))(points)
    return moments_of_points(nominal, offsets, statuses, order)


class AxisMoments(NamedTuple):
    """Skewness and kurtosis of the axes z of an error model, with error vectors L z of its factor L."""

    skewness: Float[Array, " axes"]
    kurtosis: Float[Array, " axes"]

    @property
    def nodes(self) -> tuple[Float[Array, " axes"], Float[Array, " axes"]]:
        """Distances ahead and behind of the outer nodes of the Gauss quadrature with three nodes, one of them at 0."""
        middle = 0.5 * self.skewness
        half = jnp.sqrt(self.kurtosis - 3.0 * middle**2)
        return half + middle, half - middle


def axis_moments(model: ErrorModel) -> AxisMoments | None:
    """The moments of a model; None if all errors are normal. Correlated axes of one source count as normal."""
    if model.is_normal:
        return None
    skewness, kurtosis = jnp.zeros(model.size), jnp.full(model.size, 3.0)
    for source, place in model.parts():
        if source.is_normal or not source.is_independent:
            continue
        first = place.start
        for axis, shape in enumerate(source.shapes):
            if shape is not None:
                skewness = skewness.at[first + axis].set(shape.skewness)
                kurtosis = kurtosis.at[first + axis].set(shape.kurtosis)
    return AxisMoments(skewness, kurtosis)


def sigma_points_of(axes: int, order: AxisMoments | None = None) -> Float[Array, "points axes"]:
    """Sigma points of axes that are standard normal, or have other moments."""
    if order is not None:
        ahead, behind = order.nodes
        return jnp.concatenate([jnp.zeros((1, axes)), jnp.diag(ahead), -jnp.diag(behind)])
    spread = SPREAD * np.eye(axes)
    return jnp.asarray(np.concatenate([np.zeros((1, axes)), spread, -spread]))


@quick_filter_jit
def moments_of_points(
    nominal: NominalFix,
    offsets: Float[Array, "points 3"],
    statuses: Int8[Array, " points"],
    order: AxisMoments | None = None,
) -> Moments:
    """Moments from the offsets in m, and statuses, of the fixes of the `sigma_points_of` a model."""
    axes = len(offsets) // 2
    found = counts_as_fix(statuses)
    middle, ahead, behind = offsets[0], offsets[1 : axes + 1], offsets[axes + 1 :]
    if order is None:
        bend = (ahead + behind - 2.0 * middle[None, :]) / SPREAD**2  # second derivatives along the axes
        slope = (ahead - behind) / (2.0 * SPREAD)
        cov = slope.T @ slope + 0.5 * bend.T @ bend
    else:
        far, near = (x[:, None] for x in order.nodes)
        rise, fall = (ahead - middle[None, :]) / far, (middle[None, :] - behind) / near
        bend, slope = 2.0 * (rise - fall) / (far + near), (near * rise + far * fall) / (far + near)
        cov = slope.T @ slope + _of_bends(slope, bend, order)
    mean = middle + 0.5 * jnp.sum(bend, axis=0)
    sound = nominal.fix.found & jnp.all(found)
    failed = jnp.sum(~found)
    return Moments(jnp.where(sound, mean, jnp.nan), jnp.where(sound, cov, jnp.nan), nominal.fix.status, failed)


def _of_bends(slope: Float[Array, "axes 3"], bend: Float[Array, "axes 3"], order: AxisMoments) -> Matrix3:
    """Covariance of the sum of b (z^2 - 1) / 2 over independent axes z, and its covariance with that of s z."""
    skew = 0.5 * slope.T @ (order.skewness[:, None] * bend)
    return 0.25 * bend.T @ ((order.kurtosis - 1.0)[:, None] * bend) + skew + skew.T


@accepts_observation
def second_order(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
) -> Moments:
    """Mean and covariance of the fix error to second order, by exact Hessians on the facet under the fix.

    mean_i = tr(H_i Sigma) / 2, cov_ij = (J Sigma J')_ij + tr(H_i Sigma H_j Sigma) / 2. Independent axes that are not
    normal count with their skewness and kurtosis. Raises as `sigma_points`.
    """
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    nominal, model = inputs.nominal_fix(search), checked_model(errors, inputs, moments=4)
    model.check_at(nominal)
    return second_moments(inputs, nominal, model)


@quick_filter_jit
def second_moments(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> Moments:
    """`second_order` of validated input, about the nominal fix.

    By the implicit function theorem from one Hessian, of a point along the line of sight and its height above the
    surface by range and errors, which compiles in half the time of that of the intersection.
    """
    model = model.at(inputs, nominal)
    factor = model.factor()

    def reached(place: Float[Array, " range_and_axes"]) -> Float[Array, "4"]:
        moved = model.moved(inputs, factor @ place[1:])
        p_ecef = moved.ray().through(moved.air).at(place[0])
        offset = nominal.R_ecef_from_enu.T @ (p_ecef - nominal.p_ecef)
        return jnp.append(offset, moved.terrain.clearance(p_ecef, nominal.cell))

    with_itself = lambda place: (jax.jacfwd(reached)(place),) * 2  # noqa: E731
    place = jnp.append(inputs.range_to_surface(nominal), jnp.zeros(model.size))
    hessian, jacobian = jax.jacfwd(with_itself, has_aux=True)(place)
    per_height = 1.0 / jnp.where(jacobian[3, 0] == 0.0, 1.0, jacobian[3, 0])
    along = jnp.concatenate([-per_height * jacobian[3:, 1:], jnp.eye(model.size)])  # range and errors, on the surface
    bends = along.T @ hessian @ along
    hessian = bends[:3] - jnp.multiply.outer(per_height * jacobian[:3, 0], bends[3])
    jacobian = jacobian[:3] @ along
    mean = 0.5 * jnp.trace(hessian, axis1=1, axis2=2)
    cov = jacobian @ jacobian.T + 0.5 * jnp.einsum("iab,jba->ij", hessian, hessian)
    order = axis_moments(model)
    if order is not None:  # the trace holds the bends along the axes as those of normal numbers
        bend = jnp.diagonal(hessian, axis1=1, axis2=2).T
        cov = cov + _of_bends(jacobian.T, bend, order) - 0.5 * bend.T @ bend
    known = lambda x: jnp.where(nominal.fix.found, x, jnp.nan)  # noqa: E731
    return Moments(known(mean), known(cov), nominal.fix.status, jnp.asarray(0))
