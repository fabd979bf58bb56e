"""Terrain height error with a standard deviation from a raster."""

from __future__ import annotations

from dataclasses import KW_ONLY
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxgeo._checks import as_array, as_float64, concrete, is_known
from jaxgeo._compile import quick_filter_jit
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.status import have_fix
from jaxgeo.terrain import Dem
from jaxgeo.terrain.field import AbstractField, Bounds
from jaxgeo.terrain.grid import AbstractGrid
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.sharing import AbstractSharing, Systematic
from jaxgeo.uncertainty.sources.base import AbstractSource, Correlation, Error, Sigma, sigmas
from jaxgeo.uncertainty.sources.ground import TerrainField, TerrainHeight

ON_EDGE = 1e-9  # posts: rounding tolerance for fixes on the last post


class TerrainHeightRaster(AbstractSource):
    """Terrain height error with a standard deviation from a raster, such as the height error layer of a DEM.

    `posts` (rows, cols) are standard deviations in m on a `grid` of their own, NaN where unknown; `sigma` is a factor
    on them. At an observation the source is a `TerrainHeight` with the value at the fix, bilinear between the four
    posts around it: the error is the same at all ground that lines of sight of that observation reach. Shared errors of
    two observations (`sharing`) are one standard normal number times the value at each. Where many places of the ground
    are used at once, as in `jaxgeo.register.update_orientation`, the error is that number, and raises each post of the
    terrain by it times the value there (0 where unknown).

    Where a fix lies off the raster, or one of the four posts is unknown, functions of one fix raise `ValueError`. Of
    many fixes such a one has infinite figures with a `failed` share of 1 by samples, and NaN without samples or under
    `jit`. Make a source with `jaxgeo.io.read_height_sigmas` or `from_array`.
    """

    sigma: Sigma
    correlation: Correlation = None
    sharing: AbstractSharing = Systematic()
    _: KW_ONLY
    posts: Float[Array, "... rows cols"]
    grid: AbstractGrid
    names: ClassVar = ("height",)
    unit: ClassVar = "1"

    @classmethod
    def from_array(
        cls, posts: ArrayLike, grid: AbstractGrid, *, scale: ArrayLike = 1.0, **options: Any
    ) -> TerrainHeightRaster:
        """From standard deviations in m (rows, cols), NaN where unknown, on a grid, times `scale`.

        `options` are `sharing` and `distribution`. Raises `ValueError` for negative or infinite ones, or fewer than 2
        by 2.
        """
        given: Any = as_float64(as_array(posts, "posts"), "posts")
        if given.ndim != 2 or min(given.shape) < 2:
            raise ValueError(f"posts must be standard deviations (rows, cols), 2 x 2 or more; got shape {given.shape}.")
        known = concrete(given)
        if known is not None and np.any(wrong := (known < 0.0) | np.isinf(known)):
            row, col = np.argwhere(wrong)[0].tolist()
            raise ValueError(
                "posts must be standard deviations in m, 0 or more, NaN where unknown; got "
                f"{float(known[row, col])!r} at row {row}, column {col}."
            )
        return cls(sigmas(scale), posts=given, grid=as_float64(grid, "grid"), **options)

    def at(self, inputs: ModelInputs, nominal: NominalFix) -> Any:
        del inputs
        value = sigma_at(self.posts, self.grid, nominal.p_ecef)
        return TerrainHeight(
            jnp.asarray(self.sigma) * value, self.correlation, self.sharing, distribution=self.distribution
        )

    def check_at(self, nominal: NominalFix) -> None:
        if not is_known((self.posts, self.grid, nominal)) or not have_fix(nominal.fix.status):
            return
        if np.isnan(float(_sigma_at(self.posts, self.grid, nominal.p_ecef))):
            lat, lon, _ = (float(x) for x in nominal.fix.position.to_degrees())
            raise ValueError(
                f"{self.label}: no standard deviation is known at the fix, {lat:.6f} deg, {lon:.6f} deg (lat, lon): it "
                "lies off the raster, or beside a void of it. Read one that covers the ground, or state a "
                "TerrainHeight there."
            )

    def moved(self, inputs: ModelInputs, error: Error) -> ModelInputs:
        terrain = inputs.terrain
        if not isinstance(terrain, Dem):
            raise TypeError(
                f"{self.label}: without a fix at which it is one height, a raster of standard deviations raises the "
                f"posts of a Dem; this terrain is a {type(terrain).__name__}. State a TerrainHeight in its place."
            )
        field = RasterField(jnp.asarray(error)[0], self.posts, self.grid, terrain.grid)
        return eqx.tree_at(lambda inputs: inputs.terrain, inputs, terrain.with_field(field))

    def known_at(self, lat: ArrayLike, lon: ArrayLike) -> Any:
        """Whether the standard deviation is known at places, in rad (n,)."""
        return _known_at(self.posts, self.grid, jnp.asarray(lat), jnp.asarray(lon))


