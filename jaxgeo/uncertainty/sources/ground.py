"""Terrain error sources: height bias, geoid undulation, and spatially correlated heights."""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._checks import check_finite, concrete
from jaxgeo._numerics import smaller
from jaxgeo._typing import Scalar
from jaxgeo.terrain import ConstantField, Dem, LineField
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sharing import AbstractSharing, Occasion, Systematic
from jaxgeo.uncertainty.sources.base import AbstractSource, Axis, Correlation, Covariance, Error, Sigma, sigmas, stated

NODES_A_RANGE = 4  # nodes per shortest correlation length


class TerrainHeight(AbstractSource):
    """Terrain height error, m, the same everywhere: a bias, or a random field evaluated at one location."""

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = Systematic()
    names: ClassVar = ("height",)
    unit: ClassVar = "m"

    @classmethod
    def from_metres(cls, height: Axis, **options: Any) -> TerrainHeight:
        """From a standard deviation in m."""
        return cls(**stated((height,), options))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        return _raised(inputs, error[0])


class Geoid(AbstractSource):
    """Error of the geoid undulation, m, with which heights above sea level were converted to ellipsoidal heights.

    It raises the terrain; with `platform`, also the sensor, if its height was converted in the same way.
    """

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = Systematic()
    platform: bool = eqx.field(static=True, default=False)
    names: ClassVar = ("undulation",)
    unit: ClassVar = "m"

    @classmethod
    def from_metres(cls, undulation: Axis, **options: Any) -> Geoid:
        """From a standard deviation in m."""
        return cls(**stated((undulation,), options))

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        inputs = _raised(inputs, error[0])
        if not self.platform:
            return inputs
        height = inputs.pose.position.height + error[0]
        return inputs.with_pose(eqx.tree_at(lambda pose: pose.position.height, inputs.pose, height))


