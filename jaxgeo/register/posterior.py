"""What an update finds: the corrected sensor and shot, how sure they are, and fixes from them."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool

from jaxgeo._checks import concrete
from jaxgeo._numerics import safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Flags, Numbers, ScalarField, StatusField
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.locate import FIRST_HIT
from jaxgeo.register.prior import SHIFT, Prior
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.linear import FACET, Propagation, propagate
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sharing import PerImage, PerMeasurement
from jaxgeo.uncertainty.slopes import AbstractSlope
from jaxgeo.uncertainty.sources import Correlated, TerrainHeight
from jaxgeo.uncertainty.sources.base import AbstractSource


class Update(Record):
    """Sensor, shot and terrain as ties have corrected them, and the covariance of what is left of their errors.

    `sensor`, `shot` (or trajectory, with the image's `time` in s), `terrain` and `atmosphere` are the corrected ones.
    `error` (axes,) is by what the navigation's own look was moved to get there, along the axes of `errors`, and `shift`
    (2,) that of the map to the east and north, m: the map shows the true place plus `shift`. `covariance` (axes + 2,
    axes + 2) is that of both together, about the corrected look, by the errors given, not scaled by the residuals.

    Of the ties: `residuals` (n, 2) in px, the pixel measured less that of the place on the map; `normalised` (n, 2) the
    same in standard deviations of the tie's own errors, `cov_residuals` (n, 2, 2) in px2; `weights` (n,) what the loss
    left of each.
    `chi_square_ties` and `chi_square_prior` are the squared residuals of the ties and the squared distance of `error`
    and `shift` from the prior, both in standard deviations; `redundancy_ties` and `redundancy_prior` are what they come
    to on average if the errors given are right. `steps` is how many it took. `status` is `hit`, or `not_converged`, or
    what keeps a tie from being imaged: all numbers are NaN then.
    """

    sensor: Sensor
    shot: Shot | Trajectory
    time: ScalarField | None
    terrain: AbstractTerrain
    atmosphere: Atmosphere | None
    errors: ErrorModel
    prior: Prior
    error: Numbers
    shift: Numbers
    covariance: Numbers
    residuals: Numbers
    normalised: Numbers
    cov_residuals: Numbers
    weights: Numbers
    chi_square_ties: ScalarField
    chi_square_prior: ScalarField
    redundancy_prior: ScalarField
    steps: ScalarField
    status: StatusField

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether there is an update."""
        return jnp.asarray(self.status) == Status.hit

    @property
    def axes(self) -> tuple[str, ...]:
        """A name for every row of `covariance`."""
        return (*self.errors.axes, *SHIFT)

    @property
    def unknowns(self) -> Numbers:
        """`error` and `shift` in one vector (axes + 2,)."""
        return jnp.concatenate([jnp.asarray(self.error), jnp.asarray(self.shift)], axis=-1)

    @property
    def cov_error(self) -> Numbers:
        """Covariance (axes, axes) of `error`, the map's shift being unknown too."""
        return jnp.asarray(self.covariance)[..., :-2, :-2]

    @property
    def cov_shift(self) -> Numbers:
        """Covariance (2, 2) in m2 of the map's shift to the east and north."""
        return jnp.asarray(self.covariance)[..., -2:, -2:]

    @property
    def used(self) -> Flags:
        """Which ties the loss left anything of."""
        return jnp.asarray(self.weights) > 0.0

    @property
    def degrees_of_freedom(self) -> Numbers:
        """Twice the ties, each as its weight: every unknown has its prior, so that all of them are redundant."""
        return 2.0 * jnp.sum(jnp.asarray(self.weights), axis=-1)

    @property
    def redundancy_ties(self) -> Numbers:
        """What `chi_square_ties` comes to on average."""
        return self.degrees_of_freedom - self.redundancy_prior

    @property
    def sigma0(self) -> Numbers:
        """How many times larger all residuals, those of the prior included, are than the errors given would have
        them: 1 if those are right."""
        chi_square = jnp.asarray(self.chi_square_ties) + self.chi_square_prior
        return jnp.sqrt(chi_square / self.degrees_of_freedom)

    @property
    def sigma0_ties(self) -> Numbers:
        """The same of the ties alone; of few ties, which the unknowns can follow, it says little."""
        redundancy = self.redundancy_ties
        return jnp.sqrt(jnp.asarray(self.chi_square_ties) / jnp.where(redundancy > 0.0, redundancy, jnp.nan))

    @property
    def model(self) -> ErrorModel:
        """What is left of the navigation's errors, about the corrected look: all sources as one block."""
        sigma = safe_sqrt(jnp.diagonal(self.cov_error))
        scale = jnp.where(sigma > 0.0, sigma, 1.0)
        correlation = self.cov_error / (scale[:, None] * scale[None, :])
        correlation = jnp.where(jnp.eye(sigma.shape[0]) > 0.0, 1.0, correlation)
        parts = self.errors.sources
        return ErrorModel((Correlated(parts=parts, sigma=sigma, correlation=correlation, sharing=PerImage()),))

    def fix(
        self,
        uv: ArrayLike | Sequence[ArrayLike],
        terrain_sigma: ArrayLike | None = None,
        *,
        search: AbstractSearch = FIRST_HIT,
        slope: AbstractSlope = FACET,
    ) -> Propagation:
        """The ground point that a pixel (column, row) sees from the corrected look, with its covariance.

        `terrain_sigma` in m is the error of the terrain's own height there, which is another than at the ties.
        Arguments and errors are those of `jaxgeo.uncertainty.propagate`; in addition raises `ValueError` if there is no
        update.

        Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation", draw a circle of 2.164
        standard deviations for 90 %; it is sqrt(-2 ln 0.1) = 2.146, and that only of a round error. The result's
        `circular_error(0.9)` is the exact integral over its ellipse: for axes of 278 and 68 m it is 462.5 m, where
        2.146 root mean square axes are 434.3 m and hold 87.7 %.
        """
        known = concrete(self.status)
        if known is not None and known != Status.hit:
            status = Status(int(known))
            raise ValueError(f"there is no update to fix anything from: {status.name}: {status.message}")
        sources: tuple[AbstractSource, ...] = self.model.sources
        if terrain_sigma is not None:
            sources = (*sources, TerrainHeight.from_metres(terrain_sigma, sharing=PerMeasurement()))
        return propagate(
            self.sensor,
            self.shot,
            uv,
            self.terrain,
            ErrorModel(sources),
            time=self.time,
            search=search,
            atmosphere=self.atmosphere,
            slope=slope,
        )