class RasterField(AbstractField):
    """Heights in m added to the posts of a terrain: `factor` times a raster `posts` (rows, cols) in m on its own grid,
    bilinear, 0 where it is unknown; `of` is the terrain's grid."""

    factor: Scalar
    posts: Float[Array, "... rows cols"]
    grid: AbstractGrid
    of: AbstractGrid

    def at(self, row: Scalar, col: Scalar) -> Scalar:
        value = _value_at(self.posts, self.grid, self.of.normal(jnp.stack([row, col])))
        return self.factor * jnp.where(jnp.isnan(value), 0.0, value)

    def bounds(self) -> Bounds:
        most = self.factor * jnp.max(jnp.where(jnp.isnan(self.posts), 0.0, self.posts))
        return jnp.minimum(most, 0.0), jnp.maximum(most, 0.0)


def sigma_at(posts: Float[Array, "rows cols"], grid: AbstractGrid, p_ecef: Vector3) -> Scalar:
    """Value at an ECEF point, bilinear; NaN off the posts, and beside unknown ones."""
    return _value_at(posts, grid, WGS84.normal_and_height(p_ecef)[0])


def _value_at(posts: Float[Array, "rows cols"], grid: AbstractGrid, normal: Vector3) -> Scalar:
    """`sigma_at` by the ellipsoid's normal."""
    rows, cols = posts.shape
    rowcol = grid.rowcol(normal)
    last = jnp.array([rows - 1.0, cols - 1.0])
    inside = jnp.all((rowcol >= -ON_EDGE) & (rowcol <= last + ON_EDGE))
    place = jnp.where(inside, rowcol, 0.0)
    cell = jax.lax.stop_gradient(jnp.clip(jnp.floor(place), 0.0, last - 1.0)).astype(jnp.int32)
    r, c = place[0] - cell[0], place[1] - cell[1]
    four = jax.lax.dynamic_slice(posts, (cell[0], cell[1]), (2, 2))
    is_known = inside & jnp.all(jnp.isfinite(four))
    four = jnp.where(is_known, four, 0.0)
    along, across, bend = four[1, 0] - four[0, 0], four[0, 1] - four[0, 0], four[1, 1] - four[1, 0]
    value = four[0, 0] + r * along + c * across + r * c * (bend - across)  # exact where all four are equal
    return jnp.where(is_known, value, jnp.nan)


_sigma_at = quick_filter_jit(sigma_at)


@quick_filter_jit
def _known_at(posts: Any, grid: AbstractGrid, lat: Any, lon: Any) -> Any:
    normal = jnp.stack([jnp.cos(lat) * jnp.cos(lon), jnp.cos(lat) * jnp.sin(lon), jnp.sin(lat)], axis=-1)
    return ~jnp.isnan(jax.vmap(lambda one: _value_at(posts, grid, one))(normal))


OF_TERRAIN = TerrainHeight | TerrainField | TerrainHeightRaster  # errors of the height of the terrain
