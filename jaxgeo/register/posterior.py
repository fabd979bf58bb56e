"""Result of an orientation update: corrected sensor and shot, their covariance, and fixes from them."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool

from jaxgeo._checks import concrete
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._numerics import safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Flags, Numbers, ScalarField, StatusField
from jaxgeo.earth.atmosphere import Atmosphere
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
    """Sensor, shot and terrain corrected from tie points, and the covariance of their remaining errors.

    `sensor`, `shot` (or trajectory, with the image's `time` in s), `terrain` and `atmosphere` are the corrected ones.
    `error` (axes,) is the estimated correction of the navigation's model inputs along the axes of `errors`; `shift`
    (2,) is the map shift to the east and north, m: map position = true position + `shift`. `covariance` (axes + 2, axes
    + 2) is the joint covariance of both about the corrected model inputs, from the given errors, not scaled by the
    residuals.

    Ties: `residuals` (n, 2) in px, measured pixel less projection of the map position; `normalised` (n, 2) the same in
    standard deviations of the tie's own errors, `cov_residuals` (n, 2, 2) in px2; `weights` (n,) the weights of the
    loss.
    `chi_square_ties` and `chi_square_prior` are the squared residuals of the ties and the squared distance of `error`
    and `shift` from the prior, both in standard deviations; `redundancy_ties` and `redundancy_prior` are their expected
    values for correct error models. `steps` is the number of steps. `status` is `hit`, `not_converged`, or the reason
    why a tie has no image; all numbers are NaN unless it is `hit`.
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
        """Names of the rows of `covariance`."""
        return (*self.errors.axes, *SHIFT)

    @property
    def unknowns(self) -> Numbers:
        """`error` and `shift` in one vector (axes + 2,)."""
        return jnp.concatenate([jnp.asarray(self.error), jnp.asarray(self.shift)], axis=-1)

    @property
    def cov_error(self) -> Numbers:
        """Covariance (axes, axes) of `error`, with the map shift unknown too."""
        return jnp.asarray(self.covariance)[..., :-2, :-2]

    @property
    def cov_shift(self) -> Numbers:
        """Covariance (2, 2) in m2 of the map shift to the east and north."""
        return jnp.asarray(self.covariance)[..., -2:, -2:]

    @property
    def used(self) -> Flags:
        """Flags of ties with nonzero weight."""
        return jnp.asarray(self.weights) > 0.0

    @property
    def degrees_of_freedom(self) -> Numbers:
        """Twice the sum of the tie weights: every unknown has a prior, so that all tie coordinates are redundant."""
        return 2.0 * jnp.sum(jnp.asarray(self.weights), axis=-1)

    @property
    def redundancy_ties(self) -> Numbers:
        """Expected value of `chi_square_ties`."""
        return self.degrees_of_freedom - self.redundancy_prior

    @property
    def sigma0(self) -> Numbers:
        """Ratio of all residuals, those of the prior included, to their expected size: 1 for correct error models."""
        chi_square = jnp.asarray(self.chi_square_ties) + self.chi_square_prior
        return jnp.sqrt(chi_square / self.degrees_of_freedom)

    @property
    def sigma0_ties(self) -> Numbers:
        """The same ratio for the ties alone; unreliable for few ties, which the unknowns can fit."""
        redundancy = self.redundancy_ties
        return jnp.sqrt(jnp.asarray(self.chi_square_ties) / jnp.where(redundancy > 0.0, redundancy, jnp.nan))

    @property
    def model(self) -> ErrorModel:
        """The remaining navigation errors about the corrected model inputs, all sources as one block."""
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
        """The ground point that a pixel (column, row) sees with the corrected orientation, with its covariance.

        `terrain_sigma` in m is the terrain height error there, independent of that at the ties. Arguments and errors
        are those of `jaxgeo.uncertainty.propagate`; in addition raises `ValueError` if there is no update.

        Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation", use 2.164 standard
        deviations for a 90 % circle. The correct factor is sqrt(-2 ln 0.1) = 2.146, and holds for circular errors only.
        `circular_error(0.9)` of the result is the exact integral over its ellipse: for axes of 278 and 68 m it is 462.5
        m, while 2.146 times the root mean square axis is 434.3 m and contains 87.7 %.
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
