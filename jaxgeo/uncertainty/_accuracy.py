"""Accuracy of fixes (CE, LE, SE) by the cheapest propagation method that is valid there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._checks import as_array, as_float64, is_known
from jaxgeo._compile import quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._typing import Scalar
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty._accuracy_map import SAMPLES as SAMPLES_OF_EACH
from jaxgeo.uncertainty._accuracy_map import accuracy_of_cells, check_context
from jaxgeo.uncertainty.accuracy_record import Accuracy
from jaxgeo.uncertainty.linear_accuracy import assess_fix, linear_radii, select_known
from jaxgeo.uncertainty.many_exposures import accuracy_of_exposures
from jaxgeo.uncertainty.map_cells import Request, cells_of_pixels, check_block, check_level
from jaxgeo.uncertainty.method_selection import Method, diagnose
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sampled import FIGURES, draw_errors
from jaxgeo.uncertainty.sampling import Sampling, accepts_sampling_options, resolve_sampling

SAMPLES = 20_000
SAMPLING = Sampling()
OF_PIXELS = (None, None, 0, None, None)


@accepts_sampling_options
@accepts_observation
def accuracy(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[Any],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    in_axes: Sequence[int | None] | None = None,
    probability: ArrayLike = 0.9,
    sampling: Sampling | None = SAMPLING,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    block: int | None = None,
) -> Accuracy:
    """Accuracy of the fix that `locate` returns for the same arguments, or of many fixes at once.

    The terrain around the fix is examined first, without samples: the slopes of facet and footprint, the terrain
    profile along the line of sight with its ridges and unseen gaps, and edges and voids within the errors' range. If
    linear propagation over the facet agrees with footprint and profile, it is used; otherwise that over the footprint,
    if it agrees with the profile. Its radii are scaled by what the profile makes of them. If neither is valid, or the
    ground cannot be probed, samples are drawn as `sampling` says (default: 20 000; of many pixels 2000 each), as they
    are if errors that are not normal make the error of the fix far from normal; otherwise linear propagation uses their
    variance (see `note`).

    - Many pixels of one exposure: `uv` (..., 2); the result has the shape of the pixels.
    - Many exposures: `in_axes`, as for `jax.vmap`, is 0 for each of (sensor, shot, uv, terrain, errors), or of
      (observation, terrain, errors), that is a batch, and None for one shared by all. Times and atmospheres may be
      batches too.
    - `sampling=None` draws nothing and works under `jit`, `vmap` and derivatives: figures that need samples are NaN.

    Of many pixels `block` are evaluated at a time, which bounds the memory (by default 128, on an accelerator 1024),
    and of many exposures at most 16 (on an accelerator `block`); all are sampled with the same key. A missing fix
    raises `ValueError` if there is one observation and `sampling`; otherwise it has a status, and NaN. Raises as
    `propagate`; `ValueError` for a probability outside (0, 1) and unequal batches; `TypeError` if samples would have to
    be drawn under `jit` or `vmap`.

    >>> from jaxgeo.uncertainty import sources
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0))
    >>> errors = jaxgeo.ErrorModel((
    ...     sources.Position.from_ned(north=3.0, east=3.0, down=5.0),
    ...     sources.GimbalAngles.from_degrees(yaw=1.0, pitch=0.5, roll=0.5),
    ...     sources.TerrainHeight.from_metres(2.0),
    ... ))
    >>> scene = sensor, shot, (1999.5, 1499.5), jaxgeo.ConstantHeight(600.0), errors
    ...
    >>> found = jaxgeo.accuracy(*scene)
    >>> print(f"CE90 {found.circular:.2f} m, LE90 {found.linear:.2f} m, by {found.words}")
    CE90 11.52 m, LE90 3.29 m, by linear propagation
    """
    level = check_level(probability)
    options: dict[str, Any] = {"time": time, "search": search, "atmosphere": atmosphere}
    is_traced = not is_known((sensor, shot, uv, terrain, errors, level, time, atmosphere))
    if is_traced and sampling is not None:
        raise TypeError(
            "accuracy draws samples where linear propagation is not valid, which jit, vmap and derivatives do not "
            "allow. Pass sampling=None: figures that need samples are then NaN. For samples of many fixes give all "
            "pixels as uv (..., 2), or all exposures with in_axes, outside of jit."
        )
    if in_axes is None and np.ndim(uv := as_array(uv, "uv")) < 2:
        inputs = ModelInputs.of(sensor, shot, uv, terrain, **options)
        model = checked_model(errors, inputs)
        if sampling is None:
            return _without_samples(inputs, model, level, search)
        return _of_one(inputs, model, level, search, resolve_sampling(sampling, SAMPLES))
    usual = SAMPLES_OF_EACH if in_axes is None else SAMPLES
    request = Request(level, resolve_sampling(sampling, usual, least=0), search, check_block(block))
    if in_axes is not None:
        given = (sensor, shot, uv, terrain, errors, time, atmosphere)
        return accuracy_of_exposures(given, tuple(in_axes), request)
    return _of_pixels(sensor, shot, uv, terrain, errors, time, atmosphere, request, is_traced)


def _of_one(inputs: ModelInputs, model: ErrorModel, level: Scalar, search: AbstractSearch, sampling: Any) -> Accuracy:
    """Accuracy of one fix, by samples if needed; raises `ValueError` without a fix."""
    nominal = inputs.nominal_fix(search)
    nominal.require_fix(inputs)
    model.check_at(nominal)
    return accuracy_about(inputs, nominal, model, level, search, sampling)


def accuracy_about(
    inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, level: Scalar, search: AbstractSearch, sampling: Any
) -> Accuracy:
    """`accuracy` of checked inputs, model and options, about a nominal fix."""
    found = diagnose(inputs, nominal, model)
    one = select_known(found, nominal, level)
    method, probability = Method(int(one.method)), float(level)
    cov, bias, failed, sampled = one.cov_enu, one.bias_enu, np.nan, None
    if method is Method.samples:
        sampled = draw_errors(inputs, nominal, model, search, sampling)
        radii = [sampled.quantile(figure, probability).value for figure in FIGURES]
        cov, bias, failed = np.full((3, 3), np.nan), np.full(3, np.nan), sampled.failed
    else:
        radii = linear_radii(one, level)
    circular, vertical, spherical = jax.device_put(radii)
    code, cov, bias, failed = jax.device_put((int(method), cov, bias, failed))
    linear = found.facet if method is Method.facet else found.footprint
    more = (code, cov, bias, failed, found.diagnostics, sampling.count)
    return Accuracy(
        nominal.fix, level, circular, vertical, spherical, *more, linear, sampled, found.profile, model.left_out
    )


@quick_filter_jit
def _without_samples(inputs: ModelInputs, model: ErrorModel, level: Scalar, search: AbstractSearch) -> Accuracy:
    """Accuracy of one fix by linear propagation, NaN where it is not valid."""
    nominal = inputs.nominal_fix(search)
    one = assess_fix(inputs, nominal, model, level)
    is_linear = (one.method == Method.facet) | (one.method == Method.footprint)
    cov, bias = (jnp.where(is_linear, x, jnp.nan) for x in (one.cov_enu, one.bias_enu))
    figures = (*linear_radii(one, level), one.method, cov, bias, jnp.asarray(jnp.nan), one.diagnostics)
    return Accuracy(nominal.fix, level, *figures, note=model.left_out)


def _of_pixels(
    sensor: Sensor, shot: Any, uv: Any, terrain: Any, errors: Any, time: Any, air: Any, request: Request, traced: bool
) -> Accuracy:
    """Accuracy of the fixes of pixels (..., 2) of one exposure."""
    if isinstance(shot, Pose):
        raise TypeError("shot must be a Shot, or a Trajectory: from a Pose alone a pixel sees nothing yet.")
    pixels = jnp.asarray(as_float64(uv, "uv"))
    if pixels.shape[-1:] != (2,) or not pixels.size:
        raise ValueError(f"uv must be pixels (column, row) of shape (..., 2); got shape {pixels.shape}.")
    shape, pixels = pixels.shape[:-1], pixels.reshape(-1, 2)
    if traced:
        found = accuracy_of_exposures((sensor, shot, pixels, terrain, errors, time, air), OF_PIXELS, request)
        return jax.tree.map(lambda leaf: leaf.reshape(shape + leaf.shape[1:]), found)
    context, model = check_context(sensor, shot, terrain, errors, time, request.search, air)
    return accuracy_of_cells(cells_of_pixels(pixels, context.sensor), shape, request, context, model)