class TerrainField(AbstractSource):
    """Spatially correlated terrain height errors, m: a Gaussian random field, or one with a `distribution` at each
    place (by a Gaussian copula).

    Its covariance is a sum of Gaussian, s^2 exp(-(d/a)^2), and spherical, s^2 (1 - 1.5 d/a + 0.5 (d/a)^3), variograms,
    each with standard deviation s in m and length a in m (`sigma` lists the Gaussian ones first). For one observation
    it is drawn at nodes along the line of sight, the middle one at the fix, and interpolated linearly between them. It
    is thus valid at the fix and on the ground that the ray passes before it or would reach behind it. The correlation
    between two observations follows from the distances of their nodes.
    """

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = Systematic()
    _: KW_ONLY
    gaussian_lengths: Float[Array, "..."]
    spherical_lengths: Float[Array, "..."]
    place: Float[Array, "... nodes 3"]
    rowcol: Float[Array, "... 2"]
    step: Float[Array, "... 2"]
    nodes: int = eqx.field(static=True, default=33)
    unit: ClassVar = "m"

    @classmethod
    def of_variograms(
        cls,
        *,
        gaussian: Any = (),
        spherical: Any = (),
        nodes: int = 33,
        sharing: AbstractSharing | None = None,
        distribution: Any = None,
    ) -> TerrainField:
        """From lists of (standard deviation in m, length in m), with an odd number of `nodes`.

        The node spacing is a quarter of the shortest length. Raises `ValueError` if there are no variograms, a length
        is not positive, or the number of nodes is even.
        """
        pairs = [*gaussian, *spherical]
        if not pairs or any(len(pair) != 2 for pair in pairs):
            raise ValueError("TerrainField needs variograms: gaussian=[(sigma, length), ...] or spherical=[...], in m.")
        for _, length in pairs:
            check_finite(length, "length of a variogram", "m")
            known = concrete(length)
            if known is not None and not known > 0.0:
                raise ValueError(f"length of a variogram must be positive, in m; got {float(known)!r}.")
        if nodes < 3 or nodes % 2 == 0:
            raise ValueError(f"nodes must be an odd number from 3 on, so that one lies at the fix; got {nodes!r}.")
        of_gaussian, of_spherical = (jnp.asarray([pair[1] for pair in part], float) for part in (gaussian, spherical))
        return cls(
            sigmas(*(pair[0] for pair in pairs)),
            sharing=Systematic() if sharing is None else sharing,
            gaussian_lengths=of_gaussian.reshape(-1),
            spherical_lengths=of_spherical.reshape(-1),
            place=jnp.full((nodes, 3), jnp.nan),  # set by `at`
            rowcol=jnp.zeros(2),
            step=jnp.zeros(2),
            nodes=nodes,
            distribution=distribution,
        )

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(f"node {number - self.nodes // 2:+d}" for number in range(self.nodes))

    @property
    def sigma_axes(self) -> tuple[str, ...]:
        gaussian = len(self.gaussian_lengths)
        return tuple(f"{'gaussian' if k < gaussian else 'spherical'} {k}" for k in range(len(self.sigma)))

    def at(self, inputs: ModelInputs, nominal: NominalFix) -> TerrainField:
        east, north = nominal.direction_enu[0], nominal.direction_enu[1]
        level = jnp.sqrt(east**2 + north**2)
        plumb = level < 1e-9
        ahead = jnp.stack([jnp.where(plumb, 1.0, east), jnp.where(plumb, 0.0, north), jnp.zeros_like(east)])
        spacing = jnp.min(jnp.concatenate([self.gaussian_lengths, self.spherical_lengths])) / NODES_A_RANGE
        way = spacing * (nominal.R_ecef_from_enu @ (ahead / jnp.where(plumb, 1.0, level)))
        numbers = (jnp.arange(self.nodes) - self.nodes // 2).astype(jnp.float64)
        place = nominal.p_ecef[None, :] + numbers[:, None] * way[None, :]
        assert isinstance(inputs.terrain, Dem)
        middle, following = inputs.terrain.over(nominal.p_ecef)[0], inputs.terrain.over(nominal.p_ecef + way)[0]
        step = following - middle
        after = (place, middle + numbers[0] * step, step)
        return eqx.tree_at(lambda source: (source.place, source.rowcol, source.step), self, after)

    def covariance(self) -> Covariance:
        return self.variance_at(_distances(self.place, self.place))

    def cross_covariance(self, there: Any, when: tuple[Occasion, Occasion]) -> Covariance:
        return self.sharing.correlation(*when) * self.variance_at(_distances(self.place, there.place))

    def check(self, inputs: ModelInputs) -> None:
        if not isinstance(inputs.terrain, Dem):
            raise ValueError(
                f"A TerrainField is one of the posts of a Dem; this terrain is a {type(inputs.terrain).__name__}. Use "
                "TerrainHeight for a height that errs everywhere alike."
            )

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        assert isinstance(inputs.terrain, Dem)
        field = LineField(error, self.rowcol, self.step)
        return eqx.tree_at(lambda inputs: inputs.terrain, inputs, inputs.terrain.with_field(field))

    def variance_at(self, distance: Float[Array, "..."]) -> Float[Array, "..."]:
        """Covariance in m2 of the height errors at two points `distance` m apart."""
        sigma, split = jnp.asarray(self.sigma), self.gaussian_lengths.shape[0]
        total = jnp.zeros_like(distance)
        for number in range(split):
            total = total + sigma[number] ** 2 * jnp.exp(-((distance / self.gaussian_lengths[number]) ** 2))
        for number in range(self.spherical_lengths.shape[0]):
            share = smaller(distance / self.spherical_lengths[number], 1.0)
            total = total + sigma[split + number] ** 2 * (1.0 - 1.5 * share + 0.5 * share**3)
        return total


def _raised(inputs: ModelInputs, height: Scalar) -> ModelInputs:
    terrain: Any = inputs.terrain
    return eqx.tree_at(lambda inputs: inputs.terrain, inputs, terrain.with_field(ConstantField(height)))


def _distances(here: Float[Array, "n 3"], there: Float[Array, "m 3"]) -> Float[Array, "n m"]:
    squared = jnp.sum((here[:, None, :] - there[None, :, :]) ** 2, axis=2)
    return jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0)) * (squared > 0.0)
