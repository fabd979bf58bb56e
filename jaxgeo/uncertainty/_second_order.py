"""Second-order error propagation: sigma points and exact Hessians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Int

from jaxgeo._compile import quick_filter_jit, quick_jit
from jaxgeo._locate import FIRST_HIT
from jaxgeo._record import portable
from jaxgeo._typing import Matrix3, Scalar, StatusField, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.metrics import circular_error, linear_error, spherical_error
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix

_circular_error, _linear_error, _spherical_error = map(quick_jit, (circular_error, linear_error, spherical_error))
SPREAD = 3.0**0.5  # sigmas: distance of a sigma point, exact to the fourth moment of a Gaussian along its axis


@portable
class Moments(NamedTuple):
    """Mean (m) and covariance (m2) of the fix error in east, north, up; `failed` counts sigma points without a fix."""

    mean_enu: Vector3
    cov_enu: Matrix3
    status: StatusField
    failed: Int[Array, ""]

    def circular_error(self, probability: ArrayLike) -> Scalar:
        """Radius in m about the nominal fix in the horizontal plane."""
        return _circular_error(self.cov_enu[:2, :2], probability, self.mean_enu[:2])

    def linear_error(self, probability: ArrayLike) -> Scalar:
        """Height in m above and below the nominal fix."""
        return _linear_error(self.cov_enu[2, 2], probability, self.mean_enu[2])

    def spherical_error(self, probability: ArrayLike) -> Scalar:
        """3D radius in m about the nominal fix."""
        return _spherical_error(self.cov_enu, probability, self.mean_enu)


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
    1 - n/3: correct to third order in the errors, without information between its points. If a point has no fix, its
    contribution is unknown: the moments are NaN, and `failed` counts such points. Raises as `propagate`.
    """
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    return sigma_moments(inputs, inputs.nominal_fix(search), checked_model(errors, inputs), search)


@quick_filter_jit
def sigma_moments(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, search: AbstractSearch) -> Moments:
    """`sigma_points` of validated input, about the nominal fix."""
    model = model.at(inputs, nominal)
    factor = SPREAD * model.factor().T
    points = jnp.concatenate([jnp.zeros((1, model.size)), factor, -factor])
    offsets, statuses = jax.vmap(lambda error: model.fix_offset(inputs, nominal, error, search))(points)
    found = counts_as_fix(statuses)
    middle, ahead, behind = offsets[0], offsets[1 : model.size + 1], offsets[model.size + 1 :]
    bend = (ahead + behind - 2.0 * middle[None, :]) / SPREAD**2  # second derivatives along the axes
    slope = (ahead - behind) / (2.0 * SPREAD)
    mean = middle + 0.5 * jnp.sum(bend, axis=0)
    cov = slope.T @ slope + 0.5 * bend.T @ bend
    sound = nominal.fix.found & jnp.all(found)
    failed = jnp.sum(~found)
    return Moments(jnp.where(sound, mean, jnp.nan), jnp.where(sound, cov, jnp.nan), nominal.fix.status, failed)


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

    mean_i = tr(H_i Sigma) / 2, cov_ij = (J Sigma J')_ij + tr(H_i Sigma H_j Sigma) / 2. Raises as `propagate`.
    """
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    return second_moments(inputs, inputs.nominal_fix(search), checked_model(errors, inputs))


@quick_filter_jit
def second_moments(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> Moments:
    """`second_order` of validated input, about the nominal fix."""
    model = model.at(inputs, nominal)
    factor, zero = model.factor(), jnp.zeros(model.size)
    offset = lambda z: model.linear_offset(inputs, nominal, factor @ z)  # noqa: E731
    with_itself = lambda z: (jax.jacfwd(offset)(z),) * 2  # noqa: E731
    hessian, jacobian = jax.jacfwd(with_itself, has_aux=True)(zero)
    mean = 0.5 * jnp.trace(hessian, axis1=1, axis2=2)
    cov = jacobian @ jacobian.T + 0.5 * jnp.einsum("iab,jba->ij", hessian, hessian)
    known = lambda x: jnp.where(nominal.fix.found, x, jnp.nan)  # noqa: E731
    return Moments(known(mean), known(cov), nominal.fix.status, jnp.asarray(0))
