"""Linear error propagation: covariance of a fix from the Jacobian of its offset by the errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import is_known
from jaxgeo._compile import is_direct, quick_filter_jit
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import Record
from jaxgeo._renamed import warn_renamed
from jaxgeo._typing import Matrix3, Scalar, Vector3
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.observation import Exposure, accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty._figures import figure
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, Sweep, Tangents, sweep_of
from jaxgeo.uncertainty.radii import circular_radius, linear_radius, spherical_radius
from jaxgeo.uncertainty.slopes import AbstractSlope, Facet, Spread, Surface, along_plane

Swept = Float[Array, "3 axes"]
FACET = Facet()
AXES = 16  # the derivatives of an error model have a multiple of this many axes, so that models share programs
MOST_NUMBERS = 256  # of a larger part of an exposure derivatives are formed only if the errors move it
LEAST_KNOWN = 0.5  # share of a footprint with known ground, below which the fitted plane is not used


class Propagation(Record):
    """Covariance of a fix by linear propagation.

    `jacobian` (3, axes): m of east, north, up at the fix per rad, m, px, s, K or Pa of each axis of the error vector;
    `cov_error` the covariance of the errors; `cov_enu` that of the fix in m2; `bias_enu` the mean error of the fix in m
    (zero except for a footprint slope). `jacobian`, `cov_enu` and `bias_enu` are NaN without a fix (see `fix.status`)
    and if less than half of the ground of a footprint is known (`surface.known`).
    """

    fix: Fix
    jacobian: Swept
    cov_error: Float[Array, "axes axes"]
    cov_enu: Matrix3
    bias_enu: Vector3
    surface: Surface
    nominal: NominalFix
    model: ErrorModel

    def __str__(self) -> str:
        """CE90, LE90 and SE90 of one fix, or counts and quantiles of many; fields if they are traced."""
        if not is_known(self):
            return repr(self)
        radii = {
            "CE90": self.circular_error(0.9), "LE90": self.linear_error(0.9), "SE90": self.spherical_error(0.9),
        }  # fmt: skip
        if np.ndim(self.fix.status) == 0:
            told = ", ".join(f"{name} {figure(radius, 4)} m" for name, radius in radii.items())
            return f"{told}, by linear propagation; {self.fix}"
        known = np.asarray(radii["CE90"])
        known = known[np.isfinite(known)]
        if not known.size:
            return f"{self.fix}"
        low, high = (float(np.quantile(known, share, method="higher")) for share in (0.5, 0.9))
        return f"{self.fix}. CE90 up to {figure(low)} m in half of them, {figure(high)} m in nine tenths."

    @property
    def aim(self) -> NominalFix:
        """Deprecated: `nominal`."""
        warn_renamed("Propagation.aim", "Propagation.nominal")
        return self.nominal

    @property
    def note(self) -> str | None:
        """What linear propagation leaves out of errors that are not normal, as a sentence; None if all are normal."""
        return self.model.left_out

    @property
    def cov_ecef(self) -> Matrix3:
        """Covariance of the fix in ECEF, m2."""
        R = self.nominal.R_ecef_from_enu
        return R @ self.cov_enu @ R.T

    def circular_error(self, probability: ArrayLike) -> Scalar:
        """Radius in m of the horizontal circle about the fix that contains the true point with `probability`.

        Raises `ValueError` for a probability outside (0, 1 - 1e-10] (90 % is 0.9), as the next two.
        """
        return circular_radius(self.cov_enu, probability, self.bias_enu)

    def linear_error(self, probability: ArrayLike) -> Scalar:
        """Half-height in m of the vertical interval about the fix that contains the true point with `probability`."""
        return linear_radius(self.cov_enu, probability, self.bias_enu)

    def spherical_error(self, probability: ArrayLike) -> Scalar:
        """Radius in m of the sphere about the fix that contains the true point with `probability`."""
        return spherical_radius(self.cov_enu, probability, self.bias_enu)


@accepts_observation
def propagate(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    slope: AbstractSlope = FACET,
) -> Propagation:
    """Covariance of the fix that `locate` returns for the same arguments, to first order in `errors`.

    `errors` is an `ErrorModel`, or a tuple of sources. The Jacobian is that of the fix offset, through pose, gimbal,
    camera, atmosphere and the terrain under the fix. With `slope=Footprint()` the ground is the plane fitted over the
    error ellipse, with `Level()` a horizontal plane. Of errors that are not normal only the variance is used, and the
    radii are those of a normal error of the fix (see `Propagation.note`). Works under `jit` and `vmap` like `locate`,
    with its status and NaN where there is no fix; differentiable in the sigmas and all other inputs. Raises as
    `locate`, `TypeError` for an item that is not an error source, and `ValueError` for a negative or NaN sigma, an
    invalid covariance, a distribution without a finite variance, or a source that does not apply to the observation.

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
    >>> found = jaxgeo.propagate(*scene)
    >>> print(f"CE90 {found.circular_error(0.9):.2f} m, LE90 {found.linear_error(0.9):.2f} m")
    CE90 11.60 m, LE90 3.29 m
    """
    inputs = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    nominal, model = inputs.nominal_fix(search), checked_model(errors, inputs)
    model.check_at(nominal)
    return propagate_linear(inputs, nominal, model, slope)


def propagate_linear(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, slope: AbstractSlope) -> Propagation:
    """`propagate` of checked input, about a nominal fix."""
    if not is_known((inputs, nominal, model)):
        model = model.at(inputs, nominal)
        return propagate_sweep(inputs, nominal, model, model.sweep(inputs, nominal), slope)
    errors = derivatives(inputs, nominal, model)
    return errors.propagation(nominal, _over(inputs.terrain, nominal, errors.shared, slope))


def propagate_sweep(
    inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, sweep: Sweep, slope: AbstractSlope
) -> Propagation:
    """Propagation from given derivatives; `model` is already evaluated `at` the observation."""
    cov_error = model.covariance()
    found = over_slope(inputs.terrain, nominal, sweep, cov_error, slope)
    return propagation_of(nominal, model, cov_error, found)


class OverSlope(NamedTuple):
    """Result of linear propagation over a slope; fields as of `Propagation`."""

    jacobian: Swept
    cov_enu: Matrix3
    bias_enu: Vector3
    surface: Surface


def over_slope(
    terrain: AbstractTerrain,
    nominal: NominalFix,
    sweep: Sweep,
    cov_error: Float[Array, "axes axes"],
    slope: AbstractSlope,
) -> OverSlope:
    """Linear propagation over a slope from given derivatives by the errors."""
    jacobian = sweep.facet
    surface = Surface(jnp.array([0.0, 0.0, 1.0]), *(jnp.asarray(x) for x in (0.0, 0.0, 1.0)))
    bias, extra = jnp.zeros(3), jnp.zeros((3, 3))
    if not isinstance(slope, Facet):
        spread = Spread(sweep.line, sweep.ground, cov_error)
        surface = slope.surface(terrain, nominal, facet_normal(terrain, nominal), spread)
        jacobian = spread.on(surface, nominal.direction_enu)
        along = nominal.direction_enu / along_plane(surface.normal, nominal.direction_enu)
        bias, extra = along * surface.above, jnp.outer(along, along) * surface.roughness**2
    known = lambda x: jnp.where(nominal.fix.found & (surface.known >= LEAST_KNOWN), x, jnp.nan)  # noqa: E731
    return OverSlope(known(jacobian), known(jacobian @ cov_error @ jacobian.T + extra), known(bias), surface)


def propagation_of(
    nominal: NominalFix, model: ErrorModel, cov_error: Float[Array, "axes axes"], found: OverSlope
) -> Propagation:
    """The record of a result over a slope; `model` is already evaluated `at` the observation."""
    jacobian, cov_enu, bias, surface = found
    return Propagation(nominal.fix, jacobian, cov_error, cov_enu, bias, surface, nominal, model)


class Shared(NamedTuple):
    """What linear propagation needs of an error model, of a shape that many models share: `by_error` and `cov_error`
    with axes of zeros up to the next size."""

    base: Tangents
    by_error: Tangents
    cov_error: Float[Array, "sizes sizes"]

    def sweep(self, terrain: AbstractTerrain, nominal: NominalFix) -> Sweep:
        """Derivatives of the offset by the errors."""
        return sweep_of(self.base, terrain, nominal, self.by_error)


class Derivatives(NamedTuple):
    """An error model at an observation, its covariance, and the derivatives of the line of sight by its errors."""

    model: ErrorModel
    cov_error: Float[Array, "axes axes"]
    shared: Shared

    def propagation(self, nominal: NominalFix, found: OverSlope) -> Propagation:
        """The record of a result of all axes of `shared`."""
        jacobian = jax.device_put(np.asarray(found.jacobian)[:, : self.model.size])
        return propagation_of(nominal, self.model, self.cov_error, found._replace(jacobian=jacobian))


def derivatives(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> Derivatives:
    """Derivatives of the line of sight by the errors of a model.

    Called directly, only how the errors move the exposure is compiled for another model: the derivatives of the line of
    sight by the exposure are a program of their own, which models of about as many axes share.
    """
    if not is_direct():
        return _derivatives_at_once(inputs, nominal, model)
    model, cov_error, moves = _moves(inputs, nominal, model)
    shared = Shared(*_of_line((inputs.exposure, inputs.uv), moves), moves.cov_error)
    return Derivatives(model, cov_error, shared)


def _derivatives_at_once(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> Derivatives:
    model = model.at(inputs, nominal)
    cov_error = model.covariance()
    base, by_error = model.tangents(inputs, nominal)
    return Derivatives(model, cov_error, Shared(base, _padded(by_error), _padded(cov_error, 2)))


class Moves(NamedTuple):
    """The parts of an exposure and its pixel that errors may move, without errors and their derivatives by the errors
    (last axis, padded), and the same of the height in m of the terrain above the fix; the padded covariance."""

    base: tuple[Any, Scalar]
    by_error: tuple[Any, Float[Array, " sizes"]]
    cov_error: Float[Array, "sizes sizes"]


@quick_filter_jit
def _moves(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> tuple[ErrorModel, Any, Moves]:
    """(model at the observation, its covariance, how its errors move the exposure)."""
    model = model.at(inputs, nominal)
    cov_error = model.covariance()
    may_move = _may_move(inputs, model)

    def reached(error: Array) -> tuple[Any, Any]:
        moved = model.moved(inputs, error)
        parts = eqx.filter((moved.exposure, moved.uv), may_move)
        found = parts, -moved.terrain.clearance(nominal.p_ecef, nominal.cell)
        return found, found

    by_error, base = jax.jacfwd(reached, has_aux=True)(jnp.zeros(model.size))
    return model, cov_error, Moves(base, _padded(by_error), _padded(cov_error, 2))


def _may_move(inputs: ModelInputs, model: ErrorModel) -> Any:
    """Whether each leaf of an exposure and its pixel is one that errors may move: the small ones, so that models share
    a program, and those that this model moves."""
    found: Any = None

    def moved(inputs: ModelInputs) -> Any:
        nonlocal found
        given = {id(leaf) for leaf in jax.tree.leaves((inputs.exposure, inputs.uv))}
        after = model.moved(inputs, jnp.zeros(model.size))
        found = jax.tree.map(
            lambda leaf: eqx.is_inexact_array(leaf) and (leaf.size <= MOST_NUMBERS or id(leaf) not in given),
            (after.exposure, after.uv),
        )
        return ()

    eqx.filter_eval_shape(moved, inputs)
    return found


@quick_filter_jit
def _of_line(exposed: tuple[Exposure, Any], moves: Moves) -> tuple[Tangents, Tangents]:
    """(what the fix depends on, its derivatives by the errors), from those of the exposure."""

    def reached(parts: Any, raised: Scalar) -> Tangents:
        exposure, uv = eqx.combine(parts, exposed)
        return Tangents(ModelInputs(exposure, uv).ray(), jax.tree.map(jnp.asarray, exposure.atmosphere), raised)

    along = lambda one: jax.jvp(reached, moves.base, one)[1]  # noqa: E731
    return reached(*moves.base), jax.vmap(along, in_axes=-1, out_axes=-1)(moves.by_error)


def _padded(by_error: Any, axes: int = 1) -> Any:
    """Arrays with zeros up to the next size in their last axes."""
    pad = lambda x: jnp.pad(x, [(0, 0)] * (x.ndim - axes) + [(0, -x.shape[-1] % AXES)] * axes)  # noqa: E731
    return jax.tree.map(pad, by_error)


@quick_filter_jit
def _over(terrain: AbstractTerrain, nominal: NominalFix, shared: Shared, slope: AbstractSlope) -> OverSlope:
    return over_slope(terrain, nominal, shared.sweep(terrain, nominal), shared.cov_error, slope)


def facet_normal(terrain: AbstractTerrain, nominal: NominalFix) -> Vector3:
    """Surface normal under the fix in east, north, up, scaled so that its last component is 1."""
    gradient = nominal.R_ecef_from_enu.T @ jax.grad(terrain.clearance)(nominal.p_ecef, nominal.cell)
    return gradient / gradient[2]
