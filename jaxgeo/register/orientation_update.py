"""Orientation update: navigation errors estimated from tie points between an image and a reference map."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._arguments import check_mapped_terrain, checked_air, checked_exposure
from jaxgeo._checks import as_float64, check_is, concrete
from jaxgeo.adjust.losses import AbstractLoss, Huber
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.observation import Exposure, accepts_exposure
from jaxgeo.register._equations import Problem
from jaxgeo.register._solution import Solution, solve
from jaxgeo.register.posterior import Update
from jaxgeo.register.prior import Prior, checked_prior
from jaxgeo.register.tie_errors import AbstractTiePropagation, FullJacobian, TieErrors, checked_tie_errors
from jaxgeo.register.ties import TiePoints, checked_ties, padded
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, of_arrays
from jaxgeo.uncertainty.sources import TerrainField, TerrainHeightRaster

ALONE = 10.0  # standard deviations of a lone tie: largest prior uncertainty of its pixel
HUBER, FULL_JACOBIAN = Huber(), FullJacobian()


@accepts_exposure
def update_orientation(
    sensor: Sensor,
    shot: Shot | Trajectory,
    ties: TiePoints,
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    tie_errors: TieErrors,
    *,
    prior: Prior | None = None,
    loss: AbstractLoss = HUBER,
    propagation: AbstractTiePropagation = FULL_JACOBIAN,
    time: ArrayLike | None = None,
    atmosphere: Atmosphere | None = None,
) -> Update:
    """Correct sensor, shot and terrain from tie points with a reference map, with the posterior covariance.

    `sensor`, `shot` (or a trajectory with the image's `time` in s), `terrain` and `atmosphere` are those of the
    navigation, as for `jaxgeo.locate`. `errors` is the navigation's `ErrorModel`, or a tuple of sources: its error
    vector is estimated together with the map shift. All sources can be included (position, attitude, gimbal, boresight,
    interior orientation, a common terrain height, ...); components that the ties do not determine keep their prior. A
    `TerrainHeightRaster` is one standard normal number: it raises the ground at each tie by its value there.
    `ties` are the matched points, `tie_errors` the errors of map and terrain there.

    The residual of a tie is its pixel less the projection of its map position, corrected for the map shift and placed
    on the terrain. Its covariance includes the match, the map and the terrain height, propagated by the derivatives of
    the projection (`propagation`), and the pixel. The solution is damped Gauss-Newton least squares with the prior as
    observations; each step is applied to the model inputs, so that the covariance refers to the corrected ones.
    Residuals are weighted by `loss`; redescending losses (`Tukey`, `Cauchy`) start from the `Huber` solution.

    `prior` defaults to zero mean with the covariance of `errors` and of `tie_errors.shift`. A prior of
    `propagate_prior` carries over the update of another image; `tie_errors.shift` is then ignored.

    Works under `jit` and `vmap`; the result is not differentiable. An update that does not converge has status
    `not_converged` and NaN.
    Raises `TypeError` for arguments of the wrong kind and float32, `RuntimeError` with 64-bit floats off. `ValueError`
    for no ties, shapes that do not fit, numbers that are not finite, ties over unknown terrain (by number), more than
    4096 ties, a `TerrainField` among `errors` (it belongs in `tie_errors`), a `TerrainHeightRaster` that is not known
    at all ties or of a terrain that is no `Dem`, ties without any error, as
    `jaxgeo.uncertainty.propagate` does for errors, and for a single tie whose prior uncertainty exceeds ten of its
    standard deviations: a wrong match could not be detected.
    """
    sensor, shot, moment = checked_exposure(sensor, shot, time)
    check_mapped_terrain(terrain)
    ties = checked_ties(ties)
    tie_errors = checked_tie_errors(tie_errors, ties)
    check_is(loss, AbstractLoss, "loss")
    check_is(propagation, AbstractTiePropagation, "propagation")
    inputs = ModelInputs(Exposure(sensor, shot, moment, checked_air(atmosphere)), terrain=of_arrays(terrain))
    model = checked_model(errors, inputs)
    _check_sources(model, terrain, ties)
    prior = Prior.of(model, tie_errors) if prior is None else checked_prior(prior, model)
    loss = as_float64(loss, "loss")
    solution = solve(Problem(inputs, model, padded(ties), tie_errors, prior, loss, propagation))
    _check_ground(solution, ties.count)
    _check_alone(solution, ties.count)
    return _handed_over(solution, inputs, model, prior, ties.count, time is not None)


def _handed_over(
    solution: Solution, inputs: ModelInputs, model: ErrorModel, prior: Prior, count: int, has_time: bool
) -> Update:
    exposure = solution.exposure
    terrain = inputs.terrain
    if solution.terrain is not None:
        terrain = solution.terrain
    elif isinstance(terrain, Dem) and solution.field is not None:
        terrain = dataclasses.replace(terrain, field=solution.field)  # without copying its posts
    return Update(
        sensor=exposure.sensor,
        shot=exposure.motion,
        time=exposure.time if has_time or isinstance(exposure.motion, Trajectory) else None,
        terrain=terrain,
        atmosphere=exposure.atmosphere,
        errors=model,
        prior=prior,
        error=solution.unknowns[:-2],
        shift=solution.unknowns[-2:],
        covariance=solution.covariance,
        residuals=_first(solution.residuals, count),
        normalised=_first(solution.normalised, count),
        cov_residuals=_first(solution.cov_residuals, count),
        weights=_first(solution.weights, count),
        chi_square_ties=solution.chi_square_ties,
        chi_square_prior=solution.chi_square_prior,
        redundancy_prior=solution.determined,
        steps=solution.steps,
        status=solution.status,
    )


def _first(values: Any, count: int) -> Any:
    known = concrete(values)
    return values[:count] if known is None else jnp.asarray(known[:count])  # without compiling for each count


def _check_sources(model: ErrorModel, terrain: AbstractTerrain, ties: TiePoints) -> None:
    for number, source in enumerate(model.sources):
        if isinstance(source, TerrainHeightRaster):
            _check_raster(f"errors[{number}]", source, terrain, ties)
        if isinstance(source, TerrainField):
            raise ValueError(
                f"errors[{number}] is a TerrainField, which is an error along one line of sight; for the ground at the "
                "ties give it as TieErrors(terrain_field=...), and what is common to all as a TerrainHeight."
            )


def _check_raster(name: str, source: TerrainHeightRaster, terrain: AbstractTerrain, ties: TiePoints) -> None:
    if not isinstance(terrain, Dem):
        raise ValueError(
            f"{name} is a TerrainHeightRaster, which raises the posts of a Dem; this terrain is a "
            f"{type(terrain).__name__}. State a TerrainHeight in its place."
        )
    known = concrete(source.known_at(ties.ground.lat, ties.ground.lon))
    if known is not None and not known.all():
        lost = np.flatnonzero(~known).tolist()
        raise ValueError(
            f"{name}: no standard deviation is known at {len(lost)} of {ties.count} ties: {_listed(lost)}. They lie "
            "off the raster, or beside a void of it. Read one that covers the ground, leave these ties out, or state "
            "a TerrainHeight."
        )


def _listed(ties: list[int]) -> str:
    return ", ".join(str(tie) for tie in ties[:20]) + (", ..." if len(ties) > 20 else "")


def _check_ground(solution: Solution, count: int) -> None:
    known = concrete(solution.has_ground)
    if known is None or known[:count].all():
        return
    lost = [tie for tie in range(count) if not known[tie]]
    raise ValueError(
        f"{len(lost)} of {count} ties lie outside the terrain or over a void: {_listed(lost)}. Leave them out, or load "
        "a larger terrain."
    )


def _check_alone(solution: Solution, count: int) -> None:
    predicted, status = concrete(solution.predicted), concrete(solution.status)
    if count > 1 or predicted is None or status is None or status != Status.hit or predicted <= ALONE:
        return
    raise ValueError(
        f"ties holds {count} tie point, whose pixel the prior predicts to {float(predicted):.3g} of its standard "
        f"deviations only: more than {ALONE:g}, so that nothing would tell a wrong match. Give two or more."
    )
