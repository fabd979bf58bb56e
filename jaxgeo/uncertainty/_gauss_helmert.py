"""Covariance of a fix by the Gauss-Helmert model (condition equations between observations and point)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._typing import Matrix3, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix


@accepts_observation
def gauss_helmert(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
) -> Matrix3:
    """Covariance of the fix in east, north, up (m2), equal to that of `propagate` but computed through `project`.

    Gu (2017), Eq 3. Conditions F(X, l) = 0: the point X projects to the pixel (two collinearity equations) and lies on
    the ground (one equation). With B = dF/dX and A = dF/dl, the covariance is (B' (A Sigma A')^-1 B)^-1. All three
    equations need errors, so the model must include a terrain height source; otherwise the inner matrix is singular and
    the result NaN or infinite. Raises as `propagate`.
    """
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    nominal, model = inputs.nominal_fix(search), checked_model(errors, inputs)
    model.check_at(nominal)
    return _gauss_helmert(inputs, nominal, model)


@quick_filter_jit
def _gauss_helmert(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> Matrix3:
    model = model.at(inputs, nominal)

    def conditions(offset_enu: Vector3, error: Float[Array, " axes"]) -> Vector3:
        moved = model.moved(inputs, error)
        p_ecef = nominal.p_ecef + nominal.R_ecef_from_enu @ offset_enu
        uv, _, _ = image_of_point(moved.sensor, moved.motion, jnp.asarray(moved.time), p_ecef, moved.air)
        return jnp.append(uv - moved.uv, moved.terrain.clearance(p_ecef, nominal.cell))

    B, A = jax.jacfwd(conditions, (0, 1))(jnp.zeros(3), jnp.zeros(model.size))
    inner = A @ model.covariance() @ A.T
    weight = jnp.diag(1.0 / jnp.sqrt(jnp.diagonal(inner)))  # scale pixel and metre rows alike
    B, inner = weight @ B, weight @ inner @ weight
    cov_enu = jnp.linalg.inv(B.T @ jnp.linalg.solve(inner, B))
    return jnp.where(nominal.fix.found, cov_enu, jnp.nan)
