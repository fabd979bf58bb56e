"""Accuracy of a fix without samples, for batches of pixels and for maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxgeo._record import Record
from jaxgeo._typing import IndexField, Matrix3Field, Numbers, Scalar, ScalarField, Vector3Field
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.locate import FIRST_HIT
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import counts_as_fix
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.method_selection import Diagnostics, Method, diagnose, method_of
from jaxgeo.uncertainty.metrics import circular_error, linear_error, spherical_error
from jaxgeo.uncertainty.metrics.exact import check_probability
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix

NO_FIX = -1  # in place of a `Method`, without a fix


class Assessment(Record):
    """Accuracy of a fix without samples: radii in m that contain the true point with the requested probability.

    `circular` is horizontal, `linear` vertical, `spherical` in space, by the linear propagation `trust`; NaN where that
    is `Method.samples`, which are not drawn here, and without a fix: `trust` is then `NO_FIX` (-1), and `fix.status`
    gives the reason. `signs` are the diagnostics that selected the method.
    """

    fix: Fix
    circular: ScalarField
    linear: ScalarField
    spherical: ScalarField
    trust: IndexField
    signs: Diagnostics


@accepts_observation
def assess(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    probability: ArrayLike = 0.9,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
) -> Assessment:
    """`accuracy` for the same arguments, without samples; works under `jit` and `vmap`.

    A missing fix, or one that may not be the first ground met, has a status and NaN instead of an exception. For many
    pixels use `jax.vmap(assess, in_axes=(None, None, 0, None, None))`, or `accuracy_of_pixels`, which bounds the memory
    and draws samples where needed. Raises as `propagate`, and `ValueError` for a probability outside (0, 1).
    """
    level = check_probability(probability)
    if jnp.ndim(level) != 0:
        raise ValueError(f"probability must be one number; got shape {jnp.shape(level)}. Use jax.vmap.")
    look = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    return _assessed(look, checked_model(errors, look), level, search)


class Judged(NamedTuple):
    """Selected method at a fix, with its linear covariance in m2 and bias in m (east, north, up)."""

    trust: IndexField
    cov_enu: Matrix3Field
    bias_enu: Vector3Field
    signs: Diagnostics


def judged(look: ModelInputs, aim: NominalFix, model: ErrorModel) -> Judged:
    """Method selected by the diagnostics of an observation."""
    signs, facet, footprint, _ = diagnose(look, aim, model)
    trust = method_of(signs)
    take = lambda a, b: jnp.where(trust == Method.footprint, b, a)  # noqa: E731
    cov, bias = take(facet.cov_enu, footprint.cov_enu), take(facet.bias_enu, footprint.bias_enu)
    return Judged(jnp.where(counts_as_fix(jnp.asarray(aim.fix.status)), trust, NO_FIX), cov, bias, signs)


def linear_figures(one: Judged, probability: Scalar) -> tuple[Numbers, Numbers, Numbers]:
    """Circular, linear and spherical error of one or many fixes; NaN where linear propagation is not valid."""
    is_linear = (one.trust == Method.facet) | (one.trust == Method.footprint)
    cov, bias = one.cov_enu, one.bias_enu
    radii = (
        circular_error(cov[..., :2, :2], probability, bias[..., :2]),
        linear_error(cov[..., 2, 2], probability, bias[..., 2]),
        spherical_error(cov, probability, bias),
    )
    circular, linear, spherical = (jnp.where(is_linear, radius, jnp.nan) for radius in radii)
    return circular, linear, spherical


@eqx.filter_jit
def _assessed(look: ModelInputs, model: ErrorModel, probability: Scalar, search: AbstractSearch) -> Assessment:
    aim = look.nominal_fix(search)
    one = judged(look, aim, model)
    return Assessment(aim.fix, *linear_figures(one, probability), one.trust, one.signs)
